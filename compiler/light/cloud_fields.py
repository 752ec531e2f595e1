"""Defines where clouds are: patterns over the ground, and what a point of a layer holds.

A cumulus rises from a level base as high as a pattern over the ground is above a threshold, which
is a quantile of that pattern: so the share of ground below clouds is what was asked for. Billows
(distances to scattered points, at three scales) are taken off its flanks. Cirrus has no thickness:
a pattern of drawn-out streaks is its optical depth. Patterns are squares some fifty clouds wide,
mirrored beyond their edges, which only the hazy last degree above the horizon shows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import (
    Array,
    Context,
    Finding,
    Node,
    bounded,
    draw_kind,
    forms,
    key,
    kind_of,
    noise_key,
)
from scenec.compiler.kinds.forms import an, list_of
from scenec.compiler.noise.fractal import Fractal
from scenec.compiler.noise.lattice import hash3, mix
from scenec.compiler.noise.worley import worley2
from scenec.schemas.errors import ScenecError
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Texels of a pattern, and how many of its clouds they span.
_SIDE, _SPAN = 1536, 48.0
#: Billows: texels and cells of the tile that they are looked up in.
_TILE, _CELLS = 64, 8
#: Sizes of billows over that of clouds, and how much of the flanks they take.
_BILLOWS = (0.16, 0.061, 0.0227)
_TAKEN = (0.5, 0.3, 0.2)
#: Mean of distances to scattered points in three dimensions, in cells.
_MEAN_DISTANCE = 0.5
#: How deep billows cut, in the pattern's own unit.
_DEPTH = 0.42
#: Range of a pattern above its threshold over which clouds reach their full height.
_RISE = 0.5
#: Steepness of edges, and over which share of a cloud's size a footprint halves it.
_EDGE, _BLUR = 7.0, 0.05
#: Streaks are so many times as long as wide.
_DRAWN_OUT = 7.0
_KEY_WARP, _KEY_GROUPS, _KEY_CELLS, _KEY_TILE = range(1, 5)


_OFFSET_M = list_of(
    bounded(forms.LENGTH_PER_SAMPLE, at_least=-1_000_000_000, at_most=1_000_000_000),
    "Along one axis.",
    count=2,
).but(
    default=[0, 0],
    description="Shift of the pattern, to the east and to the north. Drawn for each sample, it "
    "gives each other clouds.",
)


@dataclass(frozen=True, kw_only=True)
class CumulusClouds:
    """Heaps of cloud on a level base, as on a fine day."""

    EXAMPLE: ClassVar = {
        "coverage": {"type": "uniform", "min": 0.1, "max": 0.6},
        "offset_m": [{"type": "uniform", "min": -20_000, "max": 20_000}, 0],
    }

    KEYWORDS: ClassVar = {"type": ["object", "null"]}

    coverage: Array = key(forms.FRACTION_PER_SAMPLE, default=0.35)
    """Share of the ground that lies below clouds."""
    optical_depth: Array = key(forms.PER_SAMPLE, default=40, at_least=0, at_most=1000)
    """Of the tallest cloud, straight down."""
    base_m: Array = key(forms.LENGTH_PER_SAMPLE, default=1200, at_least=50, at_most=10_000)
    """Height of the base over the world's z = 0."""
    thickness_m: Array = key(forms.LENGTH_PER_SAMPLE, default=900, at_least=10, at_most=10_000)
    """Height of the tallest cloud over the base."""
    size_m: float = key(forms.LENGTH_PER_BATCH, default=1800, at_least=10, at_most=100_000)
    """Width of a cloud and its gap; groups are three times as wide."""
    offset_m: Array = key(_OFFSET_M)
    key: int = noise_key()


