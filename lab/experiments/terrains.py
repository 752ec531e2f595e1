"""Terrains of five classes (rock, sand, dried mud, gravel, sky), and what is left out of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SEED = 1
#: Values 0, 1, 2 … of a network's answer.
CLASSES = ("sky", "sand", "gravel", "mud", "rock")
LEVEL = "class"
CAMERA = "rover_camera"

Cfg = dict[str, Any]


def cfg(size: tuple[int, int], batches: int, samples: int) -> Cfg:
    """Three kinds of ground under rocks and a hazy sky, seen from a small rover.

    Colors are drawn for each terrain, so wide that classes share them: texture and form must tell.

    Args:
        size: Of the pictures, pixels.
        batches: Terrains, each with grounds, colors, rocks and air of its own.
        samples: Pictures of each, with a sun and a place of their own.
    """
    made: Cfg = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))
    made["rigs"]["rover"]["sensors"]["camera"]["resolution"] = list(size)
    return made | {"batches": batches, "samples": samples}


def without_sensor(made: Cfg) -> None:
    """Pictures show the radiance as it is."""
    for sensor in made["rigs"]["rover"]["sensors"].values():
        del sensor["imaging"]


def without_displacement(made: Cfg) -> None:
    """Grounds keep their colors and normals, and lose their small relief."""
    for material in made["materials"].values():
        material["maps"]["procedural"].pop("displacement", None)


def without_sky(made: Cfg) -> None:
    """The sun alone gives light, as on the Moon."""
    labels = made["light"]["sky"]["labels"]
    made["light"]["sky"] = {"type": "none", "labels": labels}


@dataclass(frozen=True)
class Setting:
    """One way to make pictures.

    Attributes:
        change: Made to the cfg; None for none.
        words: For ``scenec render``.
    """

    change: Callable[[Cfg], None] | None = None
    words: tuple[str, ...] = ("--spp", "64")


FULL = "everything"
#: What is left out -> how.
SETTINGS = {
    FULL: Setting(),
    "no sensor model": Setting(without_sensor),
    "no displacement": Setting(without_displacement),
    "no sky": Setting(without_sky),
    "4 samples": Setting(words=("--spp", "4")),
    "4 samples, denoised": Setting(words=("--spp", "4", "--denoise")),
}
