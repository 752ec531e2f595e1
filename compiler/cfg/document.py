"""Represents a cfg as it was read, in any syntax: values and their positions."""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from dataclasses import dataclass
from typing import Any

from scenec.compiler.kinds.finding import Path, Position

#: Deeper nesting than this is refused; a cfg needs about eight levels.
MAX_DEPTH = 64
# Longer runs of digits overflow a double; int() of them would cost quadratic time or raise.
_MAX_INT_DIGITS = 310


@dataclass(frozen=True)
class Document:
    """A value and its places.

    Attributes:
        value: The root value, in Python's types.
        values: Where each value starts, by its path; ``()`` is the root.
        keys: Where each key of an object stands, by the path of its value.
        duplicates: Path and position of each key that its object had already.
    """

    value: Any
    values: dict[Path, Position]
    keys: dict[Path, Position]
    duplicates: tuple[tuple[Path, Position], ...] = ()


class CfgSyntaxError(Exception):
    """A text that cannot be read: message and position of the first fault."""

    def __init__(self, message: str, position: Position):
        super().__init__(message)
        self.message = message
        self.position = position


class Text:
    """A text in UTF-8 (a byte order mark is skipped), and the lines of its characters.

    Attributes:
        text: Its characters.
        file: Its name, for positions.

    Raises:
        CfgSyntaxError: It is not UTF-8.
    """

    def __init__(self, data: bytes, file: str) -> None:
        self.file = file
        try:
            self._take(data.decode("utf-8-sig"))
        except UnicodeDecodeError as error:
            self._take(data[: error.start].decode("utf-8-sig", errors="replace"))
            raise CfgSyntaxError(
                f"byte 0x{data[error.start]:02x} is not UTF-8: save the file as UTF-8",
                self.position(len(self.text)),
            ) from error

    def _take(self, text: str) -> None:
        self.text = text
        self._line_starts = [0, *(match.end() for match in re.finditer("\n", text))]

    def position(self, offset: int) -> Position:
        """Returns the line and column of a character."""
        line = bisect_right(self._line_starts, offset)
        return Position(line, offset - self._line_starts[line - 1] + 1, self.file)


def as_number(token: str, integer: bool) -> int | float | None:
    """The number that decimal digits stand for; None where it is too large for a double."""
    if integer and len(token) < _MAX_INT_DIGITS:
        value = int(token)
        return None if abs(value) >= 2**1023 else value
    number = float(token)
    return None if math.isinf(number) else number


def has_half_pair(text: str) -> bool:
    """Whether half a surrogate pair, which no file can hold, is in a string."""
    return any("\ud800" <= character <= "\udfff" for character in text)
