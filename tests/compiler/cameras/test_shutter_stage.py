"""A compiled shutter: what stands in the stage, is read back, annotated and kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom
from shutter_cfgs import SHUTTER, cfg

from scenec.backends.annotation.annotate import annotate
from scenec.backends.camera.shutter import poses_at, row_poses
from scenec.backends.exact import ExactCaster
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera
from scenec.compiler.cameras.shutters import codes_at
from scenec.compiler.compile import compile_cfg
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.frames import FrameKey, read_frame
from scenec.schemas.shutter import Shutter, between
from scenec.testing import small
from scenec.testing.frame_units import render_to


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras: one that rolls upwards, one whose exposures overlap."""
    folder = tmp_path_factory.mktemp("shutter")
    document = cfg(SHUTTER | {"direction": "up"}, mount={"position_m": [0.2, 0.1, 0.3]})
    document["rigs"]["rover"]["sensors"]["long"] = {
        "resolution": [24, 16], "fov_deg": 60, "shutter": {"exposure_s": 0.9, "readout_s": 0},
    }  # fmt: skip
    out = folder / "out"
    compile_cfg(small.write_cfg(folder, document), seed=3, out=out, cache=folder / "cache")
    return out


@pytest.fixture(scope="module")
def stage(output: Path) -> Path:
    return output / "batch_0000" / "stage.usda"


def front(stage: Path, sample: int = 1, index: int = 0) -> Camera:
    return read_stage(stage).cameras[sample][index]


def test_cameras_come_back_as_they_move(output: Path, stage: Path) -> None:
    """Shutter, times and poses: those of the orbit, to rounding; that of the sample to the bit."""
    report = json.loads((output / "batch_0000" / "report.json").read_text())
    said = report["motion"]["rover"]["shutter"]
    for index, (name, shutter) in enumerate(
        (("front", Shutter(0.01, 0.04, True)), ("long", Shutter(0.9, 0.0)))
    ):
        camera = front(stage, index=index)
        held = camera.shutter
        assert held.shutter == shutter
        assert len(held.times) == said[name]["poses"]
        middle = len(held.times) // 2
        assert held.times[middle] == 0.0
        assert np.array_equal(held.camera_to_world[middle], camera.camera_to_world)
        assert held.times[0] == -shutter.half_span
        r = held.camera_to_world[:, :3, :3]
        assert np.abs(r.transpose(0, 2, 1) @ r - np.eye(3)).max() < 1e-13
        # It goes around at 60 degrees a second: 5 m away, level, without its mount.
        if name == "long":
            angle = np.arctan2(held.camera_to_world[:, 0, 3], held.camera_to_world[:, 1, 3])
            expected = np.radians(60.0) * np.clip(0.5 + held.times, 0.0, 1.0)
            assert np.abs(angle - expected).max() < 1e-12
            assert np.abs(np.linalg.norm(held.camera_to_world[:, :2, 3], axis=1) - 5.0).max() < 1e-9


def test_viewers_see_the_same_poses_at_fractional_time_codes(stage: Path) -> None:
    """By USD's own transforms; shutter:open and shutter:close hold the exposures in time codes."""
    opened = Usd.Stage.Open(str(stage))
    scene = read_stage(stage)
    assert (opened.GetStartTimeCode(), opened.GetEndTimeCode()) == (0.0, 2.0)
    for sample in range(3):
        for camera in scene.cameras[sample]:
            prim = UsdGeom.Camera(opened.GetPrimAtPath(camera.path))
            held = camera.shutter
            codes = codes_at(scene.times, scene.times[sample] + held.times)
            low, high = (a.Get(sample) for a in (prim.GetShutterOpenAttr(),
                                                 prim.GetShutterCloseAttr()))  # fmt: skip
            assert abs(sample + low - codes[0]) < 1e-12
            assert abs(sample + high - codes[-1]) < 1e-12
            for code, pose in zip(codes.tolist(), held.camera_to_world, strict=True):
                matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(code)
                seen = np.array(matrix).T @ np.diag([*names.HALF_TURN, 1.0])
                assert np.abs(seen - pose).max() < 1e-9


