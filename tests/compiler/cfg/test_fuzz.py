"""Whatever stands in a cfg, it loads or its faults are told."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from small_cfg import minimal

from scenec.compiler.cfg.check_schema import check_schema
from scenec.compiler.cfg.load import load
from scenec.compiler.distributions.numbers import Distribution
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.schema import load_bundle, root, walk
from scenec.schemas.errors import CfgError
from scenec.testing.examples import examples

_JSONSCHEMA = Draft202012Validator(load_bundle())
_SHARED_FOLDER = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture]
)

_FULL = minimal()
_FULL["terrain"]["relief"].append({"type": "multifractal", "amplitude_m": 1, "scale_m": 5})
_FULL["terrain"]["ground"].append(
    {"material": "sand", "labels": {"class": "ground"}, "noise": {"scale_m": 3}, "coverage": 0.5}
)
_FULL["light"]["sun"] = {"elevation_deg": {"type": "uniform", "min": 10, "max": 20}}
_FULL["objects"]["rocks"]["size_m"] = {"type": "normal", "mean": 0.3, "std": 0.1, "max": 1}
_FULL["objects"]["rocks"]["count"] = {"type": "choice", "values": [1, 2], "weights": [1, 2]}
_FULL["rigs"]["rover"]["pose"]["roll_deg"] = {"type": "log_uniform", "min": 1, "max": 2}


def _paths(value, path=()):
    yield path
    entries = value.items() if isinstance(value, dict) else ()
    entries = enumerate(value) if isinstance(value, list) else entries
    for key, below in entries:
        yield from _paths(below, (*path, key))


_PATHS = [path for path in _paths(_FULL) if path]
_PLAIN = "uniform normal batch sand class package:sys/x . ~/"
_WORDS = st.sampled_from(["x\n", "", "é", "\x00", *_PLAIN.split()]) | st.text(
    st.characters(exclude_categories=["Cs"]), max_size=5
)
_LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-3, 3)
    | st.sampled_from([0.5, -0.5, 1e308, -1e308, 5e-324, 2**53 + 1, 2**63, 10**30, 1e-9])
    | _WORDS
)
_DISTRIBUTIONS = st.fixed_dictionaries(
    {"type": st.sampled_from(["uniform", "log_uniform", "normal", "choice"])},
    optional={
        **{key: _LEAVES for key in ("min", "max", "mean", "std", "per")},
        "values": st.lists(_LEAVES, max_size=3),
        "weights": st.lists(_LEAVES, max_size=3),
    },
)
_VALUES = _LEAVES | _DISTRIBUTIONS | st.lists(_LEAVES, max_size=3) | st.sampled_from(
    [_FULL["terrain"]["ground"], _FULL["objects"], _FULL["light"], {"type": "dem"}]
)  # fmt: skip
_CHANGES = st.lists(
    st.tuples(
        st.sampled_from(_PATHS),
        st.sampled_from(["set", "delete", "add", "rename"]),
        _WORDS,
        _VALUES,
    ),
    min_size=1,
    max_size=4,
)


def _mutate(cfg, changes):
    for path, action, word, value in changes:
        owner = cfg
        for key in path[:-1]:
            try:
                owner = owner[key]
            except (KeyError, IndexError, TypeError):
                break
        else:
            key = path[-1]
            if isinstance(owner, dict):
                if action == "delete":
                    owner.pop(key, None)
                elif action == "rename" and key in owner:
                    owner[word] = owner.pop(key)
                else:
                    owner[key if action == "set" else word] = value
            elif isinstance(owner, list):
                if action == "delete":
                    del owner[:1]
                elif action == "add" or not owner:
                    owner.append(value)
                else:
                    owner[0] = value
    return cfg


@examples(100)
@given(_CHANGES)
def test_the_schemas_find_a_fault_where_jsonschema_does(changes):
    cfg = _mutate(copy.deepcopy(_FULL), changes)
    places = {finding.path for finding in check_schema(walk(root(cfg)))}
    found = [tuple(error.absolute_path) for error in _JSONSCHEMA.iter_errors(cfg)]
    # Of unknown keys and of bad names jsonschema names the object.
    assert places <= {*found} | {path for path in places if path[:-1] in found}
    assert {path for path in found if path not in places} <= {path[:-1] for path in places}


def _load_or_faults(file: Path):
    faults = ()
    try:
        return load(file)
    except CfgError as error:
        faults = error.faults
    assert faults
    assert all(fault.line >= 1 and fault.column >= 1 and fault.message for fault in faults)
    return None


@pytest.mark.slow
@examples(400, _SHARED_FOLDER)
@given(_CHANGES, st.integers(0, 3))
def test_a_mutated_cfg_loads_and_can_be_drawn_or_its_faults_are_told(tmp_path, changes, seed):
    file = tmp_path / "cfg.json"
    cfg = _mutate(copy.deepcopy(_FULL), changes)
    file.write_text(json.dumps(cfg), encoding="utf-8")
    spec = _load_or_faults(file)
    if spec is None:
        return
    for key in ("terrain", "materials", "objects", "light", "rigs"):
        drawn = resolve(spec.cfg[key], Streams(seed, 0), key, sample=0)
        left = [value for value in _leaves(drawn) if isinstance(value, Distribution)]
        assert all(number.per == "instance" for number in left)


def _leaves(value):
    if isinstance(value, (dict, list)):
        for below in value.values() if isinstance(value, dict) else value:
            yield from _leaves(below)
    else:
        yield value


@settings(_SHARED_FOLDER)
@given(st.binary(max_size=200))
def test_any_bytes_load_or_are_told_to_be_no_cfg(tmp_path, data):
    file = tmp_path / "cfg.json"
    file.write_bytes(data)
    assert _load_or_faults(file) is None


@examples(60, _SHARED_FOLDER)
@given(st.data())
def test_a_cfg_with_one_byte_changed_loads_or_its_faults_are_told(tmp_path, data):
    text = json.dumps(_FULL, indent=1).encode()
    at = data.draw(st.integers(0, len(text) - 1))
    byte = data.draw(st.integers(0, 255))
    file = tmp_path / "cfg.json"
    file.write_bytes(text[:at] + bytes([byte]) + text[at + 1 :])
    _load_or_faults(file)
