"""Defines what a batch is made of: the Plan (every number drawn) and the Scene (arrays)."""
