"""Incremental compilation: seconds after a change, against those from scratch, and what was made.

    python lab/benchmarks/incremental.py [--cfgs A,B] [--verify] [--batches N] [--fast]

Each compilation is a process of its own, into a folder of its own (but "same folder"). Ratios are
of CPU seconds of ``compile_cfg``: they bear a busy machine better.
Changes are made to the cfg that filled the cache: an object class's count by 5 % (the middle class,
and the costliest), the sun to 33 degrees, the first ground material 10 % darker, cameras 10 cm up.
The code must stay as it is meanwhile: an edit of the compiler is another key for all steps.
With ``--verify`` each is compiled from scratch, too, and every byte compared.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scenec.compiler.compile import compile_cfg
from scenec.lab.runner import CONFIGS, ROOT, SHIPPED, Cell, Cost, Study, apart, run
from scenec.schemas.errors import ScenecError
from scenec.schemas.manifest import read_manifest


def compiled(
    cfg: Path, out: Path, cache: Path | None, batches: int
) -> tuple[list[str], dict[str, float]]:
    """One compilation: steps that were made, seconds of each."""
    report = compile_cfg(cfg, seed=1, out=out, cache=cache, batches=range(batches))
    made = sorted({name for steps in report.made.values() for name in steps})
    return made, report.seconds["batch_0000"]


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


def digests(out: Path) -> dict[str, str]:
    """Reads the digests of all files of a manifest."""
    return {path: entry.sha256 for path, entry in read_manifest(out).files.items()}


def rows(study: Study, name: str, folder: Path) -> Iterator[list[Cell]]:
    """The rows of one cfg."""
    # Beside what it names: files that are given by their place.
    (folder / "configs").mkdir(parents=True)
    for entry in ("assets", "datasets", "schemas"):
        (folder / entry).symlink_to(ROOT / entry)
    cfg = json.loads((CONFIGS / f"{name}.json").read_text(encoding="utf-8"))
    batches = min(study.options.batches, int(cfg.get("batches", 1)))
    place, cache = folder / "configs" / f"{name}.json", folder / "cache"

    def made(out: str, content: dict[str, Any], cache: Path | None) -> Cost:
        place.write_text(json.dumps(content), encoding="utf-8")
        return apart(compiled, place, folder / out, cache, batches)

    scratch = made("scratch", cfg, None)

    def row(what: str, cost: Cost, same: Cell = None) -> list[Cell]:
        ratio, steps = scratch.cpu_s / cost.cpu_s, cost.value[0]
        if what.startswith("from"):
            steps = []
        shown = ", ".join(steps[:9]) + (f" and {len(steps) - 9} more" if len(steps) > 9 else "")
        return [what, cost.cpu_s, cost.wall_s, ratio, same, shown]

    yield row("from scratch", scratch)
    yield row("from scratch, filling", made("filled", cfg, cache))
    if digests(folder / "scratch") != digests(folder / "filled"):
        raise ScenecError(f"{name}: other bytes with a cache")
    yield row("nothing, same folder", made("filled", cfg, cache))
    yield row("nothing, new folder", made("again", cfg, cache))
    costliest = max(counted(cfg), key=lambda n: scratch.value[1][f"objects/{n}"])
    for i, (what, changed) in enumerate(changes(cfg, costliest)):
        cost, same = made(str(i), changed, cache), None
        if study.options.verify:
            made(f"{i}_scratch", changed, None)
            equal = digests(folder / str(i)) == digests(folder / f"{i}_scratch")
            same = "yes" if equal else "NO"
        yield row(what, cost, same)
        if study.fast:
            return


def main(study: Study) -> None:
    """Prints a table for each cfg."""
    for name in study.options.cfgs[:1] if study.fast else study.options.cfgs:
        folder = study.scratch / name
        header = [f"{name}: changed", "CPU s", "wall s", "ratio", "same bytes", "made"]
        study.table(header, rows(study, name, folder))
        size = sum(path.stat().st_size for path in (folder / "cache").rglob("*") if path.is_file())
        study.say(f"The cache takes {size / 2**20:.0f} MiB.\n")


if __name__ == "__main__":
    run(main, cfgs=SHIPPED, verify=False, batches=1)
