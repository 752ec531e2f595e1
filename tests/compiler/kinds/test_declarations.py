"""What a class says of its keys, what becomes of it, and what it costs to ask."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal

import pytest
from jsonschema import Draft202012Validator
from small_cfg import minimal

from scenec.compiler.distributions.numbers import Distribution
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.declare import Form, declared_keys, description, given, key, noise_key
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.kinds.forms import (
    CHOICE,
    LENGTH_PER_BATCH,
    PER_INSTANCE,
    TRUTH,
    WHOLE_PER_BATCH,
    list_of,
)
from scenec.compiler.kinds.generate import bundle, definition
from scenec.compiler.kinds.schema import load_bundle
from scenec.compiler.kinds.table import CHOICES, CLASSES, class_of, kind_of, name_of


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Waves on a pond,
    as they come.

    Note: for who reads the code.
    """

    EXAMPLE: ClassVar = {"length_m": 2}

    length_m: float = key(LENGTH_PER_BATCH, above=0, at_most=9)
    """From crest
    to crest."""
    many: int = key(WHOLE_PER_BATCH, default=3)
    kind: Literal["steep", 7] | None = key(CHOICE, optional=True)
    rare: bool = key(TRUTH, sparse=True)
    sides: Any = key(list_of(TRUTH, "One side.", most=2), default=[True])
    owner: str = given(lambda context: context.path)
    key: int = noise_key()


def test_a_class_says_what_json_schema_says_of_its_keys() -> None:
    number = {"$ref": "#/$defs/number", "x-per": "batch", "x-per-allowed": ["batch"]}
    assert declared_keys(Sample) == {
        "length_m": (
            {
                **number, "x-unit": "m", "exclusiveMinimum": 0, "maximum": 9,
                "description": "From crest to crest.",
            },
            True,
        ),
        "many": ({**number, "x-kind": "integer", "default": 3}, False),
        "kind": ({"enum": ["steep", 7]}, False),
        "rare": ({"type": "boolean", "x-sparse": True}, False),
        "sides": (
            {
                "type": "array", "maxItems": 2, "default": [True],
                "items": {"description": "One side.", "type": "boolean"},
            },
            False,
        ),
    }  # fmt: skip
    assert list(declared_keys(Sample)) == ["length_m", "many", "kind", "rare", "sides"]
    assert description(Sample) == "Waves on a pond, as they come."


def test_a_class_without_a_docstring_says_nothing() -> None:
    assert description(_one(key(TRUTH))) == ""


def test_what_may_be_left_out_has_its_default_in_python_too() -> None:
    made = Sample(length_m=1.0, owner="me", key=5)
    assert (made.many, made.kind, made.rare, made.sides) == (3, None, None, (True,))
    with pytest.raises(TypeError, match="length_m"):
        Sample(owner="me", key=5)  # type: ignore[call-arg]


def test_bounds_that_a_key_adds_go_before_those_of_its_form() -> None:
    form = Form({"minimum": 0, "maximum": 1})
    (declared,) = (f.metadata["scenec.key"] for f in fields(_one(key(form, at_most=5))))
    assert declared.form.keywords == {"minimum": 0, "maximum": 5}


def _one(field: Any) -> type[Any]:
    return dataclass(type("One", (), {"__annotations__": {"a": "int"}, "a": field}))


def test_the_schema_is_valid_draft_2020_12_and_is_what_ships() -> None:
    made = bundle()
    Draft202012Validator.check_schema(made)
    # Text and not values: 1 and 1.0 are told apart where messages quote them.
    assert json.dumps(made) == json.dumps(load_bundle())
    assert list(made["$defs"]) == sorted([*CLASSES, *CHOICES, "number"])


@pytest.mark.parametrize("choice", [name for name, of in CHOICES.items() if of.kinds])
def test_each_kind_has_one_class_that_goes_by_its_name(choice: str) -> None:
    for name, of in CHOICES[choice].kinds.items():
        kind = kind_of(choice, name)
        assert kind is class_of(of)
        assert name_of(choice, kind) == name
        assert definition(of)["properties"]["type"]["const"] == name


def test_a_kind_in_another_choice_says_what_is_other_there() -> None:
    relief, small = definition("relief_multifractal"), definition("displacement_multifractal")
    assert relief["properties"]["octaves"]["default"] == 8
    assert small["properties"]["octaves"]["default"] == 3
    assert "mask" in relief["properties"]
    assert "mask" not in small["properties"]
    for name in ("amplitude_m", "gain", "variant"):
        assert relief["properties"][name] == small["properties"][name]


def test_numbers_of_each_instance_reach_a_kind_as_what_they_are_drawn_from() -> None:
    depth = Distribution("uniform", "instance", False, 0.1, 0.3)
    node = {
        "type": "craters", "min_diameter_m": 1.0, "max_diameter_m": 8.0, "density_per_m2": 0.05,
        "reference_diameter_m": 1.0, "exponent": 2.0, "depth_ratio": depth, "rim_ratio": 0.04,
        "degradation": 0.4, "irregularity": 0.0,
    }  # fmt: skip
    craters = draw_kind("relief", node, "terrain/relief/1", Context(Streams(1, 0), (50.0, 50.0)))
    assert 0.1 <= craters.depth_ratio.min() < craters.depth_ratio.max() <= 0.3
    assert PER_INSTANCE.keywords["x-per"] == "instance"


_HEAVY = ("numba", "llvmlite", "pxr", "scipy", "bpy", "mitsuba", "trimesh", "rasterio")
_IMPORT = """
import importlib, json, sys
for place in json.loads(sys.argv[1]):
    importlib.import_module("scenec.compiler." + place.partition(":")[0])
print(json.dumps([name for name in json.loads(sys.argv[2]) if name in sys.modules]))
"""


def test_no_module_with_a_check_imports_what_is_heavy() -> None:
    places = [d["x-check"] for d in load_bundle()["$defs"].values() if "x-check" in d]
    assert len(places) > 5
    words = [sys.executable, "-c", _IMPORT, json.dumps(places), json.dumps(_HEAVY)]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert json.loads(said) == []


_LOAD = """
import json, sys
from scenec.compiler.cfg.load import load
load("cfg.json", text=sys.argv[1].encode())
print(json.dumps([name for name in sys.modules if name.startswith("scenec.")]))
"""


def test_only_what_a_cfg_names_is_imported(tmp_path) -> None:
    cfg = minimal()

    def imported() -> set[str]:
        words = [sys.executable, "-c", _LOAD, json.dumps(cfg)]
        done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=tmp_path)
        return set(json.loads(done.stdout))

    craters = "scenec.compiler.terrain.operators.craters"
    assert craters not in imported()
    cfg["terrain"]["relief"].append({"type": "craters", "min_diameter_m": 1, "max_diameter_m": 2})
    assert craters in imported()
