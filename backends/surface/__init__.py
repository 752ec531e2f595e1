"""What surfaces are made of, as far as renderers share it."""
