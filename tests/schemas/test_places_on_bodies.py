"""Places in a scene and on a body, against PROJ and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from scenec.compiler.geometry.lenses import FUNCTIONS
from scenec.schemas.georeference import Georeference, body_of
from scenec.schemas.lens import NUMPY

MOON = Georeference("Moon", 1_737_400.0, 1_737_400.0, 0.0, 0.0)
PLACES = [
    replace(MOON, latitude_deg=-89.9, longitude_deg=137.0),
    replace(MOON, latitude_deg=-90.0, longitude_deg=0.0),
    replace(MOON, latitude_deg=90.0, longitude_deg=-90.0),
    Georeference("Mars", 3_396_190.0, 3_376_200.0, 18.44, 77.45),
    Georeference("Mars", 3_396_190.0, 3_376_200.0, -4.6, 180.0),
    Georeference("Earth", 6_378_137.0, 6_356_752.314245, 51.5, -0.1),
    Georeference("Earth", 6_378_137.0, 6_356_752.314245, -0.001, 179.9999),
]
NAMES = [f"{p.body} {p.latitude_deg:g} {p.longitude_deg:g}" for p in PLACES]
GRID = np.stack(np.meshgrid(np.linspace(-2e4, 2e4, 9), np.linspace(-2e4, 2e4, 9))).reshape(2, -1)


def meters_apart(place, latitude, longitude, others) -> np.ndarray:
    """Between places on the ellipsoid by their angles, to first order."""
    north = np.radians(latitude - others[0]) * place.semi_major_m
    turn = (longitude - others[1] + 180.0) % 360.0 - 180.0
    return np.hypot(north, np.radians(turn) * np.cos(np.radians(latitude)) * place.semi_major_m)


@pytest.mark.parametrize("functions", [NUMPY, FUNCTIONS], ids=["numpy", "compiler"])
@pytest.mark.parametrize("place", PLACES, ids=NAMES)
def test_places_are_those_of_projs_orthographic_projection(place, functions):
    warp = pytest.importorskip("rasterio.warp")
    body = f"+proj=longlat +a={place.semi_major_m!r} +b={place.semi_minor_m!r}"
    latitude, longitude = place.latitude_longitude(*GRID, functions)
    plane, affine = place.plane()
    assert affine == (1, 0, 0, 0, 1, 0)
    there = warp.transform(plane, body, *GRID.tolist())
    assert meters_apart(place, latitude, longitude, np.array(there)[::-1]).max() < 1e-6
    back = warp.transform(body, plane, longitude.tolist(), latitude.tolist())
    assert np.abs(np.array(back) - GRID).max() < 1e-6
    assert np.abs(np.array(place.local(latitude, longitude, functions)) - GRID).max() < 1e-7


def test_a_quarter_of_the_moon_from_its_pole_is_its_equator():
    pole = replace(MOON, latitude_deg=-90.0)
    latitude, longitude = pole.latitude_longitude([0.0, 1_737_400.0], [1_737_400.0, 0.0])
    assert np.allclose(latitude, 0.0, atol=1e-5)
    assert np.allclose(longitude, [0.0, 90.0])


def test_what_the_body_hides_has_no_place():
    assert np.isnan(MOON.latitude_longitude(1_737_401.0, 0.0)).all()
    assert np.isnan(MOON.local(0.0, [91.0, 180.0])).all()
    assert np.isfinite(MOON.local(0.0, 89.0)).all()


def test_a_turned_and_stretched_plane_is_undone():
    turned = replace(PLACES[3], east_north=(0.8, -0.61, 0.59, 0.79))
    latitude, longitude = turned.latitude_longitude(*GRID)
    assert np.allclose(turned.local(latitude, longitude), GRID, atol=1e-7)
    east, north = PLACES[3].local(latitude, longitude)
    assert np.allclose(east, 0.8 * GRID[0] - 0.61 * GRID[1], atol=1e-7)
    assert np.allclose(north, 0.59 * GRID[0] + 0.79 * GRID[1], atol=1e-7)


@pytest.mark.parametrize("distance", [10.0, 1e4, 3e5])
def test_distances_are_shortened_by_no_more_than_the_bound(distance):
    # On a sphere the ground's distance is an arc, the plane's its sine.
    lost = MOON.semi_major_m * math.asin(distance / MOON.semi_major_m) - distance
    bound = MOON.shortening_m(distance)
    assert lost <= bound + 1e-9
    assert bound <= 1.25 * lost + 1e-9
    assert MOON.shortening_m(2e6) == math.inf


@pytest.mark.parametrize(
    ("words", "radius", "body"),
    [
        ("Moon_2000_IAU_IAG", 1_737_400.0, "Moon"),
        ("unknown", 1_737_400.0, "Moon"),
        ("D_MARS", 3_389_500.0, "Mars"),
        ("Ionian position", 6_378_137.0, "Earth"),
        ("WGS 84", 6_378_137.0, "Earth"),
        ("unknown", 1.0, ""),
    ],
)
def test_bodies_are_known_by_name_or_radius(words, radius, body):
    assert body_of(words, radius) == body
