"""A million rocks: compiled, and rendered by every backend, each in a process of its own.

python studies/benchmarks/million.py [--count N] [--backends cycles,mitsuba,pyrender,reference]
    [--spp N] [--triangles N]

Prints the seconds and the peak memory of each step. Peak memory of a render is that of its worker.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

SCENEC = [sys.executable, "-c", "from scenec.cli.main import main; main()"]


def cfg(count: int, triangles: int | None) -> dict:
    """Rocks of Golombek and Rapp's sizes on rolling ground, 12 to the square meter."""
    side = (count / 12.0) ** 0.5
    return {
        "version": 1,
        "name": "million",
        "labels": {"class": {"sky": 1, "ground": 2, "rock": 3}},
        "terrain": {
            "size_m": [side, side],
            "spacing_m": side / 2000.0,
            "relief": [
                {"type": "plane"},
                {"type": "multifractal", "amplitude_m": 3, "scale_m": 60, "octaves": 8},
            ],
            "ground": [{"material": "sand", "labels": {"class": "ground"}}],
        },
        "materials": {
            "sand": {"base_color": [0.4, 0.25, 0.15]},
            "stone": {"base_color": [0.2, 0.14, 0.1], "variation": 0.3},
        },
        "objects": {
            "rocks": {
                "type": "rocks",
                "count": count,
                "family": "angular",
                "material": "stone",
                "labels": {"class": "rock"},
                "prototypes": 16,
                "subdivisions": 2,
                "size_m": {"type": "golombek_rapp", "k": 0.1, "min": 0.04, "max": 2},
            }
        },
        **({"object_detail": {"max_triangles": triangles}} if triangles else {}),
        "light": {"sky": {"type": "clear", "labels": {"class": "sky"}}},
        "rigs": {
            "rover": {
                "pose": {
                    "type": "random_target",
                    "position": {"x_m": 0, "y_m": -0.2 * side, "height_m": 2},
                    "target": {"distance_m": 12, "bearing_deg": 0, "height_m": 0.5},
                },
                "sensors": {"mast": {"resolution": [640, 480], "fov_deg": 60}},
            }
        },
    }


def run(command: list[str]) -> tuple[float, float]:
    """Seconds, and peak memory in GiB, of a process and those it waited for."""
    start = time.perf_counter()
    pid = os.posix_spawn(command[0], command, os.environ)
    _, status, usage = os.wait4(pid, 0)
    if status:
        raise SystemExit(f"{' '.join(command)}: exit status {os.waitstatus_to_exitcode(status)}")
    return time.perf_counter() - start, usage.ru_maxrss / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--backends", default="cycles,mitsuba,pyrender,reference")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--triangles", type=int)
    parser.add_argument("--keep", type=Path, help="folder for the output")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / "million.json"
        file.write_text(json.dumps(cfg(options.count, options.triangles)))
        out = folder / "out"
        seconds, memory = run([*SCENEC, "compile", str(file), "--seed", "1", "-o", str(out)])
        timings = json.loads((out / "timings.json").read_text())["compile"]["batch_0000"]
        report = json.loads((out / "batch_0000" / "report.json").read_text())
        rocks = report["objects"]["rocks"]
        print(
            f"compile: {seconds:.1f} s, {memory:.2f} GiB; "
            + ", ".join(f"{key} {value:.2f} s" for key, value in timings.items())
        )
        print(
            f"  {rocks['count']:,} rocks, {rocks['triangles']:,} triangles of "
            f"{rocks['triangles_finest']:,}, error {rocks['lod_error_max_px']:.2f} px; "
            f"budget {report.get('object_budget')}; {report['bytes'] / 1e6:.0f} MB"
        )
        for backend in options.backends.split(","):
            passes = (
                "label,instance,depth" if backend == "reference" else "rgb,label,instance,depth"
            )
            command = ["render", str(out), "--backend", backend, "--passes", passes]
            seconds, _ = run([*SCENEC, *command, "--spp", str(options.spp)])
            sidecar = next((out / "batch_0000" / "frames" / backend).rglob("*.json"))
            told = json.loads(sidecar.read_text())
            steps = ", ".join(f"{key} {value:.2f} s" for key, value in told["seconds"].items())
            print(
                f"{backend}: {seconds:.1f} s, {told.get('peak_memory_gb')} GB (10^9 bytes); {steps}"
            )


if __name__ == "__main__":
    main()
