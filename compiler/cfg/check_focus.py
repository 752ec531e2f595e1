"""What must hold between a sensor's focus and its other keys."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path

#: What imaging says in place of a key: the key of its own.
_OF_IMAGING = {"f_number": "f_number", "focal_length_mm": "pixel_um"}


def check_focus(sensor: Mapping[str, Any], path: Path) -> Iterator[Finding]:
    """Findings on a sensor's focus.

    Args:
        sensor: Perhaps with faults.
        path: Where it stands.
    """
    focus = sensor.get("focus")
    if not isinstance(focus, dict):
        return
    if "lens" in sensor:
        yield Finding(
            (*path, "focus"),
            "a bent picture has no aperture here: take focus or lens away",
            at_key=True,
        )
    for key, other in _OF_IMAGING.items():
        if "imaging" in sensor and key in focus:
            yield Finding(
                (*path, "focus", key),
                f"imaging/{other} says it already: take it away here, and give it there",
                at_key=True,
            )
        elif "imaging" not in sensor and key not in focus:
            yield Finding(
                (*path, "focus"),
                f"expected the key {key}: there is no imaging, whose {other} would say it",
            )
