"""Cuts a triangle mesh along the zero lines of fields, so that each face lies on one side.

The cut is crack-free and leaves no T-junction: the point where a line crosses an edge belongs to
the edge, so both its faces get the same vertex. Its place on the edge is a root of the field
itself, found by bracketing, not of the linear interpolant: the cut line's vertices lie on the true
line, and what is left is the chord error between them (and islands that cross no edge).

Crossings nearer to an end of their edge than ``SNAP`` of its length are moved to that end, which
keeps slivers out; the label line moves by at most that much.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel

#: Fraction of an edge within which a crossing snaps to its end.
SNAP = 1.0 / 32.0
_ROOT_STEPS = 8
#: Of a face that has corners on both sides.
_CROSSED = 3

Field = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class CutMesh:
    """A mesh in the making.

    Attributes:
        points: float64 [n, 3], meters.
        faces: int32 [m, 3], counter-clockwise from above.
        parents: Ends of the edge a vertex was cut from, int32 [n, 2]; (i, i) for an uncut vertex i.
        fraction: Place of a cut vertex on its edge: 0 at parents[:, 0], 1 at the other, [n].
        cell: Grid cell that a face lies in, int32 [m].
        above: For each field so far, whether the face lies on its side >= 0, bool [k, m].
        normals: Of the first g vertices, float64 [g, 3]; the others lie on edges, between parents.
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    parents: NDArray[np.int32]
    fraction: NDArray[np.float64]
    cell: NDArray[np.int32]
    above: NDArray[np.bool_]
    normals: NDArray[np.float64]

    @classmethod
    def uncut(
        cls, points: NDArray, faces: NDArray, cell: NDArray[np.int32], normals: NDArray
    ) -> CutMesh:
        """Wraps a mesh that has only its own vertices."""
        vertices = np.arange(len(points), dtype=np.int32)
        parents, above = np.stack([vertices, vertices], axis=1), np.zeros((0, len(faces)), bool)
        return cls(points, faces, parents, np.zeros(len(points)), cell, above, normals)


@dataclass(frozen=True)
class CutReport:
    """Reports what one cut did.

    Attributes:
        vertices, faces: Added by it.
        line_m: Length of the cut line on the surface's plan, meters.
        chord_error_max_m, chord_error_rms_m: Plan distance between the cut line's segments and the
            true line, at the segments' middles (to first order: |field| / |gradient|).
        snap_max_m: Largest plan distance by which a crossing was snapped.
    """

    vertices: int
    faces: int
    line_m: float
    chord_error_max_m: float
    chord_error_rms_m: float
    snap_max_m: float


def cut(
    mesh: CutMesh, field: Field, values: NDArray[np.float64] | None = None
) -> tuple[CutMesh, CutReport]:
    """Cuts along the zero line of one field.

    Args:
        field: Values at (x, y), each float64 [n]; side >= 0 counts as above.
        values: Of the field at the vertices, where they are known.

    Returns:
        The cut mesh, its ``above`` one row longer, and the report.
    """
    if values is None:
        values = field(mesh.points[:, 0], mesh.points[:, 1])
    sign = np.where(values >= 0.0, 1, -1).astype(np.int8)
    faces = mesh.faces
    crossed = np.flatnonzero(_sides(faces, sign) == _CROSSED)
    edges = _crossing_edges(faces[crossed], sign)
    fraction = _roots(mesh.points, values, edges, field)
    snap = _snap(mesh.points, edges, fraction, sign)

    # Snapping has put some vertices on the line: some faces and edges are crossed no more.
    side = _sides(faces, sign)
    crossed, whole = np.flatnonzero(side == _CROSSED), np.flatnonzero(side != _CROSSED)
    kept = sign[edges[:, 0]] * sign[edges[:, 1]] < 0
    edges, fraction = edges[kept], fraction[kept]

    count = len(mesh.points)
    new_points = _between(mesh.points, edges, fraction)
    # Once crossed, a face becomes two (the line runs through a vertex) or three.
    vertex_of_edge = _EdgeIndex(edges, count)
    pieces, origin, piece_above, segments = _split(faces[crossed], sign, vertex_of_edge)

    all_points = np.concatenate([mesh.points, new_points])
    whole_above = side[whole] > 0
    flat = np.flatnonzero(side[whole] == 0)
    if len(flat):
        # All three vertices were snapped onto the line: the middle decides.
        middle = mesh.points[faces[whole[flat]]].mean(axis=1)
        whole_above[flat] = field(middle[:, 0].copy(), middle[:, 1].copy()) >= 0.0
    above = np.concatenate(
        [
            np.concatenate([mesh.above[:, whole], mesh.above[:, crossed][:, origin]], axis=1),
            np.concatenate([whole_above, piece_above])[None, :],
        ]
    )
    result = CutMesh(
        points=all_points,
        faces=np.concatenate([faces[whole], pieces]),
        parents=np.concatenate([mesh.parents, edges]),
        fraction=np.concatenate([mesh.fraction, fraction]),
        cell=np.concatenate([mesh.cell[whole], mesh.cell[crossed][origin]]),
        above=above,
        normals=mesh.normals,
    )
    line, worst, rms = _chord_error(all_points, segments, field)
    return result, CutReport(len(edges), len(result.faces) - len(faces), line, worst, rms, snap)


