"""Sky, suns and the tone curve are drawn once, by shared code, where the conventions say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import Radiance
from scenec.backends.picture.compose import compose, disc_fraction
from scenec.backends.picture.sky import Sky, combine, load_picture, lookup, texel_directions
from scenec.backends.stage.scene import Dome, RenderScene
from scenec.backends.testing import scenes as ms
from scenec.schemas.errors import StageError
from scenec.schemas.picture import SHOULDER, develop, srgb_encode, tone_map


def only_sky(scene: RenderScene) -> NDArray:
    camera = scene.cameras[0][0]
    h, w = camera.height, camera.width
    nothing = Radiance(np.zeros((2, h, w, 3), np.float32), np.zeros((h, w), np.float32), 2)
    return compose(nothing, scene, camera, 0).rgb.astype(float)


@pytest.mark.parametrize(
    ("direction", "u", "v"),
    [((1, 0, 0), 0.25, 0.5), ((0, -1, 0), 0.5, 0.5), ((-1, 0, 0), 0.75, 0.5)],
)
def test_on_a_z_up_stage_x_is_at_a_quarter_and_minus_y_in_the_middle(direction, u, v):
    ramp = np.broadcast_to(((np.arange(64) + 0.5) / 64)[None, :, None], (32, 64, 3))
    sky = Sky(np.ascontiguousarray(ramp, np.float32), ms.DOME_Z_UP)
    assert lookup(sky, np.array([direction], float))[0, 0] == pytest.approx(u, abs=1e-6)
    rows = np.broadcast_to(((np.arange(32) + 0.5) / 32)[:, None, None], (32, 64, 3))
    sky = Sky(np.ascontiguousarray(rows, np.float32), ms.DOME_Z_UP)
    assert lookup(sky, np.array([direction], float))[0, 0] == pytest.approx(v, abs=1e-6)
    assert lookup(sky, np.array([[1e-4, 0, 1.0]]))[0, 0] == pytest.approx(0.5 / 32, abs=1e-4)


def test_the_seam_is_at_plus_y_and_wraps_without_a_step():
    rng = np.random.default_rng(0)
    sky = Sky(rng.uniform(0, 1, (8, 16, 3)).astype(np.float32), ms.DOME_Z_UP)
    left, right = lookup(sky, np.array([[-1e-7, 1.0, 0.3], [1e-7, 1.0, 0.3]]))
    np.testing.assert_allclose(left, right, atol=1e-5)


def test_texel_centers_return_their_texels():
    rng = np.random.default_rng(1)
    picture = rng.uniform(0, 1, (6, 10, 3)).astype(np.float32)
    directions = texel_directions(6, 10).reshape(-1, 3)
    got = lookup(Sky(picture, np.eye(3)), directions).reshape(6, 10, 3)
    np.testing.assert_allclose(got, picture, atol=1e-6)


def test_domes_add_up_in_any_frame(tmp_path: Path):
    # A smooth picture, so that looking the smaller one up at the larger's texels loses little.
    d = texel_directions(64, 128)
    a = ms.write_latlong(tmp_path / "a.exr", np.repeat(2 + d[..., :1], 3, axis=2))
    d = texel_directions(32, 64)
    b = ms.write_latlong(tmp_path / "b.exr", np.repeat(2 + d[..., 1:2], 3, axis=2))
    turned = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    domes = (
        Dome(b, np.ones(3), turned),
        Dome(a, np.full(3, 3.0), ms.DOME_Z_UP),
        Dome(None, np.full(3, 0.5), np.eye(3)),
    )
    sky = combine(domes)
    assert sky is not None
    w = np.random.default_rng(2).normal(size=(400, 3))
    w /= np.linalg.norm(w, axis=1)[:, None]
    expected = 3 * (2 + (w @ ms.DOME_Z_UP)[:, 0]) + (2 + (w @ turned)[:, 1]) + 0.5
    np.testing.assert_allclose(lookup(sky, w)[:, 0], expected, atol=0.02)


@pytest.mark.parametrize("diameter_deg", [0.53, 3.0, 10.0])
def test_the_suns_disc_in_the_picture_carries_its_irradiance(diameter_deg):
    # The sum over pixels of radiance * solid angle * cosine to the sun is E.
    camera = ms.look_at((0, 0, 0), (1, 0.2, 0.5), 201, 151, 20)
    sun = ms.sun(np.degrees(np.arctan2(0.5, np.hypot(1, 0.2))), np.degrees(np.arctan2(0.2, 1)))
    sun = type(sun)(sun.to_light, sun.irradiance, float(np.radians(diameter_deg)))
    scene = ms.scene([ms.mesh(*ms.plane())], cameras=[camera], lights=[sun])
    rgb = only_sky(scene)[..., 0].ravel()
    d = camera_rays(camera).directions
    length = np.linalg.norm(d, axis=1)
    solid_angle = 1 / (camera.intrinsics[0, 0] * camera.intrinsics[1, 1] * length**3)
    total = (rgb * solid_angle * (d @ sun.to_light) / length).sum()
    assert total == pytest.approx(1000.0, rel=0.01)


def test_the_disc_is_centered_on_the_sun():
    camera = ms.look_at((0, 0, 0), (1, 0, 0), 101, 101, 10)
    sun = ms.sun(1.0, -2.0, diameter_deg=1.0)
    index = np.arange(101 * 101)
    near, fraction = disc_fraction(sun, camera, camera_rays(camera).directions, index)
    v, u = np.divmod(index[near], 101)
    x = camera.camera_to_world[:3, :3].T @ sun.to_light
    expected = camera.intrinsics @ (x / x[2])
    assert np.average(u + 0.5, weights=fraction) == pytest.approx(expected[0], abs=0.05)
    assert np.average(v + 0.5, weights=fraction) == pytest.approx(expected[1], abs=0.05)


def test_a_sun_behind_the_camera_is_not_drawn():
    camera = ms.look_at((0, 0, 0), (1, 0, 0), 40, 30, 100)
    scene = ms.scene(
        [ms.mesh(*ms.plane())], cameras=[camera], lights=[ms.sun(0, 180, diameter_deg=10)]
    )
    assert np.all(only_sky(scene) == 0.0)


def test_sky_fills_what_surfaces_leave_open_and_nothing_else():
    camera = ms.look_at((0, 0, 0), (1, 0, 0), 4, 1)
    scene = ms.scene([ms.mesh(*ms.plane())], cameras=[camera], lights=[ms.dome(8.0)])
    coverage = np.array([[0.0, 0.25, 0.75, 1.0]], np.float32)
    halves = np.stack([np.full((1, 4, 3), 1.0), np.full((1, 4, 3), 3.0)]).astype(np.float32)
    rgb = compose(Radiance(halves, coverage, 4), scene, camera, 0).rgb
    np.testing.assert_allclose(rgb[0, :, 0], 2.0 + 8.0 * (1 - coverage[0]), rtol=1e-6)


def test_the_estimated_error_is_the_error_of_the_mean():
    rng = np.random.default_rng(3)
    camera = ms.look_at((0, 0, 0), (1, 0, 0), 200, 150)
    scene = ms.scene([ms.mesh(*ms.plane())], cameras=[camera])
    halves = (5.0 + rng.normal(0, 0.4, (2, 150, 200, 3))).astype(np.float32)
    picture = compose(Radiance(halves, np.ones((150, 200), np.float32), 2), scene, camera, 0)
    true = np.sqrt(((halves.mean(axis=0) - 5.0) ** 2).mean()) / 5.0
    assert picture.noise.relative_rms == pytest.approx(true, rel=0.02)
    assert picture.noise.relative_mse == pytest.approx(true**2 / 1.01, rel=0.1)


def test_a_denoised_picture_takes_the_place_of_the_mean_before_the_sky_and_keeps_the_estimate():
    camera = ms.look_at((0, 0, 0), (1, 0, 0), 4, 1)
    scene = ms.scene([ms.mesh(*ms.plane())], cameras=[camera], lights=[ms.dome(8.0)])
    coverage = np.array([[0.0, 0.25, 0.75, 1.0]], np.float32)
    halves = np.stack([np.full((1, 4, 3), 1.0), np.full((1, 4, 3), 3.0)]).astype(np.float32)
    smooth = np.full((1, 4, 3), 5.0, np.float32)
    noisy = compose(Radiance(halves, coverage, 4), scene, camera, 0)
    picture = compose(Radiance(halves, coverage, 4, denoised=smooth), scene, camera, 0)
    np.testing.assert_allclose(picture.rgb[0, :, 0], 5.0 + 8.0 * (1 - coverage[0]), rtol=1e-6)
    # |A - B| / 2 over the mean: 1 / 2.
    assert picture.noise.relative_rms == noisy.noise.relative_rms == pytest.approx(0.5)


def test_a_missing_or_broken_sky_picture_is_said_with_its_name(tmp_path: Path):
    with pytest.raises(StageError, match=r"gone\.exr.*missing"):
        load_picture(tmp_path / "gone.exr")
    broken = tmp_path / "broken.exr"
    broken.write_bytes(b"no exr")
    with pytest.raises(StageError, match=r"broken\.exr"):
        load_picture(broken)
    text = tmp_path / "text.png"
    text.write_text("no png")
    with pytest.raises(StageError, match=r"text\.png"):
        load_picture(text)


@given(st.floats(0, 1e6), st.floats(0, 1e6))
def test_the_tone_curve_never_turns_around_and_stays_below_white(a, b):
    low, high = tone_map(np.array(sorted((a, b))))
    assert 0 <= low <= high <= 1


def test_the_tone_curve_is_linear_to_its_shoulder_and_smooth_across_it():
    x = np.linspace(0, SHOULDER, 50)
    np.testing.assert_array_equal(tone_map(x), x)
    h = 1e-6
    slope = (tone_map(np.array([SHOULDER + h])) - SHOULDER) / h
    assert slope[0] == pytest.approx(1.0, abs=1e-5)


def test_exposure_is_in_stops_and_broken_pixels_are_black():
    np.testing.assert_allclose(tone_map(np.array([0.1]), 2.0), 0.4)
    assert np.all(develop(np.array([np.nan, np.inf, -1.0])) == 0)


def test_srgb_has_its_published_values():
    # IEC 61966-2-1: 18 % gray is 118 of 255, and the two branches meet.
    assert round(255 * float(srgb_encode(np.array(0.18)))) == 118
    assert srgb_encode(np.array(0.0031308)) == pytest.approx(0.04045, abs=2e-5)
    assert srgb_encode(np.array(1.0)) == pytest.approx(1.0)
