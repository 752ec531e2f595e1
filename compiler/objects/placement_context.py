"""Gathers what objects are placed among: the ground, cameras, objects laid before them."""

from __future__ import annotations

from collections.abc import Container, Sequence
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.rotations import turned
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.height_pyramid import HeightPyramid
from scenec.compiler.objects.lattice import Circles
from scenec.compiler.scene.objects import Placed, Prototype, Scatter
from scenec.compiler.terrain.quantities import Quantities
from scenec.compiler.views.resolution import NO_VIEWS, Views
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import POINTS, over_threads


@dataclass
class PlacementContext:
    """Holds what a class of objects is placed among.

    Attributes:
        cameras: Where any camera is at any sample, float64 [c, 3], meters.
        views: What these see, for what of the ground's detail shows.
        unseen: Part that a pixel counts where no view shows an object.
        tolerance_px: What may show of the ground's error, pixels; None where its mesh is its grid.
        objects: Those laid before, by class.
        footprints: Those of them that ``apart`` needs as wide as seen from above, by class.
        beyond: The same on the land up to so far beyond the terrain's border, by that distance.
    """

    surface: GroundSurface
    cameras: NDArray[np.float64]
    views: Views = NO_VIEWS
    unseen: float = 0.0
    tolerance_px: float | None = None
    objects: dict[str, Circles] = field(default_factory=dict)
    footprints: dict[str, Circles] = field(default_factory=dict)
    beyond: dict[float, PlacementContext] = field(default_factory=dict)

    def __post_init__(self) -> None:
        #: Of the relief.
        self.quantities = Quantities(self.surface.field.grid, self.surface.field.height)
        self._pyramids: list[HeightPyramid] = []

    def height_pyramid(self) -> HeightPyramid:
        """Bounds of the relief from above, made once."""
        if not self._pyramids:
            self._pyramids.append(HeightPyramid.of(self.surface.field))
        return self._pyramids[0]

    def only(self, names: Container[str], beyond_m: float = 0.0) -> PlacementContext:
        """The same with no other classes than some; what is computed once is shared.

        Args:
            beyond_m: Above 0 for those on the land so far beyond the border.
        """
        own = copy(self.beyond[beyond_m] if beyond_m else self)
        # What is placed does not heed it, and is not made again where it changes.
        own.tolerance_px = None
        own.objects = {name: self.objects[name] for name in self.objects if name in names}
        own.footprints, own.beyond = {}, {}
        return own


def plan_circles(objects: Scatter | Placed) -> Circles:
    """One class in plan, circles as wide as its balls; single objects wherever they ever are."""
    at, radii = objects.balls()
    return Circles(np.ascontiguousarray(at[:, 0]), np.ascontiguousarray(at[:, 1]), radii)


def footprints(objects: Scatter | Placed) -> Circles:
    """One class in plan, circles as wide as it is seen from above, otherwise as above."""
    each: NDArray[np.int32] = objects.prototype
    if isinstance(objects, Scatter):
        turns: NDArray[np.floating] = turned(objects.orientations, objects.scales)
    else:
        each = np.repeat(each, objects.to_world.shape[1])
        turns = objects.to_world[:, :, :, :3].reshape(-1, 3, 3)
    return plan_circles(objects)._replace(radius=footprint_radii(objects.prototypes, each, turns))


def footprint_radii(
    prototypes: Sequence[Prototype], prototype: NDArray[np.int32], turns: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Returns radii of the circles about objects' origins that hold them as seen from above.

    Args:
        prototype: Of each object, int32 [n].
        turns: From the prototypes' axes to the world's, scale included, [n, 3, 3].

    Returns:
        Meters, float64 [n].
    """
    points = [p.points.astype(np.float64) for p in prototypes]
    reach = [(p * p).sum(axis=1) for p in points]
    # The farthest first: few others have to be looked at.
    order = [np.argsort(-each, kind="stable") for each in reach]
    offsets = np.cumsum([0] + [len(p) for p in points])
    out = np.zeros(len(prototype))
    if len(out):
        points, reach = ([a[at] for a, at in zip(of, order, strict=True)] for of in (points, reach))
        of = (np.concatenate(points), np.concatenate(reach), offsets, prototype, turns)
        over_threads(_footprints_part, len(out), *of, out, least=POINTS)
    return out


@kernel
def _footprints_part(first, last, points, reach, offsets, prototype, turns, out):  # type: ignore[no-untyped-def]
    for n in range(first, last):
        turn, stretch = turns[n], 0.0
        for k in range(3):
            column = turn[0, k] * turn[0, k] + turn[1, k] * turn[1, k] + turn[2, k] * turn[2, k]
            stretch = max(stretch, column)
        widest = 0.0
        for p in range(offsets[prototype[n]], offsets[prototype[n] + 1]):
            if stretch * reach[p] <= widest:
                break
            a, b, c = points[p]
            x = turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c
            y = turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c
            widest = max(widest, x * x + y * y)
        out[n] = np.sqrt(widest)
