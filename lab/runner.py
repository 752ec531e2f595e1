"""Runs scripts: their options, what things cost, tables and plots, the machine's speed beside them.

A benchmark is a function of a ``Study`` that prints tables; a page is one of a ``Page``, which it
writes into docs/. Either ends with ``run``.
"""

from __future__ import annotations

import argparse
import datetime
import importlib.metadata
import json
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenec.backends.run import memory
from scenec.schemas.errors import ScenecError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]
CONFIGS = ROOT / "configs"
DEMO = CONFIGS / "jacksboro.json"
#: Options that choose some of what a script makes.
_PARTS = {"only", "kinds", "works", "commands", "backends"}
#: Names of the cfgs that ship; of jacksboro once.
SHIPPED = tuple(sorted(path.stem for path in CONFIGS.glob("*.json") if "hdri" not in path.stem))
SCENEC = (sys.executable, "-c", "from scenec.cli.main import main; raise SystemExit(main())")
# No plot needs a screen.
os.environ.setdefault("MPLBACKEND", "Agg")

Cell = str | float | None


def yardstick() -> float:
    """CPU seconds of a fixed job of one thread, the median of three: how fast the machine is."""
    found = []
    for _ in range(3):
        start = time.process_time()
        x = np.random.Generator(np.random.Philox(1)).random(1 << 19)
        for _ in range(4):
            x = np.abs(np.fft.ifft(np.fft.fft(np.sort(x, kind="stable")) * 0.5)) + 0.5 * x
        found.append(time.process_time() - start)
    return statistics.median(found)


@dataclass(frozen=True)
class Cost:
    """What work in a process of its own returned and took, its own children included.

    Attributes:
        value: What it returned; None of a command.
        wall_s, cpu_s: Seconds; of a function, without the start of its process.
        peak_mib: The most that one of its processes held.
    """

    value: Any
    wall_s: float
    cpu_s: float
    peak_mib: float


def apart(work: Callable[..., Any], *arguments: Any) -> Cost:
    """Calls a function of a module in a fresh process."""
    with held() as process:
        return process(work, *arguments)


@contextmanager
def held() -> Iterator[Callable[..., Cost]]:
    """A fresh process for several calls, which share what modules hold; called as ``apart`` is."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        yield lambda work, *arguments: pool.submit(_measured, work, arguments).result()


def _measured(work: Callable[..., Any], arguments: Sequence[Any]) -> Cost:
    start, cpu = time.perf_counter(), _cpu_s()
    value = work(*arguments)
    return Cost(value, time.perf_counter() - start, _cpu_s() - cpu, peak_mib())


def _cpu_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def peak_mib() -> float:
    """The most that this process or one that it waited for has held."""
    # Not ru_maxrss of itself: that begins with what its parent held.
    return (
        max(memory.peak() or 0, 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
        / 2**20
    )


def command(words: Iterable[str | Path], status: int = 0, **environment: str) -> Cost:
    """Runs a command, its output aside.

    Args:
        words: Of the command.
        status: It ends with this one.
        environment: What is other than here.

    Raises:
        ScenecError: It ended otherwise; with what it wrote on standard error.
    """
    line = [str(word) for word in words]
    start = time.perf_counter()
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            line, env=os.environ | environment, stdout=subprocess.DEVNULL, stderr=said
        )
        _, ended, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(ended)
        wall = time.perf_counter() - start
        if process.returncode != status:
            said.seek(0)
            text = said.read().decode(errors="replace")
            raise ScenecError(f"{' '.join(line)}: exit status {process.returncode}\n{text}")
    return Cost(None, wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


@dataclass(frozen=True)
class Times:
    """Wall and CPU seconds of repeated work, and what it returned last."""

    wall: tuple[float, ...]
    cpu: tuple[float, ...]
    value: Any

    @property
    def median(self) -> float:
        """Of wall seconds."""
        return statistics.median(self.wall)

    def over(self, other: Times) -> float:
        """Median ratio of the wall seconds of paired runs."""
        return statistics.median(a / b for a, b in zip(self.wall, other.wall, strict=True))


def times(work: Callable[[], object], runs: int = 5) -> Times:
    """Times work; a first call, which may compile, does not count."""
    return in_turns({"": lambda _: work()}, runs)[""]


def in_turns(works: Mapping[str, Callable[[int], object]], runs: int) -> dict[str, Times]:
    """Times several works one after the other, again and again: a busy machine is so for all.

    Args:
        works: Called with the number of the turn; turn 0, which may compile, does not count.
        runs: How often each counts.
    """
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
    last: dict[str, object] = {}
    for turn in range(runs + 1):
        for name, work in works.items():
            wall, cpu = time.perf_counter(), time.process_time()
            last[name] = work(turn)
            found[name].append((time.perf_counter() - wall, time.process_time() - cpu))
    return {
        name: Times(tuple(w for w, _ in each[1:]), tuple(c for _, c in each[1:]), last[name])
        for name, each in found.items()
    }


def cell(value: Cell) -> str:
    """A number with the digits that a reader can use; text as it is; None as a dash."""
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    if isinstance(value, int | np.integer) or abs(value) >= 1000:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def table(header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """A Markdown table."""
    return "\n".join(_lines(header, rows)) + "\n"


def _lines(header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> Iterator[str]:
    yield "| " + " | ".join(header) + " |"
    yield "|" + "---|" * len(header)
    for row in rows:
        yield "| " + " | ".join(map(cell, row)) + " |"


class Study:
    """One run of a script.

    Attributes:
        options: Its own, by name.
        fast: Whether to spare time: fewer and smaller cases, to see that it works.
        scratch: A folder that goes away when the script ends.
    """

    def __init__(self, options: argparse.Namespace, scratch: Path) -> None:
        self.options, self.fast, self.scratch = options, bool(options.fast), scratch
        self._said: list[str] = []

    def say(self, text: str) -> None:
        """Prints a line, and keeps it for the file."""
        self._said.append(text)
        print(text, flush=True)

    def table(self, header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> None:
        """Prints a Markdown table, each row as soon as it is there."""
        for line in _lines(header, rows):
            self.say(line)
        self.say("")

    def cfg(self, content: Mapping[str, Any], name: str = "cfg") -> Path:
        """Writes a cfg into the scratch folder."""
        path = self.scratch / f"{name}.json"
        path.write_text(json.dumps(content), encoding="utf-8")
        return path

    def batch(self, cfg: Path | Mapping[str, Any], **how: Any) -> Path:
        """The folder of a cfg's first batch, compiled by seed 1 into a new scratch folder."""
        from scenec.compiler.compile import compile_cfg

        out = Path(tempfile.mkdtemp(dir=self.scratch))
        path = cfg if isinstance(cfg, Path) else self.cfg(cfg)
        how.setdefault("seed", 1)
        return compile_cfg(path, out=out, batches=range(1), **how).out / "batch_0000"

    def finish(self, head: str) -> None:
        """Writes what was said, if a file was asked for."""
        if self.options.out:
            text = "\n".join([head, "", *self._said])
            self.options.out.write_text(text, encoding="utf-8")


