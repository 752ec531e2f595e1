"""Frames a second by backend and workers: end to end, where a frame's seconds go, what bounds it.

    python lab/benchmarks/throughput.py [--backends A,B,...] [--device NAME] [--workers N,...]
        [--frames N] [--spp N] [--width N] [--cluster local] [--fast] [-o FILE]

The demo (configs/jacksboro.json) as it is, 640×480 unless told, all that it asks for written;
compiled before; by processes, or with ``--cluster`` by dask's.
``--frames`` is for each worker; numbers of workers beyond the cores are left out. ``opened`` is
when the first worker had read the stage and started its renderer. ``in all`` counts from the first
moment, with the start of workers and renderers; ``steady`` counts the second half of the frames,
and so do CPU seconds (of all processes) and the GPU's. A phase's seconds are wall clock, the median
of all frames; ``rest`` is a worker's mean time in no phase, in the second half. What a worker does
once (``once``) is the median of the frames that did it. Last, what handing out a unit costs: the
mean of a thousand that do nothing.
"""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from collections.abc import Collection, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import psutil

from scenec.backends.run.executors import make_executor
from scenec.backends.run.render import render
from scenec.backends.run.units import OfBackend, UnitResult
from scenec.compiler.compile import compile_cfg
from scenec.lab.benchmarks.gpu import most_gib, watched
from scenec.lab.runner import DEMO, Cell, Study, apart, run
from scenec.schemas.budget import usable_cores
from scenec.schemas.passes import ANNOTATION
from scenec.schemas.units import Executor, Outcome, Take, Unit, run_all

#: Seconds a worker's first frame alone takes.
_START = ("load", "exposure")
#: What the model asks about.
_MANY_CORES = 16


