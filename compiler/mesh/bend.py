"""How far the ground's smooth surface gets from its grid's samples: bounds, cell by cell.

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

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.mesh.surface import _slope
from scenec.compiler.terrain.grid import HeightField
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

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


def bends(field: HeightField) -> NDArray[np.float64]:
    """The most that the smooth surface is off from the bilinear one, meters.

    Args:
        field: The grid's heights.

    Returns:
        Of each cell, and how far its kinks are off from planes, float64 [ny - 1, nx - 1, 2].
    """
    ny, nx = field.height.shape
    out = np.empty((ny - 1, nx - 1, 2))
    over_threads(_bends_part, ny - 1, np.ascontiguousarray(field.height), out)
    return out


def of_faces(
    field: HeightField, bend: NDArray[np.float64], points: NDArray[np.float64],
    faces: NDArray[np.int32],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:  # fmt: skip
    """What faces miss of the smooth surface, meters.

    Args:
        field: The grid's heights.
        bend: From ``bends``.
        points: Vertices, float64 [n, 3].
        faces: Of a hierarchy of right triangles, the grid's or finer: each is made of whole cells
            and halves of cells, or lies in one half. int32 [m, 3].

    Returns:
        The largest distance of a sample in the face from its plane, float64 [m]; how much farther
        the smooth surface gets, and what kinks are off, float64 [m, 2]; whether the face is
        as large as half a cell, bool [m]. Smaller faces hold no sample: the first is 0, and the
        second is of their cell.
    """
    samples, missed = np.zeros(len(faces)), np.zeros((len(faces), 2))
    whole = np.zeros(len(faces), bool)
    over_threads(
        _of_faces_part, len(faces),
        field.height, *field.frame(), bend, points, faces, samples, missed, whole,
    )  # fmt: skip
    return samples, missed, whole


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
        The least and the most, and how sharp its kinks can be together.
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
    kinks = 0.0
    for m, n, sharp in _KINKS:
        low, high, steepest = _range(
            m * before[0] + n * after[0], m * before[1] + n * after[1],
            m * before[2] + n * after[2], m * before[3] + n * after[3],
        )  # fmt: skip
        if low < 0.0 < high:
            kinks += sharp * steepest
    low, high, _ = _range(d0, d1, before[2] - after[2], before[3] - after[3])
    return (0.0 if low >= 0.0 else -most), (0.0 if high <= 0.0 else most), kinks


@inlined
def _range(e0, e1, p, q):  # type: ignore[no-untyped-def]
    """Bounds of a cubic from its values, p and q, and of its slope: those of its Bezier points."""
    rise = e1 - e0
    c0, c1 = e0 + (rise + p) / 3.0, e1 - (rise + q) / 3.0
    steepest = max(abs(rise + p), max(abs(rise + q), 3.0 * abs(c1 - c0)))
    return min(min(e0, e1), min(c0, c1)), max(max(e0, e1), max(c0, c1)), steepest


@kernel
def _bends_part(first, last, height, out):  # type: ignore[no-untyped-def]
    ny, nx = height.shape
    # Of four rows: the height at the cell's two columns, p, and q.
    row, rise = np.empty((4, 4)), np.empty((3, 4))
    for j in range(first, last):
        for i in range(nx - 1):
            for k in range(4):
                r = j - 1 + k
                if r < 0 or r >= ny:
                    continue
                h1, h2 = height[r, i], height[r, i + 1]
                step = h2 - h1
                # Beyond the border the surface goes on as it is.
                before = h1 - height[r, i - 1] if i > 0 else step
                after = height[r, i + 2] - h2 if i + 2 < nx else step
                row[k, 0] = h1
                row[k, 1] = h2
                row[k, 2] = _slope(before, step) - step
                row[k, 3] = _slope(step, after) - step
            for k in range(4):
                if j == 0:
                    row[0, k] = 2.0 * row[1, k] - row[2, k]
                if j + 2 == ny:
                    row[3, k] = 2.0 * row[2, k] - row[1, k]
            # Rises between the rows, below, in, and above the cell.
            for k in range(4):
                rise[0, k] = row[1, k] - row[0, k]
                rise[1, k] = row[2, k] - row[1, k]
                rise[2, k] = row[3, k] - row[2, k]
            p0, p1, first_kinks = _beyond(rise[0], rise[1])
            q0, q1, second_kinks = _beyond(rise[2], rise[1])
            across = max(_at_most(p0, q1), _at_most(p1, q0))
            along = max(_most(row[1, 2], row[1, 3]), _most(row[2, 2], row[2, 3]))
            out[j, i, 0] = along + across
            # Over a part of the cell kinks are no farther off than that part of the bend.
            out[j, i, 1] = min(_KINK * (first_kinks + second_kinks), across)


@kernel
def _of_faces_part(  # type: ignore[no-untyped-def]
    first, last, height, x0, y0, dx, dy, bend, points, faces, samples, missed, whole
):
    ny, nx = height.shape
    for f in range(first, last):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        ax, ay = (a[0] - x0) / dx, (a[1] - y0) / dy
        bx, by = (b[0] - x0) / dx - ax, (b[1] - y0) / dy - ay
        cx, cy = (c[0] - x0) / dx - ax, (c[1] - y0) / dy - ay
        det = bx * cy - by * cx
        if abs(det) < _HALF_CELL:
            i = min(max(int(ax + (bx + cx) / 3.0), 0), nx - 2)
            j = min(max(int(ay + (by + cy) / 3.0), 0), ny - 2)
            missed[f, :] = bend[j, i]
            continue
        whole[f] = True
        i0 = int(np.round(ax + min(0.0, min(bx, cx))))
        i1 = int(np.round(ax + max(0.0, max(bx, cx))))
        j0 = int(np.round(ay + min(0.0, min(by, cy))))
        j1 = int(np.round(ay + max(0.0, max(by, cy))))
        off = most = kink = 0.0
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
                bent = bend[j, i, 0]
                kink = max(kink, bend[j, i, 1])
                if least <= _HAIR:
                    # A bilinear surface gets so far from the plane through three of its corners.
                    twist = height[j, i] + height[j + 1, i + 1]
                    twist -= height[j, i + 1] + height[j + 1, i]
                    bent += 0.25 * abs(twist)
                most = max(most, bent)
        samples[f], missed[f, 0], missed[f, 1] = off, most, kink
