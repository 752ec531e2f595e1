"""Text in cells of CSV files, so that no spreadsheet takes a name for a formula.

Names come from stages and cfgs of others. A cell that begins with one of a few characters is a
formula to a spreadsheet, which may fetch or run something; with an apostrophe before it it is text
(https://owasp.org/www-community/attacks/CSV_Injection). Numbers stay as they are.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from typing import Any, NamedTuple, TextIO

#: Of OWASP's list, with the wide forms that spreadsheets of East Asia take for them.
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")  # noqa: RUF001


def guarded(text: str) -> str:
    """A cell's text: with an apostrophe before it where it could be a formula."""
    return f"'{text}" if _is_formula(text) else text


def unguarded(text: str) -> str:
    """Returns the text that ``guarded`` was given, from what it returned."""
    return text[1:] if text.startswith("'") and _is_formula(text) else text


def guarded_line(cells: Iterable[object]) -> list[object]:
    """A line's cells: texts guarded, others as they are."""
    return [guarded(cell) if isinstance(cell, str) else cell for cell in cells]


class _Lines(NamedTuple):
    """Writes lines that end in a line feed, whatever a writer of CSV ends them with."""

    file: TextIO

    def write(self, line: str) -> int:
        return self.file.write(line.removesuffix("\r\n") + "\n")


def csv_writer(file: TextIO) -> Any:
    """Returns a ``csv.writer`` that puts each text with an end of a line in it between quotes.

    Asked for line feeds at once, Python 3.12 leaves a carriage return within a text as it is.
    """
    return csv.writer(_Lines(file))


def _is_formula(text: str) -> bool:
    """Whether it is one, apostrophes before it aside: so that each text has a cell of its own."""
    inner = text.lstrip("'")
    return inner.startswith(_FORMULA) and not _are_numbers(inner)


def _are_numbers(text: str) -> bool:
    parts = text.split()
    try:
        return bool([float(part) for part in parts])
    except ValueError:
        return False
