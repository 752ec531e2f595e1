"""Times the start: from the command to the first frame that is written, warm, by backend and part.

    python lab/benchmarks/start.py [--backends A,B,...] [--spp N] [--turns N] [--stage OUT] [--fast]

The demo (configs/jacksboro.json) as it is, compiled before unless an output of it is given; kernels
are there, and Python's byte code, if the first turn could write it: that turn does not count. Each
turn renders one frame twice by ``scenec render``: with no frames there, and with what was metered
(``frames/exposure.json``). Of the turns the least counts. ``first frame`` is wall clock from
the start of the process until the frame's sidecar is written; CPU seconds are those of all
processes, until they have ended. A frame's own steps follow, as its sidecar has them; those of two
threads overlap. Last, what any start has, part by part, in one process that does nothing else.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from scenec.backends.registry import open_backend
from scenec.lab.runner import DEMO, SCENEC, Cell, Study, apart, command, run
from scenec.schemas.exposures import EXPOSURES
from scenec.schemas.manifest import FRAMES

#: What is done once, in this order.
_STEPS = ("load", "exposure", "radiance", "annotate", "compose")
_STAGE = Path("batch_0000", "stage.usda")


def main(study: Study) -> None:
    """Prints both tables."""
    out = study.scratch / "out"
    if study.options.stage is None:
        command([*SCENEC, "compile", DEMO, "--seed", "1", "--batches", "0:1", "-o", out])
    else:
        shutil.copytree(study.options.stage, out, ignore=shutil.ignore_patterns(FRAMES))
    header = ["backend", "exposure", "first frame: wall s", "CPU s", *_STEPS]
    study.table(header, _rows(study, out))
    parts = [apart(_parts, out / _STAGE).value for _ in range(study.options.turns)]
    study.table(
        ["once a worker", "CPU s"], ([name, min(of[name] for of in parts)] for name in parts[0])
    )


def _rows(study: Study, out: Path) -> Iterator[list[Cell]]:
    for backend in study.options.backends[: 1 if study.fast else None]:
        found: dict[str, list[list[float]]] = {"metered": [], "there": []}
        turns = 1 if study.fast else study.options.turns
        for turn in range(turns + 1):
            for kind, each in found.items():
                times = _first_frame(out, backend, study.options.spp, kept=kind == "there")
                if turn:
                    each.append(times)
        for kind, each in found.items():
            yield [backend, kind, *min(each)]


def _first_frame(out: Path, backend: str, spp: int, kept: bool) -> list[float]:
    """Seconds until the first frame, CPU seconds in all, and the frame's by step."""
    frames = out / _STAGE.parent / FRAMES
    for path in frames.glob("*"):
        if path.is_dir():
            shutil.rmtree(path)
        elif not kept or path.name != EXPOSURES:
            path.unlink()
    words = ["render", out, "--backend", backend, "--batches", "0:1", "--samples", "0:1"]
    begun = time.time()
    cost = command([*SCENEC, *words, "--spp", str(spp)])
    sidecars = sorted(frames.glob("*/*/*.json"), key=lambda path: path.stat().st_mtime_ns)
    seconds: dict[str, float] = json.loads(sidecars[0].read_text(encoding="utf-8"))["seconds"]
    wall = sidecars[0].stat().st_mtime - begun
    return [wall, cost.cpu_s, *(seconds.get(step, 0.0) for step in _STEPS)]


def _parts(stage: Path) -> dict[str, float]:
    """CPU seconds of what a fresh process does before a frame."""
    found: dict[str, float] = {}

    def lap(name: str, work: Callable[[], Any]) -> Any:
        start = time.process_time()
        value = work()
        found[name] = time.process_time() - start
        return value

    lap("imports of a session", partial(import_module, "scenec.backends.run.session"))
    lap("numba", partial(import_module, "numba"))
    reader = import_module("scenec.backends.stage.read")
    scene = lap("reading the stage", partial(reader.read_stage, stage))
    caster = import_module("scenec.backends.exact").ExactCaster
    lap("building the caster", partial(caster, scene))
    lap("scipy.special", partial(import_module, "scipy.special"))
    lap("opening Mitsuba", partial(open_backend, "mitsuba", "cpu"))
    return found


if __name__ == "__main__":
    run(main, backends=("annotation", "pyrender", "mitsuba"), spp=16, turns=3, stage=Path)
