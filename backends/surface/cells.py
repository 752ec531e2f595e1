"""Pictures laid in cells, so that they do not repeat; for maps projected from above.

Cells stand on the corners of a triangular lattice of side ``Cells.size_m`` over the world's x and
y, one at the origin, one on the x axis (after Heitz and Neyret 2018, High-Performance By-Example
Noise using a Histogram-Preserving Blending Operator; Mikkelsen 2022, Practical Real-Time
Hex-Tiling). Each corner has a turn and a shift (``table``): around it the picture lies at

    (u, v) = R(turn) (p - corner) / Maps.size_m + shift,   R counter-clockwise.

At a point, the three corners of its triangle have the barycentric coordinates b_i, and the shares
w_i = b_i**4 / sum b**4: most of a cell is the picture as it is, and seams are a sixth of a side
wide. Values are mixed so that their variance stays that of the picture (Heitz and Neyret's
operator, without their change of histogram),

    mean + sum w_i (c_i - mean) / sqrt(sum w_i**2),

clipped to what values of the kind may be. Normals are turned back with their cell; the parts along
the surface mix likewise about a mean of zero, the part across by the shares alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.surface.algebra import Algebra, Number, Vector
from scenec.schemas.cells import table

#: From x, y to the lattice's own coordinates in which corners are whole numbers; and back.
TO_LATTICE = ((1.0, -1.0 / math.sqrt(3.0)), (0.0, 2.0 / math.sqrt(3.0)))
TO_WORLD = ((1.0, 0.5), (0.0, 0.5 * math.sqrt(3.0)))


class Lattice(NamedTuple):
    """Where cells are.

    Attributes:
        step: Sides of the lattice in one unit of the renderer's coordinates.
        start: Where the origin of these lies in the lattice, two numbers in [0, SIDE).
        repeats: Of the picture along a side.
        seed: Of the table.
    """

    step: Number
    start: tuple[Number, Number]
    repeats: Number
    seed: int


class Corner(NamedTuple):
    """One of the three cells at a point.

    Attributes:
        u, v: Where the picture is looked up.
        share, gain: Of what is mixed by the shares alone, and so that variance stays.
        cosine, sine: Of its turn.
    """

    u: Number
    v: Number
    share: Number
    gain: Number
    cosine: Number
    sine: Number


#: Shift along u and v, cosine and sine of the turn, of a corner in the lattice's coordinates.
type Entry = Callable[[Number, Number], tuple[Number, Number, Number, Number]]


def corners(fn: Algebra, lattice: Lattice, x: Number, y: Number, entry: Entry) -> list[Corner]:
    """The three cells at a point of the renderer's coordinates."""
    (_, skew), (_, rise) = TO_LATTICE
    (_, lean), (_, high) = TO_WORLD
    s = (x + skew * y) * lattice.step + lattice.start[0]
    t = rise * y * lattice.step + lattice.start[1]
    column, row = fn.floor(s), fn.floor(t)
    x, y = s - column, t - row
    rest = 1.0 - x - y
    upper = fn.select(rest, 0.0, 1.0)
    both = upper * rest
    near = fn.vector(rest, x + both, y + both)
    squares = near * near
    fourth = squares * squares
    powers = fn.parts(fourth)
    total = 1.0 / (powers[0] + powers[1] + powers[2])
    spread = 1.0 / fn.length(fourth)
    found = []
    for power, i, j in zip(powers, (upper, 1.0, 0.0), (upper, 0.0, 1.0), strict=True):
        dx, dy = x - i, (y - j) * lattice.repeats
        dx, dy = dx * lattice.repeats + lean * dy, high * dy
        shift_u, shift_v, cosine, sine = entry(column + i, row + j)
        u = cosine * dx - sine * dy + shift_u
        v = sine * dx + cosine * dy + shift_v
        found.append(Corner(u, v, power * total, power * spread, cosine, sine))
    return found


def mixed(
    fn: Algebra, cells: Sequence[Corner], values: Sequence[Number], mean: Number, most: float | None
) -> Number:
    """Numbers or vectors of the three cells; see the module.

    Args:
        fn: The algebra.
        cells: From ``corners``.
        values: Of each cell.
        mean: Of the picture.
        most: The largest value there is, or None.
    """
    total = mean * (1.0 - (cells[0].gain + cells[1].gain + cells[2].gain))
    for cell, value in zip(cells, values, strict=True):
        total = total + value * cell.gain
    return fn.maximum(total, 0.0) if most is None else fn.clip(total, 0.0, most)


def turned_back(fn: Algebra, cells: Sequence[Corner], normals: Sequence[Vector]) -> Vector:
    """The mixture of mapped normals of the three cells, a unit vector along the world's axes."""
    x = y = z = 0.0
    for cell, normal in zip(cells, normals, strict=True):
        u, v, w = fn.parts(normal)
        x = x + cell.gain * (cell.cosine * u + cell.sine * v)
        y = y + cell.gain * (cell.cosine * v - cell.sine * u)
        z = z + cell.share * w
    return fn.unit(fn.vector(x, y, z))


@lru_cache(maxsize=8)
def corner_table(seed: int) -> NDArray[np.float64]:
    """``Entry`` of each corner, [SIDE, SIDE, 4], by [j, i] modulo SIDE."""
    entry = table(seed)
    turn = 2.0 * np.pi * entry[..., 2]
    found = np.stack([entry[..., 0], entry[..., 1], np.cos(turn), np.sin(turn)], axis=-1)
    found.setflags(write=False)
    return found
