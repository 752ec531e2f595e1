"""Each fault of a cfg: where it is said to be, and what is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from small_cfg import DELETE, changed, faults_of, load_cfg, minimal

from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.schemas.errors import CfgError

_SIZE, _EMBED = "/objects/rocks/size_m", "/objects/rocks/embed"
_POSE, _FRONT = "/rigs/rover/pose", "/rigs/rover/sensors/front"
_UNIFORM = {"type": "uniform", "min": 0.1, "max": 0.2}
_LAYER = {"material": "sand", "labels": {"class": "ground"}}

#: A key, what it is set to in a sound cfg, where below it the one fault is, what is said.
_FAULTS = [
    ("/terain", 1, "", 'unknown key "terain"'),
    ("/objects/rocks/sise_m", 1, "", 'mean "size_m"?'),
    ("/objects/rocks/orientatoin", "any", "", '"orientation"'),
    ("/light/sun", {"elevation": 30}, "/elevation", '"elevation_deg"'),
    ("/terrain/ground/0/noise", {}, "", "the first layer is the base"),
    # wrong types
    ("/samples", "4", "", "expected a whole number"),
    ("/samples", True, "", "true: expected a whole number"),
    ("/samples", 2.5, "", "2.5: expected a whole number"),
    (_SIZE, "0.3", "", "a number or a distribution"),
    (_SIZE, [1, 2], "", "a number or a distribution"),
    ("/objects/rocks/instances", 1, "", "true or false"),
    ("/light/sun", [], "", "an object or null"),
    ("/version", 2, "", "2: expected 1"),
    ("/objects/rocks/type", {"type": "uniform"}, "", "expected"),
    # unknown choices
    ("/outputs", ["lable", "rgb"], "/0", 'did you mean "label"?'),
    ("/terrain/relief/0/type", "plain", "", 'did you mean "plane"?'),
    ("/objects/rocks/orientation", "Upright", "", '"upright"'),
    ("/outputs", ["rgb", "rgb"], "", "each item once"),
    (
        "/terrain/relief/1",
        {
            "type": "craters",
            "min_diameter_m": {"type": "uniform", "min": 1, "max": 5},
            "max_diameter_m": 4,
        },
        "/min_diameter_m",
        "5 m can be above max_diameter_m (4 m)",
    ),
    # names
    ("/name", "a b", "", "letters, digits and underscores"),
    ("/name", "plain\n", "", "letters, digits and underscores"),
    (
        "/rigs/rover/sensors/0th",
        {"resolution": [1, 1], "fov_deg": 9},
        "",
        "letters, digits and underscores",
    ),
    # bounds
    ("/terrain/spacing_m", 0, "", "more than 0 m"),
    ("/materials/sand/roughness", 1.5, "", "1.5: expected at most 1"),
    ("/objects/rocks/count", -1, "", "at least 0"),
    ("/objects/rocks/count", 1.5, "", "whole number"),
    ("/materials/sand/base_color", [0.1, 0.2], "", "at least 3 items"),
    ("/terrain/relief", [], "", "at least 1 item"),
    ("/rigs", {}, "", "at least 1 entry"),
    ("/labels/class/rock", 0, "", "at least 1"),
    ("/labels/class/rock", 2**31, "", "at most 2147483647"),
    # distributions
    (_SIZE, {}, "", '"type" is missing'),
    (_SIZE, {"type": "unifrom"}, "/type", '"uniform"'),
    (_SIZE, {"type": "uniform", "min": 1}, "", '"max" is missing'),
    (_SIZE, {**_UNIFORM, "mean": 1}, "/mean", "unknown key"),
    (_SIZE, {"type": "uniform", "min": 2, "max": 1}, "/min", "min is above max (1)"),
    (_SIZE, {"type": "uniform", "min": 0, "max": 1}, "/min", "0: expected more than 0 m"),
    (_EMBED, {"type": "choice", "values": [0.5, 2]}, "/values/1", "2: expected at most 1"),
    (
        _EMBED,
        {"type": "choice", "values": [0, 1], "weights": [1]},
        "/weights",
        "1 weights for 2 values",
    ),
    (
        _EMBED,
        {"type": "choice", "values": [0, 1], "weights": [0, 0]},
        "/weights",
        "all weights are 0",
    ),
    (_FRONT + "/fov_deg", {"type": "uniform", "min": 10, "max": 400}, "/max", "less than 180"),
    (_EMBED, {"type": "log_uniform", "min": 0, "max": 1}, "/min", "more than 0"),
    (_EMBED, {"type": "normal", "mean": 0.5, "std": 0.1, "max": 1.5}, "/max", "at most 1"),
    (_EMBED, {"type": "normal", "mean": 50, "std": 0.1}, "", "never falls between 0 and 1"),
    (_EMBED, {"type": "normal", "mean": 0.5, "std": -1}, "/std", "at least 0"),
    (
        "/objects/rocks/count",
        {"type": "uniform", "min": 1, "max": 2.5},
        "/max",
        "2.5: expected a whole number",
    ),
    (
        "/objects/rocks/count",
        {"type": "log_uniform", "min": 1.2, "max": 1.8},
        "",
        "no whole number lies between",
    ),
    ("/terrain/spacing_m", {**_UNIFORM, "per": "sample"}, "/per", "per batch only"),
    (_SIZE, {**_UNIFORM, "per": "sample"}, "/per", "per instance or batch only"),
    (
        "/light/sun",
        {"elevation_deg": {**_UNIFORM, "per": "instance"}},
        "/elevation_deg/per",
        "per sample or batch only",
    ),
    # materials and labels
    ("/objects/rocks/material", "basald", "", 'did you mean "basalt"?'),
    ("/materials/clay", {"base_color": [0, 0, 0]}, "", "is not used"),
    ("/labels/class/mud", 9, "", 'label "mud" is not used'),
    ("/labels/class/rock", 1, "", 'the id 1 is that of "ground"'),
    ("/objects/rocks/labels/class", "rok", "", 'mean "rock"?'),
    ("/light/sky/labels/clas", "sky", "", 'mean "class"?'),
    ("/objects/rocks/labels/clas", "x", "", 'mean "class"?'),
    (_FRONT + "/intrinsics", {"fx": 1, "fy": 1, "cx": 1, "cy": 1}, "", "take one away"),
    (
        "/terrain/ground/1",
        {**_LAYER, "threshold": 0.4, "coverage": 0.2},
        "/coverage",
        "take one away",
    ),
    ("/terrain/relief/0", {"type": "smooth", "length_m": 1}, "/type", "base"),
    ("/terrain/spacing_m", 1e-5, "", "height samples"),
    ("/rigs/rover/pose/position/y_m", 6, "", "-5 m to 5 m"),
    (
        "/rigs/rover/pose/position/x_m",
        {"type": "normal", "mean": 0, "std": 1},
        "",
        "give the distribution min and max",
    ),
    ("/light/sun", {"color": [0, 0, 0]}, "/color", "black"),
    # files
    (
        "/terrain/relief/0",
        {"type": "dem", "file": "no.npz", "pixel_m": 1},
        "/file",
        'no file "no.npz"',
    ),
    (
        "/terrain/relief/0",
        {"type": "dem", "file": "cfg.jsn", "pixel_m": 1},
        "/file",
        'did you mean "cfg.json"?',
    ),
    (
        "/terrain/relief/0",
        {"type": "dem", "file": "cfg.json", "pixel_m": 1},
        "/file",
        "a DEM is a .npz",
    ),
    (
        "/light/sky",
        {"type": "image", "files": ["cfg.json"], "labels": {"class": "sky"}},
        "/files/0",
        "not an OpenEXR file",
    ),
    (_POSE, {"type": "track", "file": "cfg.json"}, "/file", "cfg.json:1"),
    (_POSE, {"type": "track", "file": "a\0b"}, "/file", "zero"),
    (_POSE, {"type": "track", "file": ""}, "/file", "not empty"),
]
#: All changes, the pointer of the fault, what is said.
_OTHERS = [
    ({"/a~b": 1}, "/a~0b", "unknown key"),
    ({"/terrain/spacing_m": DELETE}, "/terrain", 'the key "spacing_m" is missing'),
    ({"/rigs/rover/sensors/front/resolution": DELETE}, "/rigs/rover/sensors/front", "resolution"),
    ({"/terrain/relief/0/type": DELETE}, "/terrain/relief/0", '"type" is missing'),
    ({"/version": DELETE}, "", '"version" is missing'),
    ({"/rigs/rover/sensors/front/fov_deg": DELETE}, "/rigs/rover/sensors/front", "intrinsics"),
]


def test_the_cfg_that_these_tests_change_has_no_fault(tmp_path):
    assert faults_of(minimal(), tmp_path) == ()


@pytest.mark.parametrize(
    ("changes", "pointer", "part"),
    [*(({key: value}, key + below, part) for key, value, below, part in _FAULTS), *_OTHERS],
)
def test_a_fault_is_told_once_at_its_pointer_with_what_was_expected(
    tmp_path, changes, pointer, part
):
    faults = faults_of(changed(changes), tmp_path)
    assert [fault.pointer for fault in faults] == [pointer], [str(fault) for fault in faults]
    assert part in faults[0].message


def test_line_and_column_are_those_of_the_value_or_of_the_key_at_fault(tmp_path):
    file = tmp_path / "cfg.json"
    cfg = changed({"/samples": 0, "/smaples": 1, "/terrain/spacing_m": DELETE})
    text = json.dumps(cfg, indent=2)
    file.write_text(text)
    with pytest.raises(CfgError) as caught:
        load(file)
    lines = text.split("\n")
    at = {fault.pointer: (fault.line, fault.column) for fault in caught.value.faults}

    def position_of(part: str) -> tuple[int, int]:
        line = next(i for i, line in enumerate(lines) if part in line)
        return line + 1, lines[line].index(part) + 1

    line, column = position_of('"samples": 0')
    assert at == {
        "/samples": (line, column + len('"samples": ')),
        "/smaples": position_of('"smaples"'),
        "/terrain": (position_of('"terrain": {')[0], 3 + len('"terrain": ')),
    }
    assert str(caught.value).startswith(f"{file}:")


def test_all_faults_of_a_file_are_told_at_once_in_its_order(tmp_path):
    cfg = changed(
        {
            "/outputs": ["rgb", "deth"],
            "/labels/class/dust": 2,
            "/terrain/relief/0/hight_m": 3,
            "/terrain/spacing_m": {"type": "uniform", "min": 3, "max": 1},
            "/materials/clay": {"base_color": [0, 0, 0]},
            "/objects/rocks/material": "basat",
            "/light/sky/type": "clar",
            "/rigs/rover/sensors/front/fov_deg": 180,
            "/rigs/rover/pose": {"type": "track", "file": "missing.csv"},
        }
    )
    faults = faults_of(cfg, tmp_path)
    assert {fault.pointer for fault in faults} == {
        "/outputs/1",
        "/labels/class/dust",
        "/terrain/relief/0/hight_m",
        "/terrain/spacing_m/min",
        "/materials/clay",
        "/objects/rocks/material",
        "/light/sky/type",
        "/rigs/rover/sensors/front/fov_deg",
        "/rigs/rover/pose/file",
    }
    assert [fault.line for fault in faults] == sorted(fault.line for fault in faults)


def test_a_misspelled_key_does_not_make_its_names_unused(tmp_path):
    cfg = minimal()
    cfg["objets"] = cfg.pop("objects")
    faults = faults_of(cfg, tmp_path)
    assert [fault.pointer for fault in faults] == ["/objets"]
    assert 'did you mean "objects"?' in faults[0].message


def test_a_key_that_stands_twice_is_told_at_its_second_place(tmp_path):
    file = tmp_path / "cfg.json"
    text = json.dumps(minimal(), indent=2)
    file.write_text(text.removesuffix("\n}") + ',\n  "name": "other"\n}')
    with pytest.raises(CfgError) as caught:
        load(file)
    (fault,) = caught.value.faults
    assert (fault.line, fault.column, fault.pointer) == (text.count("\n") + 1, 3, "/name")
    assert "stands twice" in fault.message


@pytest.mark.parametrize("labels", [{}, DELETE])
def test_a_label_that_is_left_out_is_0(tmp_path, labels):
    cfg = changed({"/objects/rocks/labels": labels, "/labels/class/rock": DELETE})
    assert draw(load_cfg(cfg, tmp_path), 0, 0).objects[0].labels == {"class": 0}


def test_without_label_levels_the_label_output_is_a_fault(tmp_path):
    cfg = changed({"/labels": DELETE, "/light": DELETE})
    cfg["terrain"]["ground"][0].pop("labels")
    cfg["objects"]["rocks"].pop("labels")
    (fault,) = faults_of(cfg, tmp_path)
    assert fault.pointer == ""
    assert 'the output "label"' in fault.message
    cfg["outputs"] = ["rgb", "depth"]
    assert load_cfg(cfg, tmp_path).cfg["labels"] == {}


def test_a_missing_cfg_and_a_folder_are_faults(tmp_path):
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(CfgError) as caught:
            load(path)
        assert caught.value.faults[0].file == str(path)


@pytest.mark.parametrize("root", [[], "cfg", 3, None, True])
def test_a_cfg_that_is_no_object_is_a_fault(tmp_path, root):
    (fault,) = faults_of(root, tmp_path)
    assert (fault.pointer, fault.line, fault.column) == ("", 1, 1)
    assert "expected an object" in fault.message


def test_an_array_that_the_dem_does_not_hold_is_told_with_the_nearest_one(tmp_path):
    np.savez(tmp_path / "relief.npz", elevation=np.zeros((4, 4)), dx=1.0)
    dem = {"type": "dem", "file": "relief.npz", "pixel_m": 10, "array": "elevatoin"}
    (fault,) = faults_of(changed({"/terrain/relief/0": dem}), tmp_path)
    assert fault.pointer == "/terrain/relief/0/array"
    assert 'did you mean "elevation"?' in fault.message
    dem["array"] = "elevation"
    assert faults_of(changed({"/terrain/relief/0": dem}), tmp_path) == ()


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04broken", b"\x93NUMPY\x01\x00\xff", b"x" * 99])
def test_a_broken_dem_is_a_fault_and_not_a_crash(tmp_path, content: bytes):
    for name in ("relief.npz", "relief.npy"):
        Path(tmp_path / name).write_bytes(content)
        dem = {"type": "dem", "file": name, "pixel_m": 10}
        (fault,) = faults_of(changed({"/terrain/relief/0": dem}), tmp_path)
        assert fault.pointer == "/terrain/relief/0/file"
        assert fault.message.startswith(name)
