"""Declares a real camera's parameters, their names in the stage, and arithmetic of exposure.

A sensor counts electrons. Of a surface whose value in ``rgb`` is L (radiance in W/(m^2 sr) with the
spectrum of sunlight; equal channels are white), a pixel of area A behind a lens of f-number N gets,
in the time t and the channel c, by the camera equation (far from close-ups, on the axis)

    electrons = L * pi / (4 N^2) * SHARE_c * A * t * WAVELENGTH_c / (h c) * quantum efficiency_c

where SHARE_c is the channel's part of the sun's power. ISO says how many of them make the largest
number of the converter (ISO 12232:2019, saturation-based speed): those of SATURATION_LUX_S / ISO
lux seconds on the sensor. The picture shows that number as white, ``headroom`` stops above a value
of 1. So what a picture shows of a value does not depend on the size of pixels; its noise does.

The model of noise is EMVA 1288's (release 4.0, 2021): see ``scenec.backends.imaging``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

#: Light per power of sunlight, lm/W: 133.1 klx over 1361 W/m^2.
LUMENS_PER_WATT = 98.0
#: ISO 12232: a speed S has its largest signal at 78 / S lux seconds.
SATURATION_LUX_S = 78.0
#: Parts of the power of a black body of 5772 K (the sun) in 600-700, 500-600 and 400-500 nm, and
#: the mean wavelengths of that power, meters: what red, green and blue pixels count.
SHARE = (0.11295, 0.12775, 0.12559)
WAVELENGTH_M = (648.6e-9, 549.4e-9, 451.1e-9)
#: h * c, J m.
PLANCK_LIGHT = 6.62607015e-34 * 299792458.0

RULES = ("fixed", "auto", "metered")
MOSAICS = ("none", "rggb", "bggr", "grbg", "gbrg")
DEMOSAICS = ("malvar", "bilinear")
#: libjpeg's bound.
MAX_JPEG_SIDE = 65500
SUBSAMPLINGS = ("4:4:4", "4:2:2", "4:2:0")


@dataclass(frozen=True)
class Imaging:
    """A sensor's parameters at one sample; the stage has an attribute for each (``attribute``).

    What is not listed is as the key of a cfg's ``imaging`` that has its name.

    Attributes:
        pattern_seed: Key of what is the same in all its pictures (fixed pattern, defects), 64 bits.
        noise_seed: Key of the batch's noise, 64 bits.
        rule: "fixed" (``time_s`` and ``iso`` are given), "auto" (metered from each picture) or
            "metered" (from the exposure that renderers find for the camera).
        time_s, iso: Exposure time in seconds and speed; 0 but with "fixed".
        time_range_s, iso_range: What the others choose from: the time first, then the speed.
        percentile: Which percentile that is; negative: the logarithmic mean of what is lit.
        headroom: Stops between a value of 1 and the brightest that a picture shows.
        color_matrix: Row-major: what red, green and blue pixels see of linear Rec.709.
        dark_current_e_s: Electrons that come without light, a second.
        hot: Share of pixels with additional dark current, exponentially distributed ...
        hot_rate_e_s: ... around this, electrons a second.
        dead: Share of pixels that see nothing.
        mosaic: Colors of the first 2 x 2 pixels; "none": each pixel sees all three.
        vignetting_power: n in cos(angle to the axis)^n.
        vignetting_polynomial: a, b, c in 1 + a r^2 + b r^4 + c r^6, r = 1 in the farthest corner.
        bloom: Share of the light that is spread ...
        bloom_sigma_px: ... by Gaussians of this, 3 times this and 9 times this standard deviation.
        jpeg_quality: 1 to 100; 0: no JPEG.
        jpeg_subsampling: Of its colors.
    """

    pattern_seed: int = 0
    noise_seed: int = 0
    rule: str = "fixed"
    time_s: float = 0.0
    iso: float = 0.0
    time_range_s: tuple[float, float] = (0.0, 0.0)
    iso_range: tuple[float, float] = (0.0, 0.0)
    target: float = 0.18
    percentile: float = -1.0
    f_number: float = 4.0
    headroom: float = 1.0
    pixel_um: float = 3.45
    quantum_efficiency: tuple[float, float, float] = (0.5, 0.6, 0.5)
    color_matrix: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    full_well_e: float = 10500.0
    bits: int = 12
    black_level: int = 64
    shot_noise: bool = True
    read_noise_e: float = 0.0
    dark_current_e_s: float = 0.0
    prnu: float = 0.0
    dsnu_e: float = 0.0
    hot: float = 0.0
    hot_rate_e_s: float = 0.0
    dead: float = 0.0
    mosaic: str = "none"
    demosaic: str = "malvar"
    vignetting_power: int = 0
    vignetting_polynomial: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bloom: float = 0.0
    bloom_sigma_px: float = 0.0
    jpeg_quality: int = 0
    jpeg_subsampling: str = "4:2:0"
    clean: bool = False
    raw: bool = False


#: USD's type of each field's attribute.
TYPES: dict[str, str] = {
    field.name: {"int": "Int", "float": "Double", "str": "Token", "bool": "Bool"}.get(
        str(field.type), "DoubleArray"
    )
    for field in fields(Imaging)
} | {"pattern_seed": "UInt64", "noise_seed": "UInt64"}


def attribute(field: str) -> str:
    """Name of a field's attribute on a camera: ``scenec:imaging:fNumber`` for ``f_number``."""
    first, *rest = field.split("_")
    return "scenec:imaging:" + first + "".join(word.capitalize() for word in rest)


