"""Shapes bedforms of the wind: transverse dunes and ripples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import forms, key, noise_key
from scenec.compiler.noise.lattice import subkey, subkeys
from scenec.compiler.noise.octaves import Octaves, octave_at, tabulate
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Wavelengths of fewer grid spacings cannot be represented.
_FINEST = 4.0
# Where crests lie farther apart than a wavelength they rise by this factor at most.
_TALLEST = 1.4
# Envelope of the noise below which crests fade toward a defect, and cosine of the angle to the wind
# from which on crests are full; there are none along it.
_FADE = 0.2
_FULL = 0.6
# Wavelengths over which crests wander, along the wind and across it.
_ALONG = 4.0
_ACROSS = 6.0


@dataclass(frozen=True)
class Dunes:
    """Transverse dunes: long crests across the wind, gentle to windward, with slip faces at the
    angle of repose.

    Note: The phase is that of a plane wave times a complex noise (phasor noise: Tricard et al.
    2019): phi = k . p + arg(order + n1(p) + i n2(p)). Where the noise is zero, crests end or fork:
    the defects of real dune fields. Heights follow the distance of crests, H * |k| / |grad phi|, so
    that slip faces keep their slope and heights vanish at defects.
    """

    EXAMPLE: ClassVar = {
        "type": "dunes",
        "height_m": 0.7,
        "wavelength_m": 9,
        "wind_deg": {"type": "uniform", "min": 20, "max": 70},
        "order": 0.2,
    }

    height_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000)
    """Height of a crest."""
    wavelength_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Mean distance of crests. Below four spacings there are none."""
    wind_deg: float = key(forms.WIND_DEG)
    repose_deg: float = key(forms.ANGLE_PER_BATCH, default=33, at_least=1, at_most=60)
    """Slope of the slip faces: the angle of repose."""
    order: float = key(forms.PER_BATCH, default=0.3, at_least=0, at_most=100)
    """How regular crests are: at 0 they end and fork most, above 1 they only wind."""
    key: int = noise_key()

    #: Whether the lee is rounded at its brink and foot.
    rounded: ClassVar[bool] = False

    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights plus bedforms.

        Raises:
            SceneError: The slip faces would take more than half of the wavelength.
        """
        lee = self._lee()
        if self.wavelength_m < _FINEST * max(grid.spacing_m):
            return height, {"below_grid": True}
        wind = self.wind_deg * (elementary.PI / 180.0)
        waves = Waves(
            grid.x() / self.wavelength_m,
            grid.y() / self.wavelength_m,
            elementary.cos(wind),
            elementary.sin(wind),
        )
        noises = self._noise(0, waves), self._noise(1, waves)
        # The complex noise of which the phase is a part: order + n1 + i n2, n of unit range.
        envelope = np.empty(grid.shape), np.empty(grid.shape)
        over_threads(_envelope_part, len(height), *noises, waves, self.order, *envelope)
        relief = np.empty(grid.shape)
        over_threads(_bedforms_part, len(height), *envelope, waves, lee, self.rounded, relief)
        relief *= self.height_m
        return height + relief, {
            "below_grid": False,
            "lee_fraction": lee,
            "highest_m": float(relief.max()),
            "mean_m": float(relief.mean()),
        }

    def _lee(self) -> float:
        angle = self.repose_deg * (elementary.PI / 180.0)
        slope = elementary.sin(angle) / elementary.cos(angle)
        # The steepest part of a rounded face is half as steep again as its mean.
        steepness = 1.5 if self.rounded else 1.0
        highest = 0.5 * self.wavelength_m * slope / steepness
        if self.height_m > highest:
            lower = f"lower height_m below {highest:.3g} or " if highest > 0.0 else ""
            raise SceneError(
                f"bedforms {self.height_m:g} m high at every {self.wavelength_m:g} m have slip "
                f"faces wider than half of that; {lower}raise wavelength_m"
            )
        return steepness * self.height_m / (self.wavelength_m * slope)

    def _noise(self, part: int, waves: Waves) -> Octaves:
        # The rectangle turned into the wind's axes, in its own.
        x, y, along, across = waves
        u = [(along * a + across * b) / _ALONG for a in (x[0], x[-1]) for b in (y[0], y[-1])]
        v = [(along * b - across * a) / _ACROSS for a in (x[0], x[-1]) for b in (y[0], y[-1])]
        return tabulate(
            subkeys(np.uint64(subkey(np.uint64(self.key), part)), 1),
            np.array([min(u), max(u)]),
            # Two noises on one lattice would both be zero at its points.
            np.array([min(v), max(v)]) + 0.5 * part,
            1.0,
            x.size * y.size,
            1e-9,
        )


@dataclass(frozen=True)
class Ripples(Dunes):
    """Wind ripples: like dunes, but round.

    Note: their lee sides are rounded, and the steepest slope of these is that given.
    """

    EXAMPLE: ClassVar = {"type": "ripples", "height_m": 0.05, "wavelength_m": 0.7, "wind_deg": 45}

    repose_deg: float = key(forms.ANGLE_PER_BATCH, default=28, at_least=1, at_most=60)
    """Steepest slope of the lee sides."""
    order: float = key(forms.PER_BATCH, default=0.4, at_least=0, at_most=100)
    """How regular crests are: at 0 they end and fork most, above 1 they only wind."""
    rounded: ClassVar[bool] = True


class Waves(NamedTuple):
    """A plane wave on a grid.

    Attributes:
        x, y: Of columns and rows, in wavelengths, float64 [nx], [ny].
        along, across: Where it runs to: cosine and sine of the angle to x.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    along: float
    across: float


