"""Defines what a kind of surface is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from scenec.compiler.kinds import bounded, forms, key, noise_key
from scenec.compiler.materials.tile import Paint, Tile

GRAIN_M = bounded(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000)


@dataclass(frozen=True, kw_only=True)
class Surface(ABC):
    """A kind of surface: each says what ``grain_m`` is of it, and adds what it asks for."""

    grain_m: float = key(GRAIN_M)
    """Width of what it consists of: crystals, stones, polygons."""
    relief_m: float | None = key(forms.SURFACE_RELIEF_M, optional=True)
    contrast: float = key(forms.SURFACE_CONTRAST)
    resolution: int = key(forms.SURFACE_RESOLUTION)
    #: Whether the relief becomes geometry on the ground: the last key of each (``kinds.shared``).
    displacement: bool = False
    key: int = noise_key()

    #: Side of one repeat that suits the usual ``grain_m``, meters.
    SIZE_M: ClassVar[float]
    #: What ``Paint.height`` is in, as a part of ``grain_m``.
    RELIEF: ClassVar[float]

    @abstractmethod
    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness on a tile."""

    def unit(self, tile: Tile) -> float:
        """Returns the unit of ``Paint.height``, meters, where no relief is asked for."""
        return self.RELIEF * tile.fitting(self.grain_m)
