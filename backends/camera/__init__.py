"""Rays of pixels: lenses, shutters."""
