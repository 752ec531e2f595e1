"""Defines what was drawn of materials: a part of the Plan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.compiler.scene.material import Material

if TYPE_CHECKING:
    # A cfg is checked without what paints.
    from scenec.compiler.materials.surface import Surface


@dataclass(frozen=True)
class MapSources:
    """Further files that a cfg names for a material, which its pictures are made of.

    Attributes:
        gloss: Roughness is 1 less it; None: there is none.
        occlusion: Ambient occlusion, which the albedo is multiplied with.
        occlusion_strength: albedo * (1 - strength * (1 - occlusion)).
        packed: Occlusion, roughness and metallic part as red, green and blue.
        packed_order: Which of them is which, by their first letters.
        unpacked: Kinds that ``packed`` is used for.
        heights: Of the relief, as a picture.
        heights_m: White above black in it; None: it stays flat.
        as_is: Whether files keep their resolution, whoever sees them.
        unused: Files of a folder whose names are understood, and which nothing is made of.
        unknown: Files of a folder whose names are not understood.
    """

    gloss: Path | None = None
    occlusion: Path | None = None
    occlusion_strength: float = 1.0
    packed: Path | None = None
    packed_order: str = "orm"
    unpacked: tuple[str, ...] = ()
    heights: Path | None = None
    heights_m: float | None = None
    as_is: bool = False
    unused: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()


@dataclass(frozen=True)
class MaterialPlan:
    """A material before its pictures are made.

    Attributes:
        material: As it is without further pictures than files that are shown as they are.
        procedural: What makes those pictures that no file gives, or None.
        sources: Further files that pictures are made of, or None.
    """

    material: Material
    procedural: Surface | None = None
    sources: MapSources | None = None
