"""Craters of a terrain as a table: what a stage tells of them, and maps of it."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class CraterTable:
    """Describes craters, oldest first: a younger one may lie over an older one.

    Attributes:
        x_m, y_m: Centers in the world, float64 [n]; those at the border may lie beyond it.
        diameter_m: From rim to rim, float32 [n].
        depth_m: Of the center below the rim as it lies there now, worn, float32 [n]; what younger
            craters and later operators did to it is not counted.
        age: From 0, now, to 1, when the surface was new, float32 [n]; NaN: nobody knows.
        wear: What is worn of it: kappa t / R**2 of the topographic diffusion since, float32 [n].
    """

    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    diameter_m: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    age: NDArray[np.float32]
    wear: NDArray[np.float32]

    @classmethod
    def joined(cls, tables: list[CraterTable]) -> CraterTable | None:
        """Puts tables after each other, the oldest first; None where there is no crater."""
        if not sum(len(table.x_m) for table in tables):
            return None
        names = [one.name for one in fields(cls)]
        return cls(*(np.concatenate([getattr(table, name) for table in tables]) for name in names))
