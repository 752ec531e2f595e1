"""Evaluates the ground's surface at any point: what a mesh of any fineness stands for.

Between a grid's samples lies a smooth surface through them, and on it the detail that the grid is
too coarse for: octaves left out, and the displacement of the materials, mixed by their weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.mesh.merge import Merge
from scenec.compiler.terrain.detail import Detail, finer, finer_than, joined, local, over
from scenec.compiler.terrain.grid import HeightField, located
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

#: Of merges at points: float64 [n] each, or [k, n].
_Sides = Sequence[NDArray[np.float64]] | NDArray[np.float64]


@dataclass(frozen=True)
class GroundSurface:
    """Heights and label fields at points.

    Attributes:
        field: The grid's heights.
        merges: Ground merges.
        details: Relief finer than the grid.
        displacements: Of each ground layer, the base first, or None.
        smooth: False takes the grid's own triangles as the truth, and nothing finer.
        shade: What is added to the albedo's variation, or None.
    """

    field: HeightField
    merges: tuple[Merge, ...] = ()
    details: tuple[Detail, ...] = ()
    displacements: tuple[Detail | None, ...] = ()
    smooth: bool = True
    shade: HeightField | None = None

    def evaluate(
        self, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        """Heights, float64 [n], and the merges' sides, float64 [n] each."""
        sides = [merge.side(x, y) for merge in self.merges]
        return self.height_at(x, y, sides), sides

    def height_at(
        self,
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        sides: _Sides | None = None,
    ) -> NDArray[np.float64]:
        """Heights, float64 [n], meters; ``sides`` of the merges there, where they are known."""
        if not self.smooth:
            return self.field.height_at(x, y)
        height = _smooth_heights(self.field, x, y)
        for detail in self.details:
            height += detail.at(x, y)
        if any(self.displacements):
            if sides is None:
                sides = [merge.side(x, y) for merge in self.merges]
            for layer, share in zip(self.displacements, self._shares(sides, x.size), strict=True):
                if layer is not None:
                    there = np.flatnonzero(share)
                    added = over(layer, x[there], y[there], height[there])
                    height[there] += share[there] * added
        return height

    def lift_at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the surface's height above the grid's triangles, float64 [n], meters."""
        if not self.smooth:
            return np.zeros(x.shape)
        return self.height_at(x, y) - self.field.height_at(x, y)

    def displaced(self, sides: _Sides, count: int) -> NDArray[np.float64]:
        """Shares of the layers that have a displacement, float64 [count, l], from merges' sides."""
        if not self.smooth or not any(self.displacements):
            return np.zeros((count, 0))
        shares = zip(self.displacements, self._shares(sides, count), strict=True)
        return np.stack([share for layer, share in shares if layer is not None], axis=1)

    def finer_than(
        self,
        length_m: NDArray[np.float64],
        shares: NDArray[np.float64],
        faces: NDArray[np.int32],
        balls: tuple[NDArray[np.float64], NDArray[np.float64]],
    ) -> NDArray[np.float64]:
        """About how large the detail is that is finer than given lengths, meters, float64 [m].

        Args:
            length_m: For each face, float64 [m].
            shares: From ``displaced``, at the vertices, float64 [n, l].
            faces: int32 [m, 3]; the largest at a face's corners counts.
            balls: About the faces: centers, float64 [m, 3], and radii, float64 [m].
        """
        details = self.details if self.smooth else ()
        layers = [layer for layer in self.displacements if layer is not None][: shares.shape[1]]
        everywhere = joined([detail.spectrum() for detail in details if local(detail) is None])
        tables = finer([everywhere, *(layer.spectrum() for layer in layers)])
        out: NDArray[np.float64] = _largest(faces, shares, length_m, tables)
        for detail in details:
            somewhere = local(detail)
            if somewhere is not None:
                x, y = np.ascontiguousarray(balls[0][:, :2].T)
                out += somewhere.finer_at(x, y, balls[1], length_m)
        return out

    def amplitude_m(self) -> float:
        """About how far the surface gets from the grid's samples, meters."""
        shown = [d for d in (*self.details, *self.displacements) if d is not None]
        spectra = [detail.spectrum() for detail in shown] if self.smooth else []
        return float(joined(spectra).amplitude_m.sum())

    def _shares(self, sides: _Sides, count: int) -> NDArray[np.float64]:
        """Returns each merged layer's share, float64 [k, n]: they add up to 1."""
        shares = np.ones((1 + len(self.merges), count))
        for k, (merge, side) in enumerate(zip(self.merges, sides, strict=True), start=1):
            shares[k] = merge.weight_of_side(side)
        _cover(shares)
        return shares


