"""Begins with a plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.kinds import bounded, forms, key, list_of
from scenec.compiler.terrain.grid import Applied, Grid


@dataclass(frozen=True)
class Plane:
    """A flat or inclined plane.

    A base.

    Note: z = height_m + slope[0] * x + slope[1] * y.
    """

    EXAMPLE: ClassVar = {"type": "plane", "slope": [0.05, 0]}

    height_m: float = key(
        forms.LENGTH_PER_BATCH, default=0, at_least=-1_000_000_000, at_most=1_000_000_000
    )
    """Height at the terrain's center."""
    slope: tuple[float, float] = key(
        list_of(
            bounded(forms.PER_BATCH, at_least=-1_000_000, at_most=1_000_000),
            "Rise over run along one axis.",
            least=2,
            most=2,
        ),
        default=[0, 0],
    )
    """dz/dx and dz/dy."""

    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """The plane added to the heights (exact up to rounding)."""
        plane = (
            self.height_m + self.slope[0] * grid.x()[None, :] + self.slope[1] * grid.y()[:, None]
        )
        return height + plane, {}
