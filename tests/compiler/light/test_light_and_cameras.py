"""Skies have the irradiance asked for, suns and cameras point where they should."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

from scenec.compiler.emit.cameras import HALF_TURN
from scenec.compiler.emit.lights import _pointing_from
from scenec.compiler.geometry.poses import compose, from_euler, from_quaternion, look_at
from scenec.compiler.light import clear_sky as skies
from scenec.compiler.light.clear_sky import ClearSky, clear_sky
from scenec.compiler.light.latlong import directions, horizontal_irradiance, luminance
from scenec.compiler.scene.exposure import incident_exposure
from scenec.compiler.scene.light import SunDisc

COLORS = tuple(
    np.array(c) for c in [(0.23, 0.42, 0.9), (0.72, 0.82, 0.95), (0.3, 0.26, 0.22), (600, 500, 400)]
)


def test_the_picture_looks_where_usd_says():
    # USD's lat-long on a Z-up stage: top +Z, +X at u = 0.25, -Y in the middle, seam at +Y.
    to = directions(256)
    assert np.allclose(to[0].mean(axis=0), [0, 0, 1], atol=1e-2)
    assert np.allclose(to[128, 128], [1, 0, 0], atol=0.02)
    assert np.allclose(to[128, 256], [0, -1, 0], atol=0.02)
    assert np.allclose(to[128, 0], [0, 1, 0], atol=0.02)
    assert np.allclose(np.linalg.norm(to, axis=-1), 1.0)


def test_a_sky_of_radiance_one_gives_pi_on_level_ground():
    for height in (2, 16, 128):
        assert np.allclose(horizontal_irradiance(np.ones((height, 2 * height, 3))), np.pi)


def test_the_lower_half_of_a_picture_gives_level_ground_nothing():
    picture = np.zeros((64, 128, 3))
    picture[32:] = 5.0
    assert horizontal_irradiance(picture).max() == 0.0


@pytest.mark.parametrize("height", [8, 64, 256])
@pytest.mark.parametrize("elevation", [-5.0, 0.0, 3.0, 45.0, 90.0])
def test_a_clear_sky_has_its_irradiance_and_is_finite_and_positive(height, elevation):
    angle = np.radians(elevation)
    picture = clear_sky(height, (np.cos(angle), 0.0, np.sin(angle)), 150.0, *COLORS)
    assert np.isfinite(picture).all()
    assert picture.min() >= 0.0
    assert luminance(horizontal_irradiance(picture)) == pytest.approx(150.0, rel=1e-5)


def test_the_brightest_part_of_a_clear_sky_is_at_the_sun():
    sun = SunDisc(*(np.array([v]) for v in (120.0, 35.0, 1000.0, 0.53)), color=np.ones((1, 3)))
    to_sun = sun.direction(0)
    picture = clear_sky(128, to_sun, 150.0, *COLORS)
    brightest = np.unravel_index(luminance(picture).argmax(), picture.shape[:2])
    assert directions(128)[brightest] @ np.array(to_sun) > np.cos(np.radians(2.0))
    # A compass bearing of 120 degrees is south-east: +x, -y.
    assert to_sun[0] > 0 > to_sun[1]
    assert to_sun[2] == pytest.approx(np.sin(np.radians(35)))


def test_a_distant_light_shines_away_from_the_sun():
    for to_light in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-0.6, 0.0, 0.8], [0.48, 0.64, -0.6]):
        matrix = _pointing_from(np.array(to_light))
        assert np.allclose(matrix.TransformDir(Gf.Vec3d(0, 0, -1)), -np.array(to_light))
        assert matrix.GetDeterminant() == pytest.approx(1.0)


def test_an_incident_meter_shows_a_white_level_surface_at_one():
    irradiance = np.array([1e-3, 10.0, 850.0, 1e5])
    shown = irradiance / np.pi * 2.0 ** incident_exposure(irradiance)
    assert np.allclose(shown, 1.0, rtol=2 ** (1 / 128) - 1)
    assert incident_exposure(np.zeros(1))[0] == 0.0


@pytest.mark.parametrize("target", [(9, 3, -2), (1, 2, 50), (1, 2, -50), (1, 2, 3)])
def test_a_camera_looks_at_its_target_with_the_horizon_level(target):
    position = np.array([1.0, 2.0, 3.0])
    pose = look_at(position, np.array(target, float), 0.0)
    rotation = pose[:3, :3]
    assert np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    seen = rotation.T @ (np.array(target) - position)
    assert np.allclose(seen[:2], 0.0, atol=1e-12)
    assert seen[2] >= 0
    assert rotation[2, 0] == pytest.approx(0.0)


def test_up_is_up_in_the_picture():
    pose = look_at(np.zeros(3), np.array([0.0, 10.0, 0.0]), 0.0)
    assert (pose[:3, :3].T @ np.array([0, 0, 1.0]))[1] < 0
    assert (pose[:3, :3].T @ np.array([1.0, 0, 0]))[0] > 0


def test_roll_turns_the_picture_about_its_middle():
    level = look_at(np.zeros(3), np.array([0.0, 10.0, 0.0]), 0.0)
    rolled = look_at(np.zeros(3), np.array([0.0, 10.0, 0.0]), 90.0)
    assert np.allclose(rolled[:3, 2], level[:3, 2])
    # Rolled clockwise by a quarter, its right side points down.
    assert np.allclose(rolled[:3, 0], [0, 0, -1], atol=1e-12)


def test_quaternions_give_the_matrices_of_an_independent_library():
    rng = np.random.default_rng(0)
    for _ in range(50):
        q = rng.normal(size=4)
        pose = from_quaternion(np.array([1.0, 2.0, 3.0]), q)
        unit = q / np.linalg.norm(q)
        expected = np.array(Gf.Matrix3d(Gf.Quatd(*unit.tolist()))).T
        assert np.allclose(pose[:3, :3], expected, atol=1e-14)
        assert pose[:3, 3].tolist() == [1, 2, 3]


def test_euler_angles_turn_about_x_then_y_then_z():
    degrees = (20.0, -50.0, 110.0)
    expected = np.eye(3)
    for axis, angle in enumerate(degrees):
        vector = Gf.Vec3d(*np.eye(3)[axis].tolist())
        expected = np.array(Gf.Matrix3d(Gf.Rotation(vector, angle))).T @ expected
    assert np.allclose(from_euler((0, 0, 0), degrees)[:3, :3], expected, atol=1e-14)


def test_composing_matrices_is_multiplying_them():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 4, 4))
    assert np.allclose(compose(a, b), a @ b, atol=1e-14)


def test_the_half_turn_relates_opencv_and_usd_cameras():
    stage = Usd.Stage.CreateInMemory()
    camera = UsdGeom.Camera.Define(stage, "/c")
    pose = look_at(np.array([1.0, -2.0, 3.0]), np.array([4.0, 4.0, 0.0]), 12.0)
    camera.AddTransformOp().Set(Gf.Matrix4d(*(pose * HALF_TURN).T.ravel().tolist()))
    frustum = camera.GetCamera().frustum
    assert np.allclose(frustum.ComputeViewDirection(), pose[:3, 2])
    assert np.allclose(frustum.ComputeUpVector(), -pose[:3, 1])
    assert np.allclose(frustum.GetPosition(), pose[:3, 3])


def test_samples_under_one_sky_share_a_picture_that_is_made_once(monkeypatch):
    made = []

    def counted(*arguments):
        made.append(arguments)
        return clear_sky(*arguments)

    monkeypatch.setattr(skies, "clear_sky", counted)
    irradiance = np.tile([50.0, 80.0], 20)
    zenith, horizon, ground = (
        np.tile(color, (40, 1)) for color in ([0.1, 0.3, 0.9], [0.4, 0.6, 0.9], [0.3] * 3)
    )
    plan = ClearSky(
        resolution=8, irradiance=irradiance, zenith_color=zenith, horizon_color=horizon,
        ground_color=ground,
    )  # fmt: skip
    sky, _, _ = plan.build(None, 40)
    assert len(made) == 2
    assert list(sky.pictures) == ["sky_0000.exr", "sky_0001.exr"]
    assert sky.texture == ("sky_0000.exr", "sky_0001.exr") * 20
