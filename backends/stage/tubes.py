"""Triangles of tubes around curves: rings of few sides, on frames that do not twist.

A curve is sampled until the chords between samples, and the sides of the rings, are within a share
of its length of the tube. Rings have the radius at which a tube, seen from all around, is as wide
on average as the round one: a polygon's mean width is its perimeter over pi.

Only sums, products, quotients and square roots are taken: the same bits on any CPU.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel

#: Distance from the round tube as a share of a curve's longest side: half a pixel where that side
#: shows in 1000, as with subdivision surfaces.
ERROR = 5e-4
#: The curves of a prim do not get more triangles; their error is larger then.
MOST_TRIANGLES = 4_000_000
#: Samples of curves that are made tubes of at once: what takes memory.
_BLOCK = 1 << 16
#: By sides of a ring: what its radius is multiplied by, pi / n / sin(pi / n), and how far, in radii
#: of the tube, its sides and corners are off that.
_RINGS = {
    3: (1.2091995761561452, 0.3954),
    4: (1.1107207345395915, 0.2147),
    8: (1.0261721529770309, 0.0520),
    16: (1.0064545427995641, 0.0129),
    32: (1.0016081889839776, 0.0033),
}
_MOST_SIDES = max(_RINGS)
#: Most samples between two ends of a segment.
_MOST_SPLITS = 64
#: Of the cosine of half a corner's angle, below which a miter gets no longer.
_SHARPEST = 0.25


@dataclass(frozen=True)
class CurveSegments:
    """Holds segments of curves as cubic Bezier curves, those of a curve behind one another.

    Attributes:
        bezier: float64 [k, 4, 3].
        widths: At their ends, float64 [k, 2].
        curve: Which curve each is of, ascending, int64 [k].
        closed: By curve: whether its last segment ends where the first begins, bool [c].
        straight: Whether they are straight, so that no chord is off.
    """

    bezier: NDArray[np.float64]
    widths: NDArray[np.float64]
    curve: NDArray[np.int64]
    closed: NDArray[np.bool_]
    straight: bool


@dataclass(frozen=True)
class TubeLayout:
    """Holds where curves are sampled, and with how many sides.

    Attributes:
        segment: Of each sample, int64 [s]; samples of a curve stand behind one another.
        at: Place in it, 0 to 1, float64 [s].
        sides: Of each curve's rings, int64 [c].
        error: Distance from the round tubes, as a share of a curve's longest side.
    """

    segment: NDArray[np.int64]
    at: NDArray[np.float64]
    sides: NDArray[np.int64]
    error: float


@dataclass(frozen=True)
class Tubes:
    """Holds triangles of tubes; a ring at the end of one stands there twice, once for its cap.

    Attributes:
        points, normals: float32 [n, 3].
        faces: Counter-clockwise from outside, int32 [m, 3].
        curve: Of each face, int32 [m].
        sample: Of each point, int32 [n].
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int32]
    curve: NDArray[np.int32]
    sample: NDArray[np.int32]


def lay_out(segments: CurveSegments, error: float = ERROR) -> TubeLayout:
    """Chooses samples and sides; a larger error where there would be too many triangles.

    Args:
        segments: The curves.
        error: As a share of the longest side of a curve's box.
    """
    b, count = segments.bezier, len(segments.closed)
    size, radius = np.zeros((2, count, 3)), np.zeros(count)
    size[0], size[1] = np.inf, -np.inf
    np.minimum.at(size[0], segments.curve, b.min(axis=1))
    np.maximum.at(size[1], segments.curve, b.max(axis=1))
    np.maximum.at(radius, segments.curve, 0.5 * segments.widths.max(axis=1))
    longest = np.maximum((size[1] - size[0]).max(axis=1), 2.0 * radius)
    bends = np.stack([b[:, 0] - 2.0 * b[:, 1] + b[:, 2], b[:, 1] - 2.0 * b[:, 2] + b[:, 3]])
    # Of the second derivative, the largest is at an end: a chord is off by an eighth of it.
    second = 6.0 * np.sqrt((bends * bends).sum(axis=2)).max(axis=0)
    while True:
        # Half for chords, half for rings.
        tolerance = 0.5 * error * longest
        splits = np.ones(len(b), np.int64)
        if not segments.straight:
            fine = np.sqrt(second / (8.0 * np.maximum(tolerance[segments.curve], 1e-300)))
            splits = np.clip(np.ceil(fine), 1, _MOST_SPLITS).astype(np.int64)
        sides = np.full(count, _MOST_SIDES)
        for n, (_, off) in reversed(_RINGS.items()):
            sides[off * radius <= tolerance] = n
        triangles = int((2 * splits * sides[segments.curve]).sum() + (2 * sides - 4).sum())
        if triangles <= MOST_TRIANGLES or (splits.max() == 1 and sides.max() == min(_RINGS)):
            break
        error *= 1.25
    # A sample at the start of each piece, and one where the curve ends.
    last = np.flatnonzero(np.diff(segments.curve, append=-1))
    own = splits.copy()
    own[last] += ~segments.closed[segments.curve[last]]
    segment = np.repeat(np.arange(len(b)), own)
    within = np.arange(len(segment)) - np.repeat(np.cumsum(own) - own, own)
    return TubeLayout(segment, within / splits[segment], sides, error)


