"""Peak memory of compiling, measured against what ``compiler/estimate.py`` says before.

    python lab/benchmarks/memory.py [--scenes NAME,NAME] [--cfgs] [--fast]

Each scene makes one key large; ``--cfgs`` adds the shipped cfgs. Each is compiled in a process of
its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.estimate import BASE_BYTES, needs_of
from scenec.lab.benchmarks.cfgs import rocks_on_hills
from scenec.lab.runner import CONFIGS, Cell, Study, apart, names, run


def scenes() -> dict[str, dict[str, Any]]:
    """By name."""
    found = {f"{n:_} rocks": rocks_on_hills(n) for n in (100_000, 1_000_000, 3_000_000)}
    found["4 million height samples"] = rocks_on_hills(0, cells=2000)
    whole = found["4 million height samples all kept"] = rocks_on_hills(0, cells=2000)
    whole["terrain"] |= {"mesh": {"tolerance_px": 0}}
    two = found["4 million height samples in two layers"] = rocks_on_hills(0, cells=2000)
    layer = {"material": "stone", "labels": {"class": "rock"}, "noise": {"scale_m": 5}}
    two["terrain"]["ground"].append(layer)
    sky = {"type": "clear", "labels": {"class": "sky"}}
    found["a sky of 2048 rows"] = rocks_on_hills(0, light={"sky": sky | {"resolution": 2048}})
    sun = {"elevation_deg": {"type": "uniform", "min": 10, "max": 80}}
    air = sky | {"type": "atmosphere", "resolution": 512}
    found["20 skies of 512 rows"] = rocks_on_hills(0, samples=20, light={"sun": sun, "sky": air})
    found["10_000 samples"] = rocks_on_hills(0, samples=10_000)
    return found


def compiled(file: Path, out: Path) -> None:
    """Compiles a cfg's first batch."""
    compile_cfg(file, seed=1, out=out, batches=range(1))


def main(study: Study) -> None:
    """Prints the table."""
    chosen = scenes()
    wanted = study.options.scenes or (list(chosen)[:1] if study.fast else list(chosen))
    files = {name: study.cfg(chosen[name], str(i)) for i, name in enumerate(wanted)}
    if study.options.cfgs:
        files |= {file.stem: file for file in sorted(CONFIGS.glob("*.json"))}

    def rows() -> Iterator[list[Cell]]:
        for number, (name, file) in enumerate(files.items()):
            said = BASE_BYTES + sum(need.bytes for need in needs_of(load(file), 1, 0))
            took = 2**20 * apart(compiled, file, study.scratch / f"out{number}").peak_mib
            yield [name, said / 1e9, took / 1e9, f"{100 * (said / took - 1):+.0f} %"]

    study.table(["scene", "estimated, GB", "measured, GB", "off"], rows())


if __name__ == "__main__":
    run(main, scenes=names, cfgs=False)
