"""The maps of a surface at a point: projections, cells and second scale of all kinds at once.

Colors of two scales: c * (1 + share * (c_far / mean - 1)), c_far the same picture ``factor`` times
as large.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Maps
from scenec.backends.surface import cells, projections
from scenec.backends.surface.algebra import FLOAT64, Algebra, Number, Vector
from scenec.backends.surface.maps import map_file, map_mean, map_values, sample
from scenec.backends.surface.projections import PLANES
from scenec.schemas.cells import SIDE

#: Values of kinds of maps: numbers, or vectors of colors and normals.
type Values = dict[str, Any]


#: Looks pictures up: values of all kinds at (u, v), bilinear and repeating. Beside these it takes
#: ``axis``, which the plane lies across, and ``far``: only colors, of the second scale.
type Texels = Callable[..., Values]


@dataclass(frozen=True)
class Point:
    """A point of a surface, in an algebra's kind; what is not looked at need not be there.

    Attributes:
        position: In the renderer's coordinates.
        normal: Unit shading normal, where it points outward.
        flat: Unit normal of the face, on either side.
        uv: Texture coordinates, two numbers.
        along_u, along_v: dP/du and dP/dv, of any length.
    """

    position: Vector
    normal: Vector = None
    flat: Vector = None
    uv: Any = None
    along_u: Vector = None
    along_v: Vector = None


@dataclass(frozen=True)
class Scale:
    """Places pictures of one size in the renderer's coordinates.

    Attributes:
        step: Repeats in one unit.
        start: Where their origin lies in the picture, a vector.
        lattice: Of cells, or None.
    """

    step: Number
    start: Vector
    lattice: cells.Lattice | None


@dataclass(frozen=True)
class Placement:
    """Places the maps of a surface.

    Attributes:
        projection: As of ``Maps``.
        near: Their scale; None by texture coordinates.
        means: Of the pictures, where there are cells.
        far: Colors' second scale, or None.
        gain, rest: Colors are multiplied by rest + gain * the larger picture.
    """

    projection: str
    near: Scale | None
    means: Values
    far: Scale | None = None
    gain: Vector = None
    rest: Vector = None


def place(
    fn: Algebra, maps: Maps, kinds: Sequence[str], center: NDArray[np.float64], unit_m: float = 1.0
) -> Placement:
    """Computes the placement of maps.

    Args:
        fn: The algebra, whose numbers they become.
        maps: A surface's.
        kinds: What will be looked up.
        center: World position of the origin of the renderer's coordinates, meters.
        unit_m: Meters in one unit of these.
    """

    def scale(factor: float) -> Scale:
        size = maps.size_m * factor
        # Whole repeats between the stage's origin and the renderer's leave no trace.
        step, start = fn.number(unit_m / size), fn.numbers(np.mod(center / size, 1.0))
        if maps.cells is None:
            return Scale(step, start, None)
        side = maps.cells.size_m * factor
        at = np.mod(np.array(cells.TO_LATTICE) @ center[:2] / side, SIDE)
        corner = (fn.number(at[0]), fn.number(at[1]))
        step, repeats = fn.number(unit_m / side), fn.number(side / size)
        return Scale(step, start, cells.Lattice(step, corner, repeats, maps.cells.seed))

    if maps.projection == "uv":
        return Placement(maps.projection, None, {})
    means = {}
    if maps.cells is not None:
        means = {k: fn.numbers(map_mean(maps, k)) for k in kinds if k != "normal"}
    if maps.far is None or "base_color" not in kinds:
        return Placement(maps.projection, scale(1.0), means)
    factor, share = maps.far
    gain, rest = far_factors(map_mean(maps, "base_color"), share)
    numbers = fn.numbers(gain), fn.numbers(rest)
    return Placement(maps.projection, scale(1.0), means, scale(factor), *numbers)


def far_factors(
    mean: NDArray[np.float64], share: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """``Placement.gain`` and ``rest``; a channel that is black everywhere is so at any scale."""
    gain = np.divide(share, mean, out=np.zeros(3), where=mean > 0.0)
    return gain, np.where(mean > 0.0, 1.0 - share, 1.0)


def look_up(
    fn: Algebra, placement: Placement, point: Point, texels: Texels, entry: cells.Entry | None
) -> Values:
    """Values of all kinds at a point; "normal" is the leaned normal, where it points outward.

    Args:
        fn: The algebra.
        placement: Of the maps.
        point: The point.
        texels: Looks the pictures up.
        entry: Looks the table of cells up, where there are any.
    """
    if placement.near is None:
        found = texels(*point.uv)
        if "normal" in found:
            mapped = found["normal"]
            found["normal"] = projections.leaned(
                fn, mapped, point.normal, point.along_u, point.along_v
            )
        return found
    if placement.projection == "triplanar":
        return _from_sides(fn, placement.near, point, texels)
    found = _from_above(fn, placement, placement.near, point, texels, entry)
    if "normal" in found:
        along_u = projections.along_x(fn, point.flat)
        found["normal"] = projections.leaned(fn, found["normal"], point.normal, along_u, None)
    if placement.far is not None and "base_color" in found:
        found["base_color"] = found["base_color"] * far_factor(fn, placement, point, texels, entry)
    return found


def far_factor(
    fn: Algebra, placement: Placement, point: Point, texels: Texels, entry: cells.Entry | None
) -> Vector:
    """Returns the second scale's factor on colors; arguments as of ``look_up``."""
    assert placement.far is not None

    def larger(u: Number, v: Number, axis: int = 2, far: bool = True) -> Values:
        return texels(u, v, axis, far=True)

    found = _from_above(fn, placement, placement.far, point, larger, entry)
    return placement.rest + placement.gain * found["base_color"]


