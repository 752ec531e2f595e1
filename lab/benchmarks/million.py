"""A million of each kind: compiled, and rendered by every backend, each in a process of its own.

    python lab/benchmarks/million.py [--count N] [--kinds A,B] [--backends A,B] [--spp N]
                                         [--keep FOLDER] [--fast]

*rocks* have levels of detail; of *finest* and *trees* (oaks, birches, spruces) each is as it was
made (``lod_px`` 0). Seconds are of the whole command; the peak of a render is that of its worker,
beside what loading was estimated to take.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from scenec.backends.registry import backend_class
from scenec.backends.stage.read import read_stage
from scenec.lab.benchmarks.cfgs import rocks_on_hills
from scenec.lab.runner import ROOT, SCENEC, Cell, Study, command, run
from scenec.schemas.errors import ScenecError
from scenec.schemas.report import BatchReport, read_output_record
from scenec.schemas.sidecars import read_sidecar


def cfg(kind: str, count: int) -> dict[str, Any]:
    """Rocks of Golombek and Rapp's sizes, 12 to the square meter; or trees, a hundredth of that."""
    made = rocks_on_hills(count, (count / (0.12 if kind == "trees" else 12.0)) ** 0.5, 500)
    made["objects"]["rocks"] |= {
        "prototypes": 16,
        "subdivisions": 3 if kind == "finest" else 2,
        "size_m": {"type": "golombek_rapp", "k": 0.1, "min": 0.04, "max": 2},
    }
    if kind == "finest":
        made["objects"]["rocks"]["lod_px"] = 0
    if kind == "trees":
        models = [ROOT / f"assets/models/{name}.glb" for name in ("oak", "birch", "spruce")]
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
    """What a backend says of loading a stage."""
    size, what = backend_class(backend).load_cost.of(read_stage(stage))
    return f"{size / 1e9:.2f} GB for {what}"


def steps_of(seconds: Mapping[str, float]) -> str:
    """The steps that take long enough to tell."""
    return ", ".join(f"{name} {value:.2f} s" for name, value in seconds.items() if value > 0.01)


def rendered(out: Path, backend: str, spp: int) -> list[Cell]:
    """Seconds, peak, steps of a render; or why there is none."""
    stage = out / "batch_0000" / "stage.usda"
    said = "" if backend == "annotation" else f"; {estimate(stage, backend)}"
    passes = "label,instance,depth" + ("" if backend == "annotation" else ",rgb")
    words = ["render", out, "--backend", backend, "--passes", passes, "--spp", str(spp)]
    try:
        cost = command([*SCENEC, *words])
    except ScenecError as error:
        return [None, None, f"{error}{said}"]
    sidecar = next((out / "batch_0000" / "frames" / backend).rglob("*.json"))
    record = read_sidecar(sidecar)
    return [cost.wall_s, record.peak_memory_gb, steps_of(record.seconds or {}) + said]


def main(study: Study) -> None:
    """Prints the table."""
    options = study.options
    count = 10_000 if study.fast else options.count

    def steps() -> Iterator[list[Cell]]:
        for kind in options.kinds:
            folder = (options.keep or study.scratch) / kind
            folder.mkdir(parents=True, exist_ok=True)
            out = folder / "out"
            words = ["compile", study.cfg(cfg(kind, count), kind), "--seed", "1", "-o", out]
            cost = command([*SCENEC, *words, "--no-cache"])
            report = read_output_record(out / "batch_0000" / "report.json", BatchReport)
            made = report.objects["rocks"]
            what = f"{made.triangles:,} triangles, {report.bytes / 1e6:.0f} MB"
            yield [kind, "compile", cost.wall_s, cost.peak_mib * 2**20 / 1e9, what]
            for backend in options.backends:
                yield [kind, backend, *rendered(out, backend, options.spp)]

    study.table(["kind", "step", "s", "peak, GB", "of these"], steps())


if __name__ == "__main__":
    backends = ("cycles", "mitsuba", "pyrender", "annotation")
    kinds = ("rocks", "finest", "trees")
    run(main, count=1_000_000, kinds=kinds, backends=backends, spp=16, keep=Path)
