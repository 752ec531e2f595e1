"""Clouds: how much they cover, what comes through, what they scatter, and that no seam shows."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from scenec.compiler.cfg.load import load
from scenec.compiler.light.build import build_light
from scenec.compiler.light.clear_sky import ClearSky
from scenec.compiler.light.cloud_fields import (
    CirrusClouds,
    CirrusField,
    Clouds,
    CumulusClouds,
    CumulusField,
    billow_tile,
    no_cirrus,
    no_cumulus,
)
from scenec.compiler.light.cloud_rays import Shine, _scattered, beam_left, through_cumulus
from scenec.compiler.light.clouds import draw_clouds
from scenec.compiler.light.latlong import directions
from scenec.compiler.light.overcast import transmitted
from scenec.compiler.light.plan import LightPlan
from scenec.compiler.scene.light import SunDisc
from scenec.schemas.errors import CfgError
from scenec.schemas.threads import at_most
from scenec.testing.small import small_cfg

UP = np.array([0.0, 0.0, 1.0])
GROUND = np.array([0.2, 0.2, 0.2])


def numbers(*values: float) -> np.ndarray:
    return np.array(values, np.float64)


def cumulus_plan(coverage=0.4, samples=1, **more) -> CumulusClouds:
    drawn = {"coverage": coverage, "optical_depth": 40.0, "base_m": 1200.0, "thickness_m": 900.0}
    plan = CumulusClouds(
        key=5, size_m=1800.0, offset_m=np.zeros((samples, 2)),
        **{key: np.full(samples, value) for key, value in drawn.items()},
    )  # fmt: skip
    return replace(plan, **more)


def cirrus_plan(samples=1, **more) -> CirrusClouds:
    drawn = {"coverage": 0.6, "optical_depth": 0.5, "height_m": 9000.0, "bearing_deg": 30.0}
    plan = CirrusClouds(
        key=6, size_m=4000.0, offset_m=np.zeros((samples, 2)),
        **{key: np.full(samples, value) for key, value in drawn.items()},
    )  # fmt: skip
    return replace(plan, **more)


@pytest.fixture(scope="module")
def heaps():
    return CumulusField(cumulus_plan()).at(0)


@pytest.fixture(scope="module")
def streaks():
    return CirrusField(cirrus_plan()).at(0)


def drawn(cumulus, cirrus, turn=0.0, to_sun=(0.0, -0.6, 0.8), height=64) -> np.ndarray:
    """Clouds over an even blue sky."""
    sky = np.broadcast_to([20.0, 40.0, 80.0], (height, 2 * height, 3)).copy()
    beam = numbers(900.0, 850.0, 800.0)
    draw_clouds(sky, turn, np.array(to_sun), beam, GROUND, cumulus, cirrus)
    return sky


def light_plan(clouds: Clouds, samples=1, elevation=50.0) -> LightPlan:
    sun = SunDisc(
        np.full(samples, 90.0), np.full(samples, elevation), np.full(samples, 1000.0),
        np.full(samples, 0.53), np.ones((samples, 3)),
    )  # fmt: skip
    zenith, horizon, ground = (np.full((samples, 3), value) for value in (0.5, 0.7, 0.2))
    sky = ClearSky(
        resolution=16, irradiance=np.full(samples, 100.0), zenith_color=zenith,
        horizon_color=horizon, ground_color=ground,
    )  # fmt: skip
    return LightPlan(sun, sky, clouds=clouds)


@pytest.mark.parametrize("coverage", [0.2, 0.7])
def test_cumulus_lies_over_as_much_ground_as_is_asked_for(coverage: float):
    """Beams straight down at random places; billows take or add a little."""
    layer = CumulusField(cumulus_plan(coverage)).at(0)
    places = np.random.default_rng(3).uniform(-30000.0, 30000.0, (2000, 2))
    hit = 0
    for east, north in places:
        there = layer._replace(pattern=layer.pattern._replace(east_m=east, north_m=north))
        hit += beam_left(UP, 0.0, 0.0, there, no_cirrus()) < 0.95
    assert hit / len(places) == pytest.approx(coverage, abs=0.08)


def test_the_tallest_cumulus_has_the_optical_depth_that_is_asked_for():
    """Everywhere a cloud of full height, but for what billows take at its top and its base."""
    layer = CumulusField(cumulus_plan(1.0, optical_depth=numbers(3.0))).at(0)
    layer = layer._replace(pattern=layer.pattern._replace(threshold=-9.0))
    assert -np.log(beam_left(UP, 0.0, 0.0, layer, no_cirrus())) == pytest.approx(3.0, rel=0.2)


@pytest.mark.parametrize("layer", ["cumulus", "cirrus"])
def test_a_layer_that_is_moved_is_the_same_layer_elsewhere(layer: str):
    """Pattern and billows alike: beams through it and rays at it find what they found."""
    move = numbers(2817.0, -911.0)
    cumulus, cirrus = no_cumulus(), no_cirrus()
    moved_cumulus, moved_cirrus = cumulus, cirrus
    if layer == "cumulus":
        cumulus = CumulusField(plan := cumulus_plan(optical_depth=numbers(4.0))).at(0)
        moved_cumulus = CumulusField(replace(plan, offset_m=move[None])).at(0)
    else:
        cirrus = CirrusField(cirrus_plan()).at(0)
        moved_cirrus = CirrusField(cirrus_plan(offset_m=move[None])).at(0)
    places = np.random.default_rng(4).uniform(-9000.0, 9000.0, (300, 2))
    way = numbers(0.36, -0.48, 0.8)
    still = np.array([beam_left(way, *place, cumulus, cirrus) for place in places])
    moved = np.array([beam_left(way, *p, moved_cumulus, moved_cirrus) for p in places + move])
    assert np.ptp(still) > 0.1
    assert moved == pytest.approx(still, abs=1e-5)


@pytest.mark.parametrize(("depth", "mu"), [(5.0, 0.6), (20.0, 1.0), (20.0, 0.3), (80.0, 0.6)])
def test_a_slab_throws_back_what_a_slab_does(depth: float, mu: float):
    """Straight up from a slab, against its reflectance by Eddington's approximation over pi."""
    t = (np.arange(2000) + 0.5) / 2000 * depth
    source = np.array([_scattered(a / mu, (depth - a) / mu, a, -mu) for a in t])
    up = (source * np.exp(-t)).sum() * depth / 2000
    reflected = mu * (1.0 - transmitted(numbers(depth), numbers(mu))[0][0])
    assert np.pi * up == pytest.approx(reflected, rel=0.35)


