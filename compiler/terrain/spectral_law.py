"""Measures how rough heights are by wavelength: a power law of their spectral density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import cosines, elementary

#: Samples along an axis that are looked at, at most: those in the middle.
_MOST = 1024
#: Frequencies that are fitted: in cycles a window, and as a share of the Nyquist frequency, above
#: which stereo matching and resampling have smoothed what instruments saw.
_LOWEST, _HIGHEST = 3.0, 0.5
#: Bins of an octave, and modes that one has at least.
_BINS, _LEAST = 4, 24
#: About the slope of land (Turcotte 1987), which densities are multiplied by within a bin.
_USUAL = 3.5
#: Median of the square of a normal variable over its mean.
_MEDIAN = 0.454936423119572
#: Standard deviation of the logarithm of such a median, times the root of the number of squares.
_MEDIAN_ERROR = 2.333


@dataclass(frozen=True)
class SpectralLaw:
    """A power spectral density in two dimensions, P(k) = density_m4 (k middle_m)^-slope.

    Its integral over all wave vectors, in cycles a meter, both signs, is the variance.

    Attributes:
        slope: Of -log P over log k: 2 (H + 1) for a surface of the Hurst exponent H.
        slope_error: Its standard deviation, were the modes of a normal field independent; what it
            is off made surfaces is 0.9 to 1.2 times that (root mean square, 32 to 256 pixels).
        middle_m: Wavelength in the middle of the fit, where the density is known best.
        density_m4: There, m^2 a (cycle / m)^2.
        pixel_m: The wider side of a pixel, half of the Nyquist frequency's wavelength.
        scatter_db: Root mean square of 10 log10 of what bins are off the law.
        longest_m, shortest_m: Wavelengths between which it was fitted.
    """

    slope: float
    slope_error: float
    middle_m: float
    density_m4: float
    pixel_m: float
    scatter_db: float = 0.0
    longest_m: float = np.inf
    shortest_m: float = 0.0

    @property
    def at_nyquist_m4(self) -> float:
        """Density at the Nyquist frequency, of one cycle in two pixels, m^4."""
        octaves = elementary.log(2.0 * self.pixel_m / self.middle_m)
        return self.density_m4 * elementary.exp(self.slope * octaves)

    def facts(self) -> dict[str, float]:
        """Returns what report.json says of it."""
        named = "slope", "slope_error", "at_nyquist_m4", "scatter_db", "longest_m", "shortest_m"
        return {f"spectrum_{name}": getattr(self, name) for name in named}


def fit_spectral_law(
    height: NDArray[np.float64], pixel_m: tuple[float, float]
) -> SpectralLaw | None:
    """Fits a power law to the spectrum of heights, from three waves a window to half of Nyquist's.

    The plane that fits them best is taken off; squares of the modes of a DCT-II, which needs no
    window since it goes on even beyond the borders (Denis et al. 2002, Mon. Weather Rev. 130,
    1812), are binned by frequency, without those along the axes, where borders leak to. The median
    of a bin stands for it (of a normal field's squares it is 0.455 of their mean), so that stripes
    and spikes do not count. The line is that of least squares, bins weighted by their modes.

    Args:
        height: Meters, float64 [ny, nx].
        pixel_m: Distance of samples in x and y.

    Returns:
        None where fewer than three bins have enough modes, or one has no relief.
    """
    nyquist = 0.5 / max(pixel_m)
    x, y, weight = _binned(height, pixel_m, nyquist)
    if len(x) < 3 or not np.isfinite(y).all():
        return None
    total = weight.sum()
    x_mean, y_mean = float((weight * x).sum() / total), float((weight * y).sum() / total)
    spread = float((weight * (x - x_mean) * (x - x_mean)).sum())
    slope = -float((weight * (x - x_mean) * y).sum()) / spread
    off = y - y_mean + slope * (x - x_mean)
    scatter = float(np.sqrt((weight * off * off).sum() / total)) * (10.0 / elementary.log(10.0))
    shortest, longest, middle = (
        elementary.exp(-float(at)) / nyquist for at in (x.max(), x.min(), x_mean)
    )
    return SpectralLaw(
        slope,
        _MEDIAN_ERROR / float(np.sqrt(spread)),
        middle,
        elementary.exp(y_mean),
        max(pixel_m),
        scatter,
        longest,
        shortest,
    )


def _binned(
    height: NDArray[np.float64], pixel_m: tuple[float, float], nyquist: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Logarithms of frequency over Nyquist's and of density, and numbers of modes, of full bins."""
    ny, nx = (min(n, _MOST) for n in height.shape)
    j, i = (height.shape[0] - ny) // 2, (height.shape[1] - nx) // 2
    modes = cosines.dct(_without_plane(height[j : j + ny, i : i + nx]), over=True)
    kx, ky = (np.arange(n) / (2.0 * n * p) for n, p in zip((nx, ny), pixel_m, strict=True))
    frequency = np.sqrt(kx[None, 1:] * kx[None, 1:] + ky[1:, None] * ky[1:, None]).ravel()
    density = (modes[1:, 1:] * modes[1:, 1:]).ravel() * (pixel_m[0] * pixel_m[1] / (4.0 * nx * ny))
    low = _LOWEST / min(nx * pixel_m[0], ny * pixel_m[1])
    used = (frequency >= low) & (frequency <= _HIGHEST * nyquist)
    log_k = elementary.log_array(frequency[used] / nyquist)
    whitened = density[used] * elementary.exp_array(_USUAL * log_k)
    which = np.floor(-log_k * (_BINS / elementary.log(2.0))).astype(np.int64)
    parts = [which == number for number in np.unique(which)]
    parts = [part for part in parts if int(part.sum()) >= _LEAST]
    x = np.array([log_k[part].mean() for part in parts])
    medians = np.array([np.median(whitened[part]) for part in parts]) / _MEDIAN
    # Of level ground: no number.
    y = np.where(medians > 0.0, elementary.log_array(np.maximum(medians, 1e-300)), -np.inf)
    return x, y - _USUAL * x, np.array([float(part.sum()) for part in parts])


def _without_plane(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights less the plane of least squares."""
    out = height - height.mean()
    for axis in (0, 1):
        n = out.shape[axis]
        at = (np.arange(n) - 0.5 * (n - 1)).reshape((-1, 1) if axis == 0 else (1, -1))
        across = (at * at).sum() * out.shape[1 - axis]
        if across > 0.0:
            out -= at * ((at * out).sum() / across)
    return out
