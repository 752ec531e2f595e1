"""Makes the tables of docs/head_to_head.md: two workloads of other tools, phase by phase.

    python lab/experiments/head_to_head.py [--fast] [--full] [--only A,B] [--backends A,B]
        [--work FOLDER] [-o FOLDER]

The workload of the OAISYS paper and a scene of BlenderProc, each compiled and rendered in a process
of its own by every backend; it takes some minutes on two cores. ``--full`` renders every frame of
the longer rendering that measures how noise falls, not the first alone. ``--work`` keeps what was
compiled, rendered and measured, and goes on where an earlier run left off; ``--only`` and
``--backends`` choose what is measured, and the page has whatever is there. Needs the extras of the
backends. What other tools take is stated, not measured: they are not among the packages.
"""

from __future__ import annotations

import json
import math
import resource
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

from scenec.backends.run.executors import make_executor
from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.lab.benchmarks.cfgs import rocks_on_hills
from scenec.lab.runner import Cell, Page, apart, names, peak_mib, run
from scenec.schemas.errors import ScenecError
from scenec.schemas.frames import read_frame

SEED = 1
BACKENDS = ("cycles", "mitsuba", "pyrender")
#: Samples per pixel, and those of the rendering beside it that measures how noise falls.
SPP, MORE = 16, 64
#: Steps of a frame's sidecar that have a column of their own; the others are annotation.
STEPS = ("load", "radiance", "write")
PHASES = ("compile", "start", "load", "radiance", "annotation", "write")


@dataclass(frozen=True)
class Workload:
    """What is rendered.

    Attributes:
        name: For options, files, and numbers of the page.
        cfg: What is compiled.
        stated: Rows of other tools: name, CPU s a sample, CPU s in all, peak in GB, where known.
        aims: CPU s a sample with start and compile, by backend.
    """

    name: str
    cfg: dict[str, Any]
    stated: tuple[tuple[str, float, float | None, float | None], ...]
    aims: dict[str, float]


#: Five classes of ground out of seven merged textures, 30,000 rocks of 16 models, five samples; a
#: camera two meters above 100 m of relief, under a sky that each sample draws anew.
PAPER = Path(__file__).with_name("paper_workload.json")

WORKLOADS = (
    Workload(
        "paper",
        json.loads(PAPER.read_text(encoding="utf-8")),
        (
            ("OAISYS, adaptive subdivision", 188.0, None, None),
            ("OAISYS, without it", 26.0, None, None),
        ),
        {"cycles": 5.0, "mitsuba": 2.5},
    ),
    Workload(
        "blenderproc",
        rocks_on_hills(30_000, samples=3, outputs=["rgb", "instance", "depth"]),
        (("BlenderProc 2.8", 67.0 / 3.0, 67.0, 2.4),),
        {},
    ),
)


def compiled(file: Path, out: Path) -> tuple[float, float]:
    """Compiles a cfg; CPU seconds of the whole process, and the most that it held, GB."""
    compile_cfg(file, seed=SEED, out=out)
    return _spent()


def rendered(out: Path, backend: str, spp: int, first: bool) -> dict[str, Any]:
    """Renders an output in this process; CPU seconds by step, peak in GB and stated errors."""
    # Steps are timed by the wall clock: here it is that of the process's CPU.
    with patch("time.perf_counter", time.process_time):
        report = render(
            out,
            backend,
            spp=spp,
            samples=range(1) if first else None,
            folder=out / f"{backend}_{spp}",
            executor=make_executor(0),
        )
    if report.failed:
        raise ScenecError(f"{backend}: {'; '.join(report.failed)}")
    found = dict.fromkeys(PHASES[1:], 0.0)
    for step, seconds in report.seconds.items():
        found[step if step in STEPS else "annotation"] += seconds
    errors = [read_frame(stem).sidecar.error.relative_rms for stem in report.frames]
    total, peak = _spent()
    found["start"] = total - sum(found.values())
    return {"phases": found, "total": total, "peak": peak, "errors": errors}


def _spent() -> tuple[float, float]:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + used.ru_utime + used.ru_stime, peak_mib() * 2**20 / 1e9


