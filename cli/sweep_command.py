"""``scenec sweep``: a cfg with many values and seeds, each point an output of its own."""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from scenec.backends.run.executors import make_executor
from scenec.cli.compile_command import cache_of
from scenec.cli.output import Progress, print_json, say, say_next, status
from scenec.cli.render_command import limits_of, render_now
from scenec.cli.run_command import refuse_early
from scenec.cli.scan_command import scan_now
from scenec.compiler.cfg.load import Spec
from scenec.compiler.sweep import CompilePoint, Point, points, read_all
from scenec.compiler.views.needed import Keep
from scenec.schemas.csv_cells import guarded_line
from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.files import atomic, check_writable, write_json
from scenec.schemas.manifest import MANIFEST
from scenec.schemas.shape import natural, read_shaped
from scenec.schemas.units import Executor, run_all

TABLE = "sweep"
#: What is relied on of a point in the list.
_POINT = {"folder": str, "seed": natural, "cfg_sha256": str, "state": str}


def run(options: argparse.Namespace) -> int:
    """Compiles all points side by side, then renders and scans them, one after the other.

    Raises:
        CfgError: The cfg of a point has faults; nothing is made.
        ScenecError: What is asked for cannot be done; nothing is made.
    """
    status(f"reading {options.cfg}")
    swept = points(options.lists, options.seeds, in_step=options.in_step)
    specs = read_all(options.cfg, swept)
    for line in dict.fromkeys(str(line) for spec in specs for line in spec.warnings):
        say(f"warning: {line}")
    table = _Table(Path(options.out), swept, specs)
    work = _to_compile(options, swept, specs)
    scanned = _refuse_early(options, specs)
    check_writable(table.out)
    with make_executor(options.workers, options.cluster, limits_of(options)) as executor:
        _compile(executor, work, table)
        for point, lidars in zip(swept, scanned, strict=True):
            if not options.compile_only and not table.failed(point):
                _render(options, executor, point, lidars, table)
    if options.json:
        print_json(table.content())
    say(f"{len(swept)} points in {table.out}/, listed in {table.out / TABLE}.csv")
    made = [point.name for point in swept if not table.failed(point)]
    if made:
        say_next(("explain" if options.compile_only else "view", table.out / made[0]))
    return 1 if any(map(table.failed, swept)) else 0


class _Table:
    """What each point of an output is, and what came of it: ``sweep.csv``, ``sweep.json``."""

    def __init__(self, out: Path, swept: Sequence[Point], specs: Sequence[Spec]) -> None:
        if (out / MANIFEST).exists():
            raise OutputError(f"{out}: holds one compilation, no sweep; choose another folder")
        _require_own(out)
        self.out = out
        self._name = specs[0].cfg["name"]
        self._rows: dict[str, dict[str, Any]] = {
            point.name: {
                "folder": point.name,
                "seed": point.seed,
                **point.values,
                "cfg_sha256": spec.digest,
                "state": "not made",
            }
            for point, spec in zip(swept, specs, strict=True)
        }

    def note(self, point: Point, state: str) -> None:
        """Writes what came of a point."""
        self._rows[point.name]["state"] = state
        write_json(self.out / f"{TABLE}.json", self.content())
        with atomic(self.out / f"{TABLE}.csv") as temporary:
            temporary.write_text(_as_csv(list(self._rows.values())), encoding="utf-8", newline="")

    def content(self) -> dict[str, Any]:
        """For scripts."""
        return {"name": self._name, "points": list(self._rows.values())}

    def failed(self, point: Point) -> bool:
        """Whether it could not be made."""
        return str(self._rows[point.name]["state"]).startswith("failed")


def _as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns the table of points as CSV, a line each below their keys."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerows(map(guarded_line, [list(rows[0]), *(row.values() for row in rows)]))
    return text.getvalue()


