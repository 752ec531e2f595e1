"""Continues the spectrum of a DEM below its pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import Context, Finding, Node, forms, given, key, noise_key
from scenec.compiler.terrain.detail import Detail
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.mask import unmasked
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.sources.dem import Dem
from scenec.compiler.terrain.spectral_law import SpectralLaw
from scenec.schemas.errors import SceneError

#: Two octaves of noise a halving: their sum is within 3 % of a power law, at one a halving 25 %.
_LACUNARITY = 1.4142135623730951
#: Cells of the first octave in a wave of the Nyquist frequency, see ``Downscale``.
_FIRST = 0.65
#: Logarithm of the integral of S(k) k^(slope - 1) dk, S the density of one octave of noise of unit
#: cells in all directions, as a polynomial of slope - 3.5; within 0.08 % for slopes from 2 to 5.
_MOMENTS = (-4.89718374, -0.369335331, 0.0540278818, -0.00252520482)
_FLATTEST, _STEEPEST = 2.0, 5.0
#: A slope that is less sure is none: three halvings down, heights are then off by half.
_MOST_UNSURE = 0.4
#: Squares of pixels that have a spectrum (three bins of 24 modes), and a slope that sure.
_FEWEST, _ENOUGH = "30 by 30 or more", "55 by 55 pixels are enough"


@dataclass(frozen=True, kw_only=True)
class Downscale:
    """Fractal relief finer than a DEM's pixel that continues its spectrum, with slope and density
    measured under the terrain.

    Note: To the DEM, which interpolation fades out above half of its Nyquist frequency, fBm is
    added that fades in there. The densities of the sum are within 20 % of the power law from a
    third to three times that frequency. Of what the DEM resolves it changes little: below a third
    of the Nyquist frequency it adds less than 5 % to the density, below a fifth 1 %. A DEM that was
    smoothed, as stereo matching does, has less than its law near the Nyquist frequency, and keeps
    that gap.
    """

    EXAMPLE: ClassVar = {"type": "downscale"}

    octaves: int = key(forms.WHOLE_PER_BATCH, default=8, at_least=1, at_most=12)
    """Halvings of the wavelength below two pixels, at most; the mesh shows those that a camera is
    near enough for."""
    roughness: float = key(forms.PER_BATCH, default=1, at_least=0, at_most=1000)
    """Factor on its heights; 1 goes on as the DEM does."""
    slope: float | None = key(forms.PER_BATCH, optional=True, at_least=_FLATTEST, at_most=_STEEPEST)
    """Slope of the power spectral density below the pixel, 2 (H + 1) of a Hurst exponent H; left
    out, as measured."""
    dem: Dem | None = given(lambda context: _dem(context))
    key: int = noise_key()

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a relief that has no DEM before it."""
        before = node.whole().at(*node.path[:-1]).each("*")[: int(node.path[-1])]
        if all(operator["type"] != "dem" for operator in before):
            yield node.fault('it continues a DEM: expected an operator "dem" before it', "type")

    def draw(self, context: Context) -> Continuation:
        """Measures the DEM under the terrain.

        Raises:
            SceneError: It cannot be read, has too few pixels there, or is no fractal surface.
        """
        if self.dem is None:
            raise SceneError(f"{context.path}: there is no DEM before it to continue")
        law = self.dem.spectral_law(Grid.with_spacing(context.size_m, context.spacing_m))
        who = f"{context.path}: {self.dem.file.name}"
        if law is None:
            raise SceneError(
                f"{who}: is flat under the terrain, or has too few pixels there to measure its "
                f"spectrum, or pixels of different sizes: expected {_FEWEST}, of one size"
            )
        if self.slope is not None:
            law = replace(law, slope=self.slope, slope_error=0.0)
        if law.slope_error > _MOST_UNSURE:
            raise SceneError(
                f"{who}: has too few pixels under the terrain: the slope of its spectrum is "
                f"{law.slope:.3g} ± {law.slope_error:.2g}, expected within {_MOST_UNSURE:g}: give "
                f"slope, or a larger terrain ({_ENOUGH})"
            )
        if not _FLATTEST <= law.slope <= _STEEPEST:
            raise SceneError(
                f"{who}: its spectrum falls as the frequency to the power of -{law.slope:.3g} "
                f"under the terrain, that of land to -{_FLATTEST:g} to -{_STEEPEST:g}: expected "
                "another DEM, or slope"
            )
        return Continuation(continued(law, self.roughness, self.octaves, self.key), law)


@dataclass(frozen=True)
class Continuation:
    """Relief that a ``Downscale`` has drawn.

    Attributes:
        noise: What is added.
        law: What it continues.
    """

    noise: Multifractal
    law: SpectralLaw
    KIND: ClassVar = "downscale"
    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights plus relief."""
        out, report = self.noise.apply(grid, height)
        return out, {"slope": self.law.slope, "longest_m": 2.0 * self.law.pixel_m, **report}

    def detail(self, grid: Grid) -> Detail | None:
        """The octaves that a grid is too coarse for."""
        return self.noise.detail(grid)


def continued(law: SpectralLaw, roughness: float, octaves: int, noise_key: int) -> Multifractal:
    """Returns fBm whose spectrum is a power law from its first octave on.

    Octave j of noise in cells of c_j = c l^-j with amplitudes a g^j has the density
    a^2 g^(2 j) c_j^2 S(k c_j). With g^2 = l^(2 - slope) their sum is the power law
    a^2 c^2 (k c)^-slope M / log l times what repeats with each octave, M the moment of S.
    """
    cell, slope = 2.0 * law.pixel_m * _FIRST, law.slope
    t, moment = slope - 3.5, 0.0
    for coefficient in reversed(_MOMENTS):
        moment = moment * t + coefficient
    octave = elementary.log(_LACUNARITY)
    # The Nyquist frequency is _FIRST / c.
    at_cell = elementary.log(law.at_nyquist_m4) + slope * elementary.log(_FIRST)
    square = elementary.exp(at_cell - moment) * octave / (cell * cell)
    return Multifractal(
        amplitude_m=roughness * float(np.sqrt(square)),
        scale_m=cell,
        octaves=2 * octaves,
        lacunarity=_LACUNARITY,
        gain=elementary.exp(0.5 * (2.0 - slope) * octave),
        variant="fbm",
        key=noise_key,
    )


def _dem(context: Context) -> Dem | None:
    """Returns the last DEM before an operator."""
    dems = (unmasked(operator) for operator in reversed(context.relief))
    return next((operator for operator in dems if isinstance(operator, Dem)), None)
