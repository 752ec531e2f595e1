"""Ground: materials merged over the terrain, and the mesh cut along their label lines."""
