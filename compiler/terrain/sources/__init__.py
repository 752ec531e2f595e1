"""Where a relief begins: planes, measured height fields, meshes."""
