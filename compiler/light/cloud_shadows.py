"""Shadows of clouds on the ground: what comes through to each place, as a picture before the sun.

The picture lies in the plane square to the sun's direction through the world's origin, so that a
texel holds for all that lies along the sun's rays through it. Each texel is one beam through the
layers, as ``beam_left`` follows it from the ground; the sun's disc softens them all as at one
distance, that of the layer's middle. What that errs: the penumbra of a cloud's base is drawn too
wide, and of its top too narrow, by half the layer's thickness over the height of its middle (27 %
of the penumbra by default).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.poses import facing
from scenec.compiler.light.cloud_fields import Cirrus, Cumulus
from scenec.compiler.light.cloud_rays import beams_left
from scenec.schemas.threads import over_threads

#: Texels of a side, at most and at least.
MOST, LEAST = 512, 4
#: Of them in the radius of the penumbra, where they are not too many.
_FINE = 1.5
#: Range of shares of the sun's light over the ground below which all of it has the middle's.
EVEN = 0.02
#: Sine of the elevation of the lowest sun whose shadows have a place: 2 degrees.
_LOWEST = 0.035
#: Points of a texel, on a side, that say how much of it lies in the disc.
_PARTS = 8


class LandBox(NamedTuple):
    """Bounds the land that shadows can fall on.

    Attributes:
        low, high: Corners of the terrain's box.
        reach_m: How far land goes on beyond it.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    reach_m: float


class Shadows(NamedTuple):
    """Holds the light that reaches the land below clouds, see ``scene.Gobo``.

    Attributes:
        picture: uint16 [h, w].
        middle_m, size_m: [2].
        texel_m: Side of a texel.
    """

    picture: NDArray[np.uint16]
    middle_m: NDArray[np.float64]
    size_m: NDArray[np.float64]
    texel_m: float


def cloud_shadows(
    to_sun: NDArray[np.float64], radius: float, cumulus: Cumulus, cirrus: Cirrus, land: LandBox
) -> Shadows | None:
    """Shadows of clouds over the land; None where there is one light on all of it.

    A terrain of so many texels that ``MOST`` do not hold them has larger ones. Of land beyond the
    terrain the picture holds as much as it has texels for, and is mirrored from there on.

    Args:
        to_sun: Unit vector.
        radius: Of the sun's disc, radians.
        cumulus, cirrus: The layers.
        land: Where they can fall.
    """
    if cumulus.extinction <= 0.0 or to_sun[2] < _LOWEST:
        return None
    axes = facing(to_sun)[:, :2]
    low, high = _extent(axes, land, 0.0)
    beyond = _extent(axes, land, land.reach_m)
    blur = (cumulus.base_m + 0.5 * cumulus.thickness_m) / to_sun[2] * radius
    texel = max(blur / _FINE, float((high - low).max()) / MOST)
    counts = np.clip(np.ceil((beyond[1] - beyond[0]) / texel), LEAST, MOST).astype(np.int64)
    middle = 0.5 * (low + high)
    disc = _disc(blur / texel)
    rim = len(disc) // 2
    left = _beams(to_sun, axes, middle, counts + 2 * rim, texel, cumulus, cirrus)
    width, height = counts
    shares = np.zeros((height, width))
    for j, i in np.argwhere(disc > 0.0):
        shares += disc[j, i] * left[j : j + height, i : i + width]
    if float(shares.max() - shares.min()) < EVEN:
        return None
    codes = np.floor(np.clip(shares, 0.0, 1.0) * 65535.0 + 0.5).astype(np.uint16)
    return Shadows(codes, middle, counts * texel, texel)


def _extent(
    axes: NDArray[np.float64], land: LandBox, reach_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the extent of the land's box along two axes: least and most, [2] each."""
    out = np.array([reach_m, reach_m, 0.0])
    corners = np.stack([np.array(land.low) - out, np.array(land.high) + out])
    along = corners[:, :, None] * axes
    return along.min(axis=0).sum(axis=0), along.max(axis=0).sum(axis=0)


def _beams(
    to_sun: NDArray[np.float64],
    axes: NDArray[np.float64],
    middle: NDArray[np.float64],
    counts: NDArray[np.int64],
    texel: float,
    cumulus: Cumulus,
    cirrus: Cirrus,
) -> NDArray[np.float64]:
    """Returns the transmission of beams through texels' centers, top row first, float64 [h, w]."""
    width, height = counts
    x = middle[0] + texel * (np.arange(width) + 0.5 - 0.5 * width)
    y = middle[1] - texel * (np.arange(height) + 0.5 - 0.5 * height)
    at = x[None, :, None] * axes[:, 0] + y[:, None, None] * axes[:, 1]
    # Down the beam to z = 0, where ``beam_left`` begins.
    places = (at - (at[..., 2:] / to_sun[2]) * to_sun)[..., :2].reshape(-1, 2)
    left = np.empty(len(places))
    over_threads(beams_left, len(places), to_sun, places, cumulus, cirrus, left)
    return left.reshape(height, width)


def _disc(radius: float) -> NDArray[np.float64]:
    """Shares of a disc's area in the texels about its middle, float64 [2 n + 1, 2 n + 1]."""
    rim = int(np.ceil(radius - 0.5)) if radius > 0.5 else 0
    side = 2 * rim + 1
    place = (np.arange(side * _PARTS) + 0.5) / _PARTS - 0.5 * side
    inside = place[:, None] * place[:, None] + place * place <= max(radius * radius, 0.25)
    shares = inside.reshape(side, _PARTS, side, _PARTS).sum(axis=(1, 3)).astype(np.float64)
    return shares / shares.sum()
