"""Lists the craters that a grid shows, for the stage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.crater_profile import height_at, profile_table
from scenec.compiler.terrain.operators.craters import Craters, resolved_on
from scenec.schemas.craters import CraterTable


def list_craters(
    craters: Craters, grid: Grid, weight: NDArray[np.float64] | None = None
) -> CraterTable:
    """Describes those that a grid shows and whose bowls reach it.

    Depths are those of ``crater_profile``, from the outline down to the center.

    Args:
        craters: What is laid.
        grid: Of the terrain.
        weight: The mask, float64 [ny, nx]: depths are multiplied by its value at the centers, and
            craters are left out where that is 0. None: there is none.
    """
    reach = 0.5 * (np.array(grid.size_m)[:, None] + craters.diameter_m)
    near = (np.abs(craters.x_m) <= reach[0]) & (np.abs(craters.y_m) <= reach[1])
    shown = np.flatnonzero(resolved_on(craters, grid) & near)
    left = np.ones(len(shown))
    if weight is not None:
        half = 0.5 * np.array(grid.size_m)
        x = np.clip(craters.x_m[shown], -half[0], half[0])
        y = np.clip(craters.y_m[shown], -half[1], half[1])
        left = HeightField(grid, weight).height_at(x, y)
        shown, left = shown[left > 0.0], left[left > 0.0]
    diameter, state = craters.diameter_m[shown], craters.state[shown]
    table = profile_table(float(state.max(initial=0.0)))
    rim, bowl = (
        np.array([height_at(row, 1.0) - height_at(row, 0.0) for row in rows])
        for rows in (table.rim, table.depth)
    )
    depth = craters.rim_ratio[shown] * np.interp(state, table.states, rim)
    depth -= craters.depth_ratio[shown] * np.interp(state, table.states, bowl)
    age = np.full(len(shown), np.nan) if craters.age is None else craters.age[shown]
    columns = diameter, left * diameter * depth, age, state
    return CraterTable(
        craters.x_m[shown], craters.y_m[shown], *(of.astype(np.float32) for of in columns)
    )
