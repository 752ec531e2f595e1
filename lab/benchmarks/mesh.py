"""The ground's mesh: thirty cameras over a hectare, and how time and memory grow with triangles.

    python lab/benchmarks/mesh.py [--fast]

Each row is a process of its own, the fastest of three. Seconds are of the step named; memory is the
process' peak, and for the growth what of it is above that of the smallest mesh before it.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.lab.runner import Cell, Study, apart, peak_mib, run

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


def with_terrain(**terrain: Any) -> dict[str, Any]:
    """The scene with other keys of its terrain."""
    cfg = copy.deepcopy(CFG)
    cfg["terrain"] |= terrain
    return cfg


def seconds(cfg: Path, folder: Path, seed: int) -> float:
    """Wall seconds of a compilation."""
    start = time.perf_counter()
    compile_cfg(cfg, seed=seed, out=folder / str(seed))
    return time.perf_counter() - start


def built(small: Path, cfg: Path) -> tuple[float, float, float]:
    """Seconds of the ground, faces, and MiB above what the smallest one, which loads all, takes."""
    build(draw(load(small), 1, 0), BuildLog())
    before, log = peak_mib(), BuildLog()
    build(draw(load(cfg), 1, 0), log)
    return log.seconds["ground"], log.facts["ground"]["faces"], peak_mib() - before


def growth(study: Study, title: str, cfgs: list[dict[str, Any]]) -> None:
    """A series of meshes and the exponents fitted to it."""
    paths = [study.cfg(cfg, f"{title.split()[0]}{i}") for i, cfg in enumerate(cfgs)]
    found = []

    def rows() -> Iterator[list[Cell]]:
        for path in paths:
            runs = [apart(built, paths[0], path) for _ in range(1 if study.fast else 3)]
            best = min(runs, key=lambda cost: cost.value[0])
            took, faces, above = best.value
            found.append((faces, took, above))
            yield [faces, took, 1e6 * took / faces, best.peak_mib, above * 2**20 / faces]

    study.say(f"{title}:\n")
    study.table(["triangles", "ground, s", "us each", "peak, MiB", "bytes each"], rows())
    # What a mesh costs beyond the process: below some MiB nothing of it can be told.
    large = [(faces, above) for faces, _, above in found if above > 16.0]
    fitted = [("time", [row[:2] for row in found]), ("memory", large)]
    exponents = [
        f"{name} {np.polyfit(*np.log(pairs).T, 1)[0]:.2f}" for name, pairs in fitted if pairs[1:]
    ]
    steepest = max(
        math.log(b[1] / a[1]) / math.log(b[0] / a[0])
        for a, b in pairwise(found)
        if b[0] > 1.2 * a[0]
    )
    study.say(
        f"Exponents: {', '.join(exponents)}; time between neighboring rows at most {steepest:.2f} "
        "(asked: 1.1 at most).\n"
    )


def main(study: Study) -> None:
    """Prints the tables."""
    path, runs = study.cfg(CFG, "hectare"), 1 if study.fast else 3
    apart(seconds, path, study.scratch, 1)
    costs = [apart(seconds, path, study.scratch, seed) for seed in range(2, 2 + runs)]
    took = [cost.value for cost in costs]
    study.say("30 cameras of 640 x 480 over 100 m x 100 m at 0.5 px, whole compilation; asked:")
    study.say("10 s and 3072 MiB at most.\n")
    peak = max(cost.peak_mib for cost in costs)
    study.table(["s, best", "s, worst", "peak, MiB"], [[min(took), max(took), peak]])
    counts = (70, 224, 707) if study.fast else (70, 125, 224, 400, 707, 1250, 2236)
    whole = [with_terrain(spacing_m=100 / n, mesh={"tolerance_px": 0}) for n in counts]
    growth(study, "whole grid, finer and finer", whole)
    finer = [with_terrain(spacing_m=100 / n) for n in counts]
    growth(study, "adaptive to 0.5 px, on finer and finer grids", finer)


if __name__ == "__main__":
    run(main)
