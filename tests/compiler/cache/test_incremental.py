"""Incremental compilation: the bytes of a new start, and only what depends on a change is made."""

from __future__ import annotations

import copy
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scenec.cli.main import main
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cache import fingerprint, memo
from scenec.compiler.cache.memo import Memo, memoizing
from scenec.compiler.cache.store import Store
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import CompileReport, compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.emit.batch import write_batch
from scenec.schemas.files import digest_of_folder
from scenec.testing import small

_LANDER = Path(__file__).parents[3] / "assets" / "models" / "lander.glb"


def _cfg() -> dict[str, Any]:
    """Small, with something of each kind of step."""
    cfg = small.small_cfg(samples=2)
    cfg["terrain"] |= {"size_m": [14, 14], "spacing_m": 0.25}
    cfg["terrain"]["ground"][1] |= {"where": [{"type": "slope", "max_deg": 40}]}
    rocks = cfg["objects"]["rocks"]
    rocks |= {"count": 40, "prototypes": 2, "subdivisions": 2}
    rocks["material"] = "slate"
    cfg["objects"] = {
        "rocks": rocks,
        "bits": copy.deepcopy(rocks)
        | {"density": {"type": "around", "of": "rocks", "reach": 2}, "material": "stone"},
        "pebbles": copy.deepcopy(rocks) | {"count": 60, "material": "stone"},
        "landers": {
            "type": "meshes",
            "models": [{"file": str(_LANDER)}],
            "labels": {"class": "rock", "surface": "stone"},
            "count": 2,
            "apart": {"radius": 0.2, "of": ["pebbles", "landers"]},
        },
    }
    procedural = {"procedural": {"type": "basalt", "resolution": 64}}
    cfg["materials"]["slate"] = {"base_color": [0.2, 0.2, 0.2], "maps": procedural}
    cfg["materials"]["sand"]["displacement"] = [
        {"type": "worley", "amplitude_m": -0.01, "scale_m": 0.3}
    ]
    return cfg


def _bytes(out: Path) -> dict[str, str]:
    files = json.loads((out / "manifest.json").read_text(encoding="utf-8"))["files"]
    return {path: entry["sha256"] for path, entry in files.items()}


class _Place:
    """Compiles cfgs into folders of their own, with one cache, or with none."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.count = folder, 0
        self.cache = folder / "cache"
        self._scratch: dict[str, dict[str, str]] = {}

    def compiled(
        self, cfg: dict[str, Any], cache: Path | None = None, seed: int = 1, **rest: Any
    ) -> tuple[CompileReport, dict[str, str]]:
        self.count += 1
        path = small.write_cfg(self.folder, cfg)
        out = self.folder / f"out{self.count}"
        report = compile_cfg(path, seed=seed, out=out, cache=cache or self.cache, **rest)
        return report, _bytes(out)

    def scratch(self, cfg: dict[str, Any]) -> dict[str, str]:
        text = json.dumps(cfg)
        if text not in self._scratch:
            self.count += 1
            out = self.folder / f"out{self.count}"
            compile_cfg(small.write_cfg(self.folder, cfg), seed=1, out=out)
            self._scratch[text] = _bytes(out)
        return self._scratch[text]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Its cache is filled by one compilation."""
    found = _Place(tmp_path_factory.mktemp("incremental"))
    report, made = found.compiled(_cfg())
    assert made == found.scratch(_cfg())
    assert report.taken == {"batch_0000": {}} or sum(report.taken["batch_0000"].values()) < 10
    return found


def _made(report: CompileReport) -> set[str]:
    return set(report.made["batch_0000"])


def test_what_has_not_changed_is_made_by_no_step(place):
    report, found = place.compiled(_cfg())
    assert report.made == {"batch_0000": {}}
    assert {"relief", "cover", "light", "ground", "objects/rocks", "emit/terrain.usdc"} <= set(
        report.taken["batch_0000"]
    )
    assert found == place.scratch(_cfg())


def _count(cfg: dict[str, Any]) -> None:
    cfg["objects"]["pebbles"]["count"] = 63


def _denser(cfg: dict[str, Any]) -> None:
    cfg["objects"]["rocks"]["count"] = 41


def _sun(cfg: dict[str, Any]) -> None:
    cfg["light"]["sun"]["elevation_deg"] = 33


def _color(cfg: dict[str, Any]) -> None:
    cfg["materials"]["sand"]["base_color"] = [0.41, 0.3, 0.2]


