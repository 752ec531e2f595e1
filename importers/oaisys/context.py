"""Holds the state that all parts of an OAISYS cfg share while it is translated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Any

from scenec.importers.assets import Assets
from scenec.importers.output import Imported
from scenec.importers.scene import identifier, unused
from scenec.importers.source import Item, Source
from scenec.schemas.codec import JsonObject

#: Why a key is dropped that OAISYS itself has no use for.
DEAD = "OAISYS reads it nowhere"


class Labels:
    """Label levels, from vectors with one id a level, and names from what has the ids.

    Attributes:
        levels: How many there are: later entries of vectors are rendered by nobody.
    """

    def __init__(self, levels: int):
        self.levels = levels
        self._names: list[dict[int, list[str]]] = [{} for _ in range(levels)]
        #: Where a name goes once it is known: an object, its key, and whose name.
        self._places: list[tuple[dict[str, Any], str, int, int]] = []

    def choice(self, ids: Sequence[float], name: str) -> dict[str, str]:
        """A choice of labels, to be filled in by ``finish``; 0 and below are no label."""
        choice: dict[str, str] = {}
        for level, number in enumerate(ids[: self.levels]):
            self._use(level, int(number), name, choice, f"level_{level}")
        return choice

    def values(self, level: int, ids: dict[str, int], name: str) -> dict[str, str | None]:
        """Labels of the pixel values of a label map, to be filled in by ``finish``."""
        values: dict[str, str | None] = dict.fromkeys(ids)
        for value, number in ids.items():
            self._use(level, number, f"{name}_{value.strip('#')}", values, value)
        return values

    def _use(self, level: int, number: int, name: str, to: dict[str, Any], key: str) -> None:
        if number > 0:
            self._names[level].setdefault(number, []).append(name)
            self._places.append((to, key, level, number))

    def finish(self) -> dict[str, dict[str, int]]:
        """The levels of the cfg; every choice is filled in."""
        named = [_named(names) for names in self._names]
        for to, key, level, number in self._places:
            to[key] = named[level][number]
        return {
            f"level_{level}": {name: number for number, name in sorted(names.items())}
            for level, names in enumerate(named)
            if names
        }


def _named(names: dict[int, list[str]]) -> dict[int, str]:
    """A name for each id: what the things that have it are called, as far as they agree."""
    names_of: dict[int, str] = {}
    for number, of in sorted(names.items()):
        shared = _beginning(of).rstrip("_0123456789") if len(set(of)) > 1 else of[0]
        name = identifier(shared) if len(shared) >= 3 else f"id_{number}"
        names_of[number] = name if name not in names_of.values() else f"{name}_{number}"
    return names_of


def _beginning(names: Sequence[str]) -> str:
    """Returns the common prefix of some names."""
    columns = zip(*names, strict=False)
    return "".join(column[0] for column in takewhile(lambda c: len(set(c)) == 1, columns))


@dataclass
class Context:
    """A translation under way.

    Attributes:
        imported: The cfg and its report.
        assets: The files that it needs.
        current: Whether the cfg is of today's generation, not that of 2021.
        labels: Its label levels.
        extent_m: Size of the terrain in x and y, once the stage is known.
        sources: Files that were read.
    """

    imported: Imported
    assets: Assets
    current: bool
    labels: Labels
    extent_m: tuple[float, float] = (100.0, 100.0)
    sources: list[Source] = field(default_factory=list)

    @property
    def cfg(self) -> JsonObject:
        """The cfg."""
        return self.imported.cfg

    def unused(self, where: str, text: str) -> str:
        """An identifier that no entry of a part of the cfg has."""
        return unused(text, self.cfg[where])


def label_vector(ctx: Context, item: Item, name: str, to: str) -> dict[str, str]:
    """The labels of ``[L0, L1, …]``."""
    ids, levels = item.numbers(), ctx.labels.levels
    none = "ids of 0 and below are no label here" if min(ids[:levels], default=1) <= 0 else ""
    over = f"levels from {levels} on are not rendered there (numIter)" if len(ids) > levels else ""
    if not levels:
        item.dropped("no level of labels is rendered there (numIter of SemanticPass)")
    elif none:
        item.approximated(to, f"{none}; {over}" if over else none)
    else:
        item.translated(to, over)
    return ctx.labels.choice(ids, name)
