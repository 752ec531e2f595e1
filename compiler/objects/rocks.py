"""Meshes procedural rocks, each in a chain of levels of detail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.geometry.icosphere import EDGE, icosphere
from scenec.compiler.geometry.normals import vertex_normals
from scenec.compiler.geometry.rounding import rounding_of
from scenec.compiler.objects.creases import along_creases
from scenec.compiler.objects.deviation import deviation
from scenec.compiler.objects.families.shape import Shape
from scenec.compiler.scene.objects import Prototype
from scenec.schemas.kernels import kernel

#: The meshes of one shape, the finest first; each has a quarter of the triangles of the one before.
Chain = tuple[Prototype, ...]


def build_prototypes(shapes: Sequence[Shape]) -> tuple[Prototype, ...]:
    """The finest mesh of each shape: around the origin, its largest radius 1/2."""
    return tuple(_Rock(shape).finest(f"rock_{i:02d}") for i, shape in enumerate(shapes))


@memoized("prototypes")
def build_chains(shapes: Sequence[Shape], coarser: bool = True) -> tuple[Chain, ...]:
    """All levels of each shape, down to the icosahedron; or the finest only.

    Every level is a radius over the same directions about the same point, so that each is closed,
    manifold, and cannot meet itself; ``error`` says how far it is from the finest.
    """
    if not coarser:
        return tuple((mesh,) for mesh in build_prototypes(shapes))
    return tuple(_chain(shape, f"rock_{i:02d}") for i, shape in enumerate(shapes))


def _chain(shape: Shape, name: str) -> Chain:
    rock = _Rock(shape)
    finest = rock.finest(name)
    levels = [finest]
    for subdivisions in range(shape.subdivisions - 1, -1, -1):
        coarse = rock.level(subdivisions, f"{name}_{20 * 4**subdivisions}")
        error = deviation(
            finest.points.astype(np.float64),
            coarse.points.astype(np.float64),
            shape.subdivisions,
            subdivisions,
            rock.middle,
        )
        # Later levels are no better: a level that is would stand for this one, too.
        levels.append(replace(coarse, error=max(error, levels[-1].error)))
    return tuple(levels)


class _Rock:
    """A shape with the place and size that its finest mesh gives it."""

    def __init__(self, shape: Shape):
        self._shape = shape
        points, self._variation = self._points(shape.subdivisions)
        axes = np.array(shape.axes) / (points.max(axis=0) - points.min(axis=0))
        points = points * axes
        center = 0.5 * (points.min(axis=0) + points.max(axis=0))
        points = points - center
        size = 2.0 * np.sqrt((points * points).sum(axis=1).max())
        self._axes, self._center, self._size = axes, center, size
        self._finest = points / size
        #: Where the surface is star-shaped about, in the meshes' own frame.
        self.middle: NDArray[np.float64] = -center / size

    def _points(self, subdivisions: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        directions = along_creases(subdivisions, *self._shape.creases())
        radius, variation = self._shape.surface(directions, EDGE / 2**subdivisions)
        return directions * radius[:, None], variation

    def finest(self, name: str) -> Prototype:
        return _mesh(name, self._shape.subdivisions, self._finest, self._variation)

    def level(self, subdivisions: int, name: str) -> Prototype:
        """A coarser mesh, kept inside of the finest one's ball."""
        points, variation = self._points(subdivisions)
        points = (points * self._axes - self._center) / self._size
        _into_ball(points, self.middle)
        return _mesh(name, subdivisions, points, variation)


def _mesh(
    name: str, subdivisions: int, points: NDArray[np.float64], variation: NDArray[np.float64]
) -> Prototype:
    _, faces = icosphere(subdivisions)
    rounded = points.astype(np.float32)
    normals = vertex_normals(rounded.astype(np.float64), faces).astype(np.float32)
    return Prototype(
        name, rounded, faces, normals, variation.astype(np.float32), rounding=rounding_of(points)
    )


@kernel
def _into_ball(points: NDArray, middle: NDArray) -> None:
    """Draws what is farther than 1/2 from the origin toward the middle, as far as needed."""
    mx, my, mz = middle
    for n in range(len(points)):
        x, y, z = points[n]
        if x * x + y * y + z * z <= 0.25:
            continue
        x, y, z = x - mx, y - my, z - mz
        # |middle + s (point - middle)| = 1/2; the middle itself is inside.
        a = x * x + y * y + z * z
        b = x * mx + y * my + z * mz
        c = mx * mx + my * my + mz * mz - 0.25
        s = (np.sqrt(max(b * b - a * c, 0.0)) - b) / a
        points[n, 0] = mx + s * x
        points[n, 1] = my + s * y
        points[n, 2] = mz + s * z
