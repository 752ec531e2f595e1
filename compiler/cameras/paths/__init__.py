"""Motions that are made and not given: one module each."""
