"""Declares listeners to long work: a terminal, a notebook, a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scenec.backends.run.render import RenderReport
    from scenec.backends.run.scan import ScanReport
    from scenec.compiler.compile import CompileReport


class StepProgress:
    """Progress through a known number of steps; this one shows nothing."""

    def __call__(self, done: int, total: int, text: str) -> None:
        """Reports that ``done`` of ``total`` steps are finished; ``text`` is about the last one."""

    def now(self, done: int, total: int, text: str) -> None:
        """Reports what is going on between two steps."""


class Listener:
    """Is told what long work does; this one keeps it to itself. Derive from it to show some."""

    #: Whether messages shall name options by their flags, as on the command line.
    flags = False

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"

    def say(self, line: str) -> None:
        """Hears a line about what is being done."""

    def warn(self, line: str) -> None:
        """Hears of what a user should see."""
        self.say(f"warning: {line}")

    def steps(self, what: str, unit: str = "frame", units: str | None = None) -> StepProgress:
        """Begins to hear of progress.

        Args:
            what: What the steps are: "compiled", "frame".
            unit: What is counted a second, one of them.
            units: Several of them; None adds an s.
        """
        return StepProgress()

    def compiled(self, report: CompileReport, cache: Path | None) -> None:
        """Hears what a compilation did, and where steps of it are kept."""

    def scanned(self, report: ScanReport) -> None:
        """Hears what came of scanning."""

    def rendered(self, report: RenderReport) -> None:
        """Hears what came of rendering."""
