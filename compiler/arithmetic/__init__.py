"""Arithmetic that gives the same bits on every CPU of one architecture."""
