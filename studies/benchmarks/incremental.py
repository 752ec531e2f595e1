"""Incremental compilation: seconds after a change, against those from scratch, and what was made.

    python studies/benchmarks/incremental.py [--verify] [--batches N] [CFG ...]

Each compilation is a process of its own, into a folder of its own (but "same folder"), after one
that fills numba's cache; CPU seconds are those of ``compile_cfg``, wall seconds too, "process" is
the CPU of all of it, imports included. Ratios are of CPU seconds: they bear a busy machine better.
Changes are made to the cfg that filled the cache: an object class's count by 5 % (the middle class,
and the costliest), the sun to 33 degrees, the first ground material 10 % darker, cameras 10 cm up.
The code must stay as it is meanwhile: an edit of the compiler is another key for all steps.
With ``--verify`` each is compiled from scratch, too, and every byte compared.
"""

from __future__ import annotations

import argparse
import copy
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
CFGS = ("landing_site", "mars_yard", "meadow_edge", "jacksboro", "lunar_mare", "volcanic_desert")
_IN_PROCESS = """
import json, resource, sys, time
from scenec.compiler.compile import compile_cfg
cfg, out, cache, batches = sys.argv[1:]
def cpu():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime
first, start = cpu(), time.perf_counter()
report = compile_cfg(cfg, seed=1, out=out, cache=cache or None, batches=range(int(batches)))
now = cpu()
print(json.dumps({
    "cpu": now - first, "wall": time.perf_counter() - start, "process": now,
    "made": sorted({name for steps in report.made.values() for name in steps}),
    "seconds": report.seconds,
}))
"""


def compiled(cfg: Path, out: Path, cache: Path | None, batches: int) -> dict[str, Any]:
    """One compilation, and what it cost."""
    done = subprocess.run(
        [sys.executable, "-c", _IN_PROCESS, cfg, out, str(cache or ""), str(batches)],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    report: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return report


def counted(cfg: dict[str, Any]) -> list[str]:
    """Classes of objects whose number the cfg says."""
    return [
        name
        for name, one in cfg["objects"].items()
        if any(isinstance(one.get(key), int | float) for key in ("count", "per_m2"))
    ]


def changes(cfg: dict[str, Any], costliest: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Cfgs with one thing changed, and what it is."""
    scattered = counted(cfg)
    for name in dict.fromkeys((scattered[len(scattered) // 2], costliest)):
        changed = copy.deepcopy(cfg)
        one = changed["objects"][name]
        key = "count" if isinstance(one.get("count"), int) else "per_m2"
        if isinstance(one.get(key), int):
            one[key] = max(one[key] + 1, round(one[key] * 1.05))
        else:
            one[key] *= 1.05
        yield f"objects/{name}", changed
    changed = copy.deepcopy(cfg)
    changed["light"]["sun"]["elevation_deg"] = 33.0
    yield "sun", changed
    changed = copy.deepcopy(cfg)
    color = changed["materials"][cfg["terrain"]["ground"][0]["material"]]["base_color"]
    color[:] = [0.9 * part for part in color]
    yield "color of a material", changed
    changed = copy.deepcopy(cfg)
    for rig in changed["rigs"].values():
        height = rig["pose"]["position"]["height_m"]
        height["max"] += 0.1
    yield "cameras moved", changed


def hashes(out: Path) -> dict[str, str]:
    """Of all files of a manifest but the cfg's text and what is told of it."""
    files = json.loads((out / "manifest.json").read_text(encoding="utf-8"))["files"]
    return {path: entry["sha256"] for path, entry in files.items()}


def measured(name: str, batches: int, verify: bool, folder: Path) -> None:
    """Prints the table of one cfg."""
    # Beside what it names: files that are given by their place.
    for entry in ROOT.iterdir():
        if entry.is_dir() and not entry.name.startswith(".") and entry.name != "configs":
            link = folder / entry.name
            if not link.exists():
                link.symlink_to(entry)
    place = folder / "configs" / f"{name}.json"
    place.parent.mkdir(exist_ok=True)
    text = (ROOT / "configs" / f"{name}.json").read_text(encoding="utf-8")
    cfg = json.loads(text)
    cache = folder / f"cache_{name}"
    batches = min(batches, int(cfg.get("batches", 1)))
    place.write_text(text, encoding="utf-8")
    scratch = compiled(place, folder / f"{name}_scratch", None, batches)
    filled = compiled(place, folder / f"{name}_filled", cache, batches)
    assert hashes(folder / f"{name}_scratch") == hashes(folder / f"{name}_filled")
    rows = [("from scratch", scratch), ("from scratch, filling", filled)]
    rows.append(
        ("nothing, same folder", compiled(place, folder / f"{name}_filled", cache, batches))
    )
    rows.append(("nothing, new folder", compiled(place, folder / f"{name}_again", cache, batches)))
    seconds = scratch["seconds"]["batch_0000"]
    scattered = counted(cfg)
    costliest = max(scattered, key=lambda n: seconds[f"objects/{n}"])
    for i, (what, changed) in enumerate(changes(cfg, costliest)):
        place.write_text(json.dumps(changed), encoding="utf-8")
        row = compiled(place, folder / f"{name}_{i}", cache, batches)
        rows.append((what, row))
        if verify:
            compiled(place, folder / f"{name}_{i}_scratch", None, batches)
            same = hashes(folder / f"{name}_{i}") == hashes(folder / f"{name}_{i}_scratch")
            row["verified"] = "  same bytes" if same else "  OTHER BYTES"
    size = sum(path.stat().st_size for path in cache.rglob("*") if path.is_file())
    print(f"\n{name}: {batches} of its batches, cache {size / 2**20:.0f} MiB")
    print(f"{'changed':28}{'CPU s':>8}{'wall s':>8}{'process':>9}{'ratio':>8}  made")
    for what, row in rows:
        ratio = scratch["cpu"] / row["cpu"]
        made = [step for step in row["made"] if not what.startswith("from")]
        shown = ", ".join(made[:9]) + (f" and {len(made) - 9} more" if len(made) > 9 else "")
        print(
            f"{what:28}{row['cpu']:8.2f}{row['wall']:8.2f}{row['process']:9.2f}{ratio:8.1f}"
            f"{row.get('verified', '')}  {shown}",
            flush=True,
        )


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("cfgs", nargs="*", default=CFGS)
    parser.add_argument("--batches", type=int, default=1)
    parser.add_argument("--verify", action="store_true")
    options = parser.parse_args()
    for name in options.cfgs:
        with tempfile.TemporaryDirectory() as folder:
            measured(Path(name).stem, options.batches, options.verify, Path(folder))


if __name__ == "__main__":
    main()
