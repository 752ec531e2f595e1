"""JSON (RFC 8259) with comments and trailing commas, and the place of every value and key.

The standard library's parser accepts NaN and duplicate keys, no comments, and forgets where things
stood; the faults of a cfg need both.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from typing import Any

from scenec.compiler.cfg.document import (
    MAX_DEPTH,
    CfgSyntaxError,
    Document,
    Text,
    as_number,
    has_half_pair,
)
from scenec.compiler.kinds.finding import Path, Position

_SPACE = re.compile(r"(?:[ \t\n\r]+|//[^\n]*|/\*.*?\*/)*", re.DOTALL)
_STRING = re.compile(r'"(?:[^"\\\x00-\x1f]|\\(?:["\\/bfnrt]|u[0-9a-fA-F]{4}))*"')
_NUMBER = re.compile(r"-?(?:0|[1-9][0-9]*)(\.[0-9]+)?([eE][+-]?[0-9]+)?")
_WORD = re.compile(r"[A-Za-z_][A-Za-z_0-9]*")
_LITERALS = {"true": True, "false": False, "null": None}


def parse(data: bytes, file: str = "") -> Document:
    """Parses a JSON text in UTF-8 (a byte order mark is skipped).

    Args:
        data: The text.
        file: Its name, for positions.

    Raises:
        CfgSyntaxError: It is not UTF-8, not JSON, nested deeper than ``MAX_DEPTH``, or holds a
            number that is too large for a double or a string with half a surrogate pair.
    """
    source = Text(data, file)
    return _JsonParser(source, source.text).document()


@dataclass
class _JsonParser:
    source: Text
    text: str
    offset: int = 0
    values: dict[Path, Position] = field(default_factory=dict)
    keys: dict[Path, Position] = field(default_factory=dict)
    duplicates: list[tuple[Path, Position]] = field(default_factory=list)

    def document(self) -> Document:
        self._skip_space()
        value = self._value((), 0)
        self._skip_space()
        if self.offset < len(self.text):
            raise self._error(f"{self._next_text()} after the end of the document")
        return Document(value, self.values, self.keys, tuple(self.duplicates))

    def _position(self) -> Position:
        return self.source.position(self.offset)

    def _error(self, message: str, offset: int | None = None) -> CfgSyntaxError:
        at = self.offset if offset is None else offset
        return CfgSyntaxError(message, self.source.position(at))

    def _next_text(self) -> str:
        if self.offset >= len(self.text):
            return "the end of the file"
        word = _WORD.match(self.text, self.offset)
        return repr(word.group()[:40] if word else self.text[self.offset])

    def _skip_space(self) -> None:
        match = _SPACE.match(self.text, self.offset)
        assert match is not None
        self.offset = match.end()
        if self.text.startswith("/*", self.offset):
            raise self._error("a comment that is not closed")

    def _take(self, character: str) -> bool:
        if self.text.startswith(character, self.offset):
            self.offset += 1
            return True
        return False

    def _value(self, path: Path, depth: int) -> Any:
        if depth > MAX_DEPTH:
            raise self._error(f"nested deeper than {MAX_DEPTH} levels")
        self.values[path] = self._position()
        if self._take("{"):
            return self._object(path, depth)
        if self._take("["):
            return self._array(path, depth)
        if self.text.startswith('"', self.offset):
            return self._string()
        number = _NUMBER.match(self.text, self.offset)
        if number:
            return self._number(number)
        word = _WORD.match(self.text, self.offset)
        if word and word.group() in _LITERALS:
            self.offset = word.end()
            return _LITERALS[word.group()]
        if word and word.group().lower() in ("nan", "infinity"):
            raise self._error(f"{word.group()} is not a JSON number")
        if word and word.group().lower() in _LITERALS:
            raise self._error(f"{word.group()!r}: write it as {word.group().lower()!r}")
        raise self._error(f"expected a value, found {self._next_text()}")

    def _object(self, path: Path, depth: int) -> dict[str, Any]:
        result: dict[str, Any] = {}
        self._skip_space()
        if self._take("}"):
            return result
        while True:
            if not self.text.startswith('"', self.offset):
                raise self._error(f"expected a key in double quotes, found {self._next_text()}")
            position = self._position()
            key = self._string()
            self._skip_space()
            if not self._take(":"):
                raise self._error(f"expected ':' after the key {key!r}, found {self._next_text()}")
            self._skip_space()
            at = (*path, key)
            if key in result:
                # The first one stays: its positions are those that later faults should name.
                self.duplicates.append((at, position))
                self._discard(depth)
            else:
                self.keys[at] = position
                result[key] = self._value(at, depth + 1)
            if not self._another("}", "the object"):
                return result

    def _discard(self, depth: int) -> None:
        values, keys, duplicates = self.values, self.keys, self.duplicates
        self.values, self.keys, self.duplicates = {}, {}, []
        self._value((), depth + 1)
        self.values, self.keys, self.duplicates = values, keys, duplicates

    def _array(self, path: Path, depth: int) -> list[Any]:
        result: list[Any] = []
        self._skip_space()
        if self._take("]"):
            return result
        while True:
            result.append(self._value((*path, len(result)), depth + 1))
            if not self._another("]", "the list"):
                return result

    def _another(self, closer: str, what: str) -> bool:
        self._skip_space()
        if self._take(closer):
            return False
        if not self._take(","):
            raise self._error(f"expected ',' or '{closer}' in {what}, found {self._next_text()}")
        self._skip_space()
        return not self._take(closer)

    def _string(self) -> str:
        match = _STRING.match(self.text, self.offset)
        if not match:
            raise self._bad_string()
        value = str(json.loads(match.group()))
        if has_half_pair(value):
            raise self._error("a string with half a surrogate pair")
        self.offset = match.end()
        return value

    def _bad_string(self) -> CfgSyntaxError:
        at = self.offset + 1
        while at < len(self.text) and self.text[at] != '"':
            if self.text[at] < " ":
                what = "a line break" if self.text[at] in "\r\n" else "a control character"
                return self._error(f"{what} in a string: close it, or write the character as an "
                                   "escape", at)  # fmt: skip
            if self.text[at] == "\\":
                if not _STRING.match(f'"{self._escape(at)}"'):
                    return self._error(
                        f"unknown escape {self._escape(at)!r} in a string; a backslash is '\\\\'",
                        at,
                    )
                at += len(self._escape(at)) - 1
            at += 1
        return self._error("a string that is not closed")

    def _escape(self, at: int) -> str:
        return self.text[at : at + (6 if self.text.startswith("u", at + 1) else 2)]

    def _number(self, match: re.Match[str]) -> int | float:
        token = match.group()
        following = self.text[match.end() : match.end() + 1]
        if following and (following.isalnum() or following in "._+-"):
            raise self._error(f"{(token + following)!r} does not begin a JSON number")
        value = as_number(token, integer=match.group(1) is None and match.group(2) is None)
        if value is None:
            raise self._error(f"the number {token[:24]} is too large")
        self.offset = match.end()
        return value
