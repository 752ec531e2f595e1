"""Declares options once, for Python and the command line alike."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import Field, dataclass, field, fields
from functools import wraps
from numbers import Integral, Real
from typing import Any, Concatenate

from scenec.api.listener import Listener
from scenec.schemas.errors import ScenecError
from scenec.schemas.spelling import nearest


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


def flag_of(name: str, declaration: Field[Any]) -> str:
    """Returns the option's flag on the command line."""
    return str(declaration.metadata.get("flag", f"--{name.replace('_', '-')}"))


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
            value, choices = _plain(getattr(self, name)), each.metadata.get("choices")
            if choices and value is not None and value not in choices:
                raise ScenecError(f"{name}: {value!r}: expected one of {', '.join(choices)}")
            if each.metadata.get("many") and isinstance(value, str):
                value = (value,)
            read = isinstance(value, str) or "str" not in str(each.type)
            if form is not None and value is not None and read and not _is_several(value):
                try:
                    value = form(str(value))
                except ScenecError as error:
                    raise ScenecError(f"{name}: {error}") from error
            require(name, value, str(each.type))
            object.__setattr__(self, name, value)


#: Which values a word of an annotation takes, and how a message says it.
_TYPES: dict[str, tuple[Callable[[Any], bool], str]] = {
    "None": (lambda value: value is None, ""),
    "bool": (lambda value: isinstance(value, bool), "a bool"),
    "str": (lambda value: isinstance(value, str), "a str"),
    # True is a number for Python, and nobody means it.
    "int": (lambda one: isinstance(one, Integral) and not isinstance(one, bool), "a whole number"),
    "float": (lambda one: isinstance(one, Real) and not isinstance(one, bool), "a number"),
    "range": (lambda value: isinstance(value, range), "a range, A:B, or one number"),
    "Path": (lambda value: isinstance(value, os.PathLike), "a path"),
    "Folder": (lambda value: isinstance(value, str | os.PathLike), "a path"),
    "Listener": (lambda value: isinstance(value, Listener), "a Listener"),
    "Executor": (lambda value: hasattr(value, "work"), "an Executor"),
}


def require(name: str, value: object, annotation: str) -> None:
    """Holds a value to its argument's annotation.

    Args:
        name: Of the argument.
        value: What was given.
        annotation: As it is written: words of ``_TYPES``, and lists of them, between ``|``. What
            has other words is not held to them; whoever reads the value does that.

    Raises:
        ScenecError: It is something else; names the argument, the value and what is expected.
    """
    words = annotation.split(" | ")
    lists = [word.partition("[")[2].removesuffix("]") for word in words if "[" in word]
    if isinstance(value, Mapping) and "Mapping[" in annotation:
        return
    if _is_several(value) and lists:
        for one in value[:1] if isinstance(value, range) else value:  # type: ignore[attr-defined]
            require(name, one, lists[-1])
        return
    known = [_TYPES[word] for word in words if word in _TYPES]
    if len(known) + len(lists) < len(words) or any(takes(value) for takes, _ in known):
        return
    # A path may be a text, and is still called one.
    besides = {"", "a str"} if "Path" in words else {""}
    expected = [said for _, said in known if said not in besides] + ["a list"] * bool(lists)
    raise ScenecError(f"{name}: {value!r:.60}: expected {' or '.join(expected)}")


def _is_several(value: object) -> bool:
    return isinstance(value, Iterable) and not isinstance(value, str | bytes | os.PathLike)


def _plain(value: Any) -> Any:
    """Returns a scalar of NumPy as Python's, what can be read once as a tuple, else the value."""
    if getattr(value, "shape", None) == ():
        return value.item()
    return tuple(value) if isinstance(value, Iterator) else value


def held_to_types[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Decorates a function so that it holds its arguments to their annotations."""
    signature = inspect.signature(function)

    @wraps(function)
    def call(*args: P.args, **options: P.kwargs) -> R:
        for name, value in signature.bind(*args, **options).arguments.items():
            require(name, _plain(value), str(signature.parameters[name].annotation))
        return function(*args, **options)

    return call


class _Translated:
    """Stands before a listener and hands it lines in the caller's words."""

    def __init__(self, listener: Listener, worded: Callable[[str], str]) -> None:
        self._listener, self._worded = listener, worded

    def __getattr__(self, name: str) -> Any:
        return getattr(self._listener, name)

    def say(self, line: str) -> None:
        self._listener.say(self._worded(line))

    def warn(self, line: str) -> None:
        self._listener.warn(self._worded(line))


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

    def three[A, B, C, R](
        self, function: Callable[[A, B, C, T], R]
    ) -> Callable[Concatenate[A, B, C, P], R]:
        """Decorates a function with three arguments before the record."""
        return self._spread(function)

    def _spread(self, function: Callable[..., Any]) -> Callable[..., Any]:
        record: Callable[..., T] = self._record

        before = list(inspect.signature(function).parameters.values())[:-1]
        after = inspect.signature(record).parameters
        signature = inspect.signature(function).replace(parameters=[*before, *after.values()])

        @wraps(function)
        def call(*args: Any, **options: Any) -> Any:
            named = [p.name for p in before[len(args) :] if p.name in options]
            if len(args) + len(named) != len(before):
                # Python would speak of the record, which nobody gave.
                signature.bind(*args, **options)
            args = (*args, *map(options.pop, named))
            for parameter, value in zip(before, args, strict=True):
                require(parameter.name, value, str(parameter.annotation))
            unknown = [name for name in options if name not in after]
            if unknown:
                # Python would speak of the record, which nobody gave.
                said = nearest(unknown[0], [*(p.name for p in before), *after])
                raise TypeError(f"{function.__name__}() has no argument {unknown[0]!r}{said}")
            made = record(**options)
            if made.listener.flags:
                return function(*args, made)
            if type(made.listener) is not Listener:
                object.__setattr__(made, "listener", _Translated(made.listener, self._named))
            try:
                return function(*args, made)
            except ScenecError as error:
                if error.args:
                    error.args = (self._named(str(error)), *error.args[1:])
                raise

        call.__signature__ = signature  # type: ignore[attr-defined]
        call.__doc__ = re.sub(r"(?m)^( +)options: .*$", self._option_help, function.__doc__ or "")
        return call

    def _named(self, text: str) -> str:
        """Names options as Python does, where a message has their flags."""
        flags = {flag_of(name, f): name for name, f in declared(self._record).items()}  # type: ignore[arg-type]
        return re.sub(r"--[a-z][a-z-]*", lambda found: flags.get(found[0], found[0]), text)

    def _option_help(self, line: re.Match[str]) -> str:
        told = {name: f.metadata["help"] for name, f in declared(self._record).items()}  # type: ignore[arg-type]
        return "\n".join(
            f"{line[1]}{name}: {text.replace('%%', '%')}" for name, text in told.items()
        )
