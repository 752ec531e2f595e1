"""Lenses: from pixels to rays and back, the same formulas for compiler, backends and datasets.

A camera's K takes points of a *plane* to pixels: u = fx x + s y + cx, v = fy y + cy. A lens says
which ray a point (x, y) of the plane belongs to, camera axes x right, y down, z forward:

``None`` (a pinhole)
    (x, y) = (X/Z, Y/Z).
``brown_conrady``
    With (a, b) = (X/Z, Y/Z) and r^2 = a^2 + b^2, x = a L + 2 p1 a b + p2 (r^2 + 2 a^2) and
    y = b L + p1 (r^2 + 2 b^2) + 2 p2 a b, where
    L = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) (Conrady 1919; Brown 1966;
    the rational model and the order k1, k2, p1, p2, k3, k4, k5, k6 are OpenCV's).
``kannala_brandt``
    The ray at the angle t to the axis lies at the distance t (1 + k1 t^2 + k2 t^4 + k3 t^6 +
    k4 t^8) from (0, 0), towards (X, Y) (Kannala and Brandt 2006; OpenCV's ``fisheye``, whose alpha
    is s / fx).
``equirectangular``
    x is the longitude atan2(X, Z), y the latitude atan2(Y, hypot(X, Z)), radians, down positive.

OpenCV's pixels have their centers at whole numbers: its cx and cy are ours less 1/2.

Where a lens is not one-to-one there is no telling which ray a point belongs to. ``reach`` says how
far from the axis it is for certain:

* Without p1 and p2, up to the first zero of the radial function's derivative (or pole), isolated
  as a root of a polynomial.
* With them, while 6 |p| R stays below the least of the derivative and L up to the radius R. The
  tangential part's Jacobian has a norm of at most 6 |p| r, and the inverse of the radial part is
  Lipschitz with one over that least: a sum of both is one-to-one on such a disc, and
  a -> radial^-1(x - tangential(a)) contracts, which is what the solver falls back to where a step
  of Newton's does not help.

What is radial is solved by Newton's method within a bracket that always holds the root, so that it
ends wherever it starts. Arithmetic but for sin, cos and atan2, which the caller gives: the compiler
has its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel

Array = NDArray[np.float64]

BROWN_CONRADY = "brown_conrady"
KANNALA_BRANDT = "kannala_brandt"
EQUIRECTANGULAR = "equirectangular"
#: Coefficients of each model, in OpenCV's order.
COEFFICIENTS: dict[str, tuple[str, ...]] = {
    BROWN_CONRADY: ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    KANNALA_BRANDT: ("k1", "k2", "k3", "k4"),
    EQUIRECTANGULAR: (),
}
#: Rounding of a border: rays that lie less than this beyond it, relatively, are taken.
_ROUNDING = 1e-12
#: No radius squared beyond it is looked at: a millionth of a radian from the eye's own plane.
_FARTHEST = 1e12
#: How far before a pole a lens ends, of the radius squared.
_BEFORE_POLE = 1e-8
#: Radii at which tangential distortion is held against the radial one.
_RADII = 4096


@dataclass(frozen=True)
class Lens:
    """A lens; see the module for its formulas.

    Attributes:
        model: One of ``COEFFICIENTS``.
        coefficients: In OpenCV's order.
        max_angle: Of kannala_brandt, radians: the border of the image circle. Beyond it there are
            no rays.
    """

    model: str
    coefficients: tuple[float, ...]
    max_angle: float = math.pi

    @property
    def planar(self) -> bool:
        """Whether all rays go forward, so that they are given with z = 1."""
        return self.model == BROWN_CONRADY


@dataclass(frozen=True)
class Functions:
    """Elementary functions of arrays."""

    sin: Callable[[Array], Array]
    cos: Callable[[Array], Array]
    atan2: Callable[[Array, Array], Array]


NUMPY = Functions(np.sin, np.cos, np.arctan2)


@kernel
def _radial(c, r):  # type: ignore[no-untyped-def]
    """The radial part of Brown and Conrady's model, and its derivative."""
    s = r * r
    above = 1.0 + s * (c[0] + s * (c[1] + s * c[4]))
    below = 1.0 + s * (c[5] + s * (c[6] + s * c[7]))
    slope_above = 2.0 * r * (c[0] + s * (2.0 * c[1] + s * 3.0 * c[4]))
    slope_below = 2.0 * r * (c[5] + s * (2.0 * c[6] + s * 3.0 * c[7]))
    factor = above / below
    return r * factor, factor + r * (slope_above - factor * slope_below) / below


