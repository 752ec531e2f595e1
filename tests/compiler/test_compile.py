"""The output as a whole: same bytes whatever the circumstances, nothing that is not needed."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from elsewhere import ALL_AT_ONCE, CIRCUMSTANCES, COMPILE
from pxr import Usd, UsdGeom
from usd_validator import independent_findings

from scenec.backends.check.files import check_files
from scenec.backends.check.stage import check_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import CfgError, OutputError, ScenecError, SceneError
from scenec.schemas.manifest import read_manifest
from scenec.testing.small import small_cfg, write_cfg


def hashes(out: Path) -> dict[str, str]:
    """sha256 of every file but the timings."""
    return {
        path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != "timings.json"
    }


def compiled(
    folder: Path, cfg: dict, seed: int = 11, name: str = "out", keep: Keep = Keep.SEEN
) -> Path:
    compile_cfg(write_cfg(folder, cfg, f"{name}.json"), seed=seed, out=folder / name, keep=keep)
    return folder / name


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> Path:
    return compiled(tmp_path_factory.mktemp("compile"), small_cfg(batches=2))


#: All in one run, which loads or compiles every kernel: what fails here is taken apart by
#: ``make thorough``.
TOGETHER = {"all at once": ALL_AT_ONCE}
ANNOTATED = (
    COMPILE
    + """
