"""Stones: one rock of each family that the compiler knows (docs/objects.md), in meters."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np

from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.objects.rocks import build_prototypes
from scenec.lab.models.glb import Look, Model
from scenec.lab.models.surfaces import Surface

LOOKS = {
    "granite": Look((0.300, 0.280, 0.255), 0.90),
    "basalt": Look((0.095, 0.092, 0.090), 0.90),
    "greywacke": Look((0.215, 0.215, 0.205), 0.85),
    "limestone": Look((0.420, 0.390, 0.330), 0.90),
    "lava": Look((0.070, 0.058, 0.054), 0.95),
}
_SEED, _SUBDIVISIONS = 1, 4


def _stone(family: str, size: float, material: str) -> Model:
    """The finest mesh of a family's first rock; ``size`` is the diameter of the ball about it."""
    cfg = {
        "version": 1, "name": "stone", "samples": 1, "labels": {}, "outputs": ["rgb"],
        "terrain": {
            "size_m": [8, 8], "spacing_m": 1, "relief": [{"type": "plane"}],
            "ground": [{"material": "stone"}],
        },
        "materials": {"stone": {"base_color": [0.2, 0.2, 0.2]}},
        "objects": {
            "stones": {
                "type": "rocks", "count": 1, "family": family, "material": "stone",
                "prototypes": 1, "subdivisions": _SUBDIVISIONS, "size_m": size,
            }
        },
        "light": {"sun": {"elevation_deg": 45, "azimuth_deg": 180}},
        "rigs": {
            "eye": {
                "pose": {
                    "type": "random_target",
                    "position": {"x_m": 0, "y_m": -3, "height_m": 1},
                    "target": {"distance_m": 3, "bearing_deg": 0},
                },
                "sensors": {"eye": {"resolution": [8, 8], "fov_deg": 50}},
            }
        },
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "stone.json")
        path.write_text(json.dumps(cfg), encoding="utf-8")
        (plan,) = draw(load(path), _SEED, 0).objects
        (rock,) = build_prototypes(plan.source.shapes)
    points = rock.points.astype(np.float64) * size
    points[:, 2] -= points[:, 2].min()
    surface = Surface()
    surface.add(points, rock.faces.astype(np.int64), rock.normals.astype(np.float64))
    return Model({"stone": surface.part(material)}, LOOKS)


def stone_weathered() -> Model:
    """A worn boulder of granite."""
    return _stone("weathered", 0.9, "granite")


def stone_angular() -> Model:
    """A block of basalt, broken along joints, its corners chipped."""
    return _stone("angular", 0.7, "basalt")


def stone_rounded() -> Model:
    """A cobble of graywacke, rounded by water."""
    return _stone("rounded", 0.25, "greywacke")


def stone_slab() -> Model:
    """A slab of bedded limestone with stepped sides."""
    return _stone("slab", 0.8, "limestone")


def stone_vesicular() -> Model:
    """A block of lava with open bubbles."""
    return _stone("vesicular", 0.4, "lava")
