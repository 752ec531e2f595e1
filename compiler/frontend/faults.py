"""Faults by path, their line and column, and how a message speaks of a value."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from scenec.compiler.frontend.json_positions import Document, Path, Position
from scenec.schemas.errors import Fault

_LONGEST = 60


@dataclass(frozen=True)
class Finding:
    """A fault at a path of the document.

    Attributes:
        path: Where.
        message: What is wrong, what was expected.
        at_key: Whether the key is at fault rather than its value.
        position: Line and column, where they are not those of the key or value at the path.
    """

    path: Path
    message: str
    at_key: bool = False
    position: Position | None = None


def locate(findings: Iterable[Finding], document: Document, file: str) -> list[Fault]:
    """Findings with file, line, column and pointer, each once."""
    faults = []
    for finding in findings:
        where = document.keys if finding.at_key else document.values
        position = finding.position or where.get(finding.path) or document.values[finding.path]
        faults.append(
            Fault(file, position.line, position.column, pointer(finding.path), finding.message)
        )
    return list(dict.fromkeys(faults))


def pointer(path: Path) -> str:
    """The JSON pointer (RFC 6901) of a path."""
    return "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in path)


def shown(value: Any) -> str:
    """A value as JSON, cut where it is long."""
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


def closest(word: str, candidates: Iterable[str]) -> str | None:
    """The candidate that ``word`` is likely a slip for; None where none is near."""
    # Case is a common slip, which the matcher would weigh in full.
    lowered = {name.lower(): name for name in reversed(list(candidates))}
    match = difflib.get_close_matches(word[:200].lower(), lowered, n=1, cutoff=0.6)
    return lowered[match[0]] if match else None


def nearest(word: str, candidates: Iterable[str]) -> str:
    """A question after the closest candidate, or where none is near, what there is.

    Returns:
        "; did you mean 'x'?", or "; known: a, b, c", or "" where there is no candidate.
    """
    known = list(candidates)
    guess = closest(word, known)
    if guess is not None:
        return f"; did you mean {shown(guess)}?"
    if not known:
        return ""
    listed = ", ".join(known[:12]) + (" …" if len(known) > 12 else "")
    return f"; known: {listed}"
