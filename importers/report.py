"""Reports the fate of each value of an imported file."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

from scenec.schemas.codec import JsonObject
from scenec.schemas.spelling import shown

#: Carried over as it was meant.
TRANSLATED = "translated"
#: Carried over, and the note says what differs.
APPROXIMATED = "approximated"
#: Not carried over, and the note says why.
DROPPED = "dropped"
#: In no imported file: what the cfg needs besides.
ADDED = "added"
FATES = (TRANSLATED, APPROXIMATED, DROPPED, ADDED)


@dataclass(frozen=True)
class Entry:
    """Records the fate of one value.

    Attributes:
        fate: One of ``FATES``.
        file: The file it stands in; "" for what is added.
        line: Its line, from 1; 0 where the file has no lines.
        pointer: JSON pointer, path of a prim, or name of a data set.
        value: The value, shortened.
        to: Where it went: a place of the cfg, or an option of the command line.
        note: What differs, or why it was dropped.
    """

    fate: str
    file: str
    line: int
    pointer: str
    value: str
    to: str = ""
    note: str = ""


@dataclass
class Report:
    """Entries in the order of the files.

    Attributes:
        entries: All of them.
    """

    entries: list[Entry] = field(default_factory=list)

    def add(self, fate: str, at: str, value: Any = None, to: str = "", note: str = "") -> None:
        """Reports on something that stands in no line of a text.

        Args:
            fate: One of ``FATES``.
            at: Its name: path of a prim or name of a data set.
            value: Its value; None: nothing to show.
            to: As of ``Entry``.
            note: As of ``Entry``.
        """
        text = "" if value is None else shown(value)
        self.entries.append(Entry(fate, "", 0, at, text, to, note))

    def added(self, to: str, note: str) -> None:
        """Reports on something that the cfg needs besides."""
        self.add(ADDED, "", None, to, note)

    def counts(self) -> dict[str, int]:
        """Counts the values of each fate."""
        found = Counter(entry.fate for entry in self.entries)
        return {fate: found[fate] for fate in FATES}

    def as_json(self) -> JsonObject:
        """For ``write_json``."""
        return {"counts": self.counts(), "values": [asdict(entry) for entry in self.entries]}

    def text(self) -> str:
        """Lines of a table, one a value."""
        places = [_place(entry) for entry in self.entries]
        width = min(max((len(place) for place in places), default=0), _WIDEST)
        return "\n".join(
            f"{entry.fate:<12}  {place:<{width}}  {_what(entry)}".rstrip()
            for entry, place in zip(self.entries, places, strict=True)
        )


#: Longer places push the rest of their line to the right, alone.
_WIDEST = 64


def _place(entry: Entry) -> str:
    line = f":{entry.line}" if entry.line else ""
    pointer = f" {entry.pointer}" if entry.file else entry.pointer
    return f"{entry.file}{line}{pointer}" or "-"


def _what(entry: Entry) -> str:
    to = f"-> {entry.to}" if entry.to else ""
    parts = (" ".join(part for part in (entry.value, to) if part), entry.note)
    return ": ".join(part for part in parts if part)
