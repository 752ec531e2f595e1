"""Pruning: what it leaves out of a stage, and what that spares in loading and drawing.

    python lab/benchmarks/prune.py [--count N] [--samples N] [--outputs label,instance,depth]
        [--backends pyrender,mitsuba] [--spp N] [--scenes drive,drone,around] [--fast]

Compiles scenes of 500 m by 500 m with and without pruning, and without any rock, and prints bytes
of the stage, and of each backend the seconds of loading (reader, its own scene, exact caster; the
median of five) and of drawing all frames, without the start of Python and of libraries. The last
columns are ratios, of the whole to the pruned, and of the whole to the one without rocks: more than
that no pruning of rocks can reach. *drive* looks along hilly ground, *drone* straight down,
*around* has four cameras for all bearings. That nothing of it shows is measured by
``lab/pages/leaving_out.py``.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.compiler.views.needed import Keep
from scenec.lab.benchmarks.cfgs import rocks_on_hills
from scenec.lab.runner import Cell, Study, apart, run
from scenec.schemas.report import Timings, read_output_record

#: Height, distance of the target, field of view.
_LOOKS = {"drive": (1.5, 10, 65), "drone": (25, 0.01, 60), "around": (1.5, 10, 90)}


def cfg(scene: str, count: int, samples: int, outputs: tuple[str, ...]) -> dict[str, Any]:
    """Hills of 18 m with rocks of Golombek and Rapp's sizes; none without a count."""
    height, distance, fov = _LOOKS[scene]
    made = rocks_on_hills(count, 500.0, 500, name=scene, samples=samples)
    made["terrain"]["relief"][1] |= {"amplitude_m": 18, "scale_m": 140}
    made["terrain"]["mesh"] = {"tolerance_px": 2}
    made["light"]["sun"] = {"elevation_deg": 35, "azimuth_deg": 200}
    made["objects"]["rocks"] |= {
        "prototypes": 8,
        "subdivisions": 2,
        "size_m": {"type": "golombek_rapp", "k": 0.05, "min": 0.1, "max": 2},
    }

    def within(low: float, high: float) -> dict[str, Any]:
        return {"type": "uniform", "min": low, "max": high}

    made["rigs"]["rover"]["pose"] |= {
        "position": {"x_m": within(-40, 40), "y_m": within(-10, 10), "height_m": height},
        "target": {"distance_m": distance, "bearing_deg": within(40, 80), "height_m": 0},
    }
    sensor = {"resolution": [320, 240], "fov_deg": fov, "outputs": list(outputs)}
    made["rigs"]["rover"]["sensors"] = {
        f"front{turn}": sensor | {"mount": {"rotation_deg": [0, turn, 0]}}
        for turn in ((0, 90, 180, 270) if scene == "around" else (0,))
    }
    if not count:
        del made["objects"], made["materials"]["stone"], made["labels"]["class"]["rock"]
    return made


def session(stage: Path, backend: str, spp: int, outputs: tuple[str, ...]) -> dict[str, float]:
    """Seconds of loading (reader, renderer, exact caster), and of all frames.

    Kernels are compiled and libraries loaded by a frame of the stage before; that does not count.
    """
    _drawn_once(stage, backend, spp, outputs, samples=1)
    loads = [_drawn_once(stage, backend, spp, outputs, samples=1)["load, s"] for _ in range(4)]
    found = _drawn_once(stage, backend, spp, outputs)
    return found | {"load, s": statistics.median([*loads, found["load, s"]])}


def _drawn_once(
    stage: Path, backend: str, spp: int, outputs: tuple[str, ...], samples: int | None = None
) -> dict[str, float]:
    """The stage loaded and its first samples drawn."""
    start = time.perf_counter(), time.process_time()
    held = Session.open(stage, backend)
    before = time.perf_counter() - start[0], time.process_time() - start[1]
    load = cpu = wall = 0.0
    for sample, cameras in enumerate(held.scene.cameras[:samples]):
        for camera in cameras:
            start = time.perf_counter(), time.process_time()
            record = held.render(camera, sample, held.passes(outputs, camera), spp, 1).record
            wall += time.perf_counter() - start[0]
            cpu += time.process_time() - start[1]
            load += (record.seconds or {}).get("load", 0.0)
    return {
        "load, s": before[0] + load,
        "frames, s": wall - load,
        "load and frames, CPU s": before[1] + cpu,
    }


def measured(study: Study, content: dict[str, Any], keep: Keep) -> dict[str, float]:
    """Numbers of a stage."""
    options = study.options
    batch = study.batch(content, keep=keep)
    files = [p for p in batch.rglob("*") if p.is_file() and p.suffix != ".json"]
    timings = read_output_record(batch.parent / "timings.json", Timings)
    numbers = {
        "stage, MB": sum(path.stat().st_size for path in files) / 1e6,
        "instances": int((read_stage(batch / "stage.usda").rows.instance_id > 0).sum()),
        "prune, s": timings.compile["batch_0000"].get("prune", 0.0),
    }
    for backend in options.backends:
        # A process of its own: two renderers do not share one.
        drawn = apart(session, batch / "stage.usda", backend, options.spp, options.outputs).value
        numbers |= {f"{backend}: {name}": value for name, value in drawn.items()}
    return numbers


def rows(study: Study, scene: str) -> Iterator[list[Cell]]:
    """A row a number."""
    options = study.options
    count, samples = (3000, 2) if study.fast else (options.count, options.samples)
    content, bare = (cfg(scene, n, samples, options.outputs) for n in (count, 0))
    whole = measured(study, content, Keep.UNPRUNED)
    pruned, none = measured(study, content, Keep.SEEN), measured(study, bare, Keep.SEEN)
    for name, value in whole.items():
        ratios = [value / found[name] if found[name] else None for found in (pruned, none)]
        ratios = [None, None] if name == "prune, s" else ratios
        yield [scene, name, value, pruned[name], none[name], *ratios]


def main(study: Study) -> None:
    """Prints the table."""
    chosen = study.options.scenes[: 1 if study.fast else None]
    header = ["scene", "", "whole", "pruned", "no rocks", "whole / pruned", "whole / no rocks"]
    study.table(header, (row for scene in chosen for row in rows(study, scene)))


if __name__ == "__main__":
    outputs = ("label", "instance", "depth")
    run(main, count=100_000, samples=30, outputs=outputs, backends=("pyrender",), spp=4,
        scenes=tuple(_LOOKS))  # fmt: skip
