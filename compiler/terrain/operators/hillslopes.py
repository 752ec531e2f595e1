"""Diffuses between sides whose heights stay: hillslopes above rivers.

dh/dt = kappa * laplacian(h), insulated at some sides of the field and with fixed heights along the
samples of the others. The semi-discrete problem (5-point Laplacian) is solved exactly, for any
step: along an axis the modes are those of the DCT-II between insulated ends, of the DST-I between
fixed ones, and between one of each those of the DST-I that are even about the insulated end (Strang
1999). Each mode decays to that of the steady state, a membrane through the fixed heights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import cosines, elementary
from scenec.compiler.terrain.grid import Grid

# Below it, 1 - exp(-x) is better known from its series, which is good to 3e-16 there.
_SERIES = 3e-3


@dataclass(frozen=True)
class _Axis:
    """One axis of a field: which of its ends are fixed.

    Attributes:
        number: Of the array's axis.
        fixed: Whether the first and the last sample are fixed.
        free: The samples between, of the whole axis.
        eigenvalues: Of minus the second difference, by mode, float64 [samples between].
        spacing: Meters.
    """

    number: int
    fixed: tuple[bool, bool]
    free: slice
    eigenvalues: NDArray[np.float64]
    spacing: float

    @classmethod
    def of(cls, number: int, n: int, spacing: float, fixed: tuple[bool, bool]) -> _Axis:
        count = n - fixed[0] - fixed[1]
        k = np.arange(count)
        half = 0.5 * elementary.PI
        if all(fixed):
            angle = half * (k + 1) / (n - 1)
        elif any(fixed):
            angle = half * (2 * k + 1) / (2 * n - 1)
        else:
            angle = half * k / n
        sine = elementary.sin_array(angle)
        free = slice(int(fixed[0]), n - int(fixed[1]))
        return cls(number, fixed, free, 4.0 * sine * sine / (spacing * spacing), spacing)

    def modes(self, field: NDArray[np.float64]) -> NDArray[np.float64]:
        """Modes of the samples between the fixed ones."""
        if not any(self.fixed):
            return cosines.dct(field, self.number)
        if all(self.fixed):
            return cosines.dst(field, self.number)
        back = np.flip(field, self.number)
        both = (back, field) if self.fixed[1] else (field, back)
        odd = cosines.dst(np.concatenate(both, self.number), self.number)
        return odd[self._along(slice(None, None, 2))]

    def field(self, modes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Inverts ``modes``."""
        if not any(self.fixed):
            return cosines.idct(modes, self.number)
        if all(self.fixed):
            return cosines.idst(modes, self.number)
        n = modes.shape[self.number]
        shape = list(modes.shape)
        shape[self.number] = 2 * n
        odd = np.zeros(shape)
        odd[self._along(slice(None, None, 2))] = modes
        both = cosines.idst(odd, self.number)
        return both[self._along(slice(n, None) if self.fixed[1] else slice(n))]

    def ends(self) -> list[int]:
        """Index of each fixed end, and of the sample beside it among the free ones."""
        return [at for at, fixed in zip((0, -1), self.fixed, strict=True) if fixed]

    def _along(self, part: slice) -> tuple[slice, ...]:
        return (part, slice(None)) if self.number == 0 else (slice(None), part)


class Hillslopes:
    """Steps of diffusion on a fixed grid.

    Args:
        sides: Where heights stay, of "west", "east", "south", "north"; at least one.
    """

    def __init__(self, grid: Grid, sides: tuple[str, ...]) -> None:
        (ny, nx), (dx, dy) = grid.shape, grid.spacing_m
        self._axes = (
            _Axis.of(0, ny, dy, ("south" in sides, "north" in sides)),
            _Axis.of(1, nx, dx, ("west" in sides, "east" in sides)),
        )
        rows, columns = (axis.eigenvalues for axis in self._axes)
        self._eigenvalues = rows[:, None] + columns[None, :]
        self._kept: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._first: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def diffused(self, height: NDArray[np.float64], spread_m2: float) -> NDArray[np.float64]:
        """Heights after a step; those along the fixed sides as they were.

        Args:
            height: Meters, float64 [ny, nx]. The first ones must not change: steps of other sizes
                begin with them, too, so their modes are kept.
            spread_m2: kappa times the step, square meters.
        """
        rows, columns = self._axes
        out = height.copy()
        if not self._eigenvalues.size:
            return out
        level, membrane = self._steady(height)
        if self._first is None:
            self._first = height, self._modes(height[rows.free, columns.free] - level)
        known = height is self._first[0]
        modes = self._first[1] if known else self._modes(height[rows.free, columns.free] - level)
        modes = modes - membrane
        modes *= self._decay(spread_m2)
        modes += membrane
        out[rows.free, columns.free] = self._field(modes) + level
        return out

    def risen(self, uplift_m: float, spread_m2: float) -> NDArray[np.float64]:
        """Returns what uplift during a step adds to it: float64 [ny, nx], meters.

        Args:
            uplift_m: How far all but the fixed samples would rise without diffusion.
            spread_m2: kappa times the step, square meters.
        """
        rows, columns = self._axes
        out = np.zeros([len(axis.eigenvalues) + sum(axis.fixed) for axis in self._axes])
        if not self._eigenvalues.size or uplift_m == 0.0:
            return out
        # Mean of the decay over the step, (1 - exp(-x)) / x; where that cancels, its series.
        x = spread_m2 * self._eigenvalues
        small = np.minimum(x, _SERIES)
        series = 1.0 - small * (0.5 - small * (1.0 / 6.0 - small * (1.0 / 24.0 - small / 120.0)))
        mean = np.where(
            x < _SERIES, series, (1.0 - self._decay(spread_m2)) / np.maximum(x, _SERIES)
        )
        modes = self._modes(np.full(x.shape, uplift_m)) * mean
        out[rows.free, columns.free] = self._field(modes)
        return out

    def _decay(self, spread_m2: float) -> NDArray[np.float64]:
        """Returns the factor by which a step damps each mode."""
        rows, columns = (elementary.exp_array(-spread_m2 * axis.eigenvalues) for axis in self._axes)
        decay: NDArray[np.float64] = rows[:, None] * columns[None, :]
        return decay

    def _steady(self, height: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """A level, and the modes of the steady state above it: the same for the same fixed ones."""
        rows, columns = self._axes
        sides = [height[at] for at in rows.ends()] + [height[:, at] for at in columns.ends()]
        fixed = np.concatenate(sides)
        # A level apart: a plain keeps every bit whatever the transforms round.
        level = float(sides[0].mean())
        if self._kept is None or not np.array_equal(self._kept[0], fixed):
            pull = np.zeros(self._eigenvalues.shape)
            for at in rows.ends():
                pull[at] += (height[at, columns.free] - level) / (rows.spacing * rows.spacing)
            for at in columns.ends():
                pull[:, at] += (height[rows.free, at] - level) / (columns.spacing * columns.spacing)
            self._kept = fixed, self._modes(pull) / self._eigenvalues
        return level, self._kept[1]

    def _modes(self, field: NDArray[np.float64]) -> NDArray[np.float64]:
        rows, columns = self._axes
        return columns.modes(rows.modes(field))

    def _field(self, modes: NDArray[np.float64]) -> NDArray[np.float64]:
        rows, columns = self._axes
        return rows.field(columns.field(modes))