@kernel
def _fisheye(c, t):  # type: ignore[no-untyped-def]
    """Kannala and Brandt's distance at an angle, and its derivative."""
    s = t * t
    value = t * (1.0 + s * (c[0] + s * (c[1] + s * (c[2] + s * c[3]))))
    slope = 1.0 + s * (3.0 * c[0] + s * (5.0 * c[1] + s * (7.0 * c[2] + s * 9.0 * c[3])))
    return value, slope


@kernel
def _solve(fisheye, c, reach, distance):  # type: ignore[no-untyped-def]
    """The radius (or angle) at which a monotonic function has a value; inf beyond ``reach``."""
    if distance == 0.0:
        return 0.0
    low, high = 0.0, min(reach, max(distance, 1e-300))
    value = _fisheye(c, high)[0] if fisheye else _radial(c, high)[0]
    while not value >= distance:
        # Within a rounding of the border it is the border's.
        if high >= reach:
            return reach if value >= distance * (1.0 - _ROUNDING) else np.inf
        if high > 1e150:
            return np.inf
        low, high = high, min(2.0 * high, reach)
        value = _fisheye(c, high)[0] if fisheye else _radial(c, high)[0]
    at = min(max(distance, low), high)
    for step_number in range(200):
        value, slope = _fisheye(c, at) if fisheye else _radial(c, at)
        if value < distance:
            low = at
        else:
            high = at
        step = at - (value - distance) / slope
        # Bisected now and then, or a step of Newton's might creep along a steep end.
        if not low <= step <= high or step_number % 8 == 7:
            step = 0.5 * (low + high)
        if abs(step - at) <= 1e-16 * at:
            return step
        at = step
    return at


@kernel
def _tangential(c, a, b):  # type: ignore[no-untyped-def]
    s = a * a + b * b
    return (
        2.0 * c[2] * a * b + c[3] * (s + 2.0 * a * a),
        c[2] * (s + 2.0 * b * b) + 2.0 * c[3] * a * b,
    )


@kernel
def _without_radial(c, reach, x, y):  # type: ignore[no-untyped-def]
    distance = np.sqrt(x * x + y * y)
    if distance == 0.0:
        return 0.0, 0.0, 0.0
    r = _solve(False, c, reach, distance)
    return x / distance * r, y / distance * r, r


@kernel
def _distorted(c, a, b):  # type: ignore[no-untyped-def]
    """A point of Brown and Conrady's plane, and the Jacobian's three numbers (it is symmetric)."""
    r = np.sqrt(a * a + b * b)
    value, slope = _radial(c, r)
    factor = value / r if r > 0.0 else 1.0
    bend = (slope - factor) / (r * r) if r > 0.0 else 0.0
    dx, dy = _tangential(c, a, b)
    xx = factor + bend * a * a + 2.0 * c[2] * b + 6.0 * c[3] * a
    xy = bend * a * b + 2.0 * c[2] * a + 2.0 * c[3] * b
    yy = factor + bend * b * b + 6.0 * c[2] * b + 2.0 * c[3] * a
    return a * factor + dx, b * factor + dy, xx, xy, yy


@kernel
def _undistort_one(c, reach, x, y):  # type: ignore[no-untyped-def]
    """(a, b, whether it is known) of a point of Brown and Conrady's plane."""
    a, b, r = _without_radial(c, reach, x, y)
    if c[2] == 0.0 and c[3] == 0.0:
        return a, b, r < np.inf
    if not r < np.inf:
        # Tangential distortion may still bring it in: begin at the border.
        away = np.sqrt(x * x + y * y)
        border = reach if reach < np.inf else 1.0
        a, b = x / away * border, y / away * border
    tiny = 1e-16 * (1.0 + np.sqrt(x * x + y * y))
    at = _distorted(c, a, b)
    dx, dy = at[0] - x, at[1] - y
    size = dx * dx + dy * dy
    for _ in range(200):
        if size <= tiny * tiny:
            break
        _, _, xx, xy, yy = at
        determinant = xx * yy - xy * xy
        na = a - (yy * dx - xy * dy) / determinant
        nb = b - (xx * dy - xy * dx) / determinant
        inside = na * na + nb * nb <= reach * reach
        at = _distorted(c, na, nb)
        ndx, ndy = at[0] - x, at[1] - y
        new = ndx * ndx + ndy * ndy
        if not (inside and new <= 0.25 * size):
            if size <= 1e4 * tiny * tiny:
                break
            tx, ty = _tangential(c, a, b)
            na, nb, r = _without_radial(c, reach, x - tx, y - ty)
            if not r < np.inf:
                return a, b, False
            at = _distorted(c, na, nb)
            ndx, ndy = at[0] - x, at[1] - y
            new = ndx * ndx + ndy * ndy
        a, b, dx, dy, size = na, nb, ndx, ndy, new
    good = size <= 1e8 * tiny * tiny and a * a + b * b <= reach * reach * (1.0 + _ROUNDING)
    return a, b, good