def _camera(cfg: dict[str, Any]) -> None:
    cfg["rigs"]["rover"]["pose"]["position"]["height_m"] = 1.6


def _relief(cfg: dict[str, Any]) -> None:
    cfg["terrain"]["relief"][0]["slope"] = [0.06, -0.02]


_GROUND = {"relief", "cover", "ground"}
_CHANGES: list[tuple[Callable[[dict[str, Any]], None], set[str], set[str]]] = [
    # What changes, steps that must be made, and steps that must not.
    (
        _count,
        {"objects/pebbles", "objects/landers", "emit/pebbles.usdc"},
        _GROUND | {"light", "cameras", "objects/rocks", "objects/bits", "emit/rocks.usdc"},
    ),
    (
        _denser,
        {"objects/rocks", "objects/bits", "emit/rocks.usdc", "emit/bits.usdc"},
        _GROUND | {"light", "cameras", "objects/pebbles", "objects/landers", "emit/terrain.usdc"},
    ),
    (_sun, {"light", "cameras"}, _GROUND | {"objects/rocks", "objects/pebbles", "views"}),
    (
        _color,
        {"emit/terrain.usdc", "emit/sand.usda"},
        _GROUND | {"light", "cameras", "objects/rocks", "surfaces/slate", "emit/slate.usda"},
    ),
    (_camera, {"cameras", "ground", "objects/rocks"}, {"relief", "cover", "light", "prototypes"}),
    (_relief, {"relief", "cover", "ground", "objects/rocks"}, {"light", "prototypes"}),
]


@pytest.mark.parametrize(
    ("change", "needed", "spared"),
    [
        pytest.param(*row, id=row[0].__name__, marks=[] if row[0] is _count else pytest.mark.slow)
        for row in _CHANGES
    ],
)
@pytest.mark.invariant
def test_a_change_makes_what_depends_on_it_and_the_bytes_of_a_new_start(
    place, change, needed, spared
):
    cfg = _cfg()
    change(cfg)
    report, found = place.compiled(cfg)
    assert found == place.scratch(cfg)
    assert needed <= _made(report)
    assert not spared & _made(report)
    # And back: all of it is there.
    report, found = place.compiled(_cfg())
    assert report.made == {"batch_0000": {}}
    assert found == place.scratch(_cfg())


@pytest.mark.slow
def test_nothing_that_a_step_gave_or_was_given_is_changed_afterwards(place, tmp_path):
    spec = load(small.write_cfg(tmp_path, _cfg()))
    for _ in range(2):
        memo_ = Memo(Store(tmp_path / "cache"), hold=True)
        with memoizing(memo_):
            scene = build(draw(spec, 1, 0), BuildLog())
            (tmp_path / "batch").mkdir()
            write_batch(tmp_path / "batch", scene)
        assert memo_.changed() == []
        shutil.rmtree(tmp_path / "batch")
    assert not memo_.made


@pytest.mark.slow
def test_a_cache_of_another_seed_and_cfg_changes_nothing(place, tmp_path):
    other = _cfg()
    _relief(other)
    place.compiled(other, tmp_path / "cache", seed=2)
    _, found = place.compiled(_cfg(), tmp_path / "cache")
    assert found == place.scratch(_cfg())


