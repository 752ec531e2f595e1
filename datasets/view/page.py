"""Writes the page: frames stream into it one after the other, an index of them comes last."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, BinaryIO

from scenec.datasets.colors import NO_LABEL, label_colors
from scenec.datasets.outputs import find_outputs
from scenec.datasets.source import FrameRef, Source, pictures_first, record_of
from scenec.datasets.view.fields import HALF_ERROR
from scenec.datasets.view.fitting import fit, too_small
from scenec.datasets.view.ground import Ground, ground_text, objects_text, site_text
from scenec.datasets.view.jobs import Fault, Pool, SourceNames, Task
from scenec.datasets.view.layers import NORMAL_ERROR_DEG, WIDEST, Fineness
from scenec.datasets.view.record import EDGES, Record, Tally, plain_json, short
from scenec.datasets.view.space import space_text, three
from scenec.schemas.codec import JSON
from scenec.schemas.errors import FrameError
from scenec.schemas.files import atomic, check_output
from scenec.schemas.manifest import FRAMES, Batch
from scenec.schemas.units import Executor, Progress, Say
from scenec.schemas.versions import version_of

_SCRIPTS = ("base", "decode", "paint", "motion", "grid", "frame", "site", "map", "space",
            "plots", "keys", "watch", "main")  # fmt: skip
#: Part of the budget for batches from above, half of it for objects: the most that are kept, and
#: bytes of each; most and least cells along the ground's side.
_GROUND_PART = 0.1
_MOST_OBJECTS = 4000
_OBJECT_BYTES = 17
_MOST_CELLS = 512
_LEAST_CELLS = 32
#: Bytes of a stored cell at most, in base64: its height, slope and class.
_CELL_BYTES = 4.0
#: Values of a pixel, of passes that have more than one.
_PLANES = {"flow": 2, "flow_backward": 2, "scene_flow": 3}
#: Missing frames that are named one by one.
_NAMED = 200


@dataclass
class ViewReport:
    """A written page.

    Attributes:
        path: The HTML file.
        bytes: Its size.
        frames: How many frames are shown.
        faults: (name, kind, message) of those that are named instead.
        missing: How many should be there and are not.
        fineness: How fine pictures are stored.
        reduced: Frames that are stored with fewer pixels than they have.
        depth_error: Most that a stored depth is off, relative to it.
    """

    path: Path
    bytes: int = 0
    frames: int = 0
    faults: list[tuple[str, str, str]] = field(default_factory=list)
    missing: int = 0
    fineness: Fineness = field(default_factory=Fineness)
    reduced: int = 0
    depth_error: float = 0.0


class _OverBudgetError(Exception):
    """The page grew beyond its budget: the trials were not like the rest."""


def write_view(
    out: Path,
    output: Path,
    *,
    backends: Sequence[str] | None = None,
    budget_mb: float = 200.0,
    faults: str = "skip",
    ground: Callable[[Batch], Ground | None] | None = None,
    watched: str = "",
    executor: Executor | None = None,
    progress: Progress = lambda done, total, text: None,
    warn: Say = lambda line: None,
) -> ViewReport:
    """Writes one HTML page that shows all frames of an output.

    Args:
        out: Output folder of compile and render, or a USD file that was rendered.
        output: The page.
        backends: Whose frames; None takes those of all.
        budget_mb: Size of the page at most, in 10^6 bytes; frames are stored as finely as fits.
        faults: ``skip`` names frames that cannot be read and goes on, ``stop`` stops at the first.
        ground: The ground of a batch from above, called in the processes; None where there is none.
        watched: State that the page loads itself again after (``watching``); "": it never does.
        executor: Who works; None: this process.
        progress: Called with done, total, and what was done.
        warn: Called with a line a fault.

    Raises:
        FrameError: There are no frames, none can be read, or one is faulty and ``faults`` is
            ``stop``.
        OutputError: The page cannot be written, or not within its budget.
    """
    check_output(output)
    names = _names(out, backends)
    sources = names.open()
    tasks = [
        Task(index, ref, Fineness())
        for index, source in enumerate(sources)
        for ref in source.frames
    ]
    tasks.sort(key=lambda t: (t.ref.batch, t.ref.camera, t.ref.sample, t.ref.backend))
    budget = round(budget_mb * 1e6)
    pool = Pool(names, executor)
    longest, raw = _sizes(sources)
    ladder = fit(pool, tasks, longest, raw, budget)
    for fineness in ladder:
        book = _Book(out, sources, tasks, fineness, budget, faults, watched, progress, warn)
        try:
            with atomic(output) as temporary, temporary.open("wb") as file:
                book.write(file, pool, ground)
        except _OverBudgetError:
            continue
        book.report.path = output
        return book.report
    raise too_small(budget, 1.5 * budget)


def _ground(
    ground: Callable[[Batch], Ground | None], _sources: Sequence[Source], batch: Batch
) -> Ground | None:
    return ground(batch)


def _names(out: Path, backends: Sequence[str] | None) -> SourceNames:
    names = {
        path.name
        for batch in find_outputs(out).find()
        if (batch.folder / FRAMES).is_dir()
        for path in (batch.folder / FRAMES).iterdir()
        if path.is_dir() and any(path.glob("*/*.json"))
    }
    there = pictures_first(names)
    # Without any, the source says what to do.
    chosen: Sequence[str | None] = backends or there or [None]
    return SourceNames(out, tuple(chosen))


def _sizes(sources: Sequence[Source]) -> tuple[int, int]:
    """Longest side of a frame, and what its stored layers take at most, by one of each camera."""
    longest, most = 1, 1
    for source in sources:
        for ref in {r.camera: r for r in source.frames}.values():
            record = record_of(ref)
            if record is None:
                # A damaged frame is named when it is its turn.
                continue
            width, height = record.resolution
            layers = 3 + sum(_PLANES.get(name, 1) for name in record.passes)
            longest = max(longest, width, height)
            most = max(most, width * height * (2 * layers + 2) + 40_000)
    return longest, most


def _shown_name(ref: FrameRef) -> str:
    """A batch's name; in a sweep with its point's folder, which says what differs."""
    folder = ref.settings.get("folder")
    own = ref.batch_name.removeprefix(f"{ref.settings.get('point')}_")
    return f"{folder}/{own}" if folder else ref.batch_name


def _differing(settings: Sequence[Mapping[str, JSON]]) -> list[list[Any]]:
    """What differs between points of a sweep: name, and the text of its value in each batch."""
    names = list(dict.fromkeys(name for one in settings for name in one))
    rows: dict[str, list[str]] = {
        name: [json.dumps(one.get(name), ensure_ascii=False).strip('"') for one in settings]
        for name in names
        if name not in ("point", "folder")
    }
    return [[name, texts] for name, texts in rows.items() if len(set(texts)) > 1]


class _Book:
    """One attempt at the page, at one fineness."""

    def __init__(
        self,
        out: Path,
        sources: Sequence[Source],
        tasks: Sequence[Task],
        fineness: Fineness,
        budget: int,
        faults: str,
        watched: str,
        progress: Progress,
        warn: Say,
    ) -> None:
        self.report = ViewReport(out, fineness=fineness)
        self.report.missing = sum(len(source.missing) for source in sources)
        self._out, self._sources, self._budget = out, sources, budget
        self._tasks = [replace(task, fineness=fineness) for task in tasks]
        self._faults, self._progress, self._warn = faults, progress, warn
        self._watched = watched
        self._cameras = sorted({task.ref.camera for task in tasks})
        self._backends = [source.backend for source in sources]
        self._batches = sorted({(task.ref.batch, task.ref.batch_name) for task in tasks})
        self._places = {task.ref.batch: task.ref for task in tasks}
        self._tallies: dict[tuple[int, int, int], Tally] = {}
        self._rows: list[dict[str, Any]] = []
        self._labels: dict[str, dict[int, str]] = {}
        self._suns: dict[int, list[list[float] | None]] = {}
        self._spaces = 0

    def write(
        self, file: BinaryIO, pool: Pool, ground: Callable[[Batch], Ground | None] | None
    ) -> None:
        """Writes everything."""
        head, body = (
            _asset("page.html")
            .replace(b"%TITLE%", _escaped(self._title()))
            .split(b"<!-- frames -->")
        )
        if self._watched:
            # The script beside the page says when it is written anew.
            head = head.replace(b"script-src ", b"script-src file: ")
        file.write(head.replace(b"/* style */", _asset("page.css")))
        total = len(self._tasks)
        for number, made in enumerate(pool.records(self._tasks)):
            self._add(file, number, made)
            name = self._tasks[number].ref.name
            self._progress(number + 1, total, name)
        if not self.report.frames:
            raise FrameError.none_readable(self._out, total, self.report.faults[0][2])
        self._note_strays()
        self._write_maps(file, pool, ground)
        self._element(file, "index", plain_json(self._index()))
        # One scope a page: the files share their names and hide them from the page.
        code = b"\n".join(_asset(f"{name}.js") for name in _SCRIPTS)
        library = b"<script>" + (three() or b"") + b"</script>" if self._spaces else b""
        body = body.replace(b"<!-- library -->", library)
        file.write(body.replace(b"/* script */", b'(() => {\n"use strict";\n' + code + b"\n})();"))
        self.report.bytes = file.tell()
        self._check()

    def _title(self) -> str:
        return self._out.resolve().name

    def _check(self) -> None:
        if self.report.bytes > self._budget:
            raise _OverBudgetError

    def _element(self, file: BinaryIO, name: str, text: bytes) -> None:
        # Browsers read what is in templates three times as fast as what is in scripts.
        file.write(f'<template id="{name}">'.encode() + text + b"</template>\n")
        self.report.bytes = file.tell()
        self._check()

    def _add(self, file: BinaryIO, number: int, stored: Record | Fault) -> None:
        ref = self._tasks[number].ref
        row: dict[str, Any] = {
            "at": [
                self._backends.index(ref.backend),
                self._batches.index((ref.batch, ref.batch_name)),
                self._cameras.index(ref.camera),
                ref.sample,
            ]
        }
        if isinstance(stored, Fault):
            name = f"{ref.backend}: {ref.name}"
            if self._faults == "stop":
                raise FrameError(stored.message)
            self._warn(f"{name}: {stored.message}")
            self.report.faults.append((name, stored.kind, stored.message))
            # Pages tell no paths of the machine they were made on.
            message = stored.message.replace(f"{self._out}/", "")
            self._rows.append({**row, "fault": [stored.kind, message]})
            return
        self._element(file, f"f{number}", stored.text)
        self._rows.append(row | stored.index)
        a, b, c, _ = row["at"]
        self._tallies.setdefault((a, b, c), Tally()).add(stored.tally)
        self.report.frames += 1
        self.report.reduced += not stored.stored
        self.report.depth_error = max(self.report.depth_error, stored.depth_error)

    def _write_maps(
        self, file: BinaryIO, pool: Pool, ground: Callable[[Batch], Ground | None] | None
    ) -> None:
        """Batches from above: objects, and the ground where there is somebody who knows it."""
        batches = {b.index: b for b in find_outputs(self._out).find()}
        chosen = [batches[index] for index, _ in self._batches]
        room = 0.5 * self._budget * _GROUND_PART / len(chosen)
        for place, batch in enumerate(chosen):
            text = objects_text(batch, min(_MOST_OBJECTS, int(room / _OBJECT_BYTES)))
            if text is not None:
                self._element(file, f"o{place}", text)
        if ground is None:
            return
        side = int(min(_MOST_CELLS, max(_LEAST_CELLS, (room / _CELL_BYTES) ** 0.5)))
        for place, found in enumerate(
            pool.over(partial(_ground, ground), chosen, lambda batch: batch.name)
        ):
            if found is not None:
                self._element(file, f"g{place}", ground_text(found, side))
                if found.site is not None:
                    self._element(file, f"s{place}", site_text(found.site, side))
                if found.model is not None:
                    self._element(file, f"m{place}", space_text(found.model))
                    self._spaces += 1
                self._suns[place] = [
                    None if sun is None else [round(v, 2) for v in sun] for sun in found.suns
                ]

    def _index(self) -> dict[str, Any]:
        """Returns the page's index, needed before it shows anything: columns, one value a frame."""
        columns = ("at", "fault", "seconds", "error", "eye", "ahead", "half", "size", "passes",
                   "pixels", "instances", "sun")  # fmt: skip
        kinds: dict[str, int] = {}
        steps = sorted({step for row in self._rows for step in row.get("seconds") or {}})
        rows = []
        for row in self._rows:
            entry = [row.get(name) for name in columns]
            # Most frames have the same passes: said once.
            passes = json.dumps(row.get("passes"))
            entry[columns.index("passes")] = kinds.setdefault(passes, len(kinds))
            seconds = row.get("seconds") or {}
            entry[columns.index("seconds")] = [seconds.get(step) for step in steps]
            rows.append(entry)
        report = self.report
        return {
            "title": self._title(),
            "scenec": version_of(),
            "watched": self._watched,
            "cameras": self._cameras,
            "backends": self._backends,
            "batches": [_shown_name(self._places[index]) for index, _ in self._batches],
            "settings": _differing([self._places[index].settings for index, _ in self._batches]),
            "levels": self._levels(),
            "passes": [json.loads(text) for text in kinds],
            "steps": steps,
            "columns": columns,
            "frames": rows,
            "tallies": [[*key, tally.as_json()] for key, tally in sorted(self._tallies.items())],
            "suns": self._suns,
            "edges": EDGES,
            "missing": [
                f"{source.backend}: {fault.name}"
                for source in self._sources
                for fault in source.missing
            ][:_NAMED],
            "missing_count": report.missing,
            "stored": {
                "side": report.fineness.side or (WIDEST if report.reduced else None),
                "bits": report.fineness.depth_bits,
                "quality": report.fineness.quality,
                "reduced": report.reduced,
                # Rounded, and still no less than it is.
                "depth_error": short(1.01 * report.depth_error, 3),
                "normal_error_deg": NORMAL_ERROR_DEG,
                "motion_error": HALF_ERROR,
            },
        }

    def _note_strays(self) -> None:
        """Says what lies among the frames and is no part of the output."""
        strays = [fault for source in self._sources for fault in source.strays]
        if strays:
            more = f" (and {len(strays) - 1} more like it)" if len(strays) > 1 else ""
            self._warn(f"{strays[0].message}{more}; not shown")

    def _levels(self) -> list[dict[str, Any]]:
        try:
            tables = self._sources[0].labels()
        except FrameError:
            return []
        found = []
        for level, names in tables.items():
            colors = label_colors(list(names))
            ids = sorted(i for i in names if i)
            found.append(
                {
                    "name": level,
                    "classes": [[0, "no label", NO_LABEL]]
                    + [[i, names[i], colors[i]] for i in ids],
                }
            )
        return found


def _asset(name: str) -> bytes:
    return (files("scenec.datasets.view") / "browser" / name).read_bytes()


def _escaped(text: str) -> bytes:
    for mark, name in (("&", "amp"), ("<", "lt"), (">", "gt"), ('"', "quot")):
        text = text.replace(mark, f"&{name};")
    return text.encode()
