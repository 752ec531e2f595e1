"""Foreign USD stages: their meshes as ground and objects, light and cameras varied."""