@kernel
def _undistort(c, reach, x, y, a, b, known):  # type: ignore[no-untyped-def]
    for n in range(x.shape[0]):
        a[n], b[n], known[n] = _undistort_one(c, reach, x[n], y[n])


@kernel
def _angles(c, reach, distance, angle):  # type: ignore[no-untyped-def]
    for n in range(distance.shape[0]):
        angle[n] = _solve(True, c, reach, distance[n])


@kernel
def _distort(c, a, b, x, y):  # type: ignore[no-untyped-def]
    for n in range(a.shape[0]):
        at = _distorted(c, a[n], b[n])
        x[n], y[n] = at[0], at[1]


def reach(lens: Lens) -> float:
    """How far from the axis a lens is one-to-one, at least.

    Returns:
        Of brown_conrady a tangent of the angle to the axis, inf if everywhere; of kannala_brandt an
        angle, radians, at most ``max_angle``; of equirectangular pi.
    """
    c = lens.coefficients
    if lens.model == EQUIRECTANGULAR:
        return math.pi
    if lens.model == KANNALA_BRANDT:
        roots = _positive_roots([(2.0 * i + 1.0) * k for i, k in enumerate((1.0, *c))])
        return min(math.sqrt(roots[0]) if roots else math.inf, lens.max_angle)
    k1, k2, p1, p2, k3, k4, k5, k6 = c
    above, below = [1.0, k1, k2, k3], [1.0, k4, k5, k6]
    # Of r A(s) / B(s), s = r^2, the derivative is ((A + 2 s A') B - 2 s A B') / B^2.
    first = _product([(1.0 + 2.0 * i) * k for i, k in enumerate(above)], below)
    second = _product(above, [2.0 * i * k for i, k in enumerate(below)])
    folds = _positive_roots([a - b for a, b in zip(first, second, strict=True)])
    # Before a pole it has come as far as anyone asks.
    poles = [(1.0 - _BEFORE_POLE) * root for root in _positive_roots(below)[:1]]
    radius = math.sqrt(min([*folds[:1], *poles])) if folds or poles else math.inf
    tangential = 6.0 * math.sqrt(p1 * p1 + p2 * p2)
    if tangential == 0.0:
        return radius
    numbers = np.array(c)
    least = 1.0
    # At r = 0 both are 1, so that no reach is longer than this.
    end = min(radius, 1.0 / tangential)
    for i in range(1, _RADII + 1):
        r = end * i / _RADII
        value, slope = _radial(numbers, r)
        least = min(least, slope, value / r)
        if least <= tangential * r:
            return end * (i - 1) / _RADII
    return end


def _product(a: Sequence[float], b: Sequence[float]) -> list[float]:
    out = [0.0] * (len(a) + len(b) - 1)
    for i, left in enumerate(a):
        for j, right in enumerate(b):
            out[i + j] += left * right
    return out


def _positive_roots(coefficients: Sequence[float]) -> list[float]:
    """Where a polynomial changes its sign between 0 and ``_FARTHEST``, ascending.

    Its coefficients from the constant one up.

    Between two neighboring zeros of its derivative a polynomial has at most one: they are bracketed
    so, from the constant up, and bisected.
    """
    c = list(coefficients)
    while c and c[-1] == 0.0:
        c.pop()
    if len(c) < 2:
        return []
    # Cauchy's bound.
    bound = 1.0 + max(abs(k / c[-1]) for k in c[:-1])
    turns = _positive_roots([i * k for i, k in enumerate(c)][1:])
    bound = min(bound, _FARTHEST)
    points = [0.0, *(t for t in turns if t < bound), bound]
    found = []
    for low, high in pairwise(points):
        rises = _value(c, low) < 0.0
        if rises == (_value(c, high) < 0.0):
            continue
        while True:
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            if (_value(c, middle) < 0.0) == rises:
                low = middle
            else:
                high = middle
        found.append(low)
    return found


def _value(c: Sequence[float], x: float) -> float:
    value = 0.0
    for k in reversed(c):
        value = value * x + k
    return value


