"""CPU seconds a frame of a stream of new scenes, and what a thousand scenes leave.

    python lab/benchmarks/stream.py [--scenes N] [--backends A,B] [--workers N,...] [--leak N]
        [-o FILE]

Each scene has 60 rocks and one camera of 96×72 pixels, which gives rgb (of annotation none),
labels, instances and depth. Seconds are of ``--scenes`` scenes (24) after the first eight, of all
processes together; with one worker or none it has all cores. ``--leak`` (0: left out): memory
and descriptors of this process and its workers together, folders among the temporary ones, and
processes, after 100 scenes, after half of so many, after all, and once the stream is closed.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

import scenec
from scenec.lab.runner import Cell, Study, apart, run
from scenec.testing.small import small_cfg

_WARM, _FIRST = 8, 100


def scene() -> dict[str, Any]:
    """Returns the cfg."""
    cfg = small_cfg(samples=1)
    cfg["objects"]["rocks"]["count"] = 60
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [96, 72]
    return cfg


def family() -> list[psutil.Process]:
    """Lists this process and its workers."""
    me = psutil.Process()
    return [me, *me.children(recursive=True)]


def cost(backend: str, workers: int, scenes: int) -> tuple[float, float]:
    """Returns CPU seconds and wall seconds a frame."""
    spent, clock = 0.0, 0.0
    asked = {"seeds": range(_WARM + scenes), "backend": backend, "workers": workers}
    for frame in scenec.stream(scene(), **asked):
        if frame.index in (_WARM - 1, _WARM + scenes - 1):
            now = sum(sum(process.cpu_times()[:2]) for process in family())
            spent, clock = now - spent, time.perf_counter() - clock
    return spent / scenes, clock / scenes


def leaks(backend: str, workers: int, scenes: int) -> list[list[Cell]]:
    """Returns (when, MiB, descriptors, temporary entries, processes) after scenes, and closed."""
    place = Path(tempfile.gettempdir())

    def row(when: str) -> list[Cell]:
        there = family()
        held = sum(process.memory_info().rss for process in there) / 2**20
        files = sum(process.num_fds() for process in there)
        entries = sum(len(folders) for _, folders, _ in os.walk(place))
        return [when, held, files, entries, len(there)]

    rows = [row("before")]
    frames = scenec.stream(scene(), seeds=range(scenes), backend=backend, workers=workers)
    counts = (frame.index + 1 for frame in frames)
    rows += [row(f"{count} scenes") for count in counts if count in (_FIRST, scenes // 2, scenes)]
    return [*rows, row("closed")]


def main(study: Study) -> None:
    """Prints both tables."""
    options, rows = study.options, []
    for backend in options.backends:
        for workers in options.workers:
            spent, wall = apart(cost, backend, workers, options.scenes).value
            rows.append([backend, workers, spent, wall, 1.0 / wall])
    study.table(["backend", "workers", "CPU s a frame", "wall s a frame", "frames/s"], rows)
    most = max(options.workers)
    for backend in options.backends if options.leak else ():
        what = f"{backend}, {most} workers"
        header = [what, "MiB", "descriptors", "temporary entries", "processes"]
        study.table(header, apart(leaks, backend, most, options.leak).value)


if __name__ == "__main__":
    run(main, scenes=24, backends=("annotation", "pyrender"), workers=(0, 1, 2), leak=0)