def faults(imaging: Imaging) -> list[str]:
    """Lists faults of the parameters, one line each: field, value, what was expected."""
    found = []

    def need(field: str, good: bool, expected: str) -> None:
        if not good:
            found.append(f"{attribute(field)} is {getattr(imaging, field)!r}: expected {expected}")

    for field, allowed in (
        ("rule", RULES),
        ("mosaic", MOSAICS),
        ("demosaic", DEMOSAICS),
        ("jpeg_subsampling", SUBSAMPLINGS),
    ):
        need(field, getattr(imaging, field) in allowed, " or ".join(allowed))
    for field, count in (
        ("time_range_s", 2),
        ("iso_range", 2),
        ("quantum_efficiency", 3),
        ("color_matrix", 9),
        ("white_balance", 3),
        ("vignetting_polynomial", 3),
    ):
        values = getattr(imaging, field)
        need(field, len(values) == count and all(map(math.isfinite, values)), f"{count} numbers")
    if found:
        return found
    for field in ("f_number", "pixel_um", "full_well_e"):
        need(field, 0.0 < getattr(imaging, field) < 1e12, "a number above 0")
    for field in ("quantum_efficiency", "white_balance"):
        need(field, 0.0 < min(getattr(imaging, field)) < 1e6, "numbers above 0")
    for field in (
        "read_noise_e", "dark_current_e_s", "prnu", "dsnu_e", "hot_rate_e_s",
        "vignetting_power", "bloom_sigma_px",
    ):  # fmt: skip
        need(field, 0.0 <= getattr(imaging, field) < 1e12, "0 or more")
    for field in ("hot", "dead", "bloom"):
        need(field, 0.0 <= getattr(imaging, field) <= 1.0, "0 to 1")
    need("headroom", -16.0 <= imaging.headroom <= 16.0, "-16 to 16")
    need("bits", 2 <= imaging.bits <= 16, "2 to 16")
    if 2 <= imaging.bits <= 16:
        need("black_level", 0 <= imaging.black_level < 2**imaging.bits - 1, "less than the largest")
    need("jpeg_quality", 0 <= imaging.jpeg_quality <= 100, "0 to 100")
    if abs(determinant(imaging.color_matrix)) < MIN_DETERMINANT:
        need("color_matrix", False, "one that can be inverted")
    need("color_matrix", _sees_white(imaging.color_matrix), "rows that add up to more than 0")
    if imaging.rule == "fixed":
        need("time_s", 0.0 < imaging.time_s < 1e12, "a number above 0")
        need("iso", 0.0 < imaging.iso < 1e12, "a number above 0")
    else:
        for field in ("time_range_s", "iso_range"):
            low, high = getattr(imaging, field)
            need(field, 0.0 < low <= high < 1e12, "two numbers above 0, the smaller one first")
        need("target", 0.0 < imaging.target < 1e12, "a number above 0")
        need("percentile", imaging.percentile <= 100.0, "at most 100")
    return found


