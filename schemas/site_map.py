"""Orthographic maps of a stage: what ``scenec export --format map`` is asked, and what it holds.

Cells are squares along the world's x and y. Row 0 is the northern one, as GIS has it; a cell's
value is that of the first surface straight below its center.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import OutputError
from scenec.schemas.georeference import Georeference
from scenec.schemas.spelling import nearest
from scenec.schemas.vehicle import TRAVERSABILITY, Vehicle

#: Layers by name -> unit and what they are; a label level's is ``label_<level>``.
LAYERS = {
    "height": ("m", "height of the first surface below, z of the stage"),
    "slope": ("degrees", "of that face's plane"),
    "tilt": ("degrees", "of the plane that fits the heights under the vehicle"),
    "roughness": ("m", "root mean square distance of the heights under the vehicle from the plane"),
    "step": ("m", "largest difference of heights within a wheel's diameter, under the vehicle"),
    "obstacle": ("m", "largest height above the plane under the vehicle"),
    "traversability": (
        "",
        ", ".join(f"{number} {name}" for number, name in enumerate(TRAVERSABILITY)),
    ),
    "label": ("", "ids of labels, one layer a level; 0 is none"),
    "instance": ("", "ids of instances; 0 is none"),
    "sun": ("", "share of the brightest sun's disc that shines on the surface, 0 to 1"),
}
#: Layers of the ground under a vehicle.
UNDER_VEHICLE = ("tilt", "roughness", "step", "obstacle", "traversability")
#: More cells than that are a slip.
MOST_CELLS = 4_000_000_000
#: Cells along the side of a tile: what is in memory at once.
TILE = 1024


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """Describes the maps that are asked for.

    Attributes:
        cell_m: Side of a cell; None: ``Vehicle.cell_m``.
        area_m: West, south, east and north border; None: the ground, without its horizon.
        sample: Time code at which things and the sun stand where they are.
        sun_rays: Rays over the sun's disc at each place; 1 is its center.
        layers: Names of ``LAYERS``.
        vehicle: Whom traversability is for; None: the first that a camera of the stage names, or
            the default one.
        changes: What is another in that one, by its fields.
    """

    cell_m: float | None = None
    area_m: tuple[float, float, float, float] | None = None
    sample: int = 0
    sun_rays: int = 1
    layers: tuple[str, ...] = tuple(LAYERS)
    vehicle: Vehicle | None = None
    changes: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Checks its values.

        Raises:
            OutputError: One makes no sense.
        """
        for name in self.layers:
            if name not in LAYERS:
                raise OutputError(f"layers: no layer {name!r}{nearest(name, LAYERS)}")
        if not 1 <= self.sun_rays <= 4096:
            raise OutputError(f"sun_rays={self.sun_rays}: expected a number from 1 to 4096")
        if not self.cell > 0.0:
            raise OutputError(f"cell_m={self.cell:g}: expected a number above 0")
        vehicle = self.for_vehicle()
        if self.vehicle is not None and set(self.layers) & set(UNDER_VEHICLE):
            vehicle.disc(self.cell)

    @property
    def cell(self) -> float:
        """Side of a cell, meters."""
        return self.for_vehicle().cell_m if self.cell_m is None else self.cell_m

    def for_vehicle(self, named: Vehicle | None = None) -> Vehicle:
        """Returns whom traversability is for, on a stage that names one or none.

        Raises:
            OutputError: One of the changes makes no sense.
        """
        return self.vehicle or replace(named or Vehicle(), **self.changes)


@dataclass(frozen=True)
class MapGrid:
    """A grid of cells over a stage.

    Attributes:
        west, north: Borders of its first cell, meters.
        cell_m: Side of a cell.
        width, height: Cells.
    """

    west: float
    north: float
    cell_m: float
    width: int
    height: int

    @classmethod
    def over(cls, area_m: tuple[float, float, float, float], cell_m: float) -> MapGrid:
        """The cells that cover an area, from its north-western corner on.

        Raises:
            OutputError: It is none, or there would be too many cells.
        """
        west, south, east, north = area_m
        if not (west < east and south < north and all(map(math.isfinite, area_m))):
            raise OutputError(
                f"area_m={','.join(f'{value:g}' for value in area_m)}: expected WEST,SOUTH,EAST,"
                "NORTH in meters, west below east, south below north"
            )
        # A side that rounding makes longer than so many cells has no more.
        sides = [max(1.0, side / cell_m - 1e-6) for side in (east - west, north - south)]
        if not sides[0] * sides[1] <= MOST_CELLS:
            raise OutputError(
                f"{sides[0]:.3g} x {sides[1]:.3g} cells of {cell_m:g} m: at most {MOST_CELLS:,} "
                "are taken; set cell_m higher or a smaller area_m"
            )
        width, height = (math.ceil(side) for side in sides)
        return cls(west, north, cell_m, width, height)

    @property
    def tiles(self) -> list[tuple[int, int]]:
        """Rows and columns of the tiles' first cells."""
        return [(y, x) for y in range(0, self.height, TILE) for x in range(0, self.width, TILE)]

    def extent(self, tile: tuple[int, int]) -> tuple[int, int]:
        """Rows and columns of a tile."""
        return min(TILE, self.height - tile[0]), min(TILE, self.width - tile[1])

    def centers(
        self, first: tuple[int, int], shape: tuple[int, int]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """X of some columns and y of some rows, whatever part of the grid they are asked with."""
        x = np.arange(first[1], first[1] + shape[1], dtype=np.float64)
        y = np.arange(first[0], first[0] + shape[0], dtype=np.float64)
        return self.west + (x + 0.5) * self.cell_m, self.north - (y + 0.5) * self.cell_m


#: Columns of tables by name, each [n]; texts are lists.
type Table = Mapping[str, NDArray[Any] | list[str]]


@dataclass(frozen=True)
class SiteFacts:
    """Describes a stage as far as its maps need that.

    Attributes:
        digest: Of the stage.
        area_m: West, south, east and north border of the ground, without its horizon.
        layers: Those of ``MapOptions.layers`` that there are, ``label`` spelled out by level.
        label_names: Level -> id -> name.
        objects: All instances: ``instance``, ``class``, places and sizes.
        paths: Poses of cameras.
        sun: Direction to the brightest sun and its full angle, (x, y, z, radians); None without.
        losses: A line for each thing in the stage that was not read.
        place: Where the stage lies; None: it does not say.
        craters: Places, diameters, depths, ages; empty where the stage tells of none.
        vehicle: Whom traversability is for.
    """

    digest: str
    area_m: tuple[float, float, float, float]
    layers: tuple[str, ...]
    label_names: dict[str, dict[int, str]]
    objects: Table
    paths: Table
    sun: tuple[float, float, float, float] | None
    losses: tuple[str, ...]
    place: Georeference | None = None
    craters: Table = field(default_factory=dict)
    vehicle: Vehicle = field(default_factory=Vehicle)
