"""Makes motions, one module each."""
