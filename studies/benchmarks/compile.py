"""Compile of the 30,000-rock, 100 m x 100 m scene: seconds and memory, another seed, and --help.

    python studies/benchmarks/compile.py [--cfg FILE] [--fast]

Each row is a process of its own, after one that fills numba's cache. "Another seed" must cost what
the first costs: nothing is remembered between compilations.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path

from scenec.compiler.compile import compile_cfg
from scenec.studies.runner import DEMO, SCENEC, Study, apart, command, run


def seconds(cfg: Path, folder: Path, *seeds: int) -> list[float]:
    """Wall seconds of one compilation after the other in this process."""
    found = []
    for seed in seeds:
        start = time.perf_counter()
        compile_cfg(cfg, seed=seed, out=folder / str(time.monotonic_ns()))
        found.append(time.perf_counter() - start)
    return found


def main(study: Study) -> None:
    """Prints the table."""
    cfg, runs = study.options.cfg, 1 if study.fast else 5
    apart(seconds, cfg, study.scratch, 0)
    both = [apart(seconds, cfg, study.scratch, 2 * i + 1, 2 * i + 2) for i in range(runs)]
    words = [*SCENEC, "compile", cfg, "--no-cache", "-o"]
    whole = [
        command([*words, study.scratch / f"cli{i}", "--seed", str(i)]).wall_s for i in range(runs)
    ]
    found = {
        "first compile of a process, s": [cost.value[0] for cost in both],
        "second, another seed, s": [cost.value[1] for cost in both],
        "peak memory of both, MiB": [cost.peak_mib for cost in both],
        "whole process `scenec compile`, s": whole,
        "`scenec --help`, s": [command([*SCENEC, "--help"]).wall_s for _ in range(runs)],
    }
    rows = ([name, statistics.median(v), min(v), max(v)] for name, v in found.items())
    study.table([f"{cfg.name}, {runs} runs", "median", "min", "max"], rows)


if __name__ == "__main__":
    run(main, cfg=DEMO)
