"""The cfg's JSON Schemas: loading them, and walking a document along them.

The schemas of ``schemas/cfg/`` keep to a part of draft 2020-12 that can be walked: ``$ref`` to
another file, ``properties``, ``additionalProperties``, ``unevaluatedProperties`` (beside a
``$ref`` to keys that schemas share, which has "x-shared"), ``items``, ``prefixItems``, and ``if``,
``then``, ``else`` (alone or in ``allOf``). So defaults, the reference page and the drawing of
numbers come from the same files as the validation. Forms that many keys share (a length drawn once
a batch, a color, a name) stand in ``forms.schema.json`` and are taken in when they are loaded.
"""

from __future__ import annotations

import importlib.resources
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from jsonschema import Draft202012Validator
from referencing import Registry
from referencing.jsonschema import DRAFT202012

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


@cache
def _registry() -> Registry:
    resources = [
        (name, DRAFT202012.create_resource(schema)) for name, schema in load_schemas().items()
    ]
    return Registry().with_resources(resources)


def validator(schema: Mapping[str, Any] | None = None) -> Draft202012Validator:
    """A validator of the whole cfg, or of one schema that may refer to the cfg's."""
    # Evolved: a validator made anew puts all schemas into a registry of its own.
    return _whole() if schema is None else _whole().evolve(schema=schema)


@cache
def _whole() -> Draft202012Validator:
    return Draft202012Validator({"$ref": ROOT}, registry=_registry())


@dataclass(frozen=True)
class Field:
    """A place in a document, and what the schemas say of it.

    Attributes:
        path: Keys and indices from the root.
        value: What stands there.
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
    own = {key: entry for key, entry in schema.items() if key not in _APPLICATORS}
    parts: list[Mapping[str, Any]] = []
    for branch in (schema, *schema.get("allOf", ())):
        if "if" in branch:
            taken = "then" if validator(branch["if"]).is_valid(value) else "else"
            parts.append(branch.get(taken, {}))
    for part in parts:
        keywords, number = _flatten(part, value)
        _merge(merged, keywords)
        is_number = is_number or number
    _merge(merged, own)
    if schema.get("$ref") == NUMBER:
        is_number = True
    elif "$ref" in schema:
        keywords, number = _flatten(load_schemas()[schema["$ref"]], value)
        # What is said here goes before what is referred to.
        _merge(
            merged,
            {key: entry for key, entry in keywords.items() if key not in merged or key in _JOINED},
        )
        is_number = is_number or number
    return merged, is_number


#: Keywords of which both sides count.
_JOINED = frozenset({"properties", "required"})
_APPLICATORS = frozenset({"$ref", "$schema", "$defs", "allOf", "if", "then", "else"})


def _merge(into: dict[str, Any], keywords: Mapping[str, Any]) -> None:
    for key, entry in keywords.items():
        if key == "properties":
            # The first wins: a file of one type says more of "type" than the switch over types.
            into[key] = {**entry, **into.get(key, {})}
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
