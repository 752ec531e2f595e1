"""Compile of the 30,000-rock, 100 m x 100 m scene: seconds and memory, another seed, and --help.

    python studies/benchmarks/compile.py [CFG]

Each row is a process of its own, after one that fills numba's cache. "Another seed" must cost what
the first costs: nothing is remembered between compilations.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
RUNS = 5
_IN_PROCESS = """
import resource, sys, time
from scenec.compiler.compile import compile_cfg
for seed in map(int, sys.argv[3:]):
    start = time.perf_counter()
    compile_cfg(sys.argv[1], seed=seed, out=sys.argv[2] + str(seed))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{time.perf_counter() - start:.3f} {peak:.0f}")
"""


def compiled(cfg: str, folder: str, *seeds: int) -> list[tuple[float, float]]:
    """(seconds, peak MiB) of each compilation, all in one process."""
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            _IN_PROCESS,
            cfg,
            f"{folder}/{time.monotonic_ns()}_",
            *map(str, seeds),
        ],
        check=True,
        capture_output=True,
        text=True,
    )
    rows = [line.split() for line in done.stdout.splitlines()]
    return [(float(seconds), float(peak)) for seconds, peak in rows]


def seconds_of(command: list[str]) -> float:
    """Wall seconds of a process."""
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - start


def main() -> None:
    """Prints the table."""
    cfg = sys.argv[1] if len(sys.argv) > 1 else str(ROOT / "configs" / "jacksboro.json")
    scenec = str(Path(sys.executable).parent / "scenec")
    rows: dict[str, list[float]] = {
        "first compile of a process, s": [],
        "second, another seed, s": [],
        "peak memory, MiB": [],
        "whole process `scenec compile`, s": [],
        "`scenec --help`, s": [],
    }
    with tempfile.TemporaryDirectory() as folder:
        compiled(cfg, folder, 0)
        for run in range(RUNS):
            (first, _), (second, peak) = compiled(cfg, folder, 2 * run + 1, 2 * run + 2)
            whole = [scenec, "compile", cfg, "--seed", str(run), "-o", f"{folder}/cli{run}"]
            for name, value in zip(
                rows,
                (first, second, peak, seconds_of(whole), seconds_of([scenec, "--help"])),
                strict=True,
            ):
                rows[name].append(value)
    print(f"{Path(cfg).name}, {os.cpu_count()} cores, {RUNS} runs")
    print(f"{'':36}{'median':>9}{'min':>9}{'max':>9}")
    for name, values in rows.items():
        middle = statistics.median(values)
        print(f"{name:36}{middle:9.2f}{min(values):9.2f}{max(values):9.2f}")


if __name__ == "__main__":
    main()
