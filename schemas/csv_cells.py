"""Text in cells of CSV files, so that no spreadsheet takes a name for a formula.

Names come from stages and cfgs of others. A cell that begins with one of a few characters is a
formula to a spreadsheet, which may fetch or run something; with an apostrophe before it it is text
(https://owasp.org/www-community/attacks/CSV_Injection). Numbers stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterable

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
