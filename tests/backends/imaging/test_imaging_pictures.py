"""A sensor's picture: optics, colors, tones, and which stage does what."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from scenec.backends.imaging import develop, optics, sensor
from scenec.backends.imaging.camera import exposure, take
from scenec.backends.imaging.jpeg import compressed
from scenec.backends.stage.scene import Camera
from scenec.schemas.imaging import SUBSAMPLINGS, Imaging, displayed_per_value
from scenec.schemas.picture import srgb_encode, tone_map
from scenec.schemas.threads import at_most
from scenec.testing.examples import examples

#: No noise, no pattern, no mosaic: the stages that are always there, finely rounded.
PLAIN = Imaging(
    time_s=1e-3, iso=200.0, f_number=4.0, shot_noise=False, bits=16, black_level=0, full_well_e=1e9
)
#: Everything.
FULL = Imaging(
    pattern_seed=11,
    noise_seed=22,
    time_s=2e-3,
    iso=800.0,
    read_noise_e=2.3,
    dark_current_e_s=2000.0,
    prnu=0.02,
    dsnu_e=3.0,
    hot=0.01,
    hot_rate_e_s=1e6,
    dead=0.01,
    mosaic="rggb",
    vignetting_power=4,
    vignetting_polynomial=(-0.1, 0.05, 0.0),
    bloom=0.05,
    bloom_sigma_px=3.0,
    jpeg_quality=80,
    color_matrix=(0.8, 0.15, 0.05, 0.1, 0.8, 0.1, 0.0, 0.2, 0.8),
    white_balance=(1.1, 1.0, 0.9),
    clean=True,
    raw=True,
)


def camera(width: int, height: int) -> Camera:
    focal = 0.8 * width
    k = np.array([[focal, 0, 0.5 * width], [0, focal, 0.5 * height], [0, 0, 1.0]])
    return Camera("cam", "/cam", width, height, k, np.eye(4))


def scene(height: int = 48, width: int = 64) -> NDArray[np.float32]:
    """Smooth colors around what PLAIN shows as gray, and edges."""
    y, x = np.mgrid[:height, :width]
    waves = [np.sin(0.1 * x + c) * np.cos(0.13 * y - c) for c in range(3)]
    light = 10.0 * np.exp(np.stack(waves, axis=2))
    light[:, width // 2 :] *= 2.0
    return light.astype(np.float32)


def picture(rgb: NDArray[np.float32], imaging: Imaging, sample: int = 0) -> NDArray[np.uint8]:
    return take(rgb, camera(rgb.shape[1], rgb.shape[0]), imaging, sample).picture


def shown(rgb: NDArray[np.floating], imaging: Imaging) -> NDArray[np.float64]:
    """What the shared tone curve makes of it, stretched so that the brightest is white."""
    white = 2.0**imaging.headroom
    ev = np.log2(displayed_per_value(imaging.f_number, imaging.time_s, imaging.iso, white))
    brightest = tone_map(np.array(2.0**imaging.headroom))
    curve = np.minimum(tone_map(rgb.astype(np.float64), ev) / brightest, 1.0)
    return 255.0 * srgb_encode(curve)


def test_without_noise_a_picture_is_the_shared_tone_curve() -> None:
    light = scene()
    # To one code: 16 bits are coarse in the shadows.
    assert np.abs(picture(light, PLAIN) - shown(light, PLAIN)).max() < 1.0
    gray = np.linspace(0.0, 400.0, 9000, dtype=np.float32).reshape(30, 300, 1).repeat(3, axis=2)
    assert np.abs(picture(gray, PLAIN) - shown(gray, PLAIN)).max() < 1.0
    assert picture(gray, PLAIN).max() == 255


def test_codes_change_where_the_curve_does() -> None:
    edges, starts = develop.codes(2.0)
    x = np.linspace(0.0, 1.0, 200001)
    curve = 255.0 * srgb_encode(np.minimum(tone_map(2.0 * x) / tone_map(np.array(2.0)), 1.0))
    found = np.searchsorted(edges, x, side="right")
    sure = np.abs(curve - np.floor(curve) - 0.5) > 1e-4
    np.testing.assert_array_equal(found[sure], np.rint(curve[sure]))
    assert starts[0] == 0
    assert starts[-1] == 255


@pytest.mark.parametrize("white", [1e-3, 0.5, 1.0, 2.0, 64.0, 1e6])
def test_each_value_finds_its_code_by_one_comparison(white: float) -> None:
    # What ``_show`` relies on: no step of the table has two edges.
    edges, starts = develop.codes(white)
    assert np.diff(starts.astype(int), append=255).max() <= 1
    ramp = np.concatenate([np.geomspace(1e-9, 1.0, 30000), edges[:255], np.nextafter(edges, 0)])
    ramp = np.minimum(ramp, 1.0).astype(np.float32)
    look = develop.Look(np.ones(3), np.inf, np.eye(3) * white, white)
    shown = develop.develop_light(np.repeat(ramp[None, :, None], 3, axis=2), look)
    expected = np.searchsorted(edges, ramp, side="right")
    np.testing.assert_array_equal(shown, np.repeat(expected[None, :, None], 3, axis=2))


def test_white_light_is_white_whatever_the_colors_of_pixels() -> None:
    light = np.full((8, 8, 3), 12.0, np.float32)
    for mosaic in ("none", *sensor.COLORS):
        odd = replace(
            PLAIN,
            mosaic=mosaic,
            quantum_efficiency=(0.3, 0.7, 0.9),
            color_matrix=FULL.color_matrix,
        )
        found = picture(light, odd)
        assert np.ptp(found) <= 1, mosaic
        assert found[0, 0, 1] == pytest.approx(picture(light, PLAIN)[0, 0, 1], abs=1)


def test_a_color_matrix_is_undone_but_for_its_noise() -> None:
    light = scene()
    mixed = replace(PLAIN, color_matrix=FULL.color_matrix)
    assert np.abs(picture(light, mixed).astype(int) - picture(light, PLAIN)).max() <= 2
    noisy = replace(PLAIN, shot_noise=True, mosaic="rggb", bits=12)
    flat = np.full((64, 64, 3), 10.0, np.float32)
    spread = [
        picture(flat, replace(noisy, color_matrix=matrix)).std()
        for matrix in (PLAIN.color_matrix, FULL.color_matrix)
    ]
    assert spread[1] > 1.1 * spread[0]


def test_white_balance_multiplies_colors() -> None:
    light = np.full((4, 4, 3), 5.0, np.float32)
    warm = picture(light, replace(PLAIN, white_balance=(1.5, 1.0, 1.2)))[0, 0]
    expected = shown(light[0, 0] * np.array([1.5, 1.0, 1.2]), PLAIN)
    assert np.abs(warm - expected).max() < 1.0


def test_what_is_full_is_white_not_pink() -> None:
    for iso in (20.0, 200.0, 3200.0):
        full = replace(PLAIN, full_well_e=10500.0, iso=iso, mosaic="rggb", bits=12, black_level=64)
        assert (picture(np.full((6, 6, 3), 1e9, np.float32), full) == 255).all()
        assert (picture(np.zeros((6, 6, 3), np.float32), full) == 0).all()


def demosaiced(raw: NDArray[np.uint16], mosaic: str, method: str) -> NDArray[np.float32]:
    """All three colors of each pixel, before they are clipped and shown."""
    out = np.empty((*raw.shape, 3), np.float32)
    padded = develop._balanced(raw, mosaic, 0, (1.0, 1.0, 1.0))
    for y, i in np.ndindex(len(raw), 2):
        develop._row_colors(padded, y, i, *develop._tables(mosaic, method), out[y])
    return out


@pytest.mark.parametrize("method", ["malvar", "bilinear"])
@pytest.mark.parametrize("mosaic", list(sensor.COLORS))
def test_demosaicing_is_that_of_plain_convolutions(mosaic: str, method: str) -> None:
    rng = np.random.default_rng(3)
    raw = rng.integers(0, 65536, (13, 18), dtype=np.uint16)
    colors = np.array(sensor.COLORS[mosaic])
    color = np.tile(colors, (7, 9))[:13, :18]
    green = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1],
                      [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]) / 8.0  # fmt: skip
    row = np.array([[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1],
                    [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]) / 8.0  # fmt: skip
    other = np.array([[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5],
                      [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]) / 8.0  # fmt: skip
    if method == "bilinear":
        cross = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]) / 4.0
        green, row = cross, np.array([[0, 0, 0], [1, 0, 1], [0, 0, 0]]) / 2.0
        other = np.array([[1, 0, 1], [0, 0, 0], [1, 0, 1]]) / 4.0
    made = {
        name: ndimage.correlate(raw.astype(np.float64), kernel, mode="mirror")
        for name, kernel in (("green", green), ("row", row), ("column", row.T), ("other", other))
    }
    expected = np.empty((13, 18, 3))
    for y, x in np.ndindex(13, 18):
        for c in range(3):
            if color[y, x] == c:
                expected[y, x, c] = raw[y, x]
            elif c == 1:
                expected[y, x, c] = made["green"][y, x]
            elif color[y, x] != 1:
                expected[y, x, c] = made["other"][y, x]
            else:
                beside = colors[y % 2][1 - x % 2] == c
                expected[y, x, c] = made["row" if beside else "column"][y, x]
    np.testing.assert_array_equal(demosaiced(raw, mosaic, method), expected)


def test_vignetting_is_the_stated_ratio() -> None:
    seen = camera(640, 480)
    shade = optics.vignetting(seen, 4, (0.0, 0.0, 0.0))
    x, y = (0.5 - 320) / 512.0, (0.5 - 240) / 512.0
    assert shade[0, 0] == pytest.approx((1 + x * x + y * y) ** -2, rel=1e-6)
    assert shade[240, 320] == pytest.approx(1.0, abs=1e-5)
    polynomial = optics.vignetting(seen, 0, (-0.3, 0.1, -0.05))
    assert polynomial[0, 0] == pytest.approx(0.75, rel=1e-6), "r = 1 in the corner"
    turned = replace(seen, camera_to_world=np.diag([-1.0, -1.0, 1.0, 1.0]))
    np.testing.assert_array_equal(optics.vignetting(turned, 4, (0.0, 0.0, 0.0)), shade)
    assert optics.vignetting(camera(1, 1), 8, (0.0, -1.0, 0.0)) == pytest.approx(1.0)


@pytest.mark.parametrize("shape", [(1, 1), (2, 7), (4, 1000), (37, 53), (128, 128)])
@pytest.mark.parametrize("sigma", [0.5, 3.0, 20.0, 500.0])
def test_bloom_conserves_light(shape: tuple[int, int], sigma: float) -> None:
    rng = np.random.default_rng(1)
    light = rng.exponential(size=(*shape, 3)).astype(np.float32)
    light[0, 0] = 1e7
    found = optics.bloom(light, 0.1, sigma)
    assert found.min() >= 0.0
    np.testing.assert_allclose(
        found.sum(axis=(0, 1), dtype=np.float64),
        light.sum(axis=(0, 1), dtype=np.float64),
        rtol=2e-6,
    )


@pytest.mark.parametrize("sigma", [1.5, 4.0, 8.0])
def test_bloom_is_three_gaussians_to_the_stated_error(sigma: float) -> None:
    # Wide enough that no tail comes back from an edge.
    light = np.zeros((400, 400, 3), np.float32)
    light[200, 197] = 1.0
    found = optics.bloom(light, 1.0, sigma)[:, :, 0].astype(np.float64)
    point = light[:, :, 0].astype(np.float64)
    expected = sum(
        share * ndimage.gaussian_filter(point, sigma * size, truncate=6, mode="reflect")
        for share, size in zip(optics.BLOOM_SHARES, optics.BLOOM_SIZES, strict=True)
    )
    assert np.abs(found - expected).max() < (0.13 if sigma >= 4.0 else 0.006) * expected.max()
    y, x = np.mgrid[:400, :400]
    for axis in (y - 200.0, x - 197.0):
        variances = [(spread * axis * axis).sum() for spread in (found, expected)]
        assert variances[0] == pytest.approx(variances[1], rel=0.015)


def test_glare_of_a_sun_leaves_shadows_their_digits() -> None:
    light = np.ones((200, 200, 3), np.float32)
    light[10, 10] = 1e9
    far = optics.bloom(light, 0.01, 1.0)[150:, 150:]
    # Beyond the reach of the Gaussians it is as it was.
    np.testing.assert_allclose(far, 1.0, rtol=1e-5)


def pillows(picture: NDArray[np.uint8], quality: int, subsampling: str) -> NDArray[np.uint8]:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=quality, subsampling=subsampling)
    return np.asarray(Image.open(file).convert("RGB"))


@pytest.mark.parametrize("subsampling", SUBSAMPLINGS)
@examples(40)
@given(
    st.integers(1, 50) | st.integers(120, 400),
    st.integers(1, 100),
    st.integers(1, 100),
    st.integers(0, 2**32 - 1),
)
def test_a_jpeg_in_bands_is_that_of_the_whole_to_the_bit(
    subsampling: str, h: int, w: int, quality: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    noise = rng.integers(0, 256, (h, w, 3), dtype=np.uint8)
    hard = rng.choice(np.array([0, 255], np.uint8), (h, w, 3))
    smooth = ndimage.uniform_filter(noise, (7, 7, 1))
    for sent in (noise, hard, smooth):
        got = compressed(sent, quality, subsampling)
        np.testing.assert_array_equal(got, pillows(sent, quality, subsampling))


STAGES = {
    "exposure time": {"time_s": 2e-3},
    "speed": {"iso": 400.0},
    "aperture": {"f_number": 5.6},
    "headroom": {"headroom": 2.0},
    "vignetting": {"vignetting_power": 4},
    "vignetting polynomial": {"vignetting_polynomial": (-0.3, 0.0, 0.0)},
    "bloom": {"bloom": 0.1, "bloom_sigma_px": 3.0},
    "white balance": {"white_balance": (1.2, 1.0, 1.0)},
    "mosaic": {"mosaic": "rggb"},
    "shot noise": {"shot_noise": True},
    "dark current": {"dark_current_e_s": 2e5},
    "prnu": {"prnu": 0.05},
    "dsnu": {"dsnu_e": 50.0},
    "hot pixels": {"hot": 0.05, "hot_rate_e_s": 1e6},
    "dead pixels": {"dead": 0.05},
    "read noise": {"read_noise_e": 20.0},
    "quantization": {"bits": 8},
    "full well": {"full_well_e": 2000.0},
    "jpeg": {"jpeg_quality": 50},
}


@pytest.mark.parametrize("stage", list(STAGES))
def test_each_stage_alone_changes_the_picture(stage: str) -> None:
    light = scene()
    changed = picture(light, replace(PLAIN, **STAGES[stage]))  # type: ignore[arg-type]
    assert (changed != picture(light, PLAIN)).mean() > 0.005
    assert changed.shape == light.shape
    assert changed.dtype == np.uint8


def test_demosaicing_and_color_matrix_change_what_they_work_on() -> None:
    light = scene()
    behind = replace(PLAIN, mosaic="rggb")
    malvar, bilinear = picture(light, behind), picture(light, replace(behind, demosaic="bilinear"))
    assert (malvar != bilinear).any()
    # Texture without color is what its gradients are made for.
    gray = np.random.default_rng(2).uniform(5.0, 25.0, (48, 64, 1)).astype(np.float32)
    gray = np.repeat(gray, 3, axis=2)
    exact = shown(gray, PLAIN)
    errors = [
        np.abs(picture(gray, replace(behind, demosaic=method)) - exact).mean()
        for method in ("malvar", "bilinear")
    ]
    assert errors[0] < 0.8 * errors[1]
    noisy = replace(behind, shot_noise=True)
    mixed = replace(noisy, color_matrix=FULL.color_matrix)
    assert (picture(light, noisy) != picture(light, mixed)).any()


def test_a_clean_picture_is_what_noise_is_added_to() -> None:
    light = np.full((96, 96, 3), 4.0, np.float32)
    # Bright enough that no pixel is clipped; a linear part of the tone curve.
    noisy = replace(FULL, jpeg_quality=0, dead=0.0, hot=0.0, dark_current_e_s=0.0)
    taken = take(light, camera(96, 96), noisy, 0)
    assert taken.clean is not None
    again = take(light, camera(96, 96), replace(noisy, noise_seed=5, pattern_seed=6), 0)
    np.testing.assert_array_equal(taken.clean, again.clean)
    assert (taken.picture != again.picture).mean() > 0.5
    mean = np.mean([take(light, camera(96, 96), noisy, i).picture for i in range(16)], axis=0)
    inside = slice(8, -8)
    difference = (mean - taken.clean)[inside, inside]
    assert abs(difference.mean()) < 0.5
    assert (
        np.abs(take(light, camera(96, 96), noisy, 0).picture.astype(float) - taken.clean).std() > 1
    )


def test_raw_numbers_are_those_the_picture_is_made_of() -> None:
    taken = take(scene(), camera(64, 48), replace(FULL, jpeg_quality=0), 3)
    assert taken.raw is not None
    assert taken.raw.dtype == np.uint16
    assert taken.raw.shape == (48, 64)
    assert 64 <= np.median(taken.raw) < 4096
    assert take(scene(), camera(64, 48), replace(FULL, mosaic="none"), 3).raw is None


def test_automatic_exposure_shows_gray_as_gray_by_time_first() -> None:
    auto = replace(
        PLAIN,
        rule="auto",
        time_s=0.0,
        iso=0.0,
        time_range_s=(1e-5, 1e-2),
        iso_range=(200.0, 3200.0),
    )
    for level in (0.5, 5.0, 50.0, 5000.0):
        light = scene() * np.float32(level / 10.0)
        time_s, iso = exposure(light, auto)
        luminance = light @ np.array([0.2126, 0.7152, 0.0722])
        ev = take(light, camera(64, 48), auto, 0).exposure_ev
        metered = np.exp(np.log(luminance).mean()) * 2.0**ev
        limited = (time_s, iso) in ((1e-5, 200.0), (1e-2, 3200.0))
        assert limited or metered == pytest.approx(0.18, rel=0.006), "to 1/64 EV"
        assert iso == 200.0 or time_s == 1e-2
    top = replace(auto, percentile=95.0, target=0.9)
    light = scene()
    luminance = light @ np.array([0.2126, 0.7152, 0.0722])
    ev = take(light, camera(64, 48), top, 0).exposure_ev
    assert np.percentile(luminance, 95) * 2.0**ev == pytest.approx(0.9, rel=0.006)
    # In the dark, the longest; what is black does not count.
    assert exposure(np.zeros((4, 4, 3), np.float32), auto) == (1e-2, 3200.0)
    assert exposure(np.zeros((4, 4, 3), np.float32), top) == (1e-2, 3200.0)
    half = light.copy()
    half[:24] = 0.0
    assert exposure(half, auto) == exposure(half[24:], auto)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2), (3, 5), (4, 8192)])
@pytest.mark.parametrize("light", [0.0, 1e-6, 1e9])
def test_any_shape_and_any_light_make_a_picture(shape: tuple[int, int], light: float) -> None:
    rgb = np.full((*shape, 3), light, np.float32)
    taken = take(rgb, camera(shape[1], shape[0]), FULL, 0)
    assert taken.picture.shape == (*shape, 3)
    assert taken.clean is not None
    if light == 1e9:
        assert taken.clean.min() == 255
    elif light == 0.0:
        assert taken.clean.max() == 0
    for iso in (1e-2, 1e6):
        picture(rgb, replace(FULL, iso=iso))


def test_radiance_stays_what_it_was() -> None:
    light = scene()
    before = light.copy()
    # Not by a flag: numba would compile all anew for arrays that have it.
    take(light, camera(64, 48), FULL, 0)
    np.testing.assert_array_equal(light, before)


@pytest.mark.invariant
def test_the_picture_is_the_same_on_any_number_of_threads_and_in_any_order() -> None:
    light = scene(97, 131)
    seen = camera(131, 97)
    first = [take(light, seen, FULL, sample) for sample in (0, 1, 2)]
    with at_most(1):
        sensor.pattern.cache_clear()
        again = [take(light, seen, FULL, sample) for sample in (2, 1, 0)][::-1]
    for one, other in zip(first, again, strict=True):
        assert one.picture.tobytes() == other.picture.tobytes()
        assert one.clean is not None
        assert other.clean is not None
        assert one.clean.tobytes() == other.clean.tobytes()
        assert one.record == other.record
    assert first[0].picture.tobytes() != first[1].picture.tobytes()
