"""The ladders of a scene: what they find, beside what else is known of it."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from scenec.cli.main import main
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.quality.ladder import APPROXIMATIONS, Ladder, LadderReport, climb, cost
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.run import climb_base
from scenec.quality.ladder.seen import looked_at, spread
from scenec.schemas.errors import OutputError, ScenecError, StageError
from scenec.testing.small import small_cfg, write_cfg

SEED = 5
CRATERS = {
    "type": "craters",
    "min_diameter_m": 0.5,
    "max_diameter_m": 4,
    "density_per_m2": 0.02,
    "reference_diameter_m": 1,
    "exponent": 2,
}


def cfg_of_all() -> dict[str, Any]:
    cfg = small_cfg(samples=2)
    relief = cfg["terrain"]["relief"]
    relief[2] = {"type": "smooth", "length_m": 0.4}
    relief.append(CRATERS)
    cfg["materials"]["sand"]["maps"] = {"procedural": {"type": "sand", "resolution": 64}}
    return cfg


@pytest.fixture(scope="module", autouse=True)
def _single_readings():
    """Nothing here looks at seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cost, "ENOUGH_S", 0.0)
        yield


@pytest.fixture(scope="module")
def output(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("ladder")
    out = compile_cfg(write_cfg(folder, cfg_of_all()), seed=SEED, out=folder / "out").out
    return out


@pytest.fixture(scope="module")
def report(output) -> LadderReport:
    before = digest(output)
    found = climb(output, rungs=3)
    assert digest(output) == before, "an output was changed"
    return found


def digest(folder: Path) -> str:
    state = [
        (path.relative_to(folder).as_posix(), path.stat().st_mtime_ns, path.read_bytes())
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    ]
    return hashlib.sha256(repr(state).encode()).hexdigest()


def ladder(report: LadderReport, name: str) -> Ladder:
    return next(one for one in report.ladders if one.name == name)


def batch_report(out: Path) -> dict[str, Any]:
    return json.loads((out / "batch_0000" / "report.json").read_text())


def climbed(folder: Path, cfg: dict[str, Any], *only: str, rungs: int = 2) -> LadderReport:
    spec = load(write_cfg(folder, cfg))
    return climb_base(Base(spec, SEED, 0), only or APPROXIMATIONS, rungs)


def numbers(node: Any) -> list[float]:
    if isinstance(node, dict):
        return [n for value in node.values() for n in numbers(value)]
    if isinstance(node, list):
        return [n for value in node for n in numbers(value)]
    return [node] if isinstance(node, int | float) else []


def test_every_approximation_of_the_scene_has_a_ladder(report):
    assert {one.name for one in report.ladders} == set(APPROXIMATIONS)
    assert not report.absent


def test_every_number_is_finite(report):
    text = json.dumps(report.as_json(), allow_nan=False)
    assert all(map(math.isfinite, numbers(json.loads(text))))
    lines = report.as_csv().splitlines()
    assert len(lines) == 1 + sum(len(one.rungs) for one in report.ladders)
    assert "nan" not in report.as_csv()


def test_each_ladder_marks_the_cfg_s_own_rung(report):
    for one in report.ladders:
        assert [rung.used for rung in one.rungs].count(True) == 1


def test_the_cfg_s_rung_claims_what_the_batch_s_report_claims(output, report):
    written = batch_report(output)
    mesh = next(rung for rung in ladder(report, "tessellation").rungs if rung.used)
    own = written["ground"]["mesh"]
    assert mesh.value == own["tolerance_px"]
    assert mesh.details["triangles_before_cuts"] == own["triangles"]
    found = own["finer"]["surface_error_found_px"]
    assert mesh.details["found_px"] == max(found, own["height_error_max_px"])
    assert mesh.triangles == written["ground"]["faces"]
    level = next(rung for rung in ladder(report, "lod").rungs if rung.used)
    rocks = written["objects"]["rocks"]
    assert level.triangles == rocks["triangles"]
    assert level.claimed == rocks["lod_error_max_px"]


def test_a_finer_rung_has_more_triangles_and_less_error(report):
    for name in ("tessellation", "lod"):
        rungs = ladder(report, name).rungs
        for coarse, fine in pairwise(rungs):
            assert fine.value < coarse.value
            assert fine.triangles >= coarse.triangles
            assert fine.bytes >= 0.9 * coarse.bytes
            assert fine.rms <= coarse.rms
    for name in ("sky", "textures", "craters", "smoothing"):
        rungs = ladder(report, name).rungs
        assert [rung.rms for rung in rungs] == sorted([rung.rms for rung in rungs], reverse=True)


def test_lod_errors_stay_within_what_was_asked_for(report):
    for rung in ladder(report, "lod").rungs:
        assert rung.claimed <= rung.value
        # Points between those that claims are made of may lie a little farther.
        assert rung.worst <= 1.1 * rung.value


def test_smoothing_errs_with_the_square_of_the_spacing(report):
    rungs = ladder(report, "smoothing").rungs
    assert rungs[-1].value == pytest.approx(0.2)
    ratio = rungs[-2].rms / rungs[-1].rms
    assert 2.5 < ratio < 5.5


def test_errors_of_the_mesh_come_out_again_from_the_stage(output, report):
    """By another library's point location, in the mesh as the stage has it."""
    tri = pytest.importorskip("matplotlib.tri")
    stage = Usd.Stage.Open(str(output / "batch_0000" / "terrain.usdc"))
    points, faces = [], []
    for prim in stage.Traverse():
        if not prim.IsA(UsdGeom.Mesh):
            continue
        mesh = UsdGeom.Mesh(prim)
        shift = UsdGeom.Xformable(prim).GetLocalTransformation().ExtractTranslation()
        at = np.array(mesh.GetPointsAttr().Get(), np.float64) + np.array(shift)
        faces.append(
            np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3) + sum(map(len, points))
        )
        points.append(at)
    x, y, z = np.concatenate(points).T
    base = Base(load(output / "cfg.json"), SEED, 0)
    surface = base.surface
    spots = [spread(surface.field), looked_at(surface.field, base.eyes)]
    u, v = (np.concatenate([spot[axis] for spot in spots]) for axis in (0, 1))
    drawn = tri.LinearTriInterpolator(tri.Triangulation(x, y, np.concatenate(faces)), z)(u, v)
    error = np.abs(np.asarray(drawn.filled(np.nan)) - surface.height_at(u, v))
    error = error[~np.isnan(error)]
    used = next(rung for rung in ladder(report, "tessellation").rungs if rung.used)
    assert used.details["points"] == len(u)
    assert used.details["worst_m"] == pytest.approx(error.max(), rel=1e-3)
    assert used.details["rms_m"] == pytest.approx(np.sqrt((error**2).mean()), rel=1e-3)


