"""Places of Sun and Earth against ERFA with the IAU's rotation elements, and published examples."""

from __future__ import annotations

import erfa
import numpy as np
import pytest

from scenec.backends.run.facts import sun_record
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.light import ephemeris
from scenec.schemas.georeference import Georeference
from scenec.testing.small import small_cfg, write_cfg

_DEG = np.pi / 180.0
_J2000 = 2451545.0
_LIGHT_AU_A_DAY = 173.1446326847


def _axes(ra: float, declination: float, turn: float) -> np.ndarray:
    """From the sky's axes to a body's, by its pole and prime meridian (WGCCRE)."""
    tilted = erfa.rx((90.0 - declination) * _DEG, erfa.rz((90.0 + ra) * _DEG, np.eye(3)))
    return erfa.rz(turn * _DEG, tilted)


def _mars_axes(d: float) -> np.ndarray:
    t = d / 36525.0
    return _axes(317.68143 - 0.1061 * t, 52.88650 - 0.0609 * t, 176.630 + 350.89198226 * d)


#: E1 to E13 of the Moon at J2000 and a day (Archinal et al. 2011), and what each adds to right
#: ascension, declination and W.
_MOON_ANGLES = np.array([
    (125.045, -0.0529921), (250.089, -0.1059842), (260.008, 13.0120009), (176.625, 13.3407154),
    (357.529, 0.9856003), (311.589, 26.4057084), (134.963, 13.0649930), (276.617, 0.3287146),
    (34.226, 1.7484877), (15.134, -0.1589763), (119.743, 0.0036096), (239.961, 0.1643573),
    (25.053, 12.9590088),
])  # fmt: skip
_MOON_RA = (-3.8787, -0.1204, 0.07, -0.0172, 0, 0.0072, 0, 0, 0, -0.0052, 0, 0, 0.0043)
_MOON_DEC = (1.5419, 0.0239, -0.0278, 0.0068, 0, -0.0029, 0.0009, 0, 0, 0.0008, 0, 0, -0.0009)
_MOON_W = (
    3.5610, 0.1208, -0.0642, 0.0158, 0.0252, -0.0066, -0.0047, -0.0046, 0.0028, 0.0052, 0.0040,
    0.0019, -0.0044,
)  # fmt: skip


def _moon_axes(d: float) -> np.ndarray:
    t, angles = d / 36525.0, (_MOON_ANGLES[:, 0] + _MOON_ANGLES[:, 1] * d) * _DEG
    return _axes(
        269.9949 + 0.0031 * t + np.dot(_MOON_RA, np.sin(angles)),
        66.5392 + 0.0130 * t + np.dot(_MOON_DEC, np.cos(angles)),
        38.3213 + 13.17635815 * d - 1.4e-12 * d * d + np.dot(_MOON_W, np.sin(angles)),
    )


def _apparent(place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Aberration, to first order: unit vector."""
    way = place / np.linalg.norm(place) + velocity / _LIGHT_AU_A_DAY
    return way / np.linalg.norm(way)


def _by_erfa(ut: float, tt: float) -> dict[str, tuple[np.ndarray, float]]:
    """Directions of the Sun in the axes of each body, and of the Earth in the Moon's; au."""
    helio, bary = erfa.epv00(_J2000, tt)
    earth, velocity, moon = helio["p"], bary["v"], erfa.moon98(_J2000, tt)["p"]
    mars = erfa.plan94(_J2000, tt, 4)
    of_earth = erfa.pnm06a(_J2000, tt) @ _apparent(-earth, velocity)
    spin = erfa.rz(erfa.gst06a(_J2000, ut, _J2000, tt), np.eye(3))
    over_moon = -(earth + moon)
    return {
        "earth": (spin @ of_earth, np.linalg.norm(earth)),
        "moon": (_moon_axes(tt) @ _apparent(over_moon, velocity), np.linalg.norm(over_moon)),
        "mars": (_mars_axes(tt) @ _apparent(-mars["p"], mars["v"]), np.linalg.norm(mars["p"])),
        "earth over moon": (_moon_axes(tt) @ (-moon / np.linalg.norm(moon)), np.linalg.norm(moon)),
    }


def _unit(at: ephemeris.Overhead) -> np.ndarray:
    latitude, longitude = at.latitude_deg * _DEG, at.longitude_deg * _DEG
    level = np.cos(latitude)
    return np.array([level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)])


