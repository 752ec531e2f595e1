"""What all parts of an OAISYS cfg share while it is translated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Any

from scenec.importers.assets import Assets
from scenec.importers.output import Imported
from scenec.importers.scene import identifier, unused
from scenec.importers.source import Item, Source


class Labels:
    """Label levels, from vectors with one id a level, and names from what has the ids."""

    def __init__(self, levels: int):
        """Begins with no label.

        Args:
            levels: How many levels there are: later entries of vectors are rendered by nobody.
        """
        self._names: list[dict[int, list[str]]] = [{} for _ in range(levels)]
        self._choices: list[tuple[dict[str, str], list[int]]] = []
        self._values: list[tuple[dict[str, str | None], int, dict[str, int]]] = []

    def choice(self, ids: Sequence[float], name: str) -> dict[str, str]:
        """A choice of labels, to be filled in by ``finish``; 0 and below are no label."""
        choice: dict[str, str] = {}
        kept = [int(value) for value in ids[: len(self._names)]]
        for level, number in enumerate(kept):
            self._use(level, number, name)
        self._choices.append((choice, kept))
        return choice

    def values(self, level: int, ids: dict[str, int], name: str) -> dict[str, str | None]:
        """Labels of the pixel values of a label map, to be filled in by ``finish``."""
        values: dict[str, str | None] = dict.fromkeys(ids)
        for value, number in ids.items():
            self._use(level, number, f"{name}_{value.strip('#')}")
        self._values.append((values, level, ids))
        return values

    @property
    def levels(self) -> int:
        """How many there are."""
        return len(self._names)

    def _use(self, level: int, number: int, name: str) -> None:
        if number > 0:
            self._names[level].setdefault(number, []).append(name)

    def finish(self) -> dict[str, dict[str, int]]:
        """The levels of the cfg; every choice is filled in."""
        named = [_named(names) for names in self._names]
        for choice, ids in self._choices:
            for level, number in enumerate(ids):
                if number > 0:
                    choice[_level(level)] = named[level][number]
        for values, level, ids_of in self._values:
            for value, number in ids_of.items():
                values[value] = named[level].get(number)
        return {
            _level(level): {name: number for number, name in sorted(names.items())}
            for level, names in enumerate(named)
            if names
        }


def _level(index: int) -> str:
    return f"level_{index}"


def _named(names: dict[int, list[str]]) -> dict[int, str]:
    """A name for each id: what the things that have it are called, as far as they agree."""
    found: dict[int, str] = {}
    for number, of in sorted(names.items()):
        shared = _beginning(of).rstrip("_0123456789") if len(set(of)) > 1 else of[0]
        name = identifier(shared) if len(shared) >= 3 else f"id_{number}"
        found[number] = name if name not in found.values() else f"{name}_{number}"
    return found


def _beginning(names: Sequence[str]) -> str:
    """What all of some names begin with."""
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
        samples: Samples of a batch.
        extent_m: Size of the terrain in x and y, once the stage is known.
        sources: Files that were read.
    """

    imported: Imported
    assets: Assets
    current: bool
    labels: Labels
    samples: int = 1
    extent_m: tuple[float, float] = (100.0, 100.0)
    sources: list[Source] = field(default_factory=list)

    @property
    def cfg(self) -> dict[str, Any]:
        """The cfg."""
        return self.imported.cfg

    def unused(self, where: str, text: str) -> str:
        """An identifier that no entry of a part of the cfg has."""
        return unused(text, self.cfg[where])


def label_vector(ctx: Context, item: Item, name: str, to: str) -> dict[str, str]:
    """The labels of ``[L0, L1, …]``."""
    ids = item.numbers()
    over = len(ids) - ctx.labels.levels
    notes = []
    if over > 0 and ctx.labels.levels:
        notes.append(f"levels from {ctx.labels.levels} on are not rendered there (numIter)")
    if not ctx.labels.levels:
        item.dropped("no level of labels is rendered there (numIter of SemanticPass)")
    elif any(number <= 0 for number in ids[: ctx.labels.levels]):
        item.approximated(to, "; ".join(["ids of 0 and below are no label here", *notes]))
    else:
        item.translated(to, "; ".join(notes))
    return ctx.labels.choice(ids, name)
