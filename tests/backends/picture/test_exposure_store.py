"""Kept exposures: metered once by many, the same to the bit, and never in the way of a render."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from subprocess import PIPE, Popen

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.backends.check.files import check_files
from scenec.backends.check.frames import check_frames
from scenec.backends.picture import exposure, exposure_store
from scenec.backends.picture.exposure_store import ExposureStore
from scenec.backends.run.executors import Processes
from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.schemas.exposures import (
    EXPOSURES,
    CameraExposure,
    Exposure,
    ExposureTable,
    read_exposures,
    write_exposures,
)
from scenec.schemas.files import sweep
from scenec.schemas.frames import read_frame
from scenec.schemas.lock import Lock
from scenec.schemas.manifest import read_manifest
from scenec.schemas.sidecars import read_sidecar
from scenec.schemas.strays import rendered_files
from scenec.testing.examples import examples
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")

FOUND = Exposure(-8.296875, 55.615368149886265, 131.69436896639903, 317.340128735, "surfaces", 4)

#: A process that says when it is ready, waits to be told, and notes each exposure that it meters.
WORKER = """
import sys
from pathlib import Path
from scenec.backends.picture.exposure_store import ExposureStore
from scenec.schemas.exposures import Exposure

def meter():
    with (Path(sys.argv[1]) / "metered").open("a") as file:
        file.write("x")
    return Exposure(0.5, 0.1, 0.2, 0.3, "sky", 1)

store = ExposureStore(Path(sys.argv[1]), "stage")
print("ready", flush=True)
input()
print(store.find_or_meter("/Camera", None, meter).ev)
"""


def never() -> Exposure:
    raise AssertionError("is there, and metered again")


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    cfg = small_cfg(samples=2, outputs=["rgb", "depth"], batches=1)
    cfg["terrain"] |= {"relief": cfg["terrain"]["relief"][:1], "spacing_m": 2.0}
    cfg["objects"]["rocks"]["count"] = 3
    cfg["rigs"]["rover"]["sensors"] = {"a": {"resolution": [16, 12], "fov_deg": 70}}
    folder = tmp_path_factory.mktemp("metered")
    compile_cfg(write_cfg(folder, cfg), seed=1, out=folder / "out")
    render(folder / "out", "mitsuba", spp=2)
    return folder / "out"


@pytest.fixture
def copy(output: Path, tmp_path: Path) -> Path:
    return shutil.copytree(output, tmp_path / "out")


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Samples that were metered."""
    found: list[int] = []
    look = exposure.look

    def noted(*arguments):
        found.append(arguments[3])
        return look(*arguments)

    monkeypatch.setattr(exposure, "look", noted)
    return found


def frames_of(out: Path) -> list[tuple[bytes, bytes, object, float]]:
    """Frames' files, and what their sidecars say of exposure."""
    stems = sorted((out / "batch_0000" / "frames").glob("*/*/*.json"))
    found = []
    for path in stems:
        record = read_sidecar(path)
        files = (path.with_suffix(suffix).read_bytes() for suffix in (".exr", ".png"))
        found.append((*files, record.exposure, record.exposure_ev))
    assert len(found) == 2
    return found


def table_of(out: Path) -> Path:
    return out / "batch_0000" / "frames" / EXPOSURES


def again(out: Path, **options) -> Path:
    shutil.rmtree(out / "batch_0000" / "frames" / "mitsuba")
    render(out, "mitsuba", spp=2, **options)
    return out


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=4, max_size=4))
@examples(50)
def test_an_exposure_is_read_as_it_was_written_to_the_bit(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("bits") / EXPOSURES
    one = CameraExposure("/Camera", 3, Exposure(*values, "sky", 7))
    write_exposures(path, ExposureTable("stage", "code", (one,)))
    (read,) = read_exposures(path).exposures
    assert repr(read) == repr(one)


def test_of_several_processes_one_meters(tmp_path):
    workers = [
        Popen([sys.executable, "-c", WORKER, str(tmp_path)], stdin=PIPE, stdout=PIPE, text=True)
        for _ in range(3)
    ]
    for worker in workers:
        assert worker.stdout.readline() == "ready\n"
    for worker in workers:
        worker.stdin.write("go\n")
        worker.stdin.flush()
    assert [worker.communicate()[0] for worker in workers] == ["0.5\n"] * 3
    assert (tmp_path / "metered").read_text() == "x"
    assert {path.name for path in tmp_path.iterdir()} == {"metered", EXPOSURES}


def test_an_exposure_is_of_its_stage_camera_sample_and_code_alone(tmp_path, monkeypatch):
    store = ExposureStore(tmp_path, "stage")
    store.find_or_meter("/A", None, lambda: FOUND)
    others = [("stage", "/B", None), ("stage", "/A", 0), ("stage", "/A", 1)]
    for ev, (digest, camera, sample) in enumerate(others):
        other = Exposure(float(ev), 1.0, 1.0, 1.0, "sky", 1)
        kept = ExposureStore(tmp_path, digest)
        assert kept.find_or_meter(camera, sample, lambda made=other: made) == other
    assert store.find_or_meter("/A", None, never) == FOUND
    assert len(read_exposures(tmp_path / EXPOSURES).exposures) == 4
    fresh = Exposure(9.0, 1.0, 1.0, 1.0, "sky", 1)
    monkeypatch.setattr(exposure_store, "metering_digest", lambda: "another rule")
    assert store.find_or_meter("/A", None, lambda: fresh) == fresh
    assert ExposureStore(tmp_path, "other").find_or_meter("/A", None, lambda: FOUND) == FOUND
    # What is of neither goes.
    assert len(read_exposures(tmp_path / EXPOSURES).exposures) == 1


@pytest.mark.parametrize("blocked", ["no folder", "no lock", "no file"])
def test_where_nothing_can_be_written_each_meters_for_itself(tmp_path, blocked):
    folder = tmp_path / "frames"
    if blocked != "no folder":
        name = EXPOSURES if blocked == "no file" else ".scenec-lock-exposure"
        (folder / name).mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))
    store = ExposureStore(folder, "stage")
    assert [store.find_or_meter("/A", None, lambda: FOUND) for _ in range(2)] == [FOUND, FOUND]
    assert sorted(tmp_path.rglob("*")) == before


