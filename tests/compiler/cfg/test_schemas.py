"""What holds for every schema of the cfg, and for the page made out of them."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from small_cfg import changed, minimal

from scenec.compiler.cfg.check_numbers import check_number
from scenec.compiler.cfg.check_schema import EXPECTED, check_schema
from scenec.compiler.kinds.schema import (
    NUMBER,
    ROOT,
    Field,
    load_bundle,
    load_schemas,
    root,
    walk,
)
from scenec.testing import cfg_reference

_WHOLE = {"$defs": load_bundle()["$defs"]}
_DOCS = Path(__file__).parents[3] / "docs"
_NAMES = list(load_schemas())


def _subschemas(schema, at=""):
    """Every schema below one, with where it stands; conditions ("if") are left out."""
    yield at, schema
    for keyword in ("properties", "$defs"):
        for key, below in schema.get(keyword, {}).items():
            yield from _subschemas(below, f"{at}/{keyword}/{key}")
    for keyword in ("items", "additionalProperties", "then", "else"):
        if isinstance(schema.get(keyword), dict):
            yield from _subschemas(schema[keyword], f"{at}/{keyword}")
    for keyword in ("allOf", "prefixItems"):
        for i, below in enumerate(schema.get(keyword, [])):
            yield from _subschemas(below, f"{at}/{keyword}/{i}")


def _all_subschemas():
    """Of every schema, with where it stands."""
    for name in _NAMES:
        yield from _subschemas(load_schemas()[name], name)


def test_the_schemas_are_valid_draft_2020_12():
    for name in _NAMES:
        Draft202012Validator.check_schema(load_schemas()[name])


#: Keywords that say where others apply, or nothing of values.
_OTHERS = {
    "$defs", "$ref", "$schema", "additionalProperties", "allOf", "default", "description", "else",
    "examples", "if", "items", "prefixItems", "properties", "propertyNames", "required", "then",
    "title", "unevaluatedProperties",
}  # fmt: skip


def _conditions(schema):
    yield schema
    for below in schema.get("properties", {}).values():
        yield from _conditions(below)


def test_no_schema_has_a_keyword_that_the_walk_passes_over():
    for at, schema in _all_subschemas():
        unknown = {key for key in schema if not key.startswith("x-")} - {*EXPECTED, *_OTHERS}
        assert not unknown, at
        for below in _conditions(schema.get("if", {})):
            assert set(below) <= {"type", "enum", "const", "properties", "required"}, at


def test_every_property_is_described():
    for at, schema in _all_subschemas():
        for key, entry in schema.get("properties", {}).items():
            assert entry.get("description", "").endswith("."), f"{at}/{key}"


def test_an_object_takes_no_unknown_keys():
    for at, schema in _all_subschemas():
        if at.endswith(("/else", "/then")):
            # Says more of keys that stand beside it.
            continue
        if "properties" in schema and "allOf" not in schema and not schema.get("x-shared"):
            # Beside a reference to shared keys, the former would refuse those.
            shares = "$ref" in schema and load_schemas()[schema["$ref"]]["x-shared"]
            assert schema["unevaluatedProperties" if shares else "additionalProperties"] is False, (
                at
            )
        assert "oneOf" not in schema, at
        assert "anyOf" not in schema, at


def test_a_reference_is_to_a_definition_that_is_there():
    for name in {*_NAMES} - {NUMBER}:
        for at, schema in _subschemas(load_schemas()[name], name):
            assert schema.get("$ref", ROOT) in load_schemas(), at


def test_every_number_says_when_it_is_drawn_and_every_default_is_valid():
    count = 0
    for at, schema in _all_subschemas():
        if "default" in schema:
            Draft202012Validator({**_WHOLE, **schema}).validate(schema["default"])
        if schema.get("$ref") != NUMBER:
            continue
        count += 1
        assert schema["x-per"] == schema["x-per-allowed"][0], at
        assert schema["x-per-allowed"][-1] == "batch", at
        if "default" in schema:
            assert not list(check_number(Field((), schema["default"], schema, True)))
    assert count > 50


def test_every_definition_is_reached_from_the_root():
    reached, pending = set(), [ROOT]
    while pending:
        name = pending.pop()
        if name in reached:
            continue
        reached.add(name)
        below = (s["$ref"] for _, s in _subschemas(load_schemas()[name]) if "$ref" in s)
        pending.extend(ref for ref in below if ref in load_schemas())
    assert sorted(reached) == _NAMES


@pytest.mark.parametrize(
    ("changes", "sound"),
    [({}, True), ({"/objects/rocks/embed": 2}, False), ({"/terrain/ground/0/noise": {}}, False)],
)
def test_an_editor_that_follows_the_schema_finds_the_same(changes, sound):
    editor = Draft202012Validator(load_bundle())
    cfg = changed(changes) if changes else minimal()
    assert editor.is_valid(cfg) == (not check_schema(walk(root(cfg)))) == sound


def _examples():
    """Place and example of every object of a cfg; unions have those of their kinds."""
    for name, schema in load_schemas().items():
        if name == NUMBER:
            for kind, definition in schema["$defs"].items():
                yield f"{name}/$defs/{kind}", definition.get("examples", [None])[0]
        elif name != ROOT and not {"allOf", "x-kinds"} & set(schema):
            yield name, schema.get("examples", [None])[0]


def test_every_object_has_an_example_that_is_valid():
    for place, example in _examples():
        assert example is not None, place
        validator = Draft202012Validator({**_WHOLE, "$ref": place})
        assert not [error.message for error in validator.iter_errors(example)], place


def test_the_schema_is_made_of_what_kinds_declare(monkeypatch):
    monkeypatch.syspath_prepend(str(_DOCS.parent))
    declarations = importlib.import_module("tools.declarations")
    file = _DOCS.parent / "schemas" / "cfg.schema.json"
    assert file.read_text(encoding="utf-8") == declarations.text(), "python -m tools.declarations"


def test_what_is_not_described_is_told_before_anything_is_written(monkeypatch):
    monkeypatch.syspath_prepend(str(_DOCS.parent))
    declarations = importlib.import_module("tools.declarations")
    of = {"description": "", "properties": {"a": {}, "b": {"description": "B."}}}
    monkeypatch.setattr(declarations, "bundle", lambda: {"$defs": {"relief_plane": of}})
    plane = "terrain.sources.plane:Plane: "
    said = f"{plane}no docstring\n{plane}a: no string below it that says what it is"
    with pytest.raises(SystemExit, match=re.escape(said)):
        declarations.main()


def test_the_reference_page_is_up_to_date():
    page = (_DOCS / "cfg.md").read_text(encoding="utf-8")
    assert page == cfg_reference.make(), "run: python -m tools.declarations"


def test_the_reference_page_links_to_its_own_sections_only():
    page = cfg_reference.make()
    titles = re.findall(r"^## (.*)$", page, re.MULTILINE)
    anchors = {re.sub(r"[^a-z0-9 _-]", "", title.lower()).replace(" ", "-") for title in titles}
    assert set(re.findall(r"\]\(#([^)]*)\)", page)) <= anchors
    assert titles[-1] == "Outputs"
    assert len(titles) == len(_NAMES) + 1
