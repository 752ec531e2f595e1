"""Checks values against the JSON Schemas, and says in words what is wrong."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from jsonschema import Draft202012Validator

from scenec.compiler.cfg.slips import in_radians, meant_color, meant_key
from scenec.compiler.kinds.finding import Finding, Path
from scenec.compiler.kinds.schema import Field, inside, walk
from scenec.schemas.plugins import names_of
from scenec.schemas.spelling import closest, nearest, shown

_TYPES = {
    "array": "a list",
    "boolean": "true or false",
    "integer": "a whole number",
    "null": "null",
    "number": "a number",
    "object": "an object",
    "string": "a string",
}
_NAME = "a name of letters, digits and underscores, with no digit first"


def check_schema(fields: Iterable[Field]) -> list[Finding]:
    """Checks all values of a cfg against their schemas.

    Args:
        fields: All places of a cfg, see ``schema.walk``.
    """
    findings: list[Finding] = []
    reported: set[Path] = set()
    for field in fields:
        if field.path[:-1] in reported:
            continue
        if color := meant_color(field):
            findings.append(Finding(field.path, color))
            reported.add(field.path)
            continue
        findings += check_value(field)
        if field.is_number:
            for below in walk(inside(field)):
                findings += check_value(below)
    return findings


def check_value(field: Field) -> Iterator[Finding]:
    """Checks a value against the keywords of its own schema."""
    value, keywords = field.value, field.keywords
    if "x-fault" in keywords:
        yield Finding(field.path, keywords["x-fault"])
    for keyword, bound in keywords.items():
        if keyword not in EXPECTED:
            continue
        if keyword == "enum" and "x-open" in keywords and value not in bound:
            # With what other packages add.
            bound = [*bound, *(n for n in names_of(keywords["x-open"]) if n not in bound)]
        errors = _JUDGE.VALIDATORS[keyword](_JUDGE, bound, value, keywords)
        if next(iter(errors or ()), None) is not None:
            meant = in_radians(value, field) if "inimum" in keyword else ""
            expected = EXPECTED[keyword](bound, field)
            yield Finding(field.path, f"{shown(value)}: expected {expected}{meant}")
    if isinstance(value, dict):
        yield from _check_keys(field)


def _check_keys(field: Field) -> Iterator[Finding]:
    value, keywords = field.value, field.keywords
    properties = keywords.get("properties", {})
    for key in keywords.get("required", ()):
        if key not in value:
            about = properties.get(key, {}).get("description", "").rstrip(".")
            yield Finding(
                field.path, f"the key {shown(key)} is missing" + (f" ({about})" if about else "")
            )
    closed = False in (keywords.get("additionalProperties"), keywords.get("unevaluatedProperties"))
    known = [name for name, entry in properties.items() if not entry.get("x-ignored")]
    unused = [name for name in known if name not in value]
    for key in value:
        if "propertyNames" in keywords and not re.search(keywords["propertyNames"]["pattern"], key):
            yield Finding((*field.path, key), f"{shown(key)}: expected {_NAME}", at_key=True)
        if not closed or key in properties:
            continue
        if key in keywords.get("x-unknown", {}):
            message = f"unknown key {shown(key)}: {keywords['x-unknown'][key]}"
        else:
            # A key that is missing is a likelier meaning than one that is there already.
            likely = unused if closest(key, unused) else known
            meant = meant_key(key, value[key], {name: properties[name] for name in known})
            message = f"unknown key {shown(key)}{meant or nearest(key, likely)}"
        yield Finding((*field.path, key), message, at_key=True)


def _types(types: str | list[str], field: Field) -> str:
    names = [types] if isinstance(types, str) else types
    words = []
    if "number" in names and "object" in names:
        words = ['a number or a distribution such as {"type": "uniform", "min": …, "max": …}']
        names = [name for name in names if name not in ("number", "object")]
    return " or ".join(words + [_TYPES[name] for name in names])


def _choice(choices: Sequence[Any], field: Field) -> str:
    values = [str(value) for value in choices]
    if not values:
        return "a name that an installed package offers, and none does"
    expected = "one of " + ", ".join(values) if len(values) > 1 else values[0]
    guess = isinstance(field.value, str) and closest(field.value, values)
    if guess:
        return f"{expected}; did you mean {shown(guess)}?"
    if "x-open" not in field.keywords:
        return expected
    installed = ", ".join(names_of(field.keywords["x-open"])) or "none"
    return f"{expected}; others come from plug-ins, of installed ones {installed} (scenec doctor)"


def _bound(words: str) -> Callable[[Any, Field], str]:
    return lambda bound, field: " ".join(
        (
            f"{words} {bound}",
            *(field.keywords[k] for k in ("x-unit", "x-from") if k in field.keywords),
        )
    )


def _count(words: str, one: str, many: str) -> Callable[[Any, Field], str]:
    return lambda bound, _: f"{words} {bound} {one if bound == 1 else many}"


#: Of JSON Schema's keywords; what they are asked of is described by ``schema``.
_JUDGE = Draft202012Validator({})
#: What each keyword asks of a value, in words; what is asked of keys stands above.
EXPECTED: dict[str, Callable[[Any, Field], str]] = {
    "type": _types,
    "enum": _choice,
    "const": lambda value, _: shown(value),
    "minimum": _bound("at least"),
    "maximum": _bound("at most"),
    "exclusiveMinimum": _bound("more than"),
    "exclusiveMaximum": _bound("less than"),
    "minItems": _count("at least", "item", "items"),
    "maxItems": _count("at most", "item", "items"),
    "uniqueItems": lambda *_: "each item once",
    "minProperties": _count("at least", "entry", "entries"),
    "minLength": lambda *_: "a string that is not empty",
    "pattern": lambda *_: _NAME,
}
