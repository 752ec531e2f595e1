"""Presses footprints: walks across the terrain in ribbed boots."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds import Context, forms, key
from scenec.compiler.noise.fractal import fbm2
from scenec.compiler.terrain.bins import BinIndex, any_within, bin_at, binned
from scenec.compiler.terrain.detail import Finer, Spectrum, finer, finer_than
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

#: Prints of one operator at most.
MAX_PRINTS = 1_000_000
# A sole, in lengths of it: half its width, and half of how far left and right feet are apart.
_HALF_WIDTH = 0.2
_HALF_GAIT = 0.35
# How much wider the ball is than the middle, and the heel narrower.
_TAPER = 0.14
#: Ribs across a sole: those of the overshoes of Apollo.
RIBS = 15
# Half the width of a rib, in spacings of ribs.
_BAR = 0.3
# In radii of the sole: of the walls, and how far the rim reaches beyond.
_WALL = 0.15
_RIM = 0.5
#: Part of a print's volume that stands in its rim; the rest is compacted.
DISPLACED = 0.3
# Of a walk: how far its heading swings, radians, and over which length, in strides; how far toes
# point outward, radians; by how much these and depths scatter.
_SWING, _SWINGS = 1.2, 20.0
_TOES, _TOES_SCATTER, _DEPTH_SCATTER = 0.12, 0.12, 0.3
_FINEST = 3.0


class Sole(NamedTuple):
    """Describes the sole that presses, in meters.

    Attributes:
        half_length, half_width: Of the outline, u^4 + v^2 = 1, tapered.
        depth: Of the floor.
        tread, pitch: Height of the ribs it leaves, and their distance along the sole.
        rim: Height of the rim.
    """

    half_length: float
    half_width: float
    depth: float
    tread: float
    pitch: float
    rim: float


@dataclass(frozen=True, kw_only=True)
class Walks:
    """Prints of ribbed boots, of walks across the terrain, with rims of displaced soil."""

    EXAMPLE: ClassVar = {"type": "footprints", "walks": 4, "depth_m": 0.03}

    walks: int = key(forms.WHOLE_PER_BATCH, default=1, at_least=0, at_most=10_000)
    """Number of walks, each through a point of the terrain's inner half."""
    stride_m: float = key(forms.LENGTH_PER_BATCH, default=1.3, above=0, at_most=1_000_000)
    """Distance between prints of one foot; the other's are half way."""
    length_m: float = key(forms.LENGTH_PER_BATCH, default=0.33, above=0, at_most=1_000_000)
    """Length of a sole, two fifths as wide. With fewer than 16 samples on a sole, prints show only
    where the mesh near cameras is finer."""
    depth_m: float = key(forms.LENGTH_PER_BATCH, default=0.025, at_least=0, at_most=1_000_000)
    """How deep boots sink; prints scatter by three tenths of it."""
    tread_m: float = key(forms.LENGTH_PER_BATCH, default=0.006, at_least=0, at_most=1_000_000)
    """Height of the ribs that soles leave; 0 for smooth soles."""

    def draw(self, context: Context) -> Footprints:
        """The prints of the walks, each across the terrain through a point of its inner half.

        A walk's heading swings by a noise; steps are half a stride apart, to the left and to the
        right of it in turn. More walks leave the first where they were.

        Raises:
            SceneError: There would be too many prints.
        """
        path, size_m = context.path, context.size_m
        diagonal = math.sqrt(size_m[0] * size_m[0] + size_m[1] * size_m[1])
        half = math.ceil(2.0 * diagonal / self.stride_m)
        if self.walks * (2 * half + 1) > MAX_PRINTS:
            raise SceneError(
                f"{path}: {self.walks * (2 * half + 1):.3g} footprints are expected, at most "
                f"{MAX_PRINTS:,} are taken; raise stride_m or lower walks"
            )
        lengths = (self.stride_m, self.length_m)
        prints = [
            _walk(context.streams, f"{path}/walk/{k}", size_m, lengths, half)
            for k in range(self.walks)
        ]
        return Footprints(
            prints=np.concatenate([np.zeros((0, 5)), *prints]),
            length_m=self.length_m,
            depth_m=self.depth_m,
            tread_m=self.tread_m,
            size_m=size_m,
        )


