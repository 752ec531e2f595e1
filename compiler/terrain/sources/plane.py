"""Begins with a plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Applied, Grid


@dataclass(frozen=True)
class Plane:
    """z = height_m + slope[0] * x + slope[1] * y.

    Attributes:
        height_m: Height at the terrain's center.
        slope: dz/dx and dz/dy.
    """

    height_m: float
    slope: tuple[float, float]

    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """The plane added to the heights (exact up to rounding)."""
        plane = (
            self.height_m + self.slope[0] * grid.x()[None, :] + self.slope[1] * grid.y()[:, None]
        )
        return height + plane, {}
