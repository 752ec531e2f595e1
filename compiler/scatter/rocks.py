"""Procedural rocks: a faceted, worn block out of a sphere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.noise.lattice import subkey
from scenec.compiler.noise.perlin import fbm3
from scenec.compiler.scatter.icosphere import icosphere
from scenec.compiler.scene import Prototype


@dataclass(frozen=True)
class RockShape:
    """One rock prototype, all of it drawn.

    The surface is star-shaped: along direction d its radius is that of a convex block bounded by
    planes (a soft minimum over them, so that edges are worn), times 1 + bumpiness * noise(d).

    Attributes:
        key: Noise key.
        plane_normals: Unit normals of the block's planes, float64 [p, 3].
        plane_distances: Their distances from the center, float64 [p].
        axes: Scale along x, y, z, the longest being 1.
        angularity: 0 is rounded, 1 sharp-edged.
        bumpiness: Amplitude of the surface noise relative to the radius.
        subdivisions: Of the icosphere.
    """

    key: int
    plane_normals: NDArray[np.float64]
    plane_distances: NDArray[np.float64]
    axes: tuple[float, float, float]
    angularity: float
    bumpiness: float
    subdivisions: int


def build_prototypes(shapes: Sequence[RockShape]) -> tuple[Prototype, ...]:
    """Meshes of all shapes: each of diameter 1 (twice its largest radius), around its center."""
    return tuple(_build(shape, f"rock_{i:02d}") for i, shape in enumerate(shapes))


def _build(shape: RockShape, name: str) -> Prototype:
    directions, faces = icosphere(shape.subdivisions)
    radius, variation = _radii(
        np.uint64(shape.key),
        directions,
        shape.plane_normals,
        shape.plane_distances,
        shape.angularity,
        shape.bumpiness,
    )
    points = directions * radius[:, None] * np.array(shape.axes)[None, :]
    points -= 0.5 * (points.min(axis=0) + points.max(axis=0))
    points /= 2.0 * np.sqrt((points * points).sum(axis=1).max())
    points = points.astype(np.float32)
    normals = _vertex_normals(points.astype(np.float64), faces).astype(np.float32)
    return Prototype(name, points, faces, normals, variation.astype(np.float32))


@njit(cache=True, error_model="numpy")
def _radii(
    key: np.uint64,
    directions: NDArray,
    normals: NDArray,
    distances: NDArray,
    angularity: float,
    bumpiness: float,
) -> tuple[NDArray, NDArray]:
    # Exponent of the soft minimum: 4 gives a pebble, 40 a freshly broken block.
    sharpness = 4.0 + 36.0 * angularity * angularity
    radius = np.empty(len(directions))
    variation = np.empty(len(directions))
    shape_key = subkey(key, 1)
    color_key = subkey(key, 2)
    for n in range(len(directions)):
        x, y, z = directions[n]
        total = 0.0
        for p in range(len(distances)):
            facing = (normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z) / distances[p]
            if facing > 0.0:
                total += elementary.pow(facing, sharpness)
        block = elementary.pow(total, -1.0 / sharpness) if total > 0.0 else 1.0
        block = min(block, 1.25)
        bumps = fbm3(shape_key, 1.7 * x, 1.7 * y, 1.7 * z, 5, 0.52)
        # However bumpy, the surface stays well away from the center it is star-shaped about.
        radius[n] = block * max(1.0 + bumpiness * bumps, 0.25)
        color = fbm3(color_key, 2.3 * x, 2.3 * y, 2.3 * z, 4, 0.65)
        variation[n] = min(max(color, -1.0), 1.0)
    return radius, variation


@njit(cache=True, error_model="numpy")
def _vertex_normals(points: NDArray, faces: NDArray) -> NDArray:
    """Area-weighted unit normals at the vertices, float64 [n, 3]."""
    normals = np.zeros((len(points), 3))
    for f in range(len(faces)):
        a, b, c = faces[f]
        ux, uy, uz = (
            points[b, 0] - points[a, 0],
            points[b, 1] - points[a, 1],
            points[b, 2] - points[a, 2],
        )
        vx, vy, vz = (
            points[c, 0] - points[a, 0],
            points[c, 1] - points[a, 1],
            points[c, 2] - points[a, 2],
        )
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for v in (a, b, c):
            normals[v, 0] += nx
            normals[v, 1] += ny
            normals[v, 2] += nz
    for n in range(len(normals)):
        x, y, z = normals[n]
        length = np.sqrt(x * x + y * y + z * z)
        if length > 0.0:
            normals[n, 0] = x / length
            normals[n, 1] = y / length
            normals[n, 2] = z / length
        else:
            normals[n, 2] = 1.0
    return normals