@dataclass(frozen=True, eq=False)
class Footprints:
    """Adds the prints of boots.

    A print is a floor ``depth_m`` deep with ribs across, walls, and a rim that holds 3 parts in 10
    of the volume; the rest is compacted. It is added to what is there: stones and grains in it are
    not leveled, and prints that overlap add up. A grid with three samples a rib holds them;
    otherwise they are detail, for meshes finer than the grid near cameras, and the grid holds none.

    Attributes:
        prints: Of each: x, y, meters; cosine and sine of where it points; factor on its depth:
            float64 [n, 5].
        length_m: Of a sole.
        depth_m: How deep it sinks.
        tread_m: Height of the ribs; 0 for smooth soles.
        size_m: Extent of the terrain.
    """

    KIND: ClassVar = "footprints"

    prints: NDArray[np.float64]
    length_m: float
    depth_m: float
    tread_m: float
    size_m: tuple[float, float]

    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights with the prints that the grid holds."""
        report: dict[str, Any] = {"prints": len(self.prints), "below_grid": not self._held(grid)}
        if report["below_grid"] or not len(self.prints):
            return height, report
        relief = self.everywhere().at(*grid.points()).reshape(grid.shape)
        dx, dy = grid.spacing_m
        return height + relief, {**report, "volume_change_m3": float(relief.sum() * dx * dy)}

    def detail(self, grid: Grid) -> FootprintsDetail | None:
        """All of them, where the grid is too coarse."""
        return None if self._held(grid) or not len(self.prints) else self.everywhere()

    def everywhere(self) -> FootprintsDetail:
        """All of them as detail."""
        return FootprintsDetail(self.prints, self._sole(), _binned(self))

    def _sole(self) -> Sole:
        pitch = self.length_m / (RIBS + 0.5)
        # Of a unit print over the area of its outline, in closed form: a linear taper keeps areas.
        pressed = (1.0 - _WALL) * (1.0 - _WALL) + 2.0 * _WALL * (0.5 - 0.35 * _WALL)
        raised = 2.0 * _RIM * (8.0 / 15.0 + _RIM * 4.0 / 15.0)
        rim = DISPLACED * self.depth_m * pressed / raised
        half = 0.5 * self.length_m
        width = _HALF_WIDTH * self.length_m
        return Sole(half, width, self.depth_m, self.tread_m, pitch, rim)

    def _held(self, grid: Grid) -> bool:
        return self.length_m / (RIBS + 0.5) >= _FINEST * max(grid.spacing_m)


@dataclass(frozen=True, eq=False)
class FootprintsDetail:
    """Prints at any point: see ``Footprints``.

    Attributes:
        sole: What presses.
        bins: Where they are.
    """

    prints: NDArray[np.float64]
    sole: Sole
    bins: BinIndex

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Meters to add at points, float64 [n]."""
        out = np.empty(x.size)
        pressed = self.prints, self.sole, self.bins
        over_threads(_heights_part, x.size, *pressed, x, y, out, least=POINTS)
        return out

    def finer_at(
        self,
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        radius_m: NDArray[np.float64],
        length_m: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """About how large what is finer than lengths is in disks, meters, float64 [n]."""
        out: NDArray[np.float64] = _amplitudes(
            self.bins, x, y, radius_m, length_m, finer([self.spectrum()])
        )
        return out

    def spectrum(self) -> Spectrum:
        """Soles count as waves of their width and the ribs on them as waves of theirs."""
        sole = self.sole
        sizes = np.array([2.0 * sole.half_width, sole.pitch])
        return Spectrum(sizes, np.array([0.5 * sole.depth + sole.rim, 0.5 * sole.tread]))


def _walk(
    streams: Streams,
    path: str,
    size_m: tuple[float, float],
    lengths: tuple[float, float],
    half: int,
) -> NDArray[np.float64]:
    """Prints of one walk that reach the terrain, float64 [n, 5]; ``half`` steps either way."""
    stride, length = lengths
    x, y, heading = streams.uniforms(f"{path}/start", 3)
    step = np.arange(-half, half + 1)
    swing = fbm2(streams.key(path), 2.0 * _SWINGS, 2, 0.5, 2.0, 0.0)
    swung = swing.at(step.astype(np.float64), np.full(len(step), 0.5))
    ahead = 2.0 * elementary.PI * heading + _SWING * swung
    east, north = elementary.cos_array(ahead), elementary.sin_array(ahead)
    middle = [
        (start - 0.5) * 0.5 * size + 0.5 * stride * (np.cumsum(way) - np.cumsum(way)[half])
        for start, size, way in zip((x, y), size_m, (east, north), strict=True)
    ]
    scatter = 2.0 * streams.uniforms(f"{path}/scatter", 2 * len(step)).reshape(-1, 2) - 1.0
    side = np.where(step % 2 == 0, 1.0, -1.0)
    points = ahead + side * (_TOES + _TOES_SCATTER * scatter[:, 0])
    columns = (
        middle[0] - side * _HALF_GAIT * length * north,
        middle[1] + side * _HALF_GAIT * length * east,
        elementary.cos_array(points),
        elementary.sin_array(points),
        1.0 + _DEPTH_SCATTER * scatter[:, 1],
    )
    prints = np.stack(columns, axis=1)
    near = np.abs(prints[:, :2]) <= 0.5 * np.array(size_m) + _reach(length)
    return prints[near.all(axis=1)]


def _reach(length_m: float) -> float:
    """Returns how far a print ends from its middle, meters: the corner of its rim at most."""
    half = 0.5 * length_m
    wide = _HALF_WIDTH * length_m * (1.0 + _TAPER * (1.0 + _RIM))
    return (1.0 + _RIM) * math.sqrt(half * half + wide * wide)


def _binned(of: Footprints) -> BinIndex:
    reach = _reach(of.length_m)
    sizes = [size + 2.0 * reach for size in of.size_m]
    x, y = np.ascontiguousarray(of.prints[:, :2].T)
    corner = (-0.5 * sizes[0], -0.5 * sizes[1])
    extent = (corner, (sizes[0], sizes[1]))
    return binned(x, y, np.full(len(x), reach), extent, 2.0 * reach)


@kernel
def _amplitudes(
    bins: BinIndex, x: NDArray, y: NDArray, radius: NDArray, length: NDArray, table: Finer
) -> NDArray:
    """Returns the relief finer than lengths in disks that prints may reach into, float64 [n]."""
    out = np.zeros(x.size)
    for n in range(x.size):
        if any_within(bins, x[n], y[n], radius[n]):
            out[n] = finer_than(table, 0, length[n])
    return out


@kernel
def _heights_part(
    first: int,
    last: int,
    prints: NDArray,
    sole: Sole,
    bins: BinIndex,
    x: NDArray,
    y: NDArray,
    out: NDArray,
) -> None:
    for n in range(first, last):
        at = bin_at(bins, x[n], y[n])
        total = 0.0
        for m in range(bins.start[at], bins.start[at + 1]):
            px, py, c, s, deeper = prints[bins.member[m]]
            dx, dy = x[n] - px, y[n] - py
            total += deeper * _print(c * dx + s * dy, c * dy - s * dx, sole)
        out[n] = total


@inlined
def _print(along: float, across: float, sole: Sole) -> float:
    """Height of a print at a place along and across the sole."""
    u = along / sole.half_length
    if abs(u) >= 1.0 + _RIM:
        return 0.0
    v = across / (sole.half_width * (1.0 + _TAPER * u))
    # (u / radius)^4 + (v / radius)^2 = 1: straight sides, round ends.
    radius = np.sqrt(0.5 * (v * v + np.sqrt(v * v * v * v + 4.0 * u * u * u * u)))
    if radius < 1.0:
        wall = elementary.smoothstep((1.0 - radius) / _WALL)
        phase = along / sole.pitch
        bar = (phase - np.floor(phase) - 0.5) / _BAR
        bar = max(1.0 - bar * bar, 0.0)
        # Less its mean, so that ribs take no volume.
        rib = bar * bar - 2.0 * _BAR * (8.0 / 15.0)
        return -wall * (sole.depth - sole.tread * rib)
    t = (radius - 1.0) / _RIM
    return sole.rim * 16.0 * t * t * (1.0 - t) * (1.0 - t) if t < 1.0 else 0.0
