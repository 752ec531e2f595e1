"""Refines subdivision surfaces: Catmull-Clark's, Loop's and bilinear ones, by OpenSubdiv's rules.

A cage is split until triangles between points of its limit surface are within ``ERROR`` of it. At
the end of a crease (a dart) the smooth limit stands for the exact one, which moves by less at each
level: that counts as error, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.polygons import triangulate
from scenec.schemas.subdivision_masks import (
    MeshEdges,
    PolygonMesh,
    corners_before,
    edges_of,
    lengths_of,
    limit_values,
    next_corners,
    split,
)

SCHEMES = ("catmullClark", "loop", "bilinear")
#: Distance of the triangles from the limit surface, as a share of the cage's longest side: half a
#: pixel where that shows in 1000.
ERROR = 5e-4
#: A mesh is not refined to more corners.
MOST_CORNERS = 2_000_000
#: Sharpness that OpenSubdiv takes for infinite.
_INFINITE = 10.0
#: Share of the deviation that a split leaves: on regular surfaces; before there is a second one;
#: where a surface does not settle.
_RATIOS = (0.25, 0.5, 0.9)


@dataclass(frozen=True)
class FaceVarying:
    """Values at corners of polygons.

    Attributes:
        values: float64 [k, w].
        indices: Of the values, by corner, int64 [c]. Corners of one vertex with the same index hang
            together.
        linear: Rule, one of USD's ``faceVaryingLinearInterpolation``.
    """

    values: NDArray[np.float64]
    indices: NDArray[np.int64]
    linear: str = "cornersPlus1"


@dataclass(frozen=True)
class Cage:
    """Holds the polygons of a subdivision surface, and how they are refined.

    Attributes:
        values: At the vertices, positions first, float64 [n, 3 + w].
        counts: Corners of each polygon, int64 [p].
        corners: Vertices of all polygons, int64 [sum of counts].
        scheme: One of ``SCHEMES``.
        boundary: One of USD's ``interpolateBoundary``.
        holes: Polygons that are not shown, int64 [h].
        creases: Edges, int64 [e, 2], and their sharpness, float64 [e].
        peaks: Vertices, int64 [v], and their sharpness, float64 [v].
        smooth_triangles: Whether Catmull-Clark's triangles are smoothed more (USD's
            ``triangleSubdivisionRule`` "smooth").
    """

    values: NDArray[np.float64]
    counts: NDArray[np.int64]
    corners: NDArray[np.int64]
    scheme: str = "catmullClark"
    boundary: str = "edgeAndCorner"
    holes: NDArray[np.int64] | None = None
    creases: tuple[NDArray[np.int64], NDArray[np.float64]] | None = None
    peaks: tuple[NDArray[np.int64], NDArray[np.float64]] | None = None
    smooth_triangles: bool = False


@dataclass(frozen=True)
class Refined:
    """Holds polygons on a limit surface.

    Attributes:
        values: As the cage's, float64 [n', 3 + w].
        counts: Corners of each polygon, int64 [p'].
        corners: Vertices of all polygons, int64 [c'].
        polygon: Polygon of the cage that each is of, int64 [p'].
        side: By corner, side of its vertex that it is on, int64 [c']: a vertex has several where
            sharp edges meet there, else its own number.
        normals: Of sides, by the right hand, unit length, float64 [s, 3]; None of bilinear
            surfaces, which are flat between edges.
        levels: How often the cage was split.
        off: Estimated distance from the limit surface, in the cage's unit.
    """

    values: NDArray[np.float64]
    counts: NDArray[np.int64]
    corners: NDArray[np.int64]
    polygon: NDArray[np.int64]
    side: NDArray[np.int64]
    normals: NDArray[np.float64] | None
    levels: int
    off: float
    _cage: Cage
    _authored: NDArray[np.int64]
    _shown: NDArray[np.bool_]

    def is_close(self) -> bool:
        """Tells whether it is within ``ERROR`` of its limit surface."""
        return self.off <= ERROR * _size(self._cage)

    def at_corners(self, varying: FaceVarying) -> NDArray[np.float64]:
        """Refines values at the corners of all polygons of the cage, [c', w]."""
        own = replace(varying, indices=varying.indices[self._authored])
        return _at_corners(self._cage, own, self.levels)[self._shown]


def crease_edges(
    indices: NDArray[np.int64], lengths: NDArray[np.int64], sharpness: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Lists the edges of USD's creases: chains of vertices, with a sharpness a chain or an edge.

    Raises:
        ValueError: The arrays do not go together.
    """
    if lengths.sum() != len(indices) or (lengths < 2).any():
        raise ValueError(
            f"creaseLengths add up to {lengths.sum()}, there are {len(indices)} creaseIndices; "
            "expected as many, and no length below 2"
        )
    inner = np.ones(len(indices), bool)
    inner[np.cumsum(lengths) - 1] = False
    start = np.flatnonzero(inner)
    if len(sharpness) == len(lengths):
        sharpness = np.repeat(sharpness, lengths - 1)
    if len(sharpness) != len(start):
        raise ValueError(
            f"{len(sharpness)} creaseSharpnesses: expected {len(lengths)}, one a crease, or "
            f"{len(start)}, one an edge"
        )
    return np.stack([indices[start], indices[start + 1]], axis=1), sharpness


def hanging(indices: Sequence[int], count: int) -> NDArray[np.int64]:
    """Returns which corner's value each corner has, by the indices of a face-varying primvar.

    Args:
        indices: Of its values; none: every corner has its own.
        count: Corners.
    """
    if not len(indices):
        return np.arange(count)
    _, first, same = np.unique(np.asarray(indices), return_index=True, return_inverse=True)
    return first[same.ravel()]


def refine(authored: Cage, error: float = ERROR, levels: int | None = None) -> Refined:
    """Refines a cage until it is within an error of its limit surface, or has too many corners.

    Args:
        authored: Its indices are in range.
        error: As a share of the longest side of the cage's box.
        levels: How often to split it, whatever the error is: that of another pose of it.
    """
    cage, chosen, polygon = _prepared(authored)
    mesh = _mesh_of(cage)
    kept = _shown(cage, mesh, polygon)
    size, (usual, first, most) = _size(cage), _RATIOS
    values = limit = before = cage.values
    given, levels, off, deviation = levels, 0, 0.0, 0.0
    while size > 0.0:
        if 4 * len(mesh.corners) > MOST_CORNERS:
            off = off if levels else math.inf
            break
        child, matrix, edges = split(mesh)
        values = matrix @ values
        limit, rest = limit_values(child, values)
        if levels:
            rest += lengths_of(limit[: mesh.size] - before).max(initial=0.0)
        last, deviation = deviation, _deviation(mesh, child, edges, limit)
        ratio = min(max(deviation / last, usual), most) if last else first
        off, before = deviation / (1.0 - ratio) + rest, limit
        if levels == given if given is not None else off <= error * size:
            limit = limit[: mesh.size]
            break
        mesh, levels, off = child, levels + 1, deviation * ratio / (1.0 - ratio) + rest
        if given is None and off <= error * size:
            break
    if levels:
        each = np.full_like(cage.counts, 4) if cage.scheme == "loop" else cage.counts
        each = each * 4 ** (levels - 1)
        polygon, kept = np.repeat(polygon, each), np.repeat(kept, each)
    shown = np.repeat(kept, mesh.counts)
    flat = mesh.scheme == "bilinear"
    side = mesh.corners if flat else _sides(mesh)
    return Refined(
        limit, mesh.counts[kept], mesh.corners[shown], polygon[kept], side[shown],
        None if flat else _normals(mesh, side, limit),
        levels, off, cage, chosen, shown,
    )  # fmt: skip


def _size(cage: Cage) -> float:
    used = cage.values[cage.corners, :3]
    return float(np.ptp(used, axis=0).max()) if len(used) else 0.0


def _prepared(cage: Cage) -> tuple[Cage, NDArray[np.int64], NDArray[np.int64]]:
    """Leaves out polygons of less than three corners, and cuts Loop's into triangles."""
    if cage.scheme == "loop":
        cut = triangulate(cage.values[:, :3], cage.corners, cage.counts)
        chosen, polygon = cut.corners.ravel(), cut.polygon
        counts = np.full(len(polygon), 3, np.int64)
    else:
        polygon = np.flatnonzero(cage.counts >= 3)
        chosen = np.flatnonzero(np.repeat(cage.counts >= 3, cage.counts))
        counts = cage.counts[polygon]
    return replace(cage, counts=counts, corners=cage.corners[chosen]), chosen, polygon


def _mesh_of(cage: Cage) -> PolygonMesh:
    size = len(cage.values)
    peaks = np.zeros(size)
    if cage.boundary == "edgeAndCorner":
        peaks[np.bincount(cage.corners, minlength=size) == 1] = math.inf
    if cage.peaks is not None:
        np.maximum.at(peaks, cage.peaks[0], _sharpness(cage.peaks[1]))
    sharp = np.zeros(len(cage.corners))
    if cage.creases is not None and len(cage.creases[0]):
        pairs, order = np.unique(np.sort(cage.creases[0], axis=1) @ [size, 1], return_inverse=True)
        most = np.zeros(len(pairs))
        np.maximum.at(most, order.ravel(), _sharpness(cage.creases[1]))
        ends = np.sort(np.stack([cage.corners, cage.corners[next_corners(cage.counts)]]), axis=0)
        keys = np.array([size, 1]) @ ends
        at = np.minimum(np.searchsorted(pairs, keys), len(pairs) - 1)
        sharp = np.where(pairs[at] == keys, most[at], 0.0)
    return PolygonMesh(
        size, cage.counts, cage.corners, sharp, peaks, cage.scheme, cage.smooth_triangles
    )


def _sharpness(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(values >= _INFINITE, math.inf, np.maximum(values, 0.0))


def _shown(cage: Cage, mesh: PolygonMesh, polygon: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Marks polygons that are no holes and, without a rule for borders, do not touch one."""
    shown = np.ones(len(polygon), bool)
    if cage.holes is not None:
        shown = ~np.isin(polygon, cage.holes)
    if cage.boundary == "none":
        of_polygon = np.repeat(np.arange(len(polygon)), cage.counts)
        shown &= np.bincount(of_polygon, _on_border(mesh)[cage.corners], len(polygon)) == 0
    return shown


def _on_border(mesh: PolygonMesh) -> NDArray[np.bool_]:
    edges, found = edges_of(mesh), np.zeros(mesh.size, bool)
    found[edges.ends[edges.is_border]] = True
    return found


def _deviation(
    mesh: PolygonMesh, child: PolygonMesh, edges: MeshEdges, limit: NDArray[np.float64]
) -> float:
    """Returns how far the limit is from a mesh's triangles at middles of edges and of polygons.

    Along the normal; at creases and borders across the edge. The center of a triangle on a
    quadratic patch is at most 4/3 times as far off as the middles of its edges.
    """
    n = mesh.size
    a, b = limit[edges.ends[:, 0], :3], limit[edges.ends[:, 1], :3]
    flat = [0.5 * (a + b)]
    if mesh.scheme != "loop":
        start = np.cumsum(mesh.counts) - mesh.counts
        # Of a quad, where its two triangles meet.
        centers = 0.5 * (limit[mesh.corners[start], :3] + limit[mesh.corners[start + 2], :3])
        many = mesh.counts != 4
        if many.any():
            mean = np.add.reduceat(limit[mesh.corners, :3], start)[many]
            centers[many] = mean / mesh.counts[many, None]
        flat.append(centers)
    way = limit[n:, :3] - np.concatenate(flat)
    off = np.abs((way * _normals(child, child.corners, limit)[n:]).sum(axis=1))
    rim = np.flatnonzero(edges.sharp > 0.0)
    chord = (b - a)[rim]
    squares = np.maximum((chord * chord).sum(axis=1), np.finfo(np.float64).tiny)
    along = (way[rim] * chord).sum(axis=1) / squares
    off[rim] = lengths_of(way[rim] - along[:, None] * chord)
    return float(off.max(initial=0.0)) * 4.0 / 3.0


def _at_corners(cage: Cage, varying: FaceVarying, levels: int) -> NDArray[np.float64]:
    """Refines face-varying values as a mesh of their own, torn where they are; [corners, w]."""
    pairs, first, corners, uses = np.unique(
        cage.corners * (len(varying.values) + 1) + varying.indices,
        return_index=True, return_inverse=True, return_counts=True,
    )  # fmt: skip
    whole, vertex = _mesh_of(cage), cage.corners[first]
    values = varying.values[varying.indices[first]]
    mesh = whole._replace(
        size=len(pairs),
        corners=corners.ravel(),
        peaks=whole.peaks[vertex],
        scheme="bilinear" if varying.linear == "all" else cage.scheme,
    )
    torn, sides = _on_border(mesh), np.bincount(vertex, minlength=whole.size)[vertex]
    pinned = (uses == 1) & (varying.linear != "none")
    if varying.linear in ("cornersPlus1", "cornersPlus2"):
        pinned |= sides > 2
    if varying.linear == "cornersPlus2":
        beside = np.bincount(vertex, pinned, whole.size)[vertex] > 0
        dart = torn & ~_on_border(whole)[vertex]
        pinned |= ((sides == 2) & beside) | ((sides == 1) & dart)
    if varying.linear == "boundaries":
        pinned |= torn
    mesh = mesh._replace(peaks=np.where(pinned, math.inf, mesh.peaks))
    # Limits are known of quads: a cage's are those of its vertices among its children.
    at = mesh
    for _ in range(max(levels, 1)):
        at, matrix, _ = split(at)
        values = matrix @ values
    return limit_values(at, values)[0][(at if levels else mesh).corners]


def _sides(mesh: PolygonMesh) -> NDArray[np.int64]:
    """Numbers the parts of vertices' fans between sharp edges, by corner."""
    # Imported where a surface has creases.
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    edges, after = edges_of(mesh), next_corners(mesh.counts)
    if not ((edges.sharp > 0.0) & ~edges.is_border).any():
        return mesh.corners
    soft = np.flatnonzero(edges.sharp[edges.of_corner] == 0.0)
    one, two = soft[np.argsort(edges.of_corner[soft], kind="stable")].reshape(-1, 2).T
    # Of two polygons at an edge, usually one runs it up, and the other one down.
    opposed = mesh.corners[one] != mesh.corners[two]
    rows = np.concatenate([one, after[one]])
    columns = np.concatenate(
        [np.where(opposed, after[two], two), np.where(opposed, two, after[two])]
    )
    count = len(mesh.corners)
    graph = csr_array((np.ones(len(rows), bool), (rows, columns)), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _normals(
    mesh: PolygonMesh, side: NDArray[np.int64], limit: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Returns unit normals of sides, means over corners by parallelograms; 0 where none is."""
    here = limit[mesh.corners, :3]
    one, two = here[next_corners(mesh.counts)] - here, here[corners_before(mesh.counts)] - here
    across = np.cross(one, two)
    rows = max(mesh.size, int(side.max(initial=-1)) + 1)
    total = np.stack([np.bincount(side, across[:, k], rows) for k in range(3)], axis=1)
    lengths = lengths_of(total)[:, None]
    return np.divide(total, lengths, out=np.zeros(total.shape), where=lengths > 0.0)
