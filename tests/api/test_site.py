"""What pages show of the ground under a vehicle: against a bent plane whose slopes are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenec.api.site import site_of
from scenec.backends.stage.read import _bounds
from scenec.backends.stage.scene import RenderScene
from scenec.datasets.view.site import site_planes
from scenec.schemas.vehicle import Vehicle
from scenec.testing.scenes import affine, camera, grid, scene

DRIVES = Vehicle(wheel_base_m=1.0, slope_deg=25.0, step_m=1.0, clearance_m=1.0)


def bent(vehicle: Vehicle | None = DRIVES, side: int = 33) -> RenderScene:
    """Level in the west, 15 degrees steep in the middle, 40 in the east: 8 m a side."""
    x = np.linspace(0.0, 8.0, side)
    rises = np.where(
        x < 2.0, 0.0, np.where(x < 5.0, np.tan(np.radians(15)), np.tan(np.radians(40)))
    )
    z = np.concatenate([[0.0], np.cumsum(rises[:-1] * np.diff(x))])
    rider = replace(camera(), vehicle=vehicle)
    made = scene([grid(np.tile(z, (side, 1)), x[1])], [(0, affine())], [0], [rider])
    return replace(made, bounds=_bounds(made.meshes, made.rows))


def test_slopes_and_classes_are_those_of_the_planes():
    site = site_of(bent(), 200)
    assert site.vehicle == DRIVES
    assert site.cell_m == DRIVES.cell_m
    x = site.corner[0] + site.cell_m * np.arange(site.slope.shape[1])
    row = site.slope.shape[0] // 2
    # A disc of half a wheelbase, and half a wheel, lies on one plane.
    for low, high, slope, kind in ((-4, -2, 0, 1), (-2, 1, 15, 2), (1, 4, 40, 3)):
        own = (x > low + 0.02) & (x < high - 0.02)
        assert site.slope[row, own] == pytest.approx(slope, abs=1e-3)
        inner = (x > low + 0.8) & (x < high - 0.8)
        assert set(site.classes[row, inner]) == {kind}
    y = site.corner[1] + site.cell_m * np.arange(site.slope.shape[0])
    assert (x[0], y[0]) == pytest.approx((-4 + site.cell_m / 2,) * 2, abs=site.cell_m)


@pytest.mark.parametrize(("cells", "layers"), [(200, 2), (33, 2), (31, 1), (1, 1)])
def test_cells_that_are_too_coarse_for_a_vehicle_have_slopes_alone(cells, layers):
    site = site_of(bent(), cells)
    facts, data = site_planes(site, 1000)
    assert [layer["name"] for layer in facts["layers"]] == ["slope", "traversability"][:layers]
    assert len(data) == layers * np.prod(facts["size"])


def test_the_default_vehicle_is_that_of_the_pass_and_nothing_is_no_site():
    assert site_of(bent(None), 100).vehicle == Vehicle()
    empty = scene([], [])
    assert site_of(empty, 100) is None


@pytest.mark.parametrize("side", [1000, 20, 1])
def test_what_a_page_stores_is_the_worst_class_and_slopes_within_a_quarter_degree(side):
    site = site_of(bent(), 200)
    facts, data = site_planes(site, side, heights=True)
    nx, ny = facts["size"]
    assert max(nx, ny) <= side
    slope, classes = np.frombuffer(data, np.uint8, 2 * nx * ny).reshape(2, ny, nx)
    z = np.frombuffer(data, "<u2", offset=2 * nx * ny).reshape(ny, nx)
    every = round(facts["step"] / site.cell_m)
    step = facts["layers"][0]["step"]
    found = np.where(slope == 0, np.nan, (slope - 1.0) * step)
    np.testing.assert_allclose(found, site.slope[::every, ::every], atol=0.5 * step + 1e-6)
    low, high = facts["heights"]
    heights = low + (z - 1.0) / 65534 * (high - low)
    np.testing.assert_allclose(heights, site.heights[::every, ::every], atol=1e-4)
    for j, i in np.ndindex(ny, nx):
        block = site.classes[j * every : (j + 1) * every, i * every : (i + 1) * every]
        assert classes[j, i] == block.max() + 1