def directions(
    lens: Lens | None, x: Array, y: Array, functions: Functions = NUMPY, extent: float | None = None
) -> tuple[Array, NDArray[np.bool_]]:
    """Rays of points of the plane, camera axes.

    Args:
        lens: The lens; None: a pinhole.
        x, y: float64 [n].
        functions: What to compute sines and cosines with.
        extent: What ``reach`` returns of the lens, where it is known already.

    Returns:
        float64 [n, 3], with z = 1 for a pinhole and brown_conrady and of length 1 for the others;
        and whether there is such a ray, bool [n]. Where there is none, it is one at the border of
        those that there are.
    """
    x, y = np.ascontiguousarray(x, np.float64), np.ascontiguousarray(y, np.float64)
    out = np.empty((len(x), 3))
    if lens is None:
        out[:, 0], out[:, 1], out[:, 2] = x, y, 1.0
        return out, np.ones(len(x), np.bool_)
    far = reach(lens) if extent is None else extent
    known = np.ones(len(x), np.bool_)
    if lens.model == BROWN_CONRADY:
        a, b = np.empty(len(x)), np.empty(len(x))
        _undistort(np.array(lens.coefficients), far, x, y, a, b, known)
        lost = np.flatnonzero(~known)
        if len(lost):
            away = np.maximum(np.sqrt(x[lost] * x[lost] + y[lost] * y[lost]), 1e-300)
            border = min(far, 1e6)
            a[lost], b[lost] = x[lost] / away * border, y[lost] / away * border
        out[:, 0], out[:, 1], out[:, 2] = a, b, 1.0
        return out, known
    if lens.model == KANNALA_BRANDT:
        distance = np.sqrt(x * x + y * y)
        angle = np.empty(len(x))
        _angles(np.array(lens.coefficients), far, distance, angle)
        known = angle < np.inf
        angle[~known] = far
        share = functions.sin(angle) / np.maximum(distance, 1e-300)
        out[:, 0], out[:, 1] = x * share, y * share
        out[:, 2] = functions.cos(angle)
        return out, known
    border = math.pi * (1.0 + _ROUNDING)
    known = (np.abs(x) <= border) & (np.abs(y) <= 0.5 * border)
    down = np.minimum(np.maximum(y, -0.5 * math.pi), 0.5 * math.pi)
    level = functions.cos(down)
    out[:, 0] = functions.sin(x) * level
    out[:, 1] = functions.sin(down)
    out[:, 2] = functions.cos(x) * level
    return out, known


def project(
    lens: Lens | None, points: Array, functions: Functions = NUMPY
) -> tuple[Array, NDArray[np.bool_]]:
    """Points of the plane where the lens shows points of space.

    Args:
        lens: The lens; None: a pinhole.
        points: Camera axes, float64 [n, 3].
        functions: What to compute angles with.

    Returns:
        float64 [n, 2], and whether the point is shown, bool [n]: not so behind a pinhole or
        brown_conrady, beyond ``reach``, and at the eye itself.
    """
    x, y, z = (np.ascontiguousarray(points[:, i], np.float64) for i in range(3))
    out = np.empty((len(x), 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        if lens is None or lens.model == BROWN_CONRADY:
            shown = z > 0.0
            a, b = x / z, y / z
            if lens is None:
                out[:, 0], out[:, 1] = a, b
                return out, shown
            far = reach(lens)
            _distort(np.array(lens.coefficients), a, b, out[:, 0], out[:, 1])
            return out, shown & (np.sqrt(a * a + b * b) <= far * (1.0 + _ROUNDING))
        level = np.sqrt(x * x + y * y)
        if lens.model == KANNALA_BRANDT:
            angle = functions.atan2(level, z)
            distance, _ = _fisheye.py_func(lens.coefficients, angle)
            share = distance / np.where(level > 0.0, level, 1.0)
            out[:, 0], out[:, 1] = x * share, y * share
            far = reach(lens)
            return out, (level + np.abs(z) > 0.0) & (angle <= far * (1.0 + _ROUNDING))
        out[:, 0] = functions.atan2(x, z)
        out[:, 1] = functions.atan2(y, np.sqrt(x * x + z * z))
        return out, level + np.abs(z) > 0.0


def radial(lens: Lens, at: float) -> float:
    """Distance from (0, 0) of a ray's point of the plane, tangential distortion left aside.

    Args:
        lens: Of brown_conrady or kannala_brandt.
        at: Tangent of the ray's angle to the axis, or that angle.
    """
    c = np.array(lens.coefficients)
    return float(_radial(c, at)[0] if lens.planar else _fisheye(c, at)[0])


def to_plane(k: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """Points of the plane of pixels, by K [3, 3]."""
    y = (v - k[1, 2]) / k[1, 1]
    return (u - k[0, 2] - k[0, 1] * y) / k[0, 0], y


def to_pixels(k: Array, plane: Array) -> Array:
    """Pixels of points of the plane, float64 [n, 2], by K [3, 3]."""
    x, y = plane[:, 0], plane[:, 1]
    return np.stack([k[0, 0] * x + k[0, 1] * y + k[0, 2], k[1, 1] * y + k[1, 2]], axis=1)


def shown_at(lens: Lens | None, k: Array, points: Array) -> Array:
    """Pixels of points in a camera's frame, float64 [n, 2], by K [3, 3]; NaN where none."""
    plane, shown = project(lens, points)
    plane[~shown] = np.nan
    return to_pixels(k, plane)
