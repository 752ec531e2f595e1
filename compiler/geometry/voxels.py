"""Voxelizes a mesh: whatever lies in it lies in a voxel, hollows included.

A cube is full where a triangle touches it (separating axes, Akenine-Möller 2001), or where
triangles are above it and to all four sides: inside of a rock. Not below it: scanned boulders are
open where they lie on the ground. So the cubes hold the mesh, and reach beyond it by less than
their diagonal, but for its hollows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel

#: Points, [n, 3], and faces, [m, 3], of a mesh.
type Mesh = tuple[NDArray[np.float32], NDArray[np.int32]]

#: Cubes along the longest axis of what points are held against.
_CUBES: Final = 48


@dataclass(frozen=True)
class Voxels:
    """Cubes that hold a mesh, in its own frame.

    Attributes:
        corner: Least corner of the first cube, float64 [3].
        side: Of a cube.
        full: bool [nx, ny, nz].
    """

    corner: NDArray[np.float64]
    side: float
    full: NDArray[np.bool_]

    def middles(self) -> NDArray[np.float64]:
        """Returns the middles of the full cubes, float64 [n, 3]."""
        return self.corner + self.side * (np.argwhere(self.full) + 0.5)


def voxels_of(mesh: Mesh, side: float, most: int) -> Voxels:
    """The cubes of a mesh.

    Args:
        mesh: With one triangle or more.
        most: Cubes along the longest axis at most: the side is longer where it has to be.
    """
    points = mesh[0].astype(np.float64)
    low = points.min(axis=0)
    extent = points.max(axis=0) - low
    # Never 0: a mesh may be a point.
    side = max(side, float(extent.max()) / most, 1e-9)
    counts = np.floor(extent / side).astype(np.int64) + 1
    # As much is left on both sides.
    corner = low - 0.5 * (counts * side - extent)
    full = np.zeros(tuple(counts.tolist()), np.bool_)
    _touch((points - corner) / side, mesh[1], full)
    return Voxels(corner, side, _with_hollows(full))


@kernel
def _touch(points, faces, full):  # type: ignore[no-untyped-def]
    """Marks the unit cubes that triangles touch."""
    # Wider than arithmetic errs.
    half = 0.5 + 1e-9
    edge = np.empty((3, 3))
    at = np.empty((3, 3))
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for f in range(len(faces)):
        for k in range(3):
            low = min(points[faces[f, 0], k], points[faces[f, 1], k], points[faces[f, 2], k])
            high = max(points[faces[f, 0], k], points[faces[f, 1], k], points[faces[f, 2], k])
            first[k] = max(int(np.floor(low - 1e-9)), 0)
            last[k] = min(int(np.floor(high + 1e-9)), full.shape[k] - 1)
            for i in range(3):
                edge[i, k] = points[faces[f, (i + 1) % 3], k] - points[faces[f, i], k]
        for x in range(first[0], last[0] + 1):
            for y in range(first[1], last[1] + 1):
                for z in range(first[2], last[2] + 1):
                    if full[x, y, z]:
                        continue
                    for i in range(3):
                        at[i, 0] = points[faces[f, i], 0] - x - 0.5
                        at[i, 1] = points[faces[f, i], 1] - y - 0.5
                        at[i, 2] = points[faces[f, i], 2] - z - 0.5
                    full[x, y, z] = _meets(at, edge, half)


@kernel
def _meets(at, edge, half):  # type: ignore[no-untyped-def]
    """Whether no normal of the triangle, and no product of its edges with axes, parts them."""
    nx = edge[0, 1] * edge[1, 2] - edge[0, 2] * edge[1, 1]
    ny = edge[0, 2] * edge[1, 0] - edge[0, 0] * edge[1, 2]
    nz = edge[0, 0] * edge[1, 1] - edge[0, 1] * edge[1, 0]
    away = nx * at[0, 0] + ny * at[0, 1] + nz * at[0, 2]
    if abs(away) > half * (abs(nx) + abs(ny) + abs(nz)):
        return False
    for i in range(3):
        for axis in range(3):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            low, high = np.inf, -np.inf
            for v in range(3):
                value = edge[i, a] * at[v, b] - edge[i, b] * at[v, a]
                low, high = min(low, value), max(high, value)
            reach = half * (abs(edge[i, a]) + abs(edge[i, b]))
            if low > reach or high < -reach:
                return False
    return True


def _with_hollows(touched: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The cubes that are touched, and those with such ones above and to all four sides of them."""
    covered = np.logical_or.accumulate(touched[:, :, ::-1], axis=2)[:, :, ::-1]
    for axis in range(2):
        covered &= np.logical_or.accumulate(touched, axis=axis)
        back = np.flip(np.logical_or.accumulate(np.flip(touched, axis), axis=axis), axis)
        covered &= back
    return np.ascontiguousarray(covered | touched)


