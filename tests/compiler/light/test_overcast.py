"""Overcast skies: the CIE's distribution, and how much light comes through a cloud."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from scenec.compiler.cfg.load import load
from scenec.compiler.light.build import build_light, without_dark
from scenec.compiler.light.latlong import directions, horizontal_irradiance, luminance
from scenec.compiler.light.overcast import OvercastSky, overcast_sky, reflected, transmitted
from scenec.compiler.light.plan import LightPlan
from scenec.compiler.scene.light import SunDisc
from scenec.schemas.errors import CfgError
from scenec.testing import photons
from scenec.testing.small import small_cfg

GRAY = np.array([1.0, 1.0, 1.0])


def made(depth=30.0, elevation=50.0, albedo=0.2, **more) -> tuple[LightPlan, int]:
    depths = np.atleast_1d(np.asarray(depth, float))
    n = len(depths)
    sun = SunDisc(
        np.full(n, 90.0), np.full(n, elevation), np.full(n, 1000.0), np.full(n, 0.53),
        np.ones((n, 3)),
    )  # fmt: skip
    ground = np.full((n, 3), albedo)
    sky = OvercastSky(
        resolution=32, optical_depth=depths, color=np.ones((n, 3)), ground_color=ground, **more
    )
    return LightPlan(sun, sky), n


def test_the_zenith_is_three_times_as_bright_as_the_horizon_and_gives_seven_ninths_of_pi():
    picture = overcast_sky(256, GRAY, 0.2 * GRAY).astype(np.float64)
    up = directions(256)[..., 2]
    sky = up > 0.0
    zenith = picture[0, 0, 0] * 3.0 / (1.0 + 2.0 * up[0, 0])
    assert picture[sky][:, 1] == pytest.approx(zenith * (1.0 + 2.0 * up[sky]) / 3.0, rel=1e-6)
    # To the horizon goes a third: half a texel of 0.7 degrees below the last row.
    assert picture[127, 0, 0] / picture[0, 0, 0] == pytest.approx(1.0 / 3.0, rel=0.02)
    assert horizontal_irradiance(picture) == pytest.approx(np.ones(3), rel=1e-6)
    assert 7.0 * np.pi / 9.0 * zenith == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize(("depth", "sine"), [(5.0, 0.9), (10.0, 0.3), (30.0, 0.7)])
def test_what_comes_through_is_what_photons_do(depth: float, sine: float):
    rng = np.random.Generator(np.random.Philox(key=7))
    counted = photons.scattered_down(rng, depth, 1.0, 1.0, 0.85, sine)
    total, left = (float(a[0]) for a in transmitted(np.array([depth]), np.array([sine])))
    assert total - left == pytest.approx(counted, rel=0.1)


def test_it_gives_the_daylight_that_is_measured_below_overcast_skies():
    """Krochmann and Seidl (1974): 300 + 21,000 sin(elevation) lux, of 100,000 below a clear sky."""
    for elevation in (30.0, 45.0, 60.0):
        plan, n = made(40.0, elevation)
        measured = (0.3 + 21.0 * np.sin(np.radians(elevation))) / 100.0 * 1000.0
        light = build_light(plan, n, color=True, labels=False)
        assert light.irradiance[0] == pytest.approx(measured, rel=0.2)


def test_the_ground_and_the_cloud_throw_light_to_and_fro():
    dark, bright = (build_light(*made(20.0, albedo=a), True, False) for a in (0.0, 0.8))
    gain = 1.0 / (1.0 - 0.8 * reflected(np.array([20.0]))[0])
    assert bright.irradiance[0] / dark.irradiance[0] == pytest.approx(gain, rel=1e-3)


def test_the_sun_is_left_out_where_none_of_it_comes_through():
    light, _, left_out = without_dark(build_light(*made(30.0), True, False), ())
    assert light.sun is None
    assert left_out == [("light/sun", "no light at every sample")]
    thin = build_light(*made(5.0, 80.0), True, False).sun
    share = np.exp(-5.0 / np.sin(np.radians(80.0)))
    assert thin.irradiance[0] == pytest.approx(1000.0 * share)


def test_samples_that_differ_in_strength_share_a_picture_and_night_is_black():
    plan, n = made([5.0, 30.0, 100.0], albedo=0.0)
    sky = build_light(plan, n, True, False).sky
    assert len(sky.pictures) == 1
    assert (np.diff(sky.intensity) < 0.0).all()
    night = build_light(*made(30.0, -1.0), True, False)
    assert without_dark(night, ())[0].sky is None
    # An irradiance that is given is that of the picture, with no sun at all.
    plan, n = made(irradiance=np.array([120.0]))
    light = build_light(replace(plan, sun=None), n, True, False)
    assert light.irradiance[0] == pytest.approx(120.0, rel=1e-6)
    assert light.sun is None


def test_the_ground_below_is_lit_by_the_sky():
    (picture,) = build_light(*made(albedo=0.5), True, False).sky.pictures.values()
    assert luminance(picture[-1, 0]) == pytest.approx(0.5 / np.pi, rel=1e-3)


@pytest.mark.parametrize(
    ("light", "words"),
    [
        ({"sun": None, "sky": {"type": "overcast"}}, "expected the key irradiance, or a sun"),
        ({"sky": {"type": "overcast", "color": [0, 0, 0]}}, "black cannot be scaled"),
        ({"sky": {"type": "overcast", "optical_depth": 1}}, "1: expected at least 5"),
    ],
)
def test_what_cannot_be_is_a_fault_of_the_cfg(tmp_path, light, words):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(small_cfg() | {"light": light}))
    with pytest.raises(CfgError, match=words):
        load(path)