def _random_times(number: int) -> list[np.datetime64]:
    span = int(
        (np.datetime64("2051-01-01") - np.datetime64("1980-01-01")) / np.timedelta64(1, "ms")
    )
    offsets = np.random.default_rng(1).integers(0, span, number)
    return [np.datetime64("1980-01-01T00:00:00") + np.timedelta64(int(o), "ms") for o in offsets]


def test_places_of_sun_and_earth_are_within_the_stated_arc_minutes_of_erfa():
    worst = dict.fromkeys(("earth", "moon", "mars", "earth over moon"), 0.0)
    for time in _random_times(1500):
        ut, tt = ephemeris.days_since_j2000(time)
        for name, (way, distance) in _by_erfa(ut, tt).items():
            if name in ephemeris.BODY_RADII_KM:
                found = ephemeris.sun_over(name, time).overhead
            else:
                found = ephemeris.earth_over_moon(time).overhead
            chord = np.linalg.norm(_unit(found) - way)
            worst[name] = max(worst[name], 120.0 * np.arcsin(0.5 * chord) / _DEG)
            assert found.distance_km == pytest.approx(distance * ephemeris.AU_KM, rel=3e-4)
    # What docs/light.md says.
    assert worst["earth"] < 0.6
    assert worst["moon"] < 0.9
    assert worst["mars"] < 0.6
    assert worst["earth over moon"] < 2.4


@pytest.mark.parametrize(
    "day", ["1972-01-01", "1980-01-01", "1999-01-01", "2016-12-31", "2024-06-01"]
)
def test_terrestrial_time_follows_the_leap_seconds_that_erfa_has(day):
    ut, tt = ephemeris.days_since_j2000(np.datetime64(f"{day}T00:00:00"))
    year, month, number = map(int, day.split("-"))
    seconds = erfa.dat(year, month, number, 0.0) + 32.184
    assert (tt - ut) * 86400.0 == pytest.approx(seconds, abs=1e-6)


@pytest.mark.parametrize(
    ("time", "ls", "mtc", "west", "lmst", "sun_west", "solar_time", "distance"),
    [
        ("2000-01-06T00:00:00", 277.18758, 23.99425, 0.0, 23.99425, 174.72600, 23.64840, 1.39358),
        ("2004-01-03T13:46:31", 327.32416, 13.16537, 184.702, 0.85190, 4.70500, 0.00020, 1.47767),
    ],
)
def test_mars_has_the_worked_examples_of_mars24(
    time, ls, mtc, west, lmst, sun_west, solar_time, distance
):
    sun = ephemeris.sun_over("mars", np.datetime64(time))
    assert sun.ls_deg == pytest.approx(ls, abs=2e-5)
    assert sun.mean_time_h == pytest.approx(mtc, abs=1e-5)
    assert ephemeris.mean_solar_time_h(sun, -west) == pytest.approx(lmst, abs=1e-5)
    assert 360.0 - sun.overhead.longitude_deg == pytest.approx(sun_west, abs=1e-5)
    assert ephemeris.solar_time_h(sun.overhead, -west) == pytest.approx(solar_time, abs=1e-5)
    assert sun.overhead.distance_km / ephemeris.AU_KM == pytest.approx(distance, abs=1e-5)


