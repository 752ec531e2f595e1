"""Objects that come in numbers: their prototypes, and where each instance lies."""
