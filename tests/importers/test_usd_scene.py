"""A foreign stage becomes a cfg whose meshes, cameras and light are where the stage has them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from made_stage import make_stage, mesh
from pxr import Gf, Usd, UsdGeom, UsdLux

from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.cli import import_arguments
from scenec.cli.main import main
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.importers.output import Imported, write
from scenec.importers.report import ADDED, APPROXIMATED, DROPPED
from scenec.importers.scene import varied_pose
from scenec.importers.usd.read import import_usd
from scenec.importers.usd.scene import KEEP
from scenec.schemas.errors import ScenecError


def imported(file: Path, **options: object) -> Imported:
    return import_usd(file, file.parent / "ours.json", **options)  # type: ignore[arg-type]


def notes(made: Imported, fate: str) -> dict[str, str]:
    return {entry.pointer: entry.note for entry in made.report.entries if entry.fate == fate}


def heights(scene: RenderScene, places: list[tuple[float, float]]) -> list[float]:
    """Heights of what is seen from 50 m above places."""
    origins = np.array([(x, y, 50.0) for x, y in places])
    rays = Rays(origins, np.tile((0.0, 0.0, -1.0), (len(places), 1)), (1, len(places)))
    return [float(50.0 - t) for t in ExactCaster(scene).cast(rays)[2]]


def test_the_command_line_knows_what_can_be_kept() -> None:
    assert import_arguments.KEEP == KEEP


@pytest.mark.slow
def test_what_the_stage_has_is_where_it_was(tmp_path: Path) -> None:
    made = imported(make_stage(tmp_path), keep=KEEP)
    assert write(made) == []
    out = tmp_path / "out"
    settings = ["objects.rocks=null", "labels.class.rock=null", "materials.stone=null"]
    spec = load(tmp_path / "ours.json", ["samples=3", *settings])
    compile_cfg(spec, seed=0, out=out)
    scene = read_stage(out / "batch_0000" / "stage.usda")
    # Centimeters and y up; the ground's middle was at x = 10 m: (x - 10, -z) in meters.
    found = heights(scene, [(2.0, -1.0), (-5.0, 0.0), (5.0, 2.0), (0.0, 0.0), (9.9, 7.9)])
    assert found == pytest.approx([1.0, 0.8, 1.6, 0.0, 0.0], abs=1e-4)
    cameras = {camera.name: camera for camera in scene.cameras[0]}
    theirs = read_stage(tmp_path / "scene.usda").cameras[0]
    assert set(cameras) == {"still_camera", "moving_camera"}
    still = cameras["still_camera"]
    (other,) = [camera for camera in theirs if camera.path == "/World/still"]
    assert (still.width, still.height) == (64, 48)
    assert still.intrinsics == pytest.approx(
        np.array([[160 / 3, 0, 32], [0, 160 / 3, 24], [0, 0, 1]])
    )
    assert still.intrinsics == pytest.approx(other.intrinsics, rel=1e-6)
    places = [
        next(c for c in sample if c.name == "moving_camera").camera_to_world[:3, 3]
        for sample in scene.cameras
    ]
    assert np.array(places) == pytest.approx(np.array([(-1, -6, 1.5), (0, -6, 1.5), (1, -6, 1.5)]))


def test_light_is_taken_over_or_varied(tmp_path: Path) -> None:
    file = make_stage(tmp_path)
    sun = imported(file, keep=["light"]).cfg["light"]["sun"]
    # Turned by -30 degrees about x, it comes from above and from +z, which is south.
    assert (sun["elevation_deg"], sun["azimuth_deg"]) == (30, 180)
    assert sun["irradiance"] == 800
    varied = imported(file).cfg["light"]["sun"]
    assert varied["azimuth_deg"] == {"type": "uniform", "min": 0, "max": 360}
    assert (
        "elevation 30.0, azimuth 180.0 there" in notes(imported(file), APPROXIMATED)["/World/sun"]
    )


def test_what_has_no_counterpart_is_said(tmp_path: Path) -> None:
    made = imported(make_stage(tmp_path))
    assert "SphereLight" in notes(made, DROPPED)["/World/bulb"]
    assert not any("hidden" in entry.pointer for entry in made.report.entries)
    assert notes(made, ADDED)["/World/moving"] == "no render product names it"


def test_varied_cameras_look_about_where_they_looked(tmp_path: Path) -> None:
    pose = imported(make_stage(tmp_path)).cfg["rigs"]["still"]["pose"]
    assert pose["type"] == "random"
    low, high = np.array(pose["region_m"])
    assert (low + high) / 2 == pytest.approx([0, -7])
    look = pose["look"]
    # It looks along the stage's -z: north, level.
    assert look["bearing_deg"]["min"] + look["bearing_deg"]["max"] == pytest.approx(0)
    assert look["pitch_deg"] == {"type": "uniform", "min": -5, "max": 5}
    assert "roll_deg" not in pose


@pytest.mark.parametrize("roll", [-40.0, 0.0, 25.0])
def test_the_roll_of_a_camera_is_clockwise_as_it_sees_it(roll: float) -> None:
    # Level, looking north: right is east, down is down; rolled clockwise, right goes down.
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    pose = np.eye(4)
    pose[:3, :3] = np.stack([(c, 0, -s), (-s, 0, -c), (0, 1, 0)], axis=1)
    assert varied_pose(pose, 10.0).get("roll_deg", 0.0) == pytest.approx(roll)


def test_a_stage_of_one_layer_is_named_itself(tmp_path: Path) -> None:
    file = tmp_path / "one.usda"
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh(stage, "/floor", (-5, -5, 0), (5, 5, 0.1))
    stage.GetRootLayer().Save()
    made = imported(file)
    assert made.cfg["terrain"]["relief"][0] == {
        "type": "mesh", "part": "/floor", "file": "one.usda", "unit_m": 1.0, "up": "z",
    }  # fmt: skip
    assert made.made == {}
    assert made.cfg["rigs"]["orbit"]["pose"]["type"] == "orbit"
    write(made)


def test_a_stage_without_ground_gets_a_plane_below_all(tmp_path: Path) -> None:
    file = tmp_path / "post.usda"
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    post = mesh(stage, "/post", (2, 1, 3), (2.5, 9, 3.5))
    UsdGeom.Xformable(post).AddRotateXOp().Set(90.0)
    dome = UsdLux.DomeLight.Define(stage, "/dome")
    dome.CreateTextureFileAttr("none.exr")
    stage.GetRootLayer().Save()
    made = imported(file)
    # Turned about x, what was y from 1 to 9 is z.
    assert made.cfg["terrain"]["relief"] == [{"type": "plane", "height_m": 1}]
    assert "no such file" in notes(made, DROPPED)["/dome"]
    write(made)


def test_ground_is_chosen_by_name(tmp_path: Path) -> None:
    file = make_stage(tmp_path)
    assert imported(file, ground="body").cfg["terrain"]["relief"][0]["part"] == "/World/crate/body"
    with pytest.raises(ScenecError, match=r'"flor": no mesh is called so; did you mean'):
        imported(file, ground="flor")


def test_a_damaged_stage_is_a_fault_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "bad.usda", tmp_path / "ours.json"
    file.write_text("#usda 1.0\ndef Xform {")
    assert main(["import", "usd", str(file), "-o", str(out)]) == 2
    assert "bad.usda: not a sound USD file" in capsys.readouterr().err
    assert main(["import", "usd", str(tmp_path / "none.usd"), "-o", str(out)]) == 2
    assert "there is no such file" in capsys.readouterr().err
    assert not out.exists()


def test_an_uneven_scale_of_copies_is_said(tmp_path: Path) -> None:
    file = make_stage(tmp_path)
    stage = Usd.Stage.Open(str(file))
    posts = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/posts"))
    posts.GetScalesAttr().Set([(1, 1, 1), (1, 8, 1)])
    posts.CreateOrientationsAttr([Gf.Quath(1), Gf.Quath(0, 0, 1, 0)])
    stage.GetRootLayer().Save()
    made = imported(file)
    assert "evened out" in notes(made, APPROXIMATED)["/World/posts"]
    write(made)
    lines = (tmp_path / "ours_files" / "posts.csv").read_text().splitlines()
    assert float(lines[2].split(",")[7]) == pytest.approx(2.0)


def test_the_report_of_a_stage_can_be_read_by_scripts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["import", "usd", str(make_stage(tmp_path)), "-o", str(tmp_path / "a" / "ours.json")]
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {"fate", "pointer", "to", "note"} <= set(told["values"][0])
