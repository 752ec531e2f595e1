"""Finds whether lenses are sound, and how far they see.

The formulas are those of ``scenec.schemas.lens``, here with elementary functions of our own.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas.lens import (
    BROWN_CONRADY,
    EQUIRECTANGULAR,
    KANNALA_BRANDT,
    Functions,
    Lens,
    directions,
    radial,
    reach,
    to_plane,
)

_RADIANS = elementary.PI / 180.0
#: Points of a picture's side at which its rays are looked at.
_SIDE = 65

Intrinsics = tuple[float, float, float, float, float]


def _atan2(y: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """By the arc tangent of the smaller over the larger, turned into its octant."""
    tall, wide = np.abs(y), np.abs(x)
    large = np.maximum(tall, wide)
    small = np.minimum(tall, wide)
    angle = elementary.atan_array(small / np.where(large > 0.0, large, 1.0))
    angle = np.where(tall > wide, 0.5 * elementary.PI - angle, angle)
    angle = np.where(x < 0.0, elementary.PI - angle, angle)
    return np.where(y < 0.0, -angle, angle)


#: What the compiler computes with.
FUNCTIONS = Functions(elementary.sin_array, elementary.cos_array, _atan2)


def sound_intrinsics(
    lens: Lens | None,
    resolution: tuple[int, int],
    fov_deg: float | None,
    given: Intrinsics | None = None,
) -> Intrinsics | str:
    """Intrinsics as given, or of a field of view; or why a lens cannot have such a picture."""
    found = given or lens_intrinsics(lens, resolution, fov_deg)
    fault = None if isinstance(found, str) else find_fault(lens, found, resolution)
    return fault or found


def lens_intrinsics(
    lens: Lens | None, resolution: tuple[int, int], fov_deg: float | None
) -> Intrinsics | str:
    """Intrinsics of square pixels around a field of view; of the whole sphere without one.

    Args:
        fov_deg: Horizontal field of view; None with equirectangular only.

    Returns:
        fx, fy, cx, cy, skew; or why there is no such picture.
    """
    width, height = resolution
    middle = 0.5 * width, 0.5 * height
    if fov_deg is None:
        return width / (2.0 * elementary.PI), height / elementary.PI, *middle, 0.0
    if lens is None:
        half = fov_deg * elementary.PI / 360.0
        focal = middle[0] * elementary.cos(half) / elementary.sin(half)
        return focal, focal, *middle, 0.0
    half = 0.5 * fov_deg * _RADIANS
    if lens.model == EQUIRECTANGULAR:
        return (middle[0] / half, middle[0] / half, *middle, 0.0)
    at = half
    if lens.model == BROWN_CONRADY:
        at = elementary.sin(half) / elementary.cos(half)
    # The image circle may be smaller than the picture.
    border = reach(replace(lens, max_angle=math.pi))
    if at > border * (1.0 + 1e-12):
        return (
            f"{_ends(lens, border)}; half a fov_deg of {fov_deg:g} lies beyond that: expected "
            "milder coefficients or less of a view"
        )
    focal = middle[0] / radial(lens, min(at, border))
    return focal, focal, *middle, 0.0


def find_fault(
    lens: Lens | None, intrinsics: Intrinsics, resolution: tuple[int, int]
) -> str | None:
    """Why a lens cannot be: it folds within the picture, or does not reach its corners."""
    if lens is None or lens.model == EQUIRECTANGULAR:
        return None
    border = reach(lens)
    if lens.model == KANNALA_BRANDT and border >= lens.max_angle:
        # What the picture has beyond the image circle shows nothing, and may.
        return None
    corners = np.array([(u, v) for u in (0, resolution[0]) for v in (0, resolution[1])], float)
    x, y = to_plane(matrix(intrinsics), corners[:, 0].copy(), corners[:, 1].copy())
    _, known = directions(lens, x, y, FUNCTIONS, border)
    if known.all():
        return None
    far = float(np.sqrt((x * x + y * y).max()))
    corner = f"the picture's corners lie at a radius of {far:.4g}"
    return f"{_ends(lens, border)}; {corner}: {_mend(lens)}"


def _ends(lens: Lens, border: float) -> str:
    if lens.model == KANNALA_BRANDT:
        at = f"{border / _RADIANS:.4g} degrees from the axis"
    elif border == math.inf:
        return "the distortion reaches no such radius"
    else:
        angle = elementary.atan(border) / _RADIANS
        at = f"a radius of {border:.4g} ({angle:.4g} degrees from the axis)"
    return f"the distortion folds back at {at}, where it has come to {radial(lens, border):.4g}"


def _mend(lens: Lens) -> str:
    mild = "expected milder coefficients, a longer focal length or a smaller picture"
    if lens.model == KANNALA_BRANDT:
        return f"{mild}, or a max_angle_deg before the fold"
    return mild


def matrix(intrinsics: Intrinsics) -> NDArray[np.float64]:
    """K [3, 3]."""
    fx, fy, cx, cy, skew = intrinsics
    return np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def pixel_rays(
    lens: Lens | None, intrinsics: Intrinsics, u: NDArray[np.float64], v: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Rays through points of a picture, camera axes: see ``schemas.lens.directions``."""
    return directions(lens, *to_plane(matrix(intrinsics), u, v), FUNCTIONS)