@dataclass(frozen=True, kw_only=True)
class CirrusClouds:
    """Thin streaks of ice, high up."""

    EXAMPLE: ClassVar = {
        "coverage": 0.7,
        "optical_depth": 0.3,
        "bearing_deg": {"type": "uniform", "min": 0, "max": 360},
    }

    KEYWORDS: ClassVar = {"type": ["object", "null"]}

    coverage: Array = key(forms.FRACTION_PER_SAMPLE, default=0.5)
    """Share of the sky, straight down, that has any."""
    optical_depth: Array = key(forms.PER_SAMPLE, default=0.5, at_least=0, at_most=10)
    """Where thickest, straight down: 0.03 is hardly visible, 0.3 usual, 3 veils the sun."""
    height_m: Array = key(forms.LENGTH_PER_SAMPLE, default=9000, at_least=1000, at_most=20_000)
    """Over the world's z = 0."""
    size_m: float = key(forms.LENGTH_PER_BATCH, default=4000, at_least=100, at_most=100_000)
    """Width of streaks; they are five times as long."""
    bearing_deg: Array = key(forms.TURN_PER_SAMPLE, default=60)
    """Compass bearing that streaks run along."""
    offset_m: Array = key(_OFFSET_M)
    key: int = noise_key()


@dataclass(frozen=True, kw_only=True)
class Clouds:
    """Clouds in an atmosphere (Earth's) or clear sky, drawn as seen from the middle of the ground.
    Each sample's sun loses what the clouds before it hide; cumulus casts shadows on the land.
    """

    EXAMPLE: ClassVar = {"cumulus": {"coverage": 0.4}, "cirrus": {"optical_depth": 0.2}}

    TITLE: ClassVar = "Clouds"
    cumulus: CumulusClouds | None = key(an("clouds_cumulus", drawn=True), default=None)
    """Cumulus; null for none."""
    cirrus: CirrusClouds | None = key(an("clouds_cirrus", drawn=True), default=None)
    """Cirrus; null for none."""
    resolution: int = key(forms.COUNT, default=768, at_least=8, at_most=8192, unit="px")
    """Height in pixels of the lat-long picture with clouds, half its width. A larger one of
    light.sky is kept."""
    more: tuple[Any, ...] = key(list_of(an("clouds_layer"), "One layer."), sparse=True)
    """Layers of other packages, the farthest first, behind cumulus and cirrus."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields whether there is no sky that they can be drawn into."""
        light = node.whole().at("light")
        sky = light.at("sky")
        try:
            takes = sky["type"] and kind_of("sky", sky["type"]).takes_clouds(sky)
        except ScenecError:
            return  # Told where the sky stands: its package cannot be used.
        if "sky" in light and not takes:
            yield light.key_fault(
                "clouds need a sky that is made, of air with water in it: expected one of the type "
                '"atmosphere" (planet "earth") or "clear"',
                "clouds",
            )

    def draw(self, context: Context) -> Clouds:
        """Returns the clouds at every sample."""
        layers: dict[str, Any] = {
            name: replace(layer, **context.at(f"{context.path}/{name}").sampled(layer))
            for name, layer in (("cumulus", self.cumulus), ("cirrus", self.cirrus))
            if layer is not None
        }
        layers["more"] = tuple(
            draw_kind("clouds_layer", node, f"{context.path}/more/{i}", context)
            for i, node in enumerate(self.more or ())
        )
        return replace(self, **layers)


class CloudPattern(NamedTuple):
    """A pattern over the ground.

    Attributes:
        values: float32 [side, side], rows to the north, columns to the east of ``turn``.
        per_m: Texels a meter.
        east_m, north_m: Where its middle is.
        cosine, sine: Of its turn, counterclockwise.
        threshold: Where clouds begin.
    """

    values: NDArray[np.float32]
    per_m: float
    east_m: float
    north_m: float
    cosine: float
    sine: float
    threshold: float


class Cumulus(NamedTuple):
    """A layer of cumulus.

    Attributes:
        pattern: Where clouds rise.
        tile: Distances to scattered points, in cells, float32 [64, 64, 64], periodic.
        base_m, thickness_m: Of the layer; the thickness is that of the tallest.
        size_m: Of a cloud.
        extinction: Within, 1/m; 0 where there is no layer.
    """

    pattern: CloudPattern
    tile: NDArray[np.float32]
    base_m: float
    thickness_m: float
    size_m: float
    extinction: float


