"""Numbers of any magnitude that the schemas let through end in a stage, or in one clear error."""

from __future__ import annotations

import copy
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.kinds import schema
from scenec.schemas.errors import CfgError, ScenecError
from scenec.testing.small import small_cfg, write_cfg

#: Sizes of arrays and numbers of things: what they do is take time.
_COUNTS = ("version", "batches", "samples", "count", "resolution", "max_triangles", "subdivisions")


def tiny_cfg() -> dict[str, Any]:
    cfg = small_cfg(samples=1)
    cfg["terrain"] |= {"size_m": [8, 6], "spacing_m": 0.5}
    cfg["terrain"]["relief"].insert(2, {"type": "stream_power", "erodibility": 1e-4,
                                        "duration_a": 1e3, "steps": 2})  # fmt: skip
    cfg["objects"]["rocks"] |= {"count": 8, "prototypes": 2, "subdivisions": 1}
    cfg["light"]["sky"]["resolution"] = 16
    pose = cfg["rigs"]["rover"]["pose"]
    pose["position"] |= {axis: {"type": "uniform", "min": -2, "max": 2} for axis in ("x_m", "y_m")}
    pose["target"]["distance_m"] = 2
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [24, 16]
    # Of cliffs of kilometers the mesh is not exact to the height of a camera.
    cfg["rigs"]["rover"]["allow_below"] = True
    return cfg


def numbers() -> dict[tuple, list[float]]:
    """Every number of the cfg, given or left out: its bounds (1e12 without), and next to 0."""
    found = {}
    for field in schema.walk(schema.root(tiny_cfg())):
        below = field.keywords.get("properties", {}) if isinstance(field.value, dict) else {}
        absent = (schema.child(field, key, 1.0) for key in below if key not in field.value)
        for one in (field, *(absent if not field.is_number else ())):
            keys = one.keywords if one is not None else {}
            counts = set(one.path) & set(_COUNTS) if one is not None else ()
            if one is None or not one.is_number or counts or one.path[:2] == ("terrain", "size_m"):
                continue
            low = keys.get("minimum", keys.get("exclusiveMinimum", -1e12))
            high = keys.get("maximum", keys.get("exclusiveMaximum", 1e12))
            far = (low, high, 1e-12)
            sound = {v for v in far if low <= v <= high}
            sound -= {keys.get("exclusiveMinimum"), keys.get("exclusiveMaximum")}
            if keys.get("x-kind") == "integer":
                sound = {int(v) for v in sound if v == int(v) and abs(v) < 1e6}
            found[one.path] = sorted(sound)
    return found


def changed(path: tuple, value: Any) -> dict[str, Any]:
    cfg = copy.deepcopy(tiny_cfg())
    node = cfg
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return cfg


@pytest.mark.slow
@pytest.mark.parametrize("path", numbers(), ids=lambda path: "/".join(map(str, path)))
def test_a_number_at_its_bounds_and_next_to_0_ends_in_a_stage_or_one_error(path, tmp_path):
    for i, value in enumerate(numbers()[path]):
        file = write_cfg(tmp_path, changed(path, value), f"{i}.json")
        out = tmp_path / str(i)
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            try:
                compile_cfg(file, seed=1, out=out)
            except ScenecError:
                assert not out.exists(), "half written"
                continue
        assert_finite(out)


def assert_finite(out: Path) -> None:
    text = (out / "batch_0000" / "report.json").read_text()

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} in report.json")

    json.loads(text, parse_constant=refuse)


@pytest.mark.parametrize("amplitude", [1e5, 1e6])
def test_high_relief_that_float32_holds_compiles(tmp_path, amplitude):
    file = write_cfg(tmp_path, changed(("terrain", "relief", 1, "amplitude_m"), amplitude))
    compile_cfg(file, seed=1, out=tmp_path / "out")
    assert_finite(tmp_path / "out")


@pytest.mark.parametrize("value", [5e-324, 1e-300, 9e-31])
@pytest.mark.parametrize("place", [(), ("min",)])
def test_a_number_next_to_zero_is_a_fault_at_its_place(tmp_path, value, place):
    given = value if not place else {"type": "uniform", "min": value, "max": 1}
    path = ("terrain", "ground", 1, "noise", "scale_m")
    with pytest.raises(CfgError) as caught:
        load(write_cfg(tmp_path, changed(path, given)))
    (fault,) = caught.value.faults
    assert fault.pointer == "/" + "/".join(map(str, (*path, *place)))
    assert "expected 0, or at least 1e-30 from it" in fault.message


def test_zero_and_small_numbers_are_no_faults(tmp_path):
    for value in (1e-30, np.nextafter(1e-30, 1.0), 1e-12):
        load(write_cfg(tmp_path, changed(("terrain", "ground", 1, "noise", "scale_m"), value)))
