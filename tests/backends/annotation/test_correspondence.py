"""Flow, scene flow, disparity and occlusion against projections, homographies and moving boxes."""

from __future__ import annotations

import copy
import dataclasses
import json
from pathlib import Path

import moving_stages as ms
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pxr import UsdGeom

from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.registry import open_backend
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.schemas.correspondence import (
    BEFORE,
    HIDDEN,
    NEXT,
    NOTHING,
    OUTSIDE,
    PARTNER,
    VISIBLE,
)
from scenec.schemas.errors import BackendError, CfgError, SceneError
from scenec.testing.examples import examples
from scenec.testing.foreign_stages import new_stage
from scenec.testing.scenes import icosphere
from scenec.testing.small import small_cfg

#: Without a partner.
MONO = ("depth", "position", *NEXT, *BEFORE)
ALL = (*MONO, *PARTNER)


def looking(eye, target, roll=0.0) -> np.ndarray:
    """A pose with OpenCV axes, upright but for a roll."""
    z = np.asarray(target, float) - eye
    z /= np.linalg.norm(z)
    up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(roll), np.sin(roll)
    pose = np.eye(4)
    pose[:3] = np.stack([c * x + s * y, c * y - s * x, z, np.asarray(eye, float)], axis=1)
    return pose


K = np.array([[60.0, 0.4, 31.0], [0.0, 63.0, 22.5], [0.0, 0.0, 1.0]])


def camera(pose, k=K, name="rig_a", partner=None, size=(64, 48)) -> Camera:
    return Camera(name, f"/World/{name}", *size, k, pose, 0.0, MONO, partner)


def with_cameras(scene: RenderScene, cameras: list[list[Camera]]) -> RenderScene:
    return dataclasses.replace(
        scene,
        samples=len(cameras),
        cameras=tuple(tuple(some) for some in cameras),
        lighting=scene.lighting[:1] * len(cameras),
    )


class Quiet(RenderScene):
    """A scene that hypothesis prints in a word."""

    def _repr_pretty_(self, printer, cycle) -> None:
        printer.text("bumps")


def render(scene: RenderScene, sample: int, index: int = 0, passes=MONO) -> dict[str, np.ndarray]:
    session = Session(scene, None)
    return session.render(scene.cameras[sample][index], sample, passes, 1, 0).arrays


@pytest.fixture(scope="module")
def bumps(tmp_path_factory) -> RenderScene:
    """A plane with balls on it, nothing moves."""
    rng = np.random.default_rng(5)
    stage = new_stage(tmp_path_factory.mktemp("bumps") / "stage.usda", "/World")
    corners = np.array([[-30, -30, 0], [30, -30, 0], [30, 30, 0], [-30, 30, 0]])
    ms.add_mesh(stage, "/World/Plane", corners, [[0, 1, 2], [0, 2, 3]])
    points, faces = icosphere(2)
    for i in range(12):
        ball = ms.add_mesh(stage, f"/World/Ball{i}", points, faces)
        place = [*rng.uniform(-6, 6, 2), rng.uniform(0, 1.5)]
        UsdGeom.Xformable(ball).AddTransformOp().Set(
            ms.matrix(np.array(place), 10.0 * i, rng.uniform(0.3, 1.2))
        )
    ms._camera(stage)
    stage.Save()
    scene = read_stage(Path(stage.GetRootLayer().realPath))
    return Quiet(**{f.name: getattr(scene, f.name) for f in dataclasses.fields(scene)})


def pixel_rays(one: Camera, uv: np.ndarray) -> np.ndarray:
    """World directions through places in the picture, z = 1; float64 [n, 3]."""
    local = np.linalg.solve(one.intrinsics, np.stack([*uv.T, np.ones(len(uv))])).T
    return local @ one.camera_to_world[:3, :3].T


poses = st.builds(
    lambda a, b, c: looking((a[0], a[1], 3 + a[2]), (b[0], b[1], 0.5), c),
    st.tuples(*[st.floats(-9, 9)] * 2, st.floats(0, 6)),
    st.tuples(*[st.floats(-4, 4)] * 2),
    st.floats(-3, 3),
)