class Cirrus(NamedTuple):
    """A sheet of cirrus.

    Attributes:
        pattern: Its streaks.
        height_m: Of the sheet.
        depth: Optical depth where it is thickest; 0 where there is no sheet.
        rise: Range of the pattern over which it gets there.
    """

    pattern: CloudPattern
    height_m: float
    depth: float
    rise: float


class CumulusField:
    """Holds what all samples of a batch share of a layer of cumulus."""

    def __init__(self, plan: CumulusClouds) -> None:
        self._plan = plan
        self._values = cumulus_values(plan.key)
        self._sorted = np.sort(self._values.ravel(), kind="stable")
        self._tile = billow_tile(plan.key)

    def at(self, sample: int) -> Cumulus:
        """The layer at a sample."""
        plan = self._plan
        coverage, thickness = float(plan.coverage[sample]), float(plan.thickness_m[sample])
        pattern = CloudPattern(
            self._values, _SIDE / (_SPAN * plan.size_m), float(plan.offset_m[sample, 0]),
            float(plan.offset_m[sample, 1]), 1.0, 0.0, _quantile(self._sorted, 1.0 - coverage),
        )  # fmt: skip
        depth = float(plan.optical_depth[sample]) if coverage > 0.0 else 0.0
        base = float(plan.base_m[sample])
        return Cumulus(pattern, self._tile, base, thickness, plan.size_m, depth / thickness)


class CirrusField:
    """Holds what all samples of a batch share of a sheet of cirrus."""

    def __init__(self, plan: CirrusClouds) -> None:
        self._plan = plan
        self._values = cirrus_values(plan.key)
        self._sorted = np.sort(self._values.ravel(), kind="stable")

    def at(self, sample: int) -> Cirrus:
        """The sheet at a sample."""
        plan = self._plan
        coverage = float(plan.coverage[sample])
        # Streaks run along the pattern's columns: to the north at a bearing of 0.
        turn = -float(plan.bearing_deg[sample]) * elementary.PI / 180.0
        low = _quantile(self._sorted, 1.0 - coverage)
        pattern = CloudPattern(
            self._values, _SIDE / (_SPAN * plan.size_m), float(plan.offset_m[sample, 0]),
            float(plan.offset_m[sample, 1]), elementary.cos(turn), elementary.sin(turn), low,
        )  # fmt: skip
        depth = float(plan.optical_depth[sample]) if coverage > 0.0 else 0.0
        rise = max(_quantile(self._sorted, 0.999) - low, 1e-6)
        return Cirrus(pattern, float(plan.height_m[sample]), depth, rise)


def no_cumulus() -> Cumulus:
    """A layer that is not there."""
    return Cumulus(_nothing(), np.zeros((1, 1, 1), np.float32), 1.0, 1.0, 1.0, 0.0)


def no_cirrus() -> Cirrus:
    """A sheet that is not there."""
    return Cirrus(_nothing(), 1.0, 0.0, 1.0)


def _nothing() -> CloudPattern:
    return CloudPattern(np.zeros((1, 1), np.float32), 1.0, 0.0, 0.0, 1.0, 0.0, 0.0)


def _quantile(sorted_values: NDArray[np.float32], share: float) -> float:
    """The value below which a share of sorted ones lies."""
    last = len(sorted_values) - 1
    return float(sorted_values[min(max(int(share * last), 0), last)])


def _places_and_keys(key: int) -> tuple[NDArray[np.float64], list[int]]:
    """Returns the places of a pattern's columns and rows, in clouds; and a key for each noise."""
    place = np.arange(_SIDE, dtype=np.float64)
    place = (place + 0.5) * (_SPAN / _SIDE)
    return place, [int(mix(np.uint64((key + i) & (2**64 - 1)))) for i in range(5)]


