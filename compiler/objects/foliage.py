"""Levels of detail of plants: fewer leaves, each larger, of the same area together.

Cook, Halstead, Planck and Ryu, "Stochastic simplification of aggregate detail" (SIGGRAPH 2007).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.model import MeshModel
from scenec.compiler.geometry.boxes import boxes_of
from scenec.compiler.geometry.pieces import pieces_of
from scenec.compiler.noise.lattice import mix
from scenec.compiler.objects.rocks import Chain
from scenec.compiler.scene.objects import Prototype
from scenec.schemas.kernels import kernel

#: What counts as a leaf, needle, blade, twig has at most so many triangles.
MOST_TRIANGLES = 12
#: A part of fewer of them keeps all.
FEWEST = 8
#: Square of the extent over the area, from which on a strip only gets wider.
LONG = 12.0
#: Each level has half of the leaves of the one before it.
LEVELS = 6
#: A level with more of the triangles of the one before is not worth its bytes.
WORTH = 0.85


class _Pieces(NamedTuple):
    """Connected pieces of a mesh.

    Attributes:
        of_face, of_vertex: int64 [m] and [n].
        triangles, area: Of each piece, int64 and float64 [p].
        center: Of its area, float64 [p, 3].
        long: Whether it is a strip, which only gets wider, bool [p].
        group: What it is a leaf of, by material and part; -1 for what all levels keep, int64 [p].
    """

    of_face: NDArray[np.int64]
    of_vertex: NDArray[np.int64]
    triangles: NDArray[np.int64]
    area: NDArray[np.float64]
    center: NDArray[np.float64]
    long: NDArray[np.bool_]
    group: NDArray[np.int64]


def foliage_chain(finest: Prototype, model: MeshModel) -> Chain:
    """The levels of a model whose materials let light through, as leaves do; others have one.

    Its connected pieces of few triangles are leaves, needles, blades and twigs. Each level keeps
    half of those of the one before in every part, one of two neighbors along a curve through space,
    by a hash of their number. What is kept grows about its center, long pieces in width alone, so
    that each part keeps its area. All else stays. ``error`` is by how much the corners of leaves
    are moved, root mean square by area.

    Args:
        finest: The model's prototype, its faces in the model's order.
        model: What it was made of.
    """
    if not any(material.diffuse_transmission > 0.0 for material in model.materials):
        return (finest,)
    partner = _partners(model.points, model.faces)
    pieces = _pieces(model, partner)
    alive = np.flatnonzero(pieces.group >= 0)
    if not len(alive):
        return (finest,)
    alive = alive[_order(pieces, alive)]
    # Corners split along edges, back to the model's own.
    uncut = np.empty(len(finest.points), np.int64)
    uncut[finest.faces] = model.faces
    groups = int(pieces.group.max()) + 1
    whole = np.bincount(pieces.group[alive], pieces.area[alive], groups)
    move = np.zeros_like(model.points)
    levels = [finest]
    for level in range(1, LEVELS + 1):
        alive = _half(alive, pieces.group, level)
        of_group = np.bincount(pieces.group[alive], pieces.area[alive], groups)
        own = pieces.group[alive]
        growth = np.ones(len(pieces.area))
        growth[alive] = whole[own] / of_group[own]
        left = pieces.group < 0
        left[alive] = True
        faces, which = left[pieces.of_face], np.flatnonzero(left[pieces.of_vertex])
        move[which] = _moves(model.points, which, pieces, partner, growth)
        made = _part_of(finest, faces, left[pieces.of_vertex[uncut]], move[uncut])
        if len(made.faces) > WORTH * len(levels[-1].faces):
            break
        error = _rms(move, model.faces[faces], pieces, faces)
        levels.append(replace(made, error=max(error, levels[-1].error)))
    return tuple(levels)


def _pieces(model: MeshModel, partner: NDArray[np.int64]) -> _Pieces:
    of_vertex = pieces_of(model.faces, len(model.points))
    of_face = of_vertex[model.faces[:, 0]]
    count = int(of_vertex.max()) + 1
    a, b, c = (model.points[model.faces[:, i]] for i in range(3))
    u, v = b - a, c - a
    normal = np.stack(
        [
            u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1],
            u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2],
            u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0],
        ]
    )
    area_of_face = 0.5 * np.sqrt((normal * normal).sum(axis=0))
    area = np.bincount(of_face, area_of_face, count)
    middle = (a + b + c) / 3.0
    center = np.stack(
        [np.bincount(of_face, area_of_face * middle[:, i], count) for i in range(3)], axis=1
    )
    center /= area[:, None]
    low, high = boxes_of(model.points, of_vertex, count)
    extent = ((high - low) * (high - low)).sum(axis=1)
    triangles = np.bincount(of_face, minlength=count)
    # A strip is pairs of vertices, and perhaps a tip.
    alone = np.bincount(of_vertex, partner == np.arange(len(partner)), count)
    long = (extent > LONG * area) & (alone <= 1)
    # By their first faces: a piece of several materials is no leaf, but whole in one level too.
    key = model.part_of_face.astype(np.int64) * (len(model.materials) + 1)
    key += model.material_of_face + 1
    mixed = np.zeros(count, np.bool_)
    first = np.full(count, len(key), np.int64)
    np.minimum.at(first, of_face, np.arange(len(key)))
    mixed[of_face[key != key[first[of_face]]]] = True
    _, group = np.unique(key[first], return_inverse=True)
    group = np.where((triangles <= MOST_TRIANGLES) & ~mixed, group, -1)
    if not (group >= 0).any():
        return _Pieces(of_face, of_vertex, triangles, area, center, long, group)
    number = np.bincount(group[group >= 0], minlength=int(group.max()) + 1)
    group = np.where((group >= 0) & (number[group] >= FEWEST), group, -1)
    return _Pieces(of_face, of_vertex, triangles, area, center, long, group)


def _order(pieces: _Pieces, which: NDArray[np.int64]) -> NDArray[np.int64]:
    """Part after part, each along Morton's curve through its leaves' middles."""
    at = pieces.center[which]
    low = at.min(axis=0)
    cells = ((at - low) * (1023.0 / max(float((at.max(axis=0) - low).max()), 1e-30))).astype(
        np.int64
    )
    code = np.zeros(len(which), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.lexsort((code, pieces.group[which]))


def _half(alive: NDArray[np.int64], group: NDArray[np.int64], level: int) -> NDArray[np.int64]:
    """One of each two neighbors of the same part, by a hash; a last single one stays."""
    own = group[alive]
    first = np.searchsorted(own, own)
    place = np.arange(len(alive)) - first
    pair = place >> 1
    single = np.append(own[1:] != own[:-1], True) & (place % 2 == 0)
    chosen = _bits(own * (1 << 32) + pair, level)
    return alive[single | (place % 2 == chosen)]


def _part_of(
    finest: Prototype,
    left: NDArray[np.bool_],
    used: NDArray[np.bool_],
    move: NDArray[np.float64],
) -> Prototype:
    """Some faces of a prototype, with the vertices that they use, moved."""
    faces = finest.faces[left]
    number = np.cumsum(used, dtype=np.int32) - 1
    new_face = np.cumsum(left, dtype=np.int32) - 1
    moved = (finest.points[used] + move[used]).astype(np.float32)
    wide = moved.astype(np.float64)
    return replace(
        finest,
        name=f"{finest.name}_{len(faces)}",
        points=moved,
        faces=number[faces].astype(np.int32),
        normals=finest.normals[used],
        variation=finest.variation[used],
        radius=float(np.sqrt((wide * wide).sum(axis=1).max())) * (1.0 + 1e-6),
        uv=None if finest.uv is None else finest.uv[left],
        colors=None if finest.colors is None else finest.colors[left],
        parts=tuple(
            replace(part, faces=new_face[part.faces[left[part.faces]]]) for part in finest.parts
        ),
    )


def _moves(
    points: NDArray[np.float64],
    which: NDArray[np.int64],
    pieces: _Pieces,
    partner: NDArray[np.int64],
    growth: NDArray[np.float64],
) -> NDArray[np.float64]:
    """By how much some vertices move where the areas of their pieces grow, [k, 3]."""
    own, at = pieces.of_vertex[which], points[which]
    grown = growth[own][:, None]
    wider = 0.5 * (grown - 1.0) * (at - points[partner[which]])
    larger = (np.sqrt(grown) - 1.0) * (at - pieces.center[own])
    return np.where(pieces.long[own][:, None], wider, larger)


def _rms(
    move: NDArray[np.float64],
    corners: NDArray[np.int32],
    pieces: _Pieces,
    left: NDArray[np.bool_],
) -> float:
    """Returns the root mean square of the moves of kept leaves' corners, weighted by leaf area."""
    own = pieces.of_face[left]
    weight = np.where(pieces.group[own] >= 0, pieces.area[own] / pieces.triangles[own], 0.0)
    x, y, z = move.T
    a, b, c = (x * x + y * y + z * z)[corners].T
    square = (a + b + c) / 3.0
    return float(np.sqrt((weight * square).sum() / weight.sum()))


def _partners(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """Returns the vertex across each one's strip, where it is mutually nearest; else itself."""
    nearest = np.arange(len(points))
    _across(points, faces, np.full(len(points), np.inf), nearest)
    mutual = nearest[nearest] == np.arange(len(points))
    return np.where(mutual, nearest, np.arange(len(points)))


@kernel
def _across(points, faces, least, nearest):  # type: ignore[no-untyped-def]
    """The other end of each vertex's shortest edge, the first of equal ones."""
    for f in range(len(faces)):
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            square = 0.0
            for axis in range(3):
                d = points[a, axis] - points[b, axis]
                square += d * d
            if square < least[a]:
                least[a], nearest[a] = square, b
            if square < least[b]:
                least[b], nearest[b] = square, a


def _bits(numbers: NDArray[np.int64], level: int) -> NDArray[np.int64]:
    """0 or 1 of each number, by a hash of it and the level."""
    out = np.empty(len(numbers), np.int64)
    _hash_bits(numbers.astype(np.uint64), np.uint64(level), out)
    return out


@kernel
def _hash_bits(numbers, level, out):  # type: ignore[no-untyped-def]
    for n in range(len(numbers)):
        out[n] = np.int64(mix(mix(numbers[n]) + level) >> np.uint64(63))
