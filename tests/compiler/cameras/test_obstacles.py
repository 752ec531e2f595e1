"""What is in a vehicle's way is its geometry at the vehicle's height, neither more nor less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from laying import laid, plan, surroundings
from scipy.spatial import cKDTree
from test_motions import around, bodies_of_meshes, prototype, rover

from scenec.compiler.cameras.paths.obstacles import obstacles_of
from scenec.compiler.cameras.paths.route import passable
from scenec.compiler.geometry.voxels import Cubes, voxels_of
from scenec.compiler.objects.plan import ModelSource
from scenec.compiler.objects.scatter import scatter
from scenec.schemas.errors import SceneError
from scenec.testing.examples import examples


def tree(crown_m: float = 3.0, branch_at_m: float | None = None) -> trimesh.Trimesh:
    """A trunk of 0.4 m, a crown from 3 m up, perhaps a branch to the east."""
    parts = [
        trimesh.creation.cylinder(0.2, segment=[[0, 0, -0.3], [0, 0, 4]]),
        trimesh.creation.icosphere(radius=crown_m).apply_translation([0, 0, 3.0 + crown_m]),
    ]
    if branch_at_m is not None:
        ends = [[0, 0, branch_at_m], [2.5, 0, branch_at_m]]
        parts.append(trimesh.creation.cylinder(0.06, segment=ends))
    return trimesh.util.concatenate(parts)


def fine(mesh: trimesh.Trimesh, step: float = 0.15) -> np.ndarray:
    """Points so dense on a mesh that each of its own is within ``step`` of one."""
    return trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, step, max_iter=16)[0]


def placed(bodies, points) -> np.ndarray:
    """Points of the prototypes in the world."""
    return np.concatenate(
        [
            points[p] @ bodies.turn[n].astype(float).T + bodies.middle[n]
            for n, p in enumerate(bodies.prototype)
        ]
    )


# The cubes of a mesh ---------------------------------------------------------------------------


@examples(25)
@given(st.integers(0, 2**32 - 1), st.integers(2, 40))
def test_cubes_hold_every_triangle_and_reach_no_farther_than_a_diagonal(seed, most):
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(12, 3)) * [1.0, 2.0, 0.3]
    soup = trimesh.Trimesh(vertices, rng.integers(0, 12, (8, 3)), process=False)
    cubes = voxels_of(prototype(soup).mesh, 0.0, most)
    weights = rng.dirichlet([1, 1, 1], 400)
    on = np.einsum("nk,nkd->nd", weights, soup.triangles[rng.integers(0, 8, 400)])
    index = np.floor((on - cubes.corner) / cubes.side).astype(int)
    index = np.clip(index, 0, np.array(cubes.full.shape) - 1)
    assert cubes.full[tuple(index.T)].all()
    # A single triangle encloses nothing.
    one = trimesh.Trimesh(vertices[:3], [[0, 1, 2]], process=False)
    middles = (own := voxels_of(prototype(one).mesh, 0.0, most)).middles()
    at = trimesh.triangles.closest_point(np.repeat(one.triangles, len(middles), 0), middles)
    away = np.abs(at - middles).max(axis=1)
    assert (away <= 0.5 * np.sqrt(3) * own.side * (1 + 1e-6)).all()


def test_a_hollow_is_full_unless_it_opens_to_a_side_or_the_top():
    ball = trimesh.creation.icosphere(radius=1.0)
    height = ball.triangles_center[:, 2]
    east = ball.triangles_center[:, 0]
    below, bowl, cave = (
        trimesh.Trimesh(ball.vertices, ball.faces[kept])
        for kept in (height > -0.5, height < 0.5, east < 0.5)
    )
    for mesh, holds in ((ball, True), (below, True), (bowl, False), (cave, False)):
        cubes = Cubes((prototype(mesh).mesh,))
        inside = cubes.near(
            np.zeros(1, np.int32), np.zeros((1, 3)), np.eye(3, dtype=np.float32)[None],
            np.full(1, 1.1), 0.0, np.zeros((1, 3)),
        )  # fmt: skip
        assert inside[0] == holds


# Vehicles --------------------------------------------------------------------------------------


def test_a_rover_passes_between_two_trees_whose_crowns_touch_above_it():
    bodies = bodies_of_meshes([tree()], [(0, 2.5, 0, 1, 0), (0, -2.5, 0, 1, 0)])
    built = rover([[-12, 0], [12, 0]]).built(around(bodies={"trees": bodies}))
    # Straight, under both.
    assert np.abs(built.to_world[:, 1, 3]).max() == 0.0
    assert built.facts["drives_over"] == {}


def test_a_tree_with_low_branches_is_driven_around():
    low, high = (
        bodies_of_meshes([tree(branch_at_m=at)], [(0, -1.5, 0, 1, 0)]) for at in (1.2, 2.6)
    )
    # A wall to either side but for the gap that the branch hangs in.
    for bodies, free in ((high, True), (low, False)):
        ground = around(bodies={"trees": bodies})
        cells = passable(ground, 30.0, 0.8, 1.0, 1.5, 0.25)
        assert cells.is_free(np.array([1.5, -1.5])) == free


def test_what_stands_higher_on_a_mast_is_part_of_the_vehicle():
    bodies = bodies_of_meshes([tree(branch_at_m=2.0)], [(0, 0, 0, 1, 0)])
    ground = around(bodies={"trees": bodies})
    drive = rover([[1.5, 0], [1.5, -8]])
    drive.built(ground)
    lifted = np.eye(4)
    # In a camera's axes, y is down.
    lifted[1, 3] = -0.6
    mast = replace(ground, sensors=(replace(ground.sensors[0], to_rig=lifted),))
    with pytest.raises(SceneError, match=r"waypoints_m/0.*object 1 of objects/trees"):
        drive.built(mast)


def test_a_blocked_waypoint_names_the_object_its_distance_and_the_key_that_helps():
    bodies = bodies_of_meshes([tree()], [(0, 9, 0, 1, 0), (3, 0, 0, 1, 0)])
    with pytest.raises(SceneError) as error:
        rover([[-5, -5], [3.4, 0.3]]).built(around(bodies={"trees": bodies}))
    said = str(error.value)
    assert said.startswith("rigs/r/pose/waypoints_m/1: at waypoint 1 (3.4, 0.3) m object 2 of")
    assert "max_object_m of 9.09 or more (now 0.25)" in said
    away = float(said.split(" m away")[0].split()[-1])
    # The trunk's axis is 0.5 m away, its bark 0.3 m; a cube is 0.14 m wide.
    assert 0.3 - np.sqrt(3) * 0.15 <= away <= 0.3
    # What it says helps.
    replace(rover([[-5, -5], [3.4, 0.3]]), max_object_m=9.09).built(
        around(bodies={"trees": bodies})
    )


@examples(8)
@given(st.integers(0, 2**32 - 1))
def test_no_triangle_is_in_a_vehicle_s_way_and_nothing_else_is_refused(seed):
    rng = np.random.default_rng(seed)
    meshes = [tree(2.0, 1.0), tree(1.0), trimesh.creation.box((3, 0.5, 1.0))]
    rows = np.column_stack(
        [
            rng.uniform(-25, 25, 14), rng.uniform(-17, 17, 14), rng.uniform(-0.5, 2.5, 14),
            rng.uniform(0.5, 1.2, 14), rng.integers(0, 3, 14),
        ]
    )  # fmt: skip
    bodies = bodies_of_meshes(meshes, rows)
    tilt = trimesh.transformations.rotation_matrix(rng.uniform(0, 1.2), rng.normal(size=3))[:3, :3]
    turn = (bodies.turn.astype(float) @ tilt).astype(np.float32)
    bodies = replace(bodies, turn=turn)

    def hills(x, y):
        return 0.4 * np.sin(0.5 * x) * np.cos(0.4 * y)

    ground = around(hills, bodies={"all": bodies})
    top, width, base = 1.5, 0.8, 1.0
    cells = passable(ground, 40.0, width, base, top, 0.25)
    empty = passable(replace(ground, bodies={}), 40.0, width, base, top, 0.25)
    points = placed(bodies, [fine(mesh) for mesh in meshes])
    step = 0.15 * 1.2
    reach = 0.5 * np.hypot(width, base)
    on_ground = ground.ground(points[:, :2])
    band = (points[:, 2] > on_ground) & (points[:, 2] < on_ground + top)
    # Nothing of an object is within the circle of the wheels, wherever in a free cell these turn.
    places = rng.uniform([-29, -19], [29, 19], (2000, 2))
    free = np.array([cells.is_free(place) for place in places])
    away = cKDTree(points[band, :2]).query(places)[0]
    assert free.any()
    assert (away[free] > reach).all()
    # What is refused has something within the stated slack, and the leaning, of it.
    refused = ~free & np.array([empty.is_free(place) for place in places])
    # Heights differ over the slack, too.
    slack = cells.slack_m() + step
    high = cells.band.high.max() - cells.band.low.min()
    loose = (points[:, 2] > on_ground - high) & (points[:, 2] < on_ground + top + high)
    lean = np.array([cells.band.reach[cells.cell(place)] for place in places[refused]])
    away = cKDTree(points[loose, :2]).query(places[refused])[0]
    assert (away <= lean + slack).all()


def test_small_objects_are_driven_over_and_large_ones_kept_off():
    bodies = {"a": bodies_of_meshes([trimesh.creation.icosphere()], [(0, 0, 0, 0.2, 0)])}
    assert obstacles_of(bodies, 0.25, 1.0) == ()
    assert len(obstacles_of(bodies, 0.15, 1.0)) == 1


# Cameras ---------------------------------------------------------------------------------------


def in_woods(cameras: np.ndarray, **change):
    """Trees laid where they are asked to be at the origin's height, and what is told of them."""
    model = prototype(tree())
    drawn = plan(count=30, embed=0.0, **change)
    source = ModelSource((), (), 0.0, False)
    drawn = replace(drawn, source=source, scale=np.ones(30), prototype=np.zeros(30, np.int32))
    spin = np.tile([0.0, 0.0, 0.0, 1.0], (30, 1))
    facts: dict = {}
    placed = scatter(
        replace(drawn, orientations=spin), ((model,),), surroundings(cameras, 0.0), facts
    )
    return placed, facts


def test_a_camera_may_be_under_a_crown_and_not_in_one():
    alone, _ = in_woods(np.zeros((0, 3)))
    at = alone.positions[4].astype(float)
    for offset, moved in (((1.5, 0, 1.5), False), ((0, 0, 6.0), True), ((0.1, 0, 1.0), True)):
        scatter, facts = in_woods((at + offset)[None])
        assert np.array_equal(scatter.positions[4], alone.positions[4]) != moved
        assert ("moved_off_cameras" in facts) == moved


def test_circles_that_find_no_place_are_compared_with_the_ground_that_is_allowed():
    where = [{"type": "point", "x_m": 0, "y_m": 0, "max_m": 4}]
    with pytest.raises(SceneError, match=r"of the ([\d.]+) % of it they may be on") as error:
        laid(surroundings(amplitude_m=0.0), count=4000, where=where, apart={"radius": 1})
    share = float(str(error.value).split("% of the ")[1].split()[0])
    assert share == pytest.approx(100 * np.pi * 16 / (40 * 32), rel=0.15)
    covered = float(str(error.value).split("would cover ")[1].split()[0])
    circles = 4000 * np.pi * 0.15**2
    assert covered == pytest.approx(100 * circles / (np.pi * 16), rel=0.15)
