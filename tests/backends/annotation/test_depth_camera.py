"""Depth cameras: what they say of planes and edges, by formula and by statistics."""

from __future__ import annotations

import copy
import dataclasses
import json
import math

import moving_stages as ms
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.stats import norm

from scenec.backends.annotation.depth_camera import measure_stereo, measure_time_of_flight
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera
from scenec.compiler.compile import compile_cfg
from scenec.schemas.depth_camera import (
    MEASURED,
    DepthCamera,
    StereoDepth,
    TimeOfFlightDepth,
    kind_of,
)
from scenec.schemas.errors import BackendError, CfgError
from scenec.testing.examples import examples
from scenec.testing.foreign_stages import new_stage
from scenec.testing.small import small_cfg

K = np.array([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]])
STEREO = StereoDepth(0.1, 0.0, 0.0, (0.0, 1e9))
TOF = TimeOfFlightDepth(0.0, 2.0, 1e6, 0.0, (0.0, 1e9))


def camera(model=None, key=5) -> Camera:
    pose = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    made = None if model is None else DepthCamera(model, key)
    return Camera("rig_a", "/World/a", 64, 48, K, pose, depth_camera=made)


@given(st.floats(0.2, 1e4), st.floats(0.01, 1), st.floats(0.01, 0.5))
@examples(30)
def test_stereo_depth_errs_with_the_square_of_depth(depth, base, noise):
    model = dataclasses.replace(STEREO, baseline_m=base, noise_px=noise)
    flat = np.full((48, 64), depth)
    made = measure_stereo(model, camera(), flat, np.ones((48, 64), bool), 3, 0)
    d = 100 * base / depth
    there = made > 0
    # The disparity is what is normal: it is read back from the depths.
    z = (100 * base / made[there] - d) / noise
    if d > 5 * noise:
        assert there.all()
        assert abs(z.mean()) < 5 / np.sqrt(z.size)
        assert abs(z.std() - 1) < 5 / np.sqrt(2 * z.size)
        assert np.median(made) == pytest.approx(depth, rel=0.2 * noise / d + 1e-3)


@pytest.mark.parametrize("step", [0.0625, 0.5, 1.0])
def test_stereo_depths_are_those_of_whole_steps(step):
    depth = np.linspace(0.5, 12.0, 48 * 64).reshape(48, 64)
    model = dataclasses.replace(STEREO, step_px=step)
    made = measure_stereo(model, camera(), depth, np.ones((48, 64), bool), 3, 0)
    steps = 10.0 / made[made > 0] / step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.abs(10.0 / made[made > 0] - 10.0 / depth[made > 0]).max() <= 0.5 * step + 1e-12


@given(st.floats(0.5, 20), st.floats(0.05, 1.0))
@examples(20)
def test_time_of_flight_noise_grows_with_range_squared_and_slant(reach, cosine):
    model = dataclasses.replace(TOF, noise_m=0.01)
    flat = np.full((64, 64), reach)
    made = measure_time_of_flight(model, flat, np.full_like(flat, cosine), np.ones_like(flat), 9, 1)
    expected = 0.01 * (reach / 2.0) ** 2 / cosine
    # Below 0 a phase is one just below the whole.
    assume(6 * expected < reach)
    off = (made - reach) / expected
    n = off.size
    assert abs(off.mean()) < 5 / np.sqrt(n)
    assert abs(off.std() - 1) < 5 / np.sqrt(2 * n)


@pytest.mark.parametrize("reach", [3.0, 14.9, 15.1, 40.0, 1000.3])
def test_ranges_are_told_modulo_the_ambiguity(reach):
    model = dataclasses.replace(TOF, ambiguity_m=15.0)
    flat = np.full((4, 4), reach)
    made = measure_time_of_flight(model, flat, np.ones_like(flat), np.full_like(flat, 0.8), 9, 1)
    np.testing.assert_allclose(made, (reach % 15.0) * 0.8, atol=1e-9)


@pytest.mark.parametrize("blur_px", [0.3, 0.4, 0.8, 2.0])
def test_at_an_edge_time_of_flight_has_ranges_between_the_two(blur_px):
    reach = np.where(np.arange(64) < 32, 2.0, 3.0)[None].repeat(8, 0)
    made = measure_time_of_flight(
        dataclasses.replace(TOF, blur_px=blur_px, ambiguity_m=15.0),
        reach, np.ones_like(reach), np.ones_like(reach), 1, 0,
    )  # fmt: skip
    # Half a pixel from the edge: the share of the spot beyond it, as a phasor.
    turn, beyond = 2 * np.pi / 15.0, norm.cdf(-0.5 / blur_px)
    mixed = (1 - beyond) / 4 * np.exp(2j * turn) + beyond / 9 * np.exp(3j * turn)
    assert np.abs(made[:, 31] - np.angle(mixed) / turn).max() < 2e-3
    reached = math.ceil(3 * blur_px)
    assert (np.abs(made - reach)[:, [*range(32 - reached), *range(32 + reached, 64)]] < 1e-9).all()
    sharp = measure_time_of_flight(TOF, reach, np.ones_like(reach), np.ones_like(reach), 1, 0)
    np.testing.assert_allclose(sharp, reach, rtol=1e-9)


