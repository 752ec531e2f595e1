"""A small cfg with everything in it, for tests that need an output to look at."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

_CFG: dict[str, Any] = {
    "version": 1, "name": "small", "samples": 3,
    "labels": {
        "class": {"sky": 1, "ground": 2, "rock": 3},
        "surface": {"sky": 7, "sand": 20, "gravel": 21, "mud": 22, "stone": 30},
    },
    "terrain": {
        "size_m": [20, 16], "spacing_m": 0.2,
        "relief": [
            {"type": "plane", "slope": [0.05, -0.02]},
            {
                "type": "multifractal", "amplitude_m": {"type": "uniform", "min": 0.3, "max": 0.6},
                "scale_m": 6, "octaves": 5,
            },
            {"type": "smooth", "length_m": 0.1},
        ],
        "ground": [
            {"material": "sand", "labels": {"class": "ground", "surface": "sand"}},
            {
                "material": "gravel", "labels": {"class": "ground", "surface": "gravel"},
                "noise": {"scale_m": 5},
            },
            {
                "material": "mud", "labels": {"class": "ground", "surface": "mud"},
                "noise": {"scale_m": 4, "octaves": 2, "distortion": 0.2}, "coverage": 0.3,
            },
        ],
    },
    "materials": {
        "sand": {"base_color": [0.4, 0.3, 0.2], "variation": 0.2},
        "gravel": {"base_color": [0.2, 0.2, 0.2], "specular": 0.05},
        "mud": {"base_color": [0.3, 0.25, 0.2], "roughness": 0.5},
        "stone": {"base_color": [0.15, 0.12, 0.1], "variation": 0.3},
    },
    "objects": {
        "rocks": {
            "type": "rocks", "count": 300, "material": "stone",
            "labels": {"class": "rock", "surface": "stone"}, "prototypes": 4, "subdivisions": 2,
            "size_m": {"type": "log_uniform", "min": 0.05, "max": 0.7},
            "density": {"type": "noise", "scale_m": 5},
        },
    },
    "light": {
        "sun": {
            "elevation_deg": {"type": "uniform", "min": 20, "max": 60},
            "azimuth_deg": {"type": "uniform", "min": 0, "max": 360},
        },
        "sky": {"type": "clear", "resolution": 32, "labels": {"class": "sky", "surface": "sky"}},
    },
    "rigs": {
        "rover": {
            "pose": {
                "type": "random_target",
                "position": {
                    "x_m": {"type": "uniform", "min": -6, "max": 6},
                    "y_m": {"type": "uniform", "min": -6, "max": 6}, "height_m": 1.5,
                },
                "target": {
                    "distance_m": {"type": "uniform", "min": 4, "max": 8},
                    "bearing_deg": {"type": "uniform", "min": 0, "max": 360}, "height_m": 0,
                },
            },
            "sensors": {"front": {"resolution": [96, 64], "fov_deg": 70}},
        },
    },
}  # fmt: skip


def small_cfg(**change: Any) -> dict[str, Any]:
    """The cfg as a dict of its own; keyword arguments replace top keys."""
    return copy.deepcopy(_CFG) | change


def sparse_cfg(**change: Any) -> dict[str, Any]:
    """Half a rock on average, which the camera circles: of seed 1, batches 2 and 3 have none."""
    cfg = small_cfg() | change
    cfg["terrain"] |= {"relief": cfg["terrain"]["relief"][:1], "spacing_m": 2.0}
    rocks = cfg["objects"]["rocks"]
    del rocks["count"], rocks["density"]
    rocks["per_m2"] = 0.5 / 320.0
    center = {"type": "object", "object": "rocks"}
    pose = {"type": "orbit", "center": center, "radius_m": 5, "height_m": 3, "period_s": 10}
    sensor = {"resolution": [8, 6], "fov_deg": 70}
    # The circle may leave the terrain.
    cfg["rigs"]["rover"] = {"pose": pose, "sensors": {"front": sensor}, "allow_below": True}
    return cfg


def scaled(node: Any, factor: float, length: bool = False) -> Any:
    """A cfg (or a part of one) with every length multiplied."""
    if isinstance(node, dict):
        return {
            key: scaled(value, factor, key.endswith("_m") or (length and key != "type"))
            for key, value in node.items()
        }
    if isinstance(node, list):
        return [scaled(value, factor, length) for value in node]
    return node * factor if length and isinstance(node, int | float) else node


def write_cfg(folder: Path, cfg: dict[str, Any] | None = None, name: str = "small.json") -> Path:
    """Writes a cfg (default: the small one) into a folder."""
    path = folder / name
    path.write_text(json.dumps(small_cfg() if cfg is None else cfg, indent=1), encoding="utf-8")
    return path
