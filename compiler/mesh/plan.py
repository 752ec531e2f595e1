"""Defines what was drawn of the terrain: a part of the Plan."""

from __future__ import annotations

from dataclasses import dataclass

from scenec.compiler.mesh.merge import Merge
from scenec.compiler.mesh.mesh import Meshing
from scenec.compiler.scene.ground import GroundLayer
from scenec.compiler.terrain.detail import Detail
from scenec.compiler.terrain.operator import ReliefOperator
from scenec.compiler.terrain.planet import TerrainPlanet
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
        planet: Sphere that it curves as, or None.
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
    planet: TerrainPlanet | None = None