class Comparison:
    """Measures, each thing once, and tells.

    Args:
        page: Where it is told.
    """

    def __init__(self, page: Page) -> None:
        self.page = page
        self.work: Path = page.options.work or page.scratch
        self.work.mkdir(parents=True, exist_ok=True)

    def measure(self, one: Workload) -> None:
        """Compiles and renders what was not measured before."""
        out = self.work / one.name
        if not self.found(one, "compile"):
            file = self.work / f"{one.name}.json"
            file.write_text(json.dumps(self.smaller(one.cfg), indent=1), encoding="utf-8")
            cpu, peak = apart(compiled, file, out).value
            self.keep(one, "compile", {"cpu": cpu, "peak": peak})
        for backend in self.page.options.backends or BACKENDS:
            for spp in (SPP, MORE):
                is_noisy = backend != "pyrender" or spp == SPP
                if is_noisy and not self.found(one, f"{backend}_{spp}"):
                    first = spp == MORE and not self.page.options.full
                    work = apart(rendered, out, backend, spp, first)
                    self.keep(one, f"{backend}_{spp}", work.value)

    def smaller(self, cfg: dict[str, Any]) -> dict[str, Any]:
        """The cfg, or with ``--fast`` one of few rocks and pixels."""
        if not self.page.fast:
            return cfg
        cfg = json.loads(json.dumps(cfg))
        cfg["objects"]["rocks"]["count"] = 300
        cfg["rigs"]["rover"]["sensors"]["mast"]["resolution"] = [64, 48]
        return cfg

    def keep(self, one: Workload, what: str, value: dict[str, Any]) -> None:
        """Keeps what was measured."""
        file = self.work / f"{one.name}_{what}.json"
        file.write_text(json.dumps(value), encoding="utf-8")

    def found(self, one: Workload, what: str) -> dict[str, Any] | None:
        """What was measured."""
        file = self.work / f"{one.name}_{what}.json"
        return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else None

    def tell(self, one: Workload) -> None:
        """Fills the two tables of a workload; they stay where it was not measured."""
        frames, compile_cost = int(one.cfg["samples"]), self.found(one, "compile")
        if compile_cost is None:
            self.page.rows(None)
            self.page.rows(None)
            return
        rows: list[list[Cell]] = []
        noise: list[list[Cell]] = []
        aims = []
        all_found = {b: self.found(one, f"{b}_{SPP}") for b in BACKENDS}
        goal = min((_rms(f["errors"]) for f in all_found.values() if f and _rms(f["errors"])),
                   default=0.0)  # fmt: skip
        for backend, found in all_found.items():
            if found is None:
                continue
            phases = {"compile": compile_cost["cpu"], **found["phases"]}
            total = sum(phases.values())
            error, peak = _rms(found["errors"]), max(found["peak"], compile_cost["peak"])
            rows.append([
                f"`--backend {backend}`", *(phases[name] for name in PHASES), total,
                total / frames, peak, _percent(error),
            ])  # fmt: skip
            if error:
                noise.append(self.equal(one, backend, found, total / frames, goal))
            if backend in one.aims:
                aim = one.aims[backend]
                met = "met" if total / frames <= aim else "missed"
                aims.append(f"{backend} {aim:g}: {met}")
        for name, each, total, peak in one.stated:
            dashes: list[Cell] = [None] * len(PHASES)
            rows.append([f"*{name}*", *dashes, total, each, peak, None])
        self.page.rows(rows)
        self.page.rows(noise)
        self.page.value(f"{one.name}_noise", _percent(goal) or "-")
        if aims:
            self.page.value(f"{one.name}_aims", "; ".join(aims))

    def equal(
        self, one: Workload, backend: str, found: dict[str, Any], each: float, goal: float
    ) -> list[Cell]:
        """What frames as clean as the cleanest cost, by the slope between two renderings."""
        more, frames = self.found(one, f"{backend}_{MORE}"), int(one.cfg["samples"])
        error, slope, shown = _rms(found["errors"]), 0.5, "1/√n, assumed"
        clean = None
        if more is not None and (clean := _rms(more["errors"])):
            before = _rms(found["errors"][: len(more["errors"])])
            slope = math.log(before / clean) / math.log(MORE / SPP)
            shown = f"n^-{slope:.2f}"
        times = (error / goal) ** (1.0 / slope)
        radiance = found["phases"]["radiance"] / frames
        return [
            f"`--backend {backend}`", _percent(error), _percent(clean), shown,
            SPP * times, radiance * times, each + radiance * (times - 1.0),
        ]  # fmt: skip


def _percent(error: float | None) -> str | None:
    return f"{100.0 * error:.3g} %" if error else None


def _rms(errors: list[float | None]) -> float:
    known = [error for error in errors if error]
    return math.sqrt(sum(e * e for e in known) / len(known)) if known else 0.0


def main(page: Page) -> None:
    """Measures, and refreshes the page."""
    both = Comparison(page)
    for one in WORKLOADS:
        if not page.options.only or one.name in page.options.only:
            both.measure(one)
    for one in WORKLOADS:
        both.tell(one)
    page.refresh(("mitsuba", "bpy", "pyrender-maintained"), ())


if __name__ == "__main__":
    run(main, page="head_to_head", only=names, backends=names, full=False, work=Path)
