"""Lenses of sensors: what says how much they see, and whether they are one-to-one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.compiler.geometry.lenses import find_fault, lens_intrinsics, make_lens
from scenec.schemas.correspondence import PARTNER
from scenec.schemas.lens import COEFFICIENTS, EQUIRECTANGULAR


def check_lens(
    sensor: Mapping[str, Any], path: Path, spans: Mapping[Path, tuple[float, float]]
) -> Iterator[Finding]:
    """Findings on a sensor's lens.

    Numbers that are drawn are looked at when they are (``draw``).

    Args:
        sensor: Perhaps with faults.
        path: Where it stands.
        spans: Smallest and largest value of each sound number, by path.
    """
    cfg = sensor.get("lens")
    if not isinstance(cfg, dict) or cfg.get("type") not in COEFFICIENTS:
        return
    if "partner" in sensor:
        yield Finding(
            (*path, "partner"),
            "a sensor with a lens is no half of a rectified pair: take one of both away",
            at_key=True,
        )
    if isinstance(sensor.get("outputs"), list):
        for i, name in enumerate(sensor["outputs"]):
            if name in PARTNER:
                yield Finding(
                    (*path, "outputs", i), f'"{name}" is of rectified pairs, which have no lens'
                )
    numbers: dict[str, Any] = {"type": cfg["type"]}
    for name in (*COEFFICIENTS[cfg["type"]], "max_angle_deg"):
        if name in cfg:
            low, high = spans.get((*path, "lens", name), (0.0, 1.0))
            if low != high:
                return
            numbers[name] = low
        elif name != "max_angle_deg":
            numbers[name] = 0.0
    lens = make_lens(numbers)
    resolution = sensor.get("resolution")
    if lens is None or not isinstance(resolution, list) or not _is_resolution(resolution):
        return
    size = (resolution[0], resolution[1])
    message: str | None
    if "intrinsics" in sensor:
        given = [_number(spans, (*path, "intrinsics", key)) for key in ("fx", "fy", "cx", "cy")]
        node = sensor["intrinsics"]
        skewed = isinstance(node, dict) and "skew" in node
        given.append(_number(spans, (*path, "intrinsics", "skew")) if skewed else 0.0)
        fx, fy, cx, cy, skew = given
        if fx is None or fy is None or cx is None or cy is None or skew is None:
            return
        message = find_fault(lens, (fx, fy, cx, cy, skew), size)
    else:
        fov = _number(spans, (*path, "fov_deg"))
        if fov is None and ("fov_deg" in sensor or lens.model != EQUIRECTANGULAR):
            return
        intrinsics = lens_intrinsics(lens, size, fov)
        message = intrinsics if isinstance(intrinsics, str) else find_fault(lens, intrinsics, size)
    if message is not None:
        yield Finding((*path, "lens"), message)


def _number(spans: Mapping[Path, tuple[float, float]], path: Path) -> float | None:
    """A number that is the same in every batch, else None."""
    low, high = spans.get(path, (0.0, 1.0))
    return low if low == high else None


def _is_resolution(value: list[Any]) -> bool:
    return len(value) == 2 and all(type(side) is int and 0 < side < 65536 for side in value)
