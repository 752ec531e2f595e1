"""Defines what a family of rocks answers, and shares what they have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.noise.lattice import subkeys
from scenec.schemas.kernels import Kernel, inlined, kernel

#: However bumpy, a surface stays this far from the center that it is star-shaped about.
LEAST = 0.25

#: Of prototypes, int32 [n], and uniform numbers, [n, 3]: turns about the vertical, in whole ones.
Turn = Callable[[NDArray[np.int32], NDArray[np.float64]], NDArray[np.float64]]


class Usual(NamedTuple):
    """Holds a family's proportions and wear where the cfg says nothing.

    Fragments have axes of about 2 : sqrt(2) : 1, whatever broke them (Michikami et al. 2010 on
    Itokawa, Eros and in the laboratory; 2022 on Ryugu). What rolls loses its corners before its
    proportions; slabs come from between bedding planes; the rest is judgment.
    """

    elongation: float
    flatness: float
    wear: float


@dataclass(frozen=True)
class Shape(ABC):
    """One rock, all of it drawn.

    The surface is ``radius(d) * d`` for every direction d, stretched along x, y, z.

    Attributes:
        bumpiness: Height of its roughness, in radii.
        axes: Extents of the finest mesh along x, y, z, the largest being 1.
        subdivisions: Of the icosphere, in the finest mesh.
    """

    key: int
    bumpiness: float
    axes: tuple[float, float, float]
    subdivisions: int
    USUAL: ClassVar[Usual] = Usual(0.25, 0.4, 0.3)
    #: The key that says how worn they are: wear or angularity.
    READS: ClassVar[str] = "wear"
    #: Whether they lie as they have formed or broken, where the cfg does not say otherwise.
    LIES: ClassVar[bool] = False

    @classmethod
    def turn(cls, shapes: Sequence[Shape], context: Context) -> Turn | None:
        """Returns how those of a class stand that are not turned at random; None: in any way."""
        return None

    def creases(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Unit normals [p, 3] and distances [p] of the planes that meet in sharp edges."""
        return np.zeros((0, 3)), np.zeros(0)

    @abstractmethod
    def surface(
        self, directions: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Radii and albedo variation (in [-1, 1]) in some directions.

        Args:
            directions: Unit vectors, float64 [n, 3].
            spacing: Angle between neighboring directions; what is too fine for it is left out.
        """


class Fine(NamedTuple):
    """Holds how rough a rock is, and how much of that a mesh can show.

    Attributes:
        spacing: Step of the mesh in radians.
        waves, grains, marks: Octaves of the family's ``noises`` that the mesh has room for.
    """

    bumpiness: float
    spacing: float
    waves: int
    grains: int
    marks: int


@dataclass(frozen=True)
class Carved[T: tuple[Any, ...]](Shape):
    """A rock whose surface a kernel makes.

    Attributes:
        drawn: All that is drawn of it beside what ``Shape`` has, as the kernel takes it.
        sample: The kernel over all directions, see ``sampling``.
        noises: Of the family's ``Fine.waves``, ``grains`` and ``marks`` the first frequency, in
            waves a radius, and the most octaves.
    """

    drawn: T
    sample: ClassVar[Kernel]
    noises: ClassVar[tuple[tuple[float, int], ...]]

    @staticmethod
    @abstractmethod
    def draw(path: str, streams: Streams, wear: float) -> T:
        """Returns what is drawn of one from the streams of a path.

        Args:
            wear: From 0, freshly broken, to 1.
        """

    def surface(
        self, directions: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns radii and variation in directions: see ``Shape``."""
        counts = [octaves(frequency, spacing, most) for frequency, most in self.noises]
        fine = Fine(self.bumpiness, spacing, *counts, *[0] * (3 - len(counts)))
        radius, variation = self.sample(np.uint64(self.key), directions, self.for_mesh(fine), fine)
        return radius, variation

    def for_mesh(self, fine: Fine) -> T:
        """Returns the parameters that the kernel takes for a mesh."""
        return self.drawn


def sampling(at: Kernel) -> Kernel:
    """The loop over directions: a kernel of (key, directions, rock, fine), see ``Carved.surface``.

    Args:
        at: Of (keys, rock, fine, x, y, z), a unit vector: radius and albedo variation there.
            ``keys`` are those of the rock's noises, ``rock`` is what the family has drawn.
    """

    @kernel
    def surface(key, directions, rock, fine):  # type: ignore[no-untyped-def]
        keys = subkeys(key, 6)
        radius = np.empty(len(directions))
        variation = np.empty(len(directions))
        for n in range(len(directions)):
            x, y, z = directions[n]
            radius[n], tone = at(keys, rock, fine, x, y, z)
            variation[n] = min(max(tone, -1.0), 1.0)
        return radius, variation

    assert isinstance(surface, Kernel)
    return surface


def octaves(frequency: float, spacing: float, most: int) -> int:
    """Counts the octaves of a noise with waves of at least two steps of a mesh; 0 to ``most``.

    Args:
        frequency: Of the first, in waves a radius.
        spacing: Step of the mesh in radians.
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


@inlined
def rough(bumpiness, bumps):  # type: ignore[no-untyped-def]
    """Factor on a radius: the center stays inside, however deep the bumps are."""
    return max(1.0 + bumpiness * bumps, LEAST)


@inlined
def ball_along(x, y, z, cx, cy, cz, radius):  # type: ignore[no-untyped-def]
    """Intersects a ray from the center with a ball: middle along the ray, half the chord squared.

    The square is below 0 where the ray misses.
    """
    along = cx * x + cy * y + cz * z
    return along, along * along - (cx * cx + cy * cy + cz * cz) + radius * radius


@inlined
def bowl(scar, x, y, z, h):  # type: ignore[no-untyped-def]
    """Inverse radius of the bowl that a ball leaves in a rock, or 0 where there is none.

    Args:
        scar: Center and radius of the ball, float64 [4].
        x, y, z: Unit direction.
        h: Inverse radius of the rock without it.
    """
    cx, cy, cz, size = scar
    along, square = ball_along(x, y, z, cx, cy, cz, size)
    if along <= 0.0 or square <= 0.0:
        return 0.0
    # Nothing is taken where the ray only touches the ball: no wall behind a bowl's rim.
    return 1.0 / max(along - np.sqrt(square), (1.0 - 0.3 * square / (size * size)) / h)


@kernel
def bowls(normals, distances, scars):  # type: ignore[no-untyped-def]
    """Centers and radii of balls that scar a block, float64 [s, 4].

    Args:
        normals, distances: Of the block's planes.
        scars: Unit directions of the bowls, their radii and depths, float64 [s, 5].
    """
    out = np.empty((len(scars), 4))
    for s in range(len(scars)):
        h, _plane, _gap = block(normals, distances, scars[s, 0], scars[s, 1], scars[s, 2], 0.0)
        out[s, :3] = scars[s, :3] * (1.0 / h - scars[s, 4] + scars[s, 3])
        out[s, 3] = scars[s, 3]
    return out