def _from_above(
    fn: Algebra,
    placement: Placement,
    scale: Scale,
    point: Point,
    texels: Texels,
    entry: cells.Entry | None,
) -> Values:
    if scale.lattice is None or entry is None:
        u, v, _ = fn.parts(point.position * scale.step + scale.start)
        return texels(u, v)
    corners = cells.corners(fn, scale.lattice, point.position, entry)
    values = [texels(*fn.parts(corner.place)[:2]) for corner in corners]
    found = {}
    for kind in values[0]:
        own = [value[kind] for value in values]
        if kind == "normal":
            found[kind] = cells.turned_back(fn, corners, own)
        else:
            found[kind] = cells.mixed(fn, corners, own, placement.means[kind], most(kind))
    return found


def _from_sides(fn: Algebra, scale: Scale, point: Point, texels: Texels) -> Values:
    at = fn.parts(point.position * scale.step + scale.start)
    shares = projections.plane_shares(fn, point.normal)
    planes = [texels(at[u], at[v], axis) for axis, (u, v) in enumerate(PLANES)]
    found = {}
    for kind in planes[0]:
        own = [plane[kind] for plane in planes]
        if kind == "normal":
            found[kind] = projections.from_sides(fn, point.normal, shares, own)
        else:
            found[kind] = own[0] * shares[0] + own[1] * shares[1] + own[2] * shares[2]
    return found


def most(kind: str) -> float | None:
    """The largest value of a kind of map; None: there is none."""
    return None if kind == "emission" else 1.0


def values_at(maps: Maps, kinds: Sequence[str], point: Point) -> dict[str, NDArray[np.float64]]:
    """The definition: values of maps, float64 [n] or [3, n] each, at points of the world [3, n].

    Raises:
        StageError: There is no such map, or it cannot be read.
    """
    placement = place(FLOAT64, maps, kinds, np.zeros(3))

    def texels(u: Number, v: Number, axis: int = 2, far: bool = False) -> Values:
        found = {}
        for kind in ("base_color",) if far else kinds:
            values = np.moveaxis(sample(map_values(maps, kind), u, v), -1, 0)
            found[kind] = values if len(values) == 3 else values[0]
        return found

    return look_up(FLOAT64, placement, point, texels, None if maps.cells is None else _entry(maps))


def _entry(maps: Maps) -> Callable[..., Any]:
    assert maps.cells is not None
    table = cells.corner_table(maps.cells.seed)

    def entry(corner: Vector) -> Any:
        column, row = corner[:2].astype(np.int64) % SIDE
        shift_u, shift_v, cosine, sine = np.moveaxis(table[row, column], -1, 0)
        return np.stack([shift_u, shift_v, 0.0 * shift_u]), (cosine, sine)

    return entry


def has_maps(maps: Maps | None, kind: str) -> bool:
    """Whether there are maps, and one of this kind."""
    return maps is not None and map_file(maps, kind) is not None
