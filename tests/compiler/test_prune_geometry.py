"""Pruning's geometric tests against brute force: what they call hidden, no sampled ray reaches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenec.compiler.geometry.poses import look_at
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.compiler.scene.scene import Ground, GroundLayer, Tile
from scenec.compiler.views.faint import Factors, choose
from scenec.compiler.views.horizon import Horizon, horizon_of, is_hidden, relief_of
from scenec.compiler.views.outlook import in_view, outlook
from scenec.compiler.views.places import fine_cells, places_seen
from scenec.compiler.views.prune import _seen_ground
from scenec.compiler.views.shadows import Sweep, shadows_seen
from scenec.compiler.views.visible import SHOWN, Eyes, grouped, seen_by

_SIDE = 48


def _ground(seed: int = 0, amplitude: float = 4.0) -> Ground:
    """Hills of sines on a grid of 40 m by 40 m, as one tile."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-20, 20, _SIDE), np.linspace(-20, 20, _SIDE))
    z = np.zeros_like(x)
    for _ in range(6):
        a, b, c = (*rng.uniform(-0.5, 0.5, 2).tolist(), rng.uniform(0, 6))
        z += amplitude / 6 * np.sin(a * x + b * y + c)
    at = np.arange(_SIDE * _SIDE).reshape(_SIDE, _SIDE)
    a, b, c, d = (p.ravel() for p in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1).astype(np.float32)
    n = len(points)
    tile = Tile("tile_000_000", np.array([3.0, -2.0, 1.0]), points, faces, np.zeros((n, 3)),
                np.zeros(len(faces), np.int32), np.zeros((0, n)), np.zeros(n))  # fmt: skip
    return Ground((GroundLayer("sand", {}),), (tile,))


def _triangles(ground: Ground) -> np.ndarray:
    tile = ground.tiles[0]
    return (tile.points.astype(float) + tile.translate)[tile.faces]


