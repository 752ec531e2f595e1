"""Splits the polygons of a subdivision surface once, and evaluates its limit: the masks.

Catmull and Clark 1978; Loop 1987; creases of DeRose, Kass and Truong 1998, whose sharpness is one
less a level, blended as OpenSubdiv blends them; limits of Halstead, Kass and DeRose 1993.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class PolygonMesh(NamedTuple):
    """Holds the polygons of one level.

    Attributes:
        size: Number of vertices.
        sharp: Of the edge from each corner to the next, float64 [c].
        peaks: Of vertices, float64 [n].
    """

    size: int
    counts: NDArray[np.int64]
    corners: NDArray[np.int64]
    sharp: NDArray[np.float64]
    peaks: NDArray[np.float64]
    scheme: str
    smooth_triangles: bool


class MeshEdges(NamedTuple):
    """Holds the edges of a mesh.

    Attributes:
        ends: Vertices, int64 [e, 2].
        sharp: float64 [e].
        of_corner: Edge from each corner to the next, int64 [c].
        is_border: bool [e].
        valence: Edges of each vertex, at least 1, float64 [n].
        is_closed: Whether as many polygons as edges are around a vertex, bool [n].
    """

    ends: NDArray[np.int64]
    sharp: NDArray[np.float64]
    of_corner: NDArray[np.int64]
    is_border: NDArray[np.bool_]
    valence: NDArray[np.float64]
    is_closed: NDArray[np.bool_]


def next_corners(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the corner after each one of its polygon."""
    after = np.arange(1, int(counts.sum()) + 1)
    ends = np.cumsum(counts)
    after[ends - 1] = ends - counts
    return after


