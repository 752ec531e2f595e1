"""Draws numbers: streams keyed by name, distributions and laws of size."""
