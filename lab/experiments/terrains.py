"""Terrains of five classes (rock, sand, dried mud, gravel, sky), and what is left out of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

SEED = 1
#: Values 0, 1, 2 … of a network's answer.
CLASSES = ("sky", "sand", "gravel", "mud", "rock")
LEVEL = "class"
CAMERA = "rover_camera"

Cfg = dict[str, Any]


def _between(least: float, most: float) -> dict[str, Any]:
    return {"type": "uniform", "min": least, "max": most}


def _albedo(*least: float) -> list[Any]:
    """Drawn for each terrain, so wide that classes share colors: texture and form must tell."""
    return [_between(value, 2.2 * value) for value in least]


def cfg(size: tuple[int, int], batches: int, samples: int) -> Cfg:
    """Three kinds of ground under rocks and a hazy sky, seen from a small rover.

    Args:
        size: Of the pictures, pixels.
        batches: Terrains, each with grounds, colors, rocks and air of its own.
        samples: Pictures of each, with a sun and a place of their own.
    """
    return {
        "version": 1,
        "name": "terrains",
        "batches": batches,
        "samples": samples,
        "outputs": ["rgb", "label", "instance"],
        "labels": {LEVEL: {name: i for i, name in enumerate(CLASSES, 1)}},
        "terrain": {
            "size_m": [36, 36],
            "spacing_m": 0.12,
            "relief": [
                {"type": "plane"},
                {
                    "type": "multifractal", "amplitude_m": _between(0.4, 1.6),
                    "scale_m": _between(7, 14), "octaves": 5,
                },
            ],
            "ground": [
                {"material": "sand", "labels": {LEVEL: "sand"}},
                *(
                    {
                        "material": name,
                        "labels": {LEVEL: name},
                        "noise": {"scale_m": _between(3, 7), "octaves": 3},
                        "sharpness": 25,
                        "coverage": share,
                    }
                    for name, share in (("gravel", 0.42), ("mud", 0.38))
                ),
            ],
            "mesh": {"finest_m": 0.025},
        },
        "materials": {
            "sand": _ground(_albedo(0.2, 0.15, 0.1), "sand", ripple_m=_between(0.07, 0.15)),
            "gravel": _ground(_albedo(0.13, 0.1, 0.075), "gravel", grain_m=_between(0.02, 0.05)),
            "mud": _ground(_albedo(0.14, 0.105, 0.075), "mud_cracks", grain_m=_between(0.12, 0.25)),
            "stone": {
                "base_color": _albedo(0.1, 0.08, 0.065),
                "variation": 0.4,
                "specular": 0.02,
                "maps": {"procedural": {"type": "basalt", "resolution": 256}},
            },
        },
        "objects": {
            "rocks": {
                "type": "rocks",
                "count": {"type": "uniform", "min": 150, "max": 600},
                "material": "stone",
                "labels": {LEVEL: "rock"},
                "prototypes": 7,
                "subdivisions": 2,
                "size_m": {"type": "log_uniform", "min": 0.15, "max": 1.2},
                "density": {"type": "noise", "scale_m": 5},
                "embed": _between(0.1, 0.5),
            }
        },
        "light": {
            "sun": {"elevation_deg": _between(12, 60), "azimuth_deg": _between(0, 360)},
            "sky": {
                "type": "atmosphere",
                "planet": "earth",
                "dust_density": _between(0.5, 3),
                "resolution": 48,
                "labels": {LEVEL: "sky"},
            },
        },
        "rigs": {
            "rover": {
                "pose": {
                    "type": "random_target",
                    "position": {
                        "x_m": _between(-10, 10),
                        "y_m": _between(-10, 10),
                        "height_m": _between(0.7, 1.5),
                    },
                    "target": {
                        "distance_m": _between(2, 6),
                        "bearing_deg": _between(0, 360),
                        "height_m": _between(0, 0.5),
                    },
                },
                "sensors": {
                    "camera": {
                        "resolution": list(size),
                        "fov_deg": 62,
                        "exposure": {"type": "incident"},
                        "imaging": {
                            "exposure": {
                                "type": "metered", "time_range_s": [1e-5, 2e-3],
                                "iso_range": [400, 6400],
                            },
                            "vignetting": {},
                            "bloom": {},
                            "jpeg": {"quality": 85},
                        },
                    }
                },
            }
        },
    }  # fmt: skip


def _ground(color: list[Any], kind: str, **keys: Any) -> Cfg:
    surface = {"type": kind, "displacement": True, "resolution": 256, **keys}
    return {
        "base_color": color,
        "specular": 0,
        "variation": 0.2,
        "maps": {"procedural": surface, "cells": {}},
    }


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
