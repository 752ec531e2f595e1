"""What the study of photographs measures, of pictures whose statistics are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.testing.ground_statistics import PIXELS_PER_DEGREE, View, in_angles, measure

_SIDE = 256


def field(exponent: float, seed: int = 1) -> NDArray[np.float64]:
    """Noise of rms 1 whose amplitude spectrum is a power of frequency."""
    frequency = np.hypot(np.fft.fftfreq(_SIDE)[:, None], np.fft.fftfreq(_SIDE)[None, :])
    frequency[0, 0] = np.inf
    white = np.random.default_rng(seed).normal(size=(_SIDE, _SIDE))
    made = np.fft.ifft2(np.fft.fft2(white) * frequency**exponent).real
    return np.asarray(made / made.std())


def view(one: NDArray[np.float64], other: NDArray[np.float64] | None = None) -> View:
    both = np.stack([one, one if other is None else other])
    return View(both, np.ones(one.shape, np.bool_))


@pytest.mark.parametrize("exponent", [-0.7, -1.0, -1.4])
def test_the_slope_is_the_exponent_of_the_amplitude_spectrum(exponent: float) -> None:
    found = measure([view(field(exponent, seed)) for seed in range(4)])
    assert found.slope == pytest.approx(exponent, abs=0.05)


def test_octaves_of_a_slope_of_minus_one_have_equal_amplitudes() -> None:
    _, *octaves = measure([view(field(-1.0, seed)) for seed in range(8)]).bands
    assert max(octaves) / min(octaves) < 1.15


def test_independent_noise_of_halves_drops_out() -> None:
    ground = 0.2 * field(-1.0)
    noise = [0.3 * np.random.default_rng(seed).normal(size=ground.shape) for seed in (7, 8)]
    clean, noisy = measure([view(ground)]), measure([view(ground + noise[0], ground + noise[1])])
    assert noisy.bands == pytest.approx(clean.bands, rel=0.05)
    assert noisy.slope == pytest.approx(clean.slope, abs=0.1)
    # The same noise in both halves is part of what they show.
    assert measure([view(ground + noise[0])]).bands[0] > 2.0 * clean.bands[0]


def test_differences_of_normal_noise_have_a_kurtosis_of_3_and_percentiles_of_their_own() -> None:
    found = measure([view(field(0.0))])
    assert found.kurtosis == pytest.approx(3.0, abs=0.1)
    assert found.percentiles == pytest.approx((-2.326, -1.282, 1.282, 2.326), abs=0.06)


def test_what_is_no_ground_does_not_count() -> None:
    ground, mask = 0.2 * field(-1.0), np.ones((_SIDE, _SIDE), np.bool_)
    mask[:, :100] = False
    spoiled = np.where(mask, ground, 9.0)
    halves = np.stack([spoiled, spoiled])
    beside = View(halves * mask, mask)
    assert measure([beside]).bands == pytest.approx(measure([view(ground)]).bands, rel=0.15)


def test_angles_are_even_and_exposure_does_not_matter() -> None:
    fx, size = 400.0, (240, 320)
    intrinsics = [[fx, 0.0, 160.0], [0.0, fx, 120.0], [0.0, 0.0, 1.0]]
    mask = np.ones(size, np.bool_)
    # A stop brighter from 10 degrees to the right of the axis on.
    right = np.arange(320) + 0.5 - 160.0 > fx * np.tan(np.radians(10.0))
    picture = np.broadcast_to(np.where(right, 2.0, 1.0), size)
    found = in_angles([picture, picture], mask, intrinsics)
    bright = in_angles([64.0 * picture, 64.0 * picture], mask, intrinsics)
    assert bright.halves == pytest.approx(found.halves)
    row = found.halves[0, found.ground.shape[0] // 2]
    left_deg = np.degrees(np.arctan(-160.0 / fx))
    edge = np.flatnonzero(np.diff(row) > 0.2)[0] + 1
    assert left_deg + edge / PIXELS_PER_DEGREE == pytest.approx(10.0, abs=1.0 / PIXELS_PER_DEGREE)
    # Glare takes 1 % of a stop's difference.
    assert np.ptp(row) == pytest.approx(1.0, abs=0.02)
