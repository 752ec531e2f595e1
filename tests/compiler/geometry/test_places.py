"""Places given by latitude and longitude lie where a sphere's own trigonometry puts them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenec.compiler.geometry.places import on_plane
from scenec.schemas.errors import SceneError
from scenec.schemas.georeference import Georeference

MOON = Georeference("Moon", 1_737_400.0, 1_737_400.0, -89.5, 40.0)


def at(latitude, longitude, here=MOON):
    return on_plane(np.array([[latitude, longitude, 7.5]]), here, "a file")[0]


@pytest.mark.parametrize(
    ("latitude", "longitude"), [(-89.5, 40.0), (-89.4, 60.0), (-90.0, 0.0), (-89.9, 220.0)]
)
def test_distance_and_height_are_those_on_the_sphere(latitude, longitude):
    x, y, z = at(latitude, longitude)
    a, b, turn = np.radians([latitude, MOON.latitude_deg, longitude - MOON.longitude_deg])
    cosine = np.sin(a) * np.sin(b) + np.cos(a) * np.cos(b) * np.cos(turn)
    # The plane touches the sphere: distances in it are the radius times the sine of the angle.
    expected = MOON.semi_major_m * np.sqrt(max(1.0 - cosine * cosine, 0.0))
    assert np.hypot(x, y) == pytest.approx(expected, abs=0.02)
    assert z == 7.5


def test_the_pole_is_south_of_what_lies_in_the_south():
    x, y, _ = at(-90.0, 123.0)
    assert abs(x) < 1e-6
    assert y == pytest.approx(-MOON.semi_major_m * np.sin(np.radians(0.5)), rel=1e-9)


def test_the_date_line_is_no_border():
    here = replace(MOON, latitude_deg=10.0, longitude_deg=179.999)
    for longitude in (-179.999, 180.001):
        assert at(10.0, longitude, here)[0] == pytest.approx(
            1_737_400.0 * np.radians(0.002) * np.cos(np.radians(10.0)), rel=1e-6
        )


@pytest.mark.parametrize(
    ("latitude", "longitude", "here", "said"),
    [
        (1.0, 1.0, None, "a file: latitude_deg and longitude_deg: the terrain lies nowhere on a"),
        (80.0, 0.0, MOON, "a file: place 1 is at 80° N, 0° E: expected"),
        (-90.5, 0.0, MOON, "expected a latitude from -90 to 90"),
        (-89.0, 361.0, MOON, "a longitude from -360 to 360"),
    ],
)
def test_a_place_that_is_none_is_named(latitude, longitude, here, said):
    with pytest.raises(SceneError) as caught:
        at(latitude, longitude, here)
    assert said in str(caught.value)