@pytest.fixture(scope="module")
def step_scene(tmp_path_factory):
    """A wall at 4 m, and a board at 2 m before its middle."""
    stage = new_stage(tmp_path_factory.mktemp("depth") / "stage.usda", "/World")
    for name, x, size in (("Wall", 4.0, 9.0), ("Board", 2.0, 0.2)):
        corners = size * np.array([[0.0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
        ms.add_mesh(stage, f"/World/{name}", corners + np.array([x, 0, 0]), [[0, 1, 2], [0, 2, 3]])
    ms._camera(stage)
    stage.Save()
    return read_stage(stage.GetRootLayer().realPath)


def test_stereo_has_no_answer_in_the_shadow_beside_what_stands_out(step_scene):
    one = camera(STEREO)
    scene = dataclasses.replace(step_scene, cameras=((one,),), samples=1)
    made = Session(scene, None).render(one, 0, ("depth", MEASURED), 1, 0).arrays
    row_depth, row = made["depth"][24], made[MEASURED][24]
    # The other camera stands right: it sees the wall right of the board, not all of it left.
    hole = np.flatnonzero((row == 0) & (row_depth > 3))
    board = np.flatnonzero(row_depth < 3)
    inside = hole[hole > 2]
    width = 100 * 0.1 * (1 / 2.0 - 1 / 4.0)
    assert len(board) == pytest.approx(100 * 0.4 / 2.0, abs=1)
    assert inside.max() == board.min() - 1
    assert len(inside) == pytest.approx(width, abs=1)
    answered = row > 0
    np.testing.assert_allclose(row[answered], row_depth[answered], rtol=1e-9)


def test_without_a_hit_or_a_model_there_is_no_answer(step_scene):
    away = camera(TOF)
    pose = away.camera_to_world.copy()
    pose[:3, 2] *= -1
    pose[:3, 0] *= -1
    away = dataclasses.replace(away, camera_to_world=pose)
    scene = dataclasses.replace(step_scene, cameras=((away,),), samples=1)
    session = Session(scene, None)
    assert not session.render(away, 0, (MEASURED,), 1, 0).arrays[MEASURED].any()
    with pytest.raises(BackendError, match="needs a depth camera"):
        session.render(dataclasses.replace(away, depth_camera=None), 0, (MEASURED,), 1, 0)


def measuring(kind: str) -> dict:
    cfg = copy.deepcopy(small_cfg())
    sensor = next(iter(next(iter(cfg["rigs"].values()))["sensors"].values()))
    sensor["outputs"] = ["depth", MEASURED]
    sensor["depth_camera"] = {"type": kind} | ({"baseline_m": 0.1} if kind == "stereo" else {})
    return cfg


@pytest.mark.parametrize("kind", ["stereo", "time_of_flight"])
def test_a_cfg_asks_for_it(tmp_path, kind):
    path = tmp_path / "cfg.json"
    path.write_text(json.dumps(measuring(kind)))
    compile_cfg(path, seed=3, out=tmp_path / "out", batches=range(1))
    scene = read_stage(tmp_path / "out" / "batch_0000" / "stage.usda")
    one = scene.cameras[1][0]
    assert kind_of(one.depth_camera.model) == kind
    session = Session(scene, None)
    made, again = (session.render(one, 1, ("depth", MEASURED), 1, 0).arrays for _ in range(2))
    assert made[MEASURED].tobytes() == again[MEASURED].tobytes()
    there = made[MEASURED] > 0
    assert there.mean() > 0.1
    off = np.abs(made[MEASURED] - made["depth"])[there]
    if kind == "stereo":
        # In disparities: half of all normal errors of 0.2 px are below 0.135 px.
        off *= one.intrinsics[0, 0] * 0.1 / (made[MEASURED][there] * made["depth"][there])
        assert np.median(off) == pytest.approx(0.135, rel=0.1)
    else:
        assert np.median(off[made["depth"][there] < 4]) < 0.1
    assert (made[MEASURED] != made["depth"])[there].all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"outputs": ["depth"]}, "nothing reads it"),
        ({"depth_camera": None}, "needs the key depth_camera"),
        ({"depth_camera": {"type": "sterio"}}, "stereo"),
    ],
)
def test_what_does_not_go_together_is_a_fault(tmp_path, change, message):
    cfg = measuring("stereo")
    sensor = next(iter(next(iter(cfg["rigs"].values()))["sensors"].values()))
    sensor |= change
    if sensor["depth_camera"] is None:
        del sensor["depth_camera"]
    path = tmp_path / "cfg.json"
    path.write_text(json.dumps(cfg))
    with pytest.raises(CfgError, match=message):
        compile_cfg(path, seed=3, out=tmp_path / "out")
