"""Begins a relief: planes, measured height fields, meshes."""