@pytest.mark.parametrize(
    ("body", "most_h", "days"), [("earth", 0.275, 365.2422), ("moon", 0.14, 29.530589)]
)
def test_mean_time_goes_evenly_and_true_time_stays_beside_it(body, most_h, days):
    # Equation of time: 16.5 minutes on Earth; the Moon turns evenly and stands upright: the Sun's
    # equation of center, 1.9 degrees, and what it is off the Earth, 0.15.
    start, off, mean = np.datetime64("2024-01-01T00:00:00"), [], []
    for hour in range(0, 366 * 24, 31):
        sun = ephemeris.sun_over(body, start + np.timedelta64(hour, "h"))
        true = ephemeris.solar_time_h(sun.overhead, 77.0)
        mean.append((hour, ephemeris.mean_solar_time_h(sun, 77.0)))
        off.append((true - mean[-1][1] + 12.0) % 24.0 - 12.0)
    assert 0.8 * most_h < np.abs(off).max() < most_h
    assert abs(np.mean(off)) < 0.02
    rate = 1.0 if body == "earth" else 1.0 / days
    (first, at_first), *rest = mean
    for hour, there in rest:
        gone = (there - at_first - (hour - first) * rate + 12.0) % 24.0 - 12.0
        assert abs(gone) < 1e-5


def test_mean_time_of_earth_is_ut_and_that_of_the_moon_begins_with_the_mean_new_moon():
    noon = ephemeris.sun_over("earth", np.datetime64("2031-05-06T12:00:00"))
    assert ephemeris.mean_solar_time_h(noon, 15.0) == pytest.approx(13.0, abs=1e-9)
    # Meeus 1998, ch. 49: mean new moon of k = 0, JDE 2451550.09766; it is midnight at longitude 0.
    days = 2451550.09766 - 2451545.0 - 64.184 / 86400.0
    time = np.datetime64("2000-01-01T12:00:00") + np.timedelta64(round(days * 86400), "s")
    mean = ephemeris.mean_solar_time_h(ephemeris.sun_over("moon", time), 0.0)
    assert (mean + 12.0) % 24.0 == pytest.approx(12.0, abs=1e-3)


def test_sun_and_earth_stand_over_the_moon_as_meeus_has_it():
    # Example 53.a, of 0 h TD; half a hundredth is rounding, 0.022 the axes of maps.
    time = np.datetime64("1992-04-11T23:59:01")
    earth, sun = ephemeris.earth_over_moon(time).overhead, ephemeris.sun_over("moon", time).overhead
    assert earth.longitude_deg - 360.0 == pytest.approx(-1.23, abs=0.028)
    assert earth.latitude_deg == pytest.approx(4.20, abs=0.028)
    assert sun.longitude_deg == pytest.approx(67.89, abs=0.028)
    assert sun.latitude_deg == pytest.approx(1.46, abs=0.028)


@pytest.mark.parametrize(
    ("over", "place", "elevation", "azimuth"),
    [
        ((0.0, 0.0), (0.0, 0.0), 90.0, None),
        ((0.0, 90.0), (0.0, 0.0), 0.0, 90.0),
        ((0.0, 180.0), (0.0, 0.0), -90.0, None),
        # At a pole the elevation is the declination.
        ((20.0, 30.0), (90.0, 0.0), 20.0, 150.0),
        ((20.0, 30.0), (-90.0, 0.0), -20.0, 30.0),
        # Over the date line, either way around.
        ((0.0, 179.0), (0.0, -179.0), 88.0, 270.0),
        ((0.0, -179.0), (0.0, 179.0), 88.0, 90.0),
    ],
)
def test_a_far_body_stands_where_the_sphere_says(over, place, elevation, azimuth):
    seen = ephemeris.in_sky(ephemeris.Overhead(*over, 1e15), *place, 6371.0)
    assert seen.elevation_deg == pytest.approx(elevation, abs=1e-9)
    if azimuth is not None:
        assert seen.azimuth_deg == pytest.approx(azimuth, abs=1e-9)


def test_a_body_on_the_horizon_is_lower_by_its_parallax_and_one_overhead_nearer():
    seen = ephemeris.in_sky(ephemeris.Overhead(0.0, 90.0, 384400.0), 0.0, 0.0, 1737.4)
    assert np.tan(-seen.elevation_deg * _DEG) == pytest.approx(1737.4 / 384400.0)
    above = ephemeris.in_sky(ephemeris.Overhead(0.0, 0.0, 384400.0), 0.0, 0.0, 1737.4)
    assert above.distance_km == pytest.approx(384400.0 - 1737.4)


