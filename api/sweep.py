"""A cfg with many values and seeds, each point an output of its own."""

from __future__ import annotations

import csv
import html
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from scenec.api.declare import Spread
from scenec.api.listener import Listener
from scenec.api.options import SweepOptions
from scenec.api.steps import (
    AnyCfg,
    Folder,
    cache_folder,
    hire,
    placed,
    plain,
    refuse_early,
    render_output,
    scan_output,
    source_of,
)
from scenec.compiler.cfg.load import Spec
from scenec.compiler.sweep import CompilePoint, SweepPoint, points, read_all
from scenec.compiler.views.needed import Keep
from scenec.schemas.codec import Facts, decode
from scenec.schemas.csv_cells import csv_writer, guarded_line
from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.files import atomic, check_writable, read_json, write_json
from scenec.schemas.manifest import MANIFEST
from scenec.schemas.sweep import SweepList
from scenec.schemas.units import Executor, run_all

TABLE = "sweep"


@Spread(SweepOptions).two
def sweep(cfg: AnyCfg, out: Folder, options: SweepOptions) -> SweepTable:
    """Compiles all points side by side, then renders and scans them, one after the other.

    Points that are there already are not made again. A point that cannot be made costs no other.

    Args:
        cfg: As of ``compile``.
        out: A folder of outputs, one a point.
        options: As fields of ``SweepOptions``.

    Returns:
        What each point is, and what came of it.

    Raises:
        CfgError: The cfg of a point has faults; nothing is made.
        ScenecError: What is asked for cannot be done; nothing is made.
    """
    listener = options.listener
    swept = points(_lists(options.values), options.seeds, in_step=options.in_step)
    path, text = source_of(cfg)
    with placed(text is None):
        specs = read_all(path, swept, text)
    for line in dict.fromkeys(str(line) for spec in specs for line in spec.warnings):
        listener.warn(line)
    table = SweepTable(Path(out), swept, specs)
    work = _to_compile(table.out, options, swept, specs)
    scanned = _refuse_early(options, specs)
    check_writable(table.out)
    with hire(options) as executor:
        _compile(executor, work, table, listener)
        for point, lidars in zip(swept, scanned, strict=True):
            if not options.compile_only and not table.failed(point):
                _render(options, executor, point, lidars, table)
    return table


def _lists(values: Mapping[str, Sequence[object]] | Sequence[str]) -> list[str]:
    """Values as the command line has them."""
    if not isinstance(values, Mapping):
        return list(values)
    texts = []
    for path, given in values.items():
        several = isinstance(given, Iterable) and not isinstance(given, str | Mapping)
        try:
            each = (json.dumps(one, default=plain) for one in (given if several else [given]))
            texts.append(f"{path}={','.join(each)}")
        except (TypeError, ValueError) as error:
            raise ScenecError(f"values: {path}: {error}") from error
    return texts


class SweepTable:
    """Tabulates each point of a sweep and its outcome: ``sweep.csv``, ``sweep.json``.

    Attributes:
        out: Folder of the outputs.
        points: Their names and values, in order.
    """

    def __init__(self, out: Path, swept: Sequence[SweepPoint], specs: Sequence[Spec]) -> None:
        if (out / MANIFEST).exists():
            raise OutputError(f"{out}: holds one compilation, no sweep; choose another folder")
        _require_sweep_table(out)
        self.out, self.points = out, tuple(swept)
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

    def note(self, point: SweepPoint, state: str) -> None:
        """Writes what came of a point."""
        self._rows[point.name]["state"] = state
        write_json(self.out / f"{TABLE}.json", self.content())
        with atomic(self.out / f"{TABLE}.csv") as temporary:
            temporary.write_text(_as_csv(list(self._rows.values())), encoding="utf-8", newline="")

    def content(self) -> Facts:
        """For scripts."""
        return {"name": self._name, "points": list(self._rows.values())}

    @property
    def made(self) -> list[Path]:
        """Output folders of the points that could be made."""
        return [self.out / point.name for point in self.points if not self.failed(point)]

    def failed(self, point: SweepPoint) -> bool:
        """Whether it could not be made."""
        return str(self._rows[point.name]["state"]).startswith("failed")

    def _repr_html_(self) -> str:
        rows = list(self._rows.values())
        lines = [("th", list(rows[0])), *(("td", list(row.values())) for row in rows)]
        cells = (
            "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in line)
            for tag, line in lines
        )
        return f"<table>{''.join(f'<tr>{line}</tr>' for line in cells)}</table>"


