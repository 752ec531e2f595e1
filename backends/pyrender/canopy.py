"""How much of the sky leaves and grass let through, on a coarse lattice of cells.

Of what transmits light, the area in each cell is summed up. Along a direction light is weakened as
by leaves that look in all directions (Beer and Lambert; Monsi and Saeki 1953): half of their area
is in the way, times sqrt(1 - s), where s is what they scatter (Goudriaan 1977). The mean over some
directions of the upper half is what is left of the sky in a cell. It is the same for all surfaces
there, and for the light of the ground about. Trunks and rocks hide nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.pyrender.ambience import mesh_bounds
from scenec.backends.pyrender.laws import even_albedo
from scenec.backends.stage.posing import moving
from scenec.backends.stage.scene import Mesh, RenderScene
from scenec.backends.surface.maps import map_mean
from scenec.backends.surface.pictures import has_maps
from scenec.schemas.kernels import kernel
from scenec.schemas.picture import luminance

#: Cells along x, y and z.
CELLS = (128, 128, 48)
#: Directions: bearings, and sines of elevations that stand for as much of the sky each.
_BEARINGS, _SINES = 8, (1.0 / 6.0, 0.5, 5.0 / 6.0)
#: Faces that stand for all of a mesh's, of all its rows together; and of a row at least.
_FACES, _FEWEST = 2_000_000, 8


@dataclass(frozen=True)
class Canopy:
    """What is left of the sky's light.

    Attributes:
        low: Least corner of the lattice, float64 [3].
        size: Its extent, float64 [3].
        open: Share of the sky, float32 [z, y, x].
    """

    low: NDArray[np.float64]
    size: NDArray[np.float64]
    open: NDArray[np.float32]


def make_canopy(scene: RenderScene) -> Canopy | None:
    """The canopy of a scene, or None where nothing in it transmits light; without what moves."""
    stands = ~moving(scene)
    sheets = []
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for index, mesh in enumerate(scene.meshes):
        to_world = scene.rows.to_world[(scene.rows.mesh == index) & stands]
        share = _dims(scene, mesh)
        if share > 0.0 and len(to_world) and len(mesh.faces):
            sheets.append((mesh, to_world, share))
            ends = mesh_bounds(mesh, to_world)
            low, high = np.minimum(low, ends[0]), np.maximum(high, ends[1])
    size = np.maximum(high - low, 1e-6)
    area = np.zeros(CELLS[::-1])
    for mesh, to_world, share in sheets:
        middles, areas = _faces(mesh, len(to_world))
        stretch = np.cbrt(np.abs(np.linalg.det(to_world[:, :, :3]))).mean()
        side = stretch * np.sqrt(np.median(areas) * len(areas) / len(mesh.faces))
        # Cloth that is larger than cells is no foliage.
        if side <= 2.0 * float((size / CELLS).max()):
            _spread(middles, areas, to_world, low, size, share, area)
    if not area.any():
        return None
    cell = size / CELLS
    depth = 0.5 * area / cell.prod()
    total = np.zeros(area.shape)
    for bearing in 2.0 * np.pi * (np.arange(_BEARINGS) + 0.5) / _BEARINGS:
        for sine in _SINES:
            slope = np.sqrt(1.0 - sine * sine) / sine * cell[2]
            shift = np.array([np.cos(bearing), np.sin(bearing)]) * slope / cell[:2]
            _weaken(depth, shift, cell[2] / sine, total)
    return Canopy(low, size, (total / (_BEARINGS * len(_SINES))).astype(np.float32))


def _dims(scene: RenderScene, mesh: Mesh) -> float:
    """By how much an area of a mesh's surfaces dims light, 0 where it is no sheet."""
    surfaces = [scene.surfaces[i] for i in mesh.layers]
    if not surfaces or not all(surface.transmits for surface in surfaces):
        return 0.0
    scatters = 0.0
    for surface in surfaces:
        color = even_albedo(surface).astype(float)
        if has_maps(surface.maps, "base_color"):
            assert surface.maps is not None
            color = color * map_mean(surface.maps, "base_color")
        scatters += float(luminance(color)) / len(surfaces)
    return float(np.sqrt(max(1.0 - scatters, 0.0)))


def _faces(mesh: Mesh, rows: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middles and areas of faces that stand for all of a mesh, float64 [n, 3] and [n]."""
    most = max(_FACES // rows, _FEWEST)
    faces = mesh.faces[:: -(-len(mesh.faces) // most) or 1]
    corners = mesh.points[faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.sqrt((across**2).sum(axis=1)) * (len(mesh.faces) / max(len(faces), 1))
    return corners.mean(axis=1), area


@kernel
def _spread(middles, areas, to_world, low, size, share, area):  # type: ignore[no-untyped-def]
    nz, ny, nx = area.shape
    for row in range(len(to_world)):
        m = to_world[row]
        # Rows turn, move and scale: as their volume does.
        volume = (
            m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
            - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
            + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
        )
        scale = share * abs(volume) ** (2.0 / 3.0)
        for f in range(len(middles)):
            x, y, z = middles[f]
            u = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3] - low[0]) / size[0] * nx
            v = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3] - low[1]) / size[1] * ny
            w = (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3] - low[2]) / size[2] * nz
            i = min(max(int(w), 0), nz - 1)
            j = min(max(int(v), 0), ny - 1)
            k = min(max(int(u), 0), nx - 1)
            area[i, j, k] += scale * areas[f]


@kernel
def _weaken(depth, shift, length, total):  # type: ignore[no-untyped-def]
    """Add what comes through along a direction, from the top cell by cell down.

    ``shift`` is how far the direction goes in x and y, in cells, while it rises by one; ``length``
    how long it is there, meters.
    """
    nz, ny, nx = depth.shape
    # At the middle of each cell of the layer above.
    before = np.zeros((ny, nx))
    here = np.zeros((ny, nx))
    parts = max(1, int(max(abs(shift[0]), abs(shift[1])) + 0.5))
    for layer in range(nz - 1, -1, -1):
        for j in range(ny):
            for k in range(nx):
                passes = 0.0
                # On the way to the middle of the layer above: this one, then that one.
                for part in range(parts):
                    along = (part + 0.5) / parts
                    y = int(j + along * shift[1] + 0.5)
                    x = int(k + along * shift[0] + 0.5)
                    z = layer if along < 0.5 else layer + 1
                    if 0 <= x < nx and 0 <= y < ny and z < nz:
                        passes += depth[z, y, x]
                passes *= length / parts
                y = j + shift[1]
                x = k + shift[0]
                if layer < nz - 1 and 0.0 <= x <= nx - 1.0 and 0.0 <= y <= ny - 1.0:
                    r = min(int(y), ny - 2)
                    c = min(int(x), nx - 2)
                    u = x - c
                    v = y - r
                    passes += (1.0 - v) * ((1.0 - u) * before[r, c] + u * before[r, c + 1])
                    passes += v * ((1.0 - u) * before[r + 1, c] + u * before[r + 1, c + 1])
                here[j, k] = passes
                total[layer, j, k] += np.exp(-passes)
        for j in range(ny):
            for k in range(nx):
                before[j, k] = here[j, k]