def test_what_is_not_finite_is_metered_by_whoever_needs_it(tmp_path):
    endless = Exposure(-512.0, float("inf"), float("inf"), float("inf"), "sky", 1)
    assert ExposureStore(tmp_path, "stage").find_or_meter("/A", None, lambda: endless) == endless
    assert not (tmp_path / EXPOSURES).exists()


def test_a_lock_that_a_killed_process_left_keeps_nobody_waiting(tmp_path):
    (tmp_path / ".scenec-lock-exposure").write_text('{"host": "here", "process": "1.1"}\n')
    assert ExposureStore(tmp_path, "stage").find_or_meter("/A", None, lambda: FOUND) == FOUND
    with Lock(tmp_path / ".scenec-lock-exposure"):
        # Who has found it takes no lock.
        assert ExposureStore(tmp_path, "stage").find_or_meter("/A", None, never) == FOUND
    sweep([tmp_path])
    assert [path.name for path in tmp_path.iterdir()] == [EXPOSURES]


def test_a_stage_is_metered_once_and_its_frames_are_the_same(copy, looks):
    before = frames_of(copy)
    assert frames_of(again(copy)) == before
    assert looks == []
    table_of(copy).unlink()
    assert frames_of(again(copy)) == before
    assert looks == [0, 1]
    table_of(copy).unlink()
    with Processes(2) as executor:
        again(copy, executor=executor)
    assert frames_of(copy) == before
    assert len(read_exposures(table_of(copy)).exposures) == 1


def test_frames_elsewhere_take_what_was_metered_beside_the_stage(copy, looks, tmp_path):
    render(copy, "mitsuba", spp=2, folder=tmp_path / "elsewhere")
    assert looks == []
    assert not list((tmp_path / "elsewhere").rglob(EXPOSURES))


def test_a_damaged_table_is_told_of_and_metered_again(copy, looks):
    before, text = frames_of(copy), table_of(copy).read_text()
    for damaged in ("", text[: len(text) // 2], "[]", text.replace('"ev"', '"eV"')):
        table_of(copy).write_text(damaged)
        (finding,) = _of_exposures(copy)
        assert finding.severity == "warning"
        said: list[str] = []
        assert frames_of(again(copy, say=said.append)) == before
        (line,) = [line for line in said if EXPOSURES in line]
        assert "metered again" in line
        assert looks == [0, 1]
        looks.clear()
        assert table_of(copy).read_text() == text


def test_a_check_knows_the_table(copy):
    assert not _of_exposures(copy)
    assert not [f for f in check_files(copy, read_manifest(copy)) if EXPOSURES in f.where]
    assert EXPOSURES not in read_manifest(copy).files


def test_a_table_of_another_stage_goes_with_its_frames(copy):
    folder = copy / "batch_0000"
    digest = json.loads(table_of(copy).read_text())["stage_digest"]
    assert digest == read_frame(next(folder.glob("frames/*/*/*.json"))).sidecar.stage_digest
    assert table_of(copy) not in rendered_files(folder, digest)
    assert table_of(copy) in rendered_files(folder, "another")
    assert table_of(copy) in rendered_files(folder)


def _of_exposures(out: Path):
    findings = check_frames(out / "batch_0000", None)
    return [one for one in findings if EXPOSURES in one.where]
