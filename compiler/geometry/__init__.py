"""Poses, projections, meshes and voxels: geometry that knows nothing of scenes."""