def test_what_a_scene_has_not_has_no_ladder_and_a_reason(tmp_path):
    cfg = small_cfg(samples=1, objects={})
    cfg["terrain"]["relief"] = [{"type": "plane"}]
    del cfg["materials"]["stone"]
    cfg["labels"] = {"class": {"ground": 2}}
    for layer in cfg["terrain"]["ground"]:
        layer["labels"] = {"class": "ground"}
    cfg["light"]["sky"] = {"type": "none"}
    found = climbed(tmp_path, cfg)
    assert set(found.absent) == {"lod", "sky", "smoothing", "craters", "textures"}
    assert all(found.absent.values())
    (flat,) = found.ladders
    assert flat.name == "tessellation"
    assert all(rung.worst == rung.details["found_px"] == 0.0 for rung in flat.rungs)
    assert flat.slopes["seconds"] is None
    json.dumps(found.as_json(), allow_nan=False)


def test_without_cameras_errors_are_in_meters_alone(tmp_path):
    cfg = cfg_of_all()
    base = Base(load(write_cfg(tmp_path, cfg)), SEED, 0)
    # A cfg has a camera at least; whoever draws a plan of his own need not.
    base.plan = replace(base.plan, rigs=())
    found = climb_base(base, ("tessellation", "lod", "craters"), 2)
    assert set(found.absent) == {"tessellation"}
    assert {one.unit for one in found.ladders} == {"m"}
    for one in found.ladders:
        assert not any("px" in key for rung in one.rungs for key in rung.details)
    levels = ladder(found, "lod").rungs
    assert [rung.value for rung in levels] == [2.0, 1.0, 0.0]
    assert levels[-1].used
    assert levels[-1].worst == 0.0
    assert levels[0].worst > levels[1].worst > 0.0


def test_a_budget_that_binds_is_said(tmp_path):
    cfg = small_cfg(samples=1)
    cfg["terrain"]["mesh"] = {"max_triangles": 1500}
    cfg["object_detail"] = {"max_triangles": 9000}
    found = climbed(tmp_path, cfg, "tessellation", "lod")
    mesh = ladder(found, "tessellation")
    assert mesh.rungs[-1].details["budget_bound"]
    assert mesh.rungs[-1].details["tolerance_reached_px"] > mesh.rungs[-1].value
    assert "1,500" in mesh.notes[0]
    levels = ladder(found, "lod")
    assert levels.rungs[-1].triangles <= 9000
    assert levels.rungs[-1].details["budget_factor"] > 1.0
    assert any("max_triangles" in note for note in levels.notes)


