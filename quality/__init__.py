"""Error against run time: of renderers, and of each of the compiler's approximations."""
