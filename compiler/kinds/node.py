"""A cfg as its checks read it: as far as the schemas find nothing wrong with it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from scenec.compiler.kinds.finding import Finding, Path
from scenec.compiler.kinds.schema import Field, child, is_of
from scenec.compiler.kinds.support import support
from scenec.schemas.spelling import nearest, shown


class Tree:
    """The places of a document that the schemas know, and which of them are sound.

    Args:
        fields: Every place, see ``schema.walk``.
        findings: What is wrong: a value is sound where nothing is at it or below it.
    """

    def __init__(self, fields: Sequence[Field], findings: Sequence[Finding]):
        self.fields = {field.path: field for field in fields}
        self.faulty = {
            finding.path[:length] for finding in findings for length in range(len(finding.path) + 1)
        }

    def is_sound(self, path: Path) -> bool:
        """Whether the schemas know the place, and find nothing wrong with all that is there."""
        return path in self.fields and path not in self.faulty


class Node:
    """An object or a list of a cfg; empty, and false, where there is none or another type stands.

    What is below may be faulty. ``key in node`` tells whether a key stands in the file at all;
    ``node[key]`` is its value where that is sound, the schema's default where the key is left out,
    and None otherwise.

    Attributes:
        path: Where it stands.
        entries: Values as they stand in the file, sound or not, by key or index.
    """

    def __init__(self, tree: Tree, path: Path = ()):
        self.path = path
        self.entries: dict[Any, Any] = {}
        self._tree = tree
        self._field = tree.fields.get(path)
        self._there = False
        if self._field is not None:
            value, kinds = self._field.value, self._field.keywords.get("type", ())
            if isinstance(value, dict) and "object" in kinds:
                self.entries, self._there = value, True
            elif isinstance(value, list) and "array" in kinds:
                self.entries, self._there = dict(enumerate(value)), True

    def __bool__(self) -> bool:
        return self._there

    def __contains__(self, key: str | int) -> bool:
        return key in self.entries

    def __getitem__(self, key: str | int) -> Any:
        if key in self.entries:
            return self.entries[key] if self._tree.is_sound((*self.path, key)) else None
        if self._field is None or not self._there:
            return None
        return self._field.keywords.get("properties", {}).get(key, {}).get("default")

    def takes(self, key: str) -> bool:
        """Returns whether an object as it is here may have a key."""
        return self._field is not None and key in self._field.keywords.get("properties", {})

    def at(self, *keys: str | int) -> Node:
        """The object or list that stands at a key or, of several keys, below it."""
        return Node(self._tree, (*self.path, *keys))

    def whole(self) -> Node:
        """The cfg that it is a part of."""
        return Node(self._tree)

    def each(self, *pattern: str) -> list[Node]:
        """The objects and lists below at keys, where ``*`` stands for any key or index."""
        found = [self]
        for part in pattern:
            found = [
                below
                for node in found
                for below in map(node.at, node.entries if part == "*" else (part,))
                if below
            ]
        return found

    def span(self, key: str | int) -> tuple[float, float] | None:
        """The least and the largest that a number, or its default, can be; None without one."""
        value = self[key]
        field = None if value is None or self._field is None else child(self._field, key, value)
        is_number = field is not None and (field.is_number or is_of(value, "number"))
        return support(value, field.keywords) if field is not None and is_number else None

    def constant(self, key: str | int) -> float | None:
        """A number that is the same whenever it is drawn; None without one."""
        low, high = self.span(key) or (0.0, 1.0)
        return low if low == high else None

    def fault(self, message: str, *below: str | int) -> Finding:
        """A finding on this value, or on one below it."""
        return Finding((*self.path, *below), message)

    def key_fault(self, message: str, *below: str | int) -> Finding:
        """A finding on the key that stands below."""
        return Finding((*self.path, *below), message, at_key=True)

    def both(self, first: str, second: str, say: str) -> Iterator[Finding]:
        """A finding on the second of two keys, if both are there."""
        if first in self and second in self:
            yield self.key_fault(f"{first} and {second} both say {say}: take one away", second)

    def either(self, first: str, second: str, say: str) -> Iterator[Finding]:
        """A finding unless exactly one of two keys is there."""
        yield from self.both(first, second, say)
        if first not in self and second not in self:
            yield self.fault(f"expected either the key {first} or the key {second}")


def unknown(what: str, name: str, valid: Iterable[str], where: str = "") -> str:
    """Returns the message about a name that refers to nothing."""
    return f"no {what} {shown(name)}{where}{nearest(name, valid)}"


def is_black(node: Node, key: str = "color") -> bool:
    """Whether a color is there, three sound numbers, that can be black."""
    spans = list(map(node.at(key).span, node.at(key).entries))
    return len(spans) == 3 and all(span and span[0] <= 0.0 for span in spans)


def black(scaled_to: str) -> str:
    """Returns the message about a color that can be black."""
    return f"black cannot be scaled to {scaled_to}: expected a component that is always above 0"


def off_terrain(cfg: Node, place: Node) -> Iterator[tuple[str, str]]:
    """Yields each of a place's keys x_m and y_m that can be off the terrain, and how."""
    for axis, key in enumerate(("x_m", "y_m")):
        size, span = cfg.at("terrain", "size_m").span(axis), place.span(key)
        if size and span and (span[0] < -0.5 * size[0] or span[1] > 0.5 * size[0]):
            half = 0.5 * size[0]
            yield (
                key,
                f"reaches from {span[0]:g} m to {span[1]:g} m, but the terrain from {-half:g} m "
                f"to {half:g} m",
            )
