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

from scenec.backends.surface.algebra import Algebra, Number, Turn, Vector
from scenec.schemas.cells import table

#: From x, y to the lattice's own coordinates in which corners are whole numbers; and back.
TO_LATTICE = ((1.0, -1.0 / math.sqrt(3.0)), (0.0, 2.0 / math.sqrt(3.0)))
TO_WORLD = ((1.0, 0.5), (0.0, 0.5 * math.sqrt(3.0)))


class Lattice(NamedTuple):
    """Places the lattice of cells.

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
        place: Where the picture is looked up, a vector of u, v and anything.
        share, gain: Of what is mixed by the shares alone, and so that variance stays.
        turn: Its.
    """

    place: Vector
    share: Number
    gain: Number
    turn: Turn


#: Shift (a vector of u, v and anything) and turn of a corner in the lattice's coordinates, a vector
#: whose third component is not looked at.
type Entry = Callable[[Vector], tuple[Vector, Turn]]


def corners(fn: Algebra, lattice: Lattice, position: Vector, entry: Entry) -> list[Corner]:
    """The three cells at a point of the renderer's coordinates."""
    (_, skew), (_, rise) = TO_LATTICE
    (_, lean), (_, high) = TO_WORLD
    repeats = lattice.repeats
    x, y, _ = fn.parts(position)
    s = (x + skew * y) * lattice.step + lattice.start[0]
    t = y * (rise * lattice.step) + lattice.start[1]
    at = fn.vector(s, t, 0.0)
    first = fn.floor(at)
    x, y, _ = fn.parts(at - first)
    rest = 1.0 - x - y
    upper = fn.select(rest, 0.0, 1.0)
    both = upper * rest
    near = fn.vector(rest, x + both, y + both)
    squares = near * near
    fourth = squares * squares
    shares = fn.parts(fourth * (1.0 / fn.dot(fourth, fn.vector(1.0, 1.0, 1.0))))
    gains = fn.parts(fourth * (1.0 / fn.length(fourth)))
    # From the triangle's first corner and from the others, in repeats of the picture.
    away = fn.vector(repeats * x + (lean * repeats) * y, (high * repeats) * y, 0.0)
    others = [
        (
            fn.vector(upper, upper, 0.0),
            fn.vector((1.0 + lean) * repeats, high * repeats, 0.0) * upper,
        ),
        (fn.vector(1.0, 0.0, 0.0), fn.vector(repeats, 0.0, 0.0)),
        (fn.vector(0.0, 1.0, 0.0), fn.vector(lean * repeats, high * repeats, 0.0)),
    ]
    found = []
    for share, gain, (step, there) in zip(shares, gains, others, strict=True):
        shift, turn = entry(first + step)
        found.append(Corner(fn.turned(away - there, turn) + shift, share, gain, turn))
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
    total = None
    for cell, normal in zip(cells, normals, strict=True):
        own = fn.turned(normal, cell.turn, back=True)
        part = own * fn.vector(cell.gain, cell.gain, cell.share)
        total = part if total is None else total + part
    return fn.unit(total)


@lru_cache(maxsize=8)
def corner_table(seed: int) -> NDArray[np.float64]:
    """``Entry`` of each corner, [SIDE, SIDE, 4], by [j, i] modulo SIDE."""
    entry = table(seed)
    turn = 2.0 * np.pi * entry[..., 2]
    found = np.stack([entry[..., 0], entry[..., 1], np.cos(turn), np.sin(turn)], axis=-1)
    found.setflags(write=False)
    return found
