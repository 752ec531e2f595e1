"""Perlin noise: range, statistics, smoothness, and independence of keys and threads."""

from __future__ import annotations

import numpy as np
import pytest
from one_octave import perlin2

from scenec.compiler.noise.fractal import fbm2_points
from scenec.compiler.noise.lattice import mix, subkey
from scenec.compiler.noise.perlin import perlin3
from scenec.schemas.threads import at_most


def octave(key: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return fbm2_points(np.uint64(key), x, y, 1.0, 1, 0.5, 2.0, 0.0)


@pytest.fixture(scope="module")
def field() -> np.ndarray:
    rng = np.random.default_rng(1)
    return octave(11, rng.uniform(-500, 500, 400_000), rng.uniform(-500, 500, 400_000))


def test_one_octave_lies_within_one_with_zero_mean_and_the_stated_rms(field):
    assert np.abs(field).max() <= 1.0
    assert abs(field.mean()) < 0.005
    assert np.sqrt((field**2).mean()) == pytest.approx(0.305, abs=0.01)


def test_noise_is_zero_on_the_lattice():
    i, j = np.meshgrid(np.arange(-20.0, 20), np.arange(-20.0, 20))
    assert np.abs(octave(3, i.ravel(), j.ravel())).max() == 0.0


def test_noise_has_continuous_slopes_across_cells():
    # Second differences shrink with the square of the step, also across lattice lines.
    y = np.full(4001, 0.37)

    def worst(step: float) -> float:
        x = (np.arange(4001) - 2000) * step
        return float(np.abs(np.diff(octave(5, x, y), 2)).max())

    # The quintic fade makes the noise C2: second differences over step^2 stay bounded.
    assert worst(1e-3) / worst(2e-3) == pytest.approx(0.25, rel=0.1)


def test_keys_give_uncorrelated_fields():
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-300, 300, (2, 200_000))
    assert abs(np.corrcoef(octave(1, x, y), octave(2, x, y))[0, 1]) < 0.01


def test_noise_looks_alike_in_all_directions():
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-300, 300, (2, 200_000))
    here = octave(9, x, y)
    drops = []
    for angle in np.linspace(0, np.pi, 8, endpoint=False):
        there = octave(9, x + 0.4 * np.cos(angle), y + 0.4 * np.sin(angle))
        drops.append(((there - here) ** 2).mean())
    assert max(drops) / min(drops) < 1.35


def test_three_dimensional_noise_stays_in_range_and_varies_in_each_direction():
    rng = np.random.default_rng(6)
    points = rng.uniform(-50, 50, (20_000, 3))
    values = np.array([perlin3(np.uint64(7), *p) for p in points])
    assert np.abs(values).max() <= 1.0
    assert abs(values.mean()) < 0.01
    for axis in range(3):
        moved = points.copy()
        moved[:, axis] += 0.5
        assert np.std([perlin3(np.uint64(7), *p) for p in moved[:2000]] - values[:2000]) > 0.1


def test_noise_does_not_depend_on_the_number_of_threads():
    rng = np.random.default_rng(8)
    x, y = rng.uniform(-100, 100, (2, 50_000))
    args = (np.uint64(5), x, y, 7.0, 6, 0.5, 2.1, 0.4)
    with at_most(1):
        alone = fbm2_points(*args)
    assert np.array_equal(alone, fbm2_points(*args))


def test_the_hash_avalanches():
    rng = np.random.default_rng(9)
    flips = []
    for value in rng.integers(0, 2**63, 300, dtype=np.uint64):
        for bit in range(0, 64, 7):
            other = value ^ np.uint64(1 << bit)
            flips.append(int(mix(value) ^ mix(other)).bit_count())
    assert np.mean(flips) == pytest.approx(32, abs=0.5)
    assert min(flips) > 8


def test_subkeys_of_neighboring_indices_differ():
    keys = {int(subkey(np.uint64(1), i)) for i in range(10_000)}
    assert len(keys) == 10_000


def test_a_point_value_is_that_of_the_array():
    x, y = np.array([0.3, -7.7]), np.array([12.9, 0.1])
    got = octave(4, x, y)
    key = subkey(np.uint64(4), 0)
    assert got.tolist() == [perlin2(key, x[i], y[i]) for i in range(2)]