@kernel
def _envelope_part(
    begin: int,
    end: int,
    first: Octaves,
    second: Octaves,
    waves: Waves,
    order: float,
    real: NDArray,
    imaginary: NDArray,
) -> None:
    x, y, along, across = waves
    for j in range(begin, end):
        u = (along * x + across * y[j]) / _ALONG
        v = (along * y[j] - across * x) / _ACROSS
        octave_at(first, 0, u, v, real[j])
        octave_at(second, 0, u, v + 0.5, imaginary[j])
        for i in range(x.size):
            real[j, i] += order


@inlined
def _difference(field: NDArray, j: int, i: int, axis: int, spacing: float) -> float:
    """Central difference, one-sided at the border."""
    if axis == 0:
        low = max(j - 1, 0)
        high = min(j + 1, field.shape[0] - 1)
        return (field[high, i] - field[low, i]) / ((high - low) * spacing)
    low = max(i - 1, 0)
    high = min(i + 1, field.shape[1] - 1)
    return (field[j, high] - field[j, low]) / ((high - low) * spacing)


@kernel
def _bedforms_part(
    first: int,
    last: int,
    real: NDArray,
    imaginary: NDArray,
    waves: Waves,
    lee: float,
    rounded: bool,
    out: NDArray,
) -> None:
    """Heights in units of the mean crest's: float64 [ny, nx]."""
    x, y, along, across = waves
    dx = x[1] - x[0]
    dy = y[1] - y[0]
    turn = 0.5 / elementary.PI
    for j in range(first, last):
        for i in range(x.size):
            a = real[j, i]
            b = imaginary[j, i]
            square = a * a + b * b
            # Phase in turns, and its gradient in turns a wavelength, times the squared envelope.
            phase = along * x[i] + across * y[j] + turn * elementary.atan2(b, a)
            gx = along * square + turn * (
                a * _difference(imaginary, j, i, 1, dx) - b * _difference(real, j, i, 1, dx)
            )
            gy = across * square + turn * (
                a * _difference(imaginary, j, i, 0, dy) - b * _difference(real, j, i, 0, dy)
            )
            gradient = np.sqrt(gx * gx + gy * gy)
            tall = 0.0
            if gradient > 0.0:
                tall = square / gradient
                # min(tall, _TALLEST), rounded.
                excess = tall * tall / (_TALLEST * _TALLEST)
                tall /= np.sqrt(np.sqrt(1.0 + excess * excess))
                tall *= elementary.smoothstep((along * gx + across * gy) / (_FULL * gradient))
                tall *= elementary.smoothstep(square / (_FADE * _FADE))
            t = phase - np.floor(phase)
            if t < 1.0 - lee:
                profile = elementary.smoothstep(t / (1.0 - lee))
            else:
                t = (1.0 - t) / lee
                profile = elementary.smoothstep(t) if rounded else t
            # Between ripples the sand lies at their middle, between dunes at their feet.
            out[j, i] = tall * (profile - 0.5) + 0.5 if rounded else tall * profile