from scenec.backends.run.render import render
assert render(sys.argv[2], "annotation").rendered
"""
)


@pytest.mark.parametrize(
    "name",
    [*TOGETHER, *(pytest.param(name, marks=pytest.mark.slow) for name in CIRCUMSTANCES)],
)
def test_the_same_cfg_and_seed_give_the_same_bytes_with(name, reference, tmp_path):
    out = tmp_path / "elsewhere" / "a folder with spaces ä"
    cfg = write_cfg(tmp_path, small_cfg(batches=2))
    # A machine without some feature warns about the name: only the bytes count.
    environment = {**os.environ, **(CIRCUMSTANCES | TOGETHER)[name]}
    subprocess.run(
        [sys.executable, "-W", "ignore", "-c", COMPILE, str(cfg), str(out)],
        check=True,
        cwd=tmp_path,
        env=environment,
        capture_output=True,
    )
    assert hashes(out) == hashes(reference)


OTHERS = sorted(Path(__file__).parents[2].glob(".venv-3.*/bin/python"))


@pytest.mark.skipif(not OTHERS, reason="make pythons installs scenec with other Pythons")
@pytest.mark.parametrize("python", OTHERS, ids=[path.parents[1].name for path in OTHERS])
def test_other_pythons_give_the_same_bytes(python, tmp_path):
    cfg = write_cfg(tmp_path, small_cfg(batches=2))
    found = {}
    for name, who in (("ours", sys.executable), ("theirs", python)):
        out = tmp_path / name
        subprocess.run([who, "-W", "ignore", "-c", ANNOTATED, cfg, out], check=True)
        # Sidecars and timings have seconds.
        found[name] = {
            path: digest
            for path, digest in hashes(out).items()
            if Path(path).suffix != ".json" or Path(path).name == "manifest.json"
        }
    assert found["theirs"] == found["ours"]
    assert {Path(path).suffix for path in found["ours"]} >= {".usdc", ".usda", ".exr", ".csv"}


def test_another_seed_and_another_batch_give_other_scenes(reference, tmp_path):
    other = compiled(tmp_path, small_cfg(batches=2), seed=12)
    ours, theirs = hashes(reference), hashes(other)
    for name in ("terrain.usdc", "objects/rocks.usdc", "cameras.usdc", "lights.usdc"):
        assert ours[f"batch_0000/{name}"] != theirs[f"batch_0000/{name}"]
        assert ours[f"batch_0000/{name}"] != ours[f"batch_0001/{name}"]


def test_seed_zero_is_a_seed_like_any_other(tmp_path):
    one = compiled(tmp_path, small_cfg(), seed=0, name="a")
    two = compiled(tmp_path, small_cfg(), seed=0, name="b")
    assert hashes(one) == hashes(two)


def test_adding_an_object_class_leaves_every_other_file_of_the_stage_as_it_was(tmp_path):
    cfg = small_cfg()
    # Pruned, what is seen past the new things, and by their light, would stay or go with them.
    before = hashes(compiled(tmp_path, cfg, name="before", keep=Keep.UNPRUNED))
    # Larger than all else, so that the scene's bounds change, too.
    gems = cfg["objects"]["rocks"] | {"count": 40, "material": "gem", "size_m": 4}
    cfg["objects"] = {"gems": gems, **cfg["objects"]}
    cfg["materials"]["gem"] = {"base_color": [0.1, 0.6, 0.3]}
    after = hashes(compiled(tmp_path, cfg, name="after", keep=Keep.UNPRUNED))
    added = {
        "batch_0000/objects/gems.usdc",
        "batch_0000/looks/gem.usda",
        "batch_0000/looks/gem.mtlx.usda",
    }
    assert set(after) - set(before) == added
    changed = {name for name in before if before[name] != after[name]}
    # The root layer lists the classes, the report counts them: neither is a file of content.
    ours = {"batch_0000/stage.usda", "batch_0000/report.json"}
    assert changed == {*ours, "manifest.json", "cfg.json"}


def test_raising_a_count_leaves_the_first_instances_where_they_were(tmp_path):
    cfg = small_cfg()
    few = compiled(tmp_path, cfg, name="few", keep=Keep.UNPRUNED)
    cfg["objects"]["rocks"]["count"] = 500
    many = compiled(tmp_path, cfg, name="many", keep=Keep.UNPRUNED)

    def arrays(out: Path) -> list[list]:
        stage = Usd.Stage.Open(str(out / "batch_0000/stage.usda"))
        instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Objects/rocks"))
        attributes = (
            instancer.GetPositionsAttr(),
            instancer.GetScalesAttr(),
            instancer.GetOrientationsAttr(),
            instancer.GetProtoIndicesAttr(),
            instancer.GetIdsAttr(),
        )
        return [list(attribute.Get())[:300] for attribute in attributes]

    assert arrays(few) == arrays(many)
    assert hashes(few)["batch_0000/terrain.usdc"] == hashes(many)["batch_0000/terrain.usdc"]


def test_the_stage_is_sound_to_us_and_to_usd(reference):
    for batch in range(2):
        findings = check_stage(reference / f"batch_{batch:04d}" / "stage.usda")
        assert [str(finding) for finding in findings] == []
    assert list(check_files(reference, read_manifest(reference))) == []


def test_the_stage_passes_an_independent_validator(reference, tmp_path):
    found = independent_findings(
        reference / "batch_0000" / "stage.usda", tmp_path / "findings.json"
    )
    # Its advice to index primvars that repeat values would cost more than it saves.
    assert found <= {("WARNING", "IndexedPrimvarChecker")}


def test_many_samples_of_everything_pass_the_independent_validator(tmp_path):
    cfg = small_cfg(samples=8)
    cfg["light"]["haze"] = {"visibility_m": {"type": "uniform", "min": 500, "max": 900}}
    out = compiled(tmp_path, cfg)
    found = independent_findings(out / "batch_0000" / "stage.usda", tmp_path / "findings.json")
    assert found <= {("WARNING", "IndexedPrimvarChecker")}
    stage = Usd.Stage.Open(str(out / "batch_0000" / "stage.usda"))
    moving = [
        attribute.GetPath().pathString
        for prim in stage.Traverse()
        for attribute in prim.GetAttributes()
        if attribute.GetNumTimeSamples() == 8
    ]
    # Were they constant, nothing would be tested.
    for prim in ("/World.", "/World/Rigs/", "/World/Lights/", "/World/Sky."):
        assert any(path.startswith(prim) for path in moving), prim


def test_the_independent_validator_does_find_faults(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "broken.usda"))
    mesh = UsdGeom.Mesh.Define(stage, "/World")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0)])
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 9])
    stage.Save()
    found = independent_findings(tmp_path / "broken.usda", tmp_path / "findings.json")
    assert {severity for severity, _ in found} & {"FAILURE", "ERROR"}


def test_the_root_layer_is_small_and_everything_is_found_by_relative_paths(reference):
    text = (reference / "batch_0000" / "stage.usda").read_text()
    assert len(text) < 4000
    for path in reference.rglob("*.usda"):
        assert str(reference) not in path.read_text()
    for path in reference.rglob("*.usdc"):
        assert str(reference).encode() not in path.read_bytes()


def test_instance_counts_are_met_exactly_and_ids_follow_the_classes(tmp_path):
    cfg = small_cfg()
    cfg["objects"]["more"] = cfg["objects"]["rocks"] | {"count": 17}
    out = compiled(tmp_path, cfg, keep=Keep.UNPRUNED)
    stage = Usd.Stage.Open(str(out / "batch_0000/stage.usda"))
    for name, count, base in (("rocks", 300, 0), ("more", 17, 300)):
        prim = stage.GetPrimAtPath(f"/World/Objects/{name}")
        assert list(UsdGeom.PointInstancer(prim).GetIdsAttr().Get()) == list(range(1, count + 1))
        assert prim.GetAttribute("scenec:instanceIdBase").Get() == base


def test_a_cfg_that_asks_for_depth_only_makes_no_material_light_or_label(tmp_path):
    out = compiled(tmp_path, small_cfg(outputs=["depth"]))
    names = set(hashes(out))
    assert {name.split("/")[1] for name in names if "/" in name} == {
        "stage.usda",
        "terrain.usdc",
        "objects",
        "cameras.usdc",
        "report.json",
        "left_out.json",
    }
    stage = Usd.Stage.Open(str(out / "batch_0000/stage.usda"))
    for prim in stage.Traverse():
        assert not UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues()
        assert "Labels" not in str(prim.GetAppliedSchemas())
    report = json.loads((out / "batch_0000/report.json").read_text())
    not_requested = "no sensor asks for "
    whys = [entry["why"] for entry in report["left_out"] if entry["pass"] != "prune"]
    assert {why.removeprefix(not_requested) for why in whys} == {"rgb", "labels", "instances"}
    assert check_stage(out / "batch_0000/stage.usda") == []


def test_the_bytes_of_geometry_do_not_depend_on_what_else_is_asked_for(tmp_path):
    with_color = compiled(tmp_path, small_cfg(outputs=["rgb", "depth"]), name="a")
    without = compiled(tmp_path, small_cfg(outputs=["depth"]), name="b")

    def points(out: Path) -> list:
        stage = Usd.Stage.Open(str(out / "batch_0000/stage.usda"))
        return [
            list(UsdGeom.Mesh(prim).GetPointsAttr().Get())
            for prim in stage.Traverse()
            if prim.IsA(UsdGeom.Mesh)
        ]

    assert points(with_color) == points(without)


def test_compiling_again_changes_nothing_and_keeps_frames(tmp_path):
    cfg = write_cfg(tmp_path)
    out = tmp_path / "out"
    compile_cfg(cfg, seed=1, out=out)
    frame = out / "batch_0000" / "frames" / "mitsuba" / "a" / "000000.png"
    frame.parent.mkdir(parents=True)
    frame.write_bytes(b"frame")
    stamp = (out / "batch_0000" / "terrain.usdc").stat().st_mtime_ns
    assert compile_cfg(cfg, seed=1, out=out).unchanged == 1
    assert (out / "batch_0000" / "terrain.usdc").stat().st_mtime_ns == stamp
    assert frame.read_bytes() == b"frame"


def test_batches_can_be_compiled_in_parts(reference, tmp_path):
    cfg = write_cfg(tmp_path, small_cfg(batches=2))
    compile_cfg(cfg, seed=11, out=tmp_path / "out", batches=range(1, 2))
    assert [b.index for b in read_manifest(tmp_path / "out").batches] == [1]
    compile_cfg(cfg, seed=11, out=tmp_path / "out", batches=range(1))
    assert hashes(tmp_path / "out") == hashes(reference)


def test_an_interrupted_run_can_be_gone_on_with(reference, tmp_path, monkeypatch):
    from scenec.compiler.emit import batch as module

    cfg = write_cfg(tmp_path, small_cfg(batches=2))
    out = tmp_path / "out"
    original = module.write_batch

    def interrupted(folder: Path, scene) -> None:
        if (out / "batch_0000").exists():
            raise KeyboardInterrupt
        original(folder, scene)

    monkeypatch.setattr(module, "write_batch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        compile_cfg(cfg, seed=11, out=out)
    monkeypatch.undo()
    # The first batch is finished and listed; a killed run would leave a folder with a dot behind.
    assert [b.index for b in read_manifest(out).batches] == [0]
    (out / ".batch_0001.0123abcd").mkdir()
    assert compile_cfg(cfg, seed=11, out=out).unchanged == 1
    (out / ".batch_0001.0123abcd").rmdir()
    assert hashes(out) == hashes(reference)


def test_batches_of_another_cfg_are_not_left_beside_new_ones(tmp_path):
    compile_cfg(write_cfg(tmp_path, small_cfg(batches=2)), seed=1, out=tmp_path / "out")
    with pytest.raises(OutputError, match=r"2 batches \(batch_0000 to batch_0001\), of seed 1"):
        compile_cfg(write_cfg(tmp_path, small_cfg()), seed=2, out=tmp_path / "out")
    assert read_manifest(tmp_path / "out").seed == 1
    out = tmp_path / "out"
    assert compile_cfg(write_cfg(tmp_path), seed=2, out=out, replace=True).unchanged == 0
    assert not (out / "batch_0001").exists()
    assert hashes(out) == hashes(compiled(tmp_path, small_cfg(), seed=2, name="other"))


def test_files_are_called_what_they_are_whatever_their_names(tmp_path):
    cfg = small_cfg()
    cfg["materials"]["lights"] = cfg["materials"].pop("stone")
    cfg["objects"] = {"terrain": cfg["objects"]["rocks"] | {"material": "lights"}}
    files = read_manifest(compiled(tmp_path, cfg)).files
    assert files["batch_0000/looks/lights.usda"].what == "material"
    assert files["batch_0000/objects/terrain.usdc"].what == "object class"
    assert files["batch_0000/lights.usdc"].what == "suns, sky and lamps"


def test_each_sensor_asks_for_its_own_outputs(tmp_path):
    from scenec.backends.stage.read import read_stage

    cfg = small_cfg()
    sensors = cfg["rigs"]["rover"]["sensors"]
    sensors["left"] = sensors["front"] | {"outputs": ["depth"]}
    sensors["right"] = sensors["front"] | {"outputs": ["instance", "label"]}
    cameras = read_stage(compiled(tmp_path, cfg) / "batch_0000" / "stage.usda").cameras[0]
    assert {camera.name: camera.outputs for camera in cameras} == {
        "rover_front": ("rgb", "label", "instance", "depth"),
        "rover_left": ("depth",),
        "rover_right": ("instance", "label"),
    }


def test_nothing_of_the_batch_lies_beyond_a_camera_s_far_plane(reference):
    stage = Usd.Stage.Open(str(reference / "batch_0000/stage.usda"))
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/World/Rigs/rover/front"))
    far = camera.GetClippingRangeAttr().Get()[1]
    box = UsdGeom.BBoxCache(0.0, ["default"]).ComputeWorldBound(stage.GetPrimAtPath("/World"))
    corners = [box.ComputeAlignedRange().GetCorner(i) for i in range(8)]
    for sample in range(3):
        eye = camera.ComputeLocalToWorldTransform(sample).ExtractTranslation()
        assert max((corner - eye).GetLength() for corner in corners) < far


def test_what_cannot_be_done_is_said_and_leaves_nothing_behind(tmp_path):
    cfg = write_cfg(tmp_path)
    with pytest.raises(ScenecError, match="batches 0 to 0"):
        compile_cfg(cfg, seed=1, out=tmp_path / "out", batches=range(1, 3))
    with pytest.raises(ScenecError, match="seed"):
        compile_cfg(cfg, seed=2**64, out=tmp_path / "out")
    full = tmp_path / "full"
    full.mkdir()
    (full / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="not empty"):
        compile_cfg(cfg, seed=1, out=full)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        compile_cfg(cfg, seed=1, out=tmp_path / "file")
    np.save(tmp_path / "hole.npy", np.full((9, 9), np.nan))
    broken = small_cfg()
    broken["terrain"]["relief"][0] = {"type": "dem", "file": "hole.npy", "pixel_m": 5}
    with pytest.raises((SceneError, CfgError), match="hole"):
        compile_cfg(write_cfg(tmp_path, broken), seed=1, out=tmp_path / "out")
    with pytest.raises(CfgError):
        compile_cfg(write_cfg(tmp_path, {"version": 1}), seed=1, out=tmp_path / "out")
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").glob("*"))


def test_a_dem_s_pixel_can_be_one_number_drawn_even(tmp_path):
    np.save(tmp_path / "dem.npy", np.random.default_rng(0).normal(size=(60, 60)))
    for pixel in (0.5, {"type": "uniform", "min": 0.4, "max": 0.6}):
        cfg = small_cfg()
        cfg["terrain"]["relief"][0] = {"type": "dem", "file": "dem.npy", "pixel_m": pixel}
        assert (
            check_stage(compiled(tmp_path, cfg, name=f"{type(pixel)}") / "batch_0000/stage.usda")
            == []
        )


@pytest.mark.slow
def test_a_disk_that_takes_no_more_ends_in_one_line_and_leaves_nothing(tmp_path):
    import resource

    # Kernels are compiled and cached first: their files are larger than the limit, too.
    compiled(tmp_path, small_cfg(), name="warm")

    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100 * 1024, 100 * 1024))

    done = subprocess.run(
        [sys.executable, "-c", "from scenec.cli.main import main; raise SystemExit(main())",
         "compile", str(write_cfg(tmp_path)), "--seed", "1", "-o", str(tmp_path / "out")],
        preexec_fn=small_files, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert f"{tmp_path}/out/batch_0000" in done.stderr
    assert "cannot be written" in done.stderr
    # Neither the name of something that is gone nor an empty folder.
    assert ".scenec-" not in done.stderr
    assert not (tmp_path / "out").exists()