@given(poses, poses)
@examples(25)
def test_what_flow_leads_to_has_the_depth_that_the_other_frame_sees(bumps, pose_a, pose_b):
    """Depth and poses of one frame give the other's depth, to 1e-6, wherever that shows it."""
    scene = with_cameras(bumps, [[camera(pose_a)], [camera(pose_b)]])
    made = render(scene, 0)
    other = scene.cameras[1][0]
    v, u = np.mgrid[:48, :64] + 0.5
    uv = np.stack([u, v], axis=-1) + made["flow"]
    seen = (made["occlusion"] == VISIBLE) & np.isfinite(made["depth"])
    directions = pixel_rays(other, uv[seen])
    origin = np.broadcast_to(other.camera_to_world[:3, 3], directions.shape)
    rays = dataclasses.replace(
        camera_rays(other), origins=origin.copy(), directions=directions, shape=(1, len(origin))
    )
    t = ExactCaster(scene).cast(rays)[2]
    expected = (made["position"][seen] - other.camera_to_world[:3, 3]) @ other.camera_to_world[
        :3, 2
    ]
    assert np.abs(t / expected - 1.0).max(initial=0.0) < 1e-6
    np.testing.assert_allclose(
        np.linalg.norm(origin + t[:, None] * directions - made["position"][seen], axis=1),
        0.0,
        atol=1e-5,
    )


@given(poses, poses)
@examples(15)
def test_each_code_is_what_a_march_along_the_line_of_sight_finds(bumps, pose_a, pose_b):
    scene = with_cameras(bumps, [[camera(pose_a)], [camera(pose_b)]])
    made = render(scene, 0)
    other = scene.cameras[1][0]
    eye = other.camera_to_world[:3, 3]
    points = made["position"].reshape(-1, 3)
    code = made["occlusion"].ravel()
    hit = np.isfinite(points[:, 0])
    local = (points - eye) @ other.camera_to_world[:3, :3]
    with np.errstate(all="ignore"):
        uv = (local / local[:, 2:]) @ other.intrinsics.T
    inside = (local[:, 2] > 0) & ((uv[:, :2] >= 0) & (uv[:, :2] <= (64, 48))).all(axis=1)
    assert (code[hit & ~inside] == OUTSIDE).all()
    # Balls and the plane, by formula: the meshes are inscribed, hence the margins.
    blocked, clear = np.zeros(len(points), bool), np.ones(len(points), bool)
    for row in scene.rows.to_world[1:]:
        center, radius = row[:, 3], np.linalg.norm(row[:, 0])
        d = points - eye
        length = np.linalg.norm(d, axis=1)
        d /= length[:, None]
        along = np.clip(((center - eye) * d).sum(axis=1), 0, length)
        miss = np.linalg.norm(eye + along[:, None] * d - center, axis=1)
        own = np.abs(np.linalg.norm(points - center, axis=1) - radius) < 0.06 * radius
        own &= points[:, 2] > 1e-9
        blocked |= (miss < 0.9 * radius) & ~own & (along < length - radius)
        clear &= (miss > 1.0 * radius) | own
    assert (code[hit & inside & blocked] == HIDDEN).all()
    away = clear & (eye[2] > 0) & (points[:, 2] < 1e-9)
    assert (code[hit & inside & away] == VISIBLE).all()


def test_flow_over_a_plane_is_the_homography_of_the_two_poses(bumps):
    plane = dataclasses.replace(
        bumps,
        rows=dataclasses.replace(
            bumps.rows,
            **{k: getattr(bumps.rows, k)[:1] for k in ("mesh", "to_world", "instance_id")},
            variation=bumps.rows.variation[:1],
            part=None if bumps.rows.part is None else bumps.rows.part[:1],
        ),
    )
    a, b = looking((1, -8, 3), (0, 2, 0), 0.2), looking((1.5, -7.2, 2.5), (0.3, 2, 0), -0.3)
    made = render(with_cameras(plane, [[camera(a)], [camera(b)]]), 0)
    # X = A (x, y, 1) on the ground: K R^T [e1 e2 -eye] of each view.
    h = [K @ p[:3, :3].T @ np.stack([*np.eye(3)[:2], -p[:3, 3]], axis=1) for p in (a, b)]
    v, u = np.mgrid[:48, :64] + 0.5
    to = np.stack([u, v, np.ones_like(u)], -1) @ (h[1] @ np.linalg.inv(h[0])).T
    expected = to[..., :2] / to[..., 2:] - np.stack([u, v], -1)
    ground = np.isfinite(made["depth"])
    assert ground.sum() > 1000
    np.testing.assert_allclose(made["flow"][ground], expected[ground], atol=1e-8)