def corners_before(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the corner before each one of its polygon."""
    before = np.empty(int(counts.sum()), np.int64)
    before[next_corners(counts)] = np.arange(len(before))
    return before


def edges_of(mesh: PolygonMesh) -> MeshEdges:
    """Finds the edges of a mesh; borders, and edges of more than two polygons, are sharp."""
    ends = np.sort(np.stack([mesh.corners, mesh.corners[next_corners(mesh.counts)]]), axis=0)
    _, first, of_corner, uses = np.unique(
        ends[0] * mesh.size + ends[1], return_index=True, return_inverse=True, return_counts=True
    )
    sharp = np.where(uses == 2, mesh.sharp[first], math.inf)
    ends = ends[:, first].T
    valence = np.bincount(ends.ravel(), minlength=mesh.size)
    closed = (valence > 1) & (valence == np.bincount(mesh.corners, minlength=mesh.size))
    return MeshEdges(ends, sharp, of_corner.ravel(), uses != 2, np.maximum(valence, 1.0), closed)


def _sparse(rows: Any, columns: Any, weights: Any, shape: tuple[int, int]) -> csr_array:
    # Imported where a surface is refined: few stages have one.
    from scipy.sparse import coo_array

    weights = np.broadcast_to(np.asarray(weights, np.float64), np.shape(rows))
    return coo_array((weights, (rows, columns)), shape=shape).tocsr()


def _scaled(weights: NDArray[np.float64], matrix: csr_array) -> csr_array:
    from scipy.sparse import diags_array

    return diags_array(weights) @ matrix


def split(mesh: PolygonMesh) -> tuple[PolygonMesh, csr_array, MeshEdges]:
    """Returns a mesh's children, the map from its values to theirs, and its edges.

    Vertices of the children: those of the mesh, of its edges, and of its polygons.
    """
    from scipy.sparse import vstack

    edges, n, p = edges_of(mesh), mesh.size, len(mesh.counts)
    count, triangles = len(edges.ends), mesh.scheme == "loop"
    of_polygon = np.repeat(np.arange(p), mesh.counts)
    faces = _sparse(of_polygon, mesh.corners, 1.0 / mesh.counts[of_polygon], (p, n))
    middles = _sparse(np.repeat(np.arange(count), 2), edges.ends.ravel(), 0.5, (count, n))
    points = [_vertices(mesh, edges, faces), _on_edges(mesh, edges, faces, middles), faces]
    matrix = vstack(points[:2] if triangles else points, format="csr")
    before = corners_before(mesh.counts)
    at_edge = n + edges.of_corner
    corner, ahead, behind = mesh.corners, at_edge, at_edge[before]
    along, back = np.maximum(mesh.sharp - 1.0, 0.0), np.maximum(mesh.sharp[before] - 1.0, 0.0)
    inner = np.zeros_like(along)
    if triangles:
        outer = np.stack([corner, ahead, behind], axis=1).reshape(-1, 3, 3)
        corners = np.concatenate([outer, ahead.reshape(-1, 1, 3)], axis=1)
        outer = np.stack([along, inner, back], axis=1).reshape(-1, 3, 3)
        sharp = np.concatenate([outer, inner.reshape(-1, 1, 3)], axis=1)
    else:
        corners = np.stack([corner, ahead, n + count + of_polygon, behind], axis=1)
        sharp = np.stack([along, inner, inner, back], axis=1)
    sides = 3 if triangles else 4
    peaks = np.zeros(matrix.shape[0])
    peaks[:n] = np.maximum(mesh.peaks - 1.0, 0.0)
    child = mesh._replace(
        size=matrix.shape[0],
        counts=np.full(corners.size // sides, sides, np.int64),
        corners=corners.ravel(),
        sharp=sharp.ravel(),
        peaks=peaks,
    )
    return child, matrix, edges


def _on_edges(
    mesh: PolygonMesh, edges: MeshEdges, faces: csr_array, middles: csr_array
) -> csr_array:
    if mesh.scheme == "bilinear":
        return middles
    shape = (len(edges.ends), len(mesh.counts))
    of_polygon = np.repeat(np.arange(len(mesh.counts)), mesh.counts)
    if mesh.scheme == "loop":
        opposite = mesh.corners[corners_before(mesh.counts)]
        across = _sparse(edges.of_corner, opposite, 0.125, (shape[0], mesh.size))
        smooth = 0.75 * middles + across
    else:
        share = np.full(len(mesh.counts), 0.25)
        if mesh.smooth_triangles:
            share[mesh.counts == 3] = 0.470
        count = np.maximum(np.bincount(edges.of_corner, minlength=shape[0]), 1)
        mean = np.bincount(edges.of_corner, share[of_polygon], shape[0]) / count
        beside = _sparse(edges.of_corner, of_polygon, mean[edges.of_corner], shape)
        smooth = _scaled(1.0 - 2.0 * mean, middles) + beside @ faces
    crease = np.minimum(edges.sharp, 1.0)
    return (_scaled(1.0 - crease, smooth) + _scaled(crease, middles)).tocsr()


def _vertices(mesh: PolygonMesh, edges: MeshEdges, faces: csr_array) -> csr_array:
    from scipy.sparse import csr_array, eye_array

    n = mesh.size
    same = eye_array(n, format="csr")
    if mesh.scheme == "bilinear":
        return same
    beside = _neighbors(edges.ends, n)
    valence = edges.valence
    if mesh.scheme == "loop":
        beta = _loop_beta(valence)
        smooth = _scaled(1.0 - valence * beta, same) + _scaled(beta, beside)
    else:
        of_polygon = np.repeat(np.arange(len(mesh.counts)), mesh.counts)
        around = _sparse(mesh.corners, of_polygon, 1.0, (n, len(mesh.counts))) @ faces
        smooth = _scaled(1.0 - 2.0 / valence, same)
        smooth = smooth + _scaled(valence**-2.0, beside + around)
    now, later = edges.sharp, np.maximum(edges.sharp - 1.0, 0.0)
    peaks_later = np.maximum(mesh.peaks - 1.0, 0.0)
    rules = _rules(edges, now, mesh.peaks), _rules(edges, later, peaks_later)
    share = np.where(rules[0] == rules[1], 1.0, _transition(mesh, edges, later, peaks_later))
    out = csr_array((n, n))
    for rule, sharp, weight in ((rules[0], now, share), (rules[1], later, 1.0 - share)):
        crease = 0.75 * same + 0.125 * _neighbors(edges.ends[sharp > 0.0], n)
        for kind, mask in ((0, smooth), (1, crease), (2, same)):
            out = out + _scaled(weight * (rule == kind), mask)
    return out.tocsr()


def _neighbors(ends: NDArray[np.int64], size: int) -> csr_array:
    return _sparse(ends.ravel(), ends[:, ::-1].ravel(), 1.0, (size, size))


def _rules(
    edges: MeshEdges, sharp: NDArray[np.float64], peaks: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Returns 0 for smooth vertices (and darts), 1 on a crease, 2 at a corner or what is none."""
    uses = np.bincount(edges.ends[sharp > 0.0].ravel(), minlength=len(peaks))
    smooth = np.where(edges.is_closed, 0, 2)
    return np.where((uses > 2) | (peaks > 0.0), 2, np.where(uses == 2, 1, smooth))


def _transition(
    mesh: PolygonMesh,
    edges: MeshEdges,
    later: NDArray[np.float64],
    peaks_later: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Returns the share of a vertex's rule, against that of its child: mean of what goes to 0."""
    ending = (edges.sharp > 0.0) & (later == 0.0)
    ends = edges.ends[ending].ravel()
    ending_peak = (mesh.peaks > 0.0) & (peaks_later == 0.0)
    total = np.bincount(ends, np.repeat(edges.sharp[ending], 2), mesh.size)
    total = total + np.where(ending_peak, mesh.peaks, 0.0)
    count = np.bincount(ends, minlength=mesh.size) + ending_peak
    return np.minimum(total / np.maximum(count, 1), 1.0)


def _loop_beta(valence: NDArray[np.float64]) -> NDArray[np.float64]:
    known, at = np.unique(valence, return_inverse=True)
    # The last bits of a cosine change with the CPU.
    cosines = np.array([round(math.cos(2.0 * math.pi / n), 12) for n in known.tolist()])
    return ((0.625 - (0.375 + 0.25 * cosines) ** 2) / known)[at.ravel()]


def limit_values(
    mesh: PolygonMesh, values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Puts values of a mesh of quads (Loop's: of triangles) on the limit surface.

    Returns:
        Them, and how far sharpness that is not used up, taken as infinite, can put them off.
    """
    if mesh.scheme == "bilinear":
        return values, 0.0
    edges, n = edges_of(mesh), mesh.size
    around = _neighbors(edges.ends, n) @ values
    valence = edges.valence[:, None]
    if mesh.scheme == "loop":
        share = 1.0 / (0.375 / _loop_beta(valence[:, 0])[:, None] + valence)
        smooth = (1.0 - valence * share) * values + share * around
    else:
        after = next_corners(mesh.counts)
        across = _sparse(mesh.corners, mesh.corners[after[after]], 1.0, (n, n)) @ values
        smooth = (valence**2 * values + 4.0 * around + across) / (valence * (valence + 5.0))

    def under(least: float) -> NDArray[np.float64]:
        sharp = np.where(edges.sharp >= least, edges.sharp, 0.0)
        rule = _rules(edges, sharp, np.where(mesh.peaks >= least, mesh.peaks, 0.0))[:, None]
        along = _neighbors(edges.ends[sharp > 0.0], n) @ values
        crease = (4.0 * values + along) / 6.0
        return np.where(rule == 0, smooth, np.where(rule == 1, crease, values))

    limit = under(np.nextafter(0.0, 1.0))
    left = (
        edges.sharp[(edges.sharp > 0.0) & np.isfinite(edges.sharp)],
        mesh.peaks[(mesh.peaks > 0.0) & np.isfinite(mesh.peaks)],
    )
    if not any(map(len, left)):
        return limit, 0.0
    return limit, float(lengths_of(limit - under(math.inf)).max(initial=0.0))


def lengths_of(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the lengths of vectors, the first three of their numbers."""
    return np.sqrt(sum(values[:, k] ** 2 for k in range(min(values.shape[1], 3))))
