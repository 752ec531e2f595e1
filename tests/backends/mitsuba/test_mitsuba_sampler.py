"""The points that Mitsuba's light is sampled with: well spread, uniform, and strangers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.mitsuba.variant import load_mitsuba

#: Calls of a path: camera, and per bounce light (2), lobe (1), direction (2), roulette (1).
CALLS = ("2d", *("2d", "1d", "2d", "1d") * 3)


def draw(seed: int, pixels: int, samples: int, first: int = 0) -> list[NDArray[np.float32]]:
    """What each call gives, [1 or 2, pixels, samples]."""
    mi: Any = load_mitsuba()
    import drjit as dr

    from scenec.backends.mitsuba.sampler import Sobol

    lane = dr.arange(mi.UInt32, pixels * samples)
    sampler = Sobol(mi.UInt32(seed), lane // samples, first + lane % samples)
    drawn = [sampler.next_2d() if call == "2d" else sampler.next_1d() for call in CALLS]
    return [np.array(values).reshape(-1, pixels, samples) for values in drawn]


def strata(values: NDArray[np.float32], parts: int) -> NDArray[np.int64]:
    return np.floor(values.astype(float) * parts).astype(np.int64)


@pytest.mark.parametrize("bits", range(7))
def test_each_elementary_interval_holds_one_of_every_power_of_two_samples(bits):
    count = 1 << bits
    for values in draw(5, 50, 64):
        for start in range(0, 64, count):
            block = values[:, :, start : start + count]
            for across in range(bits + 1) if len(values) == 2 else [bits]:
                cells = strata(block[0], 1 << across)
                if len(values) == 2:
                    along = bits - across
                    cells = (cells << along) + strata(block[1], 1 << along)
                assert (np.sort(cells, axis=1) == np.arange(count)).all()


def test_each_sample_alone_is_uniform():
    pixels = 1 << 16
    for values in draw(6, pixels, 3):
        for sample in range(3):
            cells = strata(values[0, :, sample], 64)
            if len(values) == 2:
                cells = 8 * (cells // 8) + strata(values[1, :, sample], 8)
            counts = np.bincount(cells, minlength=64)
            chi2 = float(((counts - pixels / 64) ** 2).sum() / (pixels / 64))
            # 63 degrees of freedom: above it once in 10 million.
            assert chi2 < 136.0


def test_no_number_is_one():
    mi: Any = load_mitsuba()
    from scenec.backends.mitsuba.sampler import _unit

    bits = [0, 0xFF, 0xFFFFFF00, 0xFFFFFFFF]
    np.testing.assert_array_equal(
        np.array(_unit(mi.UInt32(bits)), float) * 2**24, [0, 0xFF0000, 0xFFFF, 0xFFFFFF]
    )


def test_calls_pixels_seeds_and_samples_do_not_depend_on_each_other():
    pixels = 1 << 14
    a, b = draw(7, pixels, 2), draw(8, pixels, 2)
    columns = [values[c, :, s] for values in a for c in range(len(values)) for s in range(2)]
    columns += [values[c, :, 0] for values in b for c in range(len(values))]
    # Neighbors on one row of a picture, and on the next one of 128.
    columns += [np.roll(a[0][0, :, 0], shift) for shift in (-1, 1, 128)]
    table = np.array(columns, float)
    # Of a column as it stands, and of whether it is near the middle: neither tells another's.
    for shape in (table, np.abs(table - 0.5)):
        related = np.corrcoef(shape) * np.sqrt(pixels)
        for i in range(len(columns)):
            for j in range(i):
                same = i % 2 == 1 and j == i - 1 and i < 2 * sum(map(len, a))
                # The two samples of one call are in halves of their own.
                assert same or abs(related[i, j]) < 6.0, (i, j)


def test_calls_pair_their_points_anyhow():
    # The variance of a product's mean over a pixel, in units of that of independent numbers: above
    # 1, as points stay in blocks of powers of two; 4.7 if all calls had one order.
    samples = 8
    drawn = [values[0] - 0.5 for values in draw(4, 1 << 14, samples)]
    for a in range(len(drawn)):
        for b in range(a):
            means = (drawn[a].astype(float) * drawn[b]).mean(axis=1)
            assert 1.0 < means.var() * 144.0 * samples < 1.7


def test_a_sequence_goes_on_where_passes_end():
    whole = draw(9, 20, 16)
    for start in (0, 4, 12):
        part = draw(9, 20, 4, start)
        for a, b in zip(whole, part, strict=True):
            np.testing.assert_array_equal(a[:, :, start : start + 4], b)


def test_seeds_give_other_points_and_one_seed_the_same():
    a, b, c = draw(1, 100, 8), draw(1, 100, 8), draw(2, 100, 8)
    for first, again, other in zip(a, b, c, strict=True):
        np.testing.assert_array_equal(first, again)
        assert np.mean(first == other) < 0.01


def test_the_mean_of_a_smooth_function_converges_faster_than_with_independent_samples():
    def error(samples: int) -> float:
        x, y = draw(3, 2000, samples)[0].astype(float)
        return float((np.sin(3.0 * x) * np.exp(y)).mean(axis=1).std())

    # Independent ones: a quarter. Owen's: samples**-1.5 and a logarithm.
    assert error(256) < error(16) / 32.0
