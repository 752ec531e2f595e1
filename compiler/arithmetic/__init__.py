"""Computes elementary functions with the same bits on every CPU of one architecture."""