def _first_hits(origin, ways, triangles):
    """Parameters of the nearest hits of rays (Möller and Trumbore); inf without one."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    s = origin - a
    # Triple products, turned so that all but the way is the same for every ray.
    over, first, second = np.cross(c - a, b - a), np.cross(c - a, s), np.cross(s, b - a)
    along = ((c - a) * second).sum(1)
    found = np.full(len(ways), np.inf)
    for i, way in enumerate(ways):
        det = over @ way
        with np.errstate(all="ignore"):
            u, v, t = first @ way / det, second @ way / det, along / det
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9)
        found[i] = t[hit].min(initial=np.inf)
    return found


def _height(ground: Ground, x: float, y: float) -> float:
    triangles = _triangles(ground)
    low, high = triangles[..., :2].min(axis=1), triangles[..., :2].max(axis=1)
    below = ((low <= (x, y)) & (high >= (x, y))).all(axis=1)
    down = _first_hits(np.array([x, y, 100.0]), [np.array([0, 0, -1.0])], triangles[below])
    return 100.0 - float(down[0])


def _rig(pose, fov_px=40.0, size=(80, 60), skew=0.0, center=None, outputs=("rgb",)) -> Rig:
    middle = center or (size[0] / 2, size[1] / 2)
    sensor = Sensor("front", size, (fov_px, fov_px, *middle, skew), np.eye(4), np.zeros(1), outputs)
    return Rig("rover", pose[None], (sensor,))


@pytest.mark.parametrize("focal", [0.35, 20.0, 400.0])
@pytest.mark.parametrize(("skew", "center"), [(0.0, None), (7.0, (-30.0, 90.0))])
def test_no_ball_that_a_pixel_can_show_is_out_of_view(focal, skew, center):
    rng = np.random.default_rng(3)
    pose = look_at(np.array([1.0, 2.0, 3.0]), np.array([5.0, -2.0, 1.0]), 20.0)
    rig = _rig(pose, focal, skew=skew, center=center)
    views = outlook((rig,))
    fx, fy, cx, cy, s = rig.sensors[0].intrinsics
    out = 0
    for _ in range(2000):
        # A point that a place of the picture shows, somewhere on the surface of a ball.
        u, v = rng.uniform(0, 80), rng.uniform(0, 60)
        y = (v - cy) / fy
        way = np.array([(u - cx - s * y) / fx, y, 1.0])
        way /= np.linalg.norm(way)
        point = pose[:3, :3] @ way * rng.uniform(0.01, 50) + pose[:3, 3]
        away = rng.normal(size=3)
        radius = 10 ** rng.uniform(-3, 1)
        middle = point + radius * away / np.linalg.norm(away)
        assert in_view(views.eye[0], views.planes[0], views.axis[0], views.cone[0], *middle, radius)
        far = pose[:3, 3] + rng.normal(size=3) * 20
        out += not in_view(views.eye[0], views.planes[0], views.axis[0], views.cone[0], *far, 0.01)
    assert out > 500


@pytest.mark.parametrize(("seed", "crowd"), [(0, 1), (1, 1), (2, 1), (3, 1), (0, 300), (1, 1000)])
def test_no_ray_reaches_what_the_ground_is_said_to_hide(seed, crowd):
    ground = _ground(seed)
    rng = np.random.default_rng(seed)
    triangles = _triangles(ground)
    relief = relief_of(ground)
    hidden = 0
    for _ in range(3):
        x, y = rng.uniform(-12, 12, 2) + np.array([3, -2])
        eye = np.array([x, y, _height(ground, x, y) + 10 ** rng.uniform(-0.5, 0.7)])
        rig = _rig(look_at(eye, eye + np.array([1.0, 0.3, -0.1]), 0.0), 3.0)
        # Among many views each has a coarser horizon.
        views = outlook((replace(rig, to_world=np.repeat(rig.to_world, crowd, axis=0)),))
        horizon = horizon_of(relief, ground, views)
        assert len(horizon.slope) == crowd
        for _ in range(80):
            px, py = rng.uniform(-19, 19, 2) + np.array([3, -2])
            radius = 10 ** rng.uniform(-2, 0.3)
            ball = np.array([px, py, _height(ground, px, py) + rng.uniform(-0.5, 1) * radius])
            if not is_hidden(eye, horizon.slope[0], horizon.edges, *ball, radius):
                continue
            hidden += 1
            away = rng.normal(size=(4, 3))
            points = ball + radius * away / np.linalg.norm(away, axis=1)[:, None]
            assert (_first_hits(eye, points - eye, triangles) < 1.0).all()
    assert hidden > 5


def test_nothing_hides_from_an_eye_below_the_ground():
    ground = _ground()
    eye = np.array([3.0, -2.0, -30.0])
    views = outlook((_rig(look_at(eye, eye + np.array([1.0, 0.0, 0.1]), 0.0), 3.0),))
    assert (horizon_of(relief_of(ground), ground, views).slope == -np.inf).all()


def test_the_reliefs_bounds_hold_all_of_the_mesh():
    ground = _ground(5)
    relief = relief_of(ground)
    rng = np.random.default_rng(0)
    corners = _triangles(ground)[rng.integers(0, len(ground.tiles[0].faces), 5000)]
    weights = rng.dirichlet(np.ones(3), 5000)
    points = (corners * weights[:, :, None]).sum(axis=1)
    i = np.clip(((points[:, 0] - relief.frame[0]) / relief.frame[2]).astype(int), 0, None)
    j = np.clip(((points[:, 1] - relief.frame[1]) / relief.frame[3]).astype(int), 0, None)
    i, j = np.minimum(i, relief.low.shape[1] - 1), np.minimum(j, relief.low.shape[0] - 1)
    assert (relief.low[j, i] <= points[:, 2] + 1e-9).all()
    assert (relief.high[j, i] >= points[:, 2] - 1e-9).all()
    # Not because they are wide.
    assert np.median(relief.high - relief.low) < 0.1


@pytest.mark.parametrize("elevation", [3.0, 25.0, 80.0])
def test_a_shadow_that_falls_on_a_point_in_view_is_found(elevation):
    ground = _ground(1, 3.0)
    triangles = _triangles(ground)
    relief = relief_of(ground)
    rng = np.random.default_rng(2)
    x, y = 3.0, -2.0
    eye = np.array([x, y, _height(ground, x, y) + 1.5])
    views = outlook((_rig(look_at(eye, eye + np.array([1.0, 0.0, -0.25]), 0.0), 60.0),))
    eyes = Eyes(views, horizon_of(relief, ground, views))
    bounds = np.array([triangles.min(axis=(0, 1)) - 3, triangles.max(axis=(0, 1)) + 3])
    found = 0
    for azimuth in (0.3, 2.0, 4.5):
        e = np.deg2rad(elevation)
        sun = np.array([np.cos(e) * np.cos(azimuth), np.cos(e) * np.sin(azimuth), np.sin(e)])
        half = np.deg2rad(0.27)
        sweep = Sweep(-sun[None], np.array([[np.cos(half), np.tan(half)]]), np.zeros(1, np.int64),
                      bounds, relief)  # fmt: skip
        middles, radii, lighted = [], [], []
        grid = fine_cells(relief, bounds)
        shown = np.zeros(grid.low.shape, np.bool_)
        # Points that the view shows, and balls between them and a place on the sun's disc.
        for _ in range(60):
            u, v = rng.uniform(0, 80), rng.uniform(0, 60)
            pose = look_at(eye, eye + np.array([1.0, 0.0, -0.25]), 0.0)
            way = pose[:3, :3] @ np.array([(u - 40) / 60, (v - 30) / 60, 1.0])
            t = _first_hits(eye, [way], triangles)[0]
            if not np.isfinite(t):
                continue
            i, j = ((eye + t * way)[:2] - grid.frame[:2]) // grid.frame[2:]
            shown[int(j), int(i)] = True
            beside = np.cross(sun, rng.normal(size=3))
            to_disc = sun + np.tan(half) * beside / np.linalg.norm(beside) * rng.uniform(0, 1)
            middle = eye + t * way + to_disc * 10 ** rng.uniform(-1, 1.3)
            if (middle < bounds[0]).any() or (middle > bounds[1]).any():
                continue
            # What the ground keeps from the light has no shadow of this to show.
            back = eye + (t - 1e-6) * way
            lighted.append(np.isinf(_first_hits(back, [to_disc], triangles)[0]))
            middles.append(middle)
            radii.append(10 ** rng.uniform(-2, 0))
        at, reach = np.array(middles), np.array(radii)
        groups = grouped(at, reach, 2.0)
        none = np.zeros(len(at), np.bool_)
        seen = seen_by(eyes, at, reach, groups, views.color) == SHOWN
        places = places_seen(grid, shown, np.zeros((0, 3)), np.zeros(0))
        lit = shadows_seen(eyes, places, sweep, at, reach, none)
        free = np.array(lighted)
        assert lit[free].all()
        found += int((free & ~seen).sum())
    assert found >= 2


def test_groups_decide_as_each_ball_alone_does():
    ground = _ground(7)
    rng = np.random.default_rng(7)
    x, y = 0.0, 0.0
    eye = np.array([x, y, _height(ground, x, y) + 2.0])
    views = outlook((_rig(look_at(eye, eye + np.array([0.0, 1.0, -0.1]), 0.0)),))
    eyes = Eyes(views, horizon_of(relief_of(ground), ground, views))
    middles = np.append(rng.uniform(-15, 15, (800, 2)), rng.uniform(-4, 6, (800, 1)), axis=1)
    radii = 10 ** rng.uniform(-2, 0.5, 800)
    together = seen_by(eyes, middles, radii, grouped(middles, radii, 4.0), views.color)
    alone = seen_by(eyes, middles, radii, grouped(middles, radii, 1e-6), views.color)
    assert ((together == SHOWN) == (alone == SHOWN)).all()
    assert 50 < (together == SHOWN).sum() < 700


def test_the_sum_of_what_is_left_out_is_no_less_than_the_exact_one():
    ground = _ground(2, 0.5)
    relief = relief_of(ground)
    rng = np.random.default_rng(4)
    bounds = np.array([[-17.0, -22.0, -3.0], [23.0, 18.0, 6.0]])
    grid = fine_cells(relief, bounds)
    seen = np.zeros(grid.low.shape, np.bool_)
    seen[20:60, 30:70] = True
    places = places_seen(grid, seen, np.zeros((0, 3)), np.zeros(0))
    middles = np.stack([rng.uniform(-16, 22, 700), rng.uniform(-21, 17, 700)], axis=1)
    middles = np.append(middles, np.array([[_height(ground, *p)] for p in middles[:700]]), axis=1)
    radii = 10 ** rng.uniform(-2.2, -0.8, 700)
    nothing = Sweep(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0, np.int64), bounds, relief)
    chosen = choose(places, nothing, Factors(0.8, 0.0), middles, radii, 0.01)
    assert 20 < (~chosen.keep).sum() < 700
    assert 0.0 < chosen.reached <= 0.01
    out, reach = middles[~chosen.keep], radii[~chosen.keep]
    triangles = _triangles(ground)
    for _ in range(10):
        j, i = rng.integers(20, 60), rng.integers(30, 70)
        x, y = grid.frame[:2] + (np.array([i, j]) + rng.uniform(0, 1, 2)) * grid.frame[2]
        point = np.array([x, y, _height(ground, x, y) + 1e-3])
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        way = out - point
        distance = np.linalg.norm(way, axis=1)
        cosine = (way @ normal) / distance
        facing = cosine > 0.0
        clear = _first_hits(point, way[facing], triangles) >= 0.98
        exact = 0.8 * ((reach / distance) ** 2 * cosine)[facing][clear].sum()
        assert exact <= chosen.reached


def test_without_a_horizon_only_the_cone_counts():
    views = outlook((_rig(look_at(np.zeros(3), np.array([1.0, 0, 0]), 0.0)),))
    eyes = Eyes(views, Horizon(np.zeros((1, 0, 0), np.float32), np.zeros(2)))
    middles = np.array([[10.0, 0, 0], [-10.0, 0, 0]])
    radii = np.array([0.1, 0.1])
    shown = seen_by(eyes, middles, radii, grouped(middles, radii, 1.0), views.color)
    assert (shown == SHOWN).tolist() == [True, False]


@pytest.mark.filterwarnings("error")
def test_cells_without_ground_change_nothing_of_what_is_seen_beside_them():
    """As under a mesh with holes, which hides nothing: nothing is known to be low there."""
    ground = _ground()
    relief = relief_of(ground)
    relief.low[:] = -np.inf
    relief.high[: len(relief.high) // 3] = -np.inf
    bounds = np.array([[-17.0, -22, -4], [23, 18, 6]])
    grid = fine_cells(relief, bounds)
    views = outlook((_rig(look_at(np.array([3.0, -2, 8]), np.array([9.0, 6, 0]), 0.0)),))
    eyes = Eyes(views, Horizon(np.zeros((len(views.eye), 0, 0), np.float32), np.zeros(2)))
    seen = _seen_ground(grid, eyes, 2.0)
    empty = grid.high == -np.inf
    assert empty.any()
    assert not seen[empty].any()
    # What is told one by one, without groups, is seen no less in groups.
    alone = _seen_ground(grid, eyes, 1e-9)
    assert seen.any()
    assert np.array_equal(seen, alone)
