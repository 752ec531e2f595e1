"""Made motions keep their limits, stand on the ground, and look where they should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from scenec.compiler.cameras.paths.descent import Descent
from scenec.compiler.cameras.paths.lawn_mower import LawnMower
from scenec.compiler.cameras.paths.legs import rounded
from scenec.compiler.cameras.paths.mav import Mav
from scenec.compiler.cameras.paths.motion import (
    MotionBodies,
    MotionContext,
    frames,
    level_bearing,
    toward,
)
from scenec.compiler.cameras.paths.orbit import ObjectAim, Orbit, PointAim
from scenec.compiler.cameras.paths.rover import Rover
from scenec.compiler.cameras.paths.spline import Spline, largest
from scenec.compiler.cameras.tracks import Sampling
from scenec.compiler.geometry.poses import look_at
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.scene.objects import Prototype
from scenec.compiler.scene.rig import Sensor
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.schemas.errors import SceneError

SENSOR = Sensor(
    "front", (200, 100), (250.0, 250.0, 100.0, 50.0, 0.0), np.eye(4), np.zeros(1), ("rgb",)
)


def around(height=None, samples=50, size=(60.0, 40.0), bodies=None, spacing=0.25) -> MotionContext:
    """A terrain whose height is a function of x and y."""
    grid = Grid.with_spacing(size, spacing)
    x, y = np.meshgrid(grid.x(), grid.y())
    heights = np.zeros(grid.shape) if height is None else height(x, y) + 0.0 * x
    surface = GroundSurface(HeightField(grid, heights))
    return MotionContext("rigs/r/pose", samples, surface, (SENSOR,), bodies or {})


def hills(x, y):
    return 0.5 * np.sin(0.4 * x) * np.cos(0.3 * y)


def prototype(mesh: trimesh.Trimesh) -> Prototype:
    points = mesh.vertices.astype(np.float32)
    radius = float(np.linalg.norm(points, axis=1).max()) * (1 + 1e-6)
    none = np.zeros(len(points), np.float32)
    faces = mesh.faces.astype(np.int32)
    return Prototype("p", points, faces, np.zeros_like(points), none, radius=radius)


def bodies_of_meshes(meshes, rows) -> MotionBodies:
    """Rows of x, y, z, scale and the index of a mesh, each turned about the vertical by its x."""
    table = np.array(rows, float)
    made = tuple(prototype(mesh) for mesh in meshes)
    which = table[:, 4].astype(np.int32)
    c, s, zero = np.cos(table[:, 0]), np.sin(table[:, 0]), 0 * table[:, 0]
    turn = np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1]]).transpose(2, 0, 1)
    radius = np.array([p.radius for p in made])[which] * table[:, 3]
    turn = (turn * table[:, 3, None, None]).astype(np.float32)
    return MotionBodies(np.arange(1, len(table) + 1), table[:, :3], radius, turn, which, made)


def balls(*rows) -> MotionBodies:
    """Spheres: rows of x, y, z and the radius."""
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    return bodies_of_meshes([sphere], [[*row, 0] for row in rows])


def orthonormal(to_world) -> bool:
    r = to_world[:, :3, :3]
    square = np.allclose(r.transpose(0, 2, 1) @ r, np.eye(3), rtol=0, atol=1e-12)
    return square and np.allclose(np.linalg.det(r), 1.0)


# Frames ------------------------------------------------------------------------------------------


def test_frames_and_ways_agree_with_looking_at_a_point():
    rng = np.random.default_rng(0)
    for _ in range(100):
        way = rng.normal(size=3) * [1, 1, 3]
        expected = look_at(np.zeros(3), way, 25.0)[:3, :3]
        level = np.hypot(*way[:2])
        pitch = np.degrees(np.arctan2(way[2], level))
        ours = frames(way[None, :2] / level, pitch, 25.0)[0]
        assert np.allclose(ours, expected, rtol=0, atol=1e-13)
        level_view = look_at(np.zeros(3), way, 0.0)[:3, :3]
        ours = toward(way[None], np.array([[0.0, 1]]))[0]
        assert np.allclose(ours, level_view, rtol=0, atol=1e-13)


@pytest.mark.parametrize("end", [-90.0, 90.0])
def test_straight_down_and_up_are_reached_without_a_jump(end):
    bearing = np.tile(level_bearing(70.0), (201, 1))
    axes = frames(bearing, np.linspace(end - 1, end + 1, 201))
    assert np.abs(np.diff(axes, axis=0)).max() < 2e-4
    assert np.allclose(axes[100, :, 2], [0, 0, np.sign(end)], atol=1e-15)
    # The picture's top, looking down, is where the bearing points; its bottom, looking up.
    top = -axes[100, :, 1] * -np.sign(end)
    assert np.allclose(top[:2], bearing[0], atol=1e-15)


# Orbit -------------------------------------------------------------------------------------------


def orbit(**keys) -> Orbit:
    base = Orbit(
        center=PointAim(x_m=2.0, y_m=-1.0, height_m=0.5),
        radius_m=6.0,
        height_m=3.0,
        start_deg=30.0,
        sampling=Sampling(),
    )
    return replace(base, **keys)


def test_an_orbit_is_a_circle_that_looks_at_its_center_at_an_even_rate():
    built = orbit().built(around(hills, 36))
    center = np.array([2.0, -1.0, 0.5 + float(around(hills).ground(np.array([[2.0, -1]]))[0])])
    way = center - built.to_world[:, :3, 3]
    assert np.allclose(np.hypot(*way.T[:2]), 6.0, rtol=0, atol=1e-12)
    assert np.allclose(way[:, 2], -3.0, rtol=0, atol=1e-12)
    unit = way / np.linalg.norm(way, axis=1)[:, None]
    assert np.allclose(built.to_world[:, :3, 2], unit, rtol=0, atol=1e-13)
    bearing = np.unwrap(np.arctan2(-way[:, 0], -way[:, 1]))
    assert np.allclose(np.degrees(bearing), 30.0 + 10.0 * np.arange(36), rtol=0, atol=1e-10)
    assert np.allclose(np.diff(built.times), 60 / 36)
    assert orthonormal(built.to_world)


def test_an_orbit_of_part_of_a_turn_ends_where_it_is_told_to():
    built = orbit(sweep_deg=-90.0).built(around(samples=10))
    way = built.to_world[-1, :2, 3] - [2.0, -1.0]
    assert np.degrees(np.arctan2(*way)) == pytest.approx(-60.0)
    assert built.times[-1] == 15.0


def test_an_orbit_right_above_its_center_looks_straight_down_and_turns():
    built = orbit(radius_m=0.0).built(around(samples=4))
    assert np.allclose(built.to_world[:, :3, 2], [0, 0, -1])
    # Its picture's top points away from the side it is on: a quarter turn from pose to pose.
    top = -built.to_world[:, :3, 1]
    assert np.allclose((top[:-1] * top[1:]).sum(axis=1), 0.0, atol=1e-15)
    with pytest.raises(SceneError, match="no direction to look in"):
        orbit(radius_m=0.0, height_m=0.0).built(around(samples=4))


def test_an_orbit_rises_where_the_ground_would_be_too_near():
    built = orbit(height_m=0.0).built(around(lambda x, y: 0.5 * x, 40))
    at = built.to_world[:, :3, 3]
    assert (at[:, 2] - 0.5 * at[:, 0]).min() == pytest.approx(0.5)
    assert 0 < built.facts["lifted"] < 40


def test_an_orbit_goes_around_an_object_by_its_id_or_a_drawn_one():
    bodies = {"rocks": balls((1, 2, 3, 1), (-8, 5, 1, 2))}
    for aim, middle in (
        (ObjectAim(object="rocks", id=2, pick_u=0.0), (-8, 5)),
        (ObjectAim(object="rocks", pick_u=0.2), (1, 2)),
        (ObjectAim(object="rocks", pick_u=0.999), (-8, 5)),
    ):
        built = orbit(center=aim).built(around(samples=8, bodies=bodies))
        assert np.allclose(built.to_world[:, :2, 3].mean(axis=0), middle)
    with pytest.raises(SceneError, match="no object of the class rocks has the id 3: expected"):
        orbit(center=ObjectAim(object="rocks", id=3, pick_u=0.0)).built(around(bodies=bodies))


# Lawn mower --------------------------------------------------------------------------------------


def mower(**keys) -> LawnMower:
    base = LawnMower(
        x_m=1.0,
        y_m=2.0,
        along_m=20.0,
        across_m=12.0,
        bearing_deg=35.0,
        spacing_m=3.0,
        height_m=5.0,
        above="mean",
        sampling=Sampling(),
    )
    return replace(base, **keys)


@pytest.mark.parametrize("radius", [0.5, 1.5, 1.6, 4.0])
def test_a_survey_covers_its_rectangle_at_its_speed_with_turns_no_tighter(radius):
    built = mower(turn_radius_m=radius).built(around(hills, 20_001, (90.0, 90.0)))
    at, t = built.to_world[:, :3, 3], built.times
    h = t[1] - t[0]
    velocity = np.diff(at, axis=0) / h
    assert np.allclose(np.linalg.norm(velocity, axis=1), 2.0, rtol=1e-4)
    bend = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / h
    assert bend.max() <= 4.0 / radius * (1 + 1e-3)
    assert np.ptp(at[:, 2]) == 0.0
    # In the rectangle's own axes: five lines, from edge to edge.
    ahead = level_bearing(35.0)
    right = np.array([ahead[1], -ahead[0]])
    along, across = (at[:, :2] - [1, 2]) @ ahead, (at[:, :2] - [1, 2]) @ right
    straight = np.abs(velocity[:, :2] @ right) < 1e-6
    lines = np.unique(np.round(across[:-1][straight & (np.abs(along[:-1]) < 9.9)], 6))
    assert np.allclose(lines, [-6, -3, 0, 3, 6], atol=1e-6)
    assert along.min() < -9.99
    assert along.max() > 9.99
    assert orthonormal(built.to_world)
    # The picture's top is ahead.
    assert np.allclose(-built.to_world[:-1, :2, 1], velocity[:, :2] / 2.0, atol=2 * h / radius)


def test_the_overlap_of_strips_is_what_the_camera_sees():
    built = mower(spacing_m=None, overlap=0.75).built(around(size=(90.0, 90.0)))
    # 200 px / 250 px of 5 m are 4 m wide: a quarter of it is new, and 12 m are a multiple of that.
    assert built.facts["spacing_m"] == pytest.approx(1.0)
    assert built.facts["lines"] == 13


def test_a_survey_over_the_ground_follows_it_and_a_level_one_does_not_go_below_it():
    built = mower(above="ground").built(around(hills, 500, (90.0, 90.0)))
    at = built.to_world[:, :3, 3]
    ground = around(hills, size=(90.0, 90.0)).ground(at[:, :2])
    assert np.allclose(at[:, 2] - ground, 5.0, rtol=0, atol=1e-12)
    with pytest.raises(SceneError, match="below the ground: expected a larger height_m than -1"):
        mower(above="world", height_m=-1.0).built(around(size=(90.0, 90.0)))
    with pytest.raises(SceneError, match="the survey reaches"):
        mower().built(around(size=(15.0, 15.0)))


def test_a_survey_without_extent_is_one_pose():
    built = mower(along_m=0.0, across_m=0.0).built(around(samples=3))
    assert np.allclose(built.to_world[:, :2, 3], [1, 2])
    assert built.times.tolist() == [0, 0, 0]


# Legs --------------------------------------------------------------------------------------------


def test_corners_are_as_wide_as_the_turn_rate_asks_and_pass_no_limit():
    points = np.array([[0.0, 0], [10, 0], [10, 8], [9.9, 0], [0, 0.5], [0, 0.5], [3, 0.5]])
    legs = rounded(points, 2.0, 0.5)
    t = np.linspace(0, legs.duration_s, 200_001)
    xy, heading = legs.at(t)
    h = t[1]
    speed = np.linalg.norm(np.diff(xy, axis=0), axis=1) / h
    angle = np.unwrap(np.arctan2(heading[:, 1], heading[:, 0]))
    rate = np.abs(np.diff(angle)) / h
    assert speed.max() <= 2.0 * (1 + 1e-9)
    assert rate.max() <= 0.5 * (1 + 1e-6)
    # Continuous, from the first point to the last.
    assert np.allclose(xy[[0, -1]], points[[0, -1]], atol=1e-9)
    # It drives where it points.
    moving = speed > 1e-6
    way = np.diff(xy, axis=0)[moving] / (h * speed[moving])[:, None]
    assert ((way * heading[:-1][moving]).sum(axis=1)).min() > 1 - 1e-6


# MAV ---------------------------------------------------------------------------------------------


def mav(points, **keys) -> Mav:
    base = Mav(waypoints_m=points, height_m=2.0, tilt=False, sampling=Sampling())
    return replace(base, **keys)


SQUARE = [[-20, -12], [20, -12], [20, 12], [-20, 12], [-20, 11]]


@pytest.mark.parametrize(
    "limits",
    [{"speed_m_s": 1.0}, {"acceleration_m_s2": 0.3}, {"jerk_m_s3": 0.1}, {}],
)
def test_a_flight_keeps_its_limits_and_reaches_one_of_them(limits):
    flight = mav(SQUARE, **limits)
    built = flight.built(around(hills, 40_001))
    at, h = built.to_world[:, :3, 3], built.times[1]
    measured = []
    for order, limit in enumerate(
        (flight.speed_m_s, flight.acceleration_m_s2, flight.jerk_m_s3), start=1
    ):
        step = 1 if order < 3 else 10
        values = np.diff(at[::step], n=order, axis=0) / (h * step) ** order
        largest_seen = np.linalg.norm(values, axis=1).max()
        assert largest_seen <= limit * (1 + 1e-3)
        measured.append(largest_seen / limit)
    # The bound on speeds is not tight; the two others are.
    assert max(measured) > 0.9
    # From rest to rest.
    assert np.linalg.norm(at[1] - at[0]) / h < 1e-2
    assert np.linalg.norm(at[-1] - at[-2]) / h < 1e-2


def test_a_flight_passes_its_waypoints_and_keeps_over_the_ground():
    built = mav(SQUARE, height_m=1.0).built(around(hills, 20_001))
    at = built.to_world[:, :3, 3]
    for point in SQUARE:
        assert np.hypot(*(at[:, :2] - point).T).min() < 0.01
    above = at[:, 2] - around(hills).ground(at[:, :2])
    assert above.min() >= 0.2
    assert above.min() == pytest.approx(built.facts["lowest_m"], abs=0.05)
    assert np.ptp(above) < 2.5
    velocity = np.diff(at, axis=0)[100:-100]
    level = velocity[:, :2] / np.linalg.norm(velocity[:, :2], axis=1)[:, None]
    forward = built.to_world[100:-101, :3, 2]
    assert np.allclose(forward[:, :2] / np.cos(np.radians(30)), level, atol=5e-3)
    assert np.allclose(forward[:, 2], -0.5)


def test_a_tilted_body_feels_no_force_but_along_its_own_up():
    flight = mav(SQUARE, pitch_deg=0.0, tilt=True)
    built = flight.built(around(hills, 20_001))
    at, h = built.to_world[:, :3, 3], built.times[1]
    felt = np.diff(at, n=2, axis=0) / h**2 + [0, 0, 9.81]
    axes = built.to_world[1:-1, :3, :3]
    across = (felt[:, :, None] * axes).sum(axis=1)
    # Right and forward feel nothing; up feels it all.
    assert np.abs(across[:, [0, 2]]).max() < 2e-3
    assert np.allclose(-across[:, 1], np.linalg.norm(felt, axis=1), rtol=1e-6)
    assert orthonormal(built.to_world)


def test_a_flight_of_one_waypoint_hovers():
    built = mav([[3, 4]]).built(around(hills, 5))
    assert np.ptp(built.to_world, axis=0).max() == 0
    assert built.times is None


def test_drawn_waypoints_lie_on_the_terrain_and_given_ones_must():
    drawn = np.array([[-0.3, 0.3], [0.3, 0.3], [0.0, -0.3]])
    built = replace(mav(None), drawn=drawn).built(around(hills, 1000))
    assert np.allclose(built.to_world[[0, -1], :2, 3], drawn[[0, -1]] * [60, 40])
    with pytest.raises(SceneError, match=r"a waypoint reaches \(99, 0\) m"):
        mav([[0, 0], [99, 0]]).built(around())


def test_a_spline_passes_its_points_smoothly_and_its_bounds_hold():
    rng = np.random.default_rng(0)
    for _ in range(20):
        spline = Spline.through(np.cumsum(rng.uniform(0.1, 2, 8)), rng.normal(size=(8, 3)))
        assert np.allclose(spline.at(spline.time_s), spline.value, atol=1e-14)
        t = np.linspace(spline.time_s[0], spline.time_s[-1], 20_001)
        for order, bound in enumerate(largest((spline,)), start=1):
            values = np.linalg.norm(spline.at(t, order), axis=1)
            assert values.max() <= bound * (1 + 1e-12)
            assert values.max() > 0.7 * bound
            slope = np.diff(spline.at(t, order - 1), axis=0) / np.diff(t)[:, None]
            middle = spline.at(0.5 * (t[1:] + t[:-1]), order)
            # Steps over a knot see two cubics.
            knot = np.searchsorted(spline.time_s, t)
            inner = knot[1:] == knot[:-1]
            assert np.allclose(slope[inner], middle[inner], rtol=0, atol=1e-5 * bound)


# Descent -----------------------------------------------------------------------------------------


def descent(**keys) -> Descent:
    base = Descent(
        x_m=1.0,
        y_m=-2.0,
        entry_height_m=100.0,
        touchdown_height_m=1.5,
        entry_speed_m_s=20.0,
        touchdown_speed_m_s=0.5,
        drift_m_s=2.0,
        drift_deg=90.0,
        sampling=Sampling(),
    )
    return replace(base, **keys)


def test_a_descent_brakes_evenly_and_its_drift_dies_away():
    built = descent().built(around(hills, 1001))
    at, t = built.to_world[:, :3, 3], built.times
    assert t[-1] == pytest.approx(2 * 98.5 / 20.5)
    h = t[1]
    velocity = np.diff(at, axis=0) / h
    assert velocity[0] == pytest.approx([2.0, 0, -20.0], abs=0.02)
    assert velocity[-1] == pytest.approx([0.0, 0, -0.5], abs=0.02)
    assert np.ptp(np.diff(velocity, axis=0)[:, 2]) < 1e-9
    ground = float(around(hills).ground(np.array([[1.0, -2]]))[0])
    assert at[0, 2] == pytest.approx(ground + 100.0)
    assert at[-1] == pytest.approx([1.0, -2.0, ground + 1.5])
    assert np.allclose(built.to_world[:, :3, 2], [0, 0, -1], atol=1e-15)
    assert orthonormal(built.to_world)


def test_a_descent_at_one_speed_and_from_100_km_to_1_cm():
    built = descent(entry_speed_m_s=4.0, touchdown_speed_m_s=4.0).built(around(samples=11))
    assert np.allclose(np.diff(built.to_world[:, 2, 3]), -9.85)
    high = descent(entry_height_m=1e5, touchdown_height_m=0.01, drift_m_s=0.0)
    built = high.built(around(hills, 100))
    above = built.to_world[:, 2, 3] - float(around(hills).ground(np.array([[1.0, -2]]))[0])
    assert above[0] == pytest.approx(1e5)
    assert above[-1] == pytest.approx(0.01, abs=1e-9)
    still = descent(entry_height_m=1.5, touchdown_height_m=1.5).built(around(samples=2))
    assert np.ptp(still.to_world, axis=0).max() == 0.0
    with pytest.raises(SceneError, match="below the ground: expected less drift"):
        descent(entry_height_m=3.0, drift_m_s=30.0).built(around(lambda x, y: -2.0 * x, 100))


# Rover -------------------------------------------------------------------------------------------


def rover(points, **keys) -> Rover:
    base = Rover(waypoints_m=points, max_slope_deg=30.0, pitch_deg=0.0, sampling=Sampling())
    return replace(base, **keys)


@pytest.mark.parametrize(("east", "north"), [(0.0, 0.0), (0.2, 0.0), (0.0, -0.3), (0.3, 0.25)])
def test_on_a_plane_the_rover_has_the_plane_s_pitch_and_roll(east, north):
    ground = around(lambda x, y: east * x + north * y, 30)
    built = rover([[-10, 0], [10, 0], [10, 8]]).built(ground)
    normal = np.array([-east, -north, 1.0]) / np.sqrt(1 + east**2 + north**2)
    # Up in the body, and the height along it.
    assert np.allclose(-built.to_world[:, :3, 1], normal, rtol=0, atol=1e-9)
    at = built.to_world[:, :3, 3]
    assert np.allclose((at - [0, 0, 0]) @ normal, 1.5, rtol=0, atol=1e-9)
    first = np.array([1.0, 0.0, east])
    assert np.allclose(built.to_world[0, :3, 2], first / np.linalg.norm(first), atol=1e-9)
    slope = np.degrees(np.arctan(np.hypot(east, north)))
    assert built.facts["largest_slope_deg"] == pytest.approx(slope, abs=1e-6)
    assert orthonormal(built.to_world)


def test_a_bump_under_one_wheel_lifts_pitches_and_rolls_as_a_quarter_of_it():
    bump = around(lambda x, y: 0.2 * ((np.abs(x - 0.5) < 0.3) & (np.abs(y - 0.4) < 0.3)), 1)
    built = rover([[0, 0], [5, 0]]).built(bump)
    up = -built.to_world[0, :3, 1]
    # Ahead rises by half of 0.2 over a wheel base of 1, the left by half of 0.2 over 0.8.
    assert up[0] / up[2] == pytest.approx(-0.1, abs=1e-9)
    assert up[1] / up[2] == pytest.approx(-0.125, abs=1e-9)


def test_a_rover_keeps_its_speed_and_turn_rate():
    points = [[-20, -10], [15, -10], [15, 10], [-20, 5], [15, 6]]
    built = rover(points).built(around(samples=50_001))
    at, h = built.to_world[:, :3, 3], built.times[1]
    assert np.linalg.norm(np.diff(at, axis=0), axis=1).max() / h <= 0.5 * (1 + 1e-6)
    forward = built.to_world[:, :2, 2]
    angle = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    assert np.degrees(np.abs(np.diff(angle)).max() / h) <= 20.0 * (1 + 1e-5)


def test_a_rover_drives_around_what_is_too_steep_and_too_large():
    def wall(x, y):
        return 2.0 * (np.abs(x) < 1.0) * (y < 10.0)

    bodies = {"rocks": balls((-10, -12, 0, 2.0), (12, 0, 0, 0.2)), "trees": balls((-10, 3, 0, 3))}
    points = [[-20, -15], [-10, 14], [12, 0]]
    built = rover(points).built(around(wall, 3000, bodies=bodies))
    at = built.to_world[:, :2, 3]
    assert (at[np.abs(at[:, 0]) < 1.0, 1] > 9.5).all()
    assert np.hypot(*(at - [-10, -12]).T).min() > 2.0 + 0.3
    assert np.hypot(*(at - [-10, 3]).T).min() > 3.0 + 0.3
    # The small one is driven over, and told.
    assert built.facts["drives_over"] == {"rocks": [2]}
    for point in points:
        assert np.hypot(*(at - point).T).min() < 1.5
    assert built.facts["largest_slope_deg"] < 30.0


def test_where_no_way_leads_the_error_says_why():
    def wall(x, y):
        return 2.0 * (np.abs(x) < 1.0)

    with pytest.raises(SceneError, match=r"no way from waypoint 0 \(-10, 0\) m to 1 .* 30 deg"):
        rover([[-10, 0], [10, 0]]).built(around(wall))
    with pytest.raises(SceneError, match=r"at waypoint 1 .* the ground has a slope of .*max_slope"):
        rover([[-10, 0], [1, 0]]).built(around(wall))
    with pytest.raises(SceneError, match=r"waypoints_m/0: .* object 1 of objects/a is 0"):
        rover([[0, 0], [5, 0]]).built(around(bodies={"a": balls((0, 0, 0, 1))}))
    goals = replace(rover(None), goals_u=np.full((1, 64, 2), 0.5))
    with pytest.raises(SceneError, match="no place for goal 0 in 64 tries: 64 on slopes above 30"):
        goals.built(around(lambda x, y: 1.5 * x))


def test_drawn_goals_are_reached_and_those_that_cannot_be_are_drawn_again():
    def wall(x, y):
        return 2.0 * (np.abs(x) < 1.0)

    u = np.random.default_rng(0).uniform(0, 1, (5, 64, 2))
    built = replace(rover(None), goals_u=u).built(around(wall, 200))
    goals = np.array(built.facts["waypoints"])
    assert len(goals) == 5
    # None lies beyond the wall.
    assert len(set(np.sign(goals[:, 0]))) == 1
    at = built.to_world[:, :2, 3]
    assert len(set(np.sign(at[:, 0]))) == 1


def test_a_drive_without_a_way_is_one_pose():
    built = rover([[3, 3]]).built(around(hills, 4))
    assert np.ptp(built.to_world, axis=0).max() == 0.0


def test_a_hundred_thousand_poses_of_each_motion_are_made():
    ground = around(hills, 100_000)
    for motion in (orbit(), mower(along_m=10.0), mav(SQUARE), descent(), rover([[0, 0], [9, 9]])):
        built = motion.built(ground)
        assert built.to_world.shape == (100_000, 4, 4)
        assert np.isfinite(built.to_world).all()