def _as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns the table of points as CSV, a line each below their keys."""
    text = io.StringIO()
    lines = csv_writer(text)
    lines.writerows(map(guarded_line, [list(rows[0]), *(row.values() for row in rows)]))
    return text.getvalue()


def _require_sweep_table(out: Path) -> None:
    """Refuses a folder whose tables of that name are not those of a sweep.

    Raises:
        OutputError: One is somebody's own.
    """
    listed, table = out / f"{TABLE}.json", out / f"{TABLE}.csv"
    rows: list[dict[str, Any]] = []
    with suppress(FileNotFoundError):
        found = read_json(listed, OutputError, "sweep's list")
        decode(found, SweepList, OutputError, f"{listed}: is no sweep's list")
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
    out: Path, options: SweepOptions, swept: Sequence[SweepPoint], specs: Sequence[Spec]
) -> list[tuple[CompilePoint, bool]]:
    """Lists the points to compile, and whether each is compiled already.

    Raises:
        OutputError: A folder holds something else.
    """
    cache = cache_folder(options.cache)
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


def _refuse_early(options: SweepOptions, specs: Sequence[Spec]) -> list[bool]:
    """Whether each point has lidars.

    Raises:
        BackendError: The backend cannot render what is asked for.
    """
    if options.compile_only:
        return [False] * len(specs)
    answers: list[tuple[Any, bool]] = []
    found = []
    for spec in specs:
        # Most points have the same cameras.
        lidars = next((answer for rigs, answer in answers if rigs == spec.cfg["rigs"]), None)
        if lidars is None:
            lidars = refuse_early(options, spec.cfg)
            answers.append((spec.cfg["rigs"], lidars))
        found.append(lidars)
    return found


def _compile(
    executor: Executor,
    work: Sequence[tuple[CompilePoint, bool]],
    table: SweepTable,
    listener: Listener,
) -> None:
    for unit, is_done in work:
        table.note(unit.point, "compiled" if is_done else "not made")
    units = [unit for unit, is_done in work if not is_done]
    if len(units) < len(work):
        listener.say(f"{len(work) - len(units)} of {len(work)} points are compiled already")
    if not units:
        return
    executor.prepare(table.out)
    steps = listener.steps("compiled", unit="point")
    with closing(run_all(executor, units)) as ended:
        for done, (each, outcome) in enumerate(ended, 1):
            for line in outcome.warnings:
                listener.warn(line)
            assert isinstance(each, CompilePoint)
            if outcome.error is not None:
                listener.warn(f"{each.what}: {outcome.error}")
            table.note(each.point, f"failed: {outcome.error}" if outcome.error else "compiled")
            steps(done, len(units), each.what)


def _render(
    options: SweepOptions, executor: Executor, point: SweepPoint, lidars: bool, table: SweepTable
) -> None:
    out = table.out / point.name
    options.listener.say(f"{point.name}:")
    try:
        # First: where no camera is triggered rendering ends in an error.
        scans = len(scan_output(out, options, executor).failed) if lidars else 0
        frames = len(render_output(out, options, executor).failed)
    except ScenecError as error:
        options.listener.warn(f"{point.name}: {error}")
        table.note(point, f"failed: {error}")
        return
    lost = f"{frames} frames" if frames else f"{scans} scans" if scans else ""
    table.note(point, f"failed: {lost} were given up" if lost else "rendered")