def cumulus_values(key: int) -> NDArray[np.float32]:
    """A pattern of rounded clouds in loose groups, float32 [side, side]; a cloud is of size 1."""
    place, keys = _places_and_keys(key)
    bend = [Fractal(keys[_KEY_WARP] ^ i, 3, 0.5, 2.0, scale_m=1.1).on(place, place) for i in (0, 1)]
    groups = Fractal(keys[_KEY_GROUPS], 4, 0.5, 2.0, scale_m=3.3).on(place, place)
    out = np.empty((_SIDE, _SIDE), np.float32)
    over_threads(_cumulus_rows, _SIDE, np.uint64(keys[_KEY_CELLS]), place, *bend, groups, out)
    return out


@kernel
def _cumulus_rows(first, last, key, place, warp_x, warp_y, groups, out):  # type: ignore[no-untyped-def]
    for j in range(first, last):
        for i in range(len(place)):
            x = place[i] + 0.35 * warp_x[j, i]
            y = place[j] + 0.35 * warp_y[j, i]
            near, _ = worley2(key, x, y, 1.0)
            small, _ = worley2(key ^ np.uint64(77), 2.3 * x, 2.3 * y, 1.0)
            out[j, i] = (
                0.6 * (1.0 - near * near) + 0.18 * (1.0 - small * small) + 0.75 * groups[j, i]
            )


def cirrus_values(key: int) -> NDArray[np.float32]:
    """A pattern of streaks along its columns, float32 [side, side]."""
    place, keys = _places_and_keys(key)
    bend = Fractal(keys[_KEY_WARP], 4, 0.55, 2.0, scale_m=6.0).on(place, place)
    groups = Fractal(keys[_KEY_GROUPS], 4, 0.5, 2.0, scale_m=7.0).on(place, place)
    x = np.broadcast_to(place[None, :], bend.shape) + 1.1 * bend
    y = np.broadcast_to(place[:, None], bend.shape) / _DRAWN_OUT + 0.4 * bend
    streaks = Fractal(keys[_KEY_CELLS], 7, 0.62, 2.0, scale_m=1.0).at(x.ravel(), y.ravel())
    return np.asarray(0.5 * streaks.reshape(bend.shape) + 0.6 * groups, np.float32)


def billow_tile(key: int) -> NDArray[np.float32]:
    """Distances to scattered points, in cells, float32 [64, 64, 64]; it repeats seamlessly."""
    tile = np.empty((_TILE, _TILE, _TILE), np.float32)
    over_threads(_tile_slices, _TILE, np.uint64(_places_and_keys(key)[1][_KEY_TILE]), tile)
    return tile


@kernel
def _tile_slices(first, last, key, out):  # type: ignore[no-untyped-def]
    side = out.shape[0]
    per_cell = side // _CELLS
    for k in range(first, last):
        for j in range(side):
            for i in range(side):
                least = 1e9
                for dk in range(-1, 2):
                    for dj in range(-1, 2):
                        for di in range(-1, 2):
                            a, b, c = i // per_cell + di, j // per_cell + dj, k // per_cell + dk
                            bits = hash3(key, a % _CELLS, b % _CELLS, c % _CELLS)
                            x = a + float(bits & np.uint64(0xFFFF)) / 65536.0
                            y = b + float((bits >> np.uint64(16)) & np.uint64(0xFFFF)) / 65536.0
                            z = c + float((bits >> np.uint64(32)) & np.uint64(0xFFFF)) / 65536.0
                            x -= i / per_cell
                            y -= j / per_cell
                            z -= k / per_cell
                            least = min(least, x * x + y * y + z * z)
                out[k, j, i] = np.sqrt(least)


@inlined
def _mirrored(place: float, size: int) -> float:
    """A place in texels, folded into a pattern."""
    period = 2.0 * (size - 1)
    place -= np.floor(place / period) * period
    return min(place, period - place)


@kernel
def value_at(pattern: CloudPattern, east: float, north: float) -> float:
    """A pattern over a place, bilinear, meters."""
    side = pattern.values.shape[0]
    x, y = east - pattern.east_m, north - pattern.north_m
    u = (pattern.cosine * x + pattern.sine * y) * pattern.per_m + 0.5 * side
    v = (pattern.cosine * y - pattern.sine * x) * pattern.per_m + 0.5 * side
    u, v = _mirrored(u, side), _mirrored(v, side)
    i, j = min(int(u), side - 2), min(int(v), side - 2)
    a, b = u - i, v - j
    low = pattern.values[j, i] + a * (pattern.values[j, i + 1] - pattern.values[j, i])
    high = pattern.values[j + 1, i] + a * (pattern.values[j + 1, i + 1] - pattern.values[j + 1, i])
    return low + b * (high - low)


