"""Draws a Plan from a Spec and a seed; after that nothing is random."""
