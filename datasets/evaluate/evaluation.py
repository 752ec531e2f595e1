"""Defines what an evaluation found: measures, tables, notes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.codec import Facts

#: None stands where a measure is not defined, as the IoU of a class that nothing shows.
Cell = str | float | None


@dataclass(frozen=True)
class Table:
    """Some rows of numbers.

    Attributes:
        name: Short, for JSON and CSV.
        title: A heading for people.
        columns: Names; the first column says what a row is about.
        rows: Cells.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: list[tuple[Cell, ...]]


@dataclass
class Evaluation:
    """Holds the results of an evaluation.

    Attributes:
        task: ``instances``, ``labels``, ``depth`` or ``track``.
        predictions: The file or folder that was judged.
        against: The truth.
        settings: What the numbers depend on.
        measures: Name -> value over everything.
        units: Of measures that have one.
        tables: The same in parts.
        notes: What a reader of the numbers should know.
        arrays: What plots show beside the tables; in no file.
        files: What was written.
    """

    task: str
    predictions: Path
    against: Path
    settings: Facts = field(default_factory=dict)
    measures: dict[str, float | None] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    tables: list[Table] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)

    def as_json(self) -> Facts:
        """All but the arrays."""
        return {
            "task": self.task,
            "predictions": self.predictions.as_posix(),
            "against": self.against.as_posix(),
            "settings": self.settings,
            "measures": {name: finite(value) for name, value in self.measures.items()},
            "units": self.units,
            "tables": {
                table.name: [
                    {key: finite(cell) for key, cell in zip(table.columns, row, strict=True)}
                    for row in table.rows
                ]
                for table in self.tables
            },
            "notes": self.notes,
        }

    def lines(self) -> Iterator[tuple[str, str, str, Cell]]:
        """Every number once: (table, row, measure, value); ``all`` is the table of the whole."""
        for name, value in self.measures.items():
            yield "all", "all", name, finite(value)
        for table in self.tables:
            for row in table.rows:
                for name, cell in zip(table.columns[1:], row[1:], strict=True):
                    yield table.name, str(row[0]), name, finite(cell)


def finite(value: Cell) -> Cell:
    """A plain Python value; None for what is no number."""
    if value is None or isinstance(value, str):
        return value
    plain = value.item() if isinstance(value, np.generic) else value
    return plain if math.isfinite(plain) else None