#: Color matrices below are not inverted.
MIN_DETERMINANT = 1e-3
#: Least sum of a row of a color matrix.
MIN_WHITE = 1e-3


def determinant(matrix: tuple[float, ...]) -> float:
    """Computes the determinant of a row-major 3 x 3 matrix."""
    a, b, c, d, e, f, g, h, i = matrix
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def _sees_white(matrix: tuple[float, ...]) -> bool:
    return all(sum(matrix[row : row + 3]) >= MIN_WHITE for row in (0, 3, 6))


def electrons_per_value(imaging: Imaging, time_s: float) -> tuple[float, float, float]:
    """Electrons of a pixel on the axis for a value of 1 in all of its light, red, green, blue."""
    area = (imaging.pixel_um * 1e-6) * (imaging.pixel_um * 1e-6)
    onto = math.pi / (4.0 * imaging.f_number * imaging.f_number) * area * time_s
    red, green, blue = (
        onto * share * (wavelength / PLANCK_LIGHT) * efficiency
        for share, wavelength, efficiency in zip(
            SHARE, WAVELENGTH_M, imaging.quantum_efficiency, strict=True
        )
    )
    return red, green, blue


def electrons_per_lux_second(imaging: Imaging) -> float:
    """Electrons of a green pixel."""
    area = (imaging.pixel_um * 1e-6) * (imaging.pixel_um * 1e-6)
    per_joule = SHARE[1] * (WAVELENGTH_M[1] / PLANCK_LIGHT) * imaging.quantum_efficiency[1]
    return area * per_joule / LUMENS_PER_WATT


def saturation_e(imaging: Imaging, iso: float) -> float:
    """Electrons that make the converter's largest number; a pixel may not hold as many."""
    return electrons_per_lux_second(imaging) * SATURATION_LUX_S / iso


def electrons_per_number(imaging: Imaging, iso: float) -> float:
    """The gain: electrons that make one step of the converter."""
    return saturation_e(imaging, iso) / (2**imaging.bits - 1 - imaging.black_level)


def iso_of_gain(imaging: Imaging, electrons: float) -> float:
    """The speed whose gain is so many electrons a step."""
    steps = 2**imaging.bits - 1 - imaging.black_level
    return electrons_per_lux_second(imaging) * SATURATION_LUX_S / (electrons * steps)


def base_iso(imaging: Imaging) -> float:
    """The speed at which a full pixel makes the largest number; lower ones clip highlights."""
    return electrons_per_lux_second(imaging) * SATURATION_LUX_S / imaging.full_well_e


def displayed_per_value(f_number: float, time_s: float, iso: float, white: float) -> float:
    """Returns the displayed value of a value of 1: 2**exposure_ev.

    Args:
        f_number: Of the lens.
        time_s: Exposure time.
        iso: Speed.
        white: 2**headroom.
    """
    lux_s = math.pi * LUMENS_PER_WATT * time_s / (4.0 * f_number * f_number)
    return lux_s * iso / SATURATION_LUX_S * white


def time_and_iso(
    displayed: float,
    f_number: float,
    white: float,
    times: tuple[float, float],
    isos: tuple[float, float],
) -> tuple[float, float]:
    """The exposure that shows a value of 1 as ``displayed``, or nearest: time first, then speed.

    The lowest speed is kept while the time is within its limits.
    """
    product = displayed / displayed_per_value(f_number, 1.0, 1.0, white)
    time_s = product / isos[0]
    if times[0] <= time_s <= times[1]:
        return time_s, isos[0]
    time_s = min(max(time_s, times[0]), times[1])
    return time_s, min(max(product / time_s, isos[0]), isos[1])
