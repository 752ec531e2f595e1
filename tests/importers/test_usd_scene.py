"""A foreign stage becomes a cfg whose meshes, cameras and light are where the stage has them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from both_ways import notes
from made_stage import changed, make_stage, mesh, z_up
from pxr import Gf, Sdf, UsdGeom, UsdLux, UsdSemantics, UsdShade

import scenec
from scenec.api import make
from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.cli.main import main
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.importers.output import Imported, write
from scenec.importers.report import APPROXIMATED, DROPPED
from scenec.importers.scene import varied_pose
from scenec.importers.usd.read import import_usd
from scenec.importers.usd.scene import KEEP
from scenec.schemas.errors import ScenecError
from scenec.testing.processes import output_of


def imported(file: Path, **options: object) -> Imported:
    return import_usd(file, file.parent / "ours.json", **options)  # type: ignore[arg-type]


def heights(scene: RenderScene, places: list[tuple[float, float]]) -> list[float]:
    """Heights of what is seen from 50 m above places."""
    origins = np.array([(x, y, 50.0) for x, y in places])
    rays = Rays(origins, np.tile((0.0, 0.0, -1.0), (len(places), 1)), (1, len(places)))
    return [float(50.0 - t) for t in ExactCaster(scene).cast(rays)[2]]


def test_the_command_line_knows_what_can_be_kept():
    assert make.KEEP == KEEP


@pytest.mark.slow
def test_what_the_stage_has_is_where_it_was(tmp_path):
    made = imported(make_stage(tmp_path), keep=KEEP)
    assert write(made) == []
    out = tmp_path / "out"
    settings = ["objects.rocks=null", "labels.class.rock=null", "materials.stone=null"]
    spec = load(tmp_path / "ours.json", settings)
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


def test_light_is_taken_over_or_varied(tmp_path):
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


def test_what_has_no_counterpart_is_said(tmp_path):
    made = imported(make_stage(tmp_path))
    assert "render draws others" in notes(made, DROPPED)["/World/spare"]
    assert not any("hidden" in entry.pointer for entry in made.report.entries)


def test_varied_cameras_look_about_where_they_looked(tmp_path):
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
def test_the_roll_of_a_camera_is_clockwise_as_it_sees_it(roll):
    # Level, looking north: right is east, down is down; rolled clockwise, right goes down.
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    pose = np.eye(4)
    pose[:3, :3] = np.stack([(c, 0, -s), (-s, 0, -c), (0, 1, 0)], axis=1)
    assert varied_pose(pose, 10.0).get("roll_deg", 0.0) == pytest.approx(roll)


def test_a_stage_with_a_floor_alone_gets_a_view_and_daylight(tmp_path):
    file = tmp_path / "one.usda"
    stage = z_up(file)
    mesh(stage, "/floor", (-5, -5, 0), (5, 5, 0.1))
    stage.GetRootLayer().Save()
    made = imported(file)
    assert made.cfg["terrain"]["relief"][0]["part"] == "/floor_model"
    assert made.made.keys() == {"models.usdc"}
    assert made.cfg["rigs"]["orbit"]["pose"]["type"] == "orbit"
    assert made.cfg["light"]["sky"]["type"] == "clear"
    assert {"light/sky", "light/sun", "rigs/orbit"} <= {e.to for e in made.report.entries}
    write(made)


def test_a_stage_without_ground_gets_a_plane_below_all(tmp_path):
    file = tmp_path / "post.usda"
    stage = z_up(file)
    post = mesh(stage, "/post", (2, 1, 3), (2.5, 9, 3.5))
    UsdGeom.Xformable(post).AddRotateXOp().Set(90.0)
    dome = UsdLux.DomeLight.Define(stage, "/dome")
    dome.CreateTextureFileAttr("none.exr")
    stage.GetRootLayer().Save()
    made = imported(file)
    # Turned about x, what was y from 1 to 9 is z.
    assert made.cfg["terrain"]["relief"] == [{"type": "plane", "height_m": 1}]
    assert "none.exr does not exist" in notes(made, DROPPED)["post.usda"]
    write(made)


def test_ground_is_chosen_by_name(tmp_path):
    file = make_stage(tmp_path)
    assert imported(file, ground="body").cfg["terrain"]["relief"][0]["part"] == "/body_model"
    assert "floor" in imported(file, ground="body").cfg["objects"]
    with pytest.raises(ScenecError, match=r'"flor": no mesh is called so; did you mean'):
        imported(file, ground="flor")


def test_a_damaged_stage_is_a_fault_in_words(tmp_path, capsys):
    file, out = tmp_path / "bad.usda", tmp_path / "ours.json"
    file.write_text("#usda 1.0\ndef Xform {")
    assert (
        "bad.usda:2:1: not a USD stage"
        in output_of(capsys, ["import", "usd", str(file), "-o", str(out)], 2).err
    )
    assert (
        "none.usd: no such file"
        in output_of(capsys, ["import", "usd", str(tmp_path / "none.usd"), "-o", str(out)], 2).err
    )
    assert not out.exists()


def test_more_uneven_scales_of_copies_than_a_class_has_models_are_evened_out(tmp_path):
    file = make_stage(tmp_path)
    with changed(file) as stage:
        posts = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/posts"))
        posts.GetProtoIndicesAttr().Set([0] * 120)
        posts.GetPositionsAttr().Set([(10.0 * i, 0, 0) for i in range(120)])
        posts.GetScalesAttr().Set([(1, 1 + i, 1) for i in range(120)])
        posts.CreateOrientationsAttr([Gf.Quath(0, 0, 1, 0)] * 120)
    made = imported(file)
    assert "evened out" in notes(made, APPROXIMATED)["/World/posts"]
    assert len(made.cfg["objects"]["posts"]["models"]) == 1
    write(made)
    lines = (tmp_path / "ours_files" / "posts.csv").read_text().splitlines()
    assert float(lines[8].split(",")[7]) == pytest.approx(2.0)


def test_the_report_of_a_stage_can_be_read_by_scripts(tmp_path, capsys):
    words = ["import", "usd", str(make_stage(tmp_path)), "-o", str(tmp_path / "a" / "ours.json")]
    told = json.loads(output_of(capsys, [*words, "--json"]).out)
    assert {"fate", "pointer", "to", "note"} <= set(told["values"][0])


def test_whatever_the_reader_does_not_follow_is_in_the_report(tmp_path):
    file = make_stage(tmp_path)
    with changed(file) as stage:
        UsdGeom.NurbsCurves.Define(stage, "/World/hair")
        UsdLux.RectLight.Define(stage, "/World/panel")
        UsdLux.SphereLight(stage.GetPrimAtPath("/World/bulb")).GetPrim().CreateAttribute(
            "inputs:diffuse", Sdf.ValueTypeNames.Float
        ).Set(0.5)
        floor = UsdGeom.Mesh(stage.GetPrimAtPath("/World/floor"))
        floor.GetSubdivisionSchemeAttr().Set("catmullClark")
        floor.CreateDisplayOpacityAttr([0.5])
        camera = stage.GetPrimAtPath("/World/still")
        UsdGeom.Camera(camera).CreateShutterOpenAttr(-0.25)
        stage.DefinePrim("/World/gone").GetReferences().AddReference("gone.usda")
    losses = read_stage(file, allow_missing=True).losses
    assert len(losses) >= 6
    told = {e.note for e in imported(file).report.entries if e.fate == DROPPED}
    assert set(losses) <= told


def test_lights_that_are_hidden_or_of_no_intensity_give_none(tmp_path):
    file = make_stage(tmp_path)
    with changed(file) as stage:
        UsdGeom.Imageable(stage.GetPrimAtPath("/World/sun")).MakeInvisible()
        stage.GetPrimAtPath("/World/bulb").GetAttribute("inputs:intensity").Set(0.0)
        UsdLux.DomeLight.Define(stage, "/World/dome").CreateIntensityAttr(0.0)
    made = imported(file)
    labels = {"labels": {"class": "sky"}}
    assert made.cfg["light"] == {"sun": None, "sky": {"type": "none", **labels}}
    dark = notes(made, DROPPED)
    assert all(
        "gives no light" in dark[path] for path in ("/World/sun", "/World/bulb", "/World/dome")
    )


def test_labels_of_a_stage_keep_their_ids_under_names_that_a_cfg_can_have(tmp_path):
    file = tmp_path / "labeled.usda"
    stage = z_up(file)
    texts = ("traffic light", "traffic_light", "unseen", "2x4")
    for number, text in enumerate(texts):
        box = mesh(stage, f"/box{number}", (2 * number, 0, 0), (2 * number + 1, 1, 1))
        UsdSemantics.LabelsAPI.Apply(box, "class").CreateLabelsAttr([text])
    UsdGeom.Imageable(stage.GetPrimAtPath("/box2")).MakeInvisible()
    stage.GetRootLayer().Save()
    made = imported(file)
    # By name: "2x4", "traffic light", "traffic_light", "unseen" are 1 to 4.
    named = {"_2x4": 1, "traffic_light": 2, "traffic_light_2": 3, "rock": 5}
    assert made.cfg["labels"] == {"class": named}
    assert made.cfg["objects"]["box0"]["labels"] == {"class": "traffic_light"}
    assert notes(made, DROPPED)["class:unseen"] == "nothing that is shown has this label"
    write(made)


@pytest.mark.parametrize(
    ("path", "name", "value", "told"),
    [
        ("/World/still", "focalLength", float("nan"), "/World/still.focalLength: is nan"),
        ("/World/still", "horizontalAperture", float("inf"), "horizontalAperture: is inf"),
        ("/World/floor", "points", [(float("nan"),) * 3] * 4, "/World/floor.points: holds NaN"),
        ("/World/floor", "faceVertexIndices", [0, 1, 2, 9], "reach beyond the 8 points"),
        ("/World/sun", "inputs:intensity", float("nan"), "inputs:intensity: is nan"),
        ("/World/posts", "positions", [(float("nan"),) * 3] * 2, "positions: holds NaN"),
        ("/World/posts", "protoIndices", [0, -1], "protoIndices name a prototype beyond"),
        ("/World/crate", "xformOp:translate", (float("inf"), 0, 0), "its transform holds NaN"),
        ("/Render/product", "resolution", Gf.Vec2i(0, 0), "a camera needs a resolution"),
        ("", "metersPerUnit", float("nan"), "metersPerUnit is nan"),
        ("", "metersPerUnit", 1e307, ""),
    ],
)
def test_a_value_that_cannot_be_is_a_fault_of_one_line(tmp_path, capsys, path, name, value, told):
    file, out = make_stage(tmp_path), tmp_path / "ours.json"
    with changed(file) as stage:
        if path:
            assert stage.GetPrimAtPath(path).GetAttribute(name).Set(value)
        else:
            UsdGeom.SetStageMetersPerUnit(stage, value)
    before = sorted(tmp_path.iterdir())
    assert main(["import", "usd", str(file), "-o", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"scenec: {file}: ")
    assert told in line
    assert sorted(tmp_path.iterdir()) == before


def test_what_is_scaled_to_nothing_is_said(tmp_path):
    file = make_stage(tmp_path)
    with changed(file) as stage:
        UsdGeom.Xformable(stage.GetPrimAtPath("/World/crate")).AddScaleOp().Set((0, 0, 0))
        posts = UsdGeom.Xformable(stage.GetPrimAtPath("/World/posts/post"))
        # A sheet: its matrix has no inverse.
        posts.AddScaleOp().Set((0, 1, 1))
    made = imported(file)
    assert "scaled to nothing" in notes(made, DROPPED)["/World/crate"]
    assert "crate" not in made.cfg["objects"]
    assert made.cfg["objects"]["posts"]["models"][0]["part"] == "/posts_model"
    write(made)


@pytest.mark.parametrize(("ior", "specular"), [(1.5, 0.04), (-1.0, 1.0), (0.0, 1.0)])
def test_an_index_of_refraction_becomes_the_share_of_the_specular_part(tmp_path, ior, specular):
    file = make_stage(tmp_path)
    with changed(file) as stage:
        material = UsdShade.Material.Define(stage, "/World/glass")
        shader = UsdShade.Shader.Define(stage, "/World/glass/surface")
        shader.CreateIdAttr("UsdPreviewSurface")
        shader.CreateInput("ior", Sdf.ValueTypeNames.Float).Set(ior)
        material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
        UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/World/crate")).Bind(material)
    made = imported(file)
    assert made.cfg["objects"]["crate"]["material"] == "glass"
    assert made.cfg["materials"]["glass"]["specular"] == pytest.approx(specular)


def test_a_call_imports_as_the_command_does(tmp_path):
    stage, called, commanded = make_stage(tmp_path), tmp_path / "a.json", tmp_path / "b.json"
    made = scenec.import_scene("usd", stage, called, keep=KEEP)
    words = ["import", "usd", str(stage), "-o", str(commanded), "--keep", ",".join(KEEP)]
    assert main(words) == 0
    assert called.read_text() == commanded.read_text().replace("b_files", "a_files")
    assert sum(made.report.counts().values()) > 0
    with pytest.raises(ScenecError, match=r"^format: 'obj': expected one of oaisys, usd, blend"):
        scenec.import_scene("obj", stage, tmp_path / "c.json")
    with pytest.raises(ScenecError, match=r"^keep: 'sky': expected some of cameras,light"):
        scenec.import_scene("usd", stage, tmp_path / "c.json", keep="sky")
