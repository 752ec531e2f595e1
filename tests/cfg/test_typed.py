"""The types of a cfg in full are those of the schemas."""

from __future__ import annotations

from typing import NotRequired, get_args, get_origin, get_type_hints

import pytest
from small_cfg import load_cfg, minimal

from scenec.compiler.cfg import typed
from scenec.compiler.kinds.schema import load_schemas

_TYPES = {
    "cfg": typed.Cfg,
    "terrain": typed.Terrain,
    "terrain_mesh": typed.Mesh,
    "light": typed.Light,
    "rig": typed.Rig,
    "sensor": typed.Sensor,
    "object_detail": typed.ObjectDetail,
}
_SINGLE = {"string": str, "integer": int, "number": float}


def _sparse(kind):
    hints = get_type_hints(kind, include_extras=True)
    return {key for key, hint in hints.items() if get_origin(hint) is NotRequired}


@pytest.mark.parametrize("name", _TYPES)
def test_keys_are_those_of_the_schema_in_its_order(name):
    properties = load_schemas()[f"{name}.schema.json"]["properties"]
    hints = get_type_hints(_TYPES[name], include_extras=True)
    assert list(hints) == [key for key, entry in properties.items() if not entry.get("x-ignored")]
    assert _sparse(_TYPES[name]) == {
        key for key, entry in properties.items() if "x-sparse" in entry
    }


@pytest.mark.parametrize("name", _TYPES)
def test_plain_values_have_the_schemas_type_and_none_where_nothing_stands_for_them(name):
    schema = load_schemas()[f"{name}.schema.json"]
    for key, hint in get_type_hints(_TYPES[name]).items():
        entry = schema["properties"][key]
        kinds = get_args(hint) or (hint,)
        single = _SINGLE.get(str(entry.get("type")))
        if single is None:
            continue
        assert single in kinds, key
        given = key in schema.get("required", ()) or "default" in entry or "x-sparse" in entry
        assert (type(None) in kinds) != given, key


def test_a_cfg_in_full_has_all_keys_of_its_types(tmp_path):
    cfg = load_cfg(minimal(), tmp_path).cfg
    sensor = cfg["rigs"]["rover"]["sensors"]["front"]
    for value, kind in ((cfg, typed.Cfg), (cfg["terrain"], typed.Terrain), (sensor, typed.Sensor)):
        assert set(value) == set(get_type_hints(kind)) - _sparse(kind)
