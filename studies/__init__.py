"""Error against run time: of renderers, of the compiler's approximations, of everything timed."""