def test_a_ray_and_a_beam_find_the_same_depth(heaps):
    """Two quadratures of one cloud, wherever it is not opaque."""
    shine = Shine(UP, np.ones(3), np.ones(3), np.ones(3))
    to = directions(24)[2:9, ::6].reshape(-1, 3)
    thin = heaps._replace(extinction=heaps.extinction * 0.05)
    out = np.empty(3)
    seen = np.array([through_cumulus(thin, shine, way, 1e-3, out)[0] for way in to])
    beams = np.array([beam_left(way, 0.0, 0.0, thin, no_cirrus()) for way in to])
    assert beams.min() < 0.8
    assert np.abs(seen - beams).max() < 0.05


def test_without_clouds_the_sky_stays_as_it_is(heaps):
    assert (drawn(no_cumulus(), no_cirrus()) == [20.0, 40.0, 80.0]).all()
    none = heaps._replace(extinction=0.0)
    assert (drawn(none, no_cirrus()) == [20.0, 40.0, 80.0]).all()


def test_a_picture_has_clouds_and_no_seam_and_only_light(heaps, streaks):
    picture = drawn(heaps, streaks)
    sky = picture[:32]
    assert np.isfinite(picture).all()
    assert (picture >= 0.0).all()
    assert len(np.unique(sky[..., 0])) > 1000
    # Across the seam, around the zenith and at the horizon no more changes than elsewhere.
    across = np.abs(np.diff(sky, axis=1)).max()
    assert np.abs(sky[:, 0] - sky[:, -1]).max() <= across
    assert np.abs(np.diff(sky[0], axis=0)).max() <= across
    # Toward the horizon they fade into the air before them.
    shown = np.abs(sky - [20.0, 40.0, 80.0]).mean(axis=(1, 2))
    assert shown[-1] < 0.5 * shown[16:28].max()


