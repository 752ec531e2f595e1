"""Slopes, and what ground is to a vehicle, against closed forms and fits by other means."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import j1, jn

from scenec.backends.annotation.annotate import annotate
from scenec.backends.annotation.overhead import map_tile
from scenec.backends.annotation.terrain import ground_under
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import _bounds
from scenec.backends.testing.scenes import affine, look_at
from scenec.schemas.errors import OutputError
from scenec.schemas.site_map import MapGrid, MapOptions
from scenec.schemas.vehicle import Vehicle
from scenec.testing.examples import examples
from scenec.testing.scenes import grid, rocky, scene

#: Radii of discs in cells, of which the last are too wide for a fit to every cell.
RADII = (2, 5, 7, 10, 13, 24)


def at_cells(height, radius: float, wheel: int = 1, cells: int = 5, cell: float = 0.1):
    """Ground under a vehicle of a disc of so many cells, on a function of x and y."""
    vehicle = Vehicle(wheel_base_m=2 * radius * cell, wheel_m=2 * wheel * cell)
    reach = vehicle.reach(cell)
    at = (np.arange(cells + 2 * reach) - reach) * cell
    x, y = np.meshgrid(at, at)
    return ground_under(height(x, y)[None], cell, vehicle), at[reach : reach + cells]


@examples(20)
@given(st.floats(0, 80), st.floats(0, 360), st.sampled_from(RADII), st.integers(1, 4))
def test_a_plane_has_its_slope_no_roughness_and_steps_of_a_wheel(slope, turn, radius, wheel):
    steep = math.tan(math.radians(slope))
    a, b = steep * math.cos(math.radians(turn)), steep * math.sin(math.radians(turn))
    found, _ = at_cells(lambda x, y: 7.0 + a * x + b * y, radius, wheel)
    np.testing.assert_allclose(found.tilt, slope, atol=1e-9)
    assert found.roughness.max() < 1e-6 * (1 + steep)
    assert np.abs(found.obstacle).max() < 1e-12 * (1 + steep) * radius
    # The lattice's disc has points no farther apart along the gradient than its diameter.
    most = 2 * wheel * 0.1 * steep
    assert (found.step <= most * (1 + 1e-9) + 1e-12).all()
    assert (found.step >= most * math.sqrt(0.5) * (1 - 1e-9) - 1e-12).all()


@pytest.mark.parametrize("radius", RADII)
def test_any_ground_is_that_of_a_fit_by_linear_algebra(radius):
    rng = np.random.default_rng(radius)
    vehicle = Vehicle(wheel_base_m=2 * radius * 0.1, wheel_m=0.4)
    reach = vehicle.reach(0.1)
    z = rng.normal(size=(2, 3 + 2 * reach, 4 + 2 * reach))
    found = ground_under(z, 0.1, vehicle)
    at = np.arange(-radius, radius + 1)
    dx, dy = np.meshgrid(at, at)
    inside = dx**2 + dy**2 <= radius**2
    stride = -(-radius // 10.5)
    fitted = inside & (dx % stride == 0) & (dy % stride == 0)
    wheel = [(i, j) for i in range(-2, 3) for j in range(-2, 3) if i * i + j * j <= 4]
    for n, row, column in ((0, 0, 0), (1, 2, 3), (1, 1, 2)):
        middle = reach + row, reach + column
        patch = z[n, middle[0] - radius :, middle[1] - radius :][: len(at), : len(at)]
        design = np.column_stack([0.1 * dx[fitted], 0.1 * dy[fitted], np.ones(fitted.sum())])
        plane, *_ = np.linalg.lstsq(design, patch[fitted])
        rest = patch - (plane[0] * 0.1 * dx + plane[1] * 0.1 * dy + plane[2])
        steps = [
            np.ptp([z[n, middle[0] + j + q, middle[1] + i + p] for p, q in wheel])
            for i, j in zip(dx[inside].tolist(), dy[inside].tolist(), strict=True)
        ]
        expected = [
            np.degrees(np.arctan(np.hypot(*plane[:2]))),
            np.sqrt((rest[fitted] ** 2).mean()),
            max(steps),
            rest[inside].max(),
        ]
        got = [getattr(found, name)[n, row, column]
               for name in ("tilt", "roughness", "step", "obstacle")]  # fmt: skip
        np.testing.assert_allclose(got, expected, rtol=1e-9)


@pytest.mark.parametrize("waves", [0.7, 1.5, 4.0])
def test_a_sinusoid_has_the_roughness_of_its_integral_over_the_disc(waves):
    """Of A sin(k x) less its plane: A² (1/2 - cos(2 k x) J1(2 k R) / (2 k R)) - c² - a² R² / 4."""
    cells, amplitude = 40, 0.3
    radius = cells * 0.1
    k = 2 * math.pi * waves / radius
    found, x = at_cells(lambda x, y: amplitude * np.sin(k * x), cells)
    square = 0.5 - np.cos(2 * k * x) * j1(2 * k * radius) / (2 * k * radius)
    mean = 2 * j1(k * radius) / (k * radius) * np.sin(k * x)
    slope = 8 * jn(2, k * radius) / (k * radius**2) * np.cos(k * x)
    expected = amplitude * np.sqrt(square - mean**2 - slope**2 * radius**2 / 4)
    # The fit's lattice has 21 cells across.
    np.testing.assert_allclose(found.roughness[0, 2], expected, rtol=0.02)


def test_a_step_is_as_high_as_it_is_where_a_wheel_can_meet_it_and_nowhere_else():
    vehicle = Vehicle(wheel_base_m=1.0, wheel_m=0.2)
    reach, cells = vehicle.reach(0.1), 41
    x = (np.arange(cells + 2 * reach) - reach - 20) * 0.1
    z = np.broadcast_to(np.where(x > 0.05, 0.4, 0.0), (len(x), len(x)))
    found = ground_under(np.ascontiguousarray(z)[None], 0.1, vehicle)
    x = x[reach:-reach]
    near = (x > 0.05 - 0.61) & (x < 0.05 + 0.61)
    np.testing.assert_array_equal(found.step[0, 3], np.where(near, 0.4, 0.0))
    assert (found.classes(vehicle)[0, 3][near] == 3).all()
    assert (found.classes(vehicle)[0, 3][~near] == 1).all()


def test_what_is_not_known_under_any_cell_of_the_disc_is_not_known():
    vehicle = Vehicle(wheel_base_m=1.2, wheel_m=0.2)
    reach, cells = vehicle.reach(0.1), 31
    z = np.zeros((1, cells + 2 * reach, cells + 2 * reach))
    z[0, reach + 12, reach + 17] = np.nan
    found = ground_under(z, 0.1, vehicle)
    row, column = np.indices((cells, cells))
    hole = (row - 12) ** 2 + (column - 17) ** 2 <= 36
    for name in ("tilt", "roughness", "step", "obstacle"):
        np.testing.assert_array_equal(np.isnan(getattr(found, name)[0]), hole)
    np.testing.assert_array_equal(found.classes(vehicle)[0] == 0, hole)


#: What stands at the middle of flat ground, or how steep it is, and the class of the place.
CASES = [
    ({}, lambda x, y: 0 * x, 1),
    ({}, lambda x, y: np.tan(np.radians(14.9)) * x, 1),
    ({}, lambda x, y: np.tan(np.radians(15.1)) * y, 2),
    ({}, lambda x, y: np.tan(np.radians(29.9)) * y, 2),
    ({"step_m": 1, "clearance_m": 9}, lambda x, y: np.tan(np.radians(30.1)) * y, 3),
    # A stone of one cell: the plane rises by its share of the disc, 1 in 149.
    ({}, lambda x, y: 0.12 * ((x == 0) & (y == 0)), 1),
    ({}, lambda x, y: 0.13 * ((x == 0) & (y == 0)), 2),
    ({}, lambda x, y: 0.26 * ((x == 0) & (y == 0)), 3),
    ({"step_m": 1}, lambda x, y: 0.26 * ((x == 0) & (y == 0)), 2),
    ({"step_m": 1}, lambda x, y: 0.30 * ((x == 0) & (y == 0)), 3),
    ({"caution": 1.0}, lambda x, y: 0.24 * ((x == 0) & (y == 0)), 1),
    ({}, lambda x, y: np.where(x > 5, np.nan, 0.0), 1),
    ({}, lambda x, y: np.where(x > 0.65, np.nan, 0.0), 0),
]


@pytest.mark.parametrize(("change", "height", "expected"), CASES)
def test_classes_follow_what_the_vehicle_takes(change, height, expected):
    vehicle = Vehicle(**change)
    reach = vehicle.reach(0.1)
    at = np.arange(-reach, reach + 1) * 0.1
    x, y = np.meshgrid(at, at)
    z = np.asarray(height(x, y), np.float64)
    assert ground_under(z[None], 0.1, vehicle).classes(vehicle)[0, 0, 0] == expected


@pytest.mark.parametrize(
    ("change", "cell", "message"),
    [
        ({"slope_deg": 91}, 0.1, "slope_deg=91: expected a number above 0, up to 90"),
        ({"wheel_m": 0}, 0.1, "wheel_m=0: expected"),
        ({"caution": math.nan}, 0.1, "caution=nan"),
        ({}, 0.4, "cell_m=0.4: expected above 0 and at most 0.35"),
        ({}, 0.0, "cell_m=0: expected"),
    ],
)
def test_vehicles_that_cannot_be_are_refused(change, cell, message):
    with pytest.raises(OutputError, match=message):
        Vehicle(**change).disc(cell)


@pytest.fixture(scope="module")
def rocks():
    """Rough ground with rocks, and a camera that sees both and the sky."""
    made = rocky(60, cells=60, size_m=12.0)
    made = replace(made, bounds=_bounds(made.meshes, made.rows))
    return made, ExactCaster(made)


def test_the_pass_slope_is_that_of_its_normals(rocks):
    made, caster = rocks
    found = annotate(made, caster, look_at((0, 0, 3), (4, 1, 0), 64, 48), ("slope", "normal"), 0)
    normal, slope = found.arrays["normal"], found.arrays["slope"]
    hit = normal.any(axis=-1)
    assert hit.any()
    cosine = np.abs(normal[hit][:, 2]).clip(0, 1)
    np.testing.assert_allclose(np.cos(np.radians(slope[hit])), cosine, atol=1e-12)
    assert np.isnan(slope[~hit]).all()


@pytest.mark.parametrize("steep", [0.0, 0.3, 2.0])
def test_the_pass_slope_of_a_plane_is_its_angle_from_either_side(steep):
    x = np.linspace(-20, 20, 5)
    made = scene([grid(np.tile(steep * x, (5, 1)), 10.0)], [(0, affine())])
    for eye in ((0.0, 0.0, 5.0), (0.0, 0.0, -5.0)):
        seen = annotate(made, ExactCaster(made), look_at(eye, (0, 0, 0)), ("slope",), 0)
        slope = seen.arrays["slope"]
        assert np.isfinite(slope).any()
        np.testing.assert_allclose(
            slope[np.isfinite(slope)], np.degrees(np.arctan(steep)), atol=1e-6
        )


@pytest.mark.parametrize("vehicle", [Vehicle(), Vehicle(wheel_base_m=0.6, step_m=0.1, wheel_m=0.3)])
def test_the_pass_traversable_is_the_map_at_the_cells_that_pixels_show(rocks, vehicle):
    made, caster = rocks
    camera = replace(look_at((-1, 0.5, 2.5), (2, 1, 0), 80, 60), vehicle=vehicle)
    found = annotate(made, caster, camera, ("traversable", "position", "depth"), 0).arrays
    cell = vehicle.cell_m
    side = math.ceil(7.0 / cell)
    area = MapGrid(-side * cell, side * cell, cell, 2 * side, 2 * side)
    options = MapOptions(vehicle=vehicle)
    layer = map_tile(made, caster, area, (0, 0), options, ("traversability",))["traversability"]
    hit = np.isfinite(found["depth"])
    place = np.floor(found["position"][hit][:, :2] / cell).astype(int)
    np.testing.assert_array_equal(
        found["traversable"][hit], layer[side - 1 - place[:, 1], side + place[:, 0]]
    )
    assert set(np.unique(found["traversable"][hit])) >= {1, 2, 3}
    assert (found["traversable"][~hit] == 0).all()
    assert found["traversable"].dtype == np.uint32