class Cubes:
    """The cubes of some meshes, each made when it is first asked for."""

    def __init__(self, meshes: Sequence[Mesh]):
        self._meshes = meshes
        self._made: dict[int, Voxels] = {}

    def near(
        self,
        mesh: NDArray[np.int32],
        middle: NDArray[np.float64],
        turn: NDArray[np.float32],
        radius: NDArray[np.float64],
        reach_m: float,
        points: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Returns which instances contain any of some points, or are within ``reach_m``, bool [n].

        Args:
            mesh: Of each instance, [n].
            middle: Their positions, [n, 3].
            turn: From their axes to the world's with one scale, [n, 3, 3].
            radius: Of the balls around ``middle`` outside which no point counts, [n].
            reach_m: 0 or more.
            points: By rising x, [m, 3].
        """
        found = np.zeros(len(middle), np.bool_)
        for k in np.unique(mesh).tolist():
            if k not in self._made:
                self._made[k] = voxels_of(self._meshes[k], 0.0, _CUBES)
            own, cubes = np.flatnonzero(mesh == k), self._made[k]
            found[own] = _near_any(
                middle[own], turn[own], radius[own], reach_m, points,
                cubes.corner, cubes.side, cubes.full,
            )  # fmt: skip
        return found


@kernel
def _near_any(middle, turn, radius, reach, points, corner, side, full):  # type: ignore[no-untyped-def]
    out = np.zeros(len(middle), np.bool_)
    for n in range(len(middle)):
        r = turn[n].astype(np.float64)
        square = r[0, 0] * r[0, 0] + r[1, 0] * r[1, 0] + r[2, 0] * r[2, 0]
        # What float32 rotations are off by is added.
        near = (reach + 1e-6 * radius[n]) / np.sqrt(square)
        k = np.searchsorted(points[:, 0], middle[n, 0] - radius[n])
        while k < len(points) and points[k, 0] <= middle[n, 0] + radius[n]:
            dx, dy = points[k, 0] - middle[n, 0], points[k, 1] - middle[n, 1]
            dz = points[k, 2] - middle[n, 2]
            k += 1
            if dx * dx + dy * dy + dz * dz >= radius[n] * radius[n]:
                continue
            x = (r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz) / square
            y = (r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz) / square
            z = (r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz) / square
            if _near_cubes(corner, side, full, x, y, z, near):
                out[n] = True
                break
    return out


@kernel
def _near_cubes(corner, side, full, x, y, z, reach):  # type: ignore[no-untyped-def]
    """Whether a point in a mesh's frame lies in one of its cubes or within ``reach`` of one."""
    nx, ny, nz = full.shape
    i0 = max(int(np.floor((x - reach - corner[0]) / side)), 0)
    i1 = min(int(np.floor((x + reach - corner[0]) / side)), nx - 1)
    j0 = max(int(np.floor((y - reach - corner[1]) / side)), 0)
    j1 = min(int(np.floor((y + reach - corner[1]) / side)), ny - 1)
    k0 = max(int(np.floor((z - reach - corner[2]) / side)), 0)
    k1 = min(int(np.floor((z + reach - corner[2]) / side)), nz - 1)
    for i in range(i0, i1 + 1):
        dx = max(corner[0] + i * side - x, x - corner[0] - (i + 1) * side, 0.0)
        for j in range(j0, j1 + 1):
            dy = max(corner[1] + j * side - y, y - corner[1] - (j + 1) * side, 0.0)
            for k in range(k0, k1 + 1):
                if full[i, j, k]:
                    dz = max(corner[2] + k * side - z, z - corner[2] - (k + 1) * side, 0.0)
                    if dx * dx + dy * dy + dz * dz <= reach * reach:
                        return True
    return False
