"""Defines what was drawn of scattered objects and of models: a part of the Plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.objects.coatings import CoatingPlan
from scenec.compiler.objects.conditions import PlacementCondition
from scenec.compiler.objects.density import Density
from scenec.compiler.objects.families.shape import Shape
from scenec.compiler.objects.feet import FilletPlan
from scenec.compiler.objects.models import ModelKeys, PartRule
from scenec.compiler.objects.scattered import Spacing
from scenec.compiler.scene.labels import Labels


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

    models: tuple[ModelKeys, ...]
    rules: tuple[PartRule, ...]
    variation: float
    touch: bool


@dataclass(frozen=True)
class ObjectCount:
    """Gives the number of objects: exact, or per square meter of terrain in plan.

    Attributes:
        exact: The number, or None.
        per_m2: Of the terrain without ``where``; None with ``exact``.
        rounding_u: Uniform in [0, 1): whether what is left of a whole one counts.
    """

    exact: int | None
    per_m2: float | None
    rounding_u: float


@dataclass(frozen=True)
class ScatterPlan:
    """One class of scattered objects; n instances at most, see ``ObjectCount``.

    Attributes:
        material, labels, instances: As in ``Scatter``.
        source: What the prototypes are made of.
        count: How many there are.
        density, where, spacing, clearance_m, lod_px: As of ``Scattered``, drawn.
        fewer: Whether those that find no place are left out; else they are an error.
        place_key: Of the hash that gives an instance its further candidate places.
        position_u: Uniform numbers that pick the first candidate, float64 [n, 3].
        prototype: int32 [n].
        orientations: Unit quaternions (x, y, z, w), float64 [n, 4].
        align: Whether they then turn with the surface normal.
        scale: Factor on the prototype, float64 [n]: for rocks the diameter in meters.
        embed: Part of the height below ground, float64 [n].
        variation: Albedo variation, float64 [n], in [-1, 1].
        fillet: Fines heaped about their feet, or None.
        beyond_m: How far beyond the terrain's border they lie, on the land; 0: on the terrain.
    """

    name: str
    material: str | None
    labels: Labels
    instances: bool
    source: RockShapes | ModelSource
    count: ObjectCount
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