def test_a_cfg_whose_files_lie_elsewhere_is_asked_for(tmp_path, output):
    np.save(tmp_path / "hill.npy", np.add.outer(np.arange(64.0), np.arange(64.0)) * 0.01)
    cfg = small_cfg(samples=1, objects={})
    del cfg["materials"]["stone"], cfg["labels"]["class"]["rock"], cfg["labels"]["surface"]["stone"]
    cfg["terrain"]["relief"] = [
        {"type": "dem", "file": "hill.npy", "pixel_m": 0.5},
        {"type": "smooth", "length_m": 0.3},
    ]
    path = write_cfg(tmp_path, cfg)
    # With a setting, which the manifest knows.
    spec = load(path, ["terrain.spacing_m=0.3"])
    out = compile_cfg(spec, seed=1, out=tmp_path / "deep" / "out").out
    # The output knows where its cfg was, and not where that went since.
    moved = (tmp_path / "elsewhere").mkdir() or tmp_path / "elsewhere"
    for file in (path, tmp_path / "hill.npy"):
        file.rename(moved / file.name)
    path = moved / path.name
    with pytest.raises(OutputError, match="--cfg") as error:
        climb(out, only=["lod"])
    assert "hill.npy" in str(error.value)
    found = climb(out, only=["lod"], cfg=path)
    assert found.absent == {"lod": "the scene has no objects"}
    with pytest.raises(OutputError, match="is not the cfg"):
        climb(output, only=["lod"], cfg=path)


def test_bad_input_ends_in_one_clear_message(output, tmp_path):
    with pytest.raises(ScenecError, match='did you mean "lod"'):
        climb(output, only=["lot"])
    with pytest.raises(ScenecError, match="2 to 12"):
        climb(output, rungs=1)
    with pytest.raises(StageError, match="batch 7"):
        climb(output, batch=7)
    with pytest.raises(OutputError, match="manifest"):
        climb(tmp_path)


def test_the_command_prints_narrow_tables_and_writes_what_it_is_asked_for(output, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    plot, rows = tmp_path / "ladder.png", tmp_path / "ladder.csv"
    words = ["explain", str(output), "--ladder", "--only", "lod", "--rungs", "2"]
    assert main([*words, "--plot", str(plot), "--csv", str(rows)]) == 0
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= 100
    assert "half the error costs" in " ".join(said.split())
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert len(rows.read_text().splitlines()) == 3
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in found["ladders"]] == ["lod"]
    assert main([*words[:3], "--only", "lo"]) == 2
    assert "lod" in capsys.readouterr().err


def test_an_output_whose_cfg_was_changed_is_refused(output, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(output, other)
    cfg = json.loads((other / "cfg.json").read_text())
    cfg["terrain"]["spacing_m"] = 0.25
    (other / "cfg.json").write_text(json.dumps(cfg))
    with pytest.raises(OutputError, match="is not what"):
        climb(other, only=["lod"])


@pytest.mark.slow
def test_rivers_in_more_steps_come_nearer_to_many(tmp_path):
    cfg = small_cfg(samples=1)
    cfg["terrain"]["relief"][2] = {
        "type": "stream_power", "duration_a": 1000, "steps": 4, "erodibility": 1e-4,
        "channel_area_m2": 1, "diffusivity_m2_per_a": 1e-4,
    }  # fmt: skip
    cfg["terrain"]["relief"].append({"type": "thermal", "angle_deg": 12})
    found = climbed(tmp_path, cfg, "smoothing", rungs=4)
    rivers, slides = found.ladders
    errors = [rung.rms for rung in rivers.rungs]
    assert [rung.value for rung in rivers.rungs] == [1.0, 2.0, 4.0, 8.0]
    assert errors == sorted(errors, reverse=True)
    # First order in time.
    assert 1.3 < errors[1] / errors[2] < 3.0
    assert all(rivers.holds(rung) for rung in rivers.rungs)
    # How far an iteration converged is no claim of what the spacing errs.
    assert all(rung.claimed is None for rung in slides.rungs)
    assert all(rung.details["last_iteration_m"] > 0.0 for rung in slides.rungs)
