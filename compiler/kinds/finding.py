"""A fault of a cfg: where it is, and what is wrong."""

from __future__ import annotations

from dataclasses import dataclass

#: Keys and list indices from the root to a value.
Path = tuple[str | int, ...]


@dataclass(frozen=True)
class Position:
    """Line and column of a file, both from 1, the column in characters.

    Line 0 is that of a value that stands in no file: ``file`` is then the option that gave it.
    """

    line: int
    column: int
    file: str = ""


@dataclass(frozen=True)
class Finding:
    """A fault at a path of the document.

    Attributes:
        path: Where.
        message: What is wrong, what was expected.
        at_key: Whether the key is at fault rather than its value.
        position: Line and column, where they are not those of the key or value at the path.
        is_warning: Whether a cfg with it is taken, and the user told.
    """

    path: Path
    message: str
    at_key: bool = False
    position: Position | None = None
    is_warning: bool = False
