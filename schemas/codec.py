"""Reads JSON values as records, and writes records as JSON values.

A record is a frozen dataclass whose annotations say what a file holds:

=======================  ===========================================================================
``str``, ``bool``        of this type; ``int`` is no ``bool``, ``float`` any finite number
``JSON``, ``Any``        whatever is there
``X | None``             null, or X
``tuple[X, ...]``        a list of these, of any length
``tuple[X, Y]``          a list of just these
``Mapping[str, X]``      an object with any keys and such values; ``dict[str, X]`` likewise
another record           an object with at least the keys that have no default
``Annotated[X, check]``  X of which ``check(value)`` is None, and not what was expected instead
=======================  ===========================================================================

Keys have the names of fields, and are written in their order. What a file lacks has its default;
keys that no field has are passed over, or are in a field that is ``rest()``, with their values.
``omitted()`` is a default that is not written; ``UNSET`` likewise, of what may be null as well.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import MISSING, Field, field, fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Final,
    Literal,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from scenec.schemas.errors import ScenecError, SceneError
from scenec.schemas.files import read_json
from scenec.schemas.spelling import closest, shown

type JSON = bool | int | float | str | Sequence[JSON] | Mapping[str, JSON] | None
#: An object of a document that a schema of its own describes, from which whoever reads it knows its
#: keys: a cfg or a part of one, a JSON Schema, COCO, glTF.
JsonObject = dict[str, Any]
#: What is reported freely, or goes to scripts: whoever reads it here reads it as a record.
Facts = Mapping[str, JSON]

#: What types of JSON are called.
NAMES = {str: "a text", bool: "true or false", int: "a whole number", float: "a finite number",
          dict: "an object", list: "a list"}  # fmt: skip


class Unset(Enum):
    """Stands for a key that is not there, where null means something else."""

    UNSET = "unset"

    def __bool__(self) -> Literal[False]:
        return False


UNSET: Final = Unset.UNSET


def omitted(default: Any = None, needed: Callable[[Mapping[str, Any]], bool] | None = None) -> Any:
    """Returns a field's default, which is not written; ``needed`` objects must have the key."""
    return field(default=default, metadata={"omitted": True, "needed": needed})


def rest() -> Any:
    """Returns a field that has the keys, a ``Mapping``, that no other field has."""
    return field(default_factory=dict, metadata={"rest": True})


def natural(value: Any) -> str | None:
    """Checks for a whole number from 0."""
    return None if type(value) is int and value >= 0 else "a whole number from 0"


Natural = Annotated[int, natural]


def is_number(value: Any) -> bool:
    """Tells whether a value is a finite number that fits a float."""
    try:
        return type(value) in (int, float) and math.isfinite(value)
    except OverflowError:
        return False


def read_record[T](path: Path, kind: type[T], error: type[ScenecError], what: str) -> T:
    """Reads the record in a file.

    Args:
        path: The file.
        kind: Class of the record.
        error: What is raised.
        what: What the file should be, for messages.

    Raises:
        FileNotFoundError: It is not there.
        ScenecError: It cannot be read, or is something else; the message has the JSON pointer.
    """
    return decode(read_json(path, error, what), kind, error, f"{path}: is no {what}")


def decode[T](value: Any, kind: type[T], error: type[ScenecError], where: str) -> T:
    """Makes a record of a JSON value.

    Raises:
        ScenecError: It is none, as the given class: ``<where>: <pointer>: <what is wrong>``.
    """
    try:
        decoded: T = _reader(cast(Hashable, kind))(value)
    except _MismatchError as fault:
        place = "".join(f"/{escaped(part)}" for part in reversed(fault.place))
        raise error(f"{where}: {place or '/'}: {fault.text}") from None
    return decoded


def read_facts[T](facts: JSON, kind: type[T]) -> T:
    """Returns the record that ``report.json`` has of what a step reports.

    Raises:
        SceneError: It lacks something, or says something else.
    """
    return decode(encode(facts), kind, SceneError, kind.__name__)


