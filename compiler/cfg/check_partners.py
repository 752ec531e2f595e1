"""Outputs that need more than a camera: a stereo partner, a way of measuring depth."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.schemas.correspondence import PARTNER
from scenec.schemas.depth_camera import MEASURED
from scenec.schemas.spelling import nearest, shown


def check_partners(document: Any) -> Iterator[Finding]:
    """Findings on partners and depth cameras of sensors.

    Args:
        document: A cfg, perhaps with faults; what has another shape is passed by.
    """
    rigs = document.get("rigs") if isinstance(document, dict) else None
    for rig, content in rigs.items() if isinstance(rigs, dict) else ():
        sensors = content.get("sensors") if isinstance(content, dict) else None
        if not isinstance(sensors, dict):
            continue
        for name, sensor in sensors.items():
            if isinstance(sensor, dict):
                usual = document.get("outputs")
                yield from _of_sensor(("rigs", rig, "sensors", name), sensor, sensors, usual)


def _of_sensor(
    path: Path, sensor: dict[str, Any], sensors: dict[str, Any], usual: Any
) -> Iterator[Finding]:
    own = "outputs" in sensor
    outputs = sensor["outputs"] if own else usual
    listed = outputs if isinstance(outputs, list) else []
    place = (*path, "outputs") if own else path
    if MEASURED in listed and "depth_camera" not in sensor:
        yield Finding(place, f"the output {shown(MEASURED)} needs the key depth_camera")
    if "depth_camera" in sensor and outputs is not None and MEASURED not in listed:
        yield Finding(
            (*path, "depth_camera"),
            f"nothing reads it: the output {shown(MEASURED)} is not asked for",
            at_key=True,
        )
    name, partner = path[-1], sensor.get("partner")
    if isinstance(partner, str):
        others = [other for other in sensors if other != name]
        if partner == name:
            yield Finding((*path, "partner"), "a sensor is no partner of itself")
        elif partner not in sensors:
            yield Finding(
                (*path, "partner"),
                f"the rig has no sensor {shown(partner)}{nearest(partner, others)}",
            )
        return
    asked = [one for one in listed if one in PARTNER]
    if asked and "partner" not in sensor:
        yield Finding(
            place,
            f"the output {shown(asked[0])} needs the key partner: the sensor it goes to",
        )
