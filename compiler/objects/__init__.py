"""Objects that are models from files: their prototypes, and single ones at given poses."""
