"""Shares code of scene importers: names, labels, ground, cameras and light that vary."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.importers.numbers import tidy, uniform
from scenec.schemas.codec import JsonObject

#: The level of labels that scenes get.
LEVEL = "class"
#: Turns that a varied camera makes at most, degrees, and how far it moves, as a share of the scene.
_TURN_DEG, _TILT_DEG, _MOVE = 10.0, 5.0, 0.02


def identifier(text: str) -> str:
    """A name that a cfg may have: letters, digits and underscores."""
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_") or "thing"
    return f"_{name}" if name[0].isdigit() else name


def unused(text: str, used: Any) -> str:
    """An identifier that is not among those taken."""
    name = free = identifier(text)
    number = 2
    while free in used:
        free, number = f"{name}_{number}", number + 1
    return free


class Taxonomy:
    """One level of labels, numbered as they come.

    Attributes:
        ids: Id by name.
    """

    def __init__(self) -> None:
        self.ids: dict[str, int] = {}

    def choice(self, name: str) -> dict[str, str]:
        """A choice of one label."""
        free = identifier(name)
        self.ids.setdefault(free, len(self.ids) + 1)
        return {LEVEL: free}


def soil() -> JsonObject:
    """A material for ground that nobody described."""
    maps = {"procedural": {"type": "soil", "resolution": 512}}
    return {"base_color": [0.2, 0.14, 0.09], "maps": maps}


def intrinsics(k: Sequence[float], corner: float = 0.5) -> JsonObject:
    """Returns a sensor's intrinsics from a camera's matrix.

    Args:
        k: The matrix by row, pixels.
        corner: What the middle of the first pixel is off the matrix's origin; it is 0.5 here.
    """
    found = {"fx": k[0], "fy": k[4], "cx": k[2] + corner, "cy": k[5] + corner}
    if k[1]:
        found["skew"] = k[1]
    return {"intrinsics": {name: tidy(value) for name, value in found.items()}}


def varied_sun() -> JsonObject:
    """A sun that stands anywhere by day."""
    return {"elevation_deg": uniform(15, 75), "azimuth_deg": uniform(0, 360)}


def varied_pose(pose: NDArray[np.float64], extent_m: float) -> JsonObject:
    """Poses about one.

    Args:
        pose: From the rig's frame (x right, y down, z ahead) to the world, [4, 4].
        extent_m: Size of the scene, which says how far cameras move.
    """
    x, y, z = (float(v) for v in pose[:3, 3])
    ahead, right, down = pose[:3, 2], pose[:3, 0], pose[:3, 1]
    pitch = math.degrees(math.asin(max(-1.0, min(1.0, float(ahead[2])))))
    if abs(pitch) > 89.0:
        # Straight up or down: what is up in the picture says the bearing.
        bearing = math.degrees(math.atan2(-float(down[0]), -float(down[1])))
        roll = 0.0
    else:
        bearing = math.degrees(math.atan2(float(ahead[0]), float(ahead[1])))
        # Without roll, right is level.
        roll = math.degrees(math.atan2(-float(right[2]), -float(down[2])))
    move = max(_MOVE * extent_m, 1e-3)
    low, high = max(pitch - _TILT_DEG, -90.0), min(pitch + _TILT_DEG, 90.0)
    return {
        "type": "random",
        "region_m": [[tidy(x - move), tidy(y - move)], [tidy(x + move), tidy(y + move)]],
        "height_m": uniform(z - 0.25 * move, z + 0.25 * move),
        "above": "world",
        "look": {
            "type": "direction",
            "bearing_deg": uniform(bearing - _TURN_DEG, bearing + _TURN_DEG),
            "pitch_deg": uniform(low, high),
        },
        **({"roll_deg": tidy(round(roll, 6))} if abs(roll) > 1e-4 else {}),
        # The scene's own objects may be around it.
        "limits": {"clearance_m": -1000},
    }


def orbit(extent_m: float) -> JsonObject:
    """A way around the middle, where a scene has no camera."""
    radius, height = tidy(0.3 * extent_m), tidy(0.1 * extent_m)
    return {
        "pose": {"type": "orbit", "radius_m": radius, "height_m": height},
        "sensors": {"camera": {"resolution": [640, 480], "fov_deg": 60}},
    }


def scattered_rocks(area_m2: float, material: str, labels: dict[str, str]) -> JsonObject:
    """Some small rocks all over the ground."""
    size = math.sqrt(area_m2)
    return {
        "type": "rocks",
        "material": material,
        "labels": labels,
        "count": 200,
        "size_m": {"type": "log_uniform", "min": tidy(0.003 * size), "max": tidy(0.02 * size)},
        "density": {"type": "noise", "scale_m": tidy(0.2 * size)},
        "shortfall": "fewer",
    }
