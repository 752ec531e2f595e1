"""What cannot be drawn of a camera: its own frames are missing, nobody else's, and it is said."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdRender
from third_party import install, plan_fault, square_stage

from scenec.backends.camera.shutter import blurred_by
from scenec.backends.run.auto import check_backend
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.render import render
from scenec.backends.stage.scene import Camera, Focus, OpenShutter
from scenec.cli.main import main
from scenec.schemas import stage as names
from scenec.schemas.errors import BackendError, StageError
from scenec.schemas.frames import read_frame
from scenec.schemas.shutter import Shutter
from scenec.testing.blur_scenes import ahead
from scenec.testing.small import small_cfg, write_cfg


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two cameras: rgb, depth and ids of the left one, depth of the right one."""
    install(tmp_path, monkeypatch)
    path = square_stage(tmp_path / "square.usda", width=8)
    made = Usd.Stage.Open(str(path))
    right = UsdRender.Product.Get(made, "/Render/right")
    right.GetOrderedVarsRel().SetTargets(["/Render/Vars/depth"])
    made.Save()
    return path


@pytest.fixture
def partnerless(stage: Path) -> Path:
    """Of the left camera disparity is asked for, too, and it has no partner."""
    made = Usd.Stage.Open(str(stage))
    variable = UsdRender.Var.Define(made, "/Render/Vars/disparity")
    variable.CreateSourceNameAttr("disparity")
    left = UsdRender.Product.Get(made, "/Render/left")
    left.GetOrderedVarsRel().AddTarget(variable.GetPath())
    made.Save()
    return stage


def focused(path: Path, camera: str) -> Path:
    made = Usd.Stage.Open(str(path))
    lens = UsdGeom.Camera.Get(made, f"/World/{camera}")
    lens.CreateFStopAttr(2.0)
    lens.CreateFocusDistanceAttr(3.0)
    made.Save()
    return path


@pytest.mark.usefixtures("worker_here")
def test_the_frames_of_other_cameras_are_rendered_and_the_command_ends_with_1(partnerless, capsys):
    stage = partnerless
    assert main(["render", str(stage), "--backend", "reference", "--json"]) == 1
    said = capsys.readouterr()
    report = json.loads(said.out)
    # Three samples of each camera: of the left one the first is tried.
    assert (report["rendered"], report["refused"]) == (3, 3)
    frames = [Path(path) for path in report["frames"]]
    assert [path.is_file() for path in frames] == [False, True] * 3
    assert np.all(read_frame(frames[1].with_suffix("")).passes["depth"] == 6.0)
    assert not list(stage.parent.glob("frames/annotation/left/*.*"))
    tried, *others = report["failed"]
    assert tried.startswith("square/left/000000: /World/left: disparity needs a partner")
    assert others == [
        f"square/left/00000{i}: not tried, as square/left/000000 was refused" for i in (1, 2)
    ]
    (line,) = (line for line in said.err.splitlines() if line.startswith("warning: square"))
    assert line.startswith("warning: square/left/000000: /World/left: disparity")
    assert line.endswith("other frames of this camera are not tried")
    assert "3 frames were refused by annotation" in said.err
    assert "given up" not in said.err


def test_where_every_camera_is_refused_the_run_ends_at_once(stage, capsys):
    command = ["render", str(stage), "--backend", "reference", "--passes", "rgb"]
    assert main(command) == 2
    said = [x for x in capsys.readouterr().err.splitlines() if "no rgb" in x]
    assert [line.split(": annotation")[0] for line in said] == [
        "warning: square/left/000000", "scenec"
    ]  # fmt: skip
    assert not list(stage.parent.glob("frames/annotation/*/*.*"))


@pytest.mark.slow
@pytest.mark.usefixtures("worker_here")
def test_frames_that_are_there_already_are_no_reason_to_end_it(partnerless):
    stage = partnerless
    assert render(stage, "reference", passes=["depth"]).rendered == 6
    report = render(stage, "reference")
    # Those of the right camera were made with the same key.
    assert (report.rendered, report.skipped, report.refused) == (0, 3, 3)


@pytest.mark.slow
def test_a_camera_that_cycles_cannot_draw_costs_its_own_frames(stage):
    pytest.importorskip("bpy")
    made = Usd.Stage.Open(str(stage))
    skewed = made.GetPrimAtPath("/World/right")
    k = skewed.CreateAttribute(names.ATTR_INTRINSICS, Sdf.ValueTypeNames.DoubleArray)
    k.Set([8.0, 0.5, 4.0, 0.0, 8.0, 3.0, 0.0, 0.0, 1.0])
    made.Save()
    report = render(stage, "cycles", spp=1, passes=["rgb"], samples=range(2))
    assert (report.rendered, report.refused) == (2, 2)
    assert "it has a skew of 0.5" in report.failed[0]


