"""Evaluates pictures of heights as relief of the ground, at any point.

Between texels heights are cubic (Catmull and Rom 1974: continuous with their slopes, and exact at
texels' centers); the picture repeats, or lies in cells as its colors do
(``scenec.backends.surface.cells`` defines them; there is no clip here, which would leave kinks).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cache.memo import memoized
from scenec.compiler.kinds import Context, draw_kind
from scenec.compiler.materials.heights import file_relief, stamp, surface_relief
from scenec.compiler.materials.periodic import Plane, moments
from scenec.compiler.materials.plan import MaterialPlan
from scenec.compiler.materials.resample import box
from scenec.compiler.materials.surface import Surface
from scenec.compiler.scene.material import TilingCells
from scenec.compiler.terrain.detail import Detail, Spectrum, Sum
from scenec.compiler.terrain.grid import bicubic
from scenec.schemas.cells import SIDE, STEPS, table
from scenec.schemas.codec import JsonObject
from scenec.schemas.files import Stamp
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Root mean square of an octave of noise over its amplitude: what ``Spectrum`` speaks of.
_RMS_OF_AMPLITUDE = 0.3
_ROOT_3 = float(np.sqrt(3.0))
_NO_CELLS = np.zeros((1, 1, 4))


@dataclass(frozen=True)
class Displacement:
    """A material's relief (a ``Detail``); its picture is read or painted when it is asked for.

    Attributes:
        size_m: Side of one repeat.
        cells: How it is kept from repeating, or None.
        made: A procedural surface whose relief it is, or a picture and what white is above black.
    """

    size_m: float
    cells: TilingCells | None
    source: Surface | tuple[Path, float]

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Meters above the mean at points, float64 [n]."""
        plane, cells, out = _cached_plane(self._key()), self.cells, np.empty(x.size)
        # As it repeats at 0, else in cells of that side.
        form = plane, self.size_m, _turns(cells), 0.0 if cells is None else cells.size_m
        over_threads(_heights_part, x.size, *form, (x, y), out)
        return out

    def spectrum(self) -> Spectrum:
        """Its octaves, measured on a pyramid of box filters."""
        return _cached_spectrum(self._key())

    def _key(self) -> _Key:
        file = None if isinstance(self.source, Surface) else stamp(self.source[0])
        return self.source, self.size_m, file


def draw_displacement(
    nodes: Sequence[JsonObject] | None, material: str, drawn: MaterialPlan, context: Context
) -> Detail | None:
    """Returns what a ground material adds to the relief, at any fineness; None: nothing.

    Args:
        nodes: Small reliefs of the cfg's material.
        material: Its name.
        drawn: Its pictures, whose relief may become geometry.
        context: Of the batch.
    """
    path = f"materials/{material}/displacement"
    parts: list[Detail] = [
        draw_kind("displacement", node, f"{path}/{i}", context).everywhere()
        for i, node in enumerate(nodes or ())
    ]
    pictured = displacement_of(drawn)
    if pictured is not None:
        parts.append(pictured)
    return Sum(tuple(parts)) if parts else None


def displacement_of(drawn: MaterialPlan) -> Displacement | None:
    """The relief of a material's pictures that becomes geometry, or None."""
    maps, sources, surface = drawn.material.maps, drawn.sources, drawn.procedural
    if maps is None:
        return None
    if sources is not None and sources.heights and sources.heights_m:
        return Displacement(maps.size_m, maps.cells, (sources.heights, sources.heights_m))
    if surface is not None and surface.displacement:
        return Displacement(maps.size_m, maps.cells, surface)
    return None


#: What a relief depends on: its surface or picture, size, what tells a file from others.
type _Key = tuple[Surface | tuple[Path, float], float, Stamp | None]


@lru_cache(maxsize=4)
def _cached_plane(key: _Key) -> Plane:
    source, size_m, _ = key
    return _source_plane(source, size_m)


@memoized("displacement")
def _source_plane(source: Surface | tuple[Path, float], size_m: float) -> Plane:
    return surface_relief(source, size_m) if isinstance(source, Surface) else file_relief(*source)


@lru_cache(maxsize=16)
def _cached_spectrum(key: _Key) -> Spectrum:
    source, size_m, _ = key
    return _source_spectrum(source, size_m)


