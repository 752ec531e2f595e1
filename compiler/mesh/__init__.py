"""Merges materials over the terrain, and makes the mesh cut along their label lines."""
