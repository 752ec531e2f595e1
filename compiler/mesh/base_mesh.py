"""Takes the ground's mesh, uncut, where the surface is a mesh itself."""

from __future__ import annotations

import numpy as np

from scenec.compiler.mesh.cut import CutMesh
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface


def base_mesh(surface: MeshSurface) -> CutMesh:
    """The surface's triangles, in the order of the grid cells that their middles lie over.

    What lies beyond the terrain's rectangle counts to the cells at its border.
    """
    x0, y0, dx, dy = surface.frame()
    rows, columns = (n - 1 for n in surface.grid.shape)
    middle = surface.points[surface.faces, :2].mean(axis=1)
    # Clipped as floats: far outside they must not overflow an index.
    column = np.clip((middle[:, 0] - x0) / dx, 0, columns - 1).astype(np.int32)
    row = np.clip((middle[:, 1] - y0) / dy, 0, rows - 1).astype(np.int32)
    cell = row * columns + column
    order = np.argsort(cell, kind="stable")
    vertices = np.arange(len(surface.points), dtype=np.int32)
    return CutMesh(
        points=surface.points,
        faces=surface.faces[order],
        parents=np.stack([vertices, vertices], axis=1),
        fraction=np.zeros(len(vertices)),
        cell=cell[order],
        above=np.zeros((0, len(order)), bool),
        normals=surface.vertex_normals,
    )