@kernel
def rise_at(layer: Cumulus, east: float, north: float) -> float:
    """Returns the height of clouds over a place: 0 and less is none, 1 the full height."""
    return (value_at(layer.pattern, east, north) - layer.pattern.threshold) / _RISE


@inlined
def dome(rise: float) -> float:
    """Square of the share of the thickness up to which a cloud would reach without billows."""
    short = max(1.0 - rise, 0.0)
    return 1.0 - short * short


@kernel
def density_at(
    layer: Cumulus, rise: float, east: float, north: float, above_m: float, footprint_m: float
) -> float:
    """Share of the full extinction at a point of a layer, 0 to 1.

    Args:
        layer: The layer.
        rise: ``rise_at`` the place.
        east, north: Meters.
        above_m: Height over the base.
        footprint_m: Of what looks: billows smaller than this are left out, edges are softer.
    """
    share = above_m / layer.thickness_m
    if share <= 0.0 or share >= 1.0:
        return 0.0
    inside = dome(rise) - share * share
    if inside <= -_DEPTH:
        return 0.0
    cut = _DEPTH * min(0.4 + 2.0 * share, 1.0)
    if inside < cut:
        billow = 0.0
        # Where the pattern is moved, billows go with it.
        x, y, z = east - layer.pattern.east_m, north - layer.pattern.north_m, above_m
        for octave in range(3):
            size = _BILLOWS[octave] * layer.size_m
            if octave and size < 2.0 * footprint_m:
                break
            # Each scale is turned, so that periods never meet.
            x, y, z = 0.8 * x - 0.6 * z + 311.0, y, 0.6 * x + 0.8 * z
            x, y = 0.8 * x + 0.6 * y, 0.8 * y - 0.6 * x
            near = _tile_at(layer.tile, x / size, y / size, z / size)
            billow += _TAKEN[octave] * (near - _MEAN_DISTANCE)
        inside -= cut * 2.0 * billow
    # Edges are soft over a part of the rise, more so for what cannot tell; the base over a part of
    # the height.
    slope = _EDGE / (1.0 + footprint_m / (_BLUR * layer.size_m))
    return min(max(0.5 + slope * (inside - 0.5 / _EDGE), 0.0), 1.0) * min(share / 0.05, 1.0)


@kernel
def _tile_at(tile: NDArray, x: float, y: float, z: float) -> float:
    """A tile at a place in cells, trilinear."""
    side = tile.shape[0]
    per_cell = side / _CELLS
    x, y, z = x * per_cell, y * per_cell, z * per_cell
    fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
    a, b, c = x - fx, y - fy, z - fz
    i, j, k = int(fx) & (side - 1), int(fy) & (side - 1), int(fz) & (side - 1)
    p, q, r = (i + 1) & (side - 1), (j + 1) & (side - 1), (k + 1) & (side - 1)
    near = tile[k, j, i] + a * (tile[k, j, p] - tile[k, j, i])
    next_ = tile[k, q, i] + a * (tile[k, q, p] - tile[k, q, i])
    low = near + b * (next_ - near)
    near = tile[r, j, i] + a * (tile[r, j, p] - tile[r, j, i])
    next_ = tile[r, q, i] + a * (tile[r, q, p] - tile[r, q, i])
    return low + c * (near + b * (next_ - near) - low)


@kernel
def cirrus_depth_at(sheet: Cirrus, east: float, north: float) -> float:
    """Optical depth of a sheet straight down over a place."""
    over = (value_at(sheet.pattern, east, north) - sheet.pattern.threshold) / sheet.rise
    over = min(max(over, 0.0), 1.0)
    return sheet.depth * over * np.sqrt(over)