def make_tubes(segments: CurveSegments, layout: TubeLayout) -> Tubes:
    """Makes the triangles of curves that were laid out, in whatever pose they are."""
    curve = segments.curve[layout.segment]
    parts, first = [_NONE], 0
    for start, end in pairwise(_blocks(curve)):
        some = slice(start, end)
        centers = _positions(segments.bezier[layout.segment[some]], layout.at[some])
        ends = segments.widths[layout.segment[some]]
        radii = 0.5 * (ends[:, 0] + layout.at[some] * (ends[:, 1] - ends[:, 0]))
        closed = segments.closed[curve[some]]
        axes = _axes(curve[some], centers, closed)
        sides = layout.sides[curve[some]]
        for n in np.unique(sides).tolist():
            which = np.flatnonzero(sides == n)
            part = _tubes_of(
                n, curve[some][which], centers[which], radii[which], closed[which],
                *(each[which] for each in axes),
            )  # fmt: skip
            sample = (which[part.sample] + start).astype(np.int32)
            parts.append(replace(part, faces=part.faces + np.int32(first), sample=sample))
            first += len(part.points)
    return Tubes(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Tubes)))


_NONE = Tubes(
    np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32),
    np.zeros(0, np.int32), np.zeros(0, np.int32),
)  # fmt: skip


def _blocks(curve: NDArray[np.int64]) -> list[int]:
    """Where blocks of whole curves begin, and where the last one ends."""
    starts = np.flatnonzero(np.diff(curve, prepend=-1))
    block = starts // _BLOCK
    return [*starts[np.diff(block, prepend=-1) > 0].tolist(), len(curve)]


