"""Defines what a kind of surface is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from scenec.compiler.materials.tile import Look, Tile


@dataclass(frozen=True)
class Surface(ABC):
    """A kind of surface, with its cfg's keys as fields; each kind adds what it asks for.

    Attributes:
        key: Noise key.
        grain_m: Width of what it consists of: crystals, stones, polygons.
        relief_m: Root mean square of the relief's heights; None: as it is in nature.
        contrast: How much colors differ: 0 not at all, 1 as in nature.
        resolution: Pixels a side.
        displacement: Whether the relief becomes geometry on the ground.
    """

    key: int
    grain_m: float
    relief_m: float | None
    contrast: float
    resolution: int
    displacement: bool

    #: Side of one repeat that suits the usual ``grain_m``, meters.
    SIZE_M: ClassVar[float]
    #: What ``Look.height`` is in, as a part of ``grain_m``.
    RELIEF: ClassVar[float]

    @abstractmethod
    def paint(self, tile: Tile) -> Look:
        """Relief, color and roughness on a tile."""

    def unit(self, tile: Tile) -> float:
        """What ``Look.height`` is in, meters, where no relief is asked for."""
        return self.RELIEF * tile.fitting(self.grain_m)