def test_flow_of_the_sky_is_that_of_a_turn_whatever_the_way(bumps):
    a, b = looking((0, -8, 2), (0, 30, 14)), looking((3, -9, 2.5), (2, 30, 15), 0.1)
    made = render(with_cameras(bumps, [[camera(a)], [camera(b)]]), 0)
    h = K @ b[:3, :3].T @ a[:3, :3] @ np.linalg.inv(K)
    v, u = np.mgrid[:48, :64] + 0.5
    to = np.stack([u, v, np.ones_like(u)], -1) @ h.T
    sky = np.isinf(made["depth"])
    assert sky.sum() > 500
    expected = to[..., :2] / to[..., 2:] - np.stack([u, v], -1)
    np.testing.assert_allclose(made["flow"][sky], expected[sky], atol=1e-9)
    assert np.isnan(made["scene_flow"][sky]).all()


def test_forward_and_backward_flow_undo_each_other(bumps):
    """Through the exact caster at the place that flow leads to: no interpolation between pixels."""
    a, b = looking((1, -8, 3), (0, 2, 0)), looking((2.0, -7.5, 3.2), (0.5, 2, 0), 0.1)
    scene = with_cameras(bumps, [[camera(a)], [camera(b)]])
    made = render(scene, 0)
    v, u = np.mgrid[:48, :64] + 0.5
    checked = 0
    for y, x in ((30, 20), (35, 40), (24, 33), (40, 10), (20, 50)):
        if made["occlusion"][y, x] != VISIBLE:
            continue
        # The second camera with one pixel, whose center is where flow leads to.
        k = K.copy()
        k[:2, 2] += 0.5 - (np.array([u[y, x], v[y, x]]) + made["flow"][y, x])
        one = with_cameras(bumps, [[camera(a)], [camera(b, k, size=(1, 1))]])
        back = render(one, 1, passes=("flow_backward",))["flow_backward"][0, 0]
        np.testing.assert_allclose(back + 0.5, (u[y, x], v[y, x]), atol=1e-8)
        checked += 1
    assert checked >= 3


def test_what_moves_takes_its_points_along(tmp_path):
    path = np.array([[5.0, -1.0, 1.0], [5.5, 0.2, 1.3], [7.0, 0.9, 1.0]])
    turns = (0.0, 35.0, 100.0)
    points, faces = icosphere(2)
    stage = new_stage(tmp_path / "stage.usda", "/World", samples=3)
    ball = ms.add_mesh(stage, "/World/Ball", points, faces)
    op = UsdGeom.Xformable(ball).AddTransformOp()
    for sample, (place, turn) in enumerate(zip(path, turns, strict=True)):
        op.Set(ms.matrix(place, turn, 0.8), sample)
    wall = np.array([[12, -20, -20], [12, 20, -20], [12, 20, 20], [12, -20, 20]])
    ms.add_mesh(stage, "/World/Wall", wall, [[0, 1, 2], [0, 2, 3]])
    ms._camera(stage)
    stage.Save()
    scene = read_stage(tmp_path / "stage.usda")
    eye = looking((0, 0, 1), (5, 0, 1))
    scene = with_cameras(scene, [[camera(eye)]] * 3)
    session = Session(scene, None)
    for sample in (1, 0, 1):
        made = session.render(scene.cameras[sample][0], sample, (*MONO, "instance"), 1, 0).arrays
        on_ball = made["depth"] < 10
        assert on_ball.sum() > 50
        turn = np.radians(turns[sample + 1] - turns[sample])
        c, s = np.cos(turn), np.sin(turn)
        r = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        now = made["position"][on_ball]
        then = (now - path[sample]) @ r.T + path[sample + 1]
        np.testing.assert_allclose(
            made["scene_flow"][on_ball], (then - now) @ eye[:3, :3], atol=1e-12
        )
        local = (then - eye[:3, 3]) @ eye[:3, :3]
        uv = (local / local[:, 2:]) @ K.T
        v, u = np.mgrid[:48, :64] + 0.5
        centers = np.stack([u, v], -1)[on_ball]
        np.testing.assert_allclose(made["flow"][on_ball], uv[:, :2] - centers, atol=1e-10)
        # What turned away is behind the ball itself; what faces the eye is seen.
        normal = (then - path[sample + 1]) / np.linalg.norm(then - path[sample + 1], axis=1)[
            :, None
        ]
        facing = (normal * (eye[:3, 3] - then)).sum(axis=1) / np.linalg.norm(
            eye[:3, 3] - then, axis=1
        )
        code = made["occlusion"][on_ball]
        assert (code[facing > 0.15] == VISIBLE).all()
        assert (code[facing < -0.15] == HIDDEN).all()
        still = ~on_ball
        np.testing.assert_allclose(made["flow"][still], 0.0, atol=1e-10)
    assert (session.render(scene.cameras[2][0], 2, MONO, 1, 0).arrays["occlusion"] == NOTHING).all()


