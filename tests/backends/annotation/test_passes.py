"""Passes of other packages are asked for, written and read like those of scenec."""

from __future__ import annotations

import argparse
import importlib.util
import json
import tarfile
from pathlib import Path

import numpy as np
import pytest
import third_passes

from scenec.backends.annotation.annotate import annotate
from scenec.backends.annotation.registry import select
from scenec.backends.camera import tiles
from scenec.backends.check.compare import check_exact
from scenec.backends.exact import ExactCaster
from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.cli.arguments import passes as passes_argument
from scenec.compiler.compile import compile_cfg
from scenec.datasets.source import Source
from scenec.schemas.errors import BackendError, CfgError
from scenec.schemas.frames import read_frame
from scenec.testing.lens_scenes import CAMERAS, around, with_lens
from scenec.testing.scenes import scene
from scenec.testing.small import small_cfg, write_cfg

BOTH = {"aspect": third_passes.ASPECT, "place": third_passes.PLACE}
VIEWS = {"pinhole": with_lens(None, 96, 72), **CAMERAS}


@pytest.fixture(scope="module")
def world() -> tuple[RenderScene, ExactCaster]:
    meshes, rows = around()
    made = scene(meshes, rows)
    return made, ExactCaster(made)


@pytest.mark.parametrize("name", VIEWS)
def test_a_pass_of_another_package_is_that_of_its_formula_whole_and_in_bands(
    name: str,
    world: tuple[RenderScene, ExactCaster],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    third_passes.install(tmp_path, monkeypatch, BOTH)
    camera = VIEWS[name]
    found = annotate(*world, camera, ("place", "aspect", "normal", "depth"), 0).arrays
    assert list(found) == ["aspect", "normal", "depth", "place"]
    hit = found["normal"].any(axis=-1)
    assert hit.any()
    n = found["normal"][hit]
    away = np.degrees(np.arctan2(n[:, 0], n[:, 1])) % 360.0
    np.testing.assert_array_equal(found["aspect"][hit], away)
    assert np.isnan(found["aspect"][~hit]).all()
    v, u = np.indices(hit.shape) + 0.5
    np.testing.assert_allclose(found["place"][hit], np.stack([u, v], -1)[hit], atol=1e-6)
    monkeypatch.setattr(tiles, "PIXELS", 17 * camera.width)
    bands = annotate(*world, camera, tuple(found), 0).arrays
    for key, values in found.items():
        np.testing.assert_array_equal(bands[key], values)


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compiled with the pass among its outputs, annotated, and checked."""
    folder = tmp_path_factory.mktemp("aspect")
    with pytest.MonkeyPatch.context() as monkeypatch:
        third_passes.install(folder, monkeypatch, BOTH)
        cfg = small_cfg(samples=2, outputs=["place", "depth", "aspect", "flow"])
        compile_cfg(write_cfg(folder, cfg), seed=2, out=folder / "out")
        stage = folder / "out" / "batch_0000" / "stage.usda"
        assert read_stage(stage).cameras[0][0].outputs == ("place", "depth", "aspect", "flow")
        report = render(folder / "out", "annotation")
        assert (report.rendered, list(report.failed)) == (2, [])
        again = render(folder / "out", "annotation")
        assert (again.rendered, again.skipped) == (0, 2)
        checked = check_exact(folder / "out")
        assert {c.channel for c in checked.comparisons} >= {"place", "depth", "aspect", "flow"}
        assert all(c.differing == 0 < c.pixels for c in checked.comparisons)
    return folder


def test_frames_hold_it_and_are_read_without_its_package(output: Path) -> None:
    stem = output / "out" / "batch_0000" / "frames" / "annotation" / "rover_front" / "000000"
    frame = read_frame(stem, ["aspect", "place"])
    assert list(frame.passes) == ["depth", "aspect", "place", "flow"]
    assert frame.passes["aspect"].dtype == np.float32
    assert frame.passes["place"].shape == (64, 96, 2)
    assert frame.sidecar.conventions["aspect"].startswith("degrees clockwise")
    assert frame.sidecar.annotation["aspect"].startswith("scenec_aspect 1.0 (code ")
    source = Source(output / "out")
    assert source.load(source.frames[0]).annotation_digest()


@pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="needs Mitsuba")
def test_a_renderers_frame_takes_it_from_there(
    output: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    third_passes.install(tmp_path, monkeypatch, BOTH)
    report = render(output / "out", "mitsuba", spp=1, samples=[0], passes=["rgb", "aspect"])
    assert not report.failed
    frames = output / "out" / "batch_0000" / "frames"
    made, first = (
        read_frame(frames / name / "rover_front" / "000000") for name in ("mitsuba", "annotation")
    )
    assert list(made.passes) == ["rgb", "aspect"]
    assert "annotate" not in made.sidecar.seconds
    np.testing.assert_array_equal(made.passes["aspect"], first.passes["aspect"])


@pytest.mark.skipif(importlib.util.find_spec("h5py") is None, reason="needs h5py")
def test_datasets_hold_it(output: Path, tmp_path: Path) -> None:
    import h5py

    from scenec.datasets.export import export
    from scenec.datasets.export_plan import Choice

    choice = Choice(backend="annotation", options={"shard_mb": "1"})
    folder = export(output / "out", "webdataset", tmp_path / "w", choice).folder
    (path,) = folder.glob("*.tar")
    with tarfile.open(path) as shard:
        assert sum(".aspect." in name for name in shard.getnames()) == 2
    folder = export(output / "out", "hdf5", tmp_path / "h", Choice(backend="annotation")).folder
    types = {}
    for path in folder.rglob("*.h*5"):
        with h5py.File(path) as file:
            file.visititems(lambda name, item: types.update({name: getattr(item, "dtype", None)}))
    assert [kind for name, kind in types.items() if name.endswith("aspect")] == [np.float32]


def test_another_version_is_made_again(
    output: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = third_passes.install(tmp_path, monkeypatch, BOTH)
    ask = {"passes": ["aspect"], "samples": [1], "folder": tmp_path / "frames"}
    stage = output / "out" / "batch_0000" / "stage.usda"
    assert render(stage, "annotation", **ask).rendered == 1
    assert render(stage, "annotation", **ask).rendered == 0
    info = site / "scenec_aspect-1.0.dist-info"
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: scenec_aspect\nVersion: 1.1\n")
    assert render(stage, "annotation", **ask).rendered == 1


def test_names_are_known_by_entry_points_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cfg = write_cfg(tmp_path, small_cfg(outputs=["depth", "aspecct"]))
    with pytest.raises(CfgError, match=r'/outputs/1: "aspecct": expected one of .*ones none \(s'):
        compile_cfg(cfg, seed=1, out=tmp_path / "out")
    with pytest.raises(argparse.ArgumentTypeError, match='no pass "aspect"'):
        passes_argument("depth,aspect")
    # What would fail if it were imported.
    third_passes.install(tmp_path, monkeypatch, {"aspect": "raise RuntimeError"})
    with pytest.raises(CfgError, match='did you mean "aspect"'):
        compile_cfg(cfg, seed=1, out=tmp_path / "out")
    with pytest.raises(argparse.ArgumentTypeError, match='did you mean "aspect"'):
        passes_argument("depth,aspecct")
    assert passes_argument("depth,aspect,label.class") == ("depth", "aspect", "label.class")


def changed(old: str, new: str) -> str:
    assert old in third_passes.ASPECT
    return third_passes.ASPECT.replace(old, new)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (
            changed("    return np", "    return view.once(normal)\n    np"),
            r"returned float64 \[6912, 3\], expected float32 or float64 \[6912\]",
        ),
        (changed("np.nan, away)", "0, 1)"), "returned int64"),
        (changed("    return np", "    np"), "returned NoneType"),
        (changed("view.once", "view.twice"), r"AttributeError: .*twice.* \(\w+.py, line 9\)"),
        (changed('("angle",)', '("b", "a")'), "alphabetical"),
        (changed('name="aspect"', 'name="aspecct"'), 'its name is "aspecct"'),
        (changed("ASPECT = Pass", "ASPECT = dict"), "expected a .*contract.Pass, not dict"),
        (changed("ASPECT = ", "OTHER = "), "cannot be imported: AttributeError"),
        (
            changed("compute=aspect", "compute=1 / 0"),
            "cannot be imported: ZeroDivisionError",
        ),
        (changed("compute=aspect", "compute=aspect, needs=('rgb',)"), "it needs rgb"),
        (changed("compute=aspect", "compute=aspect, needs=('dept',)"), 'did you mean "depth"'),
    ],
)
def test_what_is_wrong_with_it_names_its_entry_point(
    source: str,
    message: str,
    world: tuple[RenderScene, ExactCaster],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    third_passes.install(tmp_path, monkeypatch, {"aspect": source})
    place = r'pass "aspect" \(scenec_aspect_aspect:ASPECT of scenec_aspect\): .*'
    with pytest.raises(BackendError, match=("" if "depth" in message else place) + message):
        annotate(*world, VIEWS["pinhole"], ["aspect"], 0)


@pytest.mark.parametrize("name", ["aspect", "depth"])
def test_two_passes_of_one_name_are_refused(
    name: str,
    world: tuple[RenderScene, ExactCaster],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for package in ("first", "second"):
        third_passes.install(tmp_path, monkeypatch, {name: third_passes.ASPECT}, package)
    several = rf'several passes have the name "{name}": .*of second, .*of first'
    with pytest.raises(BackendError, match=several):
        select(world[0], [name])


def test_a_stage_with_an_unknown_output_says_so(output: Path) -> None:
    read = read_stage(output / "out" / "batch_0000" / "stage.usda")
    assert read.cameras[0][0].outputs == ("depth", "flow")
    assert any("render variable of another renderer" in line for line in read.losses)
    report = json.loads((output / "out" / "batch_0000" / "report.json").read_text())
    gone = {entry["what"] for entry in report["left_out"] if entry["pass"] == "outputs"}
    assert not any(what.startswith(("labels", "objects: ids")) for what in gone)
