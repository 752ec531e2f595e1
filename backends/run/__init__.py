"""Renders: what is asked for, the frames of it, who makes them, where they are written."""
