"""What a family of rocks answers, and what the families share."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas.kernels import inlined, kernel

#: However bumpy, a surface stays this far from the center that it is star-shaped about.
LEAST = 0.25


class Shape(Protocol):
    """One rock, all of it drawn.

    The surface is ``radius(d) * d`` for every direction d, stretched along x, y, z.
    """

    @property
    def subdivisions(self) -> int:
        """Of the icosphere, in the finest mesh."""

    @property
    def axes(self) -> tuple[float, float, float]:
        """Extents along x, y, z, the largest being 1."""

    @property
    def fits_axes(self) -> bool:
        """Whether the finest mesh has those extents; otherwise they stretch what it has."""

    def creases(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Unit normals [p, 3] and distances [p] of the planes that meet in sharp edges."""

    def surface(
        self, directions: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Radii and albedo variation (in [-1, 1]) in some directions.

        Args:
            directions: Unit vectors, float64 [n, 3].
            spacing: Angle between neighboring directions; what is too fine for it is left out.
        """


def octaves(frequency: float, spacing: float, most: int) -> int:
    """How many octaves of a noise have waves of at least two steps of a mesh; 0 to ``most``.

    Args:
        frequency: Of the first, in waves a radius.
        spacing: Step of the mesh in radians.
        most: Not more than these.
    """
    count = 0
    while count < most and 2.0 * frequency * spacing <= 1.0:
        count += 1
        frequency *= 2.0
    return count


def unit_vectors(u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions uniform over the sphere, float64 [n, 3], from uniform numbers [n, 2]."""
    up = 2.0 * u[:, 0] - 1.0
    level = np.sqrt(np.maximum(1.0 - up * up, 0.0))
    bearing = 2.0 * elementary.PI * u[:, 1]
    return np.stack(
        [level * elementary.cos_array(bearing), level * elementary.sin_array(bearing), up], axis=1
    )


@inlined
def smooth_max(a: float, b: float, width: float) -> float:
    """The larger of two; where they are closer than ``width``, a parabola joins them."""
    gap = a - b if a > b else b - a
    top = a if a > b else b
    if gap >= width:
        return top
    return top + (width - gap) * (width - gap) / (4.0 * width)


@kernel
def block(
    normals: NDArray, distances: NDArray, x: float, y: float, z: float, width: float
) -> tuple[float, int, float]:
    """Inverse radius of a convex block with worn edges, in the direction (x, y, z).

    Args:
        normals, distances: Of its planes.
        x, y, z: Unit vector.
        width: How far the wear of an edge reaches, in inverse radii.

    Returns:
        1 / radius, the plane that is met first, and how much farther away the next one is (in
        inverse radii): near 0 at an edge.
    """
    first, second, third = 0.0, 0.0, 0.0
    plane = -1
    for p in range(len(distances)):
        h = (normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z) / distances[p]
        if h > first:
            third = second
            second = first
            first = h
            plane = p
        elif h > second:
            third = second
            second = h
        elif h > third:
            third = h
    top = first
    if width > 0.0:
        top = smooth_max(smooth_max(first, second, width), third, width)
    return top, plane, first - second
