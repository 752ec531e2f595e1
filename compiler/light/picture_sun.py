"""Finds the sun of a photographed sky, takes it out, and makes it a distant light.

A renderer samples a small bright disc far better than a few texels of a picture, and shadows then
do not depend on the picture's resolution. What is taken out is what stands out from its
surroundings; the sun gets it, so that no light is lost or counted twice.

What counts as the sun: the small spot above the horizon that alone throws shadows. The brightest
texel's neighborhood, out to ``REACH_DEG``, is held against the ring out to twice that. Texels stand
out where their luminance is ``CONTRAST`` times the ring's median and twice its ninth decile. They
are a sun if hardly any of their light lies in the outer fifth of the reach (what is larger is a
window or a bright cloud), if no other spot has a quarter of their light (lamps), and if their light
is at least ``SHARE`` of what else falls on level ground (less throws no shadow one could see).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light.latlong import directions_of_rows, horizontal_irradiance, luminance
from scenec.schemas.codec import Facts
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Angle from its middle within which all of a sun lies.
REACH_DEG = 4.0
#: Least ratio of its texels to what surrounds it.
CONTRAST = 4.0
#: Least irradiance, of the sun on a surface that faces it over the rest's on level ground.
SHARE = 0.02
#: Full diameter of a sun that the picture does not resolve: the Sun's, seen from Earth.
DIAMETER_DEG = 0.53
#: A spot as small as this many texels shows the picture's resolution, not its own size.
_UNRESOLVED_TEXELS = 4.0
#: Bright spots that are compared.
_CANDIDATES = 6
#: The next bright spot has at most this part of the sun's irradiance.
_RUNNER_UP = 0.25
#: Texels around a hole that its filling is made from.
_RIM = 512


@dataclass(frozen=True)
class PictureSun:
    """The sun of a picture.

    Attributes:
        azimuth_deg: Bearing in the picture, clockwise from the direction of its first column.
        elevation_deg: Above the horizon.
        irradiance: Luminance of the irradiance on a surface that faces it.
        color: Linear Rec.709, luminance 1, [3].
        diameter_deg: Full angular diameter.
    """

    azimuth_deg: float
    elevation_deg: float
    irradiance: float
    color: NDArray[np.float64]
    diameter_deg: float


@dataclass(frozen=True)
class _Spot:
    """Texels that stand out, as flat indices into rows ``top`` and below, and what they have."""

    index: NDArray[np.int64]
    rim: NDArray[np.int64]
    irradiance: float
    reason: str


def extract_sun(
    picture: NDArray[np.float32],
) -> tuple[NDArray[np.float32], PictureSun | None, Facts]:
    """Takes the sun out of a picture, if it has one.

    The sun's direction and irradiance are those of the sum of radiance * direction over solid angle
    of what was taken out, and each channel's irradiance on level ground is kept. The hole has the
    colors of its rim, weighted by 1 / distance^2. The diameter is that of a uniform disc with the
    same (integral of L)^2 / (integral of L^2), which a faint halo does not change, and at least
    ``DIAMETER_DEG``; a spot of up to four texels has that.

    Args:
        picture: Lat-long radiance, finite and not negative, [h, w, 3].

    Returns:
        (the picture without it, the sun, facts for the report); the same picture and None where
        there is no sun: then the facts say why.
    """
    rows = picture.shape[0] // 2
    level = luminance(picture[:rows].astype(np.float64))
    if not level.size or level.max() <= 0.0:
        return picture, None, {"found": False, "why": "nothing shines from above the horizon"}
    spots = _spots(level, picture.shape[0])
    best = max(range(len(spots)), key=lambda i: spots[i].irradiance)
    spot = spots[best]
    if spot.reason:
        return picture, None, {"found": False, "why": spot.reason}
    others = [other.irradiance for i, other in enumerate(spots) if i != best]
    if max(others, default=0.0) > _RUNNER_UP * spot.irradiance:
        return picture, None, {"found": False, "why": "no bright spot outshines the others"}
    left, taken = _filled(picture, spot)
    sun, solid_angle = _sun(taken, spot.index, picture.shape)
    rest = float(luminance(horizontal_irradiance(left)))
    if sun.irradiance < SHARE * rest:
        why = "the brightest spot's shadows could not be seen"
        return picture, None, {"found": False, "why": why}
    facts = {
        "found": True,
        "azimuth_deg": sun.azimuth_deg,
        "elevation_deg": sun.elevation_deg,
        "irradiance": sun.irradiance,
        "color": sun.color.tolist(),
        "diameter_deg": sun.diameter_deg,
        "level_irradiance_of_the_rest": rest,
        "texels": len(spot.index),
        "effective_diameter_deg": _diameter_deg(solid_angle),
    }
    return left, sun, facts


def _spots(level: NDArray[np.float64], height: int) -> list[_Spot]:
    """Bright spots, the one with the brightest texel first; each excludes the next from itself.

    Args:
        level: Luminance of the rows above the horizon.
    """
    width = level.shape[1]
    open_to = level.copy()
    spots: list[_Spot] = []
    for _ in range(_CANDIDATES):
        peak = int(open_to.argmax())
        if open_to.flat[peak] <= 0.0:
            break
        row, column = divmod(peak, width)
        spots.append(_spot(open_to, height, row, column))
        top, bottom, angle = _window(height, width, _direction(height, width, row, column))
        open_to[top:bottom][angle <= REACH_DEG] = -1.0
    return spots


def _spot(level: NDArray[np.float64], height: int, row: int, column: int) -> _Spot:
    """Measures the bright spot around a texel; values below 0 belong to another spot."""
    width = level.shape[1]
    middle = _direction(height, width, row, column)
    for _ in range(3):
        # The brightest texel may lie at the edge of the disc: go on from what is bright.
        top, bottom, angle = _window(height, width, middle)
        values = level[top:bottom]
        weight = np.broadcast_to(_solid_angles(height, width)[top:bottom, None], values.shape)
        ring = (angle > REACH_DEG) & (angle <= 2.0 * REACH_DEG) & (values >= 0.0)
        if not ring.any():
            return _nothing(_COARSE)
        median, decile = _quantiles(values[ring], weight[ring], (0.5, 0.9))
        floor = max(CONTRAST * median, 2.0 * decile)
        bright = (angle <= REACH_DEG) & (values > floor)
        if not bright.any():
            return _nothing("nothing stands out from its surroundings")
        light = np.where(bright, values * weight, 0.0)
        to = directions_of_rows(height, width, top, bottom)
        middle = (light[..., None] * to).sum(axis=(0, 1))
        middle = middle / np.sqrt((middle * middle).sum())
    total = float(light.sum())
    if float(light[angle > 0.8 * REACH_DEG].sum()) > 0.05 * total:
        return _Spot(_EMPTY, _EMPTY, total, "the brightest spot is too large for a sun")
    # The rim: what adjoins the hole, or, of a hole in the middle of darkness, its surroundings.
    hole = angle[bright].max()
    texel = 180.0 / height
    # Texels beside bright ones hold a part of the disc.
    taken = _wider(bright)
    rim = ~taken & (angle <= hole + 2.5 * texel)
    if not rim.any():
        rim = ring & ~taken
    if not rim.any():
        return _nothing(_COARSE)
    found = np.flatnonzero(rim) + top * width
    return _Spot(np.flatnonzero(taken) + top * width, found[:: -(-len(found) // _RIM)], total, "")


def _wider(bright: NDArray[np.bool_]) -> NDArray[np.bool_]:
    across = bright | np.roll(bright, 1, axis=1) | np.roll(bright, -1, axis=1)
    wider = across.copy()
    wider[1:] |= across[:-1]
    wider[:-1] |= across[1:]
    return wider


_EMPTY = np.zeros(0, np.int64)
_COARSE = "the picture is too coarse to tell a sun from its surroundings"


def _nothing(why: str) -> _Spot:
    return _Spot(_EMPTY, _EMPTY, 0.0, why)


def _window(
    height: int, width: int, middle: NDArray[np.float64]
) -> tuple[int, int, NDArray[np.float64]]:
    """Rows within twice the reach of a direction, above the horizon, and the angles to it.

    Returns:
        (first row, one past the last, angles in degrees, float64 [rows, width]).
    """
    level = np.sqrt(middle[0] * middle[0] + middle[1] * middle[1])
    polar = elementary.atan2(float(level), float(middle[2])) * 180.0 / elementary.PI
    texel = 180.0 / height
    top = max(int(np.floor((polar - 2.0 * REACH_DEG) / texel)), 0)
    bottom = min(int(np.ceil((polar + 2.0 * REACH_DEG) / texel)) + 1, height // 2)
    to = directions_of_rows(height, width, top, bottom)
    dot = to[..., 0] * middle[0] + to[..., 1] * middle[1] + to[..., 2] * middle[2]
    return top, bottom, elementary.acos_array(np.clip(dot, -1.0, 1.0)) * (180.0 / elementary.PI)


def _direction(height: int, width: int, row: int, column: int) -> NDArray[np.float64]:
    return directions_of_rows(height, width, row, row + 1)[0, column]


def _quantiles(
    values: NDArray[np.float64], weight: NDArray[np.float64], at: tuple[float, ...]
) -> list[float]:
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weight[order])
    return [
        float(values[order[min(int(np.searchsorted(below, q * below[-1])), len(order) - 1)]])
        for q in at
    ]


def _solid_angles(height: int, width: int) -> NDArray[np.float64]:
    """Returns the solid angle of a texel in each row, steradians, [height]."""
    edge = elementary.cos_array(elementary.PI * np.arange(height + 1) / height)
    return (edge[:-1] - edge[1:]) * (2.0 * elementary.PI / width)


def _filled(
    picture: NDArray[np.float32], spot: _Spot
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """The picture with the hole filled, and what was taken from each of its texels, [n, 3]."""
    height, width = picture.shape[:2]
    left = picture.copy()
    flat = left.reshape(-1, 3)
    at, rim = (_of_texels(height, width, index) for index in (spot.index, spot.rim))
    values, weight = flat[spot.rim].astype(np.float64), _solid_angles(height, width)
    filling = np.zeros((len(at), 3))
    weight = weight[spot.rim // width]
    over_threads(_interpolated_part, len(at), at, rim, values, weight, filling)
    before = flat[spot.index].astype(np.float64)
    # A channel that the surroundings have more of is theirs: nothing negative is taken out.
    flat[spot.index] = np.minimum(filling, before).astype(np.float32)
    return left, before - flat[spot.index].astype(np.float64)


def _of_texels(height: int, width: int, index: NDArray[np.int64]) -> NDArray[np.float64]:
    """Directions of single texels, float64 [n, 3]."""
    row, column = index // width, index % width
    polar = elementary.PI * (row + 0.5) / height
    bearing = 2.0 * elementary.PI * (column + 0.5) / width
    level = elementary.sin_array(polar)
    return np.stack(
        [
            level * elementary.sin_array(bearing),
            level * elementary.cos_array(bearing),
            elementary.cos_array(polar),
        ],
        axis=1,
    )


@kernel
def _interpolated_part(first, last, at, points, values, weight, out):  # type: ignore[no-untyped-def]
    """Means of values at points, by weight / distance^2, at other points."""
    for i in range(first, last):
        total = 0.0
        for j in range(len(points)):
            x = at[i, 0] - points[j, 0]
            y = at[i, 1] - points[j, 1]
            z = at[i, 2] - points[j, 2]
            share = weight[j] / (x * x + y * y + z * z)
            total += share
            for k in range(3):
                out[i, k] += share * values[j, k]
        for k in range(3):
            out[i, k] /= total


def _sun(
    removed: NDArray[np.float64], index: NDArray[np.int64], shape: tuple[int, ...]
) -> tuple[PictureSun, float]:
    """The light that was taken out as a disc, and the solid angle it filled."""
    height, width = shape[:2]
    row, column = index // width, index % width
    # Integrals over each texel of the direction: of z as ``horizontal_irradiance`` has it.
    polar = elementary.PI * np.arange(height + 1) / height
    sine = elementary.sin_array(polar)
    upward = 0.5 * (sine[1:] * sine[1:] - sine[:-1] * sine[:-1]) * (2.0 * elementary.PI / width)
    # The integral of sin^2 is polar / 2 - sin(2 polar) / 4.
    across = 0.5 * polar - 0.25 * elementary.sin_array(2.0 * polar)
    across = across[1:] - across[:-1]
    edge = 2.0 * elementary.PI * np.arange(width + 1) / width
    east, north = -elementary.cos_array(edge), elementary.sin_array(edge)
    level = luminance(removed)
    vector = np.array(
        [
            (level * across[row] * (east[column + 1] - east[column])).sum(),
            (level * across[row] * (north[column + 1] - north[column])).sum(),
            (level * upward[row]).sum(),
        ]
    )
    irradiance = float(np.sqrt((vector * vector).sum()))
    upright = float(vector[2]) / irradiance
    on_level = (removed * upward[row][:, None]).sum(axis=0)
    solid = _solid_angles(height, width)[row]
    light = float((level * solid).sum())
    effective = light * light / float((level * level * solid).sum())
    texel = float((level * solid * solid).sum()) / light
    diameter = _diameter_deg(effective) if effective > _UNRESOLVED_TEXELS * texel else 0.0
    azimuth = elementary.atan2(float(vector[0]), float(vector[1])) * 180.0 / elementary.PI
    sun = PictureSun(
        azimuth_deg=azimuth + 360.0 if azimuth < 0.0 else azimuth,
        elevation_deg=elementary.asin(upright) * 180.0 / elementary.PI,
        irradiance=irradiance,
        color=on_level / (upright * irradiance),
        diameter_deg=max(diameter, DIAMETER_DEG),
    )
    return sun, effective


def _diameter_deg(solid_angle: float) -> float:
    """Full diameter of a disc: its solid angle is 4 pi sin^2(diameter / 4)."""
    sine = np.sqrt(min(solid_angle / (4.0 * elementary.PI), 1.0))
    return float(4.0 * elementary.asin(float(sine)) * 180.0 / elementary.PI)
