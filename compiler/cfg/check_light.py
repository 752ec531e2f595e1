"""What must hold between the keys of further suns and lamps, and between them and the rest.

Like ``check_scene``, these checks pass over what does not have the shape they look for.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.schemas.spelling import nearest, shown

#: Prims of the stage that the sun and the sky have.
_TAKEN = {"Sun": "the sun", "Dome": "the sky"}


def check_light(document: Any, spans: dict[Path, tuple[float, float]]) -> list[Finding]:
    """Findings on further suns and lamps.

    Args:
        document: A cfg, perhaps with faults.
        spans: Least and largest value of the numbers that nothing is wrong with, by path.
    """
    cfg = _mapping(document)
    light = _mapping(cfg.get("light"))
    findings = list(_check_names(light))
    for group in ("more", "lamps"):
        for name, node in _mapping(light.get(group)).items():
            if isinstance(node, dict):
                findings.extend(_check_color(("light", group, name), node, spans))
    for name, node in _mapping(light.get("lamps")).items():
        mount = _mapping(_mapping(node).get("mount"))
        path: Path = ("light", "lamps", name, "mount")
        if mount.get("type") == "rig":
            findings.extend(_check_rig(path, mount, cfg))
        elif mount.get("type") == "world":
            findings.extend(_check_aim(path, mount))
            findings.extend(_check_place(path, mount, spans))
            findings.extend(_check_place((*path, "target"), mount, spans))
    return findings


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _check_names(light: dict[str, Any]) -> Iterator[Finding]:
    """All lights stand beside each other in the stage."""
    taken = dict(_TAKEN)
    for group in ("more", "lamps"):
        for name in _mapping(light.get(group)):
            if name in taken:
                yield Finding(
                    ("light", group, name),
                    f"{shown(name)} is the name of {taken[name]} already: expected another one",
                    at_key=True,
                )
            taken.setdefault(name, f"light/{group}/{name}")


def _check_color(
    path: Path, node: dict[str, Any], spans: dict[Path, tuple[float, float]]
) -> Iterator[Finding]:
    color = node.get("color")
    if not isinstance(color, list) or len(color) != 3:
        return
    components = [spans.get((*path, "color", i)) for i in range(3)]
    if None not in components and not any(span and span[0] > 0.0 for span in components):
        yield Finding(
            (*path, "color"),
            "black cannot be scaled to what is asked for: expected a component that is always "
            "above 0",
        )


def _check_rig(path: Path, mount: dict[str, Any], cfg: dict[str, Any]) -> Iterator[Finding]:
    name, rigs = mount.get("rig"), cfg.get("rigs")
    if isinstance(name, str) and isinstance(rigs, dict) and name not in rigs:
        yield Finding((*path, "rig"), f"no rig {shown(name)}{nearest(name, rigs)}")


def _check_aim(path: Path, mount: dict[str, Any]) -> Iterator[Finding]:
    for key in ("bearing_deg", "elevation_deg"):
        if "target" in mount and key in mount:
            yield Finding(
                (*path, key),
                f"target and {key} both say where it shines: take one away",
                at_key=True,
            )


def _check_place(
    path: Path, mount: dict[str, Any], spans: dict[Path, tuple[float, float]]
) -> Iterator[Finding]:
    """The ground's height is known on the terrain only."""
    if mount.get("heights", "ground") != "ground":
        return
    for axis, key in enumerate(("x_m", "y_m")):
        size, span = spans.get(("terrain", "size_m", axis)), spans.get((*path, key))
        if size is None or span is None:
            continue
        half = 0.5 * size[0]
        if span[0] < -half or span[1] > half:
            yield Finding(
                (*path, key),
                f"reaches from {span[0]:g} m to {span[1]:g} m, but the terrain from {-half:g} m "
                f'to {half:g} m: expected a place on it, or "heights": "world"',
            )
