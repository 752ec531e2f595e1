"""Every pass but ``rgb``: what the exact caster's hits say."""
