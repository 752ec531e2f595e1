"""The ground's mesh: thirty cameras over a hectare, and how time and memory grow with triangles.

    python studies/benchmarks/mesh.py [--fast]

Each row is a process of its own, after one that fills numba's cache. Seconds are of the step named;
memory is the process' peak, and for the growth what of it is above that of the smallest mesh's
process before it began.
"""

from __future__ import annotations

import copy
import json
import math
import os
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

from compile import compiled

RUNS = 3
CFG: dict[str, Any] = {
    "version": 1,
    "name": "hectare",
    "samples": 30,
    "outputs": ["rgb", "label", "instance", "depth"],
    "labels": {"class": {"sky": 1, "sand": 2, "gravel": 3, "mud": 4}},
    "terrain": {
        "size_m": [100, 100],
        "spacing_m": 0.1,
        "relief": [
            {"type": "plane", "slope": [0.05, -0.02]},
            {"type": "multifractal", "amplitude_m": 1.5, "scale_m": 40, "octaves": 9, "gain": 0.45},
        ],
        "ground": [
            {"material": "sand", "labels": {"class": "sand"}},
            {"material": "gravel", "labels": {"class": "gravel"}, "noise": {"scale_m": 11},
             "coverage": 0.4},
            {"material": "mud", "labels": {"class": "mud"}, "noise": {"scale_m": 17, "octaves": 3},
             "coverage": 0.25},
        ],
        "mesh": {"tolerance_px": 0.5},
    },
    "materials": {
        "sand": {"base_color": [0.4, 0.3, 0.2], "variation": 0.2},
        "gravel": {"base_color": [0.2, 0.2, 0.2]},
        "mud": {"base_color": [0.3, 0.25, 0.2], "roughness": 0.5},
    },
    "light": {
        "sun": {"elevation_deg": 35, "azimuth_deg": 140},
        "sky": {"type": "clear", "labels": {"class": "sky"}},
    },
    "rigs": {
        "rover": {
            "pose": {
                "type": "random_target",
                "position": {
                    "x_m": {"type": "uniform", "min": -45, "max": 45},
                    "y_m": {"type": "uniform", "min": -45, "max": 45},
                    "height_m": {"type": "uniform", "min": 1, "max": 2},
                },
                "target": {"distance_m": {"type": "uniform", "min": 5, "max": 15}},
            },
            "sensors": {"eye": {"resolution": [640, 480], "fov_deg": 65}},
        }
    },
}  # fmt: skip
# Builds the scene of a cfg without writing it; the smallest one first, which loads all kernels.
_BUILD = """
import resource, sys
from scenec.compiler.build import BuildLog, build
from scenec.compiler.draw import draw
from scenec.compiler.frontend.load import load
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
build(draw(load(sys.argv[1]), 1, 0), BuildLog())
before = peak()
log = BuildLog()
build(draw(load(sys.argv[2]), 1, 0), log)
print(log.facts["ground"]["faces"], log.seconds["ground"], peak(), peak() - before)
"""


def cfg_with(**terrain: Any) -> dict[str, Any]:
    """The scene with other keys of its terrain."""
    cfg = copy.deepcopy(CFG)
    cfg["terrain"] |= terrain
    return cfg


def write(folder: Path, name: str, cfg: dict[str, Any]) -> Path:
    """Writes a cfg."""
    path = folder / f"{name}.json"
    path.write_text(json.dumps(cfg))
    return path


def built(small: Path, cfg: Path) -> tuple[int, float, float, float]:
    """Faces, seconds of the ground, peak MiB, and MiB above the small one's peak; best of runs."""
    rows = []
    for _ in range(RUNS):
        done = subprocess.run(
            [sys.executable, "-c", _BUILD, str(small), str(cfg)],
            check=True, capture_output=True, text=True,
        )  # fmt: skip
        faces, *numbers = done.stdout.split()
        rows.append((int(faces), *map(float, numbers)))
    return min(rows, key=lambda row: row[1])


def exponent(x: list[float], y: list[float]) -> float:
    """Slope of the straight line through the logarithms, by least squares."""
    u, v = [math.log(value) for value in x], [math.log(value) for value in y]
    mean_u, mean_v = sum(u) / len(u), sum(v) / len(v)
    above = sum((a - mean_u) * (b - mean_v) for a, b in zip(u, v, strict=True))
    return above / sum((a - mean_u) ** 2 for a in u)


def growth(folder: Path, title: str, cfgs: list[dict[str, Any]]) -> None:
    """Prints a series of meshes and the exponents fitted to it."""
    paths = [write(folder, f"{title.split()[0]}{i}", cfg) for i, cfg in enumerate(cfgs)]
    print(f"\n{title}\n{'triangles':>12}{'ground, s':>12}{'us each':>10}"
          f"{'peak MiB':>10}{'B each':>10}")  # fmt: skip
    rows = []
    for path in paths:
        faces, seconds, peak, above = built(paths[0], path)
        rows.append((faces, seconds, peak, above))
        print(f"{faces:12,}{seconds:12.3f}{1e6 * seconds / faces:10.2f}{peak:10.0f}"
              f"{above * 2**20 / faces:10.0f}", flush=True)  # fmt: skip
    # What a mesh costs beyond the process: below some MiB nothing of it can be told.
    large = [row for row in rows if row[3] > 16.0]
    time = exponent([row[0] for row in rows], [row[1] for row in rows])
    print(
        f"decades: {math.log10(rows[-1][0] / rows[0][0]):.1f}; exponent of time {time:.2f}", end=""
    )
    if len(large) > 1:
        memory = exponent([row[0] for row in large], [row[3] for row in large])
        print(f", of memory {memory:.2f} (from {large[0][0]:,} triangles)", end="")
    steepest = max(
        exponent([a[0], b[0]], [a[1], b[1]]) for a, b in pairwise(rows) if b[0] > 1.2 * a[0]
    )
    print(f"; time between neighboring rows at most {steepest:.2f}; asked: 1.1 at most")


def main() -> None:
    """Prints the tables."""
    fast = "--fast" in sys.argv[1:]
    cores, load = os.cpu_count(), os.getloadavg()[0]
    print(f"{cores} cores, load {load:.1f}, best of {RUNS} runs")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = write(folder, "hectare", CFG)
        compiled(str(path), name, 1)
        rows = [compiled(str(path), name, seed)[0] for seed in range(2, 3 if fast else 2 + RUNS)]
        out = next(folder.glob("*_2/batch_0000/report.json"))
        report = json.loads(out.read_text())
        print("\n30 cameras of 640 x 480 over 100 m x 100 m at 0.5 px, whole compilation")
        print(f"{'triangles':>12}{'s, best':>12}{'s, worst':>12}{'peak MiB':>10}")
        seconds, memory = [row[0] for row in rows], [row[1] for row in rows]
        print(f"{report['ground']['faces']:12,}{min(seconds):12.2f}{max(seconds):12.2f}"
              f"{max(memory):10.0f}   asked: 10 s and 3072 MiB at most")  # fmt: skip
        counts = (70, 224, 707) if fast else (70, 125, 224, 400, 707, 1250, 2236)
        growth(folder, "whole grid, finer and finer",
               [cfg_with(spacing_m=100 / n, mesh={"tolerance_px": 0}) for n in counts])  # fmt: skip
        growth(
            folder,
            "adaptive to 0.5 px, on finer and finer grids",
            [cfg_with(spacing_m=100 / n) for n in counts],
        )


if __name__ == "__main__":
    main()
