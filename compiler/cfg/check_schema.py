"""What the JSON Schemas find wrong, in words."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.schema import Field, inside, is_of, walk
from scenec.schemas.passes import GROUP as PASSES
from scenec.schemas.passes import pass_names
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


class _Rule(NamedTuple):
    """What a keyword asks for.

    Attributes:
        holds: Whether a value is as the keyword's own value asks for.
        expected: What is, in words: of the keyword's value and the place.
        of: Type of the values that it speaks of; None: all.
    """

    holds: Callable[[Any, Any], bool]
    expected: Callable[[Any, Field], str]
    of: str | None = None


def check_schema(fields: Iterable[Field]) -> list[Finding]:
    """What the schemas find wrong.

    Args:
        fields: All places of a cfg, see ``schema.walk``.
    """
    findings: list[Finding] = []
    for field in fields:
        findings += check_value(field)
        if field.is_number:
            for below in walk(inside(field)):
                findings += check_value(below)
    return findings


def check_value(field: Field) -> Iterator[Finding]:
    """What a value's own keywords find wrong with it."""
    value, keywords = field.value, field.keywords
    for keyword, bound in keywords.items():
        if keyword not in RULES:
            continue
        rule = RULES[keyword]
        if keyword == "enum" and keywords.get("x-open") == PASSES:
            # With what other packages add.
            bound = pass_names()
        if (rule.of is None or is_of(value, rule.of)) and not rule.holds(value, bound):
            yield Finding(field.path, f"{shown(value)}: expected {rule.expected(bound, field)}")
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
    closed = False in (
        keywords.get("additionalProperties"),
        keywords.get("unevaluatedProperties"),
    )
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
            message = f"unknown key {shown(key)}{nearest(key, likely)}"
        yield Finding((*field.path, key), message, at_key=True)


def _is_same(value: Any, other: Any) -> bool:
    """Whether two values of JSON are equal: true is not 1."""
    return value == other and isinstance(value, bool) == isinstance(other, bool)


def _is_distinct(values: list[Any], asked: bool) -> bool:
    return not any(_is_same(a, b) for i, a in enumerate(values) for b in values[:i])


def _types(types: str | list[str], field: Field) -> str:
    names = [types] if isinstance(types, str) else types
    words = []
    if "number" in names and "object" in names:
        words = ['a number or a distribution such as {"type": "uniform", "min": …, "max": …}']
        names = [name for name in names if name not in ("number", "object")]
    return " or ".join(words + [_TYPES[name] for name in names])


def _choice(choices: Sequence[Any], field: Field) -> str:
    values = [str(value) for value in choices]
    expected = "one of " + ", ".join(values) if len(values) > 1 else values[0]
    guess = isinstance(field.value, str) and closest(field.value, values)
    return expected + (f"; did you mean {shown(guess)}?" if guess else "")


def _bound(words: str) -> Callable[[Any, Field], str]:
    return lambda bound, field: f"{words} {bound} {field.keywords.get('x-unit', '')}".rstrip()


def _count(words: str, one: str, many: str) -> Callable[[Any, Field], str]:
    return lambda bound, _: f"{words} {bound} {one if bound == 1 else many}"


#: What each keyword asks of a value; what is asked of keys stands above.
RULES = {
    "type": _Rule(is_of, _types),
    "enum": _Rule(lambda value, choices: value in choices, _choice),
    "const": _Rule(_is_same, lambda value, _: shown(value)),
    "minimum": _Rule(operator.ge, _bound("at least"), "number"),
    "maximum": _Rule(operator.le, _bound("at most"), "number"),
    "exclusiveMinimum": _Rule(operator.gt, _bound("more than"), "number"),
    "exclusiveMaximum": _Rule(operator.lt, _bound("less than"), "number"),
    "minItems": _Rule(lambda v, n: len(v) >= n, _count("at least", "item", "items"), "array"),
    "maxItems": _Rule(lambda v, n: len(v) <= n, _count("at most", "item", "items"), "array"),
    "uniqueItems": _Rule(_is_distinct, lambda *_: "each item once", "array"),
    "minProperties": _Rule(
        lambda v, n: len(v) >= n, _count("at least", "entry", "entries"), "object"
    ),
    "minLength": _Rule(lambda v, n: len(v) >= n, lambda *_: "a string that is not empty", "string"),
    "pattern": _Rule(lambda v, p: bool(re.search(p, v)), lambda *_: _NAME, "string"),
}
