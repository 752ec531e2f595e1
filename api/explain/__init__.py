"""Explains a batch, or one thing in it: what was built and left out, with which errors."""
