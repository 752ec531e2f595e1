"""What a cfg names may be replaced while it is compiled, or since: the manifest is true of it."""

from __future__ import annotations

import json
import os
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from small_cfg import changed

from scenec.backends.run.executors import make_executor
from scenec.cli.main import main
from scenec.compiler.cache.memo import Memo, memoized, memoizing
from scenec.compiler.cache.store import Store
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.sweep import CompilePoint, points, read_all
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import CfgError, OutputError
from scenec.schemas.files import once_per_file, stamp, tree
from scenec.schemas.units import Keeper

CFG: dict[str, Any] = changed(
    {
        "/name": "inputs",
        "/outputs": ["rgb", "label", "instance"],
        "/terrain/size_m": [8, 8],
        "/terrain/relief": [{"type": "dem", "file": "dem.npy", "pixel_m": 0.5}],
        "/materials/sand": {"maps": {"base_color": "sand.png", "size_m": 1}},
        "/objects": {
            "boxes": {
                "type": "meshes", "count": 3, "material": "basalt", "labels": {"class": "rock"},
                "models": [{"file": "box.obj", "unit_m": 1, "up": "z"}],
            }
        },
        "/rigs/rover/pose/position": {"x_m": 0, "y_m": -2, "height_m": 2},
        "/rigs/rover/pose/target": {"distance_m": 3, "height_m": 0, "bearing_deg": 0},
        "/rigs/rover/sensors/front": {"resolution": [32, 24], "fov_deg": 65},
    }
)  # fmt: skip


def _box(path: Path, half: float) -> None:
    ends = (-half, half)
    points = [(x, y, z) for x in ends for y in ends for z in (0.0, 2 * half)]
    faces = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    lines = [f"v {x:.3f} {y:.3f} {z:.3f}" for x, y, z in points]
    lines += ["f {} {} {} {}".format(*face) for face in faces]
    path.write_text("\n".join([*lines, ""]))


def _dem(path: Path, height: float) -> None:
    np.save(path, (height * np.sin(np.arange(17.0)[:, None] / 3.0) * np.ones(17)).astype("f4"))


def _picture(path: Path, value: int) -> None:
    pixels = np.full((4, 4, 3), value, np.uint8)
    Image.fromarray(pixels).save(path, format="PNG", compress_level=0)


#: Of each file: how it is written, what is in it, and what it is replaced by, as large.
FILES: dict[str, tuple[Callable[[Path, Any], None], Any, Any]] = {
    "box.obj": (_box, 0.2, 0.3),
    "dem.npy": (_dem, 0.3, 0.9),
    "sand.png": (_picture, 100, 200),
}