@kernel
def _cover(shares):  # type: ignore[no-untyped-def]
    """Multiplies layers by the transparency of those above them, float64 [k, n], in place."""
    for layer in range(1, len(shares)):
        for below in range(layer):
            for n in range(shares.shape[1]):
                shares[below, n] *= 1.0 - shares[layer, n]


@kernel
def _largest(faces, shares, length, tables):  # type: ignore[no-untyped-def]
    """Returns the largest relief finer than each face at its corners, layers by their shares."""
    out = np.zeros(len(faces))
    of_layers = np.empty(shares.shape[1])
    for f in range(len(faces)):
        everywhere = finer_than(tables, 0, length[f])
        for layer in range(len(of_layers)):
            of_layers[layer] = finer_than(tables, 1 + layer, length[f])
        for k in range(3):
            total = everywhere
            for layer in range(len(of_layers)):
                total += shares[faces[f, k], layer] * of_layers[layer]
            out[f] = max(out[f], total)
    return out


@inlined
def _slope(before: float, after: float) -> float:
    """Slope at a sample from the rises to it and from it: central, unless it would overshoot.

    Central differences are limited to three times the smaller rise (Fritsch and Carlson 1980 for
    rises of one sign): beside a cliff the surface stays level, and it exceeds the samples around it
    by less than half of the smaller rise.
    """
    limit = 3.0 * min(abs(before), abs(after))
    return min(max(0.5 * (before + after), -limit), limit)


@inlined
def _hermite(p0: float, p1: float, p2: float, p3: float, t: float) -> float:
    """Between p1 and p2."""
    rise = p2 - p1
    first = _slope(p1 - p0, rise)
    second = _slope(rise, p3 - p2)
    return p1 + t * (
        first + t * (3.0 * rise - 2.0 * first - second + t * (first + second - 2.0 * rise))
    )


@inlined
def _row(height, j, i, t):  # type: ignore[no-untyped-def]
    nx = height.shape[1]
    h1 = height[j, i]
    h2 = height[j, i + 1]
    # Beyond the border the surface goes on as it is.
    h0 = height[j, i - 1] if i > 0 else h1 - (h2 - h1)
    h3 = height[j, i + 2] if i + 2 < nx else h2 + (h2 - h1)
    return _hermite(h0, h1, h2, h3, t)


@kernel
def _smooth_heights_part(first, last, height, frame, x, y, out):  # type: ignore[no-untyped-def]
    ny, nx = height.shape
    x0, y0, dx, dy = frame
    for n in range(first, last):
        i, u = located(x[n], x0, dx, nx)
        j, v = located(y[n], y0, dy, ny)
        h1 = _row(height, j, i, u)
        h2 = _row(height, j + 1, i, u)
        h0 = _row(height, j - 1, i, u) if j > 0 else h1 - (h2 - h1)
        h3 = _row(height, j + 2, i, u) if j + 2 < ny else h2 + (h2 - h1)
        out[n] = _hermite(h0, h1, h2, h3, v)


def _smooth_heights(
    field: HeightField, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Cubic in both directions through the samples, continuous with its slope: float64 [n]."""
    out = np.empty(x.size)
    ground = field.height, field.frame()
    over_threads(_smooth_heights_part, x.size, *ground, x, y, out, least=POINTS)
    return out
