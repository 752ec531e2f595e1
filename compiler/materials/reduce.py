"""Reduces pictures, and measures what that costs them.

Two by two texels become their mean, in linear light for colors; so the mean stays, and what is lost
is only what varies within them. Normals are summed as vectors and brought to unit length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.materials.periodic import Plane, moments
from scenec.compiler.materials.resample import box
from scenec.compiler.materials.values import (
    Planes,
    Source,
    color_picture,
    colors,
    gray_picture,
    is_fine,
    mean_color,
    normal_picture,
    normals,
    raw,
    stored,
    unit,
)
from scenec.compiler.scene.material import ImageFile
from scenec.schemas.codec import Facts
from scenec.schemas.maps import COLORS

#: Texels to a pixel that are kept at least. With 1, picture and pixels end at the same wavelength;
#: what the renderers' bilinear lookup takes from waves that short a pixel's own average takes, too.
TEXELS_PER_PIXEL = 1.0
#: Sides are not made shorter: an average over fewer texels than this is a color, not a picture.
_SHORTEST = 8
#: Relative drift of a mean color that rounding may leave.
_DRIFT = 1e-4
#: Sides from which on every third texel along each says how normals lean.
_LARGE = 768
#: Steeper normals count as so steep: a slope beyond is no relief.
_LEAST_Z = 0.05


@dataclass(frozen=True)
class Reduced:
    """A smaller picture.

    Attributes:
        picture: It.
        factor: What its colors are to be multiplied with, so that their mean stays.
        facts: For report.json.
    """

    picture: ImageFile
    factor: tuple[float, float, float]
    facts: Facts


def halvings(high: int, wide: int, pixels: float) -> int:
    """Counts how often a picture can be halved and still have a texel to a pixel.

    Args:
        high, wide: Its sides, in texels.
        pixels: That one repeat takes.
    """
    count = 0
    while (
        high % 2 == 0
        and wide % 2 == 0
        and min(high, wide) // 2 >= max(_SHORTEST, TEXELS_PER_PIXEL * pixels)
    ):
        high, wide, count = high // 2, wide // 2, count + 1
    return count


@memoized("smaller picture")
def reduced(source: Source, kind: str, times: int) -> Reduced | None:
    """A picture of a kind of map, halved so often; None where its kind cannot be."""
    if kind in COLORS:
        if kind == "emission" and stored(source).dtype.kind == "f":
            # Beyond 1, where 8-bit codes end.
            return None
        return _color(source, times)
    if kind == "normal":
        return _normal(source, times)
    plane = raw(source)
    for _ in range(times):
        plane = box(plane)
    picture = gray_picture(plane, is_fine(source))
    return Reduced(picture, (1.0, 1.0, 1.0), {"rms_error": _rms(raw(picture), plane)})


def _color(source: Source, times: int) -> Reduced:
    planes = np.minimum(colors(source), np.float32(1.0))
    before = mean_color(planes)
    for _ in range(times):
        planes = box(planes)
    picture, brighter = color_picture(planes), 1.0
    after = mean_color(colors(picture))
    # Rounding moves the mean of a small picture; a factor of at most 1 puts it right.
    while (
        _drift(before, after)
        and min((a - b for a, b in zip(after, before, strict=True) if b > 0.0), default=0.0) < 0.0
        and brighter < 1.1
    ):
        brighter += 1.0 / 256.0
        picture = color_picture(np.minimum(planes * np.float32(brighter), np.float32(1.0)))
        after = mean_color(colors(picture))
    factor = (1.0, 1.0, 1.0)
    if _drift(before, after):
        red, green, blue = (
            min(b / a, 1.0) if a > 0.0 else 1.0 for b, a in zip(before, after, strict=True)
        )
        factor = (red, green, blue)
    found = colors(picture) * np.array(factor, np.float32)
    return Reduced(picture, factor, {"rms_error": _rms(found, planes)})


def _drift(before: tuple[float, ...], after: tuple[float, ...]) -> bool:
    return any(abs(a - b) > _DRIFT * b for a, b in zip(after, before, strict=True))


def _normal(source: Source, times: int) -> Reduced:
    vectors = normals(source)
    steep = slope_rms(vectors)
    for _ in range(times):
        vectors = box(vectors)
    vectors = unit(vectors)
    picture = normal_picture(vectors, is_fine(source))
    return Reduced(
        picture,
        (1.0, 1.0, 1.0),
        {
            "rms_error": _rms(normals(picture), vectors),
            "slope_rms": steep,
            "slope_rms_kept": slope_rms(vectors),
        },
    )


def slope_rms(vectors: Planes) -> float:
    """Root mean square of the slopes of normals; 1 is 45 degrees."""
    return rms_of(*slopes(vectors))


def rms_of(x: Plane, y: Plane) -> float:
    """Root mean square of the lengths of vectors, by their parts."""
    return float(np.sqrt(moments(np.ascontiguousarray(x * x + y * y))[0]))


def mean_lean(source: Source) -> float:
    """Mean sine of the angles by which a picture's normals lean; of a large one, of some."""
    step = 3 if min(stored(source).shape[:2]) >= _LARGE else 1
    vectors = normals(source, step)
    x, y = vectors[..., 0], vectors[..., 1]
    return moments(np.ascontiguousarray(np.sqrt(x * x + y * y)))[0]


def slopes(vectors: Planes) -> tuple[Plane, Plane]:
    """Slopes that lean normals as they do: along x and y of the picture."""
    z = np.maximum(vectors[..., 2], np.float32(_LEAST_Z))
    return np.asarray(vectors[..., 0] / z, np.float32), np.asarray(vectors[..., 1] / z, np.float32)


def _rms(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    away = (one - other).reshape(one.shape[0], -1)
    return float(np.sqrt(moments(np.ascontiguousarray(away * away))[0]))
