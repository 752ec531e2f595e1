"""The library that the commands call, and that ``import scenec`` gives."""
