"""A small cfg of a rig in orbit whose camera has a shutter, for tests."""

from __future__ import annotations

from typing import Any

from scenec.testing import small

ORBIT = {
    "type": "orbit",
    "center": {"type": "point", "x_m": 0, "y_m": 0, "height_m": 0.5},
    "radius_m": 5,
    "height_m": 1.5,
    "period_s": 6,
    "sweep_deg": 60,
}
SHUTTER = {"exposure_s": 0.01, "readout_s": 0.04}


def cfg(shutter: Any, pose: Any = ORBIT, **sensor: Any) -> dict[str, Any]:
    """Little to look at, soon compiled."""
    made = small.small_cfg()
    made["outputs"] = ["depth", "instance"]
    made["terrain"]["relief"] = made["terrain"]["relief"][:1]
    made["objects"]["rocks"]["count"] = 40
    front = {"resolution": [40, 30], "fov_deg": 70} | sensor
    if shutter is not None:
        front["shutter"] = shutter
    made["rigs"]["rover"] = {"pose": pose, "sensors": {"front": front}}
    return made