@kernel
def _sides(faces, sign):  # type: ignore[no-untyped-def]
    """Side of each face by the signs of its corners, 0 if all are, or _CROSSED; int8 [m]."""
    out = np.empty(len(faces), np.int8)
    for f in range(len(faces)):
        a, b, c = sign[faces[f, 0]], sign[faces[f, 1]], sign[faces[f, 2]]
        low, high = min(a, min(b, c)), max(a, max(b, c))
        out[f] = _CROSSED if low * high < 0 else low + high
    return out


def _crossing_edges(faces: NDArray, sign: NDArray) -> NDArray[np.int32]:
    """Distinct edges (low vertex first) whose ends have opposite signs, sorted: [e, 2]."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = ends[sign[ends[:, 0]] * sign[ends[:, 1]] < 0]
    low = ends.min(axis=1).astype(np.int64)
    high = ends.max(axis=1).astype(np.int64)
    codes = np.unique(low << 32 | high)
    return np.stack([codes >> 32, codes & 0xFFFFFFFF], axis=1).astype(np.int32)


def _between(points: NDArray, edges: NDArray, fraction: NDArray) -> NDArray[np.float64]:
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    return a + fraction[:, None] * (b - a)


def _roots(points: NDArray, values: NDArray, edges: NDArray, field: Field) -> NDArray[np.float64]:
    """Fraction along each edge at which the field is zero.

    Regula falsi with the Illinois rule (Dowell and Jarratt 1971): an end that stays twice running
    has its value halved, so that both ends close in; convergence is superlinear.
    """
    start, step = points[edges[:, 0], :2], points[edges[:, 1], :2] - points[edges[:, 0], :2]
    t0, t1 = np.zeros(len(edges)), np.ones(len(edges))
    f0, f1 = values[edges[:, 0]].copy(), values[edges[:, 1]].copy()
    t = t0.copy()
    moved = np.zeros(len(edges), np.int8)
    for _ in range(_ROOT_STEPS if len(edges) else 0):
        span = f1 - f0
        t = np.where(span == 0.0, t, (t0 * f1 - t1 * f0) / np.where(span == 0.0, 1.0, span))
        at = start + t[:, None] * step
        f = field(np.ascontiguousarray(at[:, 0]), np.ascontiguousarray(at[:, 1]))
        moves_1 = (f >= 0.0) == (values[edges[:, 1]] >= 0.0)
        f0 = np.where(moves_1, np.where(moved == 1, 0.5 * f0, f0), f)
        f1 = np.where(moves_1, f, np.where(moved == -1, 0.5 * f1, f1))
        t0, t1 = np.where(moves_1, t0, t), np.where(moves_1, t, t1)
        moved = np.where(moves_1, 1, -1).astype(np.int8)
    return np.clip(t, 0.0, 1.0)


def _snap(points: NDArray, edges: NDArray, fraction: NDArray, sign: NDArray) -> float:
    """Sets ``sign`` to 0 at ends that crossings snap to; returns the largest move in plan."""
    to_low = fraction < SNAP
    to_high = fraction > 1.0 - SNAP
    sign[edges[to_low, 0]] = 0
    sign[edges[to_high, 1]] = 0
    length = _lengths(points[edges[:, 1], :2] - points[edges[:, 0], :2])
    moved = np.where(to_low, fraction, np.where(to_high, 1.0 - fraction, 0.0)) * length
    return float(moved.max(initial=0.0))


class _EdgeIndex:
    """Vertex number of the cut point on an edge."""

    def __init__(self, edges: NDArray[np.int32], first: int):
        # ``edges`` are sorted, so their codes are, too.
        self._codes = edges[:, 0].astype(np.int64) << 32 | edges[:, 1]
        self._first = first

    def __call__(self, a: NDArray, b: NDArray) -> NDArray[np.int32]:
        code = np.minimum(a, b).astype(np.int64) << 32 | np.maximum(a, b)
        return (self._first + np.searchsorted(self._codes, code)).astype(np.int32)


def _split(
    faces: NDArray, sign: NDArray, vertex_of_edge: _EdgeIndex
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.bool_], NDArray[np.int32]]:
    """Cuts faces that have vertices on both sides.

    Returns:
        Pieces int32 [p, 3]; the face each comes from, [p]; whether it is above, bool [p]; the cut
        segments int32 [s, 2].
    """
    s = sign[faces]
    rows = np.arange(len(faces))

    through = np.flatnonzero((s == 0).any(axis=1))
    f = _rolled(faces[through], np.argmax(s[through] == 0, axis=1))
    middle = vertex_of_edge(f[:, 1], f[:, 2])
    two = [
        (np.stack([f[:, 0], f[:, 1], middle], axis=1), through, sign[f[:, 1]] > 0),
        (np.stack([f[:, 0], middle, f[:, 2]], axis=1), through, sign[f[:, 2]] > 0),
    ]
    segments = [np.stack([f[:, 0], middle], axis=1)]

    across = np.flatnonzero((s != 0).all(axis=1))
    sa = s[across]
    # The lone vertex is the one whose sign differs from the other two: the opposite of the sum.
    lone = np.argmax(sa == -np.sign(sa.sum(axis=1))[:, None], axis=1)
    f = _rolled(faces[across], lone)
    left = vertex_of_edge(f[:, 0], f[:, 1])
    right = vertex_of_edge(f[:, 2], f[:, 0])
    lone_above = sign[f[:, 0]] > 0
    three = [
        (np.stack([f[:, 0], left, right], axis=1), across, lone_above),
        (np.stack([left, f[:, 1], f[:, 2]], axis=1), across, ~lone_above),
        (np.stack([left, f[:, 2], right], axis=1), across, ~lone_above),
    ]
    segments.append(np.stack([left, right], axis=1))

    pieces = np.concatenate([piece for piece, _, _ in two + three]).astype(np.int32)
    origin = np.concatenate([rows[at] for _, at, _ in two + three])
    above = np.concatenate([side for _, _, side in two + three])
    return pieces, origin, above, np.concatenate(segments).astype(np.int32)


def _rolled(faces: NDArray, first: NDArray) -> NDArray:
    """Faces with the vertex at column ``first`` moved to the front, orientation kept."""
    columns = (first[:, None] + np.arange(3)[None, :]) % 3
    return np.take_along_axis(faces, columns, axis=1)


def _chord_error(points: NDArray, segments: NDArray, field: Field) -> tuple[float, float, float]:
    """Length of the cut line and the distance of its segments' middles to the true one."""
    if not len(segments):
        return 0.0, 0.0, 0.0
    a, b = points[segments[:, 0], :2], points[segments[:, 1], :2]
    length = _lengths(b - a)
    x, y = np.ascontiguousarray(0.5 * (a + b).T)
    # Down a vertical wall a line has no length in plan.
    step = max(0.05 * float(length.max()), 1e-9)
    value = field(x, y)
    gx = (field(x + step, y) - field(x - step, y)) / (2.0 * step)
    gy = (field(x, y + step) - field(x, y - step)) / (2.0 * step)
    slope = np.sqrt(gx * gx + gy * gy)
    # Where the field is flat, first order says nothing: a segment is off by its length at most.
    error = np.minimum(np.abs(value) / np.maximum(slope, 1e-300), length)
    return float(length.sum()), float(error.max()), float(np.sqrt((error * error).mean()))


def _lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sqrt((vectors * vectors).sum(axis=1))