@pytest.mark.slow
def test_entries_damaged_in_any_way_are_made_again(place, tmp_path):
    shutil.copytree(place.cache, tmp_path / "cache")
    entries = sorted((tmp_path / "cache").glob("steps/??/*.step"))
    for i, path in enumerate(entries):
        data = bytearray(path.read_bytes())
        match i % 5:
            case 0:
                data.clear()
            case 1:
                del data[len(data) // 2 :]
            case 2:
                data[-1] ^= 1
            case 3:
                data[60] ^= 255
            case 4:
                data[:] = entries[i - 1].read_bytes()
        path.write_bytes(data)
    report, found = place.compiled(_cfg(), tmp_path / "cache")
    assert found == place.scratch(_cfg())
    assert {"relief", "ground", "light"} <= _made(report)
    report, found = place.compiled(_cfg(), tmp_path / "cache")
    assert report.made == {"batch_0000": {}}


@pytest.mark.slow
def test_a_cache_deleted_on_the_way_changes_nothing(place, tmp_path):
    shutil.copytree(place.cache, tmp_path / "cache")

    def delete(text: str, place: tuple[int, int] | None) -> None:
        if place and text.endswith("ground"):
            shutil.rmtree(tmp_path / "cache", ignore_errors=True)

    report, found = place.compiled(_cfg(), tmp_path / "cache", progress=delete)
    assert found == place.scratch(_cfg())
    assert "ground" in _made(report)
    assert "relief" not in _made(report)


@pytest.mark.slow
def test_a_bound_is_kept(place, tmp_path, monkeypatch):
    monkeypatch.setenv("SCENEC_CACHE_MAX", "100000")
    _, found = place.compiled(_cfg(), tmp_path / "cache")
    assert found == place.scratch(_cfg())
    assert 0 < Store(tmp_path / "cache").size()[1] <= 100_000


@pytest.mark.slow
def test_other_code_is_another_key(place, monkeypatch):
    monkeypatch.setattr(memo, "fingerprint", lambda: "other")
    report, found = place.compiled(_cfg())
    assert {"relief", "cover", "ground", "light"} <= _made(report)
    assert found == place.scratch(_cfg())


def test_every_file_of_the_code_counts(tmp_path):
    (tmp_path / "a").mkdir()
    for name in ("x.py", "a/y.py", "a/z.json"):
        (tmp_path / name).write_text("1")
    seen = {digest_of_folder(tmp_path, fingerprint._SUFFIXES)}
    (tmp_path / "notes.md").write_text("no code")
    assert {digest_of_folder(tmp_path, fingerprint._SUFFIXES)} == seen
    for name in ("x.py", "a/y.py", "a/z.json"):
        (tmp_path / name).write_text("2")
        seen.add(digest_of_folder(tmp_path, fingerprint._SUFFIXES))
    (tmp_path / "a" / "y.py").rename(tmp_path / "a" / "w.py")
    seen.add(digest_of_folder(tmp_path, fingerprint._SUFFIXES))
    assert len(seen) == 5
    assert len(fingerprint.fingerprint()) == 64


@pytest.mark.slow
def test_the_command_line_takes_a_cache_where_it_is_told_to(place, tmp_path, monkeypatch, capsys):
    cfg = str(small.write_cfg(tmp_path, _cfg()))
    command = ["compile", cfg, "--seed", "1", "-o"]
    cache = ["--cache", str(place.cache)]
    assert main([*command, str(tmp_path / "a"), "--json", *cache]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert not steps["made"]["batch_0000"]
    assert steps["taken"]["batch_0000"]["ground"] == 1
    # The environment's, which --no-cache overrules.
    monkeypatch.setenv("SCENEC_CACHE", str(place.cache))
    assert main([*command, str(tmp_path / "b")]) == 0
    assert "steps were taken from the cache" in capsys.readouterr().err
    monkeypatch.setenv("SCENEC_CACHE", str(tmp_path / "none"))
    assert main([*command, str(tmp_path / "a"), "--no-cache", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["steps"] == {"made": {}, "taken": {}}
    assert not (tmp_path / "none").exists()
    assert _bytes(tmp_path / "a") == _bytes(tmp_path / "b") == place.scratch(_cfg())
    monkeypatch.setenv("SCENEC_CACHE_MAX", "much")
    assert main([*command, str(tmp_path / "a"), *cache]) == 2
    assert "expected a size" in capsys.readouterr().err


_PROCESS = """
import sys
from scenec.compiler.compile import compile_cfg
report = compile_cfg(sys.argv[1], seed=1, out=sys.argv[2], cache=sys.argv[3])
print(sum(report.made["batch_0000"].values()))
"""


@pytest.mark.slow
@pytest.mark.invariant
def test_processes_at_once_and_any_number_of_threads_give_the_same_bytes(place, tmp_path):
    cfg = small.write_cfg(tmp_path, _cfg())

    def start(name: str, threads: int) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", _PROCESS, cfg, tmp_path / name, tmp_path / "cache"],
            env={**os.environ, "NUMBA_NUM_THREADS": str(threads)},
            stdout=subprocess.PIPE,
            text=True,
        )

    both = [start("a", 1), start("b", 2)]
    assert [process.wait() for process in both] == [0, 0]
    for process in both:
        process.communicate()
    last = start("c", 1)
    made, _ = last.communicate()
    assert last.returncode == 0
    assert int(made) == 0
    for name in "abc":
        assert _bytes(tmp_path / name) == place.scratch(_cfg())
