"""Peak memory of compiling, measured against what ``compiler/estimate.py`` says before.

python studies/benchmarks/memory.py [SCENE ...] [--cfgs]

Each scene makes one key large; ``--cfgs`` adds the shipped cfgs. Each is compiled in a process of
its own, whose peak is the kernel's count. Prints a table.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from scenec.compiler.estimate import BASE_BYTES, needs_of
from scenec.compiler.frontend.load import load

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SCENEC = [sys.executable, "-c", "from scenec.cli.main import main; main()", "compile"]


def cfg(count: int = 0, cells: int = 200, **change: Any) -> dict[str, Any]:
    """Rocks on 100 m of hills, of a number of cells along each side."""
    base: dict[str, Any] = {
        "version": 1,
        "name": "memory",
        "labels": {"class": {"sky": 1, "ground": 2, "rock": 3}},
        "terrain": {
            "size_m": [100, 100],
            "spacing_m": 100 / cells,
            "relief": [
                {"type": "plane"},
                {"type": "multifractal", "amplitude_m": 3, "scale_m": 60, "octaves": 8},
            ],
            "ground": [{"material": "sand", "labels": {"class": "ground"}}],
        },
        "materials": {
            "sand": {"base_color": [0.4, 0.25, 0.15]},
            "stone": {"base_color": [0.2, 0.14, 0.1]},
        },
        "objects": {
            "rocks": {
                "type": "rocks",
                "count": count,
                "family": "angular",
                "material": "stone",
                "labels": {"class": "rock"},
                "size_m": {"type": "uniform", "min": 0.04, "max": 0.1},
            }
        },
        "light": {
            "sun": {"elevation_deg": 40},
            "sky": {"type": "clear", "labels": {"class": "sky"}},
        },
        "rigs": {
            "rover": {
                "pose": {
                    "type": "random_target",
                    "position": {"x_m": 0, "y_m": -20, "height_m": 2},
                    "target": {"distance_m": 12, "bearing_deg": 0, "height_m": 0.5},
                },
                "sensors": {"mast": {"resolution": [640, 480], "fov_deg": 60}},
            }
        },
    }
    return base | change


def scenes() -> dict[str, dict[str, Any]]:
    """By name."""
    found = {f"{n:,} rocks": cfg(n) for n in (100_000, 1_000_000, 3_000_000)}
    found["4 million height samples"] = cfg(cells=2000)
    whole = found["4 million height samples, all kept"] = cfg(cells=2000)
    whole["terrain"] = whole["terrain"] | {"mesh": {"tolerance_px": 0}}
    two = found["4 million height samples, two layers"] = cfg(cells=2000)
    layer = {"material": "stone", "labels": {"class": "rock"}, "noise": {"scale_m": 5}}
    two["terrain"] = two["terrain"] | {"ground": [*two["terrain"]["ground"], layer]}
    sky = {"type": "clear", "labels": {"class": "sky"}}
    found["a sky of 2048 rows"] = cfg(light={"sky": sky | {"resolution": 2048}})
    sun = {"elevation_deg": {"type": "uniform", "min": 10, "max": 80}}
    found["20 skies of 512 rows"] = cfg(
        samples=20,
        light={"sun": sun, "sky": sky | {"type": "atmosphere", "resolution": 512}},
    )
    found["10,000 samples"] = cfg(samples=10_000)
    return found


def peak_bytes(file: Path, out: Path) -> int:
    """Of a process that compiles a cfg."""
    command = [*SCENEC, str(file), "--seed", "1", "-o", str(out), "--batches", "0:1", "--no-cache"]
    with open(os.devnull, "w") as silence:
        actions = [(os.POSIX_SPAWN_DUP2, silence.fileno(), 2)]
        pid = os.posix_spawn(command[0], command, os.environ, file_actions=actions)
        _, status, usage = os.wait4(pid, 0)
    if status:
        raise SystemExit(f"{file}: exit status {os.waitstatus_to_exitcode(status)}")
    return 1024 * usage.ru_maxrss


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="some of them; all if none is given")
    parser.add_argument("--cfgs", action="store_true")
    options = parser.parse_args()
    print("| scene | estimated, GB | measured, GB | off |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as scratch:
        files = {}
        for name, made in scenes().items():
            if not options.scenes or name in options.scenes:
                files[name] = Path(scratch, f"{len(files)}.json")
                files[name].write_text(json.dumps(made), encoding="utf-8")
        if options.cfgs:
            files |= {file.stem: file for file in sorted(CONFIGS.glob("*.json"))}
        for number, (name, file) in enumerate(files.items()):
            said = BASE_BYTES + sum(need.bytes for need in needs_of(load(file), 1, 0))
            held = peak_bytes(file, Path(scratch, f"out{number}"))
            row = (
                f"| {name} | {said / 1e9:.2f} | {held / 1e9:.2f} | {100 * (said / held - 1):+.0f} %"
            )
            print(f"{row} |", flush=True)


if __name__ == "__main__":
    main()
