"""Declares the record of one problem that a check reports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or worth knowing.

    Attributes:
        check: Name of the check.
        severity: ``error`` makes the command fail; ``warning`` does not.
        where: File or prim path.
        message: What is wrong, with the values.
    """

    check: str
    severity: Literal["error", "warning"]
    where: str
    message: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}: {self.message} [{self.check}]"
