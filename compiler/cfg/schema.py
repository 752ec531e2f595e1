"""The cfg's JSON Schemas: loading them, and walking a document along them.

The schemas of ``schemas/cfg/`` keep to a part of draft 2020-12 that can be walked: ``$ref`` to
another file, ``properties``, ``additionalProperties``, ``unevaluatedProperties`` (beside a
``$ref`` to keys that schemas share, which has "x-shared"), ``items``, ``prefixItems``, and ``if``,
``then``, ``else`` (alone or in ``allOf``). So defaults, the reference page and the drawing of
numbers come from the same files as the validation (``check_schema``). Forms that many keys share (a
length drawn once a batch, a color, a name) stand in ``forms.schema.json`` and are taken in when
they are loaded.
"""

from __future__ import annotations

import importlib.resources
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from scenec.compiler.cfg.json_positions import Path

ROOT = "cfg.schema.json"
NUMBER = "number.schema.json"
FORMS = "forms.schema.json"


def read_schemas() -> dict[str, dict[str, Any]]:
    """Every file of the cfg's schemas as it stands, by its name and sorted by it."""
    folder = importlib.resources.files("scenec.schemas") / "cfg"
    names = sorted(file.name for file in folder.iterdir() if file.name.endswith(".schema.json"))
    return {name: json.loads((folder / name).read_text(encoding="utf-8")) for name in names}


@cache
def load_schemas() -> Mapping[str, dict[str, Any]]:
    """Every schema of the cfg by file name, sorted by it, with the forms that they refer to."""
    schemas = read_schemas()
    forms = schemas.pop(FORMS)["$defs"]
    return {name: _with_forms(schema, forms) for name, schema in schemas.items()}


def _with_forms(schema: Any, forms: Mapping[str, Any]) -> Any:
    if isinstance(schema, list):
        return [_with_forms(entry, forms) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    file, _, name = str(schema.get("$ref", "")).partition("#/$defs/")
    if file == FORMS:
        # What stands beside the reference goes before the form.
        own = {key: entry for key, entry in schema.items() if key != "$ref"}
        return _with_forms({**forms[name], **own}, forms)
    return {key: _with_forms(entry, forms) for key, entry in schema.items()}


@dataclass(frozen=True)
class Field:
    """A place in a document, and what the schemas say of it.

    Attributes:
        path: Keys and indices from the root.
        keywords: The schema's keywords that apply, with references followed: a key that stands
            beside a ``$ref`` goes before the same key of what is referred to.
        is_number: Whether it is a constant or a distribution.
    """

    path: Path
    value: Any
    keywords: Mapping[str, Any]
    is_number: bool


def describe(schema: Mapping[str, Any], value: Any, path: Path = ()) -> Field:
    """The field of one value under one schema."""
    keywords, is_number = _flatten(schema, value)
    return Field(path, value, keywords, is_number)


def root(document: Any) -> Field:
    """The field of a whole cfg."""
    return describe({"$ref": ROOT}, document)


def _flatten(schema: Mapping[str, Any], value: Any) -> tuple[dict[str, Any], bool]:
    merged: dict[str, Any] = {}
    is_number = False
    for branch in (schema, *schema.get("allOf", ())):
        if "if" in branch:
            taken = "then" if _fits(value, branch["if"]) else "else"
            keywords, number = _flatten(branch.get(taken, {}), value)
            _merge(merged, keywords)
            is_number = is_number or number
    _merge(merged, {key: entry for key, entry in schema.items() if key not in _APPLICATORS})
    if schema.get("$ref") == NUMBER:
        is_number = True
    elif "$ref" in schema:
        keywords, number = _flatten(_referred(schema["$ref"]), value)
        # What is said here goes before what is referred to.
        _merge(
            merged,
            {key: entry for key, entry in keywords.items() if key not in merged or key in _JOINED},
        )
        is_number = is_number or number
    return merged, is_number


def _referred(reference: str) -> Mapping[str, Any]:
    """A schema's file, or one of the kinds of numbers."""
    file, _, kind = reference.partition("#/$defs/")
    schema = load_schemas()[file or NUMBER]
    return schema["$defs"][kind] if kind else schema


def _fits(value: Any, condition: Mapping[str, Any]) -> bool:
    """Whether a value is as an ``if`` says: of a type, or with such values at its keys."""
    if "type" in condition and not is_of(value, condition["type"]):
        return False
    if value not in condition.get("enum", [condition.get("const", value)]):
        return False
    if not isinstance(value, dict):
        return True
    return all(key in value for key in condition.get("required", ())) and all(
        _fits(value[key], below)
        for key, below in condition.get("properties", {}).items()
        if key in value
    )


def is_of(value: Any, types: str | list[str]) -> bool:
    """Whether a value is of one of JSON Schema's types: 1.0 is an integer, true is no number."""
    if not isinstance(types, str):
        return any(is_of(value, name) for name in types)
    if isinstance(value, bool):
        return types == "boolean"
    if types == "integer":
        return isinstance(value, int) or (isinstance(value, float) and value.is_integer())
    return isinstance(value, _TYPES[types])


_TYPES: dict[str, type | tuple[type, ...]] = {
    "array": list, "boolean": bool, "null": type(None), "number": (int, float), "object": dict,
    "string": str,
}  # fmt: skip
#: Keywords of which both sides count.
_JOINED = frozenset({"properties", "required"})
_APPLICATORS = frozenset({"$ref", "$schema", "$defs", "allOf", "if", "then", "else"})


def _merge(into: dict[str, Any], keywords: Mapping[str, Any]) -> None:
    for key, entry in keywords.items():
        if key == "properties":
            # Of each keyword the first wins: a file of one type says more of "type" than the switch
            # over types.
            first = into.get(key, {})
            into[key] = {
                **entry,
                **{name: {**entry.get(name, {}), **own} for name, own in first.items()},
            }
        elif key == "required":
            into[key] = [*into.get(key, ()), *(k for k in entry if k not in into.get(key, ()))]
        else:
            into[key] = entry


def child(field: Field, key: str | int, value: Any) -> Field | None:
    """The field below a key or index, or None where the schemas know none."""
    schema: Any = None
    if isinstance(key, int):
        first = field.keywords.get("prefixItems", ())
        schema = first[key] if key < len(first) else field.keywords.get("items")
    else:
        schema = field.keywords.get("properties", {}).get(key)
        if schema is None:
            schema = field.keywords.get("additionalProperties")
    if not isinstance(schema, dict):
        return None
    return describe(schema, value, (*field.path, key))


def inside(number: Field) -> Field:
    """A number as an object with keys of its own."""
    keywords, _ = _flatten(load_schemas()[NUMBER], number.value)
    return Field(number.path, number.value, keywords, False)


def walk(field: Field) -> Iterator[Field]:
    """The field and all that stand below it in the document, parents first.

    Distributions are leaves. What the schemas do not know is left out.
    """
    yield field
    if field.is_number:
        return
    entries: Iterator[tuple[str | int, Any]] = iter(())
    if isinstance(field.value, dict):
        entries = iter(field.value.items())
    elif isinstance(field.value, list):
        entries = iter(enumerate(field.value))
    for key, value in entries:
        below = child(field, key, value)
        if below is not None:
            yield from walk(below)
