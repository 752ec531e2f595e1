"""Gathers what objects are placed among: the ground, cameras, objects laid before them."""

from __future__ import annotations

from collections.abc import Container
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.height_pyramid import HeightPyramid
from scenec.compiler.objects.lattice import Circles
from scenec.compiler.scene.objects import Placed, Scatter
from scenec.compiler.terrain.quantities import Quantities
from scenec.compiler.views.resolution import NO_VIEWS, Views


@dataclass
class PlacementContext:
    """Holds what a class of objects is placed among.

    Attributes:
        cameras: Where any camera is at any sample, float64 [c, 3], meters.
        views: What these see, for what of the ground's detail shows.
        unseen: Part that a pixel counts where no view shows an object.
        tolerance_px: What may show of the ground's error, pixels; None where its mesh is its grid.
        objects: Those laid before, by class.
        beyond: The same on the land up to so far beyond the terrain's border, by that distance.
    """

    surface: GroundSurface
    cameras: NDArray[np.float64]
    views: Views = NO_VIEWS
    unseen: float = 0.0
    tolerance_px: float | None = None
    objects: dict[str, Circles] = field(default_factory=dict)
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
        own.beyond = {}
        return own


def plan_circles(objects: Scatter | Placed) -> Circles:
    """One class in plan, circles as wide as its balls; single objects wherever they ever are."""
    at, radii = objects.balls()
    return Circles(np.ascontiguousarray(at[:, 0]), np.ascontiguousarray(at[:, 1]), radii)
