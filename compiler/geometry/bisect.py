"""Bisects triangles at their newest vertex where asked, and few others to keep the mesh whole.

A triangle (a, b, c) is halved from its newest vertex a to the middle of the edge bc; that middle is
the halves' newest vertex (Mitchell 1989, ACM TOMS 15). A triangle of which any edge is halved is
halved itself, its own edge bc first: marks spread until that holds, so that no vertex ever lies on
the inside of an edge. All descendants of a triangle have at most four shapes.

Any triangle mesh will do, with edges of more than two faces, too. The result does not depend on the
order in which marks spread.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.growing import Growing
from scenec.schemas.kernels import inlined, kernel

#: In place of the vertex in an edge's middle: there is none; there will be one.
_WHOLE, _MARKED = -1, -2


class Halved(NamedTuple):
    """Records what a round of halving did.

    Attributes:
        middle_of: Edge that each new vertex halves, ascending, int64 [k].
        parts: Faces that are parts of what was halved, int32 [p].
        origin: Face that each face added was a part of, int32 [a].
    """

    middle_of: NDArray[np.int64]
    parts: NDArray[np.int32]
    origin: NDArray[np.int32]


class _BisectionArrays(NamedTuple):
    """A mesh as kernels see it: the attributes of ``Bisection`` of these names."""

    faces: NDArray[np.int32]
    face_edges: NDArray[np.int32]
    edges: NDArray[np.int32]
    middles: NDArray[np.int32]


class Bisection:
    """A mesh that is halved in place, and knows its edges.

    Faces, edges and vertices keep their numbers, and new ones follow. A part of a halved face takes
    its place, the other parts follow; a halved edge stays, with a vertex in its middle.

    Attributes:
        order: The faces in the order that they would have if all parts stood where the face stood
            that was halved, int32 [m].
    """

    def __init__(self, vertices: int, faces: NDArray[np.int32]) -> None:
        """Takes faces, int32 [m, 3], to be halved at the edges opposite their first vertices."""
        face_edges, edges = _numbered(vertices, faces)
        self.vertices = vertices
        self.order = np.arange(len(faces), dtype=np.int32)
        self._faces, self._face_edges = Growing(faces.copy()), Growing(face_edges)
        self._edges = Growing(edges)
        self._middles = Growing(np.full(len(edges), _WHOLE, np.int32))

    @property
    def faces(self) -> NDArray[np.int32]:
        """Vertices of each face, the newest first, int32 [m, 3]."""
        return self._faces.rows

    @property
    def face_edges(self) -> NDArray[np.int32]:
        """Edge opposite of each of them, int32 [m, 3]; the first is the one to be halved."""
        return self._face_edges.rows

    @property
    def edges(self) -> NDArray[np.int32]:
        """Ends of the edges, the lower first, int32 [e, 2]."""
        return self._edges.rows

    @property
    def middles(self) -> NDArray[np.int32]:
        """Vertex in the middle of each edge, negative for one that is whole, int32 [e]."""
        return self._middles.rows

    def halve(self, wanted: NDArray[np.integer]) -> Halved:
        """Halves some faces, [w], and what must follow."""
        # One type of numbers: a kernel is compiled for each.
        which = wanted.astype(np.int64, copy=False)
        halved, added = _mark(self.face_edges, which, self.middles)
        middle_of = np.flatnonzero(self.middles == _MARKED)
        for rows in (self._faces, self._face_edges):
            rows.add(added)
        for rows in (self._edges, self._middles):
            rows.add(2 * len(middle_of) + added)
        before, self.order = self.order, np.empty(len(self.faces), np.int32)
        done = Halved(middle_of, np.empty(halved + added, np.int32), np.empty(added, np.int32))
        mesh = _BisectionArrays(self.faces, self.face_edges, self.edges, self.middles)
        _split(mesh, self.vertices, before, self.order, done)
        self.vertices += len(middle_of)
        return done


def bisection(points: NDArray[np.float64], faces: NDArray[np.int32]) -> Bisection:
    """A mesh whose faces are to be halved at their longest edges first.

    Args:
        points: float64 [n, 3] or [n, 2].
        faces: int32 [m, 3]; turned, not flipped. Of edges equally long (to a millionth, so that
            rounding does not choose), that of the lowest vertices is taken.
    """
    turned = faces[
        np.arange(len(faces))[:, None],
        (_longest(points, faces)[:, None] + np.arange(3)[None, :]) % 3,
    ].astype(np.int32)
    return Bisection(len(points), turned)


@kernel
def _longest(points, faces):  # type: ignore[no-untyped-def]
    """Corner opposite of each face's longest edge."""
    out = np.empty(len(faces), np.int64)
    square = np.empty(3)
    for f in range(len(faces)):
        for k in range(3):
            a, b = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            square[k] = 0.0
            for axis in range(points.shape[1]):
                d = points[a, axis] - points[b, axis]
                square[k] += d * d
        longest = max(square[0], max(square[1], square[2]))
        best = -1
        for k in range(3):
            if square[k] < longest * (1.0 - 1e-6):
                continue
            if best < 0:
                best = k
                continue
            # Both faces at an edge choose alike if they go by its vertices.
            a, b = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            c, d = faces[f, (best + 1) % 3], faces[f, (best + 2) % 3]
            if min(a, b) < min(c, d) or (min(a, b) == min(c, d) and max(a, b) < max(c, d)):
                best = k
        out[f] = best
    return out


