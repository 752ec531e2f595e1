"""Defines the Plan: one batch with every number drawn. After this, no randomness is left.

What the cfg leaves to chance stands here as numbers, arrays and noise keys (64-bit integers that
noise functions take as an argument: a function of key and position, not a generator).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.scene.rig import Lidar, Sensor
from scenec.compiler.scene.scene import GroundLayer, Labels, Material
from scenec.schemas.imaging import Imaging
from scenec.schemas.shutter import Shutter

# Names of what a plan is made of; the rooms they come from read plans.
if TYPE_CHECKING:
    from scenec.compiler.cameras.paths.motion import Motion
    from scenec.compiler.mesh.merge import Merge
    from scenec.compiler.mesh.mesh import Meshing
    from scenec.compiler.objects.coatings import CoatingPlan
    from scenec.compiler.objects.conditions import PlacementCondition
    from scenec.compiler.objects.density import Density
    from scenec.compiler.objects.families.shape import Shape
    from scenec.compiler.objects.feet import FilletPlan
    from scenec.compiler.objects.placed import PlacedPlan
    from scenec.compiler.objects.prototypes import ModelPlan, PartRule
    from scenec.compiler.scene.light_plan import LightPlan
    from scenec.compiler.terrain.detail import Detail
    from scenec.compiler.terrain.operator import ReliefOperator
    from scenec.compiler.terrain.shade import Shade


@dataclass(frozen=True)
class HorizonPlan:
    """The land beyond the terrain's border.

    Attributes:
        reach_m: How far beyond the border it goes.
        spacing_m: Of the grid of its relief.
        blend_m: Width over which the border's heights and materials give way to its own.
        layer: What it is.
    """

    reach_m: float
    spacing_m: float
    blend_m: float
    relief: tuple[ReliefOperator, ...]
    layer: GroundLayer


@dataclass(frozen=True)
class TerrainPlan:
    """Relief program and ground.

    Attributes:
        size_m, spacing_m: Of the grid.
        layers: Ground layers from the base up.
        coverage: For each merge, the fraction it shall cover, or None (its center is given).
        variation_key: Noise key of the albedo variation.
        displacements: Of each layer's material, or None.
        horizon: What lies around it, or None.
        shades: Where the albedo varies with more than its noise.
    """

    size_m: tuple[float, float]
    spacing_m: float
    relief: tuple[ReliefOperator, ...]
    layers: tuple[GroundLayer, ...]
    merges: tuple[Merge, ...]
    coverage: tuple[float | None, ...]
    variation_key: int
    meshing: Meshing
    displacements: tuple[Detail | None, ...] = ()
    horizon: HorizonPlan | None = None
    shades: tuple[Shade, ...] = ()


@dataclass(frozen=True)
class RockShapes:
    """Procedural rocks: each fits into a ball of diameter 1, so that a scale is a diameter.

    Attributes:
        shapes: One for each prototype.
        coatings: What lies on them, the lowest first.
    """

    shapes: tuple[Shape, ...]
    coatings: tuple[CoatingPlan, ...] = ()
    #: They are let down until a vertex touches the ground.
    touch: ClassVar[bool] = True


@dataclass(frozen=True)
class ModelSource:
    """Models from files, in meters: a scale is a factor.

    Attributes:
        models: One for each prototype.
        variation: How much the files' own materials vary from instance to instance.
        touch: Whether they are let down until a vertex touches the ground, or stand on it with
            their origin.
    """

    models: tuple[ModelPlan, ...]
    rules: tuple[PartRule, ...]
    variation: float
    touch: bool


@dataclass(frozen=True)
class Count:
    """How many there are: a number, or one to the square meter of terrain in plan.

    Attributes:
        exact: The number, or None.
        per_m2: Of the terrain without ``where``; None with ``exact``.
        rounding_u: Uniform in [0, 1): whether what is left of a whole one counts.
    """

    exact: int | None
    per_m2: float | None
    rounding_u: float


@dataclass(frozen=True)
class Spacing:
    """Poisson-disk spacing: distances that are kept in plan.

    Attributes:
        gap_m: Between circles.
        radius: A circle's, in radii of the ball around its object.
        of: Names of the classes that are kept away from; the own one may be among them.
    """

    gap_m: float
    radius: float
    of: tuple[str, ...]


@dataclass(frozen=True)
class ScatterPlan:
    """One class of scattered objects; n instances at most, see ``Count``.

    Attributes:
        material, labels, instances: As in ``Scatter``.
        source: What the prototypes are made of.
        count: How many there are.
        density: How many lie in one place compared with another.
        where: Conditions that the density is multiplied with.
        spacing: What is kept between objects, or None.
        fewer: Whether those that find no place are left out; else they are an error.
        clearance_m: Between cameras and balls around objects; below 0, how far inside they may be.
        place_key: Of the hash that gives an instance its further candidate places.
        position_u: Uniform numbers that pick the first candidate, float64 [n, 3].
        prototype: int32 [n].
        orientations: Unit quaternions (x, y, z, w), float64 [n, 4].
        align: Whether they then turn with the surface normal.
        scale: Factor on the prototype, float64 [n]: for rocks the diameter in meters.
        embed: Part of the height below ground, float64 [n].
        variation: Albedo variation, float64 [n], in [-1, 1].
        lod_px: Largest error of a level of detail, in pixels of the nearest view.
        fillet: Fines heaped about their feet, or None.
        beyond_m: How far beyond the terrain's border they lie, on the land; 0: on the terrain.
    """

    name: str
    material: str | None
    labels: Labels
    instances: bool
    source: RockShapes | ModelSource
    count: Count
    density: Density
    where: tuple[PlacementCondition, ...]
    spacing: Spacing | None
    fewer: bool
    clearance_m: float
    place_key: int
    position_u: NDArray[np.float64]
    prototype: NDArray[np.int32]
    orientations: NDArray[np.float64]
    align: bool
    scale: NDArray[np.float64]
    embed: NDArray[np.float64]
    variation: NDArray[np.float64]
    lod_px: float
    fillet: FilletPlan | None = None
    beyond_m: float = 0.0


@dataclass(frozen=True)
class ImagingPlan:
    """A sensor's parameters as drawn.

    Attributes:
        samples: At each sample. Of metered ones time and speed are still missing, and what they
            have to be between is there.
        metered: Whether they follow the sensor's exposure.
    """

    samples: tuple[Imaging, ...]
    metered: bool


@dataclass(frozen=True)
class SensorPlan:
    """A sensor, but for what depends on light and motion.

    Attributes:
        sensor: Without imaging and shutter; its exposure is absolute, or relative to the incident
            light's if ``metered``. An automatic one is metered, too: what it is before there are
            pictures.
        metered: Whether the exposure follows the light.
        imaging: What it makes of light, or None.
        shutter: At each sample, or None.
    """

    sensor: Sensor
    metered: bool
    imaging: ImagingPlan | None = None
    shutter: tuple[Shutter, ...] | None = None


@dataclass(frozen=True)
class RigPlan:
    """Plans a rig, its motion and its sensors.

    Attributes:
        allow_below: Whether it may be below the ground, inside of objects and off the terrain.
    """

    name: str
    pose: Motion
    sensors: tuple[SensorPlan, ...]
    lidars: tuple[Lidar, ...] = ()
    allow_below: bool = False

    @property
    def outputs(self) -> list[str]:
        """What is asked of its sensors, one after the other."""
        return [name for sensor in self.sensors for name in sensor.sensor.outputs]


@dataclass(frozen=True)
class Plan:
    """Everything about one batch; the fields shared with ``Scene`` mean the same there."""

    name: str
    batch: int
    samples: int
    label_table: dict[str, dict[str, int]]
    sky_labels: Labels
    sky_labels_below: Labels
    materials: dict[str, Material]
    terrain: TerrainPlan
    objects: tuple[ScatterPlan | PlacedPlan, ...]
    object_triangles: int | None
    light: LightPlan
    rigs: tuple[RigPlan, ...]
