"""Lidar scans: geometry by formula, noise by its statistics, files and commands."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import moving_stages as ms
import numpy as np
import pytest
import third_passes
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from pxr import Sdf, Usd, UsdGeom, UsdRender

from scenec.backends.annotation.lidar import scan
from scenec.backends.exact import ExactCaster
from scenec.backends.run.scan import scan_output
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Lidar, RenderScene
from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.datasets.source import Source
from scenec.schemas import stage as names
from scenec.schemas.errors import CfgError, FrameError, StageError
from scenec.schemas.scans import read_scan
from scenec.testing.examples import examples
from scenec.testing.scenes import icosphere
from scenec.testing.small import small_cfg

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> RenderScene:
    """A plane, label 1, and balls on it, label 2, ids 1 to 6."""
    stage = Usd.Stage.CreateNew(str(tmp_path_factory.mktemp("lidar") / "stage.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(root)
    root.CreateAttribute(names.ATTR_SCHEMA_VERSION, Sdf.ValueTypeNames.String).Set("1.5")
    root.CreateAttribute(
        names.ATTR_LABEL_NAMES.format(level="class"), Sdf.ValueTypeNames.TokenArray
    ).Set(["ground", "ball"])
    root.CreateAttribute(
        names.ATTR_LABEL_IDS.format(level="class"), Sdf.ValueTypeNames.UIntArray
    ).Set([1, 2])
    corners = np.array([[-500, -500, 0], [500, -500, 0], [500, 500, 0], [-500, 500, 0]])
    ms.add_mesh(stage, "/World/Plane", corners, [[0, 1, 2], [0, 2, 3]], 1)
    points, faces = icosphere(3)
    for i, (x, y) in enumerate([(6, 0), (-5, 3), (2, -7), (0, 9), (-8, -8), (12, 4)]):
        ball = ms.add_mesh(stage, f"/World/Ball{i}", points, faces, 2)
        UsdGeom.Xformable(ball).AddTransformOp().Set(ms.matrix(np.array([x, y, 1.0])))
    ms._camera(stage)
    stage.Save()
    return read_stage(Path(stage.GetRootLayer().realPath))


def lidar(**change) -> Lidar:
    pose = np.eye(4)
    pose[:3, 3] = (0.5, -0.25, 2.0)
    usual = {
        "name": "rig_top",
        "path": "/World/Rigs/rig/top",
        "to_world": pose,
        "elevations_deg": np.linspace(10.0, -40.0, 33),
        "azimuths_deg": np.arange(0, 360, 2.5),
        "range_m": (0.5, 100.0),
    }
    return Lidar(**(usual | change))


def test_ranges_and_points_are_those_of_plane_and_balls(scene):
    made = scan(scene, ExactCaster(scene), lidar(), 0)
    up, left = np.radians(made["elevation_deg"])[:, None], np.radians(made["azimuth_deg"])[None]
    d = np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up) + 0 * left], -1)
    eye = np.array([0.5, -0.25, 2.0])
    with np.errstate(divide="ignore"):
        plane = np.where(d[..., 2] < 0, -eye[2] / d[..., 2], np.inf)
    expected, who = plane, np.ones(plane.shape, int)
    near = np.full(plane.shape, np.inf)
    for row in scene.rows.to_world[1:]:
        b = (d * (row[:, 3] - eye)).sum(-1)
        c = ((row[:, 3] - eye) ** 2).sum()
        rest = b * b - c + 1.0
        near = np.minimum(near, np.abs(rest))
        t = np.where((rest > 0) & (b > 0), b - np.sqrt(np.maximum(rest, 0)), np.inf)
        who = np.where(t < expected, 2, who)
        expected = np.minimum(expected, t)
    answered = expected <= 100.0
    # Away from the outlines, where the balls' meshes differ from balls.
    sure = (near > 0.05) & (np.abs(expected - 100) > 0.1)
    assert (np.isfinite(made["range"]) == answered)[sure].all()
    hit = sure & answered
    np.testing.assert_allclose(made["range_true"][hit], expected[hit], atol=0.02)
    flat = hit & (who == 1)
    np.testing.assert_allclose(made["range_true"][flat], expected[flat], rtol=1e-12)
    np.testing.assert_allclose(made["points"][flat][:, 2], -2.0, atol=1e-5)
    np.testing.assert_allclose(
        made["incidence"][flat], np.sin(-np.broadcast_to(up, flat.shape)[flat]), atol=1e-6
    )
    assert (made["label.class"][hit] == who[hit]).all()
    nothing = np.isinf(made["range"])
    assert np.isnan(made["points"][nothing]).all()
    assert not made["label.class"][nothing].any()


@given(st.integers(0, 2**64 - 1), st.floats(0.0, 0.5), st.floats(0.0, 0.02), st.floats(0, 1))
@examples(15)
def test_noise_has_the_deviation_asked_for_and_losses_their_share(scene, key, a, b, lost):
    one = lidar(
        range_noise_m=a,
        range_noise_ratio=b,
        dropout=lost,
        key=key,
        elevations_deg=np.linspace(-5, -60, 64),
        azimuths_deg=np.arange(0, 360, 2.0),
    )
    clean = dataclasses.replace(one, range_noise_m=0.0, range_noise_ratio=0.0, dropout=0.0)
    caster = ExactCaster(scene)
    made, true = scan(scene, caster, one, 3), scan(scene, caster, clean, 3)["range_true"]
    there = np.isfinite(made["range"])
    n = np.isfinite(true).sum()
    assert abs(there.sum() - (1 - lost) * n) <= 5 * np.sqrt(lost * (1 - lost) * n) + 1
    deviation = np.sqrt(a * a + (b * true[there]) ** 2)
    off = made["range"][there].astype(float) - true[there]
    assert (off[deviation == 0] == pytest.approx(0, abs=1e-5)) if (deviation == 0).any() else True
    z = off[deviation > 1e-3] / deviation[deviation > 1e-3]
    if len(z) > 500:
        assert abs(z.mean()) < 5 / np.sqrt(len(z))
        assert abs(z.var() - 1) < 5 * np.sqrt(2 / len(z))


def test_a_number_depends_on_key_sample_and_ray_alone(scene):
    caster = ExactCaster(scene)
    one = lidar(range_noise_m=0.1, key=7)
    first, again = scan(scene, caster, one, 0), scan(scene, caster, one, 0)
    assert all(first[k].tobytes() == again[k].tobytes() for k in first)
    assert (scan(scene, caster, one, 1)["range"] != first["range"]).any()
    other = dataclasses.replace(one, key=8)
    assert (scan(scene, caster, other, 0)["range"] != first["range"]).any()


def test_angular_noise_moves_what_is_met_and_not_what_is_told(scene):
    one = lidar(angle_noise_deg=0.5, key=3, elevations_deg=np.full(50, -30.0))
    made = scan(scene, ExactCaster(scene), one, 0)
    flat = made["label.class"] == 1
    told = made["points"][flat] / made["range"][flat][:, None]
    np.testing.assert_allclose(np.degrees(np.arcsin(told[:, 2])), -30.0, atol=1e-4)
    met = np.degrees(np.arcsin(2.0 / made["range_true"][flat]))
    assert abs(met.mean() - 30.0) < 0.05
    assert abs(met.std() - 0.5) < 0.03


def test_a_grid_of_which_each_ray_is_said_by_itself_is_scanned_as_the_grid(scene):
    one = lidar(range_noise_m=0.1, angle_noise_deg=0.5, dropout=0.1, key=7)
    angles = np.meshgrid(one.elevations_deg, one.azimuths_deg, indexing="ij")
    other = dataclasses.replace(one, elevations_deg=angles[0], azimuths_deg=angles[1])
    own, made = (scan(scene, ExactCaster(scene), each, 0) for each in (one, other))
    assert made["elevation_deg"].shape == made["azimuth_deg"].shape == made["range"].shape
    np.testing.assert_array_equal(made["range"], own["range"])
    np.testing.assert_array_equal(made["label.class"], own["label.class"])
    np.testing.assert_allclose(made["points"], own["points"], rtol=1e-6)


@pytest.mark.parametrize("count", [0, 2, 4])
def test_rays_that_make_no_beams_are_refused(tmp_path, count):
    path = ms.write_stage(tmp_path / "stage.usda")
    stage = Usd.Stage.Open(str(path))
    prim = UsdGeom.Xform.Define(stage, "/World/odd").GetPrim()
    rays = prim.CreateAttribute(names.ATTR_LIDAR_RAYS, Sdf.ValueTypeNames.Double2Array)
    rays.Set([(0.0, 1.0), (0.0, 2.0), (0.0, 3.0)])
    prim.CreateAttribute(names.ATTR_LIDAR_AZIMUTHS, Sdf.ValueTypeNames.Int).Set(count)
    stage.Save()
    with pytest.raises(StageError, match=f"/World/odd: 3 rays, {count} a beam, are no scan"):
        read_stage(path)


@pytest.mark.parametrize(("near", "far"), [(0.0, 1e9), (2.5, 2.6), (5.0, 5.0)])
def test_only_ranges_within_bounds_are_answered(scene, near, far):
    made = scan(scene, ExactCaster(scene), lidar(range_m=(near, far)), 0)
    true = made["range_true"][np.isfinite(made["range"])]
    assert ((true >= near) & (true <= far)).all()


@pytest.mark.parametrize("height", [0.01, 1e5])
@pytest.mark.parametrize("elevation", [90.0, -90.0, 0.0, -1e-6])
def test_one_beam_straight_up_down_and_along(scene, height, elevation):
    pose = np.eye(4)
    pose[:3, 3] = (200.0, 200.0, height)
    one = lidar(
        to_world=pose,
        elevations_deg=np.array([elevation]),
        azimuths_deg=np.zeros(1),
        range_m=(0.0, 1e9),
    )
    made = scan(scene, ExactCaster(scene), one, 0)
    assert made["range"].shape == (1, 1)
    if elevation == -90.0:
        assert made["range_true"][0, 0] == pytest.approx(height, rel=1e-12)
    if elevation >= 0.0:
        assert np.isinf(made["range"][0, 0])


def with_lidar(**change) -> dict:
    cfg = small_cfg()
    rig = next(iter(cfg["rigs"].values()))
    rig["lidars"] = {
        "top": {
            "mount": {"position_m": [0, -0.4, 0]},
            "beams": 16,
            "elevation_deg": [5, -30],
            "azimuths": 90,
            "noise": {"range_m": 0.01},
            "trigger": {"every": 2},
        }
        | change
    }
    next(iter(rig["sensors"].values()))["outputs"] = ["depth", "instance", "label"]
    return cfg


def compiled(tmp_path: Path, cfg: dict) -> Path:
    path = tmp_path / "cfg.json"
    path.write_text(json.dumps(cfg))
    compile_cfg(path, seed=3, out=tmp_path / "out", batches=range(1))
    return tmp_path / "out"


def test_scans_of_a_cfg_are_written_read_and_not_made_twice(tmp_path):
    out = compiled(tmp_path, with_lidar())
    report = scan_output(out, clouds=["ply"])
    assert [stem.name for stem in report.scans] == ["000000", "000002"]
    assert report.made == 2
    assert scan_output(out, clouds=["ply"]).made == 0
    got = read_scan(report.scans[0])
    cloud = trimesh.load(report.scans[0].with_suffix(".ply"))
    there = np.isfinite(got.arrays["range"])
    np.testing.assert_array_equal(np.float32(cloud.vertices), got.arrays["points"][there])
    # The lidar looks where the rig's camera looks: its x is the camera's z.
    scene = read_stage(out / "batch_0000" / "stage.usda")
    camera = scene.cameras[0][0].camera_to_world
    pose = np.array(got.sidecar.lidar_to_world)
    np.testing.assert_allclose(pose[:3, 0], camera[:3, 2], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 2], -camera[:3, 1], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 3] - camera[:3, 3], -0.4 * camera[:3, 1], atol=1e-12)
    again = compiled(tmp_path, with_lidar())
    assert scan_output(again, clouds=["ply"]).made == 0, "compiling the same again keeps scans"


def test_a_pass_that_cannot_be_imported_keeps_no_lidar_from_scanning(tmp_path, monkeypatch):
    third_passes.install(tmp_path, monkeypatch, {"broken": "raise ImportError('no')"})
    shutil.copytree(compiled(tmp_path, with_lidar()) / "batch_0000", tmp_path / "alone")
    path = tmp_path / "alone" / "stage.usda"
    stage = Usd.Stage.Open(str(path))
    for prim in stage.Traverse():
        if prim.IsA(UsdRender.Var):
            UsdRender.Var(prim).GetSourceNameAttr().Set("broken")
    stage.Save()
    assert read_stage(path).cameras[0][0].outputs == ("broken",)
    assert scan_output(path).made == 2


def test_a_damaged_scan_is_told_and_made_anew(tmp_path):
    out = compiled(tmp_path, with_lidar())
    stem = scan_output(out).scans[0]
    good = stem.with_suffix(".npz").read_bytes()
    stem.with_suffix(".npz").write_bytes(good[:-9] + b"123456789")
    with pytest.raises(FrameError, match="scan again"):
        read_scan(stem)
    stem.with_suffix(".npz").write_bytes(good[:100])
    assert scan_output(out).made == 1
    assert stem.with_suffix(".npz").read_bytes() == good


def test_a_camera_of_its_own_rate_has_frames_where_it_is_triggered(tmp_path):
    cfg = with_lidar()
    rig = next(iter(cfg["rigs"].values()))
    sensor = next(iter(rig["sensors"].values()))
    rig["sensors"] = {"fast": sensor, "slow": sensor | {"trigger": {"every": 2, "first": 1}}}
    out = compiled(tmp_path, cfg)
    assert main(["render", str(out), "--backend", "reference", "--passes", "depth,flow"]) == 0
    found = sorted(p.parent.name[-4:] + p.stem for p in out.glob("batch_*/frames/*/*/*.json"))
    assert found == ["fast000000", "fast000001", "fast000002", "slow000001"]
    assert Source(out).missing == ()


def test_the_command_names_what_is_wrong(tmp_path, capsys):
    out = compiled(tmp_path, with_lidar())
    assert main(["scan", str(out), "--lidars", "rover_tpo"]) == 2
    assert 'did you mean "rover_top"' in capsys.readouterr().err
    (tmp_path / "b").mkdir()
    without = compiled(tmp_path / "b", small_cfg())
    with pytest.raises(StageError, match="no lidar"):
        scan_output(without)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"elevations_deg": [1, 2]}, "take one away"),
        ({"range_m": [5, 1]}, "nearest range first"),
        ({"azimuth_deg": [0, 0]}, "spans 0 degrees"),
        ({"azimuth_deg": [-300, 300]}, "spans 600 degrees"),
        ({"trigger": {"first": 99}}, "never reached"),
        ({"beamz": 3}, "beams"),
    ],
)
def test_a_lidar_that_cannot_be_is_a_fault(tmp_path, change, message):
    with pytest.raises(CfgError, match=message):
        compiled(tmp_path, with_lidar(**change))
