"""Selects the instances of a dataset by conditions on the frames' tables.

A condition is ``NAME OPERATOR VALUE``, as in ``area>=40``, ``depth_mean<=35``, ``occlusion<0.9`` or
``class=*/rocks``. An instance is kept where all conditions hold.
"""

from __future__ import annotations

import fnmatch
import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.source import LoadedFrame
from scenec.schemas import rle
from scenec.schemas.codec import Natural
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.spelling import nearest

Column = NDArray[Any]

#: What a condition may speak of, beside ``label.<level>``: from the table's columns. What is hidden
#: or cut off counts in exact pixels (``scenec.schemas.instances``).
QUANTITIES: dict[str, tuple[str, tuple[str, ...]]] = {
    "area": ("pixels that show it", ("pixels",)),
    "amodal": ("pixels that would show it if nothing hid it", ("amodal",)),
    "occlusion": ("1 - area / amodal: the part that other things hide", ("pixels", "amodal")),
    "truncation": (
        "1 - amodal / amodal_full: the part beyond the picture's border",
        ("amodal", "amodal_full"),
    ),
    "truncated": ("1 where it touches the picture's border, else 0", ("truncated",)),
    "depth_min": ("nearest depth, meters", ("depth_min",)),
    "depth_mean": ("mean depth, meters", ("depth_mean",)),
    "depth_max": ("farthest depth, meters", ("depth_max",)),
    "width": ("width of its bounding box, pixels", ("x_min", "x_max")),
    "height": ("height of its bounding box, pixels", ("y_min", "y_max")),
    "size": ("longest side of its bounding box, meters", ("size_x", "size_y", "size_z")),
    "id": ("frame id", ("id",)),
    "class": ("prim path of its class; * and ? stand for any text", ("class",)),
}
_TEXT = ("class",)
_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
    "=": operator.eq,
}
_FORM = re.compile(r"\s*([\w.\-]+)\s*(>=|<=|!=|==|>|<|=)\s*(.*?)\s*$", re.DOTALL)


@dataclass(frozen=True)
class Condition:
    """One condition.

    Attributes:
        name: A key of ``QUANTITIES``, or ``label.<level>``.
        relation: One of >= <= != > < =.
        value: A number, or text for ``class`` and labels (alternatives divided by ``|``).
    """

    name: str
    relation: str
    value: float | str

    def __str__(self) -> str:
        # In full: a condition that is read back from a card is the very same.
        value = self.value if isinstance(self.value, str) else repr(self.value).removesuffix(".0")
        return f"{self.name}{self.relation}{value}"

    def holds(self, frame: LoadedFrame) -> NDArray[np.bool_]:
        """For each line of the frame's table, whether it holds.

        Raises:
            FrameError: The table lacks a column.
            OutputError: There is no such label level.
        """
        column = quantity(frame, self.name)
        if isinstance(self.value, str):
            patterns = self.value.split("|")
            kinds, inverse = np.unique(column, return_inverse=True)
            match = [any(fnmatch.fnmatchcase(k, p) for p in patterns) for k in kinds.tolist()]
            found = np.array(match, np.bool_)[inverse]
            return found if self.relation == "=" else ~found
        result: NDArray[np.bool_] = _OPERATORS[self.relation](column, self.value)
        return result