def test_first_and_last_samples_have_nothing_before_and_after(bumps):
    scene = with_cameras(bumps, [[camera(looking((1, -8, 3), (0, 2, 0)))]] * 2)
    first = render(scene, 0, passes=("flow", "flow_backward", "occlusion_backward"))
    assert np.isnan(first["flow_backward"]).all()
    assert np.isfinite(first["flow"]).any()
    assert (first["occlusion_backward"] == NOTHING).all()
    last = render(scene, 1, passes=("flow", "occlusion", "scene_flow"))
    assert np.isnan(last["flow"]).all()
    assert np.isnan(last["scene_flow"]).all()
    assert (last["occlusion"] == NOTHING).all()


@pytest.mark.parametrize("far", [1.0, 1e3, 1e6])
def test_flow_holds_near_and_far(tmp_path, far):
    """A plane at 1 cm to 1e6 m: flow is focal length times step over depth."""
    stage = new_stage(tmp_path / "stage.usda", "/World")
    depth = 0.01 * far
    wall = np.array([[depth, -9 * far, -9 * far], [depth, 9 * far, -9 * far], [depth, 0, 9 * far]])
    ms.add_mesh(stage, "/World/Wall", wall, [[0, 1, 2]])
    ms._camera(stage)
    stage.Save()
    scene = read_stage(tmp_path / "stage.usda")
    k = np.array([[80.0, 0, 32], [0, 80, 24], [0, 0, 1]])
    poses = [looking((0, y, 0), (9, y, 0)) for y in (0.0, 0.001 * far)]
    scene = with_cameras(scene, [[camera(pose, k)] for pose in poses])
    made = render(scene, 0)
    actual = float(scene.meshes[0].points[0, 0])
    np.testing.assert_allclose(made["flow"][..., 0], 80 * 0.001 * far / actual, rtol=1e-9)
    np.testing.assert_allclose(made["flow"][..., 1], 0.0, atol=1e-9)


def test_disparity_is_focal_length_times_base_over_depth(bumps):
    left = looking((1, -8, 2), (0, 2, 0))
    right = left.copy()
    right[:3, 3] += 0.25 * left[:3, 0]
    k = np.array([[60.0, 0, 31], [0, 60, 22.5], [0, 0, 1]])
    shifted = k + np.array([[0, 0, 3.0], [0, 0, 0], [0, 0, 0]])
    pair = [
        camera(left, k, "rig_l", "/World/rig_r"),
        camera(right, shifted, "rig_r", "/World/rig_l"),
    ]
    scene = with_cameras(bumps, [pair])
    one, two = (render(scene, 0, i, ALL) for i in range(2))
    for made, sign in ((one, 1.0), (two, -1.0)):
        hit = np.isfinite(made["depth"])
        expected = sign * (60 * 0.25 / made["depth"] - 3.0)
        np.testing.assert_allclose(made["disparity"][hit], expected[hit], atol=1e-9)
        np.testing.assert_allclose(made["disparity"][~hit], -3.0 * sign, atol=1e-9)
    codes = set(np.unique(one["disparity_occlusion"]).tolist())
    assert codes == {VISIBLE, HIDDEN, OUTSIDE}
    # Left-right check, as stereo benchmarks do it: where both agree the point is seen.
    h, w = one["depth"].shape
    for y in range(0, h, 5):
        for x in range(0, w, 3):
            if one["disparity_occlusion"][y, x] != HIDDEN:
                continue
            column = x + 0.5 - one["disparity"][y, x]
            near = two["depth"][
                y, [max(0, int(column) - 1), int(column), min(w - 1, int(column) + 1)]
            ]
            assert near.min() < one["depth"][y, x]


