"""A foreign JSON file whose values are asked for by key, and what became of each.

Every value that is asked for is checked: what is wrong is kept as a fault, with file, line,
pointer, value and expectation, so that all faults are told at once (``Source.check``). Whatever
nobody asked for is reported as dropped (``Source.leave``).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from scenec.compiler.cfg import json_positions
from scenec.compiler.cfg.document import CfgSyntaxError, Document
from scenec.compiler.cfg.faults import locate, pointer
from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.finding import Path as Pointer
from scenec.importers.report import APPROXIMATED, DROPPED, TRANSLATED, Entry, Report
from scenec.schemas.errors import CfgError, Fault
from scenec.schemas.spelling import closest, nearest, shown

#: Larger numbers are slips: nothing here is counted in more.
_LARGEST = 1e12


class Source:
    """One file.

    Attributes:
        file: Its path, as faults name it.
        document: Its values and where they stand.
        faults: What is wrong, as far as it was looked at.
    """

    def __init__(self, file: Path):
        """Reads a file of JSON; comments and trailing commas are allowed.

        Raises:
            CfgError: It cannot be read, or is no JSON.
        """
        self.file = file
        name = str(file)
        try:
            self.document: Document = json_positions.parse(file.read_bytes(), name)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise CfgError([Fault(name, 1, 1, "", reason)]) from error
        except CfgSyntaxError as error:
            at = error.position
            raise CfgError([Fault(name, at.line, at.column, "", error.message)]) from error
        self._findings: list[Finding] = []
        self._entries: dict[Pointer, Entry] = {}
        self._asked: dict[Pointer, set[str]] = {}

    def root(self) -> Item:
        """The whole document."""
        return Item(self, (), self.document.value)

    @property
    def faults(self) -> list[Fault]:
        """All faults so far."""
        return locate(self._findings, self.document)

    def fault(self, at: Pointer, message: str) -> None:
        """Keeps a fault; of what is not there, that was told already."""
        if at in self.document.values:
            self._findings.append(Finding(at, message))

    def asked(self, at: Pointer, key: str) -> None:
        """Notes that an object's key has a meaning."""
        self._asked.setdefault(at, set()).add(key)

    def note(self, at: Pointer, fate: str, to: str, note: str, value: Any) -> None:
        """Says what became of a value; the first word stays, unless it was that it is dropped."""
        position = self.document.values.get(at)
        if position is not None:
            name, text = self.file.name, shown(value)
            entry = Entry(fate, name, position.line, pointer(at), text, to, note)
            if at not in self._entries or self._entries[at].fate == DROPPED != fate:
                self._entries[at] = entry

    def leave(self, dead: Mapping[str, str]) -> None:
        """Reports as dropped what nobody said anything of.

        Args:
            dead: Reasons by key, for keys that the other program does not read either.
        """
        self._leave((), self.document.value, dead)

    def _leave(self, at: Pointer, value: Any, dead: Mapping[str, str]) -> None:
        if at in self._entries:
            return
        children: Iterable[tuple[str | int, Any]] = ()
        if isinstance(value, dict):
            children = value.items()
        elif isinstance(value, list):
            children = enumerate(value)
        below = {entry[: len(at) + 1] for entry in self._entries if entry[: len(at)] == at}
        known = self._asked.get(at, set())
        for key, child in children:
            path = (*at, key)
            if path in self._entries:
                continue
            if key in dead and not (isinstance(key, str) and key in known):
                self.note(path, DROPPED, "", dead[str(key)], child)
            elif path in below or path in self._asked or _holds_objects(child):
                self._leave(path, child, dead)
            elif child not in ({}, []):
                self.note(path, DROPPED, "", self._unknown(key, known), child)

    @staticmethod
    def _unknown(key: str | int, valid: set[str]) -> str:
        if not isinstance(key, str) or key in valid:
            return "says nothing beside what else is given"
        guess = closest(key, sorted(valid))
        return "no key that is read" + (f"; did you mean {shown(guess)}?" if guess else "")

    def report_to(self, report: Report) -> None:
        """Adds what became of the values, in the file's order."""
        order = {path: i for i, path in enumerate(self.document.values)}
        for path in sorted(self._entries, key=order.__getitem__):
            report.entries.append(self._entries[path])


def _holds_objects(value: Any) -> bool:
    return isinstance(value, dict | list) and any(
        isinstance(v, dict) for v in (value.values() if isinstance(value, dict) else value)
    )


def check(sources: Iterable[Source]) -> None:
    """Raises all faults of some files.

    Raises:
        CfgError: There is at least one.
    """
    faults = [fault for source in sources for fault in source.faults]
    if faults:
        raise CfgError(faults)


