"""What must hold between the keys of a sensor's imaging, and between them and the sensor's."""

from __future__ import annotations

from collections.abc import Iterator

from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.node import Node
from scenec.schemas.imaging import MAX_JPEG_SIDE, MIN_DETERMINANT, MIN_WHITE, determinant
from scenec.schemas.spelling import shown


def check_imaging(sensor: Node) -> Iterator[Finding]:
    """Findings on the imaging of a sensor."""
    imaging = sensor.at("imaging")
    if imaging:
        yield from _check_exposure(sensor, imaging.at("exposure"))
        yield from _check_numbers(sensor, imaging)
        yield from _check_matrix(imaging)


def _check_exposure(sensor: Node, exposure: Node) -> Iterator[Finding]:
    kind = exposure["type"]
    if kind in ("manual", "auto") and "exposure" in sensor:
        yield sensor.key_fault(
            f'nothing reads it beside an imaging/exposure of type "{kind}": take it away, or make '
            'that "metered"',
            "exposure",
        )
    if kind == "manual" and ("iso" in exposure) == ("gain_e" in exposure):
        yield exposure.fault("expected either the key iso or the key gain_e")
    for key in ("time_range_s", "iso_range"):
        low, high = map(exposure.at(key).span, (0, 1))
        if low and high and low[1] > high[0]:
            yield exposure.fault(
                f"{low[1]:g} is above {high[0]:g}: expected the smaller one first", key
            )


def _check_numbers(sensor: Node, imaging: Node) -> Iterator[Finding]:
    bits, black, sides = imaging["bits"], imaging["black_level"], sensor["resolution"] or ()
    if bits is not None and black is not None and black >= 2**bits - 1:
        yield imaging.fault(
            f"a black level of {black} leaves no numbers of {bits} bits: expected less than "
            f"{2**bits - 1}",
            "black_level" if "black_level" in imaging else "bits",
        )
    if "jpeg" in imaging and max(sides, default=0) > MAX_JPEG_SIDE:
        yield imaging.fault(
            f"a JPEG has at most {MAX_JPEG_SIDE} pixels a side, this sensor {max(sides)}: take it "
            "away",
            "jpeg",
        )
    if imaging["raw"] and (1 in sides or imaging["mosaic"] == "none"):
        yield imaging.fault(
            "raw numbers are those behind a mosaic, and there is none: take it away", "raw"
        )


def _check_matrix(imaging: Node) -> Iterator[Finding]:
    matrix = imaging.at("color_matrix")
    # Drawn ones are looked at when they are drawn (compiler/cameras/imaging.py).
    numbers = [row.constant(column) for row in matrix.each("*") for column in range(3)]
    known = tuple(number for number in numbers if number is not None)
    if len(known) != 9:
        return
    for row in range(3):
        total = sum(known[3 * row : 3 * row + 3])
        if total < MIN_WHITE:
            yield matrix.fault(
                f"adds up to {total:g}, so white light looks black to such pixels: expected more "
                f"than {MIN_WHITE:g}",
                row,
            )
    if abs(determinant(known)) < MIN_DETERMINANT:
        yield matrix.fault(
            f"{shown(imaging['color_matrix'])} cannot be inverted: expected colors that can be "
            "told apart"
        )
