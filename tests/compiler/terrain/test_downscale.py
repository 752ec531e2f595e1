"""The spectrum of a DEM: found where it is known, and continued below the pixel without a seam."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.downscale import Continuation, continued
from scenec.compiler.terrain.program import run
from scenec.compiler.terrain.sources.dem import Dem
from scenec.compiler.terrain.spectral_law import SpectralLaw, fit_spectral_law
from scenec.schemas.errors import CfgError, SceneError
from scenec.testing.small import small_cfg, write_cfg

PIXEL, LEVEL = 2.0, 0.05
NYQUIST = 0.5 / PIXEL


def surface(seed: int, n: int, slope: float, level: float = LEVEL) -> np.ndarray:
    """A normal field of a power law, n by n pixels out of a periodic one four times as wide."""
    k = np.hypot(*np.meshgrid(*[np.fft.fftfreq(4 * n, PIXEL)] * 2))
    k[0, 0] = np.inf
    noise = np.fft.fft2(np.random.default_rng(seed).normal(size=k.shape))
    density = level * (k / NYQUIST) ** -slope
    return np.fft.ifft2(noise * np.sqrt(density) / PIXEL).real[:n, :n].copy()


def densities(height: np.ndarray, spacing: float, edges: np.ndarray) -> np.ndarray:
    """Means between frequencies of a periodogram with a Hann window, m^4."""
    ny, nx = height.shape
    window = np.outer(np.hanning(ny), np.hanning(nx))
    power = np.abs(np.fft.fft2((height - height.mean()) * window)) ** 2
    power *= spacing**2 / (window**2).sum()
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(nx, spacing), np.fft.fftfreq(ny, spacing)))
    return np.array([power[(k >= a) & (k < b)].mean() for a, b in pairwise(edges)])


def law_of(slope: float) -> SpectralLaw:
    return SpectralLaw(slope, 0.0, 2.0 * PIXEL, LEVEL, PIXEL)


def cfg_with(folder, heights, pixel=0.25, **keys):
    """A cfg of 20 m by 16 m on a DEM of a quarter of a meter, continued."""
    np.save(folder / "dem.npy", heights)
    cfg = small_cfg()
    dem = {"type": "dem", "file": "dem.npy", "pixel_m": pixel, "height_scale": 0.2}
    cfg["terrain"]["relief"] = [dem, {"type": "downscale", **keys}]
    return write_cfg(folder, cfg)


@pytest.mark.parametrize("slope", [2.4, 3.0, 3.6, 4.2])
@pytest.mark.parametrize("n", [64, 256])
def test_the_law_of_a_made_surface_is_found_within_its_error(slope, n):
    seeds = range(60 if n == 64 else 16)
    laws = [fit_spectral_law(surface(seed, n, slope), (PIXEL, PIXEL)) for seed in seeds]
    off = np.array([law.slope - slope for law in laws])
    stated = np.array([law.slope_error for law in laws])
    # Of so few surfaces the ratio itself is sure to 9 and 18 %.
    assert 0.7 < np.sqrt((off * off).mean()) / stated.mean() < 1.35
    assert stated.max() < (0.35 if n == 64 else 0.05)
    level = np.array([law.at_nyquist_m4 / LEVEL for law in laws])
    assert np.exp(np.log(level).mean()) == pytest.approx(1.0, abs=0.15 if n == 64 else 0.05)


@pytest.mark.parametrize("what", ["a plane", "a stripe of the sensor", "a spike", "a far datum"])
def test_the_law_holds_whatever_is_no_relief(what):
    height = surface(1, 256, 3.2)
    before = fit_spectral_law(height, (PIXEL, PIXEL))
    y, x = np.indices(height.shape) * PIXEL
    height += {
        "a plane": 0.3 * x - 0.7 * y,
        "a stripe of the sensor": 3.0 * np.sin(2.0 * np.pi * x / 10.0),
        "a spike": np.where((x == 200.0) & (y == 100.0), 10.0, 0.0),
        "a far datum": 1e6 + 0.0 * x,
    }[what]
    after = fit_spectral_law(height, (PIXEL, PIXEL))
    assert after.slope == pytest.approx(before.slope, abs=0.03)
    assert after.at_nyquist_m4 == pytest.approx(before.at_nyquist_m4, rel=0.05)


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (5, 5), (300, 3)])
def test_too_few_samples_and_level_ground_have_no_law(shape):
    assert fit_spectral_law(np.random.default_rng(0).normal(size=shape), (1.0, 1.0)) is None
    assert fit_spectral_law(np.full((64, 64), 7.25), (1.0, 1.0)) is None


@pytest.mark.parametrize("slope", [2.0, 2.7, 3.5, 4.3, 5.0])
def test_noise_is_scaled_by_the_moment_of_its_own_density(slope):
    t = np.linspace(0.0, 1.0, 2001)
    fade = 1.0 - t**3 * (t * (t * 6.0 - 15.0) + 10.0)
    k = np.geomspace(1e-3, 30.0, 600)
    total = np.zeros(k.size)
    turns = (np.arange(32) + 0.5) / 32 * np.pi / 2.0
    for turn in turns:
        # Of one lattice point's share, sqrt(2) (g . x) w(x) w(y), with gradients g of all turns.
        across = [2.0 * np.pi * c * k[:, None] * t for c in (np.cos(turn), np.sin(turn))]
        even = [2.0 * np.trapezoid(fade * np.cos(a), t, axis=1) for a in across]
        odd = [2.0 * np.trapezoid(t * fade * np.sin(a), t, axis=1) for a in across]
        total += ((odd[0] * even[1]) ** 2 + (even[0] * odd[1]) ** 2) / len(turns)
    moment = np.trapezoid(total * k**slope, np.log(k))
    noise = continued(law_of(slope), 1.0, 8, 1)
    # The sum of all octaves, far above the first: a^2 c^2 (k c)^-slope M / log l.
    found = noise.amplitude_m**2 * noise.scale_m**2 * moment / np.log(noise.lacunarity)
    assert found * (NYQUIST * noise.scale_m) ** -slope == pytest.approx(LEVEL, rel=2e-3)
    assert noise.gain**2 * noise.lacunarity ** (slope - 2.0) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("slope", [2.6, 3.2, 3.8])
def test_the_joined_spectrum_has_no_seam_and_the_dem_keeps_what_it_resolves(slope, tmp_path):
    size, n = (160.0, 160.0), 96
    grid = Grid.with_spacing(size, PIXEL / 8.0)
    edges = NYQUIST * np.array([0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0])
    middle = np.sqrt(edges[1:] * edges[:-1])
    joined, added = np.zeros(len(middle)), np.zeros(len(middle))
    expected = LEVEL * (middle / NYQUIST) ** -slope
    for seed in range(4):
        np.save(tmp_path / "dem.npy", surface(seed, n, slope))
        dem = Dem(tmp_path / "dem.npy", pixel_m=PIXEL)
        finer = Continuation(continued(law_of(slope), 1.0, 8, seed), law_of(slope))
        below, whole = (run(of, grid).field.height for of in ((dem,), (dem, finer)))
        joined += densities(whole, PIXEL / 8.0, edges) / expected / 4.0
        added += densities(whole - below, PIXEL / 8.0, edges) / expected / 4.0
    # The first two bins hold few waves a window.
    assert np.abs(joined[2:] - 1.0).max() < 0.2
    assert (added[:3] < [0.001, 0.01, 0.05]).all()


def test_what_is_measured_stands_in_the_report_and_is_what_goes_on(tmp_path):
    heights = surface(5, 128, 3.0)
    log = BuildLog()
    build(draw(load(cfg_with(tmp_path, heights)), 1, 0), log)
    dem, finer = log.facts["relief"]
    # Under the terrain: 80 by 64 pixels, and those that interpolation reads beyond.
    law = fit_spectral_law(0.2 * heights[::-1][30:98, 22:106], (0.25, 0.25))
    assert dem["spectrum_slope"] == finer["slope"] == pytest.approx(law.slope, rel=1e-9)
    assert dem["spectrum_at_nyquist_m4"] == pytest.approx(law.at_nyquist_m4, rel=1e-9)
    assert finer["longest_m"] == pytest.approx(0.5)
    # The first noise has cells of 0.33 m, and a grid of 0.2 m shows those of 0.4 m.
    assert (finer["octaves"], finer["octaves_below_grid"]) == (0, 16)


@pytest.mark.parametrize("n", [29, 30, 54, 55])
def test_the_fewest_pixels_are_those_that_the_messages_name(n):
    law = fit_spectral_law(surface(3, n, 3.2), (PIXEL, PIXEL))
    assert (law is not None) == (n >= 30)
    assert (law is not None and law.slope_error < 0.4) == (n >= 55)


@pytest.mark.parametrize(
    ("heights", "keys", "said"),
    [
        (np.full((128, 128), 3.0), {}, "is flat under"),
        (np.random.default_rng(0).normal(size=(128, 128)), {}, "expected another DEM, or slope"),
        (surface(1, 128, 3.0)[::2, ::2], {"pixel": 0.5}, "give slope, or a larger terrain"),
    ],
)
def test_a_dem_without_a_law_is_an_error(heights, keys, said, tmp_path):
    with pytest.raises(SceneError, match=said):
        draw(load(cfg_with(tmp_path, heights, **keys)), 1, 0)


@pytest.mark.parametrize(
    ("relief", "pointer"),
    [
        ([{"type": "plane"}, {"type": "downscale"}], "/terrain/relief/1/type"),
        ([{"type": "plane"}, {"type": "downscale", "slope": 6}], "/terrain/relief/1/slope"),
    ],
)
def test_faults_have_their_place(relief, pointer, tmp_path):
    cfg = small_cfg()
    cfg["terrain"]["relief"] = relief
    with pytest.raises(CfgError) as caught:
        load(write_cfg(tmp_path, cfg))
    assert pointer in {fault.pointer for fault in caught.value.faults}
