"""What commands print: lines for people, JSON for scripts, progress for the impatient."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from scenec.cli.interrupt import stop_if_pending


def print_json(value: Any) -> None:
    """One JSON document on standard output."""
    print(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False))


def say(text: str) -> None:
    """A line about what is being done, on standard error: standard output is for results."""
    stop_if_pending()
    print(text, file=sys.stderr, flush=True)


class Progress:
    """Progress through a known number of steps: a bar on a terminal, plain lines elsewhere."""

    def __init__(self, what: str):
        self._what = what
        self._start = time.perf_counter()
        self._terminal = sys.stderr.isatty()

    def __call__(self, done: int, total: int, text: str) -> None:
        """Reports that ``done`` of ``total`` steps are finished; ``text`` is about the last one."""
        stop_if_pending()
        elapsed = time.perf_counter() - self._start
        left = elapsed / done * (total - done) if done else 0.0
        if not self._terminal:
            say(f"{self._what} {done}/{total}: {text}")
            return
        filled = round(24 * done / total) if total else 24
        bar = "█" * filled + "░" * (24 - filled)
        line = f"\r{self._what} {bar} {done}/{total}, {left:.0f} s left: {text}"
        sys.stderr.write(line[:118].ljust(118) + ("\n" if done == total else ""))
        sys.stderr.flush()


def table(rows: list[list[str]], header: list[str]) -> str:
    """Text columns: the first to the left, the others to the right."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    lines = []
    for row in [header, ["-" * width for width in widths], *rows]:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
