"""Faults by path, with line and column."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from scenec.compiler.cfg.document import Document, Path, Position
from scenec.schemas.errors import Fault


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


def locate(findings: Iterable[Finding], document: Document) -> list[Fault]:
    """Findings with file, line, column and pointer, each once."""
    faults = []
    for finding in findings:
        where = document.keys if finding.at_key else document.values
        position = finding.position or where.get(finding.path) or document.values[finding.path]
        at = pointer(finding.path)
        faults.append(Fault(position.file, position.line, position.column, at, finding.message))
    return list(dict.fromkeys(faults))


def pointer(path: Path) -> str:
    """The JSON pointer (RFC 6901) of a path."""
    return "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in path)
