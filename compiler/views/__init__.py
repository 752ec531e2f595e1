"""Passes over the Scene: what no camera of the batch can notice is left out, and said."""
