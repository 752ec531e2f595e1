"""Defines the Scene: one batch as arrays, the vocabulary of all passes and of the emitter.

World frame: meters, Z up, x east, y north, the terrain's center at the origin. Everything is plain
data; nothing here draws, reads files or knows of USD.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.labels import Labels
from scenec.compiler.scene.light import Haze, Lamp, SkyLabelMaps, SkyLight, SunDisc
from scenec.compiler.scene.material import Material
from scenec.compiler.scene.objects import Objects, Placed
from scenec.compiler.scene.rig import Rig
from scenec.schemas.craters import CraterTable
from scenec.schemas.errors import SceneError
from scenec.schemas.georeference import Georeference


@dataclass(frozen=True)
class DemOrigin:
    """Locates the terrain on a planet; recorded, and never part of any arithmetic.

    Attributes:
        crs: Coordinate reference system: an authority's code, or WKT.
        center: The world's origin in it, in its units.
        height_offset_m: Added to the (scaled) heights of the DEM.
        place: The same by latitude and longitude; None where the file does not say on which body.
    """

    crs: str
    center: tuple[float, float]
    height_offset_m: float
    place: Georeference | None = None


@dataclass(frozen=True)
class Scene:
    """One batch.

    Attributes:
        times: Real time of each sample, seconds, [samples].
        label_table: Per level, name -> id.
        sky_labels: Label id of the sky per level.
        sky_labels_below: Of its picture's ground, on levels that give that a label of its own.
        materials: By name; only those in use.
        objects: Object classes in the cfg's order.
        sun, sky: Light; None where there is none.
        more_suns: Further distant discs by prim name: earthshine, a second sun.
        sky_label_maps: Labels of a panorama, or None.
        outputs: Union of all sensors' outputs.
        bounds: World bounds of the geometry but for the horizon, float64 [2, 3].
        georeference: Of the first DEM that has one; None without.
        craters: Of the relief; None where it has none.
    """

    name: str
    samples: int
    times: NDArray[np.float64]
    label_table: dict[str, dict[str, int]]
    sky_labels: Labels
    materials: dict[str, Material]
    ground: Ground
    objects: Objects
    sun: SunDisc | None
    sky: SkyLight | None
    rigs: tuple[Rig, ...]
    outputs: tuple[str, ...]
    bounds: NDArray[np.float64]
    georeference: DemOrigin | None = None
    more_suns: dict[str, SunDisc] = field(default_factory=dict)
    lamps: tuple[Lamp, ...] = ()
    haze: Haze | None = None
    sky_label_maps: SkyLabelMaps | None = None
    sky_labels_below: Labels = field(default_factory=dict)
    craters: CraterTable | None = None

    @property
    def reach(self) -> NDArray[np.float64]:
        """World bounds of all geometry, float64 [2, 3]."""
        if self.ground.horizon is None:
            return self.bounds
        tile = self.ground.horizon.tile
        low, high = (tile.translate + pick(tile.points, axis=0) for pick in (np.min, np.max))
        return np.stack([np.minimum(self.bounds[0], low), np.maximum(self.bounds[1], high)])


def require_finite(scene: Scene) -> None:
    """Refuses numbers that are in range each and multiply to what float32 cannot hold.

    Raises:
        SceneError: There are some.
    """
    arrays: dict[str, NDArray[Any]] = {}
    for one in scene.objects:
        if isinstance(one, Placed):
            arrays[f"objects/{one.name}: poses"] = one.to_world
            continue
        arrays[f"objects/{one.name}: positions"] = one.positions
        arrays[f"objects/{one.name}: sizes"] = one.scales
    for name, picture in scene.sky.pictures.items() if scene.sky else ():
        if not isinstance(picture, Path):
            arrays[f"light/sky: {name}"] = picture
    for rig in scene.rigs:
        arrays[f"rigs/{rig.name}: poses"] = rig.to_world
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise SceneError(f"{name} overflow; use smaller numbers")