def _positions(b: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    t = at[:, None]
    s = 1.0 - t
    return (
        s * s * s * b[:, 0]
        + 3.0 * s * s * t * b[:, 1]
        + 3.0 * s * t * t * b[:, 2]
        + t * t * t * b[:, 3]
    )


#: Tangent, the frame's first axis, and the direction and length of the miter; [s, 3] each.
type _Axes = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def _neighbors(
    curve: NDArray[np.int64], closed: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The samples before and after each; at the ends of curves that are not closed itself."""
    index = np.arange(len(curve))
    first = np.searchsorted(curve, curve, side="left")
    last = np.searchsorted(curve, curve, side="right") - 1
    before = np.where(index > first, index - 1, np.where(closed, last, index))
    after = np.where(index < last, index + 1, np.where(closed, first, index))
    return before, after


def _axes(
    curve: NDArray[np.int64], centers: NDArray[np.float64], closed: NDArray[np.bool_]
) -> _Axes:
    """Frames of rings that turn as little as they can along a curve (double reflection).

    Wang, Juettler, Zheng and Liu 2008, "Computation of rotation minimizing frames".
    """
    before, after = _neighbors(curve, closed)
    incoming, outgoing = _unit(centers - centers[before]), _unit(centers[after] - centers)
    incoming = np.where((incoming == 0.0).all(axis=1)[:, None], outgoing, incoming)
    outgoing = np.where((outgoing == 0.0).all(axis=1)[:, None], incoming, outgoing)
    tangent = _unit(incoming + outgoing)
    flat = (tangent == 0.0).all(axis=1)
    tangent[flat] = outgoing[flat]
    tangent[(tangent == 0.0).all(axis=1)] = 0.0, 0.0, 1.0
    # Where a curve has a corner, its ring lies in the bisecting plane and is longer across it.
    cosine = np.maximum((tangent * outgoing).sum(axis=1), _SHARPEST)[:, None]
    across = _unit(outgoing - (outgoing * tangent).sum(axis=1)[:, None] * tangent)
    miter = across * np.sqrt(np.maximum(1.0 / cosine - 1.0, 0.0))
    first = np.searchsorted(curve, curve, side="left")
    rank = np.arange(len(curve)) - first
    side = np.zeros_like(tangent)
    start = np.flatnonzero(rank == 0)
    least = np.abs(tangent[start]).argmin(axis=1)
    chosen = np.eye(3)[least]
    side[start] = _unit(chosen - (chosen * tangent[start]).sum(axis=1)[:, None] * tangent[start])
    _carry(first, centers, tangent, side)
    return tangent, side, miter


@kernel
def _carry(start, centers, tangent, side):  # type: ignore[no-untyped-def]
    """Carries the first axis of each curve's frames from its first sample on, in place."""
    for k in range(start.shape[0]):
        if start[k] == k:
            continue
        old = k - 1
        step = _unit_of(_minus(centers[k], centers[old]))
        turned, way = _mirrored(side[old], step), _mirrored(tangent[old], step)
        found = _mirrored(turned, _unit_of(_minus(tangent[k], way)))
        along = _dot(found, tangent[k])
        for i in range(3):
            side[k, i] = found[i] - along * tangent[k, i]
        found = _unit_of((side[k, 0], side[k, 1], side[k, 2]))
        for i in range(3):
            side[k, i] = found[i]


@inlined
def _minus(a, b):  # type: ignore[no-untyped-def]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _mirrored(v, normal):  # type: ignore[no-untyped-def]
    twice = 2.0 * _dot(v, normal)
    return v[0] - twice * normal[0], v[1] - twice * normal[1], v[2] - twice * normal[2]


@inlined
def _unit_of(v):  # type: ignore[no-untyped-def]
    length = math.sqrt(_dot(v, v))
    if length > 0.0:
        return v[0] / length, v[1] / length, v[2] / length
    return 0.0, 0.0, 0.0


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths = np.sqrt((vectors * vectors).sum(axis=1))[:, None]
    return np.where(lengths > 0.0, vectors / np.where(lengths > 0.0, lengths, 1.0), 0.0)


def _circle(n: int) -> NDArray[np.float64]:
    """Corners of a regular polygon on the unit circle, [n, 2], counter-clockwise."""
    if n == 3:
        h = 0.5 * np.sqrt(3.0)
        return np.array([(1.0, 0.0), (-0.5, h), (-0.5, -h)])
    points = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
    while len(points) < n:
        middles = points + np.roll(points, -1, axis=0)
        middles /= np.sqrt((middles * middles).sum(axis=1))[:, None]
        points = np.stack([points, middles], axis=1).reshape(-1, 2)
    return points


def _tubes_of(
    n: int,
    curve: NDArray[np.int64],
    centers: NDArray[np.float64],
    radius: NDArray[np.float64],
    closed: NDArray[np.bool_],
    tangent: NDArray[np.float64],
    side: NDArray[np.float64],
    miter: NDArray[np.float64],
) -> Tubes:
    """Tubes of curves that have rings of n sides, all arrays by sample."""
    other = np.cross(tangent, side)
    circle = _circle(n)
    out = circle[None, :, :1] * side[:, None] + circle[None, :, 1:] * other[:, None]
    grown = out + (out * miter[:, None]).sum(axis=2)[:, :, None] * miter[:, None]
    ring = centers[:, None] + (_RINGS[n][0] * radius)[:, None, None] * grown
    count = len(curve)
    index = np.arange(count)
    _, after = _neighbors(curve, closed)
    bands = np.flatnonzero(after != index)
    # Where a curve closes, the ring that it comes back to stands turned: the nearest corner is met.
    shift = np.zeros(len(bands), np.int64)
    back = np.flatnonzero(after[bands] < bands)
    near = (out[after[bands[back]]] * out[bands[back], :1]).sum(axis=2)
    shift[back] = near.argmax(axis=1)
    j = np.arange(n)
    k = (j + 1) % n
    here, there = (bands * n)[:, None], (after[bands] * n)[:, None]
    a, b = here + j, here + k
    c, d = there + (j + shift[:, None]) % n, there + (k + shift[:, None]) % n
    lower = np.stack([a, b, c], axis=2)[radius[bands] > 0.0].reshape(-1, 3)
    upper = np.stack([b, d, c], axis=2)[radius[after[bands]] > 0.0].reshape(-1, 3)
    # Caps: rings once more, flat.
    before, _ = _neighbors(curve, closed)
    tips = [np.flatnonzero((at == index) & (radius > 0.0)) for at in (before, after)]
    lone = (before == index) & (after == index)
    tips = [tip[~lone[tip]] for tip in tips]
    points = [ring.reshape(-1, 3), *(ring[tip].reshape(-1, 3) for tip in tips)]
    normals = [out.reshape(-1, 3)]
    faces, start = [lower, upper], count * n
    for tip, sign in zip(tips, (-1.0, 1.0), strict=True):
        normals.append(np.repeat(sign * tangent[tip], n, axis=0))
        base = start + n * np.arange(len(tip))[:, None]
        ordered = np.stack([base + 0 * j[2:], base + j[1:-1], base + j[2:]], axis=2)
        faces.append((ordered if sign > 0.0 else ordered[:, :, [0, 2, 1]]).reshape(-1, 3))
        start += n * len(tip)
    sample = np.concatenate([np.repeat(index, n), *(np.repeat(tip, n) for tip in tips)])
    every = np.concatenate(faces).astype(np.int32)
    return Tubes(
        np.concatenate(points).astype(np.float32),
        np.concatenate(normals).astype(np.float32),
        every,
        curve[sample[every[:, 0]]].astype(np.int32),
        sample.astype(np.int32),
    )
