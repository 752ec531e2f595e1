"""Bounds how far the ground's smooth surface gets from its grid's samples, cell by cell.

Within a cell the surface of ``surface.py`` is a cubic along the rows of samples, and another one
across them, each with limited slopes. Its *bend* is how far it gets from the bilinear surface of
the cell's corners. In one dimension, where p and q are what the slopes at the ends have beyond the
cell's rise, it is t (1 - t) ((1 - t) p - t q). Along rows p and q are known. Across rows they
depend on where between the columns one is, and are bounded by what the rows can be there. So the
samples around the cell count in full: a cliff beside it bends it, too.

Where a slope across rows reaches its limit between the columns, the surface has a *kink* there.
Triangles whose legs are a part s of the cell miss s of the kinks, and s^3 of a cubic where it is
known at the middles of their edges.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.mesh.surface import _slope
from scenec.compiler.terrain.grid import HeightField
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

#: Largest t (1 - t)^2 in [0, 1], at 1/3.
_ONE_END = 4.0 / 27.0
#: Sums of so much of the rises before and after a sample: where one is 0, the limited slope (their
#: mean up to three times the smaller one) has a kink, so many times as sharp as the sum is steep.
_KINKS = (
    (1.0, 0.0, 6.0), (0.0, 1.0, 6.0),
    (5.0, -1.0, 0.5), (1.0, -5.0, 0.5), (7.0, 1.0, 0.5), (1.0, 7.0, 0.5),
)  # fmt: skip
#: What a kink across a distance is off from the line through its ends, at its middle; distances in
#: a triangle of leg 1; and what a slope across rows counts with at most.
_KINK = 0.25 * 1.4142135623730951 * _ONE_END
#: Twice the area in cells below which a triangle lies within half of a cell.
_HALF_CELL = 0.75
_HAIR = 1e-9


class Missed(NamedTuple):
    """What faces miss of the smooth surface.

    Attributes:
        samples: The largest distance of a sample in the face from its plane, meters, float64 [m].
        bend: How much farther the smooth surface gets, meters, float64 [m].
        kink: What kinks are off; of whole cells, where points see no more of a cubic than of kinks,
            the bend; meters, float64 [m].
        cell: Cell that a face lies within, -1 for one of whole cells and halves; int32 [m]. Those
            hold no sample, and their bend is their cell's.
    """

    samples: NDArray[np.float64]
    bend: NDArray[np.float64]
    kink: NDArray[np.float64]
    cell: NDArray[np.int32]


def bends(field: HeightField) -> NDArray[np.float64]:
    """The most that the smooth surface is off from the bilinear one, meters.

    Args:
        field: The grid's heights.

    Returns:
        Of each cell, float64 [ny - 1, nx - 1].
    """
    ny, nx = field.height.shape
    out = np.empty((ny - 1, nx - 1))
    over_threads(_bends_part, ny - 1, np.ascontiguousarray(field.height), out)
    return out


def of_faces(field: HeightField, points: NDArray[np.float64], faces: NDArray[np.int32]) -> Missed:
    """What faces miss of the smooth surface.

    Args:
        field: The grid's heights.
        points: Vertices, float64 [n, 3].
        faces: Of a hierarchy of right triangles, the grid's or finer: each is made of whole cells
            and halves of cells, or lies in one half. int32 [m, 3].
    """
    height, count = np.ascontiguousarray(field.height), len(faces)
    samples, bent, kinks = np.zeros((3, count))
    missed = Missed(samples, bent, kinks, np.full(count, -1, np.int32))
    bend = bends(field)
    over_threads(_of_faces_part, count, height, field.frame(), bend, points, faces, missed)
    # Kinks take as long as all the rest: only those of cells with smaller faces.
    within = np.flatnonzero(missed.cell >= 0)
    kink = np.full(bend.size, np.nan)
    kink[missed.cell[within]] = 0.0
    cells = np.flatnonzero(kink == 0.0)
    over_threads(_kinks_part, len(cells), height, cells, kink, least=POINTS)
    missed.kink[within] = kink[missed.cell[within]]
    return missed


@inlined
def _most(p: float, q: float) -> float:
    """Largest absolute t (1 - t) ((1 - t) p - t q) in [0, 1]."""
    # From the end where it is steeper.
    if abs(p) < abs(q):
        p, q = q, p
    if p == 0.0:
        return 0.0
    # With p = 1 its derivative is 0 where 1 - 2 (2 + r) t + 3 (1 + r) t^2 is.
    r = q / p
    root = np.sqrt(1.0 + r + r * r)
    most = 0.0
    for divisor in (2.0 + r + root, 2.0 + r - root):
        if divisor > 1.0:
            t = 1.0 / divisor
            most = max(most, abs(p * t * (1.0 - t) * (1.0 - t - t * r)))
    return most


@inlined
def _at_most(p: float, q: float) -> float:
    """No less than ``_most``, from its ends one by one."""
    a, b = abs(p), abs(q)
    if p * q >= 0.0:
        return _ONE_END * max(a, b)
    return min(0.25 * max(a, b), _ONE_END * (a + b))


@inlined
def _beyond(before, after):  # type: ignore[no-untyped-def]
    """What a slope across rows has beyond the rise after it, anywhere between two columns.

    A slope limited to three times the smaller rise differs from the rise after it by at most half
    of the rises' difference, or by what this rise is larger than three times the one before; toward
    the latter.

    Args:
        before, after: Rises at both columns, and p and q of the rises between them.

    Returns:
        The least and the most.
    """
    d0, d1 = before[0] - after[0], before[1] - after[1]
    bent = _at_most(before[2] - after[2], before[3] - after[3])
    most = 0.5 * (max(abs(d0), abs(d1)) + bent)
    by_one = _at_most(after[2], after[3])
    steep = max(abs(after[0]), abs(after[1])) + by_one
    if before[0] * before[1] > 0.0:
        # But for the rows' bends the difference is convex: largest at an end.
        ends = max(abs(after[0]) - 3.0 * abs(before[0]), abs(after[1]) - 3.0 * abs(before[1]))
        steep = min(steep, ends + by_one + 3.0 * _at_most(before[2], before[3]))
    # At most the rises' difference in any case.
    most = max(most, min(steep, 2.0 * most))
    low, high, _ = _range(d0, d1, before[2] - after[2], before[3] - after[3])
    return (0.0 if low >= 0.0 else -most), (0.0 if high <= 0.0 else most)


@inlined
def _sharpness(before, after):  # type: ignore[no-untyped-def]
    """How sharp the kinks of such a slope can be together."""
    kinks = 0.0
    for m, n, sharp in _KINKS:
        low, high, steepest = _range(
            m * before[0] + n * after[0], m * before[1] + n * after[1],
            m * before[2] + n * after[2], m * before[3] + n * after[3],
        )  # fmt: skip
        if low < 0.0 < high:
            kinks += sharp * steepest
    return kinks


@inlined
def _range(e0, e1, p, q):  # type: ignore[no-untyped-def]
    """Bounds of a cubic from its values, p and q, and of its slope: those of its Bezier points."""
    rise = e1 - e0
    c0, c1 = e0 + (rise + p) / 3.0, e1 - (rise + q) / 3.0
    steepest = max(abs(rise + p), max(abs(rise + q), 3.0 * abs(c1 - c0)))
    return min(min(e0, e1), min(c0, c1)), max(max(e0, e1), max(c0, c1)), steepest


@inlined
def _read(height, r, i, rows, at):  # type: ignore[no-untyped-def]
    """Reads row r over the cells of column i: heights at both ends, p, and q.

    Beyond the border the surface goes on as it is.

    Args:
        height: Samples, float64 [ny, nx].
        r: A row, or the next one beyond the border: those two inside are read before it.
        i: The column.
        rows: Of four rows in turn, float64 [4, n, 4]: receives it.
        at: Where.
    """
    ny, nx = height.shape
    into = rows[r % 4, at]
    if r < 0 or r >= ny:
        inward = 1 if r < 0 else -1
        for k in range(4):
            into[k] = 2.0 * rows[(r + inward) % 4, at, k] - rows[(r + 2 * inward) % 4, at, k]
        return
    h1, h2 = height[r, i], height[r, i + 1]
    step = h2 - h1
    before = h1 - height[r, i - 1] if i > 0 else step
    after = height[r, i + 2] - h2 if i + 2 < nx else step
    into[0], into[1] = h1, h2
    into[2], into[3] = _slope(before, step) - step, _slope(step, after) - step


@inlined
def _rise(rows, j, at):  # type: ignore[no-untyped-def]
    """From row j to the next."""
    low, high = rows[j % 4, at], rows[(j + 1) % 4, at]
    return high[0] - low[0], high[1] - low[1], high[2] - low[2], high[3] - low[3]


@inlined
def _across(rows, j, at):  # type: ignore[no-untyped-def]
    """The most that a cell of row j bends across rows: by the rises below, in, and above it."""
    rise = _rise(rows, j, at)
    p0, p1 = _beyond(_rise(rows, j - 1, at), rise)
    q0, q1 = _beyond(_rise(rows, j + 1, at), rise)
    return max(_at_most(p0, q1), _at_most(p1, q0))


@kernel
def _bends_part(first, last, height, out):  # type: ignore[no-untyped-def]
    columns = out.shape[1]
    rows, along = np.empty((4, columns, 4)), np.empty((2, columns))
    for i in range(columns):
        for r in (first, first + 1, first - 1):
            _read(height, r, i, rows, i)
        along[first % 2, i] = _most(rows[first % 4, i, 2], rows[first % 4, i, 3])
    for j in range(first, last):
        upper = (j + 1) % 4
        for i in range(columns):
            _read(height, j + 2, i, rows, i)
            along[(j + 1) % 2, i] = _most(rows[upper, i, 2], rows[upper, i, 3])
            out[j, i] = max(along[0, i], along[1, i]) + _across(rows, j, i)


@kernel
def _kinks_part(first, last, height, cells, kink):  # type: ignore[no-untyped-def]
    """Of some cells, how far their kinks are off from planes: no farther than that part bends."""
    rows = np.empty((4, 1, 4))
    for n in range(first, last):
        j, i = divmod(cells[n], height.shape[1] - 1)
        for r in (j, j + 1, j - 1, j + 2):
            _read(height, r, i, rows, 0)
        rise = _rise(rows, j, 0)
        below = _sharpness(_rise(rows, j - 1, 0), rise)
        above = _sharpness(_rise(rows, j + 1, 0), rise)
        kink[cells[n]] = min(_KINK * (below + above), _across(rows, j, 0))


@kernel
def _of_faces_part(first, last, height, frame, bend, points, faces, missed):  # type: ignore[no-untyped-def]
    ny, nx = height.shape
    x0, y0, dx, dy = frame
    for f in range(first, last):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        ax, ay = (a[0] - x0) / dx, (a[1] - y0) / dy
        bx, by = (b[0] - x0) / dx - ax, (b[1] - y0) / dy - ay
        cx, cy = (c[0] - x0) / dx - ax, (c[1] - y0) / dy - ay
        det = bx * cy - by * cx
        if abs(det) < _HALF_CELL:
            i = min(max(int(ax + (bx + cx) / 3.0), 0), nx - 2)
            j = min(max(int(ay + (by + cy) / 3.0), 0), ny - 2)
            missed.bend[f], missed.cell[f] = bend[j, i], j * (nx - 1) + i
            continue
        i0 = int(np.round(ax + min(0.0, min(bx, cx))))
        i1 = int(np.round(ax + max(0.0, max(bx, cx))))
        j0 = int(np.round(ay + min(0.0, min(by, cy))))
        j1 = int(np.round(ay + max(0.0, max(by, cy))))
        off = most = 0.0
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                u = ((i - ax) * cy - (j - ay) * cx) / det
                v = ((j - ay) * bx - (i - ax) * by) / det
                if u >= -_HAIR and v >= -_HAIR and u + v <= 1.0 + _HAIR:
                    plane = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                    off = max(off, abs(height[j, i] - plane))
                if i == i1 or j == j1:
                    continue
                # The cell's middle lies inside, or on an edge: then half of the cell does.
                u += (0.5 * cy - 0.5 * cx) / det
                v += (0.5 * bx - 0.5 * by) / det
                least = min(u, min(v, 1.0 - u - v))
                if least < -_HAIR:
                    continue
                bent = bend[j, i]
                if least <= _HAIR:
                    # A bilinear surface gets so far from the plane through three of its corners.
                    twist = height[j, i] + height[j + 1, i + 1]
                    twist -= height[j, i + 1] + height[j + 1, i]
                    bent += 0.25 * abs(twist)
                most = max(most, bent)
        missed.samples[f], missed.bend[f], missed.kink[f] = off, most, most
