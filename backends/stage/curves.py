"""BasisCurves of a stage as tubes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.backends.stage import values
from scenec.backends.stage.deforming import ShapePose
from scenec.backends.stage.tubes import ERROR, CurveSegments, TubeLayout, Tubes, lay_out, make_tubes
from scenec.schemas.errors import StageError

#: What is said of curves that are not drawn, or not as they are authored.
NO_WIDTH = "curves without widths have no surface and are not drawn"
SHORT = "curves of too few points for their basis are left out"
RIBBONS = "curves with normals are ribbons, and are drawn as round tubes"

_TYPES = ("cubic", "linear")
_WRAPS = ("nonperiodic", "periodic", "pinned")
#: By basis: control points of a segment (rows of Bezier's from four of its own), and the points
#: from a segment to the next.
_BASES = {
    "bezier": (np.eye(4), 3),
    "bspline": (
        np.array([(1, 4, 1, 0), (0, 4, 2, 0), (0, 2, 4, 0), (0, 1, 4, 1)], np.float64) / 6.0,
        1,
    ),
    "catmullRom": (
        np.array([(0, 6, 0, 0), (-1, 6, 1, 0), (0, 1, 6, -1), (0, 0, 6, 0)], np.float64) / 6.0,
        1,
    ),
}
_LINEAR = np.array([(3, 0), (2, 1), (1, 2), (0, 3)], np.float64) / 3.0


@dataclass(frozen=True)
class ShapeOfCurves:
    """Holds the curves of a prim, ready to be made tubes of at any points.

    Attributes:
        points: As authored, float32 [n, 3].
        lines: What of them is lost.
    """

    points: NDArray[np.float32]
    lines: tuple[str, ...]
    _segments: CurveSegments
    _controls: NDArray[np.int64]
    _phantoms: NDArray[np.int64]
    _to_bezier: NDArray[np.float64]
    _counts: NDArray[np.int64]
    _ends: NDArray[np.int64]
    layout: TubeLayout

    def tubes(self, points: NDArray[np.float32]) -> Tubes:
        """Makes the triangles, with the curves' points elsewhere."""
        bezier = _bezier(points, self._controls, self._phantoms, self._to_bezier)
        return make_tubes(replace(self._segments, bezier=bezier), self.layout)

    def posed(self, pose: ShapePose) -> ShapePose:
        """A pose of the tubes."""
        tubes = self.tubes(pose.points)
        return ShapePose(tubes.points, tubes.normals, pose.shown)

    def at_samples(
        self, found: NDArray[np.float32], interpolation: str
    ) -> NDArray[np.float64] | None:
        """Values of a primvar at the samples of the tubes, [s, w]; None where they do not fit."""
        tokens, segment = UsdGeom.Tokens, self.layout.segment
        t = self.layout.at[:, None]
        if interpolation == tokens.uniform and len(found) == len(self._counts):
            return found[self._segments.curve[segment]].astype(np.float64)
        if interpolation == tokens.varying and len(found) > self._ends.max(initial=-1):
            a, b = found[self._ends[segment]].astype(np.float64).transpose(1, 0, 2)
            return a + t * (b - a)
        if interpolation == tokens.vertex and len(found) == len(self.points):
            c = _bezier(found, self._controls, self._phantoms, self._to_bezier)[segment]
            s = 1.0 - t
            return (
                s * s * s * c[:, 0]
                + 3.0 * s * s * t * c[:, 1]
                + 3.0 * s * t * t * c[:, 2]
                + t * t * t * c[:, 3]
            )
        return None


