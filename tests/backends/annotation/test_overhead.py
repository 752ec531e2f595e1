"""Maps from above: heights are the mesh's, the sun's light is geometry's, burial is a ball's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scenec.backends.annotation import overhead
from scenec.backends.annotation.instances import Instances
from scenec.backends.annotation.overhead import map_tile
from scenec.backends.annotation.overhead_tables import (
    ground_area,
    objects_table,
    paths_table,
    world_boxes,
)
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import _bounds
from scenec.backends.stage.scene import Lighting, RenderScene
from scenec.backends.testing.scenes import affine, icosphere, plane, sun
from scenec.schemas import site_map
from scenec.schemas.errors import OutputError
from scenec.schemas.site_map import LAYERS, MapGrid, MapOptions
from scenec.testing.scenes import camera, grid, mesh, rocky, scene

ALL = (*(name for name in LAYERS if name not in ("label", "sun")), "label_class")


def bounded(made: RenderScene) -> RenderScene:
    return replace(made, bounds=_bounds(made.meshes, made.rows))


def mapped(made: RenderScene, area: MapGrid, layers=("height",), **options):
    """One tile that is all of it."""
    asked = MapOptions(cell_m=area.cell_m, **options)
    return map_tile(made, ExactCaster(made), area, (0, 0), asked, layers)


def below(made: RenderScene, x: float, y: float) -> tuple[float, int]:
    """Highest point of all triangles over a place, by barycentric coordinates, and its instance."""
    best = -math.inf, 0
    for row, (index, matrix) in enumerate(zip(made.rows.mesh, made.rows.to_world, strict=True)):
        of = made.meshes[index]
        points = of.points.astype(float) @ matrix[:, :3].T + matrix[:, 3]
        a, b, c = points[of.faces].transpose(1, 0, 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (
                c[:, 0] - a[:, 0]
            )
            u = ((b[:, 0] - x) * (c[:, 1] - y) - (b[:, 1] - y) * (c[:, 0] - x)) / area
            v = ((c[:, 0] - x) * (a[:, 1] - y) - (c[:, 1] - y) * (a[:, 0] - x)) / area
            z = u * a[:, 2] + v * b[:, 2] + (1 - u - v) * c[:, 2]
        inside = (u >= 0) & (v >= 0) & (u + v <= 1)
        if inside.any() and z[inside].max() > best[0]:
            best = float(z[inside].max()), int(made.rows.instance_id[row])
    return best


def test_heights_and_ids_are_those_of_the_highest_triangle_over_each_cell():
    made = bounded(rocky(80, cells=50, size_m=10.0, subdivisions=2))
    area = MapGrid.over((-5.0, -5.0, 5.0, 5.0), 0.11)
    found = mapped(made, area, ("height", "instance", "label_class"))
    rng = np.random.default_rng(1)
    rows, columns = rng.integers(0, area.height, 300), rng.integers(0, area.width, 300)
    rock = np.argwhere(found["instance"])[::40]
    x, y = area.centers((0, 0), (area.height, area.width))
    for row, column in [*zip(rows, columns, strict=True), *rock]:
        expected, owner = below(made, x[column], y[row])
        height = found["height"][row, column]
        if not math.isfinite(expected):
            assert np.isnan(height)
            continue
        assert height == np.float32(height)
        assert height == pytest.approx(expected, abs=1e-6)
        assert found["instance"][row, column] == owner
        assert found["label_class"][row, column] == (3 if owner else 2)


def test_a_balls_profile_is_that_of_its_sphere():
    points, faces = icosphere(5)
    made = bounded(scene([mesh(points, faces)], [(0, affine(2.0 * np.eye(3), (0.3, -0.2, 5.0)))]))
    area = MapGrid.over((-2.0, -2.5, 2.6, 2.1), 0.07)
    found = mapped(made, area, ("height", "slope"))
    x, y = np.meshgrid(*area.centers((0, 0), (area.height, area.width)))
    away = np.hypot(x - 0.3, y + 0.2)
    inside = away < 1.9
    true = 5.0 + np.sqrt(4.0 - np.minimum(away, 2) ** 2)
    # Chords of triangles with sides of 1/16 of the radius.
    assert np.abs(found["height"] - true)[inside].max() < 0.004
    angle = np.degrees(np.arcsin(np.minimum(away / 2.0, 1.0)))
    assert np.abs(found["slope"] - angle)[inside].max() < 3.5
    assert np.isnan(found["height"][away > 2.0]).all()


@pytest.mark.parametrize("tile", [17, 64])
def test_tiles_and_areas_do_not_change_what_a_cell_is(tile, monkeypatch):
    made = bounded(rocky(200, cells=60, size_m=12.0))
    caster, area = ExactCaster(made), MapGrid.over((-6.0, -6.0, 6.0, 6.0), 0.1)
    options = MapOptions(cell_m=0.1)
    whole = map_tile(made, caster, area, (0, 0), options, ALL)
    with monkeypatch.context() as patch:
        patch.setattr(site_map, "TILE", tile)
        for first in area.tiles:
            height, width = area.extent(first)
            part = map_tile(made, caster, area, first, options, ALL)
            for name, values in part.items():
                there = whole[name][first[0] :, first[1] :][:height, :width]
                np.testing.assert_array_equal(values, there, err_msg=name)
        assert sum(math.prod(area.extent(first)) for first in area.tiles) == 120 * 120
    # An area within has the surroundings of the whole.
    inner = MapGrid.over((-3.0, -2.0, 2.0, 3.0), 0.1)
    part = map_tile(made, caster, inner, (0, 0), options, ALL)
    for name, values in part.items():
        np.testing.assert_allclose(values, whole[name][30:80, 30:80], atol=1e-5, err_msg=name)


def box_on_plane(height: float) -> RenderScene:
    """A box, 1 m wide along x and 8 m along y, on a plane at z = 0."""
    points, faces = plane(30.0)
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-4, 4) for z in (0, height)])
    # Two triangles a side, whichever way round.
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (1, 3, 7, 5)]
    box = [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]
    made = scene([mesh(points, faces), mesh(corners, box)], [(0, affine()), (1, affine())], [0, 1])
    return bounded(made)


@pytest.mark.parametrize("elevation", [8.0, 30.0, 60.0])
def test_the_shadow_of_a_box_is_as_long_as_its_height_over_the_tangent(elevation):
    made = box_on_plane(0.7)
    lit = Lighting((sun(elevation, 180.0), sun(90.0, irradiance=1.0)), ())
    made = replace(made, lighting=(lit,))
    area = MapGrid.over((-2.0, -1.0, 8.0, 1.0), 0.01)
    found = mapped(made, area, ("sun",))["sun"]
    x, _ = area.centers((0, 0), (area.height, area.width))
    end = 0.5 + 0.7 / math.tan(math.radians(elevation))
    # The sun is in the west: the box's top and the ground before it are lit.
    expected = np.where((x > 0.5) & (x < end), 0.0, 1.0)
    np.testing.assert_array_equal(found, np.broadcast_to(expected, found.shape))


def test_a_penumbra_has_the_share_of_the_disc_that_the_edge_leaves():
    diameter, elevation, height = 4.0, 30.0, 3.0
    made = box_on_plane(height)
    made = replace(made, lighting=(Lighting((sun(elevation, 180.0, diameter_deg=diameter),), ()),))
    area = MapGrid.over((4.5, -0.05, 7.5, 0.05), 0.1)
    found = mapped(made, area, ("sun",), sun_rays=2048)["sun"][0]
    x, _ = area.centers((0, 0), (area.height, area.width))
    # Height of the box's edge above the disc's center, in radii of the disc in the plane across.
    edge = np.degrees(np.arctan2(height, x - 0.5)) - elevation
    t = np.clip(np.tan(np.radians(edge)) / math.tan(math.radians(diameter / 2)), -1, 1)
    above = (np.arccos(t) - t * np.sqrt(1 - t * t)) / math.pi
    assert (above == 0).any()
    assert (above == 1).any()
    np.testing.assert_allclose(found, above, atol=0.004)


def test_a_place_that_faces_away_from_the_sun_is_dark_without_a_ray():
    x = np.linspace(-10, 10, 41)
    ridge = np.broadcast_to(-np.abs(x) * 2.0, (41, 41))
    made = bounded(scene([grid(np.ascontiguousarray(ridge), 0.5)], [(0, affine())], [0]))
    made = replace(made, lighting=(Lighting((sun(40.0, 0.0),), ()),))
    area = MapGrid.over((-9.0, -1.0, 9.0, 1.0), 0.1)
    found = mapped(made, area, ("sun",))["sun"]
    x, _ = area.centers((0, 0), (area.height, area.width))
    np.testing.assert_array_equal(found, np.broadcast_to(np.where(x > 0, 1.0, 0.0), found.shape))


def test_without_a_sun_nobody_knows():
    made = box_on_plane(1.0)
    found = mapped(made, MapGrid.over((-1, -1, 1, 1), 0.2), ("sun",))["sun"]
    assert np.isnan(found).all()


def test_balls_are_buried_as_deep_as_they_were_sunk():
    points, faces = icosphere(4)
    flat = plane(50.0)
    ball = mesh(points, faces)
    sunk = np.array([0.0, 0.25, 0.5, 0.9, 1.0])
    at = [(3.0 * k, -2.0, 1.5 + 0.4 * (1.0 - 2.0 * s)) for k, s in enumerate(sunk)]
    rng = np.random.default_rng(0)
    turns = Rotation.random(len(sunk), rng=rng).as_matrix()
    rows = [(0, affine(offset=(0, 0, 1.5)))]
    rows += [(1, affine(0.4 * turn, place)) for turn, place in zip(turns, at, strict=True)]
    rows += [(1, affine(offset=(80.0, 0.0, 0.0)))]
    made = bounded(scene([mesh(*flat), ball], rows, range(7)))
    made = replace(made, instance_paths={"/World/balls": 0})
    area = ground_area(made)
    assert area == (-50.0, -50.0, 50.0, 50.0)
    table = objects_table(made, ExactCaster(made, trees=False), Instances(made), 0, area)
    np.testing.assert_array_equal(table["instance"], [1, 2, 3, 4, 5])
    assert table["class"] == ["/World/balls"] * 5
    np.testing.assert_allclose(table["x_m"], 3.0 * np.arange(5), atol=2e-3)
    np.testing.assert_allclose(table["ground_m"], 1.5, atol=1e-6)
    np.testing.assert_allclose(table["height_m"], 0.8, rtol=4e-3)
    np.testing.assert_allclose(table["size_m"], 0.8, rtol=4e-3)
    np.testing.assert_allclose(table["burial"], sunk, atol=4e-3)
    np.testing.assert_allclose(table["above_ground_m"], 0.8 * (1 - sunk), atol=4e-3)
    # Beyond the ground there is none to lie in.
    beyond = objects_table(
        made, ExactCaster(made, trees=False), Instances(made), 0, (70.0, -9.0, 90.0, 9.0)
    )
    np.testing.assert_array_equal(beyond["instance"], [6])
    assert np.isnan(beyond["burial"]).all()


def test_boxes_of_rows_hold_their_vertices_exactly():
    made = rocky(30, cells=10, size_m=5.0, subdivisions=1)
    found = world_boxes(made, np.arange(31), 0)
    for row in (0, 5, 30):
        of = made.meshes[made.rows.mesh[row]]
        matrix = made.rows.to_world[row]
        points = of.points.astype(float) @ matrix[:, :3].T + matrix[:, 3]
        np.testing.assert_allclose(found[row], [points.min(0), points.max(0)], rtol=1e-12)


@pytest.mark.parametrize(
    ("target", "heading", "pitch"),
    [((0, 1, 0), 0, 0), ((1, 0, 1), 90, 45), ((0, -1, 0), 180, 0), ((-1, 0, -1), 270, -45)],
)
def test_paths_say_where_cameras_look(target, heading, pitch):
    at = np.array([4.0, 5.0, 6.0])
    made = scene([mesh(*plane())], [(0, affine())], [0], [camera(eye=at, target=at + target)])
    table = paths_table(made)
    assert table["camera"] == ["test_front"]
    assert (table["x_m"][0], table["y_m"][0], table["z_m"][0]) == (4.0, 5.0, 6.0)
    assert table["heading_deg"][0] == pytest.approx(heading)
    assert table["pitch_deg"][0] == pytest.approx(pitch)


@pytest.mark.parametrize(
    ("area", "cell", "shape"),
    [
        ((-50, -50, 50, 50), 0.05, (2000, 2000)),
        ((0, 0, 0.3, 0.1), 0.1, (1, 3)),
        ((0, 0, 0.31, 0.1), 0.1, (1, 4)),
        ((0, 0, 0.01, 0.01), 0.1, (1, 1)),
        ((0, 0, 0, 1), 0.1, "expected WEST,SOUTH,EAST,NORTH"),
        ((0, 2, 1, 1), 0.1, "expected WEST,SOUTH,EAST,NORTH"),
        ((0, 0, math.inf, 1), 0.1, "expected WEST,SOUTH,EAST,NORTH"),
        ((0, 0, 1e6, 1e6), 0.1, "1e[+]07 x 1e[+]07 cells of 0.1 m: at most"),
    ],
)
def test_grids_cover_their_area_and_no_more(area, cell, shape):
    if isinstance(shape, str):
        with pytest.raises(OutputError, match=shape):
            MapGrid.over(area, cell)
    else:
        found = MapGrid.over(area, cell)
        assert (found.height, found.width) == shape


def test_points_of_the_disc_are_in_it_and_spread_evenly():
    toward = overhead.brightest(
        replace(box_on_plane(1.0), lighting=(Lighting((sun(20.0, 70.0, diameter_deg=3.0),), ()),)),
        0,
    )
    directions = np.array(overhead._disc(toward, 1000))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    away = np.degrees(np.arccos(directions @ toward[:3]))
    assert away.max() < 1.5
    # Of a disc half of the area is within the radius over the root of two.
    assert abs((away < 1.5 * math.sqrt(0.5)).mean() - 0.5) < 0.002
    np.testing.assert_allclose(directions.mean(axis=0), toward[:3], atol=2e-4)
