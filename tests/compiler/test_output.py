"""An output folder: replaced whole whenever a process ends; nothing of the user's is lost."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import shutil
import subprocess
import sys
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from killed import contents, killed_at_each_call

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import Spec, load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.emit.batch import write_batch
from scenec.compiler.emit.maps import copy_maps
from scenec.compiler.output import Output, locked
from scenec.compiler.scene.material import ImageFile, MaterialMaps
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic, inside, sweep, temporary_folder
from scenec.schemas.lock import LOCK, BusyError, Lock, is_alive, process_id
from scenec.schemas.manifest import read_manifest, stage_digest
from scenec.schemas.update import UPDATE, finish_update, replace_files
from scenec.testing.small import small_cfg, write_cfg

STAGE = {
    "stage.usda": "#usda 1.0",
    "terrain.usdc": "terrain",
    "objects/a.usdc": "a",
    "textures/a/1.png": "picture",
    "report.json": "{}",
}
#: One file is the same, one is another, one comes, two go, and a folder with them.
NEXT = {
    "stage.usda": "#usda 1.0\n",
    "terrain.usdc": "terrain",
    "looks/b.usda": "b",
    "report.json": "{}\n",
}
MINE = {
    "batch_0000/notes.txt": "mine",
    "batch_0000/textures/mine.png": "mine",
    "batch_0000/frames/annotation/rover_front/000000.json": "{}",
    "batch_0000/frames/annotation/rover_front/000000.exr": "exr",
    "batch_0000/scans/rover_lidar/000000.npz": "npz",
    "notes.txt": "mine",
}


def write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


@cache
def loaded(cfg: Path, _text: bytes) -> Spec:
    return load(cfg)


def put(out: Path, cfg: Path, files: dict[str, str], seed: int = 1, replace: bool = False) -> bool:
    """Brings a made-up batch in, as ``compile_cfg`` does with one that it built."""
    spec = loaded(cfg, cfg.read_bytes())
    with locked(out):
        output = Output(out, spec, seed, Keep.SEEN, [0], replace, lambda _line: None)
        with temporary_folder(out) as folder:
            write(folder / "batch_0000", files)
            same = output.put(folder, 0, 3, 0)
        output.write_timings({"batch_0000": {"draw": 1.0}})
        output.close()
    return same


@pytest.fixture
def output(tmp_path) -> tuple[Path, Path]:
    cfg = write_cfg(tmp_path)
    put(tmp_path / "out", cfg, STAGE)
    write(tmp_path / "out", MINE)
    return tmp_path / "out", cfg


@pytest.mark.parametrize("replace", [False, True])
def test_a_batch_is_replaced_whole_or_not_at_all_whenever_its_process_is_killed(
    output, tmp_path, replace
):
    out, cfg = output
    seed = 2 if replace else 1
    before = contents(out)
    shutil.copytree(out, tmp_path / "clean")
    put(tmp_path / "clean", cfg, NEXT, seed, replace)
    after = contents(tmp_path / "clean")
    assert before != after
    seen = set()
    kept = tmp_path / "kept"
    shutil.copytree(out, kept)
    for _ in killed_at_each_call(lambda: put(out, cfg, NEXT, seed, replace)):
        # The next command, whichever it is, reads the manifest first.
        read_manifest(out)
        now = {n: b for n, b in contents(out).items() if not n.startswith(".scenec-")}
        # Timings are beside the promise.
        assert {**now, "timings.json": b""} in (
            {**before, "timings.json": b""},
            {**after, "timings.json": b""},
        )
        seen.add(now["manifest.json"])
        # The next one that writes leaves nothing of the killed one's.
        put(out, cfg, NEXT, seed, replace)
        assert contents(out) == after
        shutil.rmtree(out)
        shutil.copytree(kept, out)
    assert len(seen) == 2


def test_a_first_batch_is_there_whole_or_not_at_all(tmp_path):
    cfg = write_cfg(tmp_path)
    out = tmp_path / "deep" / "out"
    put(tmp_path / "clean", cfg, STAGE)
    for _ in killed_at_each_call(lambda: put(out, cfg, STAGE)):
        put(out, cfg, STAGE)
        assert contents(out) == contents(tmp_path / "clean")
        shutil.rmtree(tmp_path / "deep")


def test_finishing_an_update_can_be_killed_as_well(output, tmp_path, caplog):
    out, cfg = output
    kept = tmp_path / "kept"
    put(shutil.copytree(out, tmp_path / "clean"), cfg, NEXT)
    for _ in killed_at_each_call(lambda: put(out, cfg, NEXT)):
        if (out / UPDATE).is_dir():
            break
    shutil.copytree(out, kept)
    for _ in killed_at_each_call(lambda: finish_update(out)):
        finish_update(out)
        now = {n: b for n, b in contents(out).items() if n != "timings.json"}
        clean = contents(tmp_path / "clean")
        assert now == {n: b for n, b in clean.items() if n != "timings.json"}
        shutil.rmtree(out)
        shutil.copytree(kept, out)
    caplog.clear()
    with caplog.at_level(logging.WARNING, "scenec.output"):
        finish_update(out)
        finish_update(out)
    assert [r.getMessage() for r in caplog.records] == [
        f"{out}: finished an update that was cut short"
    ]


def test_the_disk_has_an_update_before_it_begins_and_its_begin_before_anything_moves(
    output, monkeypatch
):
    out, cfg = output
    calls: list[object] = []
    sync, rename, replace_ = os.fsync, os.rename, os.replace

    def synced(file: int) -> None:
        calls.append(os.fstat(file).st_ino)
        sync(file)

    def renamed(old: Path, new: Path) -> None:
        inside_ = {path.stat().st_ino for path in (old, *Path(old).rglob("*"))}
        assert inside_ <= set(calls)
        calls.append("begins")
        rename(old, new)

    def moved(old: Path, new: Path) -> None:
        if UPDATE in Path(old).parts:
            assert calls[calls.index("begins") + 1] == out.stat().st_ino
            calls.append("moved")
        replace_(old, new)

    for name, spy in (("fsync", synced), ("rename", renamed), ("replace", moved)):
        monkeypatch.setattr(os, name, spy)
    put(out, cfg, NEXT)
    assert (calls.count("begins"), calls.count("moved")) == (1, 4)


def test_an_update_that_cannot_be_done_is_refused_before_anything_is(output, tmp_path):
    out, cfg = output
    (out / "batch_0000" / "looks").write_text("a file where a folder goes")
    before = contents(out)
    with pytest.raises(OutputError, match="looks: is a file, and a folder goes there"):
        put(out, cfg, NEXT)
    assert contents(out) == before


def test_a_manifest_that_lists_what_is_elsewhere_removes_nothing_there(output, tmp_path):
    out, cfg = output
    (tmp_path / "theirs").write_text("theirs")
    (out / "folder").mkdir()
    sound = (out / "manifest.json").read_text()
    for name, words in (("../theirs", "no path inside"), ("folder", "folder: is a folder")):
        manifest = json.loads(sound)
        manifest["files"][name] = {"sha256": "", "bytes": 0}
        (out / "manifest.json").write_text(json.dumps(manifest))
        before = contents(out)
        with pytest.raises(OutputError, match=words):
            put(out, cfg, NEXT, 2, replace=True)
        assert contents(out) == before
    assert (tmp_path / "theirs").exists()


def test_what_leads_out_of_an_output_is_not_replaced(output, tmp_path):
    out, cfg = output
    (tmp_path / "elsewhere").mkdir()
    (out / "batch_0000" / "looks").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutputError, match="leads out of this folder"):
        put(out, cfg, NEXT)
    assert not list((tmp_path / "elsewhere").iterdir())
    # Nor by an update that somebody else made.
    (out / "batch_0000" / "looks").unlink()
    (tmp_path / "elsewhere" / "theirs").write_text("theirs")
    write(out / UPDATE, {".scenec-removed": json.dumps(["../elsewhere/theirs"])})
    with pytest.raises(OutputError, match="no path inside"):
        read_manifest(out)
    assert (tmp_path / "elsewhere" / "theirs").exists()


def test_files_that_the_manifest_does_not_list_are_kept_and_named(tmp_path):
    cfg = write_cfg(tmp_path, small_cfg(outputs=["depth"]))
    out = tmp_path / "out"
    compile_cfg(cfg, seed=1, out=out)
    write(out, {n: t for n, t in MINE.items() if "frames" not in n and "scans" not in n})
    again = compile_cfg(cfg, seed=1, out=out)
    assert again.unchanged == 1
    assert again.strays == (
        f"{out}/batch_0000/notes.txt (and 1 more in batch_0000): no part of the stage; left as it "
        "is",
    )
    compile_cfg(cfg, seed=2, out=out, replace=True)
    for name in ("batch_0000/notes.txt", "batch_0000/textures/mine.png", "notes.txt"):
        assert (out / name).read_text() == "mine"


def test_a_foreign_file_in_the_place_of_one_of_ours_is_not_overwritten(output):
    out, cfg = output
    write(out, {"batch_0000/looks/b.usda": "mine"})
    with pytest.raises(OutputError, match=r"looks/b\.usda.*is not the compiler's"):
        put(out, cfg, NEXT)
    assert (out / "batch_0000/looks/b.usda").read_text() == "mine"


def test_another_seed_or_cfg_is_refused_without_replace_and_says_what_would_go(output, tmp_path):
    out, cfg = output
    before = contents(out)
    other = write_cfg(tmp_path, small_cfg(name="other"), "other.json")
    for arguments, why in (((cfg, STAGE, 2), "seed 1, not 2"), ((other, STAGE), "another cfg")):
        with pytest.raises(OutputError, match=f"batch_0000 with 1 frames, of {why}.*--replace"):
            put(out, *arguments)
    assert contents(out) == before


def test_replacing_throws_frames_of_other_stages_away_and_keeps_those_of_the_same(output):
    out, cfg = output
    frames = out / "batch_0000" / "frames" / "annotation" / "rover_front"
    digest = stage_digest(read_manifest(out), "batch_0000")
    write(frames, {"000001.json": json.dumps({"stage_digest": digest}), "000001.exr": "exr"})
    write(frames, {"000002.clean.png": "half a frame", "mine.png": "mine", "000003.txt": "mine"})
    put(out, cfg, STAGE, 2, replace=True)
    assert sorted(os.listdir(frames)) == ["000001.exr", "000001.json", "000003.txt", "mine.png"]
    put(out, cfg, NEXT, 3, replace=True)
    assert sorted(os.listdir(frames)) == ["000003.txt", "mine.png"]


def test_more_batches_of_the_same_cfg_are_no_other_cfg_and_fewer_are_said(tmp_path):
    out = tmp_path / "out"
    put(out, write_cfg(tmp_path, small_cfg(batches=1)), STAGE)
    more = write_cfg(tmp_path, small_cfg(batches=5))
    spec = load(more)
    with locked(out):
        output = Output(out, spec, 1, Keep.SEEN, [4], False, lambda _line: None)
        with temporary_folder(out) as folder:
            write(folder / "batch_0004", NEXT)
            output.put(folder, 4, 3, 0)
    assert [b.index for b in read_manifest(out).batches] == [0, 4]
    write(out, {"batch_0004/frames/annotation/rover_front/000000.json": "{}"})
    fewer = write_cfg(tmp_path, small_cfg(batches=2))
    with pytest.raises(OutputError, match="batch_0004 with 1 frames, which this cfg has no more"):
        put(out, fewer, STAGE)
    assert put(out, fewer, STAGE, replace=True)
    assert not (out / "batch_0004").exists()


def test_two_compilations_of_one_output_do_not_run_at_once(output):
    out, cfg = output
    with locked(out):
        holder = subprocess.run(
            [sys.executable, "-m", "scenec.cli.main", "compile", str(cfg), "--seed", "1", "-o",
             str(out), "--no-cache"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert holder.returncode == 2
        assert f"process {os.getpid()}, since 20" in holder.stderr
        assert "is at work here" in holder.stderr
    assert put(out, cfg, STAGE)
    assert not (out / LOCK).exists()


def test_those_who_share_a_lock_keep_out_who_wants_it_alone(tmp_path):
    path = tmp_path / LOCK
    with Lock(path, alone=False):
        with Lock(path, alone=False), pytest.raises(BusyError):
            Lock(path)
        with pytest.raises(BusyError, match=f"process {os.getpid()}"):
            Lock(path)
        assert path.exists()
    assert not path.exists()
    Lock(path).release()


def test_a_lock_of_a_killed_process_is_nobody_s(tmp_path):
    for _ in killed_at_each_call(lambda: Lock(tmp_path / LOCK).release()):
        Lock(tmp_path / LOCK).release()
        assert not list(tmp_path.iterdir())


def test_a_file_system_without_locks_is_said_and_works(tmp_path, monkeypatch, caplog):
    def refused(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", refused)
    with caplog.at_level(logging.WARNING, "scenec.output"), Lock(tmp_path / LOCK):
        assert not list(tmp_path.iterdir())
    assert "knows no locks" in caplog.text


def test_what_a_killed_process_was_writing_is_swept_and_what_a_live_one_writes_is_not(tmp_path):
    def act() -> None:
        with atomic(tmp_path / "a.exr") as temporary:
            temporary.write_bytes(b"half")
        with temporary_folder(tmp_path) as folder:
            write(folder, {"deep/file": "half"})

    (tmp_path / ".scenec-notes").write_text("mine")
    with atomic(tmp_path / "b.exr") as living:
        living.write_bytes(b"")
        for _ in killed_at_each_call(act):
            sweep([tmp_path])
            left = {path.name for path in tmp_path.iterdir()} - {"a.exr"}
            assert left == {living.name, ".scenec-notes"}


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says when a process started")
def test_a_process_that_has_ended_is_not_alive_whatever_has_its_number_now(tmp_path):
    with warnings.catch_warnings():
        # Of threads that the child does not use.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        with temporary_folder(tmp_path):
            Lock(tmp_path / LOCK)
            os._exit(0)
    # It has ended, and has its number until it is waited for.
    os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)
    (left,) = {path.name for path in tmp_path.iterdir()} - {LOCK}
    sweep([tmp_path])
    assert not list(tmp_path.iterdir())
    os.waitpid(child, 0)
    # Somebody else has it.
    (tmp_path / left.replace(str(child), str(os.getpid()))).mkdir()
    sweep([tmp_path])
    assert not list(tmp_path.iterdir())
    assert is_alive(process_id())


@pytest.mark.parametrize(
    "name", ["../x", "/etc/passwd", "a/../../x", "link/x", "link", "", ".", "a\0b", "a\\..\\b"]
)
def test_no_name_leads_out_of_its_folder(tmp_path, name):
    root = tmp_path / "root"
    root.mkdir()
    (root / "link").symlink_to(tmp_path)
    with pytest.raises(OutputError):
        inside(root, name)


def test_no_name_in_a_scene_leads_out_of_its_batch(tmp_path):
    scene = build(draw(load(write_cfg(tmp_path)), 1, 0), BuildLog(), Keep.SEEN)
    mud = scene.materials["mud"]
    maps = MaterialMaps(1.0, {"base_color": ImageFile("/../../../x", b"")}, "opengl")
    folder = tmp_path / "batch"
    before = contents(tmp_path)
    for change in (
        {"objects": (replace(scene.objects[0], name="../../x"),)},
        {"materials": {**scene.materials, "../x": mud}},
    ):
        with pytest.raises(OutputError, match="is no path inside of this folder"):
            write_batch(folder, replace(scene, **change))
    with pytest.raises(OutputError, match="is no path inside of this folder"):
        copy_maps(folder, "mud", replace(mud, maps=maps))
    assert contents(tmp_path) == before


def test_names_in_a_folder_that_is_a_link_itself_are_fine(tmp_path):
    (tmp_path / "real" / "a").mkdir(parents=True)
    (tmp_path / "root").symlink_to(tmp_path / "real")
    (tmp_path / "real" / "in").symlink_to("a")
    for name in ("a", "a/new.exr", "in/new.exr"):
        assert inside(tmp_path / "root", name) == tmp_path / "root" / name


def test_a_place_that_cannot_be_written_is_said_before_the_compilation(tmp_path):
    (tmp_path / "file").write_text("")
    said: list[str] = []

    def tell(text: str, _place: tuple[int, int] | None) -> None:
        said.append(text)

    for out in (tmp_path / "file" / "out", Path("/proc/nowhere/out")):
        with pytest.raises(OutputError, match="cannot be written"):
            compile_cfg(write_cfg(tmp_path), seed=1, out=out, progress=tell)
    assert said == []


def test_a_disk_without_room_is_said_before_the_compilation(tmp_path, monkeypatch):
    full = os.statvfs(tmp_path)
    fields = list(full)
    fields[4] = 3
    monkeypatch.setattr(os, "statvfs", lambda _path: os.statvfs_result(fields))
    with pytest.raises(OutputError, match="the disk is full"):
        compile_cfg(write_cfg(tmp_path), seed=1, out=tmp_path / "a" / "out")
    assert not (tmp_path / "a").exists()


def test_a_killed_replacement_of_a_new_folder_leaves_none(tmp_path):
    new = tmp_path / "new"
    write(new, STAGE)
    replace_files(new, tmp_path / "there")
    assert contents(tmp_path / "there") == {n: t.encode() for n, t in STAGE.items()}
