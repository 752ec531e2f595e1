"""Defines a surface that is a mesh: walls, overhangs and caves, which heights cannot hold."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.bisect import bisection
from scenec.compiler.geometry.normals import vertex_normals
from scenec.compiler.noise.perlin import fbm3
from scenec.compiler.terrain.grid import HeightField
from scenec.compiler.terrain.sources.mesh_plan import HAIR, PlanBins, see, top_at
from scenec.schemas.kernels import inlined, kernel


@dataclass(frozen=True)
class MeshSurface(HeightField):
    """A mesh, and as heights what is seen of it from above.

    What stands on a point of the plan stands on the topmost surface there; where the mesh is not,
    on the grid's heights, which go on beyond it.

    Attributes:
        points: float64 [n, 3], meters.
        faces: int32 [m, 3], counter-clockwise seen from outside.
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int32]

    @cached_property
    def bins(self) -> PlanBins:
        """Its faces by their place in plan."""
        return PlanBins.of(self.points, self.faces)

    @cached_property
    def vertex_normals(self) -> NDArray[np.float64]:
        """Unit normals, the faces' weighted by area, float64 [n, 3]."""
        return vertex_normals(self.points, self.faces)

    @property
    def flat(self) -> float:
        """Distance from an edge that counts as on it, meters."""
        return HAIR * min(self.grid.spacing_m)

    def height_at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height of the topmost surface at points: float64 [n] from two float64 [n], meters."""
        top = top_at(self.points, self.faces, self.bins, self.flat, x, y)
        return np.where(np.isfinite(top), top, super().height_at(x, y))

    def lifted(self, height: NDArray[np.float64]) -> MeshSurface:
        """The surface after relief: each vertex goes up as the heights above or below it do.

        What changed at (x, y), d = height - self.height, moves everything over (x, y) by the same:
        (x, y, z) -> (x, y, z + d(x, y)), a shear of space. It is one to one, so surfaces that did
        not cross do not cross afterwards, but for what a triangle misses of d between its
        vertices. It adds nothing to a vertical wall: that is what roughness is for.

        Args:
            height: Heights after the relief program, float64 [ny, nx].
        """
        change = HeightField(self.grid, height - self.height)
        x, y = (np.ascontiguousarray(self.points[:, axis]) for axis in (0, 1))
        points = self.points.copy()
        points[:, 2] += change.height_at(x, y)
        top = see(points, self.faces, self.frame(), self.grid.shape).top
        return MeshSurface(self.grid, np.where(np.isfinite(top), top, height), points, self.faces)


def subdivided(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    longest_m: float,
    max_triangles: int,
    size_m: tuple[float, float] = (np.inf, np.inf),
) -> tuple[NDArray[np.float64], NDArray[np.int32], float]:
    """A mesh of the same shape without long edges over the terrain: crack-free, by bisection.

    Args:
        points: float64 [n, 3].
        faces: int32 [m, 3].
        longest_m: No edge shall be longer.
        max_triangles: Budget; where it binds, edges stay longer.
        size_m: Of the terrain, around the origin; faces beyond it stay as large as they are.

    Returns:
        Points, faces, and the longest edge that is left over the terrain.
    """
    half = 0.5 * size_m[0], 0.5 * size_m[1]
    mesh = bisection(points, faces)
    limit = max(_longest_edge(points, mesh.faces, half), longest_m)
    done = points, mesh.faces.copy()
    while True:
        # Level by level, so that a budget that binds leaves triangles of about one size.
        while True:
            wanted = np.flatnonzero(_has_longer_edge(points, mesh.faces, half, limit))
            if not len(wanted):
                break
            halved = mesh.halve(wanted)
            if len(mesh.faces) > max_triangles:
                return *done, _longest_edge(*done, half)
            ends = points[mesh.edges[halved.middle_of]]
            points = np.concatenate([points, 0.5 * (ends[:, 0] + ends[:, 1])])
        done = points, mesh.faces[mesh.order]
        if limit <= longest_m:
            return *done, _longest_edge(*done, half)
        limit = max(longest_m, 0.7071067811865476 * limit)


def roughened(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    key: int,
    amplitude_m: float,
    scale_m: float,
    octaves: int,
    gain: float,
) -> NDArray[np.float64]:
    """Vertices moved along their normals by 3-D fBm, which shows on walls and ceilings too.

    Where the amplitude is larger than the surface's radius of curvature, it can cross itself.

    Args:
        key: Noise key.
        amplitude_m: Of the first octave, meters.
        scale_m: Size of the largest features, meters.
        octaves, gain: Of the noise; successive frequencies double.

    Returns:
        float64 [n, 3].
    """
    out = points.copy()
    normals = vertex_normals(points, faces)
    _roughen(out, normals, np.uint64(key), amplitude_m, scale_m, octaves, gain)
    return out


@kernel
def _roughen(points, normals, key, amplitude, scale, octaves, gain):  # type: ignore[no-untyped-def]
    for n in range(len(points)):
        x, y, z = points[n]
        move = amplitude * fbm3(key, x / scale, y / scale, z / scale, octaves, gain)
        for k in range(3):
            points[n, k] += move * normals[n, k]


@inlined
def _longest_square(points, a, b, c, half):  # type: ignore[no-untyped-def]
    """Square of a face's longest edge; 0 where it lies beyond the terrain."""
    for axis in range(2):
        low = min(points[a, axis], min(points[b, axis], points[c, axis]))
        high = max(points[a, axis], max(points[b, axis], points[c, axis]))
        if low > half[axis] or high < -half[axis]:
            return 0.0
    longest = 0.0
    for i, j in ((a, b), (b, c), (c, a)):
        total = 0.0
        for k in range(3):
            d = points[i, k] - points[j, k]
            total += d * d
        longest = max(longest, total)
    return longest


@kernel
def _longest_edge(points, faces, half):  # type: ignore[no-untyped-def]
    longest = 0.0
    for f in range(len(faces)):
        a, b, c = faces[f]
        longest = max(longest, _longest_square(points, a, b, c, half))
    return np.sqrt(longest)


@kernel
def _has_longer_edge(points, faces, half, limit):  # type: ignore[no-untyped-def]
    # A hair of slack: an edge of the limit's length is not longer for its rounding.
    square = limit * limit * (1.0 + 1e-9)
    out = np.zeros(len(faces), np.bool_)
    for f in range(len(faces)):
        a, b, c = faces[f]
        out[f] = _longest_square(points, a, b, c, half) > square
    return out