@dataclass
class Case:
    """A render: when each frame was done, and what it had cost by then.

    Attributes:
        device: Where it was drawn.
        start_s: When it began, on the clock of ``done_s``.
        opened_s: When the first worker had opened the stage.
        done_s: Of each frame, in the order in which they came.
        cpu_s: CPU seconds of all processes by then.
        phases: Wall seconds by step, of each frame.
        gpu: (when, busy in percent, MiB taken), again and again.
    """

    device: str = ""
    start_s: float = 0.0
    opened_s: float = 0.0
    done_s: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)
    phases: list[dict[str, float]] = field(default_factory=list)
    gpu: list[tuple[float, float, float]] = field(default_factory=list)

    @property
    def rate(self) -> float:
        """Frames a second in all."""
        return len(self.done_s) / (self.done_s[-1] - self.start_s)

    @property
    def steady_s(self) -> float:
        """Seconds a frame of the second half."""
        return _of_second_half(self.done_s)

    @property
    def steady_cpu_s(self) -> float:
        """CPU seconds a frame of the second half."""
        return _of_second_half(self.cpu_s)

    @property
    def busy(self) -> float | None:
        """Share of the second half that the GPU was busy; None without one."""
        middle = self.done_s[len(self.done_s) // 2 - 1]
        found = [busy for when, busy, _ in self.gpu if middle <= when <= self.done_s[-1]]
        return statistics.fmean(found) / 100 if found and any(found) else None

    def rest_s(self, workers: int) -> float:
        """Seconds a frame of the second half that a worker spent in no phase."""
        late = self.phases[len(self.phases) // 2 :]
        return workers * self.steady_s - statistics.fmean(sum(of.values()) for of in late)

    def median(self, phase: str) -> float:
        """Seconds a frame; of what a worker does once, of the frames that did it."""
        found = [frame.get(phase, 0.0) for frame in self.phases]
        if phase in _START:
            found = [seconds for seconds in found if seconds > 0.01] or [0.0]
        return statistics.median(found)


def _of_second_half(sums: list[float]) -> float:
    middle = len(sums) // 2
    return (sums[-1] - sums[middle - 1]) / (len(sums) - middle)


class _Noted:
    """An executor that notes when each frame is done, and what it took."""

    def __init__(self, executor: Executor) -> None:
        self._executor, self.case = executor, Case(start_s=time.perf_counter())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._executor, name)

    def work(self, take: Take) -> Generator[tuple[Unit, Outcome]]:
        """See ``Executor``."""
        with closing(self._executor.work(take)) as ended:
            for unit, outcome in ended:
                self.case.opened_s = self.case.opened_s or time.perf_counter()
                if isinstance(outcome.value, UnitResult):
                    self.case.done_s.append(time.perf_counter())
                    self.case.cpu_s.append(_cpu_s())
                    self.case.phases.append(outcome.value.seconds)
                yield unit, outcome


def _cpu_s() -> float:
    this = psutil.Process()
    used = [process.cpu_times() for process in (this, *this.children(recursive=True))]
    return sum(times.user + times.system for times in used)


def rendered(
    out: Path, backend: str, device: str, workers: int, frames: int, spp: int, cluster: str | None
) -> Case:
    """Renders the first frames of an output into a folder that goes away."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory(dir=out) as folder, make_executor(workers, cluster) as inner:
        noted = _Noted(inner)
        noted.case.start_s = start
        report = render(
            out, backend, device=device, spp=spp, samples=range(frames), folder=Path(folder),
            executor=cast(Executor, noted),
        )  # fmt: skip
        noted.case.device = report.device
        return noted.case


def cost_of_a_unit(workers: int, cluster: str | None, count: int) -> float:
    """Milliseconds, of one that does nothing."""
    with make_executor(workers, cluster) as executor:
        start = 0.0
        for number, _ in enumerate(run_all(executor, [OfBackend("0", exec)] * (count + 8))):
            if number == 7:
                start = time.perf_counter()
        return 1e3 * (time.perf_counter() - start) / count


def compiled(study: Study, samples: int) -> Path:
    """The demo with as many samples."""
    cfg = json.loads(DEMO.read_text(encoding="utf-8")) | {"samples": samples}
    for rig in cfg["rigs"].values():
        for sensor in rig["sensors"].values():
            width, height = sensor["resolution"]
            sensor["resolution"] = [study.options.width, study.options.width * height // width]
    return compile_cfg(study.cfg(cfg), seed=1, out=study.scratch / "out").out


def main(study: Study) -> None:
    """Prints the tables."""
    options = study.options
    cores = usable_cores()
    each = 2 if study.fast else options.frames
    numbers = [n for n in options.workers if n <= cores] or [1]
    numbers = numbers[:1] if study.fast else numbers
    out = compiled(study, each * max(numbers))
    units = 50 if study.fast else 1000
    least_s: list[list[Cell]] = []
    for backend in options.backends:
        cases: dict[int, Case] = {}
        rates = _rates(study, out, backend, numbers, each, cases)
        study.table(
            ["backend", "device", "workers", "frames", "opened, s", "first frame, s",
             "frames/s in all", "frames/s steady", "CPU s a frame", "GPU busy, %",
             "of the GPU, GiB"],
            rates,
        )  # fmt: skip
        phases = dict.fromkeys(p for case in cases.values() for of in case.phases for p in of)
        steady = [phase for phase in phases if phase not in _START]
        study.table(
            ["workers", *(f"{name}, s" for name in (*steady, "rest")),
             *(f"once: {name}, s" for name in phases if name in _START)],
            (
                [workers, *map(case.median, steady), case.rest_s(workers),
                 *(case.median(phase) for phase in phases if phase in _START)]
                for workers, case in cases.items()
            ),
        )  # fmt: skip
        cpu, gpu = least(cases.values())
        bounds = (at_most(cpu, gpu, n) for n in (cores, _MANY_CORES))
        least_s.append([backend, cases[numbers[0]].device, cpu, gpu or None, *bounds])
    study.table(
        ["backend", "device", "CPU s a frame", "GPU s a frame", f"frames/s at most, {cores} cores",
         f"{_MANY_CORES} cores"],
        least_s,
    )  # fmt: skip
    study.table(
        ["workers", "ms a unit that does nothing"],
        ([n, cost_of_a_unit(n, options.cluster, units)] for n in numbers),
    )


def _rates(
    study: Study, out: Path, backend: str, numbers: list[int], each: int, cases: dict[int, Case]
) -> Iterator[list[Cell]]:
    """Renders with each number of workers; fills ``cases``."""
    options = study.options
    device = "auto" if backend == ANNOTATION else options.device
    for workers in numbers:
        with watched() as taken:
            frames = each * workers
            how = (device, workers, frames, options.spp, options.cluster)
            cost = apart(rendered, out, backend, *how)
        case = cases[workers] = cost.value
        case.gpu = taken
        yield [
            backend, case.device, workers, frames, case.opened_s - case.start_s,
            case.done_s[0] - case.start_s, case.rate, 1.0 / case.steady_s, case.steady_cpu_s,
            None if case.busy is None else 100 * case.busy, most_gib(taken) or None,
        ]  # fmt: skip


def least(cases: Collection[Case]) -> tuple[float, float]:
    """The least CPU and GPU seconds a frame of some cases."""
    gpu = [case.busy * case.steady_s for case in cases if case.busy is not None]
    return min(case.steady_cpu_s for case in cases), min(gpu, default=0.0)


def at_most(cpu_s: float, gpu_s: float, cores: int) -> float:
    """Frames a second of cores and a GPU that never wait for one another."""
    return min(cores / cpu_s, 1.0 / gpu_s if gpu_s else float("inf"))


if __name__ == "__main__":
    run(
        main, backends=("annotation", "pyrender", "mitsuba"), device="auto",
        workers=(1, 2, 4, 8, 16), frames=8, spp=16, width=640, cluster=str,
    )  # fmt: skip
