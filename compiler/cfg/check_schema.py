"""What the JSON Schemas find wrong, in words."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from jsonschema import ValidationError

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.compiler.cfg.schema import describe, validator
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


def check_schema(document: Any) -> list[Finding]:
    """All findings of the schemas on a document."""
    findings: list[Finding] = []
    for error in validator().iter_errors(document):
        findings.extend(_findings(error))
    return findings


def _findings(error: ValidationError) -> Iterator[Finding]:
    path: Path = tuple(error.absolute_path)
    keyword = str(error.validator)
    if keyword in ("additionalProperties", "unevaluatedProperties"):
        yield from _unknown_keys(error, path)
    elif keyword == "required":
        yield from _missing_keys(error, path)
    elif "propertyNames" in error.absolute_schema_path:
        yield Finding(
            (*path, error.instance),
            f"{shown(error.instance)}: {_IDENTIFIER}",
            at_key=True,
        )
    elif not (keyword == "enum" and error.instance in _offered(error)):
        say = _MESSAGES.get(keyword)
        expected = say(error) if say else error.message
        yield Finding(path, f"{shown(error.instance)}: expected {expected}")


_IDENTIFIER = "expected a name of letters, digits and underscores, with no digit first"


def _unknown_keys(error: ValidationError, path: Path) -> Iterator[Finding]:
    # With those of the schemas that it refers to.
    schema = describe(error.schema, error.instance).keywords
    known = [name for name, entry in schema["properties"].items() if not entry.get("x-ignored")]
    reasons = schema.get("x-unknown", {})
    unused = [name for name in known if name not in error.instance]
    for key in error.instance:
        if key in schema["properties"]:
            continue
        if key in reasons:
            message = f"unknown key {shown(key)}: {reasons[key]}"
        else:
            # A key that is missing is a likelier meaning than one that is there already.
            likely = unused if closest(key, unused) else known
            message = f"unknown key {shown(key)}{nearest(key, likely)}"
        yield Finding((*path, key), message, at_key=True)


def _missing_keys(error: ValidationError, path: Path) -> Iterator[Finding]:
    # One error names one key, in its message only; a second error names the next.
    for key in error.validator_value:
        if key not in error.instance and error.message.startswith(f"{key!r} "):
            about = error.schema.get("properties", {}).get(key, {}).get("description", "")
            yield Finding(
                path,
                f"the key {shown(key)} is missing" + (f" ({about.rstrip('.')})" if about else ""),
            )


def _type(error: ValidationError) -> str:
    types = error.validator_value
    names = [types] if isinstance(types, str) else list(types)
    if "number" in names and "object" in names:
        words = ['a number or a distribution such as {"type": "uniform", "min": …, "max": …}']
        names = [name for name in names if name not in ("number", "object")]
    else:
        words = []
    return " or ".join(words + [_TYPES[name] for name in names])


def _offered(error: ValidationError) -> tuple[str, ...]:
    """What other packages add to a list of values that is open to them."""
    return pass_names() if error.schema.get("x-open") == PASSES else ()


def _enum(error: ValidationError) -> str:
    values = [str(value) for value in _offered(error) or error.validator_value]
    expected = "one of " + ", ".join(values) if len(values) > 1 else values[0]
    guess = isinstance(error.instance, str) and closest(error.instance, values)
    return expected + (f"; did you mean {shown(guess)}?" if guess else "")


def _bound(words: str) -> Callable[[ValidationError], str]:
    def say(error: ValidationError) -> str:
        unit = error.schema.get("x-unit", "")
        return f"{words} {error.validator_value}" + (f" {unit}" if unit else "")

    return say


def _count(least: str, one: str, many: str) -> Callable[[ValidationError], str]:
    def say(error: ValidationError) -> str:
        number = error.validator_value
        return f"{least} {number} {one if number == 1 else many}"

    return say


_MESSAGES: dict[str, Callable[[ValidationError], str]] = {
    "type": _type,
    "enum": _enum,
    "const": lambda error: shown(error.validator_value),
    "minimum": _bound("at least"),
    "maximum": _bound("at most"),
    "exclusiveMinimum": _bound("more than"),
    "exclusiveMaximum": _bound("less than"),
    "minItems": _count("at least", "item", "items"),
    "maxItems": _count("at most", "item", "items"),
    "minProperties": _count("at least", "entry", "entries"),
    "minLength": lambda error: "a string that is not empty",
    "uniqueItems": lambda error: "each item once",
    "pattern": lambda error: _IDENTIFIER.removeprefix("expected "),
}
