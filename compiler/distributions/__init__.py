"""Randomness keyed by name: streams, distributions and laws of size."""
