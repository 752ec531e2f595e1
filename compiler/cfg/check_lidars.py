"""Lidars and triggers: numbers that do not go together."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.schemas.spelling import shown


def check_lidars(document: Any) -> Iterator[Finding]:
    """Findings on lidars, and on when sensors are triggered.

    Args:
        document: A cfg, perhaps with faults; what does not have the shape looked for is passed by.
    """
    rigs = document.get("rigs") if isinstance(document, dict) else None
    for rig, content in rigs.items() if isinstance(rigs, dict) else ():
        for kind in ("sensors", "lidars"):
            things = content.get(kind) if isinstance(content, dict) else None
            for name, thing in things.items() if isinstance(things, dict) else ():
                if not isinstance(thing, dict):
                    continue
                path = ("rigs", rig, kind, name)
                yield from _check_trigger(path, thing, document.get("samples"))
                if kind == "lidars":
                    if name in (content.get("sensors") or {}):
                        yield Finding(path, f"a sensor has the name {shown(name)}, too")
                    yield from _check_lidar(path, thing)


def _check_trigger(path: Path, thing: dict[str, Any], samples: Any) -> Iterator[Finding]:
    trigger = thing.get("trigger")
    first = trigger.get("first", 0) if isinstance(trigger, dict) else 0
    if isinstance(first, int) and isinstance(samples, int) and first >= samples > 0:
        yield Finding(
            (*path, "trigger", "first"),
            f"is never reached: there are samples 0 to {samples - 1}",
        )


def _check_lidar(path: Path, lidar: dict[str, Any]) -> Iterator[Finding]:
    if "beams" in lidar and "elevations_deg" in lidar:
        yield Finding(
            (*path, "elevations_deg"),
            "beams and elevations_deg both say how many beams there are: take one away",
            at_key=True,
        )
    elif "beams" not in lidar and "elevations_deg" not in lidar:
        yield Finding(path, "expected either the key beams or the key elevations_deg")
    for key, most in (("range_m", None), ("azimuth_deg", 360.0)):
        pair = lidar.get(key)
        if not (isinstance(pair, list) and len(pair) == 2):
            continue
        low, high = pair
        if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in pair):
            continue
        if most is None and low > high:
            yield Finding((*path, key), f"expected the nearest range first: {high:g}, {low:g}")
        elif most is not None and not 0.0 < abs(high - low) <= most:
            yield Finding(
                (*path, key), f"spans {abs(high - low):g} degrees, expected above 0, at most 360"
            )