@memoized("displacement")
def _source_spectrum(source: Surface | tuple[Path, float], size_m: float) -> Spectrum:
    return octaves_of(_cached_plane(Displacement(size_m, None, source)._key()), size_m)


def octaves_of(plane: Plane, size_m: float) -> Spectrum:
    """Octaves of a picture that repeats over a square of ``size_m``.

    What a box filter over 2**k texels keeps and one over 2**(k + 1) does not counts as waves of
    2**(k + 1) texels; its amplitude is as of noise of that root mean square.
    """
    wavelengths, amplitudes = [], []
    texel = size_m / min(plane.shape)
    whole = moments(plane)[1]
    square = whole * whole
    while min(plane.shape) > 1:
        high, wide = plane.shape[0] // 2 * 2, plane.shape[1] // 2 * 2
        plane = box(plane[:high, :wide])
        rest = moments(plane)[1]
        texel *= 2.0
        wavelengths.append(texel)
        amplitudes.append(float(np.sqrt(max(square - rest * rest, 0.0))) / _RMS_OF_AMPLITUDE)
        square = rest * rest
    return Spectrum(np.array(wavelengths, np.float64), np.array(amplitudes, np.float64))


@lru_cache(maxsize=8)
def _turns(cells: TilingCells | None) -> NDArray[np.float64]:
    """Returns each cell's shift along u and v, and cosine and sine of its turn."""
    if cells is None:
        return _NO_CELLS
    found = table(cells.seed)
    angles = np.arange(STEPS) * (2.0 * elementary.PI / STEPS)
    turn = np.round(found[..., 2] * STEPS).astype(np.int64)
    cosine, sine = elementary.cos_array(angles)[turn], elementary.sin_array(angles)[turn]
    return np.ascontiguousarray(np.stack([found[..., 0], found[..., 1], cosine, sine], axis=-1))


@inlined
def _after(i, count):  # type: ignore[no-untyped-def]
    """The index after one from 0 to count - 1, the last one's being 0; without a division."""
    return i + 1 if i + 1 < count else 0


@kernel
def _look_up(plane, u, v):  # type: ignore[no-untyped-def]
    """A picture at coordinates in its repeats, v up."""
    high, wide = plane.shape
    x = (u - np.floor(u)) * wide - 0.5
    y = (1.0 - (v - np.floor(v))) * high - 0.5
    column = np.floor(x)
    row = np.floor(y)
    across = x - column
    down = y - row
    i0 = (np.int64(column) - 1) % wide
    j0 = (np.int64(row) - 1) % high
    i1, j1 = _after(i0, wide), _after(j0, high)
    i2, j2 = _after(i1, wide), _after(j1, high)
    i3, j3 = _after(i2, wide), _after(j2, high)
    return bicubic(plane, (j0, j1, j2, j3), (i0, i1, i2, i3), across, down)


@kernel
def _heights_part(first, last, plane, size, turns, cell, points, out):  # type: ignore[no-untyped-def]
    x, y = points
    for n in range(first, last):
        if cell == 0.0:
            out[n] = _look_up(plane, x[n] / size, y[n] / size)
            continue
        p = x[n] / cell
        q = y[n] / cell
        across = p - q / _ROOT_3
        along = q * (2.0 / _ROOT_3)
        i = np.floor(across)
        j = np.floor(along)
        across -= i
        along -= j
        upper = 1 if across + along >= 1.0 else 0
        total = 0.0
        fourths = 0.0
        squares = 0.0
        for k in range(3):
            if k == 0:
                a, b, near = upper, upper, abs(1.0 - across - along)
            elif k == 1:
                a, b, near = 1, 0, 1.0 - along if upper else across
            else:
                a, b, near = 0, 1, 1.0 - across if upper else along
            dx = across - a
            dy = along - b
            away_x = (dx + 0.5 * dy) * cell / size
            away_y = 0.5 * _ROOT_3 * dy * cell / size
            own = turns[(np.int64(j) + b) % SIDE, (np.int64(i) + a) % SIDE]
            u = own[2] * away_x - own[3] * away_y + own[0]
            v = own[3] * away_x + own[2] * away_y + own[1]
            share = near * near * near * near
            total += share * _look_up(plane, u, v)
            fourths += share
            squares += share * share
        # Shares over their sum; the spread over the root of their squares' sum.
        out[n] = total / np.sqrt(squares) if fourths > 0.0 else 0.0