def _require_own(out: Path) -> None:
    """Refuses a folder whose tables of that name are not those of a sweep.

    Raises:
        OutputError: One is somebody's own.
    """
    listed, table = out / f"{TABLE}.json", out / f"{TABLE}.csv"
    rows: list[dict[str, Any]] = []
    with suppress(FileNotFoundError):
        found = read_shaped(listed, {"name": str, "points": [_POINT]}, OutputError, "sweep's list")
        rows = found["points"]
    try:
        there = table.read_text(encoding="utf-8")
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        raise OutputError(f"{table}: cannot be read: {error}") from error
    ours = _as_csv(rows) if rows else ""
    # The last column is the state, which may be a step behind.
    try:
        kept, own = ([row[:-1] for row in csv.reader(io.StringIO(text))] for text in (there, ours))
    except csv.Error:
        kept, own = [[there]], []
    if kept != own:
        raise OutputError(
            f"{table}: is not what a sweep wrote, and its own goes there; move it away, or choose "
            "another folder"
        )


def _to_compile(
    options: argparse.Namespace, swept: Sequence[Point], specs: Sequence[Spec]
) -> list[tuple[CompilePoint, bool]]:
    """What to compile, and whether it is there already.

    Raises:
        OutputError: A folder holds something else.
    """
    out, cache = Path(options.out), cache_of(options)
    units = [
        CompilePoint(
            spec=spec,
            point=point,
            out=(out / point.name).absolute(),
            keep=Keep(options.keep),
            batches=options.batches,
            cache=None if cache is None else cache.absolute(),
            replace=options.replace,
            faults=options.faults,
        )
        for point, spec in zip(swept, specs, strict=True)
    ]
    return [(unit, unit.is_done()) for unit in units]


def _refuse_early(options: argparse.Namespace, specs: Sequence[Spec]) -> list[bool]:
    """Whether each point has lidars.

    Raises:
        BackendError: The backend cannot render what is asked for.
    """
    if options.compile_only:
        return [False] * len(specs)
    known: list[tuple[Any, bool]] = []
    found = []
    for spec in specs:
        # Most points have the same cameras.
        lidars = next((answer for rigs, answer in known if rigs == spec.cfg["rigs"]), None)
        if lidars is None:
            lidars = refuse_early(options, spec.cfg)
            known.append((spec.cfg["rigs"], lidars))
        found.append(lidars)
    return found


def _compile(executor: Executor, work: Sequence[tuple[CompilePoint, bool]], table: _Table) -> None:
    for unit, is_done in work:
        table.note(unit.point, "compiled" if is_done else "not made")
    units = [unit for unit, is_done in work if not is_done]
    if len(units) < len(work):
        say(f"{len(work) - len(units)} of {len(work)} points are compiled already")
    if not units:
        return
    executor.prepare(table.out)
    bar = Progress("compiled", unit="point")
    with closing(run_all(executor, units)) as ended:
        for done, (each, outcome) in enumerate(ended, 1):
            for line in outcome.warnings:
                say(f"warning: {line}")
            assert isinstance(each, CompilePoint)
            if outcome.error is not None:
                say(f"warning: {each.what}: {outcome.error}")
            table.note(each.point, f"failed: {outcome.error}" if outcome.error else "compiled")
            bar(done, len(units), each.what)


def _render(
    options: argparse.Namespace, executor: Executor, point: Point, lidars: bool, table: _Table
) -> None:
    own = argparse.Namespace(**{**vars(options), "out": str(table.out / point.name)})
    say(f"{point.name}:")
    try:
        # First: where no camera is triggered rendering ends in an error.
        scans = len(scan_now(own, executor=executor).failed) if lidars else 0
        frames = len(render_now(own, executor).failed)
    except ScenecError as error:
        say(f"warning: {point.name}: {error}")
        table.note(point, f"failed: {error}")
        return
    lost = f"{frames} frames" if frames else f"{scans} scans" if scans else ""
    table.note(point, f"failed: {lost} were given up" if lost else "rendered")
