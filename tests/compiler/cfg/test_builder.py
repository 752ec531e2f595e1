"""Cfgs that are written in Python are those that are written in JSON."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

from scenec.compiler.cfg import builder
from scenec.compiler.cfg.builder import (
    Cfg,
    GroundBase,
    Material,
    PoseOrbit,
    ReliefMultifractal,
    ReliefPlane,
    Rig,
    Sensor,
    Terrain,
    Uniform,
)
from scenec.compiler.cfg.load import load
from scenec.compiler.kinds.schema import load_schemas
from scenec.schemas.errors import CfgError
from scenec.schemas.extras import install
from scenec.testing.extras import missing

ROOT = Path(__file__).resolve().parents[3]
CONFIGS = sorted((ROOT / "configs").glob("*.json"))


def hills(**keys: object) -> Cfg:
    relief = [ReliefPlane(), ReliefMultifractal(amplitude_m=Uniform(min=0.2, max=1), scale_m=8)]
    ground = [GroundBase(material="soil")]
    eye = Sensor(resolution=(320, 240), fov_deg=60)
    given = {
        "name": "hills",
        "outputs": ["rgb"],
        "terrain": Terrain(size_m=(20, 20), spacing_m=0.2, relief=relief, ground=ground),
        "materials": {"soil": Material(base_color=(0.2, 0.15, 0.1))},
        "rigs": {"drone": Rig(pose=PoseOrbit(radius_m=8, height_m=5), sensors={"eye": eye})},
    }
    return Cfg(**(given | keys))


def test_a_cfg_is_the_json_that_it_looks_like(tmp_path: Path) -> None:
    document = {
        "version": 1,
        "name": "hills",
        "outputs": ["rgb"],
        "terrain": {
            "size_m": [20, 20],
            "spacing_m": 0.2,
            "relief": [
                {"type": "plane"},
                {
                    "type": "multifractal",
                    "amplitude_m": {"type": "uniform", "min": 0.2, "max": 1},
                    "scale_m": 8,
                },
            ],
            "ground": [{"material": "soil"}],
        },
        "materials": {"soil": {"base_color": [0.2, 0.15, 0.1]}},
        "rigs": {
            "drone": {
                "pose": {"type": "orbit", "radius_m": 8, "height_m": 5},
                "sensors": {"eye": {"resolution": [320, 240], "fov_deg": 60}},
            }
        },
    }
    assert hills().as_json() == document
    saved = hills().save(tmp_path / "hills.json")
    assert hills().check(tmp_path).digest == load(saved).digest


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_shipped_cfg_can_be_read_and_written_again(path: Path) -> None:
    document = json.loads(path.read_text())
    if "package:bpy/" in path.read_text() and missing("bpy"):
        pytest.skip(f"its sky is of bpy: {install('cycles')}")
    document.pop("$schema", None)
    assert builder.read(path).as_json() == document


def test_null_is_told_from_what_is_left_out() -> None:
    light = builder.Light(sun=None)
    assert light.as_json() == {"sun": None}
    assert builder.Light().as_json() == {}
    assert repr(light) == "Light(sun=None)"


def test_text_that_is_no_json_is_a_fault_as_a_file_s_is() -> None:
    with pytest.raises(CfgError) as info:
        load("cfg", text=b'{"name": NaN}')
    (fault,) = info.value.faults
    assert (fault.file, fault.line, fault.column) == ("cfg", 1, 10)
    with pytest.raises(CfgError):
        hills(samples=float("nan")).check()


def test_faults_are_told_without_a_file() -> None:
    with pytest.raises(CfgError) as info:
        hills(samples=0, rigs={}).check()
    told = [(fault.file, fault.line, fault.pointer) for fault in info.value.faults]
    assert told == [("cfg", 0, "/rigs"), ("cfg", 0, "/samples")]


def test_a_key_that_there_is_not_is_refused_at_once() -> None:
    with pytest.raises(TypeError, match="scale_mm"):
        ReliefMultifractal(amplitude_m=1, scale_mm=8)
    with pytest.raises(AttributeError, match="ReliefWaves"):
        _ = builder.ReliefWaves
    relief = ReliefMultifractal(amplitude_m=1, scale_m=8)
    with pytest.raises(AttributeError, match='has no key "scale_mm"; did you mean "scale_m"'):
        relief.scale_mm = 9
    relief.scale_m = 9
    assert relief.as_json()["scale_m"] == 9


def test_every_object_of_the_schemas_has_a_class() -> None:
    shared = {"$ref", "x-shared"}
    kinds = {
        name: content
        for name, content in load_schemas().items()
        if "properties" in content and "allOf" not in content and not shared <= content.keys()
    }
    missing = {n for n, c in kinds.items() if not c.get("x-shared")} - set(builder.names().values())
    assert not missing
    for name, reference in builder.names().items():
        made = getattr(builder, name)
        assert made is builder.part_class(reference)
        assert made.__doc__


@pytest.mark.slow
def test_type_checkers_know_keys_and_types(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    stub = importlib.import_module("cfg_stub").make()
    (tmp_path / "builder.pyi").write_text(stub)
    (tmp_path / "use.py").write_text(
        "from builder import ReliefMultifractal, Uniform\n"
        "ReliefMultifractal(amplitude_m=Uniform(min=1, max=2), scale_m=8)\n"
        "ReliefMultifractal(amplitude_m='3', scale_m=8)\n"
        "ReliefMultifractal(amplitude_m=3, scale_mm=8)\n"
    )
    command = [sys.executable, "-m", "mypy", "--no-incremental", "--config-file=", "use.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    faults = [line for line in done.stdout.splitlines() if line.startswith("use.py:")]
    lines = {int(line.split(":")[1]) for line in faults if " error: " in line}
    assert lines == {3, 4}, done.stdout


def test_a_star_brings_the_classes_and_nothing_that_the_module_imports():
    brought: dict[str, object] = {}
    exec("from scenec.compiler.cfg.builder import *", brought)
    there = {name for name in brought if not name.startswith("__")}
    assert {"Cfg", "Uniform", "CompleteCfg", "read"} <= there
    assert there.isdisjoint({"json", "dataclasses", "schema", "cache", "Any"})
    assert there == set(dir(builder))