class Page(Study):
    """One run of a script that writes a page.

    Attributes:
        name: Of the page, without suffix; its plots' names begin with it.
        folder: Of the page; plots go to ``pictures`` below it.
        whole: Whether all that the script makes is made anew, and not what ``--only`` names.
    """

    def __init__(
        self, options: argparse.Namespace, scratch: Path, name: str, whole: bool = True
    ) -> None:
        super().__init__(options, scratch)
        self.name, self.folder = name, options.out
        self.whole = whole
        (self.folder / "pictures").mkdir(parents=True, exist_ok=True)
        self._tables: list[list[Sequence[Cell]] | None] = []
        self._values: dict[str, str] = {}

    def timed(self, work: Callable[[], object], repeat: int = 3) -> float:
        """Best of some runs, CPU seconds of all threads: other work beside hardly changes them."""
        best = np.inf
        for _ in range(1 if self.fast else repeat):
            start = time.process_time()
            work()
            best = min(best, time.process_time() - start)
        return float(best)

    def picture(self, name: str) -> Path:
        """The file of a picture."""
        return self.folder / "pictures" / f"{self.name}_{name}.png"

    def shown(self, name: str, what: str = "") -> str:
        """Markdown that shows a picture."""
        return f"![{what or name.replace('_', ' ')}](pictures/{self.picture(name).name})\n"

    def save(self, figure: Figure, name: str, dpi: int = 90) -> str:
        """Writes a plot; returns the Markdown that shows it."""
        import matplotlib.pyplot as plt

        if figure.get_layout_engine() is None:
            figure.tight_layout()
        figure.savefig(self.picture(name), dpi=dpi, metadata={"Software": None})
        plt.close(figure)
        return self.shown(name)

    def rows(self, rows: Iterable[Sequence[Cell]] | None) -> None:
        """Gives the page's next table its rows; None leaves it as it is."""
        self._tables.append(None if rows is None else [list(row) for row in rows])

    def value(self, name: str, text: str) -> None:
        """Puts a text between ``<!--name-->`` and ``<!--/name-->``."""
        self._values[name] = text

    def block(self, name: str, header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> None:
        """Puts a table between ``<!--name-->`` and ``<!--/name-->``."""
        self.value(name, f"\n\n{table(header, rows)}\n")

    def refresh(self, packages: Sequence[str], parts: Iterable[Callable[[Page], object]]) -> None:
        """Makes the parts, and writes the page anew with their tables, numbers and versions.

        The page's own text is docs/NAME.md: whoever wants another text edits it there.

        Args:
            packages: Whose versions stand between ``<!--by_SCRIPT-->`` and ``<!--/by_SCRIPT-->``,
                with command, version of scenec and date; if there are any, cores and yardstick.
            parts: Each calls ``rows``, table by table as they stand in the page, or ``block`` where
                the page has tables of others too, and ``value``.

        Raises:
            ScenecError: The page has other tables or marks than the parts.
        """
        for part in parts:
            start = time.perf_counter()
            part(self)
            about = (getattr(part, "func", part).__doc__ or "").splitlines() or [""]
            print(f"{time.perf_counter() - start:6.1f} s  {about[0]}", file=sys.stderr, flush=True)
        text = (ROOT / "docs" / f"{self.name}.md").read_text(encoding="utf-8")
        if self.whole:
            self.value(f"by_{Path(sys.argv[0]).stem}", _stamp(packages))
        # Tables within marks are of values.
        spans = [m.span() for m in re.finditer(r"<!--(\w+)-->.*?<!--/\1-->", text, re.DOTALL)]
        found = [m for m in _TABLE.finditer(text) if not any(a < m.start() < b for a, b in spans)]
        if self._tables and len(found) != len(self._tables):
            raise ScenecError(
                f"docs/{self.name}.md: {len(found)} tables, {len(self._tables)} were made"
            )
        for old, rows in reversed(list(zip(found, self._tables, strict=False))):
            wide = old["line"].count("---")
            if rows is None:
                continue
            if any(len(row) != wide for row in rows):
                raise ScenecError(f"docs/{self.name}.md: {old['head'].strip()}: other columns")
            lines = "".join("| " + " | ".join(map(cell, row)) + " |\n" for row in rows)
            text = text[: old.start("rows")] + lines + text[old.end("rows") :]
        for name, value in self._values.items():
            marks = re.compile(f"(?<=<!--{name}-->).*?(?=<!--/{name}-->)", re.DOTALL)
            # No template: texts may have backslashes.
            text, count = marks.subn(value.replace("\\", r"\\"), text)
            if not count:
                raise ScenecError(f"docs/{self.name}.md: nothing is marked <!--{name}-->")
        (self.folder / f"{self.name}.md").write_text(text, encoding="utf-8")


_TABLE = re.compile(
    r"^(?P<head>\|.*\|\n)(?P<line>\|(?:---\|)+\n)(?P<rows>(?:\|.*\|\n)*)", re.MULTILINE
)


def _stamp(packages: Iterable[str]) -> str:
    named = [f"{name} {importlib.metadata.version(name)}" for name in packages]
    scenec = f"scenec {importlib.metadata.version('scenec')}, {datetime.date.today()}"
    machine = f"{os.cpu_count()} cores, yardstick {yardstick():.2f} CPU s"
    said = [scenec, ", ".join(named), machine] if named else [scenec]
    return f"`python {_relative(sys.argv[0])}`: {'; '.join(said)}"


def run(main: Callable[[Any], None], page: str | None = None, **defaults: Any) -> None:
    """Runs a script from its command line; ends the process.

    It has ``--fast``, ``-o`` and an option for each default: a flag for False, names with commas
    for a tuple, one that may be left out for a type.

    Args:
        main: Of a ``Study``, or of a ``Page``; the docstring of its module says what it does.
        page: Name of the page that it writes.
        defaults: By name.
    """
    about = (sys.modules[main.__module__].__doc__ or "").splitlines()[0]
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--fast", action="store_true", help="fewer cases, to see that it works")
    where = "folder of the page" if page else "file for the tables"
    folder = ROOT / "docs" if page else None
    parser.add_argument("-o", "--out", type=Path, default=folder, help=where)
    for name, default in defaults.items():
        _add(parser, "--" + name.replace("_", "-"), default)
    options = parser.parse_args()
    status = 0
    try:
        with _scratch() as scratch:
            if page:
                whole = all(
                    getattr(options, name) == (None if callable(defaults[name]) else defaults[name])
                    for name in _PARTS & defaults.keys()
                )
                main(Page(options, scratch, page, whole))
            else:
                study, before = Study(options, scratch), yardstick()
                words = " ".join(["python", *map(_relative, sys.argv)])
                head = f"`{words}`, {os.cpu_count()} cores, "
                print(f"{head}yardstick {before:.3f} CPU s\n", flush=True)
                main(study)
                head += f"yardstick {before:.3f} CPU s before, {yardstick():.3f} after"
                print(head)
                study.finish(head)
    except ScenecError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        status = 2
    raise SystemExit(status)


def names(text: str) -> tuple[str, ...]:
    """The type of an option of names that may be left out."""
    return tuple(text.split(","))


def _relative(word: str) -> str:
    path = Path(word).resolve()
    return str(path.relative_to(ROOT)) if path.is_file() and path.is_relative_to(ROOT) else word


@contextmanager
def _scratch() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def _add(parser: argparse.ArgumentParser, name: str, default: Any) -> None:
    if default is False:
        parser.add_argument(name, action="store_true")
    elif callable(default):
        parser.add_argument(name, type=default)
    elif isinstance(default, tuple):
        kind = type(default[0])
        parser.add_argument(
            name, default=default, type=lambda text: tuple(kind(part) for part in text.split(","))
        )
    else:
        parser.add_argument(name, type=type(default), default=default)
