"""Samples candidate places by density from numbers in [0, 1), through prefix sums.

The first candidate of an instance comes from what was drawn for it; the next ones from a hash of
the class's key, the instance and the number of the try: no generator is needed after ``draw``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.noise.lattice import hash2, subkeys, unit
from scenec.compiler.objects.lattice import PlanLattice
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import POINTS, over_threads


class CandidateData(NamedTuple):
    """Holds ``Candidates`` as kernels take them.

    Attributes:
        cumulative, corners: As there.
        corner, size: Of the lattice, and of its cells, in x and y, meters.
        columns, rows: Of the lattice.
    """

    cumulative: NDArray[np.float64]
    corners: NDArray[np.float64]
    corner: tuple[float, float]
    size: tuple[float, float]
    columns: int
    rows: int


@dataclass(frozen=True, eq=False)
class Candidates:
    """Maps three uniform numbers to a place: the first to a cell or face, the others within it.

    Attributes:
        lattice: The cells; faces are taken where there are ``corners``.
        cumulative: Running sum of what each cell or face holds, float64 [m]; empty: all the same.
        corners: Of the faces in plan, float64 [m, 3, 2]; empty on heights.
        share: Part of the density that ``where`` left.
    """

    lattice: PlanLattice
    cumulative: NDArray[np.float64]
    corners: NDArray[np.float64]
    share: float

    def cells(self) -> CandidateData:
        """Returns the arrays as ``point`` takes them."""
        (ny, nx), of = self.lattice.shape, self.lattice
        return CandidateData(self.cumulative, self.corners, (of.x0, of.y0), (of.dx, of.dy), nx, ny)

    def at(
        self, u: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Points: x and y in meters, float64 [n], and the cell or face, int64 [n].

        Args:
            u: In [0, 1), float64 [n, 3].
        """
        x, y, index = np.empty(len(u)), np.empty(len(u)), np.empty(len(u), np.int64)
        u = np.ascontiguousarray(u)
        over_threads(_points_part, len(u), self.cells(), u, x, y, index, least=POINTS)
        return x, y, index

    def allowed(self) -> float:
        """Share of the ground in plan that is in cells or faces where anything may be."""
        if not self.cumulative.size:
            return 1.0
        held = np.diff(self.cumulative, prepend=0.0) > 0.0
        if not len(self.corners):
            return int(held.sum()) / held.size
        a, b, c = (self.corners[:, k] for k in range(3))
        area = np.abs(
            (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        )
        return float(area[held].sum() / area.sum())


@kernel
def point(cells, u, v, w):  # type: ignore[no-untyped-def]
    """x, y, and the index of the cell or face, of three numbers in [0, 1)."""
    cumulative, nx = cells.cumulative, cells.columns
    if cumulative.size:
        total = u * cumulative[-1]
        index = np.searchsorted(cumulative, total, side="right")
        # u < 1, yet u * total can round up to total itself.
        index = min(index, cumulative.size - 1)
    else:
        count = nx * cells.rows
        index = min(int(u * count), count - 1)
    if cells.corners.shape[0]:
        # Uniform over a triangle (Turk 1990).
        root = np.sqrt(v)
        a, b, c = 1.0 - root, root * (1.0 - w), root * w
        face = cells.corners[index]
        return (
            a * face[0, 0] + b * face[1, 0] + c * face[2, 0],
            a * face[0, 1] + b * face[1, 1] + c * face[2, 1],
            index,
        )
    (x0, y0), (dx, dy) = cells.corner, cells.size
    return x0 + dx * (index % nx + v), y0 + dy * (index // nx + w), index


@kernel
def _points_part(first, last, cells, u, x, y, index):  # type: ignore[no-untyped-def]
    for n in range(first, last):
        x[n], y[n], index[n] = point(cells, u[n, 0], u[n, 1], u[n, 2])


def numbers(
    u: NDArray[np.float64], key: int, instances: NDArray[np.int64], attempts: NDArray[np.int64]
) -> NDArray[np.float64]:
    """The three numbers of given tries: those drawn at try 0, hashes after it. Float64 [m, 3].

    Args:
        u: What was drawn, float64 [n, 3].
        instances, attempts: Which, int64 [m].
    """
    return _numbers(u, subkeys(np.uint64(key), 3), instances, attempts)


@kernel
def _numbers(u, keys, instances, attempts):  # type: ignore[no-untyped-def]
    out = np.empty((len(instances), 3))
    for n in range(len(instances)):
        i = instances[n]
        for k in range(3):
            if attempts[n] == 0:
                out[n, k] = u[i, k]
            else:
                out[n, k] = unit(hash2(keys[k], i, attempts[n]))
    return out
