"""Rocks: sound meshes, exact counts, densities as asked, seated on the ground."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from scenec.compiler.distributions.streams import Streams
from scenec.compiler.geometry.icosphere import icosphere
from scenec.compiler.geometry.rotations import align_to_normals, rotation_rows
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.bodies import Bodies
from scenec.compiler.objects.density import Density, NoiseDensity, UniformDensity
from scenec.compiler.objects.families.shape import Shape
from scenec.compiler.objects.families.weathered import WeatheredRock
from scenec.compiler.objects.height_candidates import candidates_on
from scenec.compiler.objects.height_pyramid import HeightPyramid, plane_above
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.objects.rocks import build_prototypes
from scenec.compiler.objects.seating import seat
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import Multifractal


def shape(seed: int, angularity: float = 0.6, bumpiness: float = 0.25, level: int = 3) -> Shape:
    drawn = WeatheredRock.draw("rock", Streams(seed, 0), 1.0 - angularity)
    return WeatheredRock(seed, bumpiness, (1.0, 0.8, 0.6), level, drawn)


def relief() -> HeightField:
    grid = Grid.with_spacing((40.0, 40.0), 0.4)
    operator = Multifractal(key=1, amplitude_m=1.5, scale_m=8.0, octaves=5)
    return HeightField(grid, operator.apply(grid, np.zeros(grid.shape))[0])


def place(
    field: HeightField, density: Density, u: np.ndarray, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Where uniform numbers lead to."""
    around = PlacementContext(GroundSurface(field), np.zeros((0, 3)))
    return candidates_on(field, density, (), around, name).at(u)[:2]


def quaternions(n: int, seed: int = 0) -> np.ndarray:
    q = np.random.default_rng(seed).normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1)[:, None]


@pytest.mark.parametrize("subdivisions", [0, 1, 3])
def test_the_icosphere_is_that_of_an_independent_library(subdivisions):
    points, faces = icosphere(subdivisions)
    ours = trimesh.Trimesh(points, faces, process=False)
    theirs = trimesh.creation.icosphere(subdivisions)
    assert ours.is_watertight
    assert ours.is_winding_consistent
    assert ours.volume == pytest.approx(theirs.volume, rel=1e-12)
    assert ours.area == pytest.approx(theirs.area, rel=1e-12)
    assert np.allclose(np.linalg.norm(points, axis=1), 1.0, atol=1e-15)


def test_the_count_is_exact_and_the_first_points_stay_when_it_grows():
    u = np.random.default_rng(0).random((1000, 3))
    few = place(
        relief(), NoiseDensity(key=5, scale_m=6.0, octaves=3, contrast=4.0), u[:300], "rocks"
    )
    many = place(relief(), NoiseDensity(key=5, scale_m=6.0, octaves=3, contrast=4.0), u, "rocks")
    assert len(many[0]) == 1000
    assert np.array_equal(few[0], many[0][:300])
    assert np.array_equal(few[1], many[1][:300])


def test_uniform_density_fills_the_terrain_evenly():
    u = np.random.default_rng(2).random((50_000, 3))
    x, y = place(relief(), UniformDensity(), u, "rocks")
    assert (np.abs(x) <= 20).all()
    assert (np.abs(y) <= 20).all()
    assert abs(x.mean()) < 0.2
    assert x.std() == pytest.approx(40 / np.sqrt(12), rel=0.01)


def test_a_uniform_density_needs_no_cells_and_places_as_equal_cells_would():
    class Even(NoiseDensity):
        def at(self, x, y):
            return np.ones(x.shape)

    u = np.random.default_rng(5).random((5000, 3))
    quick = place(relief(), UniformDensity(), u, "rocks")
    cells = place(relief(), Even(scale_m=1.0, contrast=1.0, octaves=1, key=1), u, "rocks")
    assert np.array_equal(quick[0], cells[0])
    assert np.array_equal(quick[1], cells[1])


def test_aligned_objects_turn_their_up_axis_to_the_normal():
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(200, 3))
    normals[:, 2] = np.abs(normals[:, 2])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    upright = np.zeros((200, 4))
    spin = rng.uniform(0, np.pi, 200)
    upright[:, 2], upright[:, 3] = np.sin(spin), np.cos(spin)
    turned = align_to_normals(upright, normals)
    up = np.array([rotation_rows(q)[2::3] for q in turned])
    assert np.allclose(up, normals, atol=1e-12)


def test_every_rock_is_in_the_ground_by_the_depth_asked_for():
    field = relief()
    rocks = build_prototypes([shape(1), shape(2)])
    n = 200
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-18, 18, (2, n))
    half = quaternions(n).astype(np.float16)
    size, embed = rng.uniform(0.05, 2.0, n), rng.uniform(0.0, 0.8, n)
    which = rng.integers(0, 2, n).astype(np.int32)
    bodies = Bodies.of(rocks, which, (x, y), half, size, embed)
    z = seat(HeightPyramid.of(field), bodies)
    for i in range(n):
        turn = np.array(rotation_rows(half[i].astype(np.float64))).reshape(3, 3)
        points = rocks[which[i]].points.astype(np.float64) @ turn.T * size[i]
        height = np.ptp(points[:, 2])
        points += [x[i], y[i], z[i]]
        gap = points[:, 2] - field.height_at(points[:, 0].copy(), points[:, 1].copy())
        assert gap.min() == pytest.approx(-embed[i] * height, abs=1e-9)


def test_seats_on_one_cell_a_border_and_huge_rocks_are_those_of_every_vertex():
    rng = np.random.default_rng(8)
    (rock,) = build_prototypes([shape(3)])
    for shape_of_grid, scale in (((1, 1), 1.0), ((40, 30), 1.0), ((40, 30), 60.0)):
        grid = Grid((30.0, 20.0), (shape_of_grid[1] + 1, shape_of_grid[0] + 1))
        field = HeightField(grid, rng.normal(0.0, 3.0, grid.shape) - 50.0)
        n = 60
        x, y = rng.uniform(-20, 20, (2, n))
        half = quaternions(n, 2).astype(np.float16)
        size, embed = scale * rng.uniform(0.01, 2.0, n), rng.uniform(0.0, 1.0, n)
        bodies = Bodies.of((rock,), np.zeros(n, np.int32), (x, y), half, size, embed)
        z = seat(HeightPyramid.of(field), bodies)
        for i in range(n):
            turn = np.array(rotation_rows(half[i].astype(np.float64))).reshape(3, 3)
            points = rock.points.astype(np.float64) @ turn.T * size[i]
            ground = field.height_at(points[:, 0] + x[i], points[:, 1] + y[i])
            wanted = -(points[:, 2] - ground).min() - embed[i] * np.ptp(points[:, 2])
            assert z[i] == pytest.approx(wanted, abs=1e-9)


def test_a_plane_above_a_rectangle_is_nowhere_below_the_ground():
    rng = np.random.default_rng(5)
    field = HeightField(Grid((30.0, 20.0), (31, 41)), rng.normal(0.0, 3.0, (41, 31)))
    pyramid = HeightPyramid.of(field)
    for width in (0.0, 0.1, 1.0, 3.0, 12.0):
        for left, front in rng.uniform(-17.0, 17.0, (60, 2)):
            right, back = left + width, front + width * rng.uniform()
            height, along_x, along_y = plane_above(pyramid, left, right, front, back)
            x, y = rng.uniform((left, front), (right, back), (200, 2)).T
            plane = height + along_x * (x - left) + along_y * (y - front)
            assert (field.height_at(x.copy(), y.copy()) <= plane).all()
