"""Peak memory of compiling, measured against what ``compiler/estimate.py`` says before.

python benchmarks/bench_memory.py [SCENE ...] [--cfgs]

Each scene makes one key large; ``--cfgs`` adds the shipped cfgs. Each is compiled in a process of
its own, whose peak is the kernel's count. Prints a table.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import hills

from scenec.compiler.estimate import BASE_BYTES, needs_of
from scenec.compiler.frontend.load import load


def cfg(count: int = 0, cells: int = 200, **change: Any) -> dict[str, Any]:
    """Rocks on 100 m of hills, of a number of cells along each side."""
    sizes = {"type": "uniform", "min": 0.04, "max": 0.1}
    return hills.cfg(100.0, 100.0 / cells, {"count": count, "size_m": sizes}, **change)


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


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="some of them; all if none is given")
    parser.add_argument("--cfgs", action="store_true")
    options = parser.parse_args()
    hills.table("scene", "estimated, GB", "measured, GB", "off")
    with tempfile.TemporaryDirectory() as scratch:
        files = {}
        for name, made in scenes().items():
            if not options.scenes or name in options.scenes:
                files[name] = Path(scratch, f"{len(files)}.json")
                files[name].write_text(json.dumps(made), encoding="utf-8")
        if options.cfgs:
            files |= {file.stem: file for file in sorted((hills.ROOT / "configs").glob("*.json"))}
        for number, (name, file) in enumerate(files.items()):
            said = BASE_BYTES + sum(need.bytes for need in needs_of(load(file), 1, 0))
            words = ["compile", file, "--seed", "1", "-o", Path(scratch, f"out{number}")]
            held = hills.run([*words, "--batches", "0:1", "--no-cache"])
            hills.row(
                name, f"{said / 1e9:.2f}", f"{held / 1e9:.2f}", f"{100 * (said / held - 1):+.0f} %"
            )


if __name__ == "__main__":
    main()
