"""What must hold between the keys of a sensor's imaging, and between them and the sensor's.

Like ``check_scene``, these checks pass over what does not have the shape they look for.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.schemas.imaging import MAX_JPEG_SIDE, MIN_DETERMINANT, MIN_WHITE, determinant
from scenec.schemas.spelling import shown

Spans = dict[Path, tuple[float, float]]

#: Of the schema, where the cfg is silent.
_BITS, _BLACK = 12, 64


def check_imaging(document: Any, spans: Spans) -> list[Finding]:
    """Findings on the imaging of all sensors.

    Args:
        document: A cfg, perhaps with faults.
        spans: Least and largest value of the numbers that nothing is wrong with, by path.
    """
    findings: list[Finding] = []
    for rig, node in _mapping(_mapping(document).get("rigs")).items():
        for name, sensor in _mapping(_mapping(node).get("sensors")).items():
            imaging = _mapping(sensor).get("imaging")
            if isinstance(imaging, dict):
                path: Path = ("rigs", rig, "sensors", name)
                findings.extend(_check_exposure(path, sensor, imaging, spans))
                findings.extend(_check_numbers(path, sensor, imaging, spans))
                findings.extend(_check_matrix((*path, "imaging", "color_matrix"), imaging, spans))
    return findings


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _check_exposure(
    path: Path, sensor: dict[str, Any], imaging: dict[str, Any], spans: Spans
) -> Iterator[Finding]:
    exposure = _mapping(imaging.get("exposure"))
    kind = exposure.get("type", "metered")
    below: Path = (*path, "imaging", "exposure")
    if kind in ("manual", "auto") and "exposure" in sensor:
        yield Finding(
            (*path, "exposure"),
            f'nothing reads it beside an imaging/exposure of type "{kind}": take it away, or make '
            'that "metered"',
            at_key=True,
        )
    if kind == "manual" and ("iso" in exposure) == ("gain_e" in exposure):
        yield Finding(below, "expected either the key iso or the key gain_e")
    for key in ("time_range_s", "iso_range"):
        low, high = (spans.get((*below, key, i)) for i in (0, 1))
        if low is not None and high is not None and low[1] > high[0]:
            yield Finding(
                (*below, key), f"{low[1]:g} is above {high[0]:g}: expected the smaller one first"
            )


def _check_numbers(
    path: Path, sensor: dict[str, Any], imaging: dict[str, Any], spans: Spans
) -> Iterator[Finding]:
    bits, black = imaging.get("bits", _BITS), imaging.get("black_level", _BLACK)
    if isinstance(bits, int) and isinstance(black, int) and 8 <= bits <= 16:
        largest = 2**bits - 1
        if black >= largest:
            yield Finding(
                (*path, "imaging", "black_level" if "black_level" in imaging else "bits"),
                f"a black level of {black} leaves no numbers of {bits} bits: expected less than "
                f"{largest}",
            )
    shape = sensor.get("resolution")
    thin = isinstance(shape, list) and 1 in shape
    sides = [side for side in shape if isinstance(side, int)] if isinstance(shape, list) else []
    if "jpeg" in imaging and max(sides, default=0) > MAX_JPEG_SIDE:
        yield Finding(
            (*path, "imaging", "jpeg"),
            f"a JPEG has at most {MAX_JPEG_SIDE} pixels a side, this sensor {max(sides)}: take it "
            "away",
        )
    if imaging.get("raw") is True and (thin or imaging.get("mosaic") == "none"):
        yield Finding(
            (*path, "imaging", "raw"),
            "raw numbers are those behind a mosaic, and there is none: take it away",
        )


def _check_matrix(path: Path, imaging: dict[str, Any], spans: Spans) -> Iterator[Finding]:
    found = [spans.get((*path, row, column)) for row in range(3) for column in range(3)]
    # Drawn ones are looked at when they are drawn (compiler/cameras/imaging.py).
    numbers = [span[0] for span in found if span is not None and span[0] == span[1]]
    if len(numbers) != 9:
        return
    for row in range(3):
        total = sum(numbers[3 * row : 3 * row + 3])
        if total < MIN_WHITE:
            yield Finding(
                (*path, row),
                f"adds up to {total:g}, so white light looks black to such pixels: expected more "
                f"than {MIN_WHITE:g}",
            )
    if abs(determinant(tuple(numbers))) < MIN_DETERMINANT:
        yield Finding(
            path,
            f"{shown(imaging['color_matrix'])} cannot be inverted: expected colors that can be "
            "told apart",
        )
