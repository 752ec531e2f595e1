"""Annotation while a shutter is open: row by row that of a camera of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from scenec.backends.annotation.annotate import annotate
from scenec.backends.annotation.correspondence import match
from scenec.backends.annotation.instances import Instances
from scenec.backends.camera.rays import camera_rays
from scenec.backends.camera.shutter import (
    beside,
    is_rolling,
    places_of,
    poses_at,
    row_poses,
)
from scenec.backends.exact import ExactCaster
from scenec.backends.picture.compose import background
from scenec.backends.stage.scene import Camera, Lighting, OpenShutter, RenderScene, Sun
from scenec.backends.testing.scenes import look_at
from scenec.schemas.correspondence import VISIBLE
from scenec.schemas.depth_camera import DepthCamera, StereoDepth
from scenec.schemas.shutter import Shutter, between
from scenec.testing.examples import examples
from scenec.testing.lens_scenes import CAMERAS, around
from scenec.testing.scenes import affine, mesh, scene

PASSES = ("depth", "range", "label", "instance", "normal", "position", "face")


def moved(
    camera: Camera,
    shutter: Shutter,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    keys: int = 5,
) -> Camera:
    """A camera that goes at an even velocity (m/s) and turns at an even rate (rad/s), its own."""
    times = np.linspace(-1.0, 1.0, keys) * max(shutter.half_span, 1e-3)
    poses = np.repeat(camera.camera_to_world[None], keys, axis=0)
    poses[:, :3, 3] += times[:, None] * np.array(velocity)
    if not any(spin):
        return dataclasses.replace(camera, shutter=OpenShutter(shutter, times, poses))
    turned = Rotation.from_matrix(poses[:, :3, :3]) * Rotation.from_rotvec(
        times[:, None] * np.array(spin)
    )
    poses[:, :3, :3] = turned.as_matrix()
    poses[keys // 2] = camera.camera_to_world
    return dataclasses.replace(camera, shutter=OpenShutter(shutter, times, poses))


def still(camera: Camera, pose: NDArray) -> Camera:
    return dataclasses.replace(camera, shutter=None, camera_to_world=pose)


#: Twisting and passing by; downwards and upwards; through lenses.
SHUTTERS = (Shutter(0.004, 0.03), Shutter(0.0, 0.05, True))
PLAIN = look_at([0.3, -0.2, 1.4], [4.0, 2.0, 0.4], 61, 46)
VIEWS = {"pinhole": PLAIN, **CAMERAS}


def rolling(name: str, shutter: Shutter = SHUTTERS[0]) -> Camera:
    return moved(VIEWS[name], shutter, (6.0, -3.0, 1.0), (0.7, -2.0, 3.0))


@pytest.fixture(scope="module")
def world() -> RenderScene:
    meshes, rows = around(300)
    return scene(meshes, rows)


@pytest.fixture(scope="module")
def caster(world: RenderScene) -> ExactCaster:
    return ExactCaster(world)


angles = st.floats(-3.0, 3.0)


@examples(40)
@given(
    st.lists(st.tuples(angles, angles, angles), min_size=2, max_size=5),
    st.sampled_from([1.0, 1e-3, 1e-7, 1e-10]),
    st.lists(st.floats(-0.3, 1.3), min_size=1, max_size=8),
)
def test_poses_between_keys_are_scipys_slerp(
    turns: list[tuple[float, float, float]], scale: float, parts: list[float]
) -> None:
    """Of large, small and next to no turns; positions are linear; beyond the ends they are held."""
    vectors = np.array(turns) * np.array([scale, scale, scale])
    base = Rotation.from_rotvec([0.4, -1.0, 0.3])
    keys = base * Rotation.from_rotvec(vectors)
    times = np.cumsum(np.arange(1.0, len(turns) + 1.0)) * 0.01
    poses = np.repeat(np.eye(4)[None], len(turns), axis=0)
    poses[:, :3, :3] = keys.as_matrix()
    poses[:, :3, 3] = vectors * 7.0 + 100.0
    at = times[0] + np.array(parts) * (times[-1] - times[0])
    inside = np.clip(at, times[0], times[-1])
    steps = (keys[:-1].inv() * keys[1:]).magnitude()
    found = between(times, poses, at)
    if steps.max() < np.pi - 1e-6:
        expected = Slerp(times, keys)(inside).as_matrix()
        assert (
            np.abs(found[:, :3, :3] - expected).max() < 2e-9 * max(1.0, steps.max()) * 1e-3 + 1e-12
        )
    for k in range(3):
        expected = np.interp(inside, times, poses[:, k, 3])
        assert np.abs(found[:, k, 3] - expected).max() < 1e-10
    assert np.array_equal(between(times, poses, times), poses)


def test_half_a_turn_between_keys_has_one_answer() -> None:
    """About the axis whose first component is above 0, whichever sign rounding gives."""
    for axis in ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, -0.8, 0.0], [-0.6, 0.8, 0.0]):
        poses = np.repeat(np.eye(4)[None], 2, axis=0)
        poses[1, :3, :3] = Rotation.from_rotvec(np.pi * np.array(axis)).as_matrix()
        found = between(np.array([0.0, 1.0]), poses, np.array([0.5]))[0, :3, :3]
        leading = next(x for x in axis if x != 0.0)
        turn = 0.5 * np.pi * np.array(axis) * np.sign(leading)
        assert np.abs(found - Rotation.from_rotvec(turn).as_matrix()).max() < 1e-9


def test_a_single_key_is_held() -> None:
    poses = PLAIN.camera_to_world[None]
    found = between(np.zeros(1), poses, np.array([-1.0, 0.0, 5.0]))
    assert np.array_equal(found, np.repeat(poses, 3, axis=0))


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("shutter", SHUTTERS, ids=["down", "up"])
def test_each_row_is_that_of_a_still_camera_with_the_rows_pose(
    name: str, shutter: Shutter, world: RenderScene, caster: ExactCaster
) -> None:
    """Every pass to the bit, against a whole picture for each row; bands of rows are the same."""
    camera = rolling(name, shutter)
    rays = camera_rays(camera)
    found = annotate(world, caster, camera, PASSES, 0).arrays
    poses = row_poses(camera)
    sign = -1.0 if shutter.upward else 1.0
    for r in range(0, camera.height, 9):
        # The definition, said once more.
        at = sign * shutter.readout_s * ((r + 0.5) / camera.height - 0.5)
        assert camera.shutter is not None
        pose = poses_at(camera.shutter, np.array([at]))[0]
        assert np.array_equal(pose, poses[r])
        alone = still(camera, pose)
        expected = annotate(world, caster, alone, PASSES, 0).arrays
        for key, values in expected.items():
            real = values.dtype.kind == "f"
            assert np.array_equal(found[key][r], values[r], equal_nan=real), key
        part = camera_rays(camera, range(r, r + 1))
        row = slice(r * camera.width, (r + 1) * camera.width)
        assert np.array_equal(part.directions, rays.directions[row])
        assert np.array_equal(part.origins, rays.origins[row])
    assert len(np.unique(found["instance"])) > 7


@pytest.mark.parametrize("name", ["pinhole", "equirectangular"])
def test_amodal_masks_are_those_of_each_instance_alone(
    name: str, world: RenderScene, caster: ExactCaster
) -> None:
    camera = rolling(name)
    rays = camera_rays(camera)
    exact = caster.hits(rays)
    listed = Instances(world).seen(exact.row, exact.t, camera, 0, caster.geometry, True, rays)
    assert listed.amodal is not None
    meshes, rows = around(300)
    ids = listed.table["id"]
    for at in range(0, len(ids), max(1, len(ids) // 10)):
        alone = ExactCaster(scene(meshes, [rows[int(ids[at]) - 1]])).hits(rays)
        assert np.array_equal(listed.amodal.mask(at).ravel(), alone.row == 0)
        assert listed.table["amodal"][at] == (alone.row == 0).sum()


def test_a_camera_that_passes_an_upright_edge_sees_it_slanted() -> None:
    """Column u is where it is at the sample, less v readout fx / Z over the height: 1e-9 px."""
    wall = mesh([[0.0, 5.0, -9.0], [9.0, 5.0, -9.0], [9.0, 5.0, 9.0], [0.0, 5.0, 9.0]],
                [[0, 1, 2], [0, 2, 3]])  # fmt: skip
    flat = scene([wall], [(0, affine())])
    eye = look_at([0.0, 0.0, 0.0], [0.0, 5.0, 0.0], 400, 80)
    speed, readout, depth = 4.0, 0.05, 5.0
    camera = moved(eye, Shutter(0.0, readout), (speed, 0.0, 0.0), keys=2 * 1 + 1)
    found = annotate(flat, ExactCaster(flat), camera, ("instance",), 0).arrays
    fx, cx = camera.intrinsics[0, 0], camera.intrinsics[0, 2]
    v = np.arange(80) + 0.5
    edge = cx - speed * readout * (v / 80 - 0.5) * fx / depth
    u = np.arange(400) + 0.5
    assert np.array_equal(found["instance"] == 1, u[None, :] >= edge[:, None])
    # The same from a picture of points: exact, not to a pixel.
    points = np.stack([np.zeros(9), np.full(9, depth), np.linspace(-0.4, 0.4, 9)], axis=1)
    places = places_of(camera, points, np.zeros(9, bool))
    slope = speed * readout * fx / depth / 80
    straight = cx - slope * (places.pixel[:, 1] - 40.0)
    assert np.abs(places.pixel[:, 0] - straight).max() < 1e-9
    assert places.pixel[:, 1].min() < 35.0 < 45.0 < places.pixel[:, 1].max()


def test_exposure_alone_changes_no_annotation(world: RenderScene, caster: ExactCaster) -> None:
    camera = moved(PLAIN, Shutter(0.02, 0.0), (6.0, -3.0, 1.0), (0.7, -2.0, 3.0))
    assert not is_rolling(camera)
    plain = still(camera, camera.camera_to_world)
    one, two = camera_rays(camera), camera_rays(plain)
    assert np.array_equal(one.origins, two.origins)
    assert np.array_equal(one.directions, two.directions)
    found = annotate(world, caster, camera, PASSES, 0).arrays
    expected = annotate(world, caster, plain, PASSES, 0).arrays
    for key, values in expected.items():
        assert np.array_equal(values, found[key], equal_nan=values.dtype.kind == "f"), key


def test_a_camera_that_stands_still_does_not_roll() -> None:
    camera = moved(PLAIN, Shutter(0.01, 0.1))
    assert not is_rolling(camera)
    assert np.array_equal(camera_rays(camera).directions, camera_rays(PLAIN).directions)


def test_a_picture_of_one_row_is_that_of_the_sample() -> None:
    """Its row is the middle one."""
    line = dataclasses.replace(PLAIN, height=1)
    camera = moved(line, Shutter(0.01, 0.2), (6.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    assert is_rolling(camera)
    assert np.array_equal(row_poses(camera)[0], line.camera_to_world)
    assert np.array_equal(camera_rays(camera).directions, camera_rays(line).directions)


def test_half_a_turn_during_the_readout_is_followed(
    world: RenderScene, caster: ExactCaster
) -> None:
    """The first row looks one way, the last one back; nothing fails, rows are as ever."""
    camera = moved(PLAIN, Shutter(0.0, 1.0), spin=(0.0, np.pi, 0.0), keys=9)
    poses = row_poses(camera)
    turn = Rotation.from_matrix(poses[0, :3, :3]).inv() * Rotation.from_matrix(poses[-1, :3, :3])
    assert abs(turn.magnitude() - np.pi * (1.0 - 1.0 / camera.height)) < 1e-9
    rays = camera_rays(camera)
    found = caster.hits(rays)
    alone = still(camera, poses[3])
    expected = caster.hits(camera_rays(alone))
    row = slice(3 * camera.width, 4 * camera.width)
    assert np.array_equal(found.row[row], expected.row[row])
    points = rays.origins + np.where(np.isfinite(found.t), found.t, 1.0)[:, None] * rays.directions
    places = places_of(camera, points, np.zeros(len(points), bool))
    check_places(camera, points, np.zeros(len(points), bool), places.pixel)


def check_places(
    camera: Camera, points: NDArray, far: NDArray, pixel: NDArray, least: float = 0.0
) -> None:
    """Points through the pose of the row that was found land in that row, to 1e-6."""
    seen = ~np.isnan(pixel[:, 0])
    assert seen.mean() >= least
    held = camera.shutter
    assert held is not None
    sign = -1.0 if held.shutter.upward else 1.0
    times = sign * held.shutter.readout_s * (pixel[seen, 1] / camera.height - 0.5)
    pose = between(held.times, held.camera_to_world, times)
    offset = points[seen] - np.where(far[seen, None], 0.0, pose[:, :3, 3])
    local = np.einsum("nji,nj->ni", pose[:, :3, :3], offset)
    u, v, w = camera.intrinsics @ local.T
    assert np.abs(np.stack([u / w, v / w], axis=1) - pixel[seen]).max(initial=0.0) < 1e-6


@pytest.mark.parametrize("upward", [False, True])
def test_a_point_is_found_in_the_row_that_sees_it(upward: bool) -> None:
    """What each pixel shows, and each pixel of the sky, comes back to the pixel, to 1e-6."""
    camera = moved(PLAIN, Shutter(0.0, 0.03, upward), (6.0, -3.0, 1.0), (0.7, -2.0, 3.0))
    rays = camera_rays(camera)
    n = len(rays.origins)
    far = np.arange(n) % 3 == 0
    t = np.random.default_rng(2).uniform(0.5, 100.0, n)
    points = np.where(far[:, None], rays.directions, rays.origins + t[:, None] * rays.directions)
    places = places_of(camera, points, far)
    v, u = np.divmod(np.arange(n), camera.width)
    assert np.abs(places.pixel - np.stack([u + 0.5, v + 0.5], axis=1)).max() < 1e-6
    check_places(camera, points, far, places.pixel, 1.0)
    assert np.abs(places.local[~far, 2] - t[~far]).max() < 1e-6


def test_what_cannot_be_seen_has_no_place() -> None:
    """Behind the camera all along: NaN, no matter where the search begins."""
    camera = moved(PLAIN, Shutter(0.0, 0.03), (6.0, 0.0, 0.0), (0.0, 0.5, 0.0))
    pose = camera.camera_to_world
    points = pose[:3, 3] - np.array([[1.0], [50.0]]) * pose[:3, 2]
    places = places_of(camera, points, np.zeros(2, bool))
    assert np.isnan(places.pixel).all()


def test_flow_leads_to_what_the_other_picture_shows(
    world: RenderScene, caster: ExactCaster
) -> None:
    """Visible points, through the row that is found, land in it; the other frame's depth is theirs.

    Both frames roll; the second is elsewhere.
    """
    here = rolling("pinhole")
    there = moved(
        look_at([0.6, -0.1, 1.45], [4.0, 2.2, 0.5], 61, 46), SHUTTERS[0], (5.0, 2.0, 0.0),
        (0.5, 1.0, -2.0),
    )  # fmt: skip
    rays = camera_rays(here)
    exact = caster.hits(rays)
    found = match(world, caster, exact, rays, (here, 0), (there, 0))
    hit = exact.row >= 0
    points = rays.origins + np.where(hit, exact.t, 0.0)[:, None] * rays.directions
    check_places(there, np.where(hit[:, None], points, rays.directions), ~hit, found.pixel, 0.5)
    seen = np.flatnonzero((found.code == VISIBLE) & hit)
    assert len(seen) > 500
    # A ray of that row through that very point of the picture meets it again.
    held = there.shutter
    assert held is not None
    for n in seen[:: len(seen) // 60].tolist():
        u, v = found.pixel[n]
        pose = poses_at(held, held.shutter.middles(np.array([v]), there.height))[0]
        k = still(there, pose)
        k = dataclasses.replace(k, width=1, height=1, intrinsics=k.intrinsics - np.array(
            [[0, 0, u - 0.5], [0, 0, v - 0.5], [0, 0, 0]]))  # fmt: skip
        again = caster.hits(camera_rays(k))
        assert abs(again.t[0] - found.there[n, 2]) < 1e-6
        assert again.row[0] == exact.row[n]
    own = np.isfinite(exact.t)
    assert np.abs(found.here[own, 2] - exact.t[own]).max() < 1e-9


def test_a_rectified_pair_that_rolls_alike_differs_along_rows_alone(
    world: RenderScene, caster: ExactCaster
) -> None:
    """But for its second eye's arc between keys, whose chord it takes."""
    left = rolling("pinhole")
    right = beside(left, 0.2)
    rays = camera_rays(left)
    exact = caster.hits(rays)
    found = match(world, caster, exact, rays, (left, 0), (right, 0))
    hit = exact.row >= 0
    v, u = np.divmod(np.arange(len(hit)), left.width)
    assert np.abs(found.pixel[hit, 1] - (v + 0.5)[hit]).max() < 5e-3
    expected = left.intrinsics[0, 0] * 0.2 / exact.t
    assert np.abs((u + 0.5 - found.pixel[:, 0]) - expected)[hit].max() < 5e-3


