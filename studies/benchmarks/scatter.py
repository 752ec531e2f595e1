"""Scattering: how long objects take to be placed and seated, and how much memory that needs.

python studies/benchmarks/scatter.py [--count 30000,100000,300000,1000000] [--subdivisions 1]
                                   [--json FILE]

Each case runs in a process of its own, whose peak memory is that of drawing, placing and seating
alone (terrain and compiled kernels come off it). The overlap-free
case has radii that cover about a quarter of the terrain.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from typing import Any

import numpy as np

from scenec.compiler.frontend.fill import fill
from scenec.compiler.frontend.streams import Streams
from scenec.compiler.ground.surface import Surface
from scenec.compiler.scatter.draw import draw_rocks
from scenec.compiler.scatter.draw_scatter import Setting
from scenec.compiler.scatter.lay import lay
from scenec.compiler.scatter.rocks import build_chains
from scenec.compiler.scatter.surroundings import Surroundings
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.multifractal import Multifractal

_SIZE = 400.0
CASES: dict[str, dict[str, Any]] = {
    "uniform": {},
    "noise": {"density": {"type": "noise", "scale_m": 20}},
    "clusters": {"density": {"type": "clusters", "parents": 200, "sigma_m": 4}},
    "slope": {"where": [{"type": "slope", "max_deg": 20, "softness_deg": 5}]},
    "overlap-free": {"apart": {}},
}


def rocks(count: int, subdivisions: int, case: dict[str, Any]) -> dict[str, Any]:
    """One class in full."""
    largest = 0.5 * _SIZE / max(count, 1) ** 0.5
    thing = {
        "type": "rocks",
        "count": count,
        "material": "stone",
        "subdivisions": subdivisions,
        "size_m": {"type": "power_law", "exponent": 2.5, "min": 0.2 * largest, "max": 4 * largest},
        **case,
    }
    terrain = {"size_m": [_SIZE, _SIZE], "spacing_m": 0.4, "relief": [], "ground": [{}]}
    cfg = {"terrain": terrain, "objects": {"rocks": thing}, "materials": {}, "rigs": {}}
    filled: dict[str, Any] = fill(cfg)["objects"]["rocks"]
    return filled


def measure(count: int, subdivisions: int, name: str) -> dict[str, Any]:
    """Seconds of each step and peak memory, in this process."""
    grid = Grid.with_spacing((_SIZE, _SIZE), 0.4)
    relief = Multifractal(1, 3.0, 40.0, 8, 2.0, 0.5, "fbm", 0.7)
    surface = Surface(HeightField(grid, relief.apply(grid, np.zeros(grid.shape))[0]))
    cameras = np.array([[x, 0.0, 2.0] for x in np.linspace(-100, 100, 100)])
    setting = Setting(size_m=(_SIZE, _SIZE))

    def once(n: int) -> tuple[dict[str, float], int]:
        cfg = rocks(n, subdivisions, CASES[name])
        start = time.perf_counter()
        plan = draw_rocks("rocks", cfg, {}, Streams(1, 0), setting)
        drawn = time.perf_counter()
        chains = build_chains(plan.source.shapes, coarser=False)
        built = time.perf_counter()
        facts: dict[str, Any] = {}
        scatter = lay(plan, chains, Surroundings(surface, cameras), facts)
        end = time.perf_counter()
        seconds = {"draw_s": drawn - start, "shapes_s": built - drawn, "lay_s": end - built}
        return seconds, scatter.count

    once(100)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    seconds, placed = once(count)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "case": name,
        "count": placed,
        **{key: round(value, 4) for key, value in seconds.items()},
        "peak_mb": round(after / 1024),
        "more_mb": round((after - before) / 1024),
    }


def main() -> None:
    """Runs all cases and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--count", default="30000,100000,300000,1000000")
    parser.add_argument("--subdivisions", type=int, default=1)
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--json")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(int(arguments.count), arguments.subdivisions, arguments.one)))
        return
    rows = []
    head = ("case", "count", "draw_s", "shapes_s", "lay_s", "peak_mb", "more_mb")
    print("  ".join(f"{key:>12}" for key in head))
    for name in arguments.cases.split(","):
        for count in arguments.count.split(","):
            done = subprocess.run(
                [
                    sys.executable, __file__, "--one", name, "--count", count,
                    "--subdivisions", str(arguments.subdivisions),
                ],
                capture_output=True, text=True, check=True,
            )  # fmt: skip
            row = json.loads(done.stdout.splitlines()[-1])
            rows.append(row)
            print("  ".join(f"{row[key]:>12}" for key in head), flush=True)
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:
            json.dump(rows, file, indent=1)


if __name__ == "__main__":
    main()
