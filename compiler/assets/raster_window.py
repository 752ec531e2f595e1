"""Finds what a window on a raster needs of it, and reads that: over date lines and poles, too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.raster_plane import RasterPlane
from scenec.compiler.geometry.lenses import FUNCTIONS

#: Pixels around a window that interpolation may read.
_MARGIN = 3
#: Places along each side of a window by which its outline in the file is known.
_PLACES = 33
#: Of a degree: by less an edge of a file is at a pole.
_AT_POLE = 1e-6


@dataclass(frozen=True)
class RasterWindow:
    """A part of a raster: what lies under a rectangle of the scene.

    Attributes:
        latitude_deg, longitude_deg: Of its center, geodetic and eastern; or
        x_m, y_m: the center in the file's coordinates, in meters.
        size_m: Along x and y.
        pixel_m: Size that pixels get along x and y; None for the file's own.
        spacing_m: What need not be resolved: a file's overviews may be as coarse as this.
    """

    latitude_deg: float | None
    longitude_deg: float | None
    x_m: float | None
    y_m: float | None
    size_m: tuple[float, float]
    pixel_m: tuple[float, float] | None = None
    spacing_m: float = 0.0


@dataclass(frozen=True)
class Box:
    """Pixels of a raster; beyond its first and last column they go on around the body.

    Attributes:
        column, row: The first, below 0 where it lies around the body or beyond a pole.
        columns, rows: How many.
        coarser: How many pixels stand for one spacing that is asked for.
    """

    column: int
    row: int
    columns: int
    rows: int
    coarser: float

    def read(self, read: Callable[[Any], NDArray[Any]], shape: tuple[int, int]) -> NDArray[Any]:
        """Reads it.

        Args:
            read: Reads pixels ((first row, last row), (first column, last column)).
            shape: Of the raster, (rows, columns).
        """
        rows, columns = shape
        first, last = max(self.row, 0), min(self.row + self.rows, rows)
        inside = self._band(read, columns, first, last, 0)
        half = columns // 2
        above = [self._band(read, columns, -1 - row, -row, half) for row in range(self.row, first)]
        below = [
            self._band(read, columns, 2 * rows - 1 - row, 2 * rows - row, half)
            for row in range(last, self.row + self.rows)
        ]
        return np.concatenate([*above, inside, *below]) if above or below else inside

    def _band(
        self, read: Callable[[Any], NDArray[Any]], columns: int, first: int, last: int, turn: int
    ) -> NDArray[Any]:
        """Some rows, whose columns are moved around the body."""
        start, end = self.column + turn, self.column + turn + self.columns
        parts = []
        while start < end:
            within = start % columns
            count = min(columns - within, end - start)
            parts.append(read(((first, last), (within, within + count))))
            start += count
        return np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]


def box_of(plane: RasterPlane, shape: tuple[int, int], window: RasterWindow) -> Box | None:
    """Returns the pixels that a window needs; None where there are none.

    Args:
        plane: How the raster lies under the window's center.
        shape: (rows, columns).
        window: The part.
    """
    rows, columns = shape
    half = 0.5 * window.size_m[0], 0.5 * window.size_m[1]
    steps = np.linspace(-1.0, 1.0, _PLACES)
    x, y = (part.ravel() for part in np.meshgrid(half[0] * steps, half[1] * steps))
    column, row = (part.reshape(_PLACES, _PLACES) for part in plane.pixels(x, y))
    if not (np.isfinite(column).all() and np.isfinite(row).all()):
        return None
    across = _steps(column, row, 1) / (window.size_m[0] / (_PLACES - 1))
    along = _steps(column, row, 0) / (window.size_m[1] / (_PLACES - 1))
    coarser = window.spacing_m * float(min(np.median(across), np.median(along)))
    curved = plane.steps is None
    around = curved and plane.frame.turns() == columns
    low_row, high_row = _span(row, curved)
    low, high = _span(column, curved)
    poles = _poles(plane, half, _MARGIN / float(np.median(along)))
    if poles:
        at = plane.pixels_at(np.array(poles), np.zeros(len(poles)))[1]
        low_row, high_row = min(low_row, *at), max(high_row, *at)
        low, high = 0.0, float(columns)
    first, last = int(np.floor(low_row)) - _MARGIN, int(np.ceil(high_row)) + _MARGIN
    left, right = int(np.floor(low)) - _MARGIN, int(np.ceil(high)) + _MARGIN
    if around and right - left >= columns:
        left, right = -_MARGIN, columns + _MARGIN
    if not around:
        left, right = max(left, 0), min(right, columns)
    crossed = around and columns % 2 == 0
    ends = [
        crossed and abs(abs(_latitude(plane, float(end))) - 90.0) < _AT_POLE for end in (0, rows)
    ]
    first = max(first, -_MARGIN if ends[0] and rows > _MARGIN else 0)
    last = min(last, rows + _MARGIN if ends[1] and rows > _MARGIN else rows)
    if min(last, rows) <= max(first, 0) or right <= left:
        return None
    return Box(left, first, right - left, last - first, coarser)


def _steps(column: NDArray, row: NDArray, axis: int) -> NDArray[np.float64]:
    """Pixels between neighbors."""
    a, b = np.diff(column, axis=axis), np.diff(row, axis=axis)
    found: NDArray[np.float64] = np.sqrt(a * a + b * b)
    return found


def _span(at: NDArray[np.float64], curved: bool) -> tuple[float, float]:
    """Between which values a smooth function lies that is known at some places."""
    most = max(float(np.abs(np.diff(at, axis=axis)).max()) for axis in (0, 1))
    spare = 0.25 * most if curved else 0.0
    return float(at.min()) - spare, float(at.max()) + spare


def _poles(plane: RasterPlane, half: tuple[float, float], margin_m: float) -> list[float]:
    """Latitudes of the poles under a window."""
    if plane.steps is not None:
        return []
    touching = plane.touching()
    found = []
    for pole in (90.0, -90.0):
        x, y = touching.local(np.array([pole]), np.array([0.0]), FUNCTIONS)
        if abs(x[0]) <= half[0] + margin_m and abs(y[0]) <= half[1] + margin_m:
            found.append(pole)
    return found


def _latitude(plane: RasterPlane, row: float) -> float:
    """Latitude, as the file counts it, of an edge between rows."""
    assert plane.frame.degrees is not None
    _, _, c, d = plane.frame.degrees
    return c * plane.frame.at(0.0, row)[1] + d
