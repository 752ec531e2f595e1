"""The surface model's maps and merges by hand, in float64: the oracle of every renderer's tests.

Written apart from ``scenec.backends.surface``, whose one definition all renderers and the light
meter share: arrays [..., 3], one function a formula, nothing but NumPy.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Cells, Maps
from scenec.backends.surface import lobes
from scenec.backends.surface.maps import map_values, sample
from scenec.schemas.cells import SIDE, table

#: World axes that are u and v on the planes across x, y and z.
PLANES = ((1, 2), (0, 2), (0, 1))
#: From x, y to the lattice's own coordinates in which corners are whole numbers; and back.
TO_LATTICE = np.array([[1.0, -1.0 / np.sqrt(3.0)], [0.0, 2.0 / np.sqrt(3.0)]])
TO_WORLD = np.array([[1.0, 0.5], [0.0, 0.5 * np.sqrt(3.0)]])


def mean_of(described: Maps, kind: str) -> NDArray[np.float64]:
    """Mean of a map over its picture, [1 or 3]."""
    mean: NDArray[np.float64] = map_values(described, kind).mean(axis=(0, 1), dtype=np.float64)
    return mean


def corners(cells: Cells, xy: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """The three cells at points [..., 2].

    Returns:
        Corners in the lattice's coordinates, int64 [..., 3, 2]; shares [..., 3]; and what the
        points are from the corners, meters [..., 3, 2].
    """
    at = np.asarray(xy, np.float64) / cells.size_m
    place = at @ TO_LATTICE.T
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
    offsets = away @ TO_WORLD.T * cells.size_m
    return (low[..., None, :] + steps).astype(np.int64), shares, offsets


def mixed(
    values: NDArray, shares: NDArray, mean: NDArray | float, upper: float | None
) -> NDArray[np.float64]:
    """Values of the three cells [..., 3, c] at their shares [..., 3]; see the module."""
    spread = np.sqrt((shares * shares).sum(axis=-1))[..., None]
    total = (shares[..., None] * (values - mean)).sum(axis=-2)
    found: NDArray[np.float64] = np.clip(mean + total / spread, 0.0, upper)
    return found


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
    mean = mean_of(described, kind)
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
    return mixed(values, shares, mean_of(described, kind), None if kind == "emission" else 1.0)


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


def heeded(weight: NDArray, depth: float, below: NDArray, above: NDArray) -> NDArray[np.float64]:
    """Weight of one merge, w'; arguments of shapes that fit each other."""
    weight = np.asarray(weight, np.float64)
    if depth <= 0.0:
        return weight
    depth = max(depth, 1e-3)
    over = (2.0 * weight - 1.0) * (1.0 + depth) + (above - below)
    found: NDArray[np.float64] = np.clip(0.5 + over / (2.0 * depth), 0.0, 1.0)
    return found


def heeded_weights(
    weights: Sequence[NDArray], depths: Sequence[float], heights: Sequence[NDArray]
) -> list[NDArray[np.float64]]:
    """Weights of all merges, w', from the base up.

    Args:
        weights: Of each merge.
        depths: Of each merge, or none at all: 0.
        heights: Of each layer, one more than there are merges.
    """
    at = np.asarray(heights[0], np.float64)
    found = []
    for number, weight in enumerate(weights):
        depth = depths[number] if depths else 0.0
        own = heeded(weight, depth, at, heights[number + 1])
        at = at + own * (heights[number + 1] - at)
        found.append(own)
    return found


def triplanar_weights(normals: NDArray) -> NDArray[np.float64]:
    """Share of the planes across x, y and z where the unit shading normals are [..., 3].

    n**4 of each component, over their sum: equal on a vector and its opposite, and smooth.
    """
    squares = np.square(np.asarray(normals, np.float64))
    fourth = squares * squares
    shares: NDArray[np.float64] = fourth / fourth.sum(axis=-1, keepdims=True)
    return shares


def triplanar(
    picture: NDArray[np.floating], size_m: float, positions: NDArray, normals: NDArray
) -> NDArray[np.float64]:
    """A picture of numbers or colors [h, w, c] on a surface, [..., c].

    Args:
        picture: From ``map_values``.
        size_m: Side of one repeat.
        positions: World, [..., 3].
        normals: Unit shading normals, [..., 3].
    """
    shares = triplanar_weights(normals)
    at = np.asarray(positions, np.float64) / size_m
    total = np.zeros((*at.shape[:-1], picture.shape[2]))
    for axis, (u, v) in enumerate(PLANES):
        total += shares[..., axis, None] * sample(picture, at[..., u], at[..., v])
    return total


def uv_normal(
    mapped: NDArray[np.floating], normals: NDArray, along_u: NDArray, along_v: NDArray
) -> NDArray[np.float64]:
    """Normals of a map in the frame of texture coordinates, unit vectors [..., 3].

    The tangent is dP/du of the triangle, less its part along the shading normal; the bitangent is
    across both, on the side of dP/dv. Unlike MikkTSpace's, they are not averaged over a vertex's
    triangles: the two agree where coordinates are smooth in space. Where a triangle has no area in
    the picture, normals stay as they are.

    Args:
        mapped: Values of the map, [..., 3].
        normals: Unit shading normals, [..., 3].
        along_u, along_v: Of ``face_tangents``, in the world, [..., 3].
    """
    n = np.asarray(normals, np.float64)
    lift = (n * along_u).sum(axis=-1, keepdims=True)
    tangent = along_u - lift * n
    length = np.sqrt((tangent * tangent).sum(axis=-1, keepdims=True))
    tangent = tangent / np.where(length > 0.0, length, 1.0)
    across = np.cross(n, tangent)
    side = np.sign((across * along_v).sum(axis=-1, keepdims=True))
    leaned = mapped[..., :1] * tangent + mapped[..., 1:2] * side * across + mapped[..., 2:3] * n
    size = np.sqrt((leaned * leaned).sum(axis=-1, keepdims=True))
    found: NDArray[np.float64] = np.where((length > 0.0) & (size > 0.0), leaned / size, n)
    return found


def brighter(
    color: NDArray | float, roughness: NDArray | float, cosine: NDArray | float
) -> NDArray[np.float64]:
    """What bounces after the first make a lobe of a color brighter by (Kulla and Conty 2017).

    Albedos are the definition's polynomials, which ``test_rough_lobes`` holds against integrals.
    """
    color, alpha = np.asarray(color, np.float64), np.maximum(np.square(roughness), 1e-3)
    once = lobes.albedo(alpha, np.asarray(cosine, np.float64))
    mean = np.polynomial.polynomial.polyval(alpha, lobes.MEAN_ALBEDO)
    found: NDArray[np.float64] = 1.0 + color * mean / (1.0 - color * (1.0 - mean)) * (
        1.0 / once - 1.0
    )
    return found