def test_denoising_an_aperture_is_refused_before_anything_is_rendered(stage, capsys, monkeypatch):
    command = ["render", str(focused(stage, "left")), "--backend", "smooth", "--denoise"]
    # Had the renderer been given the scene, its worker would have ended.
    plan_fault(stage.parent, monkeypatch, "exit", where="load")
    assert main(command) == 2
    where, said = capsys.readouterr().err.splitlines()
    assert where.startswith("frames go into ")
    assert said == (
        "scenec: camera left: its aperture makes its picture the mean of many, and denoisers take "
        "single ones: render it without denoising"
    )
    assert not (stage.parent / "frames").exists()


def test_an_aperture_does_not_count_where_no_rgb_is_asked_for(stage):
    # Of the right camera depth is asked for.
    focused(stage, "right")
    report = render(stage, "smooth", denoise=True, spp=2, samples=range(1))
    assert (report.rendered, report.refused) == (2, 0)


def test_run_refuses_to_denoise_an_aperture_before_it_compiles(tmp_path, capsys):
    cfg = small_cfg()
    (sensor,) = cfg["rigs"]["rover"]["sensors"].values()
    sensor["focus"] = {"distance_m": 2.5, "f_number": 2.0, "focal_length_mm": 25.0}
    out = tmp_path / "out"
    words = ["run", str(write_cfg(tmp_path, cfg)), "--seed", "1", "-o", str(out)]
    assert main([*words, "--backend", "cycles", "--denoise"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("scenec: camera rover_front: its aperture")
    assert not out.exists()
    with pytest.raises(BackendError, match="camera a: its aperture"):
        check_backend(RenderPlan("auto", denoise=True), rgb=True, apertures=["a"])


def test_an_open_shutter_counts_where_the_camera_moves():
    camera = ahead(8, 6, 10.0)
    poses = np.repeat(camera.camera_to_world[None], 3, axis=0)

    def held(shutter: Shutter, way: float) -> Camera:
        moved = poses.copy()
        moved[:, 0, 3] += way * np.array([-1.0, 0.0, 1.0])
        return dataclasses.replace(
            camera, shutter=OpenShutter(shutter, np.array([-1.0, 0.0, 1.0]), moved)
        )

    assert blurred_by(camera) is None
    assert blurred_by(held(Shutter(0.1), 0.01)) == "shutter"
    assert blurred_by(held(Shutter(0.0, 0.1), 0.01)) == "shutter"
    assert blurred_by(held(Shutter(0.1), 0.0)) is None
    assert blurred_by(held(Shutter(0.0), 0.01)) is None
    assert blurred_by(dataclasses.replace(camera, focus=Focus(2.0, 0.0))) is None
    assert blurred_by(dataclasses.replace(camera, focus=Focus(2.0, 0.01))) == "aperture"


@pytest.mark.usefixtures("worker_here")
def test_annotation_without_passes_makes_all_but_rgb(stage, capsys):
    assert main(["render", str(stage), "--backend", "annotation", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["rendered"], report["refused"], report["warnings"]) == (6, 0, [])
    held = {stem.parent.name: set(read_frame(stem).passes) for stem in
            (Path(frame).with_suffix("") for frame in report["frames"])}  # fmt: skip
    assert held == {"left": {"depth", "instance"}, "right": {"depth"}}


@pytest.mark.usefixtures("worker_here")
def test_of_a_camera_that_asks_for_rgb_alone_annotation_makes_nothing_and_says_so(stage):
    made = Usd.Stage.Open(str(stage))
    right = UsdRender.Product.Get(made, "/Render/right")
    right.GetOrderedVarsRel().SetTargets(["/Render/Vars/rgb"])
    made.Save()
    report = render(stage, "annotation")
    assert {stem.parent.name for stem in report.frames} == {"left"}
    assert any("camera right asks for rgb alone: no frame" in line for line in report.warnings)
    left = UsdRender.Product.Get(made, "/Render/left")
    left.GetOrderedVarsRel().SetTargets(["/Render/Vars/rgb"])
    made.Save()
    with pytest.raises(StageError, match=r"no frame to render: .*rgb alone is asked for"):
        render(stage, "annotation")
