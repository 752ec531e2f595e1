"""A million of each kind: compiled, and rendered by every backend, each in a process of its own.

python benchmarks/bench_million.py [--count N] [--kinds rocks,finest,trees] [--spp N]
    [--backends cycles,mitsuba,pyrender,reference] [--keep FOLDER]

*rocks* have levels of detail, of *finest* and *trees* (oaks, birches, spruces) each is as it was
made (``lod_px`` 0). Prints the seconds and the peak memory of each step, and what loading was
estimated to take. Peak memory of a render is that of its worker.
"""

from __future__ import annotations

import argparse
import importlib
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import hills

from scenec.backends.stage.read import read_stage

ADAPTERS = {"cycles": "Cycles", "mitsuba": "Mitsuba", "pyrender": "Pyrender"}


def cfg(kind: str, count: int) -> dict[str, Any]:
    """Rocks of Golombek and Rapp's sizes, 12 to the square meter; or trees, a hundredth of that."""
    side = (count / (0.12 if kind == "trees" else 12.0)) ** 0.5
    things: dict[str, Any] = {
        "count": count,
        "prototypes": 16,
        "subdivisions": 3 if kind == "finest" else 2,
        "size_m": {"type": "golombek_rapp", "k": 0.1, "min": 0.04, "max": 2},
    }
    if kind == "finest":
        things["lod_px"] = 0
    made = hills.cfg(side, side / 500.0, things)
    if kind == "trees":
        models = [hills.ROOT / f"assets/models/{name}.glb" for name in ("oak", "birch", "spruce")]
        made["objects"]["rocks"] = {
            "type": "meshes",
            "models": [{"file": str(file)} for file in models],
            "labels": {"class": "rock"},
            "count": count,
            "lod_px": 0,
        }
        del made["materials"]["stone"]
    return made


def estimate(stage: Path, backend: str) -> str:
    """What its adapter says of loading a stage."""
    if backend not in ADAPTERS:
        return ""
    module = importlib.import_module(f"scenec.backends.{backend}.adapter")
    size, what = getattr(module, ADAPTERS[backend]).load_cost.of(read_stage(stage))
    return f"{size / 1e9:.2f} GB for {what}"


def main() -> None:
    """Prints what the module says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--kinds", default="rocks,finest,trees")
    parser.add_argument("--backends", default="cycles,mitsuba,pyrender,reference")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--keep", type=Path, help="folder for the output")
    options = parser.parse_args()
    hills.table("kind", "step", "seconds", "peak, GB", "of which")
    with tempfile.TemporaryDirectory() as temporary:
        for kind in options.kinds.split(","):
            folder = (options.keep or Path(temporary)) / kind
            folder.mkdir(parents=True, exist_ok=True)
            file, out = folder / "hills.json", folder / "out"
            file.write_text(json.dumps(cfg(kind, options.count)))
            start = time.perf_counter()
            held = hills.run(["compile", file, "--seed", "1", "-o", out, "--no-cache"])
            seconds = time.perf_counter() - start
            report = json.loads((out / "batch_0000/report.json").read_text())
            said = report["objects"]["rocks"]
            what = f"{said['triangles']:,} triangles, {report['bytes'] / 1e6:.0f} MB"
            hills.row(kind, "compile", f"{seconds:.1f}", f"{held / 1e9:.2f}", what)
            for backend in filter(None, options.backends.split(",")):
                render(kind, out, backend, options.spp)


def render(kind: str, out: Path, backend: str, spp: int) -> None:
    """A line of the table."""
    color = "" if backend == "reference" else "rgb,"
    words = ["render", out, "--backend", backend, "--passes", f"{color}label,instance,depth"]
    start = time.perf_counter()
    try:
        hills.run([*words, "--spp", str(spp)])
    except SystemExit as error:
        hills.row(
            kind, backend, "", "", f"{error}; {estimate(out / 'batch_0000/stage.usda', backend)}"
        )
        return
    seconds = time.perf_counter() - start
    sidecar = next((out / "batch_0000/frames" / backend).rglob("*.json"))
    told = json.loads(sidecar.read_text())
    steps = ", ".join(f"{key} {value:.2f} s" for key, value in told["seconds"].items())
    said = estimate(out / "batch_0000/stage.usda", backend)
    hills.row(kind, backend, f"{seconds:.1f}", f"{told.get('peak_memory_gb')}", f"{steps}; {said}")


if __name__ == "__main__":
    main()