@pytest.mark.parametrize("turn", [0.0, 30.0, -170.0])
def test_bearings_are_those_of_the_scene_where_its_y_is_not_north(turn):
    # x and y turned counterclockwise from east and north.
    c, s = np.cos(turn * _DEG), np.sin(turn * _DEG)
    place = Georeference("Moon", 1737400.0, 1737400.0, 0.0, 0.0, (c, -s, s, c))
    for azimuth in (0.0, 77.0, 359.0):
        far = 0.01 * _DEG
        north, east = np.cos(azimuth * _DEG) * far, np.sin(azimuth * _DEG) * far
        x, y = place.local(north / _DEG, east / _DEG)
        found = ephemeris.turned(azimuth, place.east_north)
        expected = np.arctan2(float(x), float(y)) / _DEG % 360.0
        assert (found - expected + 180.0) % 360.0 == pytest.approx(180.0, abs=1e-5)


#: A place on each body: what its file is laid out in, the body's degrees, the center in meters or
#: degrees, the pixel, the angle of rows to the coordinates' x. Polar stereographic y leans from
#: north by the longitude, that of UTM by the meridians' convergence.
_SITES = {
    "moon": ("IAU_2015:30135", "IAU_2015:30100", (-12_345.0, 9_876.0), 20.0, 0.0),
    "mars": ("IAU_2015:49900", "IAU_2015:49900", (77.45, 18.44), 3e-4, 0.0),
    "earth": ("EPSG:32633", "EPSG:4326", (700_000.0, 5_300_000.0), 0.5, 20.0),
}


@pytest.mark.parametrize("body", sorted(_SITES))
def test_a_sun_over_a_dem_of_gdals_stands_where_erfa_and_proj_have_it(tmp_path, body):
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import Affine
    from rasterio.warp import transform

    crs, degrees, center, pixel, turn = _SITES[body]
    rows = Affine.translation(*center) @ Affine.rotation(turn) @ Affine.scale(pixel, -pixel)
    layout = {"crs": crs, "transform": rows @ Affine.translation(-32, -32)}
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=64, height=64, count=1, dtype="float32",
        **layout,
    ) as file:  # fmt: skip
        file.write(np.zeros((64, 64), np.float32), 1)
    cfg = small_cfg(samples=2)
    cfg["terrain"]["relief"][0] = {"type": "dem", "file": "dem.tif"}
    time = "2031-05-06T10:00:00Z"
    cfg["light"]["sun"] = {"type": "ephemeris", "body": body, "time_utc": time, "step_s": 5400}
    compile_cfg(write_cfg(tmp_path, cfg), seed=5, out=tmp_path / "out")
    scene = read_stage(tmp_path / "out" / "batch_0000" / "stage.usda")
    # The scene's axes on the body: where PROJ puts the ends of a cross upon the file's plane.
    ends = np.array([(0, 0), (1, 0), (0, 1)]) * (1e-3 if pixel < 0.01 else 1.0) + center
    places = zip(*transform(crs, degrees, *ends.T.tolist()), strict=True)
    up, x, y = (_unit(ephemeris.Overhead(north, east, 0.0)) for east, north in places)
    x, y = (way / np.linalg.norm(way) for way in (x - up, y - up))
    radius = ephemeris.BODY_RADII_KM[body] / ephemeris.AU_KM
    for sample in range(2):
        at = np.datetime64(time[:-1]) + sample * np.timedelta64(5400, "s")
        way, distance = _by_erfa(*ephemeris.days_since_j2000(at))[body]
        seen = way - radius / distance * up
        expected = np.array([seen @ x, seen @ y, seen @ up]) / np.linalg.norm(seen)
        (sun,) = scene.lighting[sample].suns
        assert sun.time.body == body
        assert (sun.time.ls_deg is not None) == (body == "mars")
        assert np.datetime64(sun.time.time_utc[:-1]) == at
        assert sun_record(scene.lighting[sample]).time == sun.time
        chord = np.linalg.norm(sun.to_light - expected)
        assert 2.0 * np.arcsin(0.5 * chord) / _DEG < 0.9 / 60.0
