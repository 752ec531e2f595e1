"""YAML 1.2 with the place of every value and key.

Scalars mean what the core schema of YAML 1.2.2 (section 10.3) says: ``no`` and ``2026-01-01`` are
strings. Keys are strings as they are written. Aliases and merge keys (``<<``) stand for what they
name; tags, and what JSON cannot say (``.nan``), are refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionStartEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
    StreamEndEvent,
)

from scenec.compiler.cfg.document import (
    MAX_DEPTH,
    CfgSyntaxError,
    Document,
    Text,
    as_number,
    has_half_pair,
)
from scenec.compiler.kinds.finding import Path, Position

#: Values that aliases may stand for in all: a page of them, and no bomb.
_MOST_COPIES = 100_000
_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_INT = re.compile(r"[-+]?[0-9]+")
_BASES = {8: re.compile(r"0o[0-7]{1,99}"), 16: re.compile(r"0x[0-9a-fA-F]{1,99}")}
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NO_NUMBER = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_MERGE = "<<"


@dataclass
class _Node:
    """A value, what stands below it, and how many values that is."""

    position: Position
    content: Any
    size: int = 1
    duplicates: list[tuple[str, Position]] = field(default_factory=list)


def parse(data: bytes, file: str = "") -> Document:
    """Parses a YAML text in UTF-8 (a byte order mark is skipped).

    Args:
        data: The text.
        file: Its name, for positions.

    Raises:
        CfgSyntaxError: It is not UTF-8, not one document of YAML, nested deeper than
            ``MAX_DEPTH``, or holds what no cfg can: tags, keys that are no words, numbers that are
            none.
    """
    text = Text(data, file)
    try:
        return _YamlParser(text).document()
    except YAMLError as error:
        raise _fault(error, text) from error


def _fault(error: YAMLError, text: Text) -> CfgSyntaxError:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    message = getattr(error, "problem", None) or getattr(error, "reason", None) or "is not YAML"
    if mark is not None:
        position = Position(mark.line + 1, mark.column + 1, text.file)
        return CfgSyntaxError(f"not YAML: {message}", position)
    return CfgSyntaxError(f"not YAML: {message}", text.position(getattr(error, "position", 0)))


class _YamlParser:
    def __init__(self, text: Text) -> None:
        self._file = text.file
        self._events: Iterator[Event] = YAML(typ="safe", pure=True).parse(text.text)
        self._anchors: dict[str, _Node] = {}
        self._copies = 0

    def document(self) -> Document:
        next(self._events)
        event = next(self._events)
        if not isinstance(event, DocumentStartEvent):
            raise self._error("expected a value, found the end of the file", event)
        root = self._node(next(self._events), 0)
        # The end of the document, and what follows it.
        next(self._events)
        event = next(self._events)
        if not isinstance(event, StreamEndEvent):
            raise self._error("a second document: expected one", event)
        flat = Document(None, {}, {})
        duplicates: list[tuple[Path, Position]] = []
        value = _flatten(root, (), flat, duplicates)
        return Document(value, flat.values, flat.keys, tuple(duplicates))

    def _position(self, event: Event) -> Position:
        return Position(event.start_mark.line + 1, event.start_mark.column + 1, self._file)

    def _error(self, message: str, event: Event) -> CfgSyntaxError:
        return CfgSyntaxError(message, self._position(event))

    def _node(self, event: Event, depth: int) -> _Node:
        if depth > MAX_DEPTH:
            raise self._error(f"nested deeper than {MAX_DEPTH} levels", event)
        if isinstance(event, AliasEvent):
            return self._alias(event, depth)
        assert isinstance(event, (ScalarEvent, CollectionStartEvent))
        if event.tag is not None:
            raise self._error(f"the tag {event.tag}: a cfg takes none", event)
        node = _Node(self._position(event), None)
        if isinstance(event, ScalarEvent):
            node.content = self._scalar(event)
        elif isinstance(event, SequenceStartEvent):
            self._sequence(node, depth)
        else:
            assert isinstance(event, MappingStartEvent)
            self._mapping(node, depth)
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _alias(self, event: AliasEvent, depth: int) -> _Node:
        node = self._anchors.get(event.anchor)
        if node is None:
            raise self._error(f"the alias *{event.anchor} names nothing before it", event)
        self._copies += node.size
        if self._copies > _MOST_COPIES:
            raise self._error(f"aliases stand for more than {_MOST_COPIES} values", event)
        if depth + _depth(node) > MAX_DEPTH:
            raise self._error(f"nested deeper than {MAX_DEPTH} levels", event)
        return node

    def _sequence(self, node: _Node, depth: int) -> None:
        node.content = []
        while not isinstance(event := next(self._events), SequenceEndEvent):
            below = self._node(event, depth + 1)
            node.content.append(below)
            node.size += below.size

    def _mapping(self, node: _Node, depth: int) -> None:
        entries: dict[str, tuple[Position, _Node]] = {}
        merged: dict[str, tuple[Position, _Node]] = {}
        while not isinstance(event := next(self._events), MappingEndEvent):
            if not isinstance(event, ScalarEvent) or event.tag is not None:
                raise self._error("expected a key that is a word", event)
            key, position = self._string(event), self._position(event)
            value = next(self._events)
            below = self._node(value, depth + 1)
            if key == _MERGE and event.style is None:
                for source in below.content if isinstance(below.content, list) else [below]:
                    if not isinstance(source.content, dict):
                        raise self._error("<< takes a mapping, or a list of some", value)
                    for name, entry in source.content.items():
                        merged.setdefault(name, entry)
            elif key in entries:
                node.duplicates.append((key, position))
            else:
                entries[key] = (position, below)
        node.content = {**merged, **entries}
        node.size += sum(below.size for _, below in node.content.values())

    def _string(self, event: ScalarEvent) -> str:
        if has_half_pair(event.value):
            raise self._error("a string with half a surrogate pair", event)
        return str(event.value)

    def _scalar(self, event: ScalarEvent) -> Any:
        text = self._string(event)
        if event.style is not None:
            return text
        if text in _WORDS:
            return _WORDS[text]
        if _NO_NUMBER.fullmatch(text):
            raise self._error(f"{text} is no number that a cfg takes", event)
        for base, digits in _BASES.items():
            if digits.fullmatch(text):
                return int(text, base)
        if _FLOAT.fullmatch(text) is None:
            return text
        number = as_number(text, integer=_INT.fullmatch(text) is not None)
        if number is None:
            raise self._error(f"the number {text[:24]} is too large", event)
        return number


def _depth(node: _Node) -> int:
    below = node.content
    if isinstance(below, dict):
        below = [entry for _, entry in below.values()]
    return 1 + max(map(_depth, below)) if isinstance(below, list) and below else 0


def _flatten(
    node: _Node, path: Path, into: Document, duplicates: list[tuple[Path, Position]]
) -> Any:
    into.values[path] = node.position
    duplicates += [((*path, key), position) for key, position in node.duplicates]
    if isinstance(node.content, list):
        return [
            _flatten(below, (*path, i), into, duplicates) for i, below in enumerate(node.content)
        ]
    if not isinstance(node.content, dict):
        return node.content
    value = {}
    for key, (position, below) in node.content.items():
        into.keys[(*path, key)] = position
        value[key] = _flatten(below, (*path, key), into, duplicates)
    return value
