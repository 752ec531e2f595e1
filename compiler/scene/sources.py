"""Defines pictures that a cfg names and that become others before they are shown."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Sources:
    """What is made of further files, or left as it is.

    Attributes:
        gloss: Roughness is 1 less it; None: there is none.
        occlusion: Ambient occlusion, which the albedo is multiplied with.
        occlusion_strength: albedo * (1 - strength * (1 - occlusion)).
        packed: Occlusion, roughness and metallic part as red, green and blue.
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
    unpacked: tuple[str, ...] = ()
    heights: Path | None = None
    heights_m: float | None = None
    as_is: bool = False
    unused: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
