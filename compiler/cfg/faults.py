"""Faults by path, with line and column."""

from __future__ import annotations

from collections.abc import Iterable

from scenec.compiler.cfg.document import Document
from scenec.compiler.kinds.finding import Finding, Path
from scenec.schemas.errors import Fault


def locate(findings: Iterable[Finding], document: Document) -> list[Fault]:
    """Findings with file, line, column and pointer, each once."""
    faults = []
    for finding in findings:
        where = document.keys if finding.at_key else document.values
        path = finding.path
        while path not in document.values:
            # A key that is left out: what it is left out of.
            path = path[:-1]
        position = finding.position or where.get(path) or document.values[path]
        at = pointer(finding.path)
        faults.append(Fault(position.file, position.line, position.column, at, finding.message))
    return list(dict.fromkeys(faults))


def pointer(path: Path) -> str:
    """The JSON pointer (RFC 6901) of a path."""
    return "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in path)
