"""What must hold between a sensor's shutter, its imaging and its rig's motion.

Like ``check_scene``, these checks pass over what does not have the shape they look for.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path

#: Poses that come one by one, at no time.
_STILL = ("random", "random_target")


def check_shutters(document: Any) -> Iterator[Finding]:
    """Findings on the shutters of all sensors.

    Args:
        document: A cfg, perhaps with faults.
    """
    for rig, node in _mapping(_mapping(document).get("rigs")).items():
        kind = _mapping(_mapping(node).get("pose")).get("type")
        for name, sensor in _mapping(_mapping(node).get("sensors")).items():
            shutter = _mapping(sensor).get("shutter")
            if not isinstance(shutter, dict):
                continue
            path: Path = ("rigs", rig, "sensors", name, "shutter")
            if kind in _STILL:
                yield Finding(
                    path,
                    f'poses of the type "{kind}" are of no time, so nothing moves while a shutter '
                    "is open: take it away, or let the rig move (track, orbit, lawn_mower, rover, "
                    "mav, descent)",
                    at_key=True,
                )
            exposure = _mapping(_mapping(sensor.get("imaging")).get("exposure"))
            if "exposure_s" not in shutter and exposure.get("type") != "manual":
                yield Finding(
                    path,
                    'expected the key exposure_s: nothing but an imaging/exposure of type "manual" '
                    "says it otherwise",
                )


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