class Item:
    """A value of a source, or the place of one that is not there, which is false.

    What is asked for in a wrong form is a fault, and the answer then a harmless one of the right
    form: the translation goes on, to find further faults, and is thrown away at the end. Of what
    is not there the answer is the usual one, and whatever is said of it is said of nothing.

    Attributes:
        source: Its file.
        path: Where it stands.
        value: In Python's types; None where it is not there.
    """

    def __init__(self, source: Source, path: Pointer, value: Any):
        self.source = source
        self.path = path
        self.value = value

    def __bool__(self) -> bool:
        """Whether the file has it."""
        return self.path in self.source.document.values

    def get(self, key: str) -> Item:
        """The value of a key."""
        self.source.asked(self.path, key)
        value = self.value.get(key) if isinstance(self.value, dict) else None
        return Item(self.source, (*self.path, key), value)

    def need(self, key: str) -> Item:
        """The value of a key that must be there."""
        found = self.get(key)
        if not found and isinstance(self.value, dict) and self:
            self.fault(f"no key {shown(key)}, which is required{nearest(key, self.value)}")
        elif not found:
            self._expected(f"an object with the key {shown(key)}")
        return found

    def object(self, key: str) -> Item:
        """The object of a key, an empty one where the key is not there."""
        found = self.get(key)
        if found and not isinstance(found.value, dict):
            found._expected("an object")
        return Item(self.source, found.path, found.value if isinstance(found.value, dict) else {})

    def entries(self) -> Iterator[tuple[str, Item]]:
        """Keys and values of an object."""
        for key in self.value if isinstance(self.value, dict) else ():
            yield key, self.get(key)

    def children(self) -> list[Item]:
        """The entries of a list."""
        if not isinstance(self.value, list):
            self._expected("a list")
            return []
        return [Item(self.source, (*self.path, i), v) for i, v in enumerate(self.value)]

    def fault(self, message: str) -> None:
        """Keeps a fault of this value."""
        self.source.fault(self.path, message)

    def _expected(self, what: str) -> None:
        self.fault(f"{shown(self.value)}: expected {what}")

    # Forms.

    def text(self) -> str:
        """A string; usually an empty one."""
        if not isinstance(self.value, str):
            self._expected("a string")
            return ""
        return self.value

    def one_of(self, *known: str) -> str:
        """One of some words; usually the first."""
        if self.value not in known:
            near = nearest(str(self.value), known) if isinstance(self.value, str) else ""
            self._expected(f"one of {', '.join(known)}{near}")
            return known[0]
        return str(self.value)

    def flag(self) -> bool:
        """True or false; usually false."""
        if not isinstance(self.value, bool):
            self._expected("true or false")
            return False
        return self.value

    def number(
        self, low: float = -_LARGEST, high: float = _LARGEST, usual: float | None = None
    ) -> float:
        """A number between two bounds."""
        if not self and usual is not None:
            return usual
        if not _is_number(self.value) or not low <= self.value <= high:
            self._expected(f"a number{_between(low, high)}")
            return max(low, min(1.0, high))
        return self.value

    def whole(self, low: int = 0, high: int = 2**31, usual: int | None = None) -> int:
        """A whole number between two bounds."""
        value = self.value
        if not self and usual is not None:
            return usual
        if not _is_number(value) or value != int(value) or not low <= value <= high:
            self._expected(f"a whole number{_between(low, high)}")
            return max(low, 1)
        return int(value)

    def numbers(
        self, count: int | None = None, usual: Sequence[float] | None = None
    ) -> list[float]:
        """A list of numbers."""
        value = self.value
        if not self and usual is not None:
            return list(usual)
        sound = isinstance(value, list) and all(_is_number(v) and abs(v) < _LARGEST for v in value)
        if not sound or (count is not None and len(value) != count):
            self._expected("a list of numbers" if count is None else f"a list of {count} numbers")
            return [1.0] * (count or 1)
        return [float(v) for v in value]

    def span(
        self,
        low: float = -_LARGEST,
        high: float = _LARGEST,
        usual: tuple[float, float] | None = None,
    ) -> tuple[float, float]:
        """``[a]``, a alone or ``[a, b]``: a constant or a uniform range, as its two ends."""
        if not self and usual is not None:
            return usual
        value = [self.value] if _is_number(self.value) else self.value
        sound = isinstance(value, list) and len(value) in (1, 2)
        if not sound or not all(_is_number(v) and low <= v <= high for v in value):
            self._expected(f"[a] or [a, b], numbers{_between(low, high)}")
            return max(low, min(1.0, high)), max(low, min(1.0, high))
        if value[-1] < value[0]:
            self._expected("[a, b] with a up to b")
        return min(value), max(value)

    # What became of it.

    def translated(self, to: str, note: str = "") -> Item:
        """Notes that the value is carried over as it was meant."""
        self.source.note(self.path, TRANSLATED, to, note, self.value)
        return self

    def approximated(self, to: str, note: str) -> Item:
        """Notes a value carried over but for the note's difference; without one, as meant."""
        fate = APPROXIMATED if note else TRANSLATED
        self.source.note(self.path, fate, to, note, self.value)
        return self

    def dropped(self, note: str) -> None:
        """Notes that the value is not carried over, for what the note says."""
        self.source.note(self.path, DROPPED, "", note, self.value)

    def drop(self, note: str, *keys: str) -> None:
        """None of some keys is carried over."""
        for key in keys:
            self.get(key).dropped(note)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _between(low: float, high: float) -> str:
    if low > -_LARGEST and high < _LARGEST and high < 2**31:
        return f" from {low:g} to {high:g}"
    if low > -_LARGEST:
        return f" of {low:g} or more"
    return ""