def test_disparity_without_its_partner_is_an_error(bumps):
    scene = with_cameras(bumps, [[camera(looking((1, -8, 2), (0, 2, 0)))]])
    with pytest.raises(BackendError, match="needs a partner"):
        render(scene, 0, passes=("disparity",))


def test_all_renderers_give_the_same_bits(bumps):
    poses = looking((1, -8, 3), (0, 2, 0)), looking((2.0, -7.5, 3.2), (0.5, 2, 0), 0.1)
    scene = with_cameras(bumps, [[camera(pose)] for pose in poses])
    truth = render(scene, 0, passes=MONO)
    made = Session(scene, open_backend("mitsuba")).render(scene.cameras[0][0], 0, MONO, 1, 0).arrays
    for name in MONO:
        assert made[name].tobytes() == truth[name].tobytes(), name


def stereo(cfg: dict) -> dict:
    cfg = copy.deepcopy(cfg)
    rig = next(iter(cfg["rigs"].values()))
    sensor = next(iter(rig["sensors"].values()))
    sensor |= {"outputs": ["depth", "flow", "disparity"], "partner": "right"}
    other = copy.deepcopy(sensor) | {"outputs": ["depth"]}
    other["mount"] = {"position_m": [0.12, 0, 0]}
    del other["partner"]
    rig["sensors"] = {"left": sensor, "right": other}
    return cfg


@pytest.fixture
def cfg() -> dict:
    return small_cfg()


def compiled(tmp_path: Path, cfg: dict) -> Path:
    path = tmp_path / "cfg.json"
    path.write_text(json.dumps(cfg))
    compile_cfg(path, seed=3, out=tmp_path / "out", batches=range(1))
    return tmp_path / "out" / "batch_0000" / "stage.usda"


def test_a_pair_of_a_cfg_has_its_disparity(tmp_path, cfg):
    scene = read_stage(compiled(tmp_path, stereo(cfg)))
    left = next(c for c in scene.cameras[1] if c.name.endswith("left"))
    assert left.partner == left.path.replace("left", "right")
    session = Session(scene, None)
    made = session.render(left, 1, session.passes(None, left), 1, 0).arrays
    hit = np.isfinite(made["depth"])
    np.testing.assert_allclose(
        made["disparity"][hit], left.intrinsics[0, 0] * 0.12 / made["depth"][hit], rtol=1e-9
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mount": {"position_m": [0.12, 0, 0], "rotation_deg": [0, 1, 0]}}, "turned differently"),
        ({"mount": {"position_m": [0.12, 0.01, 0]}}, "apart downwards"),
        ({"mount": {"position_m": [0, 0, 0]}}, "in one place"),
        ({"resolution": [32, 24]}, "resolutions"),
        ({"fov_deg": 40}, "their fx"),
    ],
)
def test_a_pair_that_is_not_rectified_is_named(tmp_path, cfg, change, message):
    made = stereo(cfg)
    next(iter(made["rigs"].values()))["sensors"]["right"] |= change
    with pytest.raises(SceneError, match=message):
        compiled(tmp_path, made)


@pytest.mark.parametrize(
    ("partner", "message"),
    [("rihgt", 'did you mean "right"'), ("left", "of itself"), (None, "needs the key partner")],
)
def test_a_partner_that_is_not_there_is_a_fault(tmp_path, cfg, partner, message):
    made = stereo(cfg)
    sensor = next(iter(made["rigs"].values()))["sensors"]["left"]
    if partner is None:
        del sensor["partner"]
    else:
        sensor["partner"] = partner
    with pytest.raises(CfgError, match=message):
        compiled(tmp_path, made)