def test_clouds_stay_where_they_are_when_the_picture_is_turned(heaps, streaks):
    """A quarter clockwise: what was at the bearing of 90 degrees is in the picture's north."""
    as_is = drawn(heaps, streaks)
    turned = drawn(heaps, streaks, turn=0.5 * np.pi)
    assert np.roll(turned, 32, axis=1)[:32] == pytest.approx(as_is[:32], rel=1e-6)


def test_threads_do_not_change_a_bit(heaps, streaks):
    with at_most(1):
        alone = drawn(heaps, streaks, height=32)
    assert (alone == drawn(heaps, streaks, height=32)).all()


def test_the_tile_of_billows_repeats_without_a_seam():
    tile = billow_tile(1)
    for axis in range(3):
        within = np.abs(np.diff(tile, axis=axis)).max()
        ends = np.abs(np.take(tile, 0, axis) - np.take(tile, -1, axis)).max()
        assert ends <= within * (1.0 + 1e-5)


def test_the_sun_loses_what_is_before_it_and_samples_alike_share_a_picture():
    samples = 4
    moved = np.zeros((samples, 2))
    moved[2:, 0] = [700.0, 5000.0]
    clouds = Clouds(
        resolution=16, cumulus=cumulus_plan(0.6, samples, offset_m=moved),
        cirrus=cirrus_plan(samples),
    )  # fmt: skip
    light = build_light(light_plan(clouds, samples), samples, True, False)
    left = np.array(light.facts["clouds"]["sun_transmittance"])
    assert light.sun.irradiance == pytest.approx(1000.0 * left)
    assert left[0] == left[1]
    assert set(left) == {0.0, 1.0}
    assert light.sky.texture[0] == light.sky.texture[1]
    assert len(light.sky.pictures) == 3
    # The larger picture is the clouds'; of the sky without them, the sky's.
    assert {len(p) for p in light.sky.pictures.values()} == {16}


def test_drawn_light_depends_on_the_batch_and_the_cfg_has_its_defaults(tmp_path):
    from scenec.compiler.draw import draw

    cfg = small_cfg(samples=3)
    cfg["light"]["clouds"] = {"cumulus": {}, "cirrus": {"bearing_deg": 10}}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(cfg))
    spec = load(path)
    plans = [draw(spec, 1, batch).light.clouds for batch in (0, 1)]
    for plan in plans:
        assert plan.resolution == 768
        assert plan.cumulus.coverage == pytest.approx(0.35)
        assert plan.cumulus.offset_m.shape == (3, 2)
        assert plan.cirrus.bearing_deg == pytest.approx(10.0)
    assert plans[0].cumulus.key != plans[1].cumulus.key


@pytest.mark.parametrize(
    "sky",
    [{"type": "none"}, {"type": "overcast"}, {"type": "atmosphere", "planet": "mars"}],
)
def test_clouds_need_a_sky_that_can_have_them(tmp_path, sky):
    cfg = small_cfg()
    cfg["light"] = {"sky": sky | {"labels": cfg["light"]["sky"]["labels"]}, "clouds": {}}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(cfg))
    with pytest.raises(CfgError, match="/light/clouds: clouds need a sky that is made"):
        load(path)


def test_the_sky_that_is_there_when_none_is_said_can_have_clouds(tmp_path):
    cfg = small_cfg(outputs=["depth"], labels={})
    cfg["light"] = {"clouds": {}}
    for user in (*cfg["terrain"]["ground"], *cfg["objects"].values()):
        user.pop("labels", None)
    path = tmp_path / "a.json"
    path.write_text(json.dumps(cfg))
    assert load(path).cfg["light"]["sky"]["type"] == "clear"