@dataclass(frozen=True)
class Filters:
    """Conditions, all of which must hold.

    Attributes:
        conditions: In order.
        rejected: What becomes of the others: ``drop`` them (their pixels are no instance), or
            ``ignore``: keep them, marked as not to be judged, in formats that know such a mark.
    """

    conditions: tuple[Condition, ...] = ()
    rejected: str = "drop"

    def apply(self, frame: LoadedFrame) -> dict[str, int]:
        """Filter a frame, in place.

        Returns:
            By condition, how many instances it was the first to reject.

        Raises:
            FrameError: The frame's table lacks a column.
        """
        counts: dict[str, int] = {}
        if not self.conditions:
            return counts
        if not frame.table:
            raise FrameError(
                f"{frame.ref.stem}.json: has no pass instance for {self.conditions[0]} to speak "
                "of; render with --passes …,instance"
            )
        keep = np.ones(len(frame.table["id"]), np.bool_)
        for condition in self.conditions:
            holds = condition.holds(frame)
            counts[str(condition)] = int((keep & ~holds).sum())
            keep &= holds
        if self.rejected == "ignore":
            frame.ignored |= ~keep
        elif not keep.all():
            frame.table = {name: column[keep] for name, column in frame.table.items()}
            frame.ignored = frame.ignored[keep]
            frame.passes["instance"] = rle.only(frame.passes["instance"], frame.table["id"])
        return counts


@dataclass
class Tally:
    """Counts instances examined, accepted and rejected, summed over frames."""

    seen: Natural
    kept: Natural
    rejected: dict[str, Natural]

    def add(self, examined: int, accepted: int, rejected: dict[str, int]) -> None:
        """Add a frame's."""
        self.seen += examined
        self.kept += accepted
        for name, count in rejected.items():
            self.rejected[name] = self.rejected.get(name, 0) + count


def parse_condition(text: str) -> Condition:
    """A condition as it is written.

    Raises:
        OutputError: It is none; says what is wrong and what there is.
    """
    match = _FORM.match(text)
    if match is None:
        raise OutputError(
            f"condition {text!r}: expected NAME OPERATOR VALUE, as in 'area>=40' or "
            f"'class=*/rocks'; names: {', '.join(QUANTITIES)}, label.LEVEL"
        )
    name, relation, value = match.groups()
    relation = "=" if relation == "==" else relation
    is_label = name.startswith("label.") and len(name) > len("label.")
    if name not in QUANTITIES and not is_label:
        raise OutputError(
            f"condition {text!r}: nothing is called {name!r}"
            f"{nearest(name, [*QUANTITIES, 'label.LEVEL'])}"
        )
    if name in _TEXT or is_label:
        if relation not in ("=", "!="):
            raise OutputError(f"condition {text!r}: {name} is text: compare it by = or !=")
        if not value:
            raise OutputError(f"condition {text!r}: says nothing after {relation}")
        return Condition(name, relation, value)
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise OutputError(f"condition {text!r}: expected a finite number, not {value!r}")
    return Condition(name, relation, number)


def quantity(frame: LoadedFrame, name: str) -> Column:
    """A quantity of each instance in a frame's table: one of ``QUANTITIES`` or ``label.<level>``.

    Raises:
        FrameError: The table lacks a column: the frame was rendered by an earlier version.
        OutputError: There is no such label level.
    """
    table = frame.table
    if name.startswith("label."):
        if name not in table:
            known = [column for column in table if column.startswith("label.")]
            raise OutputError(f"there is no label level {name!r}{nearest(name, known)}")
        return table[name]
    needed = QUANTITIES[name][1]
    lacking = [column for column in needed if column not in table]
    if lacking:
        raise FrameError(
            f"{frame.ref.stem}.instances.csv: has no column {lacking[0]!r}, which {name!r} needs: "
            "it is of an earlier version; render again"
        )
    columns = [table[column] for column in needed]
    if name in ("occlusion", "truncation"):
        part, whole = (column.astype(np.float64) for column in columns)
        return 1.0 - part / np.maximum(whole, 1.0)
    if name in ("width", "height"):
        return columns[1] - columns[0] + 1
    if name == "size":
        return np.max(np.stack(columns), axis=0)
    return columns[0]


def make_filters(conditions: Sequence[str], rejected: str = "drop") -> Filters:
    """Filters from conditions as they are written.

    Raises:
        OutputError: One of them is none.
    """
    if rejected not in ("drop", "ignore"):
        raise OutputError(f"rejected instances are dropped or ignored, not {rejected!r}")
    return Filters(tuple(map(parse_condition, conditions)), rejected)
