"""Shadows of clouds on the land: where they lie, how soft they are, and when there are none."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from test_clouds import cirrus_plan, cumulus_plan, light_plan

from scenec.backends.stage.read import read_stage
from scenec.backends.surface.gobo import passed
from scenec.compiler.compile import compile_cfg
from scenec.compiler.geometry.poses import facing
from scenec.compiler.light import cloud_shadows as shadows
from scenec.compiler.light.build import build_light
from scenec.compiler.light.cloud_fields import (
    CirrusField,
    Clouds,
    Cumulus,
    CumulusField,
    no_cirrus,
    no_cumulus,
)
from scenec.compiler.light.cloud_rays import beam_left
from scenec.compiler.light.cloud_shadows import EVEN, LandBox, _disc, cloud_shadows
from scenec.testing.small import small_cfg

RADIUS = np.radians(0.265)
LAND = LandBox((-1000.0, -800.0, -20.0), (1000.0, 800.0, 60.0), 0.0)


def to_sun(elevation: float, azimuth: float = 120.0) -> np.ndarray:
    e, a = np.radians([elevation, azimuth])
    return np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])


@cache
def heaps(coverage: float) -> Cumulus:
    return CumulusField(cumulus_plan(coverage)).at(0)


def from_disc(place, way, cumulus, cirrus, count=60) -> float:
    """What comes to a place of all of the sun's disc, beam by beam on Vogel's spiral."""
    axes = facing(way)
    k = np.arange(count)
    r, turn = RADIUS * np.sqrt((k + 0.5) / count), k * np.pi * (3.0 - np.sqrt(5.0))
    ways = way + np.outer(r * np.cos(turn), axes[:, 0]) + np.outer(r * np.sin(turn), axes[:, 1])
    total = 0.0
    for one in ways / np.sqrt((ways * ways).sum(axis=1))[:, None]:
        east, north = (place - one * (place[2] / one[2]))[:2]
        total += beam_left(one, east, north, cumulus, cirrus)
    return total / count


def test_shadows_of_a_layer_moved_by_texels_are_the_same_texels_elsewhere():
    up = np.array([0.0, 0.0, 1.0])
    layer = heaps(0.45)
    land = LandBox((-8000.0, -8000.0, -20.0), (8000.0, 8000.0, 60.0), 0.0)
    still = cloud_shadows(up, RADIUS, layer, no_cirrus(), land)
    # East is along the picture's first axis or its second, this way or that.
    east, north = 5.0 * still.texel_m * facing(up)[:2, 0]
    moved = cloud_shadows(
        up, RADIUS,
        layer._replace(pattern=layer.pattern._replace(east_m=east, north_m=north)),
        no_cirrus(), land,
    )  # fmt: skip
    assert moved is not None
    before, after = (made.picture.astype(int) for made in (still, moved))
    assert np.ptp(before) > 20000
    assert np.abs(after[:, 5:] - before[:, :-5]).max() <= 1


@pytest.mark.parametrize(("elevation", "coverage"), [(80.0, 0.45), (40.0, 0.45), (12.0, 0.15)])
def test_shadows_lie_where_beams_from_the_suns_disc_are_stopped(elevation, coverage):
    """At places of any height, against beams to all of the disc: softer by what is stated."""
    layer = heaps(coverage)
    cirrus = CirrusField(cirrus_plan()).at(0)
    way = to_sun(elevation)
    for shift in range(0, 9000, 1000):
        cumulus = layer._replace(pattern=layer.pattern._replace(east_m=float(shift)))
        made = cloud_shadows(way, RADIUS, cumulus, cirrus, LAND)
        if made is not None and 0.3 < made.picture.mean() / 65535.0 < 0.7:
            break
    axes = facing(way)
    rng = np.random.default_rng(2)
    places = rng.uniform(LAND.low, LAND.high, (120, 3))
    at = (places @ axes[:, :2] - made.middle_m) / made.size_m
    height, width = made.picture.shape
    columns = np.floor((at[:, 0] + 0.5) * width).astype(int)
    rows = np.floor((0.5 - at[:, 1]) * height).astype(int)
    found = made.picture[rows, columns] / 65535.0
    true = np.array([from_disc(place, way, cumulus, cirrus) for place in places])
    assert 0.05 < true.mean() < 0.95
    # The nearest texel, and one distance for all of a cloud.
    assert np.abs(found - true).mean() < 0.02
    assert np.corrcoef(found, true)[0, 1] > 0.98


def test_the_middle_has_the_share_that_the_sky_shows():
    """The sky's picture hides the sun where the land's middle lies in shadow."""
    offsets = np.stack([np.linspace(-9000.0, 9000.0, 12), np.zeros(12)], axis=1)
    clouds = Clouds(resolution=8, cumulus=cumulus_plan(0.5, 12, offset_m=offsets))
    land = LandBox((-300.0, -300.0, 0.0), (300.0, 300.0, 20.0), 0.0)
    light = build_light(light_plan(clouds, 12), 12, True, False, land)
    gobo = light.sun.gobo
    middle = np.array(light.facts["clouds"]["sun_transmittance"])
    crossed = np.flatnonzero([bool(name) for name in gobo.texture])
    assert len(crossed) > 3
    for i in crossed:
        picture = gobo.pictures[gobo.texture[i]]
        x, y = (gobo.middle_m[i] / gobo.size_m[i]) * [-1, 1] + 0.5
        row, column = int(y * picture.shape[0]), int(x * picture.shape[1])
        assert picture[row, column] / 65535.0 == pytest.approx(middle[i], abs=0.12)
        assert light.sun.irradiance[i] == 1000.0
        assert picture.max() - picture.min() >= EVEN * 65535.0
    even = np.setdiff1d(np.arange(12), crossed)
    assert len(even)
    assert light.sun.irradiance[even] == pytest.approx(1000.0 * middle[even])
    assert light.facts["clouds"]["shadows"]["texel_m"][even[0]] is None


def test_land_that_has_one_light_has_no_picture():
    """Without cumulus, with coverage 0, below a sheet of it, and where the sun is all but down."""
    layer = heaps(0.45)
    sheet = layer._replace(pattern=layer.pattern._replace(threshold=-9.0))
    cirrus = CirrusField(cirrus_plan()).at(0)
    for cumulus in (no_cumulus(), layer._replace(extinction=0.0), sheet):
        assert cloud_shadows(to_sun(50.0), RADIUS, cumulus, cirrus, LAND) is None
    assert cloud_shadows(to_sun(1.0), RADIUS, layer, cirrus, LAND) is None
    small = LandBox((-1.0, -1.0, 0.0), (1.0, 1.0, 0.0), 0.0)
    made = [
        cloud_shadows(to_sun(50.0, azimuth), RADIUS, layer, no_cirrus(), small)
        for azimuth in range(0, 360, 20)
    ]
    # A sun turns a patch of ground from sun to shade, seldom in between.
    assert sum(one is None for one in made) > 12


@pytest.mark.parametrize("elevation", [2.1, 90.0])
@pytest.mark.parametrize("half", [0.5, 40000.0])
@pytest.mark.parametrize(
    "layer", [(50.0, 10.0, 10.0), (10000.0, 10000.0, 100000.0), (50.0, 10000.0, 30.0)]
)
def test_extremes_are_finite_and_no_larger_than_what_is_allowed(
    monkeypatch, elevation, half, layer
):
    monkeypatch.setattr(shadows, "MOST", 32)
    base, thickness, size = layer
    cumulus = heaps(0.5)
    cumulus = cumulus._replace(
        base_m=base, thickness_m=thickness, size_m=size, extinction=40.0 / thickness,
        pattern=cumulus.pattern._replace(per_m=cumulus.pattern.per_m * cumulus.size_m / size),
    )  # fmt: skip
    land = LandBox((-half, -half, -100.0), (half, half, 3000.0), 50.0 * half)
    for radius in (0.0, RADIUS, np.radians(5.0)):
        made = cloud_shadows(to_sun(elevation), radius, cumulus, no_cirrus(), land)
        if made is None:
            continue
        assert max(made.picture.shape) <= 32
        assert np.isfinite([*made.middle_m, *made.size_m, made.texel_m]).all()
        assert min(made.size_m) > 0.0


@pytest.mark.parametrize("radius", [0.0, 0.3, 0.6, 1.5, 4.2])
def test_a_disc_has_its_area_and_no_side(radius: float):
    disc = _disc(radius)
    assert disc.sum() == pytest.approx(1.0)
    assert (disc == disc[::-1]).all()
    assert (disc == disc.T).all()
    side = np.arange(len(disc)) - len(disc) // 2
    # Second moment of a disc along an axis: a quarter of its radius squared.
    moment = (disc.sum(axis=0) * side * side).sum()
    if radius > 1.0:
        assert moment == pytest.approx(0.25 * radius * radius, rel=0.05)


@pytest.mark.parametrize("elevation", [75.0, 30.0])
def test_a_stage_tells_which_places_lie_in_shadow(tmp_path, elevation):
    """What a reader finds at places of any height is what beams to the sun find there."""
    cfg = small_cfg()
    cfg |= {"samples": 6, "outputs": ["rgb"]}
    cfg["terrain"] |= {"size_m": [3000, 2400], "spacing_m": 100}
    cfg["light"]["sun"] = {"elevation_deg": elevation, "azimuth_deg": 200}
    cover = {"type": "choice", "values": [0.6, 0.0]}
    cfg["light"]["clouds"] = {"cumulus": {"coverage": cover}, "resolution": 16}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(cfg))
    compile_cfg(path, seed=3, out=tmp_path / "out")
    scene = read_stage(tmp_path / "out" / "batch_0000" / "stage.usda")
    assert scene.losses == ()
    suns = [lighting.suns[0] for lighting in scene.lighting]
    cloudy = [i for i, one in enumerate(suns) if one.gobo is not None]
    assert 0 < len(cloudy) < 6
    one, clear = suns[cloudy[0]], next(one for one in suns if one.gobo is None)
    assert one.irradiance == pytest.approx(clear.irradiance)
    assert len(list((tmp_path / "out").rglob("clouds_*.png"))) == 1

    from scenec.compiler.cfg.load import load
    from scenec.compiler.draw import draw

    plan = draw(load(path), 3, 0).light.clouds
    assert plan.cumulus is not None
    cumulus = CumulusField(plan.cumulus).at(cloudy[0])
    places = np.random.default_rng(1).uniform(*scene.bounds, (400, 3))
    way = np.asarray(one.to_light)
    beams = np.array(
        [
            beam_left(way, *(place - way * (place[2] / way[2]))[:2], cumulus, no_cirrus())
            for place in places
        ]
    )
    found = passed(one, places)
    assert 0.05 < beams.mean() < 0.95
    assert np.corrcoef(found, beams)[0, 1] > 0.97
