"""The cfg's JSON Schema: loading it, and walking a document along it.

``schemas/cfg.schema.json`` is made of what kinds declare (``generate``), with a definition for each
object. It keeps to a part of draft 2020-12 that can be walked: ``$ref`` to a definition,
``properties``, ``additionalProperties``, ``unevaluatedProperties`` (beside a ``$ref`` to keys that
objects share, which has "x-shared"), ``items``, ``prefixItems``, and ``if``, ``then``, ``else``
(alone or in ``allOf``). So defaults, the reference page and the drawing of numbers come from the
same declarations as the validation (``check_schema``). Where a definition says "x-kinds", the key
of that name can hold a name that another package offers (``scenec.schemas.plugins``).
"""

from __future__ import annotations

import importlib.resources
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from scenec.compiler.kinds.finding import Path
from scenec.compiler.kinds.forms import DEFS
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import ScenecError
from scenec.schemas.plugins import KINDS, entry_points_of, named, names_of, origin, place
from scenec.schemas.spelling import shown

ROOT, NUMBER = f"{DEFS}cfg", f"{DEFS}number"


@cache
def load_bundle() -> JsonObject:
    """Returns the schema as it stands in the file that ships."""
    file = importlib.resources.files("scenec.schemas") / "cfg.schema.json"
    bundle: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return bundle


@cache
def load_schemas() -> Mapping[str, JsonObject]:
    """Returns every definition by the reference to it, sorted by name."""
    return {f"{DEFS}{name}": schema for name, schema in load_bundle()["$defs"].items()}


def bundled(*, partial: bool = False) -> JsonObject:
    """One JSON Schema for editors; with kinds of other packages.

    Args:
        partial: Whether keys may be missing that are required, as in a cfg that extends another.
    """
    bundle: dict[str, Any] = _with_kinds(load_bundle(), partial)
    return {"$schema": load_bundle()["$schema"], **bundle}


def _with_kinds(schema: Any, partial: bool) -> Any:
    if isinstance(schema, list):
        return [_with_kinds(entry, partial) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    found = {
        key: entry if key == "if" else _with_kinds(entry, partial)
        for key, entry in schema.items()
        # A key of the cfg may be called so: what it says is no list, and no string.
        if not (key == "required" and partial and isinstance(entry, list))
        and not (key == "$schema" and isinstance(entry, str))
    }
    if "enum" in found and isinstance(found.get("x-open"), str):
        found["enum"] = list(dict.fromkeys([*found["enum"], *names_of(found["x-open"])]))
    if isinstance(key := found.get("x-kinds"), str):
        of = schema["properties"][key]
        branches = [
            {
                "if": {"properties": {key: {"const": name}}, "required": [key]},
                "then": _with_kinds(_keys_of(of["x-open"], name, key), partial),
            }
            for name in names_of(of["x-open"])
            if name not in of["enum"]
        ]
        if branches:
            found["allOf"] = [*found.get("allOf", ()), *branches]
            found.pop("additionalProperties", None)
    return found


def _keys_of(group: str, name: str, key: str) -> dict[str, Any]:
    """Returns the keys of another package's kind; of one that is broken, any."""
    try:
        found = dict(kind_schema(group, name))
    except ScenecError:
        return {}
    if key != "type":
        # What is named so has keys beside.
        del found["additionalProperties"]
        return found
    return {**found, "properties": {key: {"const": name}, **found["properties"]}}


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
    keywords: JsonObject
    is_number: bool


def describe(schema: JsonObject, value: Any, path: Path = ()) -> Field:
    """The field of one value under one schema."""
    keywords, is_number = _flatten(schema, value)
    return Field(path, value, keywords, is_number)


def root(document: Any) -> Field:
    """The field of a whole cfg."""
    return describe({"$ref": ROOT}, document)


def _flatten(schema: JsonObject, value: Any) -> tuple[dict[str, Any], bool]:
    merged: dict[str, Any] = {}
    is_number = False
    for branch in (schema, *schema.get("allOf", ())):
        if "if" in branch:
            taken = "then" if fits(value, branch["if"]) else "else"
            keywords, number = _flatten(branch.get(taken, {}), value)
            _merge(merged, keywords)
            is_number = is_number or number
    if "x-kinds" in schema and isinstance(value, dict):
        key = schema["x-kinds"]
        _merge(merged, _offered(schema["properties"][key], value.get(key)))
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


def _offered(key: JsonObject, name: Any) -> dict[str, Any]:
    """Returns the schema that another package's kind adds; ``key`` is the schema of its name."""
    group = key["x-open"]
    if not isinstance(name, str) or not (points := entry_points_of(group, name)):
        return {}
    if name in key["enum"]:
        what, whose = f"{KINDS[group]} {shown(name)}", ", ".join(map(place, points))
        return {"x-fault": f"several packages offer the {what}: scenec, {whose}; remove one"}
    try:
        return dict(kind_schema(group, name))
    except ScenecError as error:
        return {"x-fault": str(error)}


def origins(fields: Iterable[Field]) -> dict[str, str]:
    """Packages and versions of the kinds that a cfg names and other packages offer.

    Args:
        fields: All places of the cfg, see ``walk``.

    Returns:
        By group and name: "scenec.relief steps": "scenec-steps 1.0".
    """
    found = {}
    for field in fields:
        if "x-kinds" not in field.keywords or not isinstance(field.value, dict):
            continue
        name = field.value.get(field.keywords["x-kinds"])
        entry = field.keywords["properties"][field.keywords["x-kinds"]]
        if isinstance(name, str) and name not in entry["enum"]:
            found[f"{entry['x-open']} {name}"] = origin(entry["x-open"], name)
    return dict(sorted(found.items()))


@cache
def kind_schema(group: str, name: str) -> JsonObject:
    """The keys of another package's kind.

    Raises:
        ScenecError: It cannot be loaded, or what it says of its keys is no schema.
    """
    # Imported here: few cfgs have any.
    from jsonschema import Draft202012Validator, SchemaError

    from scenec.compiler.kinds.generate import foreign, with_forms
    from scenec.compiler.kinds.table import offered_kind

    kind = offered_kind(group, name)
    try:
        whole = foreign(group, kind)
        Draft202012Validator.check_schema(whole)
        schema: JsonObject = with_forms(whole)
        for keywords in schema["properties"].values():
            _flatten(keywords, None)
    except (SchemaError, KeyError, NameError) as error:
        why = error.message if isinstance(error, SchemaError) else f"there is no {error}"
        why = str(error) if isinstance(error, NameError) else why
        what = "SCHEMA" if hasattr(kind, "SCHEMA") else "keys"
        raise ScenecError(f"{named(group, name)}: {what}: {why}") from error
    return schema


def _referred(reference: str) -> JsonObject:
    """A definition, or one of the laws of numbers."""
    if reference in load_schemas():
        return load_schemas()[reference]
    of, _, law = reference.rpartition("/$defs/")
    if of not in load_schemas():
        raise KeyError(reference)
    law_schema: JsonObject = load_schemas()[of]["$defs"][law]
    return law_schema


def fits(value: Any, condition: JsonObject) -> bool:
    """Whether a value is as an ``if`` says: of a type, or with such values at its keys."""
    if "type" in condition and not is_of(value, condition["type"]):
        return False
    if value not in condition.get("enum", [condition.get("const", value)]):
        return False
    if not isinstance(value, dict):
        return True
    return all(key in value for key in condition.get("required", ())) and all(
        fits(value[key], below)
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


def _merge(into: dict[str, Any], keywords: JsonObject) -> None:
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
