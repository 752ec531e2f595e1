"""Bisects triangles at their newest vertex where asked, and few others to keep the mesh whole.

A triangle (a, b, c) is halved from its newest vertex a to the middle of the edge bc; that middle is
the halves' newest vertex (Mitchell 1989, ACM TOMS 15). A triangle of which any edge is halved is
halved itself, its own edge bc first: marks spread until that holds, so that no vertex ever lies on
the inside of an edge. All descendants of a triangle have at most four shapes.

Any triangle mesh will do, with edges of more than two faces, too. The result does not depend on the
order in which marks spread.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel


class Bisectable(NamedTuple):
    """A mesh that knows its edges.

    Attributes:
        vertices: Number of vertices.
        faces: Vertices of each face, the newest first, int32 [m, 3].
        face_edges: Edge opposite of each of them, int32 [m, 3]; the first is the one to be halved.
        edges: Ends of the edges, the lower first, int32 [e, 2].
    """

    vertices: int
    faces: NDArray[np.int32]
    face_edges: NDArray[np.int32]
    edges: NDArray[np.int32]


@dataclass(frozen=True)
class Halved:
    """A mesh after a round of halving.

    Attributes:
        mesh: The mesh; old vertices keep their numbers, each new one follows.
        ends: Ends of the edge in whose middle each new vertex lies, int32 [k, 2].
        middle_of: Edge of the old mesh that each new vertex halves, int32 [k].
        face_origin: Face of the old mesh that each face is (a part of), int32 [m'].
        face_new: Whether the face is a part, bool [m'].
        edge_origin: Edge of the old mesh that each edge is, -1 for a new one, int32 [e'].
    """

    mesh: Bisectable
    ends: NDArray[np.int32]
    middle_of: NDArray[np.int32]
    face_origin: NDArray[np.int32]
    face_new: NDArray[np.bool_]
    edge_origin: NDArray[np.int32]


def bisectable(points: NDArray[np.float64], faces: NDArray[np.int32]) -> Bisectable:
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
    return newest_first(len(points), turned)


def newest_first(vertices: int, faces: NDArray[np.int32]) -> Bisectable:
    """A mesh whose faces are to be halved at the edges opposite of their first vertices.

    Args:
        vertices: How many there are.
        faces: int32 [m, 3].
    """
    face_edges, edges = _numbered(vertices, faces)
    return Bisectable(vertices, faces, face_edges, edges)


def halve(mesh: Bisectable, wanted: NDArray[np.bool_]) -> Halved:
    """Halves the faces wanted, and what must follow.

    Args:
        mesh: The mesh.
        wanted: bool [m].
    """
    marked = np.zeros(len(mesh.edges), bool)
    _mark(mesh.face_edges, wanted, marked)
    middle_of = np.flatnonzero(marked).astype(np.int32)
    pieces, first_piece = _pieces(mesh.face_edges, marked)
    kept = len(marked) - len(middle_of)
    new_edges = kept + 2 * len(middle_of) + int((pieces - 1).sum())
    faces = np.empty((int(pieces.sum()), 3), np.int32)
    edges = np.empty((new_edges, 2), np.int32)
    halved = Bisectable(mesh.vertices + len(middle_of), faces, np.empty_like(faces), edges)
    edge_origin = np.full(new_edges, -1, np.int32)
    edge_origin[:kept] = np.flatnonzero(~marked)
    _split(mesh, marked, kept, first_piece, halved)
    return Halved(
        mesh=halved,
        ends=mesh.edges[middle_of],
        middle_of=middle_of,
        face_origin=np.repeat(np.arange(len(pieces), dtype=np.int32), pieces),
        face_new=np.repeat(pieces > 1, pieces),
        edge_origin=edge_origin,
    )


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
def _mark(face_edges, wanted, marked):  # type: ignore[no-untyped-def]
    """Marks edges to be halved until each face with a marked edge has its first one marked."""
    for f in range(len(face_edges)):
        if wanted[f]:
            marked[face_edges[f, 0]] = True
    # Sweeps to and fro: marks run along chains of faces in either direction.
    changed = True
    forward = True
    while changed:
        changed = False
        for n in range(len(face_edges)):
            f = n if forward else len(face_edges) - 1 - n
            if marked[face_edges[f, 0]]:
                continue
            if marked[face_edges[f, 1]] or marked[face_edges[f, 2]]:
                marked[face_edges[f, 0]] = True
                changed = True
        forward = not forward


@kernel
def _pieces(face_edges, marked):  # type: ignore[no-untyped-def]
    """Faces that each face becomes, and the number of the first of them."""
    pieces = np.empty(len(face_edges), np.int64)
    first = np.empty(len(face_edges), np.int64)
    total = 0
    for f in range(len(face_edges)):
        count = 1
        for k in range(3):
            count += marked[face_edges[f, k]]
        pieces[f] = count
        first[f] = total
        total += count
    return pieces, first


@inlined
def _write(mesh, at, corners, edges):  # type: ignore[no-untyped-def]
    faces, face_edges = mesh.faces, mesh.face_edges
    faces[at, 0], faces[at, 1], faces[at, 2] = corners[0], corners[1], corners[2]
    face_edges[at, 0], face_edges[at, 1], face_edges[at, 2] = edges[0], edges[1], edges[2]


@kernel
def _split(mesh, marked, kept, first_piece, out):  # type: ignore[no-untyped-def]
    """Halve the marked edges, and the faces beside them.

    Args:
        mesh: ``Bisectable``.
        marked: Which edges, bool [e]; of a face with any, its first.
        kept: How many are not.
        first_piece: Number of the first face that each becomes, int64 [m].
        out: Receives the halved mesh but for its number of vertices: first the edges that are kept,
            then halves of the others in twos, then edges across faces.
    """
    vertices, faces, face_edges, edges = mesh
    all_edges = out.edges
    # Where an edge stands now: its number, or the rank of its middle.
    number = np.empty(len(edges), np.int64)
    keeps = 0
    halved = 0
    for e in range(len(edges)):
        if marked[e]:
            number[e] = halved
            for side in range(2):
                half = kept + 2 * halved + side
                # The middle has the higher number of the two.
                all_edges[half, 0] = edges[e, side]
                all_edges[half, 1] = vertices + halved
            halved += 1
        else:
            number[e] = keeps
            all_edges[keeps, 0], all_edges[keeps, 1] = edges[e, 0], edges[e, 1]
            keeps += 1
    inner = kept + 2 * halved
    for f in range(len(faces)):
        a, b, c = np.int64(faces[f, 0]), np.int64(faces[f, 1]), np.int64(faces[f, 2])
        ea, eb, ec = face_edges[f, 0], face_edges[f, 1], face_edges[f, 2]
        at = first_piece[f]
        if not marked[ea]:
            _write(out, at, (a, b, c), (number[ea], number[eb], number[ec]))
            continue
        m = vertices + number[ea]
        half_b = kept + 2 * number[ea] + (edges[ea, 1] == b)
        half_c = kept + 2 * number[ea] + (edges[ea, 1] == c)
        am = inner
        all_edges[am, 0], all_edges[am, 1] = min(a, m), max(a, m)
        inner += 1
        if marked[ec]:
            n = vertices + number[ec]
            at_a = kept + 2 * number[ec] + (edges[ec, 1] == a)
            at_b = kept + 2 * number[ec] + (edges[ec, 1] == b)
            all_edges[inner, 0], all_edges[inner, 1] = min(m, n), max(m, n)
            _write(out, at, (n, m, a), (am, at_a, inner))
            _write(out, at + 1, (n, b, m), (half_b, inner, at_b))
            inner += 1
            at += 2
        else:
            _write(out, at, (m, a, b), (number[ec], half_b, am))
            at += 1
        if marked[eb]:
            n = vertices + number[eb]
            at_a = kept + 2 * number[eb] + (edges[eb, 1] == a)
            at_c = kept + 2 * number[eb] + (edges[eb, 1] == c)
            all_edges[inner, 0], all_edges[inner, 1] = min(m, n), max(m, n)
            _write(out, at, (n, m, c), (half_c, at_c, inner))
            _write(out, at + 1, (n, a, m), (am, inner, at_a))
            inner += 1
        else:
            _write(out, at, (m, c, a), (number[eb], am, half_c))
