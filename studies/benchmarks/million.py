"""A million rocks: compiled, and rendered by every backend, each in a process of its own.

    python studies/benchmarks/million.py [--count N] [--backends A,B] [--spp N] [--triangles N]
                                         [--keep FOLDER] [--fast]

Seconds are of the whole command; the peak of a render is that of its worker.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scenec.studies.benchmarks.cfgs import rocks_on_hills
from scenec.studies.runner import SCENEC, Cell, Study, command, run


def cfg(count: int, triangles: int | None) -> dict[str, Any]:
    """Rocks of Golombek and Rapp's sizes on rolling ground, 12 to the square meter."""
    made = rocks_on_hills(count, (count / 12.0) ** 0.5, 2000)
    made["light"] = {"sky": made["light"]["sky"]}
    made["objects"]["rocks"] |= {
        "prototypes": 16,
        "subdivisions": 2,
        "size_m": {"type": "golombek_rapp", "k": 0.1, "min": 0.04, "max": 2},
    }
    return made | ({"object_detail": {"max_triangles": triangles}} if triangles else {})


def steps_of(seconds: dict[str, float]) -> str:
    """The steps that take long enough to tell."""
    return ", ".join(f"{name} {value:.2f} s" for name, value in seconds.items() if value > 0.01)


def main(study: Study) -> None:
    """Prints the table."""
    options = study.options
    count = 10_000 if study.fast else options.count
    folder = options.keep or study.scratch
    folder.mkdir(parents=True, exist_ok=True)
    file, out = study.cfg(cfg(count, options.triangles)), folder / "out"

    def steps() -> Iterator[list[Cell]]:
        cost = command([*SCENEC, "compile", file, "--seed", "1", "-o", out])
        timings = json.loads((out / "timings.json").read_text())["compile"]["batch_0000"]
        yield ["compile", cost.wall_s, cost.peak_mib / 1024, steps_of(timings)]
        for backend in options.backends:
            passes = "label,instance,depth" + ("" if backend == "reference" else ",rgb")
            words = ["render", out, "--backend", backend, "--passes", passes]
            cost = command([*SCENEC, *words, "--spp", str(options.spp)])
            sidecar = next((out / "batch_0000" / "frames").rglob(f"{backend}/*/*.json"), None)
            sidecar = sidecar or next((out / "batch_0000" / "frames").rglob("*.json"))
            told = json.loads(sidecar.read_text())
            peak = told.get("peak_memory_gb")
            yield [backend, cost.wall_s, peak and peak * 1e9 / 2**30, steps_of(told["seconds"])]

    study.table(["step", "s", "peak, GiB", "of these"], steps())
    report = json.loads((out / "batch_0000" / "report.json").read_text())
    rocks = report["objects"]["rocks"]
    study.say(
        f"{rocks['count']:,} rocks, {rocks['triangles']:,} triangles of "
        f"{rocks['triangles_finest']:,}, error {rocks['lod_error_max_px']:.2f} px; "
        f"budget {report.get('object_budget')}; {report['bytes'] / 1e6:.0f} MB"
    )


if __name__ == "__main__":
    backends = ("cycles", "mitsuba", "pyrender", "reference")
    run(main, count=1_000_000, backends=backends, spp=16, triangles=int, keep=Path)
