"""Declares options once, for Python and the command line alike."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import Field, dataclass, field, fields
from functools import wraps
from typing import Any, Concatenate

from scenec.api.listener import Listener
from scenec.schemas.errors import ScenecError


def option(default: Any, help: str, **facts: Any) -> Any:
    """Declares a field that is an option.

    Args:
        default: Of a list: an empty tuple.
        help: What it is, as ``--help`` says it.
        facts: ``form``: what reads its text (``forms``); ``choices``; ``metavar``; ``flag``, where
            it is another than the name; ``many``: whether it may be given several times;
            ``const``: whether it is true where it is given, though its default is not false.
    """
    return held(default, help=help, **facts)


def held(default: Any, **facts: Any) -> Any:
    """Declares a field that is held to what is said of it, and is no option without a help.

    Args:
        default: As of ``option``.
        facts: As of ``option``.
    """
    return field(default=default, metadata=facts)


def declared(record: type, own: bool = False) -> dict[str, Field[Any]]:
    """The options of a record by name.

    Args:
        record: One of ``CallOptions``.
        own: Whether only those that its own class declares.
    """
    there = record.__annotations__ if own else record.__dataclass_fields__  # type: ignore[attr-defined]
    return {f.name: f for f in fields(record) if f.name in there and "help" in f.metadata}


@dataclass(frozen=True, kw_only=True)
class CallOptions:
    """Holds what every call takes, and checks it.

    Attributes:
        listener: Who hears what is done; the default keeps silent.

    None, too, means a field's default.

    Raises:
        ScenecError: One has a value that it cannot have.
    """

    listener: Listener = Listener()  # noqa: RUF009 (it has no state)

    def __post_init__(self) -> None:
        """Holds values to their forms, and reads those that are given as texts."""
        for each in fields(self):
            name, default, form = each.name, each.default, each.metadata.get("form")
            if getattr(self, name) is None:
                object.__setattr__(self, name, default)
            value, choices = getattr(self, name), each.metadata.get("choices")
            if isinstance(default, str | Listener) and not isinstance(value, type(default)):
                raise ScenecError(f"{name}: {value!r}: expected a {type(default).__name__}")
            if choices and value is not None and value not in choices:
                raise ScenecError(f"{name}: {value!r}: expected one of {', '.join(choices)}")
            several = isinstance(value, Iterable) and not isinstance(value, str)
            if several and not _takes_several(each.type):
                raise ScenecError(f"{name}: {value!r:.60}: expected one value")
            path = isinstance(value, bool | str | os.PathLike | None)
            if "Path" in str(each.type) and not (path or several):
                raise ScenecError(f"{name}: {value!r}: expected a path")
            if each.metadata.get("many") and not several:
                object.__setattr__(self, name, (str(value),))
            if form is None or value is None or several:
                continue
            try:
                object.__setattr__(self, name, form(str(value)))
            except ScenecError as error:
                raise ScenecError(f"{name}: {error}") from error


def _takes_several(annotation: object) -> bool:
    """Tells whether a field's annotation, as written, names a container."""
    containers = ("Sequence", "Collection", "Iterable", "Mapping", "range")
    return any(word in str(annotation) for word in containers)


class Spread[**P, T: CallOptions]:
    """Makes a function that takes a record take the record's fields, as typed keywords.

    ``@Spread(RenderOptions).one`` on ``def render(out, options)`` makes ``render(out, spp=16)``.

    Args:
        record: The class.
    """

    def __init__(self, record: Callable[P, T]) -> None:
        self._record = record

    def one[A, R](self, function: Callable[[A, T], R]) -> Callable[Concatenate[A, P], R]:
        """Decorates a function with one argument before the record."""
        return self._spread(function)

    def two[A, B, R](self, function: Callable[[A, B, T], R]) -> Callable[Concatenate[A, B, P], R]:
        """Decorates a function with two arguments before the record."""
        return self._spread(function)

    def _spread(self, function: Callable[..., Any]) -> Callable[..., Any]:
        record: Callable[..., T] = self._record

        before = list(inspect.signature(function).parameters.values())[:-1]
        after = inspect.signature(record).parameters.values()
        signature = inspect.signature(function).replace(
            parameters=[*(p.replace(kind=p.POSITIONAL_ONLY) for p in before), *after]
        )

        @wraps(function)
        def call(*args: Any, **options: Any) -> Any:
            if len(args) != len(before):
                # Python would speak of the record, which nobody gave.
                signature.bind(*args, **options)
            return function(*args, record(**options))

        call.__signature__ = signature  # type: ignore[attr-defined]
        call.__doc__ = re.sub(r"(?m)^( +)options: .*$", self._option_help, function.__doc__ or "")
        return call

    def _option_help(self, line: re.Match[str]) -> str:
        told = {name: f.metadata["help"] for name, f in declared(self._record).items()}  # type: ignore[arg-type]
        return "\n".join(
            f"{line[1]}{name}: {text.replace('%%', '%')}" for name, text in told.items()
        )