def encode(value: Any) -> Any:
    """Returns a record, or what one may hold, as JSON values."""
    if is_dataclass(value):
        found: dict[str, Any] = {}
        for name, is_rest, skipped in _written(cast(Hashable, type(value))):
            inner = getattr(value, name)
            if inner is not UNSET and inner is not skipped:
                found |= encode(inner) if is_rest else {name: encode(inner)}
        return found
    if isinstance(value, Mapping):
        return {str(key): encode(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [encode(inner) for inner in value]
    # Of NumPy.
    return value.tolist() if hasattr(value, "dtype") else value


class _MismatchError(Exception):
    """Carries a mismatch and the keys that lead to it, from the inside out."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.place: list[str] = []


@cache
def _written(kind: Any) -> tuple[tuple[str, bool, Any], ...]:
    """Returns of each field its name, whether it is the rest, and what of it is not written."""
    return tuple(
        (one.name, "rest" in one.metadata, one.default if "omitted" in one.metadata else UNSET)
        for one in fields(kind)
    )


@cache
def _reader(kind: Any) -> Callable[[Any], Any]:
    """Returns what makes a value of this type of a JSON value, or raises a ``_MismatchError``."""
    origin, args = get_origin(kind), get_args(kind)
    if kind in (JSON, Any):
        return lambda value: value
    if origin is Annotated:
        return _checked(args[1], _reader(args[0]))
    if origin in (Union, types.UnionType):
        (inner,) = (_reader(one) for one in args if one not in (types.NoneType, Unset))
        may_be_null = types.NoneType in args
        return lambda value: None if value is None and may_be_null else inner(value)
    if origin is tuple:
        return _tuple(args)
    if origin in (Mapping, dict):
        return _mapping(_reader(args[1]))
    if is_dataclass(kind):
        return _record(kind)
    return _plain(kind)


def _plain(kind: type) -> Callable[[Any], Any]:
    def read(value: Any) -> Any:
        if not (is_number(value) if kind is float else type(value) is kind):
            raise _expected(NAMES[kind], value)
        return value

    return read


def _checked(
    check: Callable[[Any], str | None], inner: Callable[[Any], Any]
) -> Callable[[Any], Any]:
    def read(value: Any) -> Any:
        expected = check(value)
        if expected is not None:
            raise _expected(expected, value)
        return inner(value)

    return read


def _tuple(args: tuple[Any, ...]) -> Callable[[Any], Any]:
    any_length = args[-1] is ...
    readers = [_reader(one) for one in args if one is not ...]

    def read(value: Any) -> Any:
        if not isinstance(value, list):
            raise _expected(NAMES[list], value)
        if not any_length and len(value) != len(readers):
            raise _MismatchError(f"expected {len(readers)} values, not {len(value)}")
        values: list[Any] = []
        try:
            for inner, one in zip(
                readers * len(value) if any_length else readers, value, strict=True
            ):
                values.append(inner(one))
        except _MismatchError as fault:
            fault.place.append(str(len(values)))
            raise
        return tuple(values)

    return read


def _mapping(inner: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def read(value: Any) -> Any:
        if not isinstance(value, dict):
            raise _expected(NAMES[dict], value)
        found, key = {}, ""
        try:
            for key, one in value.items():
                found[key] = inner(one)
        except _MismatchError as fault:
            fault.place.append(key)
            raise
        return found

    return read


def _is_needed(one: Field[Any]) -> Callable[[Any], bool] | None:
    if one.default is MISSING and one.default_factory is MISSING:
        return lambda _value: True
    needed: Callable[[Any], bool] | None = one.metadata.get("needed")
    return needed


def _record(kind: Any) -> Callable[[Any], Any]:
    hints = get_type_hints(kind, include_extras=True)
    others = next((one.name for one in fields(kind) if "rest" in one.metadata), None)
    readers = {one.name: _reader(hints[one.name]) for one in fields(kind)}
    of_others = {} if others is None else {others: readers.pop(others)}
    keys = {
        one.name: (readers[one.name], _is_needed(one))
        for one in fields(kind)
        if one.name in readers
    }

    def read(value: Any) -> Any:
        if not isinstance(value, dict):
            raise _expected(NAMES[dict], value)
        found, key = {}, ""
        try:
            for key, (inner, is_needed) in keys.items():
                if key in value:
                    found[key] = inner(value[key])
                elif is_needed is not None and is_needed(value):
                    break
            else:
                for key, inner in of_others.items():
                    found[key] = inner({name: value[name] for name in value if name not in keys})
                return kind(**found)
        except _MismatchError as fault:
            if key in keys:
                fault.place.append(key)
            raise
        guess = closest(key, [name for name in value if name not in keys])
        mend = "" if guess is None else f"; is it {shown(guess)}?"
        raise _MismatchError(f"the key {shown(key)} is missing{mend}")

    return read


def _expected(expected: str, value: Any) -> _MismatchError:
    return _MismatchError(f"expected {expected}, not {value_text(value)}")


def value_text(value: Any) -> str:
    """Returns a JSON value for messages."""
    return NAMES[type(value)] if isinstance(value, dict | list) else shown(value)


def escaped(key: str) -> str:
    """Returns a key as a part of a JSON pointer (RFC 6901)."""
    return key.replace("~", "~0").replace("/", "~1")
