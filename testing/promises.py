"""What users may build on within a major version, comparable: docs/guarantees.md.

``promised`` reads it off the code that runs; ``broken`` says what another reading took back.
Additions break nothing: a new key with a default, an option, a parameter, a field, a choice.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from types import ModuleType
from typing import Any, get_args, get_type_hints

import scenec
from scenec.cli.main import parser
from scenec.compiler.kinds.schema import bundled
from scenec.schemas import errors, passes, stage
from scenec.testing.small import small_cfg

Facts = dict[str, Any]

#: Records that are written to files which users read: module of ``schemas``, and name.
_RECORDS = {
    "manifest": "Manifest",
    "records": "FrameRecord",
    "report": "BatchReport",
    "site_map": "SiteFacts",
    "sweep": "SweepList",
}
#: What the schema says of a key for people to read; its words may change.
_WORDS = {"title", "description", "examples"}
#: Names of the schema whose lists may only grow, and bounds that may only widen.
_GROWING = {"enum", "type", "x-per-allowed", "anyOf", "oneOf"}
_LOWER, _UPPER = {"minimum", "minItems", "exclusiveMinimum"}, {"maximum", "maxItems"}


def promised() -> Facts:
    """Returns what holds now: keys, options, calls, fields of records, names in a stage."""
    return {
        "cfg": _without_words(bundled()["$defs"]),
        "commands": _commands(),
        "python": dict(_calls()),
        "errors": {
            name: [base.__name__ for base in kind.__mro__[1:-1]]
            for name, kind in inspect.getmembers(errors, inspect.isclass)
            if issubclass(kind, Exception)
        },
        "records": dict(_records()),
        "stage": _constants(stage, "ATTR_", "PRIMVAR_"),
        "passes": {name: "" for name in sorted(passes.PASSES)},
    }


def broken(before: Any, now: Any, where: str = "") -> list[str]:
    """Lists what ``before`` promised and ``now`` does not hold.

    Args:
        before: Of ``promised``, of the version that began the promise.
        now: Of ``promised``, today, or the same part of it.
        where: JSON pointer of the part.
    """
    name = where.rpartition("/")[2]
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        gone = [f"{where}/{key}: is gone" for key in before if key not in now]
        kept = [broken(before[key], now[key], f"{where}/{key}") for key in before if key in now]
        return [*gone, *(line for lines in kept for line in lines), *_needed(before, now, where)]
    if name in _GROWING or name == "choices":
        lost = [one for one in _list(before) if one not in _list(now)]
        return [f"{where}: no longer takes {one}" for one in lost]
    if name == "required":
        return [f"{where}: {one} became required" for one in now if one not in before]
    if name in _LOWER | _UPPER and isinstance(now, int | float):
        narrower = now > before if name in _LOWER else now < before
        return [f"{where}: was {before}, is {now}"] if narrower else []
    return [] if before == now else [f"{where}: was {before}, is {now}"]


def _needed(before: Mapping[str, Any], now: Mapping[str, Any], where: str) -> list[str]:
    """What is new and has to be given: a parameter without a default, a list of required keys."""
    new = {key: value for key, value in now.items() if key not in before}
    lines = [f"{where}/required: {one} became required" for one in new.get("required", ())]
    lines += [f"{where}/{key}: is a new limit" for key in new if key in _LOWER | _UPPER]
    if where.startswith("/python/"):
        lines += [f"{where}/{key}: has to be given" for key, value in new.items() if value is True]
    return lines


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _without_words(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {
            key: {name: _without_words(one) for name, one in inner.items()}
            if key == "properties"
            else _without_words(inner)
            for key, inner in value.items()
            if key not in _WORDS
        }
    return [_without_words(one) for one in value] if isinstance(value, list) else value


def _commands() -> Facts:
    [commands] = [
        action for action in parser()._actions if isinstance(action, argparse._SubParsersAction)
    ]
    return {name: dict(_options(command)) for name, command in commands.choices.items()}


def _options(command: argparse.ArgumentParser) -> Iterator[tuple[str, Facts]]:
    for action in command._actions:
        facts: Facts = {"takes": str(action.nargs) if action.nargs is not None else "1"}
        if action.choices is not None:
            facts["choices"] = sorted(map(str, action.choices))
        for name in action.option_strings or [action.dest]:
            yield name, facts


def _calls() -> Iterator[tuple[str, Facts]]:
    """Names of the library; of a call, whether each parameter has to be given."""
    for module in (scenec, importlib.import_module("scenec.compiler.cfg.builder")):
        for name in module.__all__:
            one = getattr(module, name)
            if module is not scenec and not inspect.isroutine(one):
                continue  # classes of the builder are the schema's
            if inspect.isclass(one):
                yield name, {key: False for key in _attributes(one) if not key.startswith("_")}
            elif callable(one):
                yield f"{name}()", dict(_parameters(one))


def _attributes(kind: type) -> set[str]:
    annotated = (vars(base).get("__annotations__", ()) for base in kind.__mro__)
    return {*dir(kind), *(key for keys in annotated for key in keys)}


def _parameters(call: Any) -> Iterator[tuple[str, bool]]:
    for name, one in inspect.signature(call).parameters.items():
        many = one.kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD)
        yield name, one.default is one.empty and not many


def _records() -> Iterator[tuple[str, Facts]]:
    for module, name in _RECORDS.items():
        kind = getattr(importlib.import_module(f"scenec.schemas.{module}"), name)
        yield module, _shape(kind)


def _shape(kind: Any) -> Any:
    """Fields of a record, with those of the records in it; of anything else, its name."""
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        return {one.name: _shape(hints[one.name]) for one in fields(kind) if one.init}
    inner = [_shape(one) for one in get_args(kind)]
    records = [one for one in inner if isinstance(one, dict)]
    if records:
        return {key: value for record in records for key, value in record.items()}
    return " | ".join(sorted({str(one) for one in inner})) or getattr(kind, "__name__", str(kind))


def _constants(module: ModuleType, *prefixes: str) -> Facts:
    return {name: value for name, value in vars(module).items() if name.startswith(prefixes)}


def kept_cfg() -> Facts:
    """A small cfg whose output is kept, for later versions to read."""
    cfg = small_cfg(name="kept", samples=2)
    cfg["terrain"] |= {"size_m": [8, 6], "spacing_m": 0.4}
    cfg["objects"]["rocks"] |= {"count": 30, "prototypes": 2, "subdivisions": 1}
    rover = cfg["rigs"]["rover"]
    rover["pose"]["position"] = {"x_m": -2, "y_m": 0, "height_m": 1.2}
    rover["pose"]["target"] = {"distance_m": 3, "bearing_deg": 90, "height_m": 0}
    lens = {"type": "brown_conrady", "k1": -0.1}
    rover["sensors"]["front"] = {"resolution": [48, 32], "fov_deg": 70, "lens": lens}
    return cfg