def strip_width(lens: Lens, intrinsics: Intrinsics, width: int) -> float | None:
    """Width over distance of what the row of the axis sees of a plane across the axis.

    None where a ray of its ends does not meet that plane, or hardly.
    """
    ends, known = pixel_rays(lens, intrinsics, np.array([0.0, width]), np.full(2, intrinsics[3]))
    ends /= np.sqrt((ends * ends).sum(axis=1))[:, None]
    if not known.all() or not bool((ends[:, 2] > 0.05).all()):
        return None
    across = ends[:, 0] / ends[:, 2]
    return float(across[1] - across[0])


def sight_of(
    lens: Lens, intrinsics: Intrinsics, resolution: tuple[int, int], margin: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """A cone around the axis that holds all rays of a camera with a lens, and its scale.

    Args:
        lens: The camera's.
        intrinsics: (fx, fy, cx, cy, skew), pixels.
        resolution: (width, height), pixels.
        margin: How far the picture is continued on each side, in parts of its size.

    Returns:
        Cosine and sine of the cone's half angle (that of the farthest of the border's rays: all
        lenses show what is farther from the axis farther from the principal point; panoramas have
        (-1, 0), everything); and in place of fx and fy, twice, the most pixels that an object takes
        that would take one of a pinhole's of focal length 1 (of 1 radian, for fisheyes and
        panoramas: rays near the poles of a panorama, and behind a fisheye, fill more than they
        show, and count as those beside the axis do).
    """
    fx, fy, _, _, skew = intrinsics
    focal = max(fx, fy) + abs(skew)
    if lens.model == EQUIRECTANGULAR:
        return (-1.0, 0.0), (focal, focal)
    width, height = resolution
    along = np.arange(_SIDE) / (_SIDE - 1.0) * (1.0 + 2.0 * margin) - margin
    low, high = np.full(_SIDE, -margin), np.full(_SIDE, 1.0 + margin)
    u = width * np.concatenate([along, along, low, high])
    v = height * np.concatenate([low, high, along, along])
    rays, _ = pixel_rays(lens, intrinsics, u, v)
    rays /= np.sqrt((rays * rays).sum(axis=1))[:, None]
    # Between two of the border's points a ray leads at most as far out as their distance.
    chord = np.sqrt(((rays[1:] - rays[:-1]) * (rays[1:] - rays[:-1])).sum(axis=1))
    step = float(np.max(np.delete(chord, [_SIDE - 1, 2 * _SIDE - 1, 3 * _SIDE - 1])))
    widest = elementary.acos(min(max(float(rays[:, 2].min()), -1.0), 1.0)) + step
    factor = _steepest(lens, widest)
    if widest >= elementary.PI:
        return (-1.0, 0.0), (focal * factor, focal * factor)
    return (elementary.cos(widest), elementary.sin(widest)), (focal * factor, focal * factor)


def _steepest(lens: Lens, widest: float) -> float:
    """The most a lens magnifies, along the radius and across, up to an angle to the axis."""
    border = min(reach(lens), widest)
    if lens.model == BROWN_CONRADY:
        end = min(widest, 0.5 * elementary.PI - 1e-3)
        border = min(reach(lens), elementary.sin(end) / elementary.cos(end))
    at = [border * i / (_SIDE - 1.0) for i in range(_SIDE)]
    values = [radial(lens, r) for r in at]
    most = 1.0
    for i in range(1, _SIDE):
        most = max(most, (values[i] - values[i - 1]) / (at[i] - at[i - 1]), values[i] / at[i])
    # Tangential distortion adds at most 6 |p| r.
    if lens.model == BROWN_CONRADY:
        p1, p2 = lens.coefficients[2:4]
        most += 6.0 * math.sqrt(p1 * p1 + p2 * p2) * border
    return most
