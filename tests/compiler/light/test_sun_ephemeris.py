"""The sun of a place and a time, from the cfg to the light of a batch."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from scenec.compiler.cfg.load import Spec, load
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw import draw
from scenec.compiler.kinds import Context, draw_kind
from scenec.compiler.light.build import SceneLight, build_light, without_dark
from scenec.schemas.errors import CfgError, SceneError
from scenec.schemas.georeference import Georeference
from scenec.testing.small import small_cfg, write_cfg

_SITE = {
    "type": "ephemeris",
    "body": "moon",
    "latitude_deg": -89.5,
    "longitude_deg": 222,
    "time_utc": "2027-03-15T06:00:00Z",
}
_LABELS = {"labels": {"class": "sky", "surface": "sky"}}


def read(tmp_path, sun: dict[str, Any], **light: Any) -> Spec:
    cfg = small_cfg(samples=4)
    sky = {"type": "none"} | light.get("sky", {}) | _LABELS
    cfg["light"] = {"sun": _SITE | sun} | light | {"sky": sky}
    return load(write_cfg(tmp_path, cfg))


def lit(tmp_path, sun: dict[str, Any], **light: Any) -> SceneLight:
    plan = draw(read(tmp_path, sun, **light), 1, 0)
    return build_light(plan.light, 4, color=True, labels=False)


def test_a_sun_says_disc_or_nothing_and_what_says_nothing_stays_as_it_was(tmp_path):
    cfg = small_cfg()
    cfg["light"]["sun"] = {"elevation_deg": 12}
    said = load(write_cfg(tmp_path, cfg)).cfg["light"]["sun"]
    assert "type" not in said
    cfg["light"]["sun"]["type"] = "disc"
    assert load(write_cfg(tmp_path, cfg)).cfg["light"]["sun"] == {"type": "disc"} | said


def test_the_sun_goes_once_around_a_lunar_pole_in_a_synodic_month(tmp_path):
    light = lit(tmp_path, {"step_s": 29.530589 * 86400 / 4})
    turns = np.diff(light.sun.azimuth_deg) % 360.0
    # Seen from the south pole, counterclockwise: evenly but for the eccentric ways of both.
    assert np.minimum(turns, 360.0 - turns) == pytest.approx(90.0, abs=8.0)
    assert np.abs(light.sun.elevation_deg).max() < 1.6 + 0.5
    facts = light.facts["sun"]
    assert facts["time_utc"][1] == "2027-03-22T15:11:00.722Z"
    assert facts["elevation_deg"] == light.sun.elevation_deg.tolist()


def test_strength_and_width_follow_the_distance_unless_they_are_given(tmp_path):
    mars = {"body": "mars", "latitude_deg": 18, "longitude_deg": 77, "step_s": 86400 * 170}
    light = lit(tmp_path, mars)
    au = np.array(light.facts["sun"]["distance_au"])
    assert np.ptp(au) > 0.2
    assert light.sun.irradiance == pytest.approx(1361.0 / (au * au))
    assert light.sun.diameter_deg == pytest.approx(0.53292 / au, rel=1e-4)
    assert len(light.facts["sun"]["ls_deg"]) == 4
    assert lit(tmp_path, mars | {"irradiance": 77}).sun.irradiance.tolist() == [77.0] * 4


def test_the_earth_hangs_over_the_near_side_and_is_full_at_new_moon(tmp_path):
    # New moon, first quarter, full moon of January 2000 (6th 18:14, 14th 13:34, 21st 4:40 UT).
    near = {"latitude_deg": 0, "longitude_deg": 0, "earthshine": True}
    for time, phase in (("06T18:14", 0.0), ("14T13:34", 90.0), ("21T04:40", 180.0)):
        light = lit(tmp_path, near | {"time_utc": f"2000-01-{time}:00Z"})
        earth, facts = light.more_suns["Earth"], light.facts["sun"]["earth"]
        assert facts["phase_deg"][0] == pytest.approx(phase, abs=5.1)
        assert earth.elevation_deg.min() > 80.0
        assert earth.diameter_deg == pytest.approx(1.9, abs=0.15)
    full = lit(tmp_path, near | {"time_utc": "2000-01-06T18:14:00Z"}).more_suns["Earth"]
    assert full.irradiance[0] == pytest.approx(0.137, rel=0.2)
    far = lit(tmp_path, near | {"longitude_deg": 180})
    dark = without_dark(far, ())[2]
    assert ("light/more/Earth", "below the horizon at every sample") in dark


def test_a_sun_that_sets_shines_on_the_samples_before(tmp_path):
    # Greenwich at the equinox: it is up for twelve hours.
    place = {"body": "earth", "latitude_deg": 51.48, "longitude_deg": 0, "step_s": 6 * 3600}
    light = lit(tmp_path, place | {"time_utc": "2024-03-20T03:00:00Z"})
    assert (light.sun.elevation_deg > 0).tolist() == [False, True, True, False]
    assert (without_dark(light, ())[0].sun.irradiance > 0).tolist() == [False, True, True, False]


@pytest.mark.parametrize("latitude", [-90, 0, 90])
@pytest.mark.parametrize("longitude", [-180, 180, 360])
@pytest.mark.parametrize("body", ["earth", "moon", "mars"])
@pytest.mark.parametrize("time", ["1900-01-01T00:00", "2100-12-31T23:59:59.999999Z"])
def test_poles_the_date_line_and_the_years_bounds_have_a_sun(
    tmp_path, body, latitude, longitude, time
):
    place = {"body": body, "latitude_deg": latitude, "longitude_deg": longitude, "time_utc": time}
    light = lit(tmp_path, place | {"step_s": -0.0})
    for values in (light.sun.elevation_deg, light.sun.azimuth_deg, light.sun.irradiance):
        assert np.isfinite(values).all()
    tilt = {"earth": 23.46, "moon": 1.6, "mars": 25.3}[body]
    assert np.abs(light.sun.elevation_deg).max() <= (tilt if latitude else 90.0)
    other = lit(tmp_path, place | {"longitude_deg": longitude - 360 if longitude > 0 else 180})
    assert other.sun.elevation_deg == pytest.approx(light.sun.elevation_deg, abs=1e-9)


def test_a_batch_or_a_sample_draws_its_hour(tmp_path):
    offset = {"type": "uniform", "min": 0, "max": 86400}
    times = lit(tmp_path, {"offset_s": offset}).facts["sun"]["time_utc"]
    assert len(set(times)) == 4
    times = lit(tmp_path, {"offset_s": offset | {"per": "batch"}}).facts["sun"]["time_utc"]
    assert len(set(times)) == 1


@pytest.mark.parametrize(
    ("sun", "light", "pointer", "words"),
    [
        ({"time_utc": "2027-02-30T00:00:00Z"}, {}, "/time_utc", "expected a time in UTC"),
        ({"time_utc": "tomorrow"}, {}, "/time_utc", "expected a time in UTC"),
        ({"time_utc": "2027-02-03T00:00:00+01:00"}, {}, "/time_utc", "expected a time in UTC"),
        ({"time_utc": "1899-12-31T23:59:59Z"}, {}, "/time_utc", "1900 to 2100"),
        ({"time_utc": "2016-12-31T23:59:60Z"}, {}, "/time_utc", "expected a time in UTC"),
        ({"latitude_deg": 91}, {}, "/latitude_deg", "90"),
        ({"body": "mon"}, {}, "/body", '"moon"'),
        ({"body": "mars", "earthshine": True}, {}, "/earthshine", "the Moon alone"),
        ({"color": [0, 0, 0]}, {}, "/color", "black"),
        ({"elevation_deg": 3}, {}, "/elevation_deg", "unknown key"),
        ({}, {"sky": {"type": "atmosphere", "planet": "mars"}}, "/body", 'expected "mars"'),
        ({"type": "ephemeri"}, {}, "/type", '"ephemeris"'),
    ],
)
def test_a_fault_of_the_ephemeris_is_told_where_it_is(tmp_path, sun, light, pointer, words):
    with pytest.raises(CfgError) as caught:
        read(tmp_path, sun, **light)
    (fault,) = caught.value.faults
    assert fault.pointer == f"/light/sun{pointer}"
    assert words in fault.message


def test_a_place_is_whole_or_that_of_a_dem(tmp_path):
    for left_out, words in (
        (("longitude_deg",), "both of the keys"),
        (("latitude_deg", "longitude_deg"), "expected the keys latitude_deg and longitude_deg"),
    ):
        cfg = small_cfg()
        cfg["light"]["sun"] = {k: v for k, v in _SITE.items() if k not in left_out}
        with pytest.raises(CfgError, match=words):
            load(write_cfg(tmp_path, cfg))


def test_a_dems_place_is_taken_with_the_turn_of_its_axes():
    node = {"type": "ephemeris", "body": "moon", "time_utc": _SITE["time_utc"], "step_s": 0.0}
    node |= {"offset_s": 0.0, "color": [1.0, 1.0, 1.0], "earthshine": False, "irradiance": None}
    site = {"latitude_deg": -89.5, "longitude_deg": 222.0}
    context = Context(Streams(1, 0, 0), path="light/sun", samples=1)
    given = draw_kind("suns", node | site, "light/sun", context).disc
    node |= dict.fromkeys(site)
    # Its +y is south.
    place = Georeference("Moon", 1737400.0, 1737400.0, *site.values(), (-1.0, 0.0, 0.0, -1.0))
    track = draw_kind("suns", node, "light/sun", replace(context, georeference=lambda: place))
    found = track.disc
    assert track.facts["azimuth_deg"] == found.azimuth_deg
    assert track.facts["azimuth_from_north_deg"] == given.azimuth_deg
    assert found.elevation_deg == given.elevation_deg
    assert found.azimuth_deg == pytest.approx((given.azimuth_deg + 180.0) % 360.0)
    with pytest.raises(SceneError, match="says no latitude and longitude"):
        draw_kind("suns", node, "light/sun", context)
    there = replace(context, georeference=lambda: place)
    with pytest.raises(SceneError, match='lies on Moon: expected "moon"'):
        draw_kind("suns", node | {"body": "mars"}, "light/sun", there)


def test_steps_beyond_the_years_that_are_taken_are_told(tmp_path):
    with pytest.raises(SceneError, match="sample 3 is 3000000000 s after"):
        lit(tmp_path, {"step_s": 1e9})