def test_poses_compose_with_what_the_camera_is_below(stage: Path, tmp_path: Path) -> None:
    """A stage that refers to it, turned, moved, and in centimeters with y up."""
    path = tmp_path / "around.usda"
    outer = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(outer, 0.01)
    UsdGeom.SetStageUpAxis(outer, UsdGeom.Tokens.y)
    outer.SetStartTimeCode(0)
    outer.SetEndTimeCode(2)
    # As in the stage: USD scales the time samples of a layer that differs.
    outer.SetTimeCodesPerSecond(1.0)
    outer.SetFramesPerSecond(1.0)
    world = outer.DefinePrim("/World")
    xform = UsdGeom.Xformable(world)
    matrix = Gf.Matrix4d().SetScale(100.0) * Gf.Matrix4d().SetRotate(
        Gf.Rotation(Gf.Vec3d(1, 2, 3), 40.0)
    )
    xform.AddTransformOp().Set(matrix.SetTranslateOnly(Gf.Vec3d(300, -50, 20)))
    world.GetReferences().AddReference(str(stage), "/World")
    outer.SetDefaultPrim(world)
    outer.GetRootLayer().Save()
    inner = front(stage, index=0)
    found = next(c for c in read_stage(path).cameras[1] if "front" in c.path)
    assert found.shutter.shutter == inner.shutter.shutter
    turn = found.camera_to_world @ np.linalg.inv(inner.camera_to_world)
    expected = turn @ inner.shutter.camera_to_world
    assert np.abs(found.shutter.camera_to_world - expected).max() < 1e-9


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        (names.ATTR_SHUTTER_EXPOSURE, -1.0, "expected 0 or more"),
        (names.ATTR_SHUTTER_READOUT, float("nan"), "expected a finite number"),
        (names.ATTR_SHUTTER_DIRECTION, "dwon", '"down"'),
        (names.ATTR_SHUTTER_TIMES, [-0.1, 0.1], "0 among them"),
        (names.ATTR_SHUTTER_TIMES, [-0.001, 0.0, 0.001], "or beyond"),
        (names.ATTR_SHUTTER_TIMES, [-0.1, 0.0, 0.05, 0.1], "expected one for each"),
    ],
)
def test_numbers_that_cannot_be_are_refused(
    stage: Path, tmp_path: Path, name: str, value: Any, said: str
) -> None:
    path = tmp_path / "broken.usda"
    layer = Sdf.Layer.CreateNew(str(path))
    layer.subLayerPaths = [str(stage)]
    opened = Usd.Stage.Open(layer)
    opened.SetDefaultPrim(opened.GetPrimAtPath("/World"))
    opened.SetStartTimeCode(0)
    opened.SetEndTimeCode(2)
    UsdGeom.SetStageMetersPerUnit(opened, 1.0)
    UsdGeom.SetStageUpAxis(opened, UsdGeom.Tokens.z)
    camera = opened.GetPrimAtPath("/World/Rigs/rover/front")
    attribute = camera.GetAttribute(name)
    attribute.Set(value)
    for sample in range(3):
        if name == names.ATTR_SHUTTER_EXPOSURE:
            attribute.Set(value, sample)
    layer.Save()
    with pytest.raises(StageError, match=said.replace('"', '"')):
        read_stage(path)


def test_the_rows_of_a_compiled_picture_are_those_of_still_cameras(stage: Path) -> None:
    """Brute force: a pinhole for each row, at that row's pose; labels apart, to the bit."""
    scene = read_stage(stage)
    caster = ExactCaster(scene)
    camera = scene.cameras[1][0]
    passes = ("depth", "instance", "normal", "position")
    found = annotate(scene, caster, camera, passes, 1).arrays
    poses = row_poses(camera)
    assert np.abs(poses[0] - poses[-1]).max() > 0.1
    differs = 0
    whole = replace(camera, shutter=None)
    before = annotate(scene, caster, whole, passes, 1).arrays
    for r, pose in enumerate(poses):
        alone = replace(camera, shutter=None, camera_to_world=pose)
        expected = annotate(scene, caster, alone, passes, 1).arrays
        for key, values in expected.items():
            real = values.dtype.kind == "f"
            assert np.array_equal(found[key][r], values[r], equal_nan=real), key
        differs += int((expected["depth"][r] != before["depth"][r]).sum())
    assert differs > 300


def test_sidecars_say_where_the_camera_was(stage: Path, tmp_path: Path) -> None:
    session = Session.open(stage, "reference")
    camera = front(stage)
    key = FrameKey(session.scene.digest, ("depth", "instance", "position", "flow"), 0, 1, "r", "0")
    stem = tmp_path / "000001"
    render_to(session, stem, 1, key, 1)
    frame = read_frame(stem)
    held = camera.shutter
    said = frame.sidecar.shutter
    assert (said.exposure_s, said.readout_s, said.direction) == (0.01, 0.04, "up")
    assert np.array_equal(said.camera_to_world, held.camera_to_world)
    assert np.array_equal(frame.sidecar.camera_to_world, camera.camera_to_world)
    ends = poses_at(held, np.array([0.02, -0.02]) * 29.0 / 30.0)
    assert np.abs(np.array([said.first_row, said.last_row]) - ends).max() < 1e-12
    assert np.isfinite(frame.passes["flow"]).mean() > 0.3
    # What a reader makes of depth and the sidecar alone is what the position pass says.
    depth = frame.passes["depth"].astype(np.float64)
    hit = np.isfinite(depth)
    assert hit.mean() > 0.3
    v, u = np.mgrid[0:30, 0:40] + 0.5
    local = np.linalg.inv(np.array(frame.sidecar.intrinsics)) @ np.stack(
        [u.ravel(), v.ravel(), np.ones(1200)]
    )
    at = -said.readout_s * ((np.arange(30) + 0.5) / 30 - 0.5)
    poses = between(np.array(said.times_s), np.array(said.camera_to_world), at)
    pose = np.repeat(poses, 40, axis=0)
    point = np.einsum("nij,jn->ni", pose[:, :3, :3], local) * depth.reshape(-1, 1)
    point += pose[:, :3, 3]
    expected = frame.passes["position"].reshape(-1, 3)
    assert np.abs(point - expected)[hit.ravel()].max() < 1e-5


def test_the_same_bytes_come_from_the_cache_and_from_scratch(output: Path, tmp_path: Path) -> None:
    cache = output.parent / "cache"
    document = output.parent / "small.json"
    taken = compile_cfg(document, seed=3, out=tmp_path / "a", cache=cache)
    assert taken.taken["batch_0000"]["cameras"] == 1
    compile_cfg(document, seed=3, out=tmp_path / "b")
    for name in ("cameras.usdc", "stage.usda", "report.json"):
        one, two, three = (
            (folder / "batch_0000" / name).read_bytes()
            for folder in (output, tmp_path / "a", tmp_path / "b")
        )
        assert one == two == three
