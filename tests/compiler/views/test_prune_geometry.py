"""Pruning's geometric tests against brute force: what they call hidden, no sampled ray reaches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from scenec.compiler.geometry.poses import look_at
from scenec.compiler.scene.ground import Ground, GroundLayer, MeshTile
from scenec.compiler.scene.light import Lamp, SunDisc
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.compiler.scene.scene import Scene
from scenec.compiler.views.frustum import COLOR, Views, in_view, views_of_all
from scenec.compiler.views.illumination import (
    VisibleBlocks,
    shadows_visible_blocks,
    squared_distances,
    view_factors,
    visible_blocks,
)
from scenec.compiler.views.occlusion import BlockRelief, is_hidden, relief_of_tiles, with_horizon
from scenec.compiler.views.visible import SHOWN, visible

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
    tile = MeshTile("tile_000_000", np.array([3.0, -2.0, 1.0]), points, faces, np.zeros((n, 3)),
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
    views = views_of_all((rig,))
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
        assert in_view(views, 0, *middle, radius)
        far = pose[:3, 3] + rng.normal(size=3) * 20
        out += not in_view(views, 0, *far, 0.01)
    assert out > 500


def _bounds(ground: Ground, slack: float = 0.0) -> np.ndarray:
    triangles = _triangles(ground)
    return np.array([triangles.min(axis=(0, 1)) - slack, triangles.max(axis=(0, 1)) + slack])


def _seeing(ground: Ground, *rigs: Rig, slack: float = 0.0) -> tuple[BlockRelief, Views]:
    """The relief, and views that know what it hides."""
    views = views_of_all(rigs)
    relief = relief_of_tiles(ground.tiles, _bounds(ground, slack), len(views.eye))
    return relief, with_horizon(views, relief)


@pytest.mark.parametrize(("seed", "crowd"), [(0, 1), (1, 1), (2, 1), (3, 1), (0, 300), (1, 1000)])
def test_no_ray_reaches_what_the_ground_is_said_to_hide(seed, crowd):
    ground = _ground(seed)
    rng = np.random.default_rng(seed)
    triangles = _triangles(ground)
    hidden = 0
    for _ in range(3):
        x, y = rng.uniform(-12, 12, 2) + np.array([3, -2])
        eye = np.array([x, y, _height(ground, x, y) + 10 ** rng.uniform(-0.5, 0.7)])
        rig = _rig(look_at(eye, eye + np.array([1.0, 0.3, -0.1]), 0.0), 3.0)
        # Among many views each has wider blocks.
        _, views = _seeing(ground, replace(rig, to_world=np.repeat(rig.to_world, crowd, axis=0)))
        assert len(views.ceiling) == crowd
        for _ in range(80):
            px, py = rng.uniform(-19, 19, 2) + np.array([3, -2])
            radius = 10 ** rng.uniform(-2, 0.3)
            ball = np.array([px, py, _height(ground, px, py) + rng.uniform(-0.5, 1) * radius])
            if not is_hidden(views, 0, *ball, radius):
                continue
            hidden += 1
            away = rng.normal(size=(4, 3))
            points = ball + radius * away / np.linalg.norm(away, axis=1)[:, None]
            assert (_first_hits(eye, points - eye, triangles) < 1.0).all()
    assert hidden > 5


@pytest.mark.parametrize("eye", [(3.0, -2.0, -30.0), (3.0, -22.5, 3.0), (60.0, 0.0, 5.0)])
def test_nothing_hides_from_an_eye_below_the_ground_or_beside_it(eye):
    ground = _ground()
    at = np.array(eye)
    rig = _rig(look_at(at, np.array([3.1, -2.0, 1.0]), 0.0), 3.0)
    assert (_seeing(ground, rig)[1].ceiling == -np.inf).all()


def test_the_reliefs_bounds_hold_all_of_the_mesh():
    ground = _ground(5)
    relief = relief_of_tiles(ground.tiles, _bounds(ground, 2.0), 1)
    rng = np.random.default_rng(0)
    corners = _triangles(ground)[rng.integers(0, len(ground.tiles[0].faces), 5000)]
    weights = rng.dirichlet(np.ones(3), 5000)
    points = (corners * weights[:, :, None]).sum(axis=1)
    i, j = ((points[:, :2] - relief.frame[:2]) / relief.frame[2:]).astype(int).T
    assert (relief.low[j, i] <= points[:, 2] + 1e-9).all()
    assert (relief.high[j, i] >= points[:, 2] - 1e-9).all()
    # Not because they are wide.
    assert np.median((relief.high - relief.low)[relief.is_solid]) < 0.2
    # 40 of 44 m are ground; blocks that are so in part may hide nothing.
    assert relief.is_solid.mean() == pytest.approx((40 / 44) ** 2, rel=0.03)
    assert (relief.low[relief.is_solid] <= relief.high[relief.is_solid]).all()
    assert not relief.is_solid[0].any()


def _scene(ground: Ground, sun: np.ndarray | None, lamps: tuple[Lamp, ...] = ()) -> Scene:
    """A scene of a ground, one sample of a sun towards a direction, and lamps."""
    light = None
    if sun is not None:
        light = SunDisc(
            np.degrees(np.arctan2(sun[:1], sun[1:2])),
            np.degrees(np.arcsin(sun[2:])),
            *(np.array([value]) for value in (1000.0, 0.54)),
            np.ones((1, 3)),
        )
    return Scene("s", 1, np.zeros(1), {}, {}, {}, ground, (), light, None, (), ("rgb",),
                 _bounds(ground, 3.0), lamps=lamps)  # fmt: skip


def _shown_points(eye: np.ndarray, pose: np.ndarray, triangles: np.ndarray, rng, count: int):
    """Points of the ground that random places of the picture show."""
    u, v = rng.uniform(0, 80, count), rng.uniform(0, 60, count)
    ways = (pose[:3, :3] @ np.stack([(u - 40) / 60, (v - 30) / 60, np.ones(count)])).T
    far = _first_hits(eye, ways, triangles)
    near = np.isfinite(far)
    return (eye + (far[:, None] - 1e-6) * ways)[near]


@pytest.mark.parametrize("elevation", [3.0, 25.0, 80.0])
def test_a_shadow_that_falls_on_a_point_in_view_is_found(elevation):
    ground = _ground(1, 3.0)
    triangles = _triangles(ground)
    rng = np.random.default_rng(2)
    eye = np.array([3.0, -2.0, _height(ground, 3.0, -2.0) + 1.5])
    pose = look_at(eye, eye + np.array([1.0, 0.0, -0.25]), 0.0)
    relief, views = _seeing(ground, _rig(pose, 60.0), slack=3.0)
    seen = visible_blocks(relief, _bounds(ground, 3.0), views, np.zeros((0, 3)), np.zeros(0))
    found = 0
    for azimuth in (0.3, 2.0, 4.5):
        e = np.deg2rad(elevation)
        sun = np.array([np.cos(e) * np.cos(azimuth), np.cos(e) * np.sin(azimuth), np.sin(e)])
        scene = _scene(ground, sun)
        middles, radii, lighted = [], [], []
        # Balls between a point that the view shows and a place on the sun's disc.
        for point in _shown_points(eye, pose, triangles, rng, 60):
            beside = np.cross(sun, rng.normal(size=3))
            to_disc = sun + np.tan(np.deg2rad(0.27)) * beside / np.linalg.norm(
                beside
            ) * rng.uniform(0, 1)
            middle = point + to_disc * 10 ** rng.uniform(-1, 1.3)
            if (middle < scene.bounds[0]).any() or (middle > scene.bounds[1]).any():
                continue
            # What the ground keeps from the light has no shadow of this to show.
            lighted.append(np.isinf(_first_hits(point, [to_disc], triangles)[0]))
            middles.append(middle)
            radii.append(10 ** rng.uniform(-2, 0))
        at, reach, free = np.array(middles), np.array(radii), np.array(lighted)
        lit = shadows_visible_blocks(seen, scene, at, reach)
        assert lit[free].all()
        found += int((free & (visible(views, at, reach) != SHOWN)).sum())
    assert found >= 2


def test_a_lamps_shadow_that_falls_on_a_point_in_view_is_found():
    ground = _ground(1, 3.0)
    triangles = _triangles(ground)
    rng = np.random.default_rng(6)
    eye = np.array([3.0, -2.0, _height(ground, 3.0, -2.0) + 1.5])
    pose = look_at(eye, eye + np.array([1.0, 0.0, -0.25]), 0.0)
    relief, views = _seeing(ground, _rig(pose, 60.0), slack=3.0)
    seen = visible_blocks(relief, _bounds(ground, 3.0), views, np.zeros((0, 3)), np.zeros(0))
    at = eye + np.array([-4.0, 6.0, 4.0])
    to_world = np.eye(4)
    to_world[:3, 3] = at
    lamp = Lamp(
        name="lamp", to_world=to_world[None], intensity=np.ones((1, 3)),
        radius_m=np.array([0.05]), cone_deg=np.array([180.0]), softness=np.zeros(1),
    )  # fmt: skip
    scene = _scene(ground, None, (lamp,))
    points = _shown_points(eye, pose, triangles, rng, 200)
    # Balls that touch the line from the lamp's sphere to a point.
    start = at + 0.04 * rng.normal(size=points.shape) / 3.0
    way = points - start
    lighted = np.array(
        [_first_hits(s, [w], triangles)[0] >= 1.0 - 1e-5 for s, w in zip(start, way, strict=True)]
    )
    radii = 10 ** rng.uniform(-2, -0.3, len(points))
    aside = rng.normal(size=points.shape)
    aside *= (0.99 * radii / np.linalg.norm(aside, axis=1))[:, None]
    middles = start + rng.uniform(0.1, 0.95, (len(points), 1)) * way + aside
    inside = ((middles > scene.bounds[0]) & (middles < scene.bounds[1])).all(axis=1)
    lit = shadows_visible_blocks(seen, scene, middles, radii)
    assert (lighted & inside).sum() > 20
    assert lit[lighted & inside].all()
    # Not all that is there: what stands beyond the lamp casts no shadow here.
    beyond = at - 0.5 * way[:100] / np.linalg.norm(way[:100], axis=1)[:, None]
    assert not shadows_visible_blocks(seen, scene, beyond, np.full(len(beyond), 0.01)).any()


def test_blocks_are_seen_as_their_points_are_and_fill_falls_with_distance():
    ground = _ground(2, 0.5)
    eye = np.array([-10.0, -2.0, 4.0])
    pose = look_at(eye, eye + np.array([1.0, 0.0, -0.4]), 0.0)
    relief, views = _seeing(ground, _rig(pose, 60.0), slack=3.0)
    ball = np.array([[-16.0, 10.0, 2.0]])
    seen = visible_blocks(relief, _bounds(ground, 3.0), views, ball, np.array([0.5]))
    points = _shown_points(eye, pose, _triangles(ground), np.random.default_rng(0), 300)
    i, j = ((points[:, :2] - seen.frame[:2]) / seen.frame[2]).astype(int).T
    assert (seen.top[j, i] >= points[:, 2] - 1e-6).all()
    assert (seen.distance[j, i] == 0.0).all()
    i, j = ((ball[0, :2] - seen.frame[:2]) / seen.frame[2]).astype(int)
    assert seen.top[j, i] == 2.5
    # No more than the exact distance to any point seen, and less by no more than two blocks.
    at = np.random.default_rng(1).uniform((-16, -21), (22, 17), (400, 2))
    j, i = np.nonzero(seen.top > -np.inf)
    corners = seen.frame[:2] + np.stack([i, j], axis=1) * seen.frame[2]
    away = np.maximum(np.maximum(corners - at[:, None], at[:, None] - corners - seen.frame[2]), 0.0)
    exact = np.linalg.norm(away, axis=2).min(axis=1)
    middles = np.append(at, np.zeros((400, 1)), axis=1)
    with np.errstate(divide="ignore"):
        measured = 1.0 / np.sqrt(view_factors(seen, middles, np.ones(400)))
    assert (measured <= exact + 1e-9).all()
    assert (measured >= exact - 2.9 * seen.frame[2]).all()
    assert exact.max() > 5.0


def test_nothing_seen_leaves_nothing_to_fill():
    empty = np.full((4, 4), -np.inf)
    seen = VisibleBlocks(empty, np.full((4, 4), np.inf), empty, np.array([0.0, 0.0, 1.0, 1.0]), 9.0)
    assert (view_factors(seen, np.ones((3, 3)), np.full(3, 9.0)) == 0.0).all()


def test_without_a_horizon_only_the_volume_counts():
    views = views_of_all((_rig(look_at(np.zeros(3), np.array([1.0, 0, 0]), 0.0)),))
    assert (views.kind == COLOR).all()
    middles = np.array([[10.0, 0, 0], [-10.0, 0, 0], [0.05, 0, -10.0]])
    # What is straight below counts as seen.
    shown = visible(views, middles, np.full(3, 0.1)) == SHOWN
    assert shown.tolist() == [True, False, True]


@pytest.mark.filterwarnings("error")
def test_blocks_without_ground_are_not_seen_and_hide_nothing():
    """As of a mesh with a hole."""
    ground = _ground()
    tile = ground.tiles[0]
    corners = tile.points[tile.faces]
    kept = ~((corners[..., 1] < -8.0).any(axis=1) & (corners[..., 0] > -10.0).all(axis=1))
    holed = replace(ground, tiles=(replace(tile, faces=tile.faces[kept]),))
    rig = _rig(look_at(np.array([3.0, -2, 8]), np.array([9.0, -6, 0]), 0.0))
    relief, views = _seeing(holed, rig)
    empty = relief.high == -np.inf
    assert empty.any()
    assert not relief.is_solid[empty].any()
    seen = visible_blocks(relief, _bounds(ground, 3.0), views, np.zeros((0, 3)), np.zeros(0))
    assert (seen.top > -np.inf).any()
    assert not (seen.top[empty] > -np.inf).any()
    assert (seen.ground[empty] == -np.inf).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (40, 61)])
@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 1.0])
def test_distances_to_what_is_seen_are_those_of_another_transform(shape, share):
    rng = np.random.default_rng(5)
    top = np.where(rng.random(shape) < share, 3.0, -np.inf)
    if share == 0.0:
        assert np.isinf(squared_distances(top)).all()
        top.flat[rng.integers(top.size)] = -1e300
    # Where nothing is seen SciPy has no answer.
    if (top > -np.inf).any():
        expected = distance_transform_edt(top == -np.inf)
        np.testing.assert_array_equal(np.sqrt(squared_distances(top)), expected)
