"""Prints for commands: lines for people, JSON for scripts, progress for the impatient."""

from __future__ import annotations

import json
import math
import shlex
import shutil
import sys
import time
from collections import deque
from typing import TYPE_CHECKING, Any

from scenec.api.listener import StepProgress
from scenec.cli.interrupt import stop_if_pending

if TYPE_CHECKING:
    from scenec.compiler.cfg.load import Spec


def print_json(value: Any) -> None:
    """One JSON document on standard output, in ASCII where that holds no more."""
    narrow = sys.stdout.encoding.lower() not in ("utf-8", "utf8")
    print(json.dumps(value, indent=2, ensure_ascii=narrow, allow_nan=False))


def say(text: str) -> None:
    """A line about what is being done, on standard error: standard output is for results."""
    stop_if_pending()
    tell(text)


def tell(text: str) -> None:
    """Prints a line on standard error, from any thread."""
    clear_bar()
    print(text, file=sys.stderr, flush=True)


def say_next(*commands: tuple[str, Any]) -> None:
    """The last line of a command: what one may do with what it made.

    Args:
        commands: (words of the command, the path that ends it).
    """
    texts = [f"scenec {words} {shlex.quote(str(path))}" for words, path in commands]
    say("next: " + "  or  ".join(texts))


def status(text: str) -> None:
    """Shows the current step on a terminal until the next line, which wipes it.

    Elsewhere the answer to bad input stays its faults and no more.
    """
    if sys.stderr.isatty():
        clear_bar()
        columns = shutil.get_terminal_size((118, 24)).columns - 1
        sys.stderr.write(f"\r{text[:columns]}")
        sys.stderr.flush()
        _Bar.open = True


class _Bar:
    """Whether the terminal's last line is a bar, which other lines must not run into."""

    open = False


def clear_bar() -> None:
    """Wipes the bar, if one is open, before something else is printed."""
    if _Bar.open:
        _Bar.open = False
        # Carriage return, erase the line (ECMA-48 EL).
        sys.stderr.write("\r\x1b[K")


def warn(spec: Spec) -> Spec:
    """Says what is improbable in a cfg, which it returns."""
    for warning in spec.warnings:
        say(f"warning: {warning}")
    return spec


class Progress(StepProgress):
    """Progress through a known number of steps: a bar on a terminal, plain lines elsewhere.

    Both say how many steps a second are made, over the last of them, and how long the rest will
    take at that speed.

    Args:
        what: What the steps are, before the bar.
        unit: What is counted a second, one of them.
        units: Several of them; None adds an s.
        every_s: Seconds between two plain lines, but for the first and the last.
    """

    def __init__(
        self, what: str, unit: str = "frame", units: str | None = None, every_s: float = 0.0
    ):
        self._what = what
        self._unit = unit
        self._units = units or f"{unit}s"
        self._every_s = every_s
        # What was reported when: speed is that of the last steps, since those that were done
        # before (frames that are there) cost next to nothing.
        self._reports = deque([(time.perf_counter(), 0)], maxlen=_WINDOW)
        self._told = -math.inf
        self._said = time.perf_counter()
        self._terminal = sys.stderr.isatty()

    def __call__(self, done: int, total: int, text: str) -> None:
        """Reports that ``done`` of ``total`` steps are finished; ``text`` is about the last one."""
        stop_if_pending()
        self._report(done, text)
        if self._terminal:
            self._bar(done, total, text)
        elif done == total or time.perf_counter() - self._told >= self._every_s:
            self._told = time.perf_counter()
            say(f"{self._what} {done}/{total}{self._forecast(done, total)}: {text}")

    def now(self, done: int, total: int, text: str) -> None:
        """Says what is going on between two steps: beside the bar, or once a second in a line."""
        stop_if_pending()
        if not self._terminal and time.perf_counter() - self._said >= _SAY_S:
            self._said = time.perf_counter()
            say(text)
        if self._terminal:
            self._told = 0.0
            self._bar(done, total, text, last=False)

    def _report(self, done: int, text: str) -> None:
        """Notes when a step was finished."""
        if text.endswith(THERE):
            # It cost none of our time.
            self._reports.clear()
        elif len(self._reports) == 1 and done > self._reports[0][1] + 1:
            # Nor did whatever was finished before the first report.
            self._reports[0] = (self._reports[0][0], done - 1)
        self._reports.append((time.perf_counter(), done))

    def _forecast(self, done: int, total: int) -> str:
        """Steps a second over the last reports, and what is left; "" while that is a guess."""
        start, first = self._reports[0]
        elapsed = time.perf_counter() - start
        if done == first or elapsed <= 0.0 or (done - first < _SURE and elapsed < _SURE_S):
            return ""
        rate = (done - first) / elapsed
        return f", {self._speed(rate)}, {_span((total - done) / rate)} left"

    def _bar(self, done: int, total: int, text: str, last: bool = True) -> None:
        last &= done == total
        now = time.perf_counter()
        if not last and now - self._told < _REDRAW_S:
            return
        self._told = now
        columns = shutil.get_terminal_size((118, 24)).columns - 1
        filled = round(24 * done / total) if total else 24
        bar = "█" * filled + "░" * (24 - filled)
        line = f"{self._what} {bar} {done}/{total}{self._forecast(done, total)}: {text}"
        _Bar.open = not last
        sys.stderr.write("\r" + line[:columns].ljust(columns) + ("\n" if last else ""))
        sys.stderr.flush()

    def _speed(self, rate: float) -> str:
        if rate >= 1.0:
            return f"{rate:.3g} {self._units}/s"
        return f"{1.0 / rate:.3g} s a {self._unit}"


#: Ends what is said of a step that an earlier run has made.
THERE = "there already"
#: So many steps, or seconds of fewer, tell how long the rest takes.
_SURE, _SURE_S = 3, 30.0
#: Reports that speed is taken over.
_WINDOW = 32
#: Seconds between two plain lines about what is going on.
_SAY_S = 1.0
#: Seconds between two plain lines of progress, in logs and pipes.
LINE_S = 10.0
#: A bar that is drawn more often only costs time.
_REDRAW_S = 0.05


def _span(seconds: float) -> str:
    """A time as people say it: 12 s, 3:07 min, 2:10 h."""
    whole = round(seconds)
    if whole < 100:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole // 60 % 60:02d} h"