def read_curves(prim: Usd.Prim, time: Usd.TimeCode) -> ShapeOfCurves:
    """Reads the curves of a prim.

    Args:
        prim: A BasisCurves.
        time: When.

    Raises:
        StageError: Its arrays contradict each other, hold NaN, or a width below 0.
    """
    curves = UsdGeom.BasisCurves(prim)
    points = values.array(curves.GetPointsAttr(), np.float32, time, width=(3,))
    counts = values.array(curves.GetCurveVertexCountsAttr(), np.int64, time)
    if (counts < 0).any() or counts.sum() != len(points):
        raise StageError(
            f"{prim.GetPath()}: curveVertexCounts add up to {counts.sum()}, there are "
            f"{len(points)} points"
        )
    linear = values.word(curves.GetTypeAttr(), "cubic", time, _TYPES) == "linear"
    basis = values.word(curves.GetBasisAttr(), "bezier", time, tuple(_BASES))
    wrap = values.word(curves.GetWrapAttr(), "nonperiodic", time, _WRAPS)
    matrix, step = (_LINEAR, 1) if linear else _BASES[basis]
    pinned = wrap == "pinned" and not linear and step == 1
    width = matrix.shape[1]
    if wrap == "periodic":
        pieces = np.where(counts >= (2 if linear else width - step), counts // step, 0)
    else:
        own = counts + 2 * pinned * (counts >= 2)
        pieces = np.maximum(own - width, -step) // step + 1
    pieces[counts < 2] = 0
    first = np.cumsum(counts) - counts
    curve = np.repeat(np.arange(len(counts)), pieces)
    within = np.arange(len(curve)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    place = within[:, None] * step + np.arange(width) - pinned
    n, base = counts[curve][:, None], first[curve][:, None]
    phantoms = np.zeros(place.shape, np.int64)
    if wrap == "periodic":
        place %= n
    elif pinned:
        phantoms = (place < 0).astype(np.int64) - (place >= n)
        place = np.clip(place, 0, n - 1)
    controls = base + place
    closed = np.full(len(counts), wrap == "periodic")
    ends = _ends(pieces, closed, curve, within)
    lines = [SHORT] * bool((pieces == 0).any())
    shape = ShapeOfCurves(
        points,
        (),
        CurveSegments(
            _bezier(points, controls, phantoms, matrix), np.zeros((len(curve), 2)), curve, closed,
            linear,
        ),
        controls, phantoms, matrix, counts, ends, TubeLayout(curve[:0], np.zeros(0), counts, 0.0),
    )  # fmt: skip
    widths, lost = _widths(curves, shape, time)
    lines += lost
    segments = replace(shape._segments, widths=widths)
    layout = lay_out(segments)
    if layout.error > ERROR:
        lines.append(f"curves of too many segments are within {100 * layout.error:.2g} % of their "
                     "length")  # fmt: skip
    if curves.GetNormalsAttr().HasAuthoredValue():
        lines.append(RIBBONS)
    return replace(shape, lines=tuple(lines), _segments=segments, layout=layout)


def _ends(
    pieces: NDArray[np.int64],
    closed: NDArray[np.bool_],
    curve: NDArray[np.int64],
    within: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Which varying values stand at both ends of each segment, int64 [k, 2]."""
    own = pieces + (~closed & (pieces > 0))
    first = (np.cumsum(own) - own)[curve]
    after = np.where(closed[curve] & (within + 1 == pieces[curve]), 0, within + 1)
    return np.stack([first + within, first + after], axis=1)


def _bezier(
    found: NDArray[np.float32],
    controls: NDArray[np.int64],
    phantoms: NDArray[np.int64],
    matrix: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Values as Bezier's control values of segments, float64 [k, 4, w].

    A pinned curve goes on beyond its ends as USD says: by twice the end less what is before it.
    """
    given = found.astype(np.float64)[controls]
    at, column = np.nonzero(phantoms)
    beside = found.astype(np.float64)[controls[at, column] + phantoms[at, column]]
    given[at, column] = 2.0 * given[at, column] - beside
    # Sums written out, since BLAS' last bits depend on how many there are.
    return np.stack(
        [sum(row[i] * given[:, i] for i in range(given.shape[1])) for row in matrix], axis=1
    )


def _widths(
    curves: UsdGeom.BasisCurves, shape: ShapeOfCurves, time: Usd.TimeCode
) -> tuple[NDArray[np.float64], list[str]]:
    """Widths at the ends of segments, float64 [k, 2], and what is lost."""
    prim, count = curves.GetPrim(), len(shape._segments.curve)
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("widths")
    if primvar and primvar.HasValue():
        found, kind = values.flattened(primvar, np.float64, time), primvar.GetInterpolation()
    else:
        found = values.array(curves.GetWidthsAttr(), np.float64, time)
        kind = curves.GetWidthsInterpolation()
    if not len(found):
        return np.zeros((count, 2)), [NO_WIDTH] * bool(count)
    if not (np.isfinite(found).all() and found.min() >= 0.0):
        raise StageError(f"{prim.GetPath()}: widths below 0, or not finite")
    if len(found) == 1:
        return np.full((count, 2), found[0]), []
    column = found.astype(np.float32)[:, None]
    ends: list[NDArray[np.float64] | None] = []
    for t in (0.0, 1.0):
        layout = TubeLayout(np.arange(count), np.full(count, t), shape._counts, 0.0)
        ends.append(replace(shape, layout=layout).at_samples(column, kind))
    if ends[0] is None or ends[1] is None:
        raise StageError(
            f"{prim.GetPath()}: {len(found)} widths ({kind}): expected one, or as many as its "
            "curves need"
        )
    # Splines of widths may swing below 0.
    return np.maximum(np.stack([end[:, 0] for end in ends if end is not None], axis=1), 0.0), []
