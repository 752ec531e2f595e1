"""What workers bring: frames an hour with one, two, and dask; what a unit costs.

    python lab/benchmarks/workers.py [--frames N] [--backends A,B,...] [--fast]

The demo (configs/jacksboro.json) at 320×240. ``whole`` counts from the command's first moment, with
the start of workers and renderers; ``steady`` counts the second half of the frames. A unit's cost
is the mean of a thousand that do nothing.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from scenec.backends.run.executors import make_executor
from scenec.backends.run.render import render
from scenec.backends.run.units import OfBackend
from scenec.compiler.compile import compile_cfg
from scenec.lab.runner import DEMO, Cell, Study, run
from scenec.schemas.units import run_all

#: (name, --workers, --cluster)
WHO = (("1", 1, None), ("2", 2, None), ("dask 2", 2, "local"))


def compiled(folder: Path, samples: int) -> Path:
    """The demo with another resolution and number of samples."""
    cfg = json.loads(DEMO.read_text(encoding="utf-8")) | {"samples": samples, "batches": 1}
    for rig in cfg["rigs"].values():
        for sensor in rig["sensors"].values():
            sensor["resolution"] = [320, 240]
    file = folder / "cfg.json"
    file.write_text(json.dumps(cfg), encoding="utf-8")
    compile_cfg(file, seed=1, out=folder / "out")
    return folder / "out"


def frames(out: Path, backend: str, workers: int, cluster: str | None) -> tuple[float, float]:
    """Frames an hour: over the whole, and over the second half."""
    times: list[float] = []
    passes = ["label", "instance", "depth"] + ([] if backend == "annotation" else ["rgb"])
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        with make_executor(workers, cluster) as executor:
            report = render(
                out, backend, spp=16, passes=passes, folder=Path(folder), executor=executor,
                progress=lambda *_: times.append(time.perf_counter()),
            )  # fmt: skip
        whole = time.perf_counter() - start
    count, middle = report.rendered, report.rendered // 2
    return 3600 * count / whole, 3600 * (count - middle) / (times[-1] - times[middle - 1])


def cost_of_a_unit(workers: int, cluster: str | None, count: int = 1000) -> float:
    """Seconds, of one that does nothing."""
    with make_executor(workers, cluster) as executor:
        start = 0.0
        for number, _ in enumerate(run_all(executor, [OfBackend("0", exec)] * (count + 8))):
            if number == 7:
                start = time.perf_counter()
        return (time.perf_counter() - start) / count


def main(study: Study) -> None:
    """Prints the tables."""
    options = study.options
    count = 4 if study.fast else options.frames

    def rates() -> Iterator[list[Cell]]:
        out = compiled(study.scratch, count)
        for backend in options.backends:
            one = (0.0, 0.0)
            for name, *who in WHO:
                found = frames(out, backend, *who)
                one = found if name == "1" else one
                told = [
                    f"{rate:,.0f} ({rate / of:.2f})" for rate, of in zip(found, one, strict=True)
                ]
                yield [backend, name, *told, os.getloadavg()[0]]

    study.table(["backend", "workers", "frames/h whole", "frames/h steady", "load"], rates())
    units = 50 if study.fast else 1000
    study.table(
        ["workers", "ms a unit"],
        ([name, 1e3 * cost_of_a_unit(*who, units)] for name, *who in WHO),
    )


if __name__ == "__main__":
    run(main, frames=40, backends=("mitsuba", "pyrender", "annotation"))