def written(folder: Path, other: str = "", **changes: Any) -> Path:
    """The cfg and its files, one of them with other content."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (write, first, second) in FILES.items():
        write(folder / name, second if name == other else first)
    path = folder / "c.json"
    path.write_text(json.dumps({**CFG, **changes}))
    return path


def stages(out: Path) -> dict[str, bytes]:
    batches = (path for path in tree(out) if path.parts[0].startswith("batch_"))
    return {str(path): (out / path).read_bytes() for path in batches}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("gone", [False, True])
def test_a_file_that_is_replaced_amid_a_compilation_is_a_fault_and_vouched_by_nothing(
    name: str, gone: bool, tmp_path: Path
) -> None:
    cfg, out = written(tmp_path, batches=3), tmp_path / "out"

    def swap(text: str, _place: object) -> None:
        if text.startswith("compiling batch_0001"):
            write, _, second = FILES[name]
            (tmp_path / name).unlink()
            if not gone:
                write(tmp_path / name, second)

    with pytest.raises(CfgError) as info:
        compile_cfg(cfg, seed=1, out=out, progress=swap)
    (fault,) = info.value.faults
    where = {"box.obj": "/objects/boxes/models/0/file", "dem.npy": "/terrain/relief/0/file",
             "sand.png": "/materials/sand/maps/base_color"}  # fmt: skip
    assert fault.pointer == where[name]
    assert fault.message.startswith(f'"{name}": {name} has {"gone" if gone else "changed"} since')
    manifest = json.loads((out / "manifest.json").read_text())
    assert [batch["index"] for batch in manifest["batches"]] == [0]
    assert not (out / "batch_0001").exists()
    shutil.rmtree(tmp_path / "again", ignore_errors=True)
    compile_cfg(written(tmp_path / "again", batches=1), seed=1, out=tmp_path / "again" / "out")
    assert stages(tmp_path / "again" / "out") == stages(out)


def test_workers_are_held_to_it_too(tmp_path: Path) -> None:
    spec = load(written(tmp_path))
    _box(tmp_path / "box.obj", 0.3)
    with make_executor(1) as executor, pytest.raises(CfgError, match="changed since"):
        compile_cfg(spec, seed=1, out=tmp_path / "out", executor=executor)
    assert not (tmp_path / "out" / "manifest.json").exists()


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_equal_size_and_time_is_read_again_in_one_process(
    name: str, tmp_path: Path
) -> None:
    cfg = written(tmp_path / "a")
    file = cfg.with_name(name)
    compile_cfg(cfg, seed=1, out=tmp_path / "first")
    before = file.stat()
    write, _, second = FILES[name]
    write(file, second)
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert file.stat().st_size == before.st_size
    compile_cfg(cfg, seed=1, out=tmp_path / "second")
    compile_cfg(written(tmp_path / "b", other=name), seed=1, out=tmp_path / "fresh")
    assert stages(tmp_path / "second") == stages(tmp_path / "fresh")
    assert stages(tmp_path / "second") != stages(tmp_path / "first")


def test_a_stamp_is_another_when_content_time_and_size_are_made_equal(tmp_path: Path) -> None:
    path = tmp_path / "a"
    read = once_per_file(most=2)(Path.read_text)
    path.write_text("one")
    first, held = stamp(path), path.stat()
    assert read(path) == "one"
    path.write_text("two")
    os.utime(path, ns=(held.st_atime_ns, held.st_mtime_ns))
    assert stamp(path) != first
    assert read(path) == "two"


_swaps: list[Callable[[], None]] = []


@memoized("reading")
def _reading(path: Path) -> str:
    for swap in _swaps:
        swap()
    return path.read_text()


def test_a_step_whose_file_is_replaced_amid_it_is_not_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("one")
    _swaps.append(lambda: path.write_text("two") and None)
    with memoizing(Memo(Store(tmp_path / "cache"))):
        assert _reading(path) == "two"
    _swaps.clear()
    path.write_text("one")
    memo = Memo(Store(tmp_path / "cache"))
    with memoizing(memo):
        assert _reading(path) == "one"
    assert memo.made == {"reading": 1}


def test_a_sweep_compiles_what_it_read(tmp_path: Path) -> None:
    cfg, out = written(tmp_path), tmp_path / "out"
    swept = points(["terrain.spacing_m=0.5,1.0"], range(1))
    specs = read_all(cfg, swept)
    cfg.write_text("no cfg any more")
    for point, spec in zip(swept, specs, strict=True):
        unit = CompilePoint(
            spec, point, (out / point.name).absolute(), Keep.SEEN, None, None, False, "stop"
        )
        pickle.loads(pickle.dumps(unit)).run(Keeper())
        said = json.loads((out / point.name / "manifest.json").read_text())["cfg"]
        assert said["sha256"] == spec.digest
        assert said["settings"] == list(point.settings)
        assert unit.is_done()
        assert not replace(unit, batches=range(1, 2)).is_done()


def test_a_point_of_a_sweep_compiles_in_a_process_in_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cfg, elsewhere = written(tmp_path / "cfg"), tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(cfg.parent)
    (point,) = points([], range(1))
    (spec,) = read_all(cfg.name, [point])
    out = tmp_path / "out"
    unit = CompilePoint(spec, point, out, Keep.SEEN, None, None, False, "stop")
    monkeypatch.chdir(elsewhere)
    unit.run(Keeper())
    assert unit.is_done()


def test_run_reads_its_cfg_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from scenec.compiler.cfg import load as module

    cfg, read = written(tmp_path), []
    monkeypatch.setattr(
        module, "load", lambda *words: read.append(words) or load(*words), raising=True
    )
    words = ["--backend", "annotation", "--passes", "label", "--workers", "0", "--no-cache"]
    assert main(["run", str(cfg), "-o", str(tmp_path / "out"), *words]) == 0
    assert len(read) == 1


def test_an_outputs_cfg_compiles_again_where_it_lies(tmp_path: Path) -> None:
    cfg, out = written(tmp_path / "mine"), tmp_path / "deep" / "er" / "out"
    compile_cfg(cfg, seed=1, out=out)
    compile_cfg(out / "cfg.json", seed=1, out=tmp_path / "again")
    assert stages(tmp_path / "again") == stages(out)
    first, second = (
        json.loads((o / "manifest.json").read_text()) for o in (out, tmp_path / "again")
    )
    assert first == second
    # And that one's, and one that extends it.
    compile_cfg(tmp_path / "again" / "cfg.json", seed=1, out=out)
    other = tmp_path / "other.json"
    other.write_text(json.dumps({"extends": "again/cfg.json", "name": "other"}))
    assert load(other).files["terrain/relief/0/file"].path.resolve() == (
        tmp_path / "mine" / "dem.npy"
    )
    with make_executor(1) as executor:
        compile_cfg(out / "cfg.json", seed=1, out=tmp_path / "third", executor=executor)
    assert stages(tmp_path / "third") == stages(out)


def test_an_outputs_cfg_without_its_folder_is_told_of_its_files(tmp_path: Path) -> None:
    compile_cfg(written(tmp_path / "mine"), seed=1, out=tmp_path / "out")
    (tmp_path / "mine").rename(tmp_path / "moved")
    with pytest.raises(CfgError, match=r'/terrain/relief/0/file: no file "dem.npy"'):
        load(tmp_path / "out" / "cfg.json")


@pytest.mark.parametrize("name", ["sweep.csv", "sweep.json"])
def test_a_table_that_is_not_a_sweeps_stays(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cfg, out = written(tmp_path), tmp_path / "out"
    words = ["sweep", str(cfg), "--seeds", "0:2", "-o", str(out), "--compile-only", "--no-cache"]
    words += ["--workers", "0"]
    out.mkdir()
    (out / name).write_text("my,own,table\n1,2,3\n")
    assert main(words) == 2
    assert (out / name).read_text() == "my,own,table\n1,2,3\n"
    assert sorted(path.name for path in out.iterdir()) == [name]
    assert name in capsys.readouterr().err
    (out / name).unlink()
    assert main(words) == 0
    # Its own is written again; with a line of somebody's it is theirs.
    assert main(words) == 0
    with (out / "sweep.csv").open("a") as table:
        table.write("a note\n")
    assert main(words) == 2
    assert (out / "sweep.csv").read_text().endswith("a note\n")


def test_a_table_with_cells_beyond_what_csv_reads_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cfg, out = written(tmp_path), tmp_path / "out"
    out.mkdir()
    (out / "sweep.csv").write_text("x" * 200_000)
    assert main(["sweep", str(cfg), "--seeds", "0:2", "-o", str(out), "--compile-only"]) == 2
    assert "sweep.csv: is not what a sweep wrote" in capsys.readouterr().err


def test_a_sweep_of_too_many_points_makes_no_list(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["sweep", "c.json", "--seeds", "0:1000000000", "-o", "out"])
    assert left.value.code == 2
    assert (
        "'0:1000000000': expected numbers below 2^64, 1,000,000 of them" in capsys.readouterr().err
    )
    many = ",".join(map(str, range(400)))
    words = ["sweep", "c.json", "--set", f"a={many}", "--seeds", "0:400", "-o", "out"]
    assert main(words) == 2
    assert "a sweep of 160,000 points: expected at most 100,000" in capsys.readouterr().err


def test_an_output_that_is_compiled_from_elsewhere_has_the_same_files(tmp_path: Path) -> None:
    for place in ("a", "b/c/d"):
        compile_cfg(written(tmp_path / place), seed=1, out=tmp_path / "out" / place)
    first, second = (
        json.loads((tmp_path / "out" / place / "manifest.json").read_text())
        for place in ("a", "b/c/d")
    )
    assert first == second
    with pytest.raises(OutputError, match="of seed 1, not 2"):
        compile_cfg(tmp_path / "out" / "a" / "cfg.json", seed=2, out=tmp_path / "out" / "a")