def test_a_stereo_camera_rolls_with_both_eyes(world: RenderScene, caster: ExactCaster) -> None:
    """Without noise and steps it tells the exact depth wherever the second eye sees the point."""
    model = StereoDepth(baseline_m=0.1, noise_px=0.0, step_px=0.0, range_m=(0.05, 1e3))
    camera = dataclasses.replace(rolling("pinhole"), depth_camera=DepthCamera(model, 1))
    found = annotate(world, caster, camera, ["depth", "depth_measured"], 0).arrays
    told = found["depth_measured"]
    assert (told > 0.0).mean() > 0.4
    assert np.abs(told - found["depth"])[told > 0.0].max() < 1e-9


def test_the_sun_stands_where_the_rows_look() -> None:
    """Its disc is in each row where that row's still camera shows it."""
    eye = look_at([0.0, 0.0, 1.0], [0.0, 5.0, 2.0], 60, 50)
    camera = moved(eye, Shutter(0.0, 0.05), spin=(0.0, 6.0, 0.0))
    to_light = np.array([0.0, 5.0, 1.1]) / np.linalg.norm([0.0, 5.0, 1.1])
    sun = Sun(to_light, np.ones(3), np.radians(12.0))
    lit = dataclasses.replace(scene([], []), lighting=(Lighting((sun,), ()),))
    wanted = np.ones((50, 60), bool)
    found = background(lit, camera, 0, wanted)
    poses = row_poses(camera)
    assert (found.sum(axis=2) > 0.0).sum() > 100
    for r in range(0, 50, 7):
        expected = background(lit, still(camera, poses[r]), 0, wanted)
        assert np.abs(found[r] - expected[r]).max() < 1e-9