@kernel
def _numbered(vertices, faces):  # type: ignore[no-untyped-def]
    """Edges in order of their lower vertex, then of the face that names them first."""
    first = np.zeros(vertices + 1, np.int64)
    for f in range(len(faces)):
        for k in range(3):
            first[min(faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]) + 1] += 1
    for v in range(vertices):
        first[v + 1] += first[v]
    # Each vertex has a run of slots for its edges to higher vertices, doubles not yet known.
    other = np.empty(first[vertices], np.int32)
    used = np.zeros(vertices, np.int64)
    slot = np.empty((len(faces), 3), np.int64)
    for f in range(len(faces)):
        for k in range(3):
            a, b = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            low, high = min(a, b), max(a, b)
            at = first[low]
            end = at + used[low]
            while at < end and other[at] != high:
                at += 1
            if at == end:
                other[at] = high
                used[low] += 1
            slot[f, k] = at
    number = np.empty(first[vertices], np.int32)
    edges = np.empty((used.sum(), 2), np.int32)
    count = 0
    for v in range(vertices):
        for at in range(first[v], first[v] + used[v]):
            number[at] = count
            edges[count, 0], edges[count, 1] = v, other[at]
            count += 1
    face_edges = np.empty((len(faces), 3), np.int32)
    for f in range(len(faces)):
        for k in range(3):
            face_edges[f, k] = number[slot[f, k]]
    return face_edges, edges


@kernel
def _mark(face_edges, wanted, middles):  # type: ignore[no-untyped-def]
    """Marks edges to be halved until each face with a marked edge has its first one marked.

    Returns:
        Number of faces to be halved, and by how many faces there will be more.
    """
    for f in wanted:
        middles[face_edges[f, 0]] = _MARKED
    # Sweeps to and fro: marks run along chains of faces in either direction.
    changed = True
    forward = True
    while changed:
        changed = False
        halved = added = 0
        for n in range(len(face_edges)):
            f = n if forward else len(face_edges) - 1 - n
            others = (middles[face_edges[f, 1]] == _MARKED) + (middles[face_edges[f, 2]] == _MARKED)
            if middles[face_edges[f, 0]] != _MARKED:
                if others == 0:
                    continue
                middles[face_edges[f, 0]] = _MARKED
                changed = True
            halved += 1
            added += 1 + others
        forward = not forward
    return halved, added


@inlined
def _write(mesh, at, corners, edges):  # type: ignore[no-untyped-def]
    faces, face_edges = mesh.faces, mesh.face_edges
    faces[at, 0], faces[at, 1], faces[at, 2] = corners[0], corners[1], corners[2]
    face_edges[at, 0], face_edges[at, 1], face_edges[at, 2] = edges[0], edges[1], edges[2]


@inlined
def _add_edge(mesh, at, first, second):  # type: ignore[no-untyped-def]
    mesh.edges[at, 0], mesh.edges[at, 1] = min(first, second), max(first, second)
    mesh.middles[at] = _WHOLE


@inlined
def _half(mesh, first_half, m, e, end):  # type: ignore[no-untyped-def]
    """The half of edge e, of which m is the middle's rank among the new ones, at an end of it."""
    return first_half + 2 * m + (mesh.edges[e, 1] == end)


@kernel
def _split(mesh, vertices, before, order, done):  # type: ignore[no-untyped-def]
    """Halves the marked edges, and the faces beside them.

    Args:
        mesh: ``_BisectionArrays`` with room for what is added: halves of edges in twos, then edges
            across faces. Edges are marked; of a face with any, its first.
        before: The faces in order, int32 [m].
        order: Receives the new order, int32 [m'].
        done: ``Halved``, of which the faces are received.
    """
    faces, face_edges, edges, middles = mesh
    inner, added = len(edges) - len(done.origin), 0
    first_half = inner - 2 * len(done.middle_of)
    for k in range(len(done.middle_of)):
        e = done.middle_of[k]
        middles[e] = vertices + k
        for side in range(2):
            _add_edge(mesh, first_half + 2 * k + side, edges[e, side], vertices + k)
    rank = parts = 0
    for f in before:
        ea, eb, ec = face_edges[f, 0], face_edges[f, 1], face_edges[f, 2]
        if middles[ea] < 0:
            order[rank] = f
            rank += 1
            continue
        a, b, c = faces[f]
        # The first part takes the face's place.
        count = 2 + (middles[eb] >= 0) + (middles[ec] >= 0)
        end = len(faces) - len(done.origin) + added
        for k in range(count):
            part = end + k - 1 if k else f
            order[rank + k] = done.parts[parts + k] = part
            if k:
                done.origin[added + k - 1] = f
        rank += count
        parts += count
        added += count - 1
        at = f
        m = middles[ea]
        half_b = _half(mesh, first_half, m - vertices, ea, b)
        half_c = _half(mesh, first_half, m - vertices, ea, c)
        am = inner
        _add_edge(mesh, am, a, m)
        inner += 1
        if middles[ec] >= 0:
            n = middles[ec]
            at_a = _half(mesh, first_half, n - vertices, ec, a)
            at_b = _half(mesh, first_half, n - vertices, ec, b)
            _add_edge(mesh, inner, m, n)
            _write(mesh, at, (n, m, a), (am, at_a, inner))
            _write(mesh, end, (n, b, m), (half_b, inner, at_b))
            inner += 1
            at = end + 1
        else:
            _write(mesh, at, (m, a, b), (ec, half_b, am))
            at = end
        if middles[eb] >= 0:
            n = middles[eb]
            at_a = _half(mesh, first_half, n - vertices, eb, a)
            at_c = _half(mesh, first_half, n - vertices, eb, c)
            _add_edge(mesh, inner, m, n)
            _write(mesh, at, (n, m, c), (half_c, at_c, inner))
            _write(mesh, at + 1, (n, a, m), (am, inner, at_a))
            inner += 1
        else:
            _write(mesh, at, (m, c, a), (eb, am, half_c))
