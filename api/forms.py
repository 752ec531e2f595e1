"""Parses values of options, and lists the permitted ones.

Each form reads a text as the command line has it. A value that is given in Python is held to the
same form, so that both refuse the same with the same words.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from scenec.schemas.errors import ScenecError
from scenec.schemas.passes import is_pass, pass_names
from scenec.schemas.spelling import nearest, shown

#: Seconds, meters, megabytes, shares: far beyond what there is, and short of what overflows.
_MOST = 1e12
#: More are asked for by a slip, and are listed somewhere.
_LONGEST_SPAN = 1_000_000


def whole(low: int, high: float, expected: str) -> Callable[[str], int]:
    """Returns a parser of whole numbers between two bounds."""

    def read(text: str) -> int:
        try:
            value = int(text, 10)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise ScenecError(f"{text!r}: expected {expected}")
        return value

    return read


seed = whole(0, 2**64 - 1, "a whole number from 0 to 2^64 - 1")
#: Far beyond what converges, and short of what overflows.
positive = whole(1, 2**20, f"a whole number from 1 to {2**20}")
#: A batch, a sample, an attempt: as many as a stage can number.
counted = whole(0, 2**31 - 1, f"a whole number from 0 to {2**31 - 1}")
workers = whole(0, 1024, "a whole number from 0 to 1024")
#: That scenec chooses.
AUTO = "auto"


def workers_or_auto(text: str) -> int | str:
    """Reads a number of workers, or that they are chosen."""
    if text == AUTO:
        return text
    return whole(0, 1024, "a whole number from 0 to 1024, or auto")(text)


port = whole(0, 65535, "a port from 1 to 65535, or 0 for a free one")


def span(text: str) -> range:
    """``A:B`` as the range A to B - 1; ``A`` alone is A:A+1."""
    first, colon, last = text.partition(":")
    try:
        start = int(first, 10)
        stop = int(last, 10) if colon else start + 1
    except ValueError:
        start, stop = 0, -1
    if start < 0 or stop <= start:
        raise ScenecError(
            f"{text!r}: expected A:B with 0 <= A < B (it holds A to B-1), or one number"
        )
    if stop > 2**64 or stop - start > _LONGEST_SPAN:
        raise ScenecError(
            f"{text!r}: expected numbers below 2^64, {_LONGEST_SPAN:,} of them at most"
        )
    return range(start, stop)


def amount(text: str) -> float:
    """Parses a number above 0, at most 1e12."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= _MOST:
        most = f", at most {_MOST:g}" if value > _MOST else ""
        raise ScenecError(f"{text!r}: expected a number above 0{most}")
    return value


def number(text: str) -> float:
    """Parses a number."""
    try:
        return float(text)
    except ValueError:
        raise ScenecError(f"{text!r}: expected a number") from None


def ascending[T: (int, float)](one: Callable[[str], T]) -> Callable[[str], tuple[T, ...]]:
    """Returns a parser of several, such as ``4,16,64``: ascending, each once."""

    def read(text: str) -> tuple[T, ...]:
        return tuple(sorted({one(part) for part in names(text) or [""]}))

    return read


def some_of(known: Sequence[str]) -> Callable[[str], tuple[str, ...]]:
    """Returns a parser of some of these names."""

    def read(text: str) -> tuple[str, ...]:
        for name in names(text):
            if name not in known:
                raise ScenecError(f"{name!r}: expected some of {','.join(known)}")
        return tuple(names(text))

    return read


def passes(text: str) -> tuple[str, ...]:
    """A list such as ``rgb,depth``."""
    chosen = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    for name in chosen:
        if not (is_pass(name) or _is_level(name)):
            raise ScenecError(f"no pass {shown(name)}{nearest(name, pass_names())}")
    if not chosen:
        raise ScenecError(
            f"{text!r}: expected some of {','.join(pass_names())}, separated by commas "
            "(label.NAME is one level of labels)"
        )
    return chosen


def _is_level(name: str) -> bool:
    return name.startswith("label.") and name.removeprefix("label.").isidentifier()


def names(text: str) -> list[str]:
    """A list such as ``lander,logs``, each once."""
    return list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def listed(text: str) -> list[str]:
    """A list such as ``mitsuba,cycles``, as it stands."""
    return [name for name in text.split(",") if name]


def positions(text: str) -> list[str]:
    """Splits a list by position, as ``sky,ground,,rock``: repeated and empty names stay."""
    return [name.strip() for name in text.split(",")]
