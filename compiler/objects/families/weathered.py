"""Weathered rocks: faceted, worn blocks out of a sphere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.noise.lattice import subkey
from scenec.compiler.noise.perlin import fbm3
from scenec.compiler.objects.families.shape import LEAST
from scenec.schemas.kernels import kernel


@dataclass(frozen=True)
class Weathered:
    """A convex block bounded by planes (a soft minimum over them), times 1 + bumpiness * noise.

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
    fits_axes: bool = False

    def creases(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """None: all edges are worn."""
        return np.zeros((0, 3)), np.zeros(0)

    def surface(
        self, directions: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As of ``Shape``; coarser meshes share the finest one's vertices."""
        return _surface(
            np.uint64(self.key),
            directions,
            self.plane_normals,
            self.plane_distances,
            self.angularity,
            self.bumpiness,
        )


@kernel
def _surface(
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
        radius[n] = block * max(1.0 + bumpiness * bumps, LEAST)
        color = fbm3(color_key, 2.3 * x, 2.3 * y, 2.3 * z, 4, 0.65)
        variation[n] = min(max(color, -1.0), 1.0)
    return radius, variation
