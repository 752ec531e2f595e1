"""What the ground of a stage is to the vehicle that its cameras ride on, for pages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scenec.backends.stage.scene import RenderScene
from scenec.datasets.view.site import Site
from scenec.schemas.errors import OutputError
from scenec.schemas.site_map import MapGrid, MapOptions
from scenec.schemas.vehicle import Vehicle

if TYPE_CHECKING:
    from scenec.backends.exact import ExactCaster


def site_of(scene: RenderScene, cells: int, caster: ExactCaster | None = None) -> Site | None:
    """Maps a stage at its first sample for the first vehicle that a camera names, or the default.

    Args:
        scene: The stage.
        cells: Most along its longer side. Classes are left out where these are too coarse for them.
        caster: Of the stage, where somebody has one; it is posed.

    Returns:
        None where there is no ground.
    """
    # Casting costs numba: only where it is done.
    from scenec.backends.annotation.overhead import map_tile
    from scenec.backends.annotation.overhead_tables import ground_area
    from scenec.backends.exact import ExactCaster

    west, south, east, north = area = ground_area(scene)
    if not (west < east and south < north):
        return None
    vehicle = scene.vehicle or Vehicle()
    cell = max(vehicle.cell_m, max(east - west, north - south) / cells)
    layers: tuple[str, ...] = ("height", "slope", "traversability")
    try:
        options = MapOptions(cell_m=cell, vehicle=vehicle, layers=layers)
    except OutputError:
        layers = layers[:2]
        options = MapOptions(cell_m=cell, vehicle=vehicle, layers=layers)
    grid = MapGrid.over(area, cell)
    made = map_tile(scene, caster or ExactCaster(scene, trees=False), grid, (0, 0), options, layers)
    # Rows run south there.
    up = {name: np.ascontiguousarray(values[::-1]) for name, values in made.items()}
    corner = grid.west + 0.5 * cell, grid.north - (grid.height - 0.5) * cell
    return Site(
        corner, cell, up["height"], up["slope"], up.get("traversability"), vehicle,
        scene.georeference,
    )  # fmt: skip
