"""Other label names and ids than the cfg's: merged classes, classes left out, a benchmark's ids.

A file says, per level, what a label becomes::

    { "surface": { "gravel": "soil", "sand": "soil", "sky": null,
                   "mud": { "name": "wet", "id": 9 } } }

A name that is not there stays as it is; ``null`` is "no label" (0). Labels of one new name are one.
Its id is the one that is given, else that of the label which has this name already, else the lowest
of those that became it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.source import LoadedFrame
from scenec.schemas.codec import Facts
from scenec.schemas.errors import OutputError
from scenec.schemas.spelling import nearest

Names = dict[int, str]


@dataclass(frozen=True)
class Remap:
    """Renames and renumbers labels.

    Attributes:
        changes: Level -> name -> (new name or None, new id or None).
    """

    changes: Mapping[str, Mapping[str, tuple[str | None, int | None]]] = field(default_factory=dict)

    def labels(self, old: dict[str, Names]) -> dict[str, Names]:
        """The new names of all levels, in order of ids, without 0."""
        new: dict[str, Names] = {}
        for level, names in old.items():
            table = self._numbers(level, names)
            found = {table[number][0]: table[number][1] for number in names if table[number][0]}
            new[level] = dict(sorted(found.items()))
        return new

    def number(self, level: str, number: int, old: dict[str, Names]) -> int:
        """The new id of a label; 0 where it is left out."""
        return self._numbers(level, old.get(level, {})).get(number, (0, ""))[0]

    def check(self, old: dict[str, Names]) -> None:
        """Refuse levels and names that are not there.

        Raises:
            OutputError: One is not, or two new names share an id.
        """
        for level, changes in self.changes.items():
            if level not in old:
                raise OutputError(f"remapping: no level {level!r}{nearest(level, old)}")
            for name in changes:
                if name not in old[level].values():
                    raise OutputError(
                        f"remapping: level {level!r} has no label {name!r}"
                        f"{nearest(name, old[level].values())}"
                    )
            owners: dict[int, str] = {}
            for number, name in self._numbers(level, old[level]).values():
                if number and owners.setdefault(number, name) != name:
                    raise OutputError(
                        f"remapping: level {level!r} would have id {number} for both "
                        f"{owners[number]!r} and {name!r}"
                    )

    def apply(self, frame: LoadedFrame) -> None:
        """Remap a frame, in place: its passes, its table, its names."""
        for level in self.changes:
            if level not in frame.labels:
                continue
            table = self._numbers(level, frame.labels[level])
            pass_name = f"label.{level}"
            if pass_name in frame.passes:
                numbers = {old: new for old, (new, _) in table.items()}
                frame.passes[pass_name] = replaced(frame.passes[pass_name], numbers)
            if pass_name in frame.table:
                texts = {frame.labels[level][old]: name for old, (_, name) in table.items()}
                column = frame.table[pass_name]
                frame.table[pass_name] = np.array(
                    [texts.get(text, text) for text in column.tolist()], np.str_
                )
        frame.labels = self.labels(frame.labels)

    def as_json(self) -> dict[str, Facts]:
        """Returns the JSON form, as written in a file."""
        return {
            level: {
                name: new if number is None else {"name": new, "id": number}
                for name, (new, number) in changes.items()
            }
            for level, changes in self.changes.items()
        }

    def _numbers(self, level: str, names: Names) -> dict[int, tuple[int, str]]:
        """Old id -> (new id, new name); (0, "") where it is left out."""
        changes = self.changes.get(level, {})
        became = {number: changes.get(name, (name, None)) for number, name in names.items()}
        by_name = {name: number for number, name in names.items()}
        chosen: dict[str, int] = {}
        for number, (name, given) in sorted(became.items()):
            if name is not None:
                if given is not None:
                    chosen[name] = given
                elif name not in chosen:
                    chosen[name] = by_name.get(name, number)
        return {
            number: (0, "") if name is None else (chosen[name], name)
            for number, (name, _) in became.items()
        }


def replaced(ids: NDArray[np.unsignedinteger], numbers: Mapping[int, int]) -> NDArray[np.uint32]:
    """A picture of ids with other ids in their place; those that are not named stay."""
    if not numbers:
        return ids.astype(np.uint32)
    old = np.array(sorted(numbers), np.int64)
    new = np.array([numbers[number] for number in old.tolist()], np.uint32)
    if int(old[-1]) < 1 << 16:
        table = np.arange(1 << 16, dtype=np.uint32)
        table[old] = new
        small = ids < len(table)
        return np.where(small, table[np.where(small, ids, 0)], ids).astype(np.uint32)
    at = np.minimum(np.searchsorted(old, ids), len(old) - 1)
    return np.where(old[at] == ids, new[at], ids).astype(np.uint32)


def read_remap(path: Path | str) -> Remap:
    """Read a file of changes.

    Raises:
        OutputError: It cannot be read, or is none.
    """
    try:
        value = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise OutputError(f"{path}: is no JSON: {error}") from error
    return parse_remap(value, str(path))


def parse_remap(value: Any, where: str = "remapping") -> Remap:
    """Changes from JSON values.

    Raises:
        OutputError: They are none; names the place.
    """
    if not isinstance(value, dict):
        raise OutputError(f"{where}: expected an object of levels")
    changes: dict[str, dict[str, tuple[str | None, int | None]]] = {}
    for level, table in value.items():
        if not isinstance(table, dict):
            raise OutputError(f"{where}: /{level}: expected an object: old name to new name")
        changes[level] = {
            name: _change(new, f"{where}: /{level}/{name}") for name, new in table.items()
        }
    return Remap(changes)


def _change(value: Any, where: str) -> tuple[str | None, int | None]:
    if value is None:
        return None, None
    if isinstance(value, str) and value:
        return value, None
    if (
        isinstance(value, dict)
        and set(value) <= {"name", "id"}
        and isinstance(value.get("name"), str)
    ):
        number = value.get("id")
        if number is None or (type(number) is int and 0 < number < 2**32):
            return value["name"], number
    raise OutputError(
        f"{where}: expected a new name, null, or {{'name': …, 'id': 1 to 4294967295}}; "
        f"not {json.dumps(value)[:60]}"
    )
