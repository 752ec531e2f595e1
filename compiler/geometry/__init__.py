"""Computes with poses, lenses, triangles and voxels: geometry that knows nothing of scenes."""
