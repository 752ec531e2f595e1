"""Electrons and numbers, against EMVA 1288's own ways of measuring them, and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from scenec.backends.imaging import chance, sensor
from scenec.schemas import imaging as formulas
from scenec.schemas.imaging import Imaging

QUIET = sensor.Exposed(
    weights=np.eye(3),
    dark_e=0.0,
    time_s=1.0,
    full_well_e=1e6,
    read_e=0.0,
    gain=1.0,
    black=0.0,
    largest=65535.0,
    shot=True,
)
ONE = np.ones((1, 1), np.float32)


def flat(value: float, h: int = 256, w: int = 256) -> NDArray[np.float32]:
    return np.full((h, w, 3), value, np.float32)


def numbers(
    light: NDArray[np.float32],
    how: sensor.Exposed = QUIET,
    sample: int = 0,
    key: int = 7,
    of: sensor.Pattern | None = None,
) -> NDArray[np.float64]:
    """Behind a mosaic, [h, w]; every color counts the same."""
    sound = sensor.pattern(1, (*light.shape[:2], 1), 0.0, 0.0, 0.0, 0.0, 0.0)
    raw = sensor.expose(light, ONE, "rggb", key, sample, of or sound, how)
    return raw[:, :, 0].astype(np.float64)


def test_philox_gives_the_words_of_its_authors_test_vectors() -> None:
    # Random123's kat_vectors: philox4x32 10.
    full = np.uint64(2**32 - 1)
    none = np.uint64(0)
    words = chance.philox(none, none, none, none, none)
    assert [int(word) for word in words] == [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]
    words = chance.philox(np.uint64(2**64 - 1), full, full, full, full)
    assert [int(word) for word in words] == [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]
    # Key a4093822 299f31d0, counter 243f6a88 85a308d3 13198a2e 03707344.
    counter = [np.uint64(n) for n in (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344)]
    words = chance.philox(np.uint64(0x299F31D0A4093822), *counter)
    assert [int(word) for word in words] == [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1]


def test_philox_of_a_line_of_counters_is_that_of_each() -> None:
    words = np.empty((4, 37), np.uint64)
    first, key, *rest = (np.uint64(n) for n in (2**32 - 20, 0x299F31D0A4093822, 5, 2**32 - 1, 2))
    chance.philoxes(key, first, *rest, words)
    for i in range(37):
        one = chance.philox(key, np.uint64((2**32 - 20 + i) % 2**32), *rest)
        assert words[:, i].tolist() == [int(word) for word in one]


def test_normal_numbers_are_the_quantiles_they_should_be() -> None:
    words = np.concatenate([np.arange(0, 2**32, 99991), [0, 1, 2**32 - 1]]).astype(np.uint64)
    table = chance.quantiles()
    found = np.array([chance.normal(word, table) for word in words])
    exact = stats.norm.ppf((words.astype(np.float64) + 0.5) / 2.0**32)
    assert np.abs(found - exact).max() < 1.5e-4
    assert np.abs(found - exact)[np.abs(exact) > 3].max() < 1e-6


def test_many_numbers_at_once_are_the_same_numbers() -> None:
    rng = np.random.default_rng(4)
    words = rng.integers(0, 2**32, 20000).astype(np.uint64)
    words[:4] = [0, 1, 2**32 - 1, 2**24]
    means = rng.choice([0.0, 0.3, 9.99, 10.0, 55.5, 1e4, 1e9], 20000)
    table = chance.quantiles()
    made, drawn = means.copy(), np.empty(20000)
    chance.poissons(made, words, table)
    chance.normals(words, table, drawn)
    for i, word in enumerate(words):
        alone = means[i : i + 1].copy()
        chance.poissons(alone, words[i : i + 1], table)
        assert made[i] == alone[0]
        assert drawn[i] == chance.normal(word, table)


@pytest.mark.parametrize("mean", [0.0, 0.01, 1.0, 9.99, 10.0, 30.0, 399.0, 401.0, 5000.0])
def test_poisson_numbers_have_the_distribution_to_the_stated_error(mean: float) -> None:
    words = (np.arange(100000) * (2.0**32 / 100000)).astype(np.uint64)
    table = chance.quantiles()
    found = np.full(len(words), mean)
    chance.poissons(found, words, table)
    assert (np.diff(found) >= 0).all(), "more probable words give larger numbers"
    k = np.arange(found.max() + 1)
    share = np.searchsorted(found, k, side="right") / len(found)
    allowed = 2e-5 if mean < chance.EXACT_BELOW else 3.2e-4 * (10.0 / mean) + 2e-5
    assert np.abs(share - stats.poisson.cdf(k, mean)).max() < allowed
    assert found.mean() == pytest.approx(mean, rel=2e-4, abs=1e-4)
    assert found.var() == pytest.approx(mean, rel=2e-3, abs=1e-4)


def test_logarithms_are_right_to_the_last_digits() -> None:
    x = np.logspace(-300, 300, 1001)
    found = np.array([chance.log(value) for value in x])
    assert np.abs(found - np.log(x)).max() < 4e-13


def test_the_photon_transfer_curve_gives_gain_and_read_noise_back() -> None:
    # EMVA 1288, 6.6: variance of the difference of two frames over their mean, both in DN.
    how = QUIET._replace(gain=4.0, read_e=12.0, black=100.0)
    means, variances = [], []
    for level in (50, 200, 1000, 5000, 20000, 80000):
        first, second = numbers(flat(level), how, 0), numbers(flat(level), how, 1)
        means.append(0.5 * (first.mean() + second.mean()) - 100.0)
        variances.append(0.5 * (first - second).var())
    slope, offset = np.polyfit(means, variances, 1, w=1.0 / np.array(variances))
    assert 1.0 / slope == pytest.approx(4.0, rel=0.01)
    # Read noise, and the rounding's 1/12.
    assert np.sqrt(offset - 1.0 / 12.0) * 4.0 == pytest.approx(12.0, rel=0.02)


def test_signal_to_noise_follows_emvas_formula() -> None:
    how = QUIET._replace(gain=1.0, read_e=5.0)
    gain = sensor.pattern(3, (512, 512, 1), 0.02, 0.0, 0.0, 0.0, 0.0)
    for level in (30.0, 300.0, 3000.0):
        found = numbers(flat(level, 512, 512), how, of=gain)
        noise = np.sqrt(5.0**2 + level + (0.02 * level) ** 2 + 1.0 / 12.0)
        assert found.mean() / found.std() == pytest.approx(level / noise, rel=0.01)


def test_dark_frames_show_dark_current_and_offsets() -> None:
    how = QUIET._replace(dark_e=40.0, black=64.0)
    found = numbers(flat(0.0), how)
    assert found.mean() == pytest.approx(104.0, abs=0.2)
    assert found.var() == pytest.approx(40.0, rel=0.02)
    uneven = sensor.pattern(5, (256, 256, 1), 0.0, 8.0, 0.0, 0.0, 0.0)
    many = np.mean([numbers(flat(0.0), how, i, of=uneven) for i in range(64)], axis=0)
    # The spread of what stays: DSNU, and what is left of shot noise.
    assert np.sqrt(many.var() - 40.0 / 64.0) == pytest.approx(8.0, rel=0.01)


def test_a_flat_fields_spread_is_its_prnu() -> None:
    uneven = sensor.pattern(5, (256, 256, 1), 0.03, 0.0, 0.0, 0.0, 0.0)
    found = numbers(flat(20000.0), QUIET._replace(shot=False), of=uneven)
    assert found.std() / found.mean() == pytest.approx(0.03, rel=0.01)
    # Normal, as EMVA supposes.
    assert stats.kstest((found.ravel() / 20000.0 - 1.0) / 0.03, "norm").pvalue > 1e-3


def test_hot_and_dead_pixels_are_as_many_as_asked_for_and_stay_where_they_are() -> None:
    bad = sensor.pattern(9, (512, 512, 1), 0.0, 0.0, 0.02, 300.0, 0.01)
    how = QUIET._replace(shot=False)
    lit, dark = (
        numbers(flat(100.0, 512, 512), how, of=bad),
        numbers(flat(0.0, 512, 512), how, of=bad),
    )
    assert (lit - dark == 0.0).mean() == pytest.approx(0.01, rel=0.1)
    hot = dark[dark > 0]
    assert len(hot) / dark.size == pytest.approx(0.02, rel=0.1)
    assert hot.mean() == pytest.approx(300.0, rel=0.06)
    assert hot.std() == pytest.approx(300.0, rel=0.1), "exponential"
    later = numbers(flat(0.0, 512, 512), how._replace(time_s=2.0), 1, of=bad)
    # Twice the time, twice the current, in the same pixels, but for rounding.
    assert np.abs(later - 2.0 * dark).max() <= 1.0


def test_numbers_are_rounded_and_end_where_the_converter_ends() -> None:
    ramp = np.repeat(np.linspace(0, 400, 4001, dtype=np.float32)[None, :, None], 3, axis=2)
    how = QUIET._replace(shot=False, gain=2.0, black=10.0, largest=150.0, full_well_e=250.0)
    raw = sensor.expose(
        np.concatenate([ramp, ramp]), ONE, "rggb", 0, 0,
        sensor.pattern(1, (2, 4001, 1), 0.0, 0.0, 0.0, 0.0, 0.0), how,
    )  # fmt: skip
    expected = np.floor(10.0 + np.minimum(ramp[0, :, 0].astype(np.float64), 250.0) / 2.0 + 0.5)
    np.testing.assert_array_equal(raw[0, :, 0], expected)
    # Every number is there equally often below the full well, which ends at 10 + 125.
    counts = np.bincount(raw[0, :, 0])
    assert raw.max() == 135
    assert set(counts[11:135]) <= {19, 20, 21}
    higher = sensor.expose(
        flat(1e9, 2, 2), ONE, "rggb", 0, 0,
        sensor.pattern(1, (2, 2, 1), 0.0, 0.0, 0.0, 0.0, 0.0), how._replace(full_well_e=1e9),
    )  # fmt: skip
    assert (higher == 150).all()


@pytest.mark.parametrize("light", [0.0, 1e9, np.inf, np.nan, -1.0])
def test_no_light_makes_numbers_that_are_none(light: float) -> None:
    for gain in (0.01, 1.0, 1000.0):
        how = QUIET._replace(gain=gain, read_e=3.0, full_well_e=1e4, largest=4095.0, black=64.0)
        found = numbers(flat(light, 3, 5), how)
        if light > 0:
            assert (found == min(4095.0, 64.0 + round(1e4 / gain))).all() or gain == 1000.0
        else:
            assert (np.abs(found - 64.0) <= 20.0 / gain + 1.0).all()


def test_noise_belongs_to_seed_sample_and_pixel() -> None:
    light = flat(500.0, 64, 64)
    first = numbers(light)
    assert (first == numbers(light)).all()
    for other in (numbers(light, sample=1), numbers(light, key=8)):
        assert np.abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.06
    # More light in one place changes no other pixel.
    light[5, 6] = 9000.0
    assert np.argwhere(numbers(light) != first).tolist() == [[5, 6]]
    # Nor does read noise change what the photons are.
    quiet, noisy = numbers(light), numbers(light, QUIET._replace(read_e=4.0))
    assert np.std(noisy - quiet) == pytest.approx(4.0, rel=0.05)


def test_nearly_the_same_light_has_nearly_the_same_noise() -> None:
    # As of two renderers: the noise differs by no more than the light does.
    light = flat(500.0)
    other = light * np.float32(1.002)
    assert np.abs(numbers(other) - numbers(light)).max() <= 3


def test_electrons_follow_the_camera_equation() -> None:
    # A white surface in sunlight of 100 klx, f/8, 1 ms, 3.45 um: by hand, in green.
    imaging = Imaging(f_number=8.0, pixel_um=3.45, quantum_efficiency=(1.0, 0.6, 1.0))
    radiance = 1020.0 / np.pi
    irradiance = np.pi * radiance / (4.0 * 64.0)
    in_band = irradiance * 0.12775
    photons = in_band * (3.45e-6) ** 2 * 1e-3 / (6.62607015e-34 * 2.99792458e8 / 549.4e-9)
    electrons = formulas.electrons_per_value(imaging, 1e-3)[1] * radiance
    assert electrons == pytest.approx(0.6 * photons, rel=1e-9)


def test_sunny_sixteen_exposes_gray_as_iso_12232_says() -> None:
    # f/16, 1/100 s, ISO 100, 100 klx: 0.18 lx s on the sensor behind 18 % gray, of 0.78 at most.
    gray = 0.18 * (1e5 / formulas.LUMENS_PER_WATT) / np.pi
    shown = formulas.shown_per_value(16.0, 0.01, 100.0, 1.0) * gray
    assert shown == pytest.approx(np.pi * 0.18 * 1e5 / np.pi / (4 * 256) * 0.01 / 0.78, rel=1e-9)
    assert shown == pytest.approx(0.225, abs=0.002)
    # What is shown of a value is what its electrons are of those that saturate.
    imaging = Imaging(f_number=16.0)
    electrons = formulas.electrons_per_value(imaging, 0.01)[1] * gray
    assert electrons / formulas.saturation_e(imaging, 100.0) == pytest.approx(shown, rel=1e-9)


def test_time_comes_before_speed_and_both_keep_their_limits() -> None:
    times, isos = (1e-4, 0.03), (200.0, 6400.0)
    for shown in 2.0 ** np.arange(-24.0, 8.0, 0.5):
        time_s, iso = formulas.time_and_iso(shown, 4.0, 2.0, times, isos)
        assert times[0] <= time_s <= times[1]
        assert isos[0] <= iso <= isos[1]
        if times[0] < time_s < times[1]:
            assert iso == isos[0]
        if isos[0] < iso < isos[1]:
            assert time_s == times[1]
        if times[0] < time_s < times[1] or isos[0] < iso < isos[1]:
            assert formulas.shown_per_value(4.0, time_s, iso, 2.0) == pytest.approx(shown)


def test_a_gain_is_the_speed_that_has_it() -> None:
    imaging = Imaging()
    for gain in (0.01, 2.5, 1000.0):
        iso = formulas.iso_of_gain(imaging, gain)
        assert formulas.electrons_per_number(imaging, iso) == pytest.approx(gain)
    base = formulas.base_iso(imaging)
    assert formulas.saturation_e(imaging, base) == pytest.approx(imaging.full_well_e)
