"""Airlight: its closed forms against quadrature, its limits, and a volume rendered by Mitsuba."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mitsuba_volume import (
    DISTANCE_M,
    EXTINCTION,
    GROUND,
    HEIGHT_M,
    SCALE_HEIGHT_M,
    SKY,
    SUN_DEG,
    WAY_DEG,
    WAYS_DEG,
)
from numpy.typing import NDArray
from scipy.integrate import quad

from scenec.backends.picture import airlight, ordinates
from scenec.backends.picture.airlight import (
    FAR_M,
    Air,
    air_of,
    ambient,
    arrive,
    depth_above,
    optical_depth,
    phase,
)
from scenec.backends.picture.sky import Sky, texel_directions
from scenec.backends.stage.scene import Haze, Sun
from scenec.backends.testing import scenes as ms
from scenec.testing.examples import examples

GRAY = np.array([0.4, 0.5, 0.6])
FLAT = Sky(GRAY.reshape(1, 1, 3).astype(np.float32), np.eye(3))
#: So little is scattered that next to none is so twice.
ONCE = 1e-9


def haze(
    visibility: float = 100.0, height: float = 1000.0, g: float = 0.7, albedo: float = 1.0
) -> Haze:
    extinction = np.full(3, 3.912 / visibility)
    return Haze(extinction, height, asymmetry=g, albedo=np.full(3, albedo))


def toward(elevation_deg: float, bearing_deg: float = 0.0) -> NDArray:
    e, a = np.radians([elevation_deg, bearing_deg])
    return np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])


def sun(elevation_deg: float, irradiance: float = 1000.0, bearing_deg: float = 0.0) -> Sun:
    return Sun(toward(elevation_deg, bearing_deg), np.full(3, irradiance), np.radians(0.53))


def through(
    air: Air, direction: NDArray, distance: float, z: float = 0.0
) -> tuple[NDArray, NDArray]:
    """Transmittance and airlight of one ray, [3] each."""
    origin, ways = np.array([[0.0, 0.0, z]]), direction[None]
    passed, added = arrive(air, origin, ways[:, None], np.array([[distance]]), ambient(air, ways))
    return passed[0], added[0]


def source(air: Air, direction: NDArray, depth: NDArray, way: NDArray) -> NDArray:
    """J of the module at optical depths [n] below the top and along the ray, float64 [n, 3]."""
    of, cosine = air.medium, air.medium.to_light @ direction
    strength = ambient(air, direction[None])[0, 3:].reshape(-1, 3).astype(float)
    strength = np.vstack([strength, np.zeros((len(cosine), 3))])
    lobes = phase(cosine, of.asymmetry**2)
    lobes = np.concatenate([lobes, phase(cosine, of.asymmetry) - lobes])
    if len(lobes):
        strength[-len(lobes) :] += np.tile(of.beam, (2, 1)) * lobes[:, None]
    exponent = of.rate * depth[:, None, None] + of.offset + of.sight * way[:, None, None]
    return (strength * np.exp(-exponent)).sum(axis=1)


def aureole(sun_elevation_deg: float, width_deg: float = 8.0, rows: int = 180) -> Sky:
    """A sky whose horizon is 8 times as bright below the sun as elsewhere; dark ground."""
    to = texel_directions(rows, 2 * rows) @ ms.DOME_Z_UP.T
    angle = np.degrees(np.arccos(np.clip(to @ toward(sun_elevation_deg), -1, 1)))
    level = 10.0 + 70.0 * np.exp(-angle / width_deg + sun_elevation_deg / width_deg)
    level = np.where(to[..., 2] < 0.0, 3.0, level)
    return Sky(np.repeat(level[..., None], 3, -1).astype(np.float32), ms.DOME_Z_UP)


def depth(height: float, z0: float, z1: float, distance: float) -> float:
    return float(optical_depth(height, z0, z1 - z0, distance))


@given(
    st.floats(0.1, 1e6),
    st.floats(-20.0, 20.0),
    st.floats(-30.0, 30.0),
    st.floats(1e-3, 1e5),
)
def test_the_closed_form_is_the_integral(height, start, rise, distance):
    z0, z1 = start * height, (start + rise) * height
    lowest = min(z0, z1) / height
    # In units of the density at the lowest point, where the integrand is at most 1.
    slope = abs(rise)
    expected = distance * quad(lambda x: np.exp(-slope * x), 0, 1, epsabs=0, epsrel=1e-12)[0]
    assert depth(height, z0, z1, distance) == pytest.approx(expected * np.exp(-lowest), rel=1e-9)


@given(st.floats(-1e12, 1e12), st.floats(-1e12, 1e12), st.floats(0, 1e12), st.floats(1e-3, 1e9))
def test_it_is_finite_and_not_negative_for_any_ray(z0, z1, distance, height):
    found = depth(height, z0, z1, distance)
    assert np.isfinite(found)
    assert found >= 0.0


def test_its_limits():
    assert depth(50.0, 3.0, 3.0, 0.0) == 0.0
    # Level, straight up to space, and with no end of its height.
    assert depth(50.0, 100.0, 100.0, 7.0) == pytest.approx(7.0 * np.exp(-2.0), rel=1e-14)
    assert depth(50.0, 0.0, 1e9, 1e9) == pytest.approx(50.0, rel=1e-12)
    assert depth(np.inf, -1e5, 1e5, 321.0) == 321.0
    # Nearly level: the two branches of (1 - exp(-x)) / x meet.
    steps = [depth(1.0, 0.0, rise, 1.0) for rise in (0.0, 0.9e-12, 1.1e-12, 1e-9)]
    np.testing.assert_allclose(steps, 1.0, rtol=1e-9)


@examples(50)
@given(st.floats(0.0, 1.0), st.floats(-0.99, 0.99))
def test_two_parts_of_a_way_weaken_as_the_whole(share, slope):
    whole = depth(30.0, 5.0, 5.0 + 400.0 * slope, 400.0)
    middle = 5.0 + 400.0 * slope * share
    first = depth(30.0, 5.0, middle, 400.0 * share)
    second = depth(30.0, middle, 5.0 + 400.0 * slope, 400.0 * (1.0 - share))
    assert first + second == pytest.approx(whole, rel=1e-9)


@given(st.floats(-0.95, 0.95))
def test_the_phase_function_is_a_density_with_mean_cosine_g(g):
    whole = quad(lambda c: 2 * np.pi * phase(np.array(c), g), -1, 1, epsrel=1e-10)[0]
    mean = quad(lambda c: 2 * np.pi * c * phase(np.array(c), g), -1, 1, epsrel=1e-10)[0]
    assert whole == pytest.approx(1.0, rel=1e-8)
    assert mean == pytest.approx(g, abs=1e-8)


@given(
    st.floats(-89.0, 89.0),
    st.floats(0.5, 90.0),
    st.floats(0.1, 3000.0),
    st.floats(-50.0, 200.0),
    st.floats(5.0, 500.0),
)
def test_airlight_in_a_layer_is_the_integral_of_single_scattering(e, up, distance, z, height):
    air = air_of(haze(200.0, height, albedo=ONCE), (sun(up),), None, -60.0)
    direction = toward(e, 40.0)
    _, added = through(air, direction, distance, z)
    extinction = 3.912 / 200.0
    slant = 1.0 / np.sin(np.radians(up))
    lobe = float(phase(direction @ toward(up), 0.7))

    def scattered_at(d: float) -> float:
        there = z + d * direction[2]
        local = extinction * np.exp(-there / height)
        before = extinction * depth(height, z, there, d)
        return 1000.0 * lobe * local * np.exp(-before - local * height * slant)

    # Nodes where the integrand has a scale of its own, so that quadrature cannot step over it.
    nodes = np.unique(np.clip(np.geomspace(1e-3, 1.0, 24) * distance, 0.0, distance))
    parts = zip([0.0, *nodes[:-1]], nodes, strict=True)
    expected = sum(quad(scattered_at, a, b, epsabs=1e-13, epsrel=1e-10)[0] for a, b in parts)
    np.testing.assert_allclose(added / ONCE, expected, rtol=1e-6, atol=1e-6)


@examples(30)
@given(
    st.floats(-90.0, 90.0),
    st.floats(0.5, 90.0),
    st.floats(-3.0, 2.0),
    st.floats(0.0, 3.0),
    st.floats(-0.9, 0.9),
    st.floats(0.0, 1.0),
)
def test_airlight_is_the_integral_of_its_source(e, up, log_depth, above, g, albedo):
    # A layer of 100 m, of some optical depth at the floor; a ray from some height to its end.
    height, whole = 100.0, 10.0**log_depth
    of = haze(height * 3.912 / whole, height, g, albedo)
    air = air_of(of, (sun(up), sun(50.0, 100.0, 70.0)), aureole(up), 0.0)
    direction, z = toward(e, 40.0), above * height
    _, added = through(air, direction, FAR_M if e >= 0.0 else z / max(-direction[2], 1e-9), z)
    top = whole * np.exp(-above)
    # In the depth s above: s falls to 0 upward, grows to the floor's downward.
    steps, weights = np.polynomial.legendre.leggauss(400)
    steps, weights = 0.5 * (steps + 1.0), 0.5 * weights
    length = min(top if e >= 0.0 else whole - top, 45.0 * abs(direction[2]))
    way = steps * length / max(abs(direction[2]), 1e-300)
    there = top - np.sign(direction[2]) * steps * length
    if length > 0.0 and abs(direction[2]) > 1e-6:
        lit = source(air, direction, there, way)
        expected = (weights[:, None] * lit).sum(axis=0) * length / abs(direction[2])
        end = (top if e >= 0.0 else whole - top) / abs(direction[2])
        blurred = np.exp(-air.medium.sight[0] * end) - np.exp(-end)
        expected += blurred * ambient(air, direction[None])[0, :3]
        np.testing.assert_allclose(added, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("depth_", [1e-6, 0.1, 3.0, 1e3, 1e6])
@pytest.mark.parametrize("g", [-0.5, 0.0, 0.85])
def test_a_layer_that_absorbs_nothing_loses_no_light(depth_, g):
    """What comes down and is not taken by the ground leaves through the top."""
    suns, part = (sun(30.0), sun(5.0, 300.0, 80.0)), 0.4
    comes = np.pi * 100.0 + sum(each.irradiance[0] * each.to_light[2] for each in suns)
    ground = part * comes / np.pi
    picture = np.full((64, 128, 3), 100.0, np.float32)
    picture[32:] = ground
    air = air_of(haze(60.0 * 3.912 / depth_, 60.0, g), suns, Sky(picture, ms.DOME_Z_UP), 0.0)
    x, weight = np.polynomial.legendre.leggauss(24)
    leaves = 0.0
    for sine, share in zip(0.5 * (x + 1.0), 0.5 * weight, strict=True):
        for bearing in np.arange(0.0, 360.0, 10.0):
            way = toward(-np.degrees(np.arcsin(sine)), bearing)
            passed, added = through(air, way, 1800.0 / sine, 1800.0)
            sent = passed[0] * ground * air.dimming[0] + added[0]
            leaves += sent * sine * share * 2.0 * np.pi / 36.0
    assert comes == pytest.approx(leaves + (1.0 - part) * comes * air.dimming[0], rel=0.01)


@pytest.mark.parametrize("up", [5.0, 30.0, 90.0])
def test_endless_air_that_scatters_alike_reflects_as_chandrasekhars_function_says(up):
    """I = albedo E mu_0 H(mu) H(mu_0) / (4 pi (mu + mu_0)), with H by iteration of its equation."""
    albedo = 0.95
    x, weight = np.polynomial.legendre.leggauss(64)
    nodes, weight = 0.5 * (x + 1.0), 0.5 * weight

    def h(mu: NDArray, at_nodes: NDArray) -> NDArray:
        whole = (weight * nodes * at_nodes / (mu[:, None] + nodes)).sum(axis=1)
        return 1.0 / (np.sqrt(1.0 - albedo) + 0.5 * albedo * whole)

    values = np.ones(64)
    for _ in range(300):
        values = h(nodes, values)
    air = air_of(haze(1.0, 60.0, g=0.0, albedo=albedo), (sun(up),), None, 0.0)
    sine = np.sin(np.radians(up))
    for e in (-5.0, -40.0, -90.0):
        mu = np.sin(np.radians(-e))
        at = h(np.array([mu, sine]), values)
        expected = albedo * 1000.0 * sine * at.prod() / (4.0 * np.pi * (mu + sine))
        _, added = through(air, toward(e, 70.0), 1200.0 / mu, 1200.0)
        assert added[0] == pytest.approx(expected, rel=0.02)


def test_a_layer_that_scatters_nothing_weakens_suns_alone_by_beers_law():
    air = air_of(haze(60.0 * 3.912 / 1.2, 60.0, albedo=0.0), (sun(30.0),), None, 0.0)
    np.testing.assert_allclose(air.dimming, np.exp(-2.4), rtol=1e-12)
    air = air_of(haze(albedo=0.0), (sun(30.0),), FLAT, 0.0)
    assert not through(air, toward(10.0), 1e3)[1].any()


@pytest.mark.parametrize("g", [0.0, 0.7, 0.9])
@pytest.mark.parametrize("depth_", [0.01, 0.3, 1.0, 5.0, 100.0])
def test_in_a_furnace_everything_is_as_bright_as_its_walls(g, depth_):
    """Sky and ground of one radiance, and nothing absorbs: haze is unseen."""
    air = air_of(haze(3912.0 / depth_, g=g), (), FLAT, 0.0)
    np.testing.assert_allclose(air.dimming, 1.0, rtol=1e-3)
    for z in (0.0, 1000.0, 4000.0):
        for e in (-80.0, -20.0, -1.0, 1.0, 20.0, 80.0):
            way = toward(e, 30.0)
            passed, added = through(air, way, FAR_M if e > 0.0 else z / -way[2], z)
            np.testing.assert_allclose(GRAY * passed + added, GRAY, rtol=1e-3)


@given(st.floats(0.0, 1.0), st.floats(-89.0, 89.0), st.floats(-5.0, 90.0), st.floats(-300.0, 300.0))
def test_two_pieces_of_a_ray_compose_to_the_whole(share, e, up, z):
    # But for light that is turned a little on its way: with g = 0 there is none.
    of = haze(150.0, 60.0, g=0.0)
    air = air_of(of, (sun(up), sun(20.0, 80.0, 120.0)), aureole(up), -800.0)
    direction, length = toward(e, 25.0), 400.0
    whole_passed, whole_added = through(air, direction, length, z)
    passed, added = through(air, direction, share * length, z)
    then_passed, then_added = through(
        air, direction, (1.0 - share) * length, z + share * length * direction[2]
    )
    np.testing.assert_allclose(passed * then_passed, whole_passed, rtol=1e-8, atol=1e-300)
    np.testing.assert_allclose(added + passed * then_added, whole_added, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("bearing", [0.0, 10.0, 90.0, 180.0])
@pytest.mark.parametrize("e", [-50.0, -10.0, 0.0, 20.0])
def test_two_meters_of_haze_of_a_kilometer_add_less_than_a_hundredth(bearing, e):
    air = air_of(haze(1000.0), (sun(10.0),), aureole(10.0), 0.0)
    _, added = through(air, toward(e, bearing), 2.0, 2.0)
    # A white wall in the sun sends 318 W/(m^2 sr).
    assert ((added > 0.0) & (added < 1.0)).all()


def test_airlight_50_degrees_below_the_sun_is_as_beside_it_in_the_row():
    # The horizon is 6 times as bright below the sun as 40 degrees beside it. Haze on the ground in
    # front of the camera is 50 degrees from the sun there, and 60 degrees in the row beside.
    up = 8.0
    for suns in ((sun(up),), ()):
        air = air_of(haze(30.0, 3.0), suns, aureole(up), 0.0)
        row = [through(air, toward(-42.0, b), 2.0, 2.0)[1][0] for b in range(0, 181, 5)]
        # No more than the phase function has it, by the angles to the sun.
        angles = np.array([toward(-42.0, b) @ toward(up) for b in (0.0, 40.0)])
        near, far = phase(angles, 0.7)
        assert 1.5 < near / far < 1.7
        assert row[0] < near / far * row[8]
        assert (np.diff(row) < 0.0).all()


@pytest.mark.slow
def test_it_has_no_steps_in_bearing_elevation_distance_or_the_suns_height():
    sky = aureole(5.0)
    air = air_of(haze(80.0, 40.0), (sun(5.0),), sky, 0.0)

    def of_sun(up: float) -> NDArray:
        air = air_of(haze(80.0, 2.0), (sun(up, 10.0),), FLAT, 0.0)
        return through(air, toward(-20.0, 10.0), 6.0, 2.0)[1]

    ways = {
        "bearing": (lambda b: through(air, toward(-1.0, b), 60.0, 2.0)[1], 0.0, 360.0),
        "elevation": (lambda e: through(air, toward(e, 3.0), 60.0, 2.0)[1], -90.0, 90.0),
        "distance": (lambda d: through(air, toward(-3.0, 3.0), d, 2.0)[1], 0.0, 300.0),
        "sun": (of_sun, -1.0, 1.0),
    }
    for name, (value, low, high) in ways.items():
        steps = []
        for count in (200, 800):
            found = np.array([value(x)[0] for x in np.linspace(low, high, count + 1)])
            steps.append(np.abs(np.diff(found)).max() / found.max())
        # Four times as many steps are about a fourth as large each.
        assert steps[1] < 0.4 * steps[0], name
        assert steps[1] < 0.05, name


@examples(30)
@given(
    st.floats(-1e6, 1e6),
    st.floats(-90.0, 90.0),
    st.floats(-90.0, 90.0),
    st.floats(-6.0, 6.0),
    st.floats(-9.0, 9.0),
)
def test_it_is_finite_and_not_negative_for_any_layer(z, e, up, log_height, log_visibility):
    of = haze(10.0**log_visibility, 10.0**log_height)
    sky = aureole(up, rows=16)
    air = air_of(of, (sun(up),), sky, min(z, 0.0))
    # No brighter than the brightest place of the sky, and what is scattered of the sun.
    most = 1e4 + float(sky.picture.max())
    for distance in (0.0, 1e-9, 1.0, 1e12, FAR_M):
        passed, added = through(air, toward(e), distance, z)
        assert ((passed >= 0.0) & (passed <= 1.0)).all()
        assert np.isfinite(added).all()
        assert ((added >= 0.0) & (added <= most)).all()
    assert ((air.dimming >= 0.0) & (air.dimming <= 1.0 + 1e-9)).all()
    assert (depth_above(of, z) >= 0.0).all()


def test_suns_add_up_and_one_that_has_set_adds_nothing():
    way = toward(-10.0, 30.0)

    def added(*suns: Sun) -> NDArray:
        return through(air_of(haze(), suns, None, 0.0), way, 50.0, 20.0)[1]

    one, other = sun(20.0), sun(50.0, 300.0, 80.0)
    # Its sum of exponentials is fitted to all of the light.
    np.testing.assert_allclose(added(one, other), added(one) + added(other), rtol=0.01)
    np.testing.assert_array_equal(added(one, sun(-1.0)), added(one))
    assert not added(sun(-1.0)).any()


def test_colors_are_alike_where_all_are_one_and_stay_apart_where_not():
    way, suns = toward(-3.0, 20.0), (sun(20.0),)
    gray = air_of(haze(200.0), suns, None, 0.0)
    assert gray.medium.gray
    color = np.array([0.5, 1.0, 2.0]) * 3.912 / 200.0
    colored = air_of(Haze(color), suns, None, 0.0)
    assert not colored.medium.gray
    for c in range(3):
        alone = air_of(Haze(np.full(3, color[c])), suns, None, 0.0)
        one, other = through(colored, way, 50.0, 20.0), through(alone, way, 50.0, 20.0)
        assert one[0][c] == other[0][c]
        assert one[1][c] == pytest.approx(other[1][c], rel=1e-9)


def test_a_color_that_no_haze_weakens_is_as_without_haze():
    """Two colors of haze, and ground so high above z = 0 that nothing of the layer is left."""
    way, suns = toward(-3.0, 20.0), (sun(20.0),)
    of = Haze(np.array([0.01, 0.01, 0.0]), 60.0)
    two = air_of(of, suns, FLAT, 0.0)
    passed, added = through(two, way, 50.0, 20.0)
    assert (passed[2], added[2], two.dimming[2]) == (1.0, 0.0, pytest.approx(1.0, abs=1e-5))
    all_three = air_of(replace(of, extinction=np.full(3, 0.01)), suns, FLAT, 0.0)
    expected = through(all_three, way, 50.0, 20.0)[1]
    # Its sums of exponentials are fitted to all colors of one depth.
    np.testing.assert_allclose(added[:2], expected[:2], rtol=1e-3)
    high = 800.0 * of.scale_height_m
    passed, added = through(air_of(of, suns, FLAT, high), way, 50.0, high + 20.0)
    assert ((passed == 1.0) & (added < 1e-300)).all()


@pytest.mark.parametrize(("g", "off"), [(-0.9, 0.11), (-0.7, 0.02), (0.3, 0.02)])
def test_four_times_as_many_streams_find_the_same_light(g, off, monkeypatch):
    ways = [toward(e, b) for e in (-60.0, -20.0, -3.0, 3.0, 60.0) for b in (0.0, 90.0, 180.0)]

    def found() -> NDArray:
        air = air_of(haze(60.0 * 3.912 / 2.0, 60.0, g), (sun(30.0),), aureole(30.0), 0.0)
        ends = [FAR_M if way[2] > 0.0 else 10.0 / -way[2] for way in ways]
        return np.array(
            [through(air, way, end, 10.0)[1][0] for way, end in zip(ways, ends, strict=True)]
        )

    few = found()
    orders = np.arange(64)
    monkeypatch.setattr(ordinates, "STREAMS", 32)
    monkeypatch.setattr(airlight, "STREAMS", 32)
    monkeypatch.setattr(ordinates, "_ORDERS", orders)
    monkeypatch.setattr(ordinates, "_EVEN", ((orders[:, None] + orders) % 2 == 0)[..., None])
    ordinates._sines.cache_clear()
    try:
        many = found()
    finally:
        ordinates._sines.cache_clear()
    np.testing.assert_allclose(few, many, rtol=off)


@pytest.mark.parametrize("turned", [0.0, 100.0])
def test_a_sun_in_the_skys_picture_is_scattered_like_a_sun(turned):
    """But for what is within the width of the lobe that is straight on."""
    picture = np.zeros((512, 1024, 3), np.float32)
    row, column = 150, 700
    picture[row, column] = 1e6
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    sky = Sky(picture, np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ ms.DOME_Z_UP)
    to_sun = (texel_directions(512, 1024) @ sky.to_world.T)[row, column]
    edges = np.cos(np.arange(row, row + 2) * np.pi / 512)
    irradiance = 1e6 * (edges[0] - edges[1]) * (2 * np.pi / 1024)
    same = Sun(to_sun, np.full(3, irradiance), np.radians(0.53))
    of = haze(60.0 * 3.912, 60.0)
    pictured, lit = air_of(of, (), sky, 0.0), air_of(of, (same,), None, 0.0)
    np.testing.assert_allclose(pictured.dimming, lit.dimming, rtol=0.03)
    rng = np.random.default_rng(2)
    for way in rng.normal(size=(60, 3)):
        way /= np.linalg.norm(way)
        if way @ to_sun < 0.9 and abs(way[2]) > 0.05:
            far = FAR_M if way[2] > 0.0 else 10.0 / -way[2]
            expected = through(lit, way, far, 10.0)[1]
            np.testing.assert_allclose(through(pictured, way, far, 10.0)[1], expected, rtol=0.1)


@pytest.mark.parametrize("g", [0.0, 0.7])
def test_it_is_what_mitsuba_renders_of_a_volume(g):
    """Single scattering to its noise; all of it, under sun and sky over ground, to 2 % beyond."""
    # In a process of its own: Mitsuba and Blender do not share one.
    script = Path(__file__).with_name("mitsuba_volume.py")
    done = subprocess.run(
        [sys.executable, str(script), str(g)], capture_output=True, text=True, check=True
    )
    (mean, error), *whole = [map(float, line.split()) for line in done.stdout.splitlines()]
    ground = GROUND * (SKY + 1000.0 * np.sin(np.radians(SUN_DEG)) / np.pi)
    picture = np.full((128, 256, 3), SKY, np.float32)
    picture[64:] = ground
    sky = Sky(picture, ms.DOME_Z_UP)
    of = Haze(np.full(3, EXTINCTION), SCALE_HEIGHT_M, asymmetry=g, albedo=np.full(3, ONCE))
    air = air_of(of, (sun(SUN_DEG),), None, 0.0)
    expected = through(air, toward(*WAY_DEG), DISTANCE_M, HEIGHT_M)[1][0] / ONCE
    assert error < 0.01 * expected
    assert abs(mean - expected) < 5.0 * error + 1e-3 * expected
    air = air_of(replace(of, albedo=np.ones(3)), (sun(SUN_DEG),), sky, 0.0)
    for (mean, error), (e, bearing) in zip(whole, WAYS_DEG, strict=True):
        way = toward(e, bearing)
        passed, added = through(air, way, FAR_M if e > 0.0 else HEIGHT_M / -way[2], HEIGHT_M)
        behind = SKY if e > 0.0 else ground * air.dimming[0]
        expected = passed[0] * behind + added[0]
        assert error < 0.03 * expected
        assert abs(mean - expected) < 4.0 * error + 0.02 * mean
