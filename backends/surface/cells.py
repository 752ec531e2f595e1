"""Pictures laid in cells, so that they do not repeat, and colors of two scales: the definition.

This is the reference that renderers are held against: each does the same arithmetic in its own
language. Both are for maps projected from above.

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
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Cells, Maps, Reading
from scenec.backends.surface.maps import map_file, map_source, map_values, sample
from scenec.schemas.cells import SIDE, table

#: From x, y to the lattice's own coordinates in which corners are whole numbers; and back.
TO_LATTICE = ((1.0, -1.0 / math.sqrt(3.0)), (0.0, 2.0 / math.sqrt(3.0)))
TO_WORLD = ((1.0, 0.5), (0.0, 0.5 * math.sqrt(3.0)))


def corners(cells: Cells, xy: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """The three cells at points [..., 2].

    Returns:
        Corners in the lattice's coordinates, int64 [..., 3, 2]; shares [..., 3]; and what the
        points are from the corners, meters [..., 3, 2].
    """
    at = np.asarray(xy, np.float64) / cells.size_m
    place = np.stack([at @ np.array(row) for row in TO_LATTICE], axis=-1)
    low = np.floor(place)
    x, y = np.moveaxis(place - low, -1, 0)
    upper = np.where(x + y >= 1.0, 1.0, 0.0)
    one, zero = np.ones_like(x), np.zeros_like(x)
    # Two corners are those of both triangles of a rhombus.
    steps = np.stack(
        [
            np.stack([upper, upper], axis=-1),
            np.stack([one, zero], axis=-1),
            np.stack([zero, one], axis=-1),
        ],
        axis=-2,
    )
    near = np.stack(
        [
            np.abs(1.0 - x - y),
            np.where(upper > 0.0, 1.0 - y, x),
            np.where(upper > 0.0, 1.0 - x, y),
        ],
        axis=-1,
    )
    squares = near * near
    fourth = squares * squares
    shares = fourth / fourth.sum(axis=-1, keepdims=True)
    away = np.stack([x, y], axis=-1)[..., None, :] - steps
    offsets = np.stack([away @ np.array(row) for row in TO_WORLD], axis=-1) * cells.size_m
    return (low[..., None, :] + steps).astype(np.int64), shares, offsets


def mixed(
    values: NDArray, shares: NDArray, mean: NDArray | float, upper: float | None
) -> NDArray[np.float64]:
    """Values of the three cells [..., 3, c] at their shares [..., 3]; see the module."""
    spread = np.sqrt((shares * shares).sum(axis=-1))[..., None]
    total = (shares[..., None] * (values - mean)).sum(axis=-2)
    found: NDArray[np.float64] = np.clip(mean + total / spread, 0.0, upper)
    return found


def most(kind: str) -> float | None:
    """The largest value of a kind of map; None: there is none."""
    return None if kind == "emission" else 1.0


def map_mean(described: Maps, kind: str) -> NDArray[np.float64]:
    """Mean of a map over its picture, [1 or 3]."""
    return _mean(*map_source(described, kind), described)


@lru_cache(maxsize=64)
def _mean(
    path: object, kind: str, flip_green: bool, reading: Reading, described: Maps
) -> NDArray[np.float64]:
    mean: NDArray[np.float64] = map_values(described, kind).mean(axis=(0, 1), dtype=np.float64)
    mean.setflags(write=False)
    return mean


def value(described: Maps, kind: str, xy: NDArray) -> NDArray[np.float64]:
    """A map of numbers or colors projected from above, with its cells and far scale, [..., c].

    Args:
        described: With the projection "above".
        kind: Any but "normal".
        xy: World, [..., 2].
    """
    found = _scaled(described, kind, xy, 1.0)
    if described.far is None or kind != "base_color":
        return found
    factor, share = described.far
    mean = map_mean(described, kind)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(mean > 0.0, _scaled(described, kind, xy, factor) / mean, 1.0)
    return np.asarray(found * (1.0 + share * (relative - 1.0)), np.float64)


def _scaled(described: Maps, kind: str, xy: NDArray, factor: float) -> NDArray[np.float64]:
    """The picture, and its cells, ``factor`` times as large."""
    picture = map_values(described, kind)
    size = described.size_m * factor
    if described.cells is None:
        at = np.asarray(xy, np.float64) / size
        return sample(picture, at[..., 0], at[..., 1])
    cells = Cells(described.cells.size_m * factor, described.cells.seed)
    values, shares, _ = _cells(picture, cells, size, xy)
    return mixed(values, shares, map_mean(described, kind), most(kind))


def _cells(
    picture: NDArray[np.floating], cells: Cells, size: float, xy: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """Values of the three cells [..., 3, c], their shares [..., 3], and turns in radians."""
    corner, shares, offsets = corners(cells, xy)
    entry = table(cells.seed)[corner[..., 1] % SIDE, corner[..., 0] % SIDE]
    turn = 2.0 * np.pi * entry[..., 2]
    cosine, sine = np.cos(turn), np.sin(turn)
    x, y = offsets[..., 0] / size, offsets[..., 1] / size
    u = cosine * x - sine * y + entry[..., 0]
    v = sine * x + cosine * y + entry[..., 1]
    return sample(picture, u, v), shares, turn


def normal(described: Maps, xy: NDArray) -> NDArray[np.float64]:
    """What a map of normals projected from above holds, unit vectors [..., 3]: x along u = x."""
    picture = map_values(described, "normal")
    if described.cells is None:
        at = np.asarray(xy, np.float64) / described.size_m
        return sample(picture, at[..., 0], at[..., 1])
    values, shares, turn = _cells(picture, described.cells, described.size_m, xy)
    cosine, sine = np.cos(turn), np.sin(turn)
    x = cosine * values[..., 0] + sine * values[..., 1]
    y = cosine * values[..., 1] - sine * values[..., 0]
    spread = np.sqrt((shares * shares).sum(axis=-1))
    found = np.stack(
        [
            (shares * x).sum(axis=-1) / spread,
            (shares * y).sum(axis=-1) / spread,
            (shares * values[..., 2]).sum(axis=-1),
        ],
        axis=-1,
    )
    length = np.sqrt((found * found).sum(axis=-1, keepdims=True))
    turned: NDArray[np.float64] = found / np.where(length > 0.0, length, 1.0)
    return turned


def has_maps(described: Maps | None, kind: str) -> bool:
    """Whether there are maps, and one of this kind."""
    return described is not None and map_file(described, kind) is not None
