"""Pruning: what it leaves out, what that spares, and the proof that it shows nowhere.

    python lab/benchmarks/prune.py [--count N] [--samples N] [--outputs label,instance,depth]
        [--backends pyrender,mitsuba] [--spp N] [--scenes drive,drone,around] [--fast]
    python lab/benchmarks/prune.py --proof 50 [--color] [--pictures SPP]

The first compiles scenes of 500 m by 500 m with and without pruning, and without any rock, and
prints bytes of the stage, and of each backend the seconds of loading (reader, its own scene, exact
caster; the median of five) and of drawing all frames, without the start of Python and of libraries.
The last columns are ratios, of the whole to the pruned, and of the whole to the one without
rocks: more than that no pruning of rocks can reach.
*drive* looks along hilly ground, *drone* straight down, *around* has four cameras for all bearings.
The second compares annotation of drawn scenes (``testing/pruned_scenes.py``), bit by bit; with
``--pictures`` it renders them whole and pruned with Mitsuba, and says how far the light of blocks
of 8 by 8 pixels differs: with equal noise seeds, and with others in parts of their noise.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.compiler.views.needed import Keep
from scenec.lab.benchmarks.cfgs import rocks_on_hills
from scenec.lab.runner import Cell, Study, apart, run
from scenec.schemas.errors import ScenecError
from scenec.schemas.report import Timings, read_output_record
from scenec.testing.pruned_scenes import annotation, compiled, difference, drawn_cfg

#: Height, distance and height of the target, field of view.
_LOOKS = {"drive": (1.5, 10, 0, 65), "drone": (25, 0.01, 0, 60), "around": (1.5, 10, 0, 90)}
#: A stage is loaded so often, and once more with all frames.
_LOADS = 4


def cfg(scene: str, count: int, samples: int, outputs: tuple[str, ...]) -> dict[str, Any]:
    """Hills of 18 m with rocks of Golombek and Rapp's sizes; none without a count."""
    height, distance, target, fov = _LOOKS[scene]
    made = rocks_on_hills(count, 500.0, 500, name=scene, samples=samples)
    made["terrain"]["relief"][1] |= {"amplitude_m": 18, "scale_m": 140}
    made["terrain"]["mesh"] = {"tolerance_px": 2}
    made["light"]["sun"] = {"elevation_deg": 35, "azimuth_deg": 200}
    made["objects"]["rocks"] |= {
        "prototypes": 8,
        "subdivisions": 2,
        "size_m": {"type": "golombek_rapp", "k": 0.05, "min": 0.1, "max": 2},
    }
    made["rigs"]["rover"] = {
        "pose": {
            "type": "random_target",
            "position": {
                "x_m": {"type": "uniform", "min": -40, "max": 40},
                "y_m": {"type": "uniform", "min": -10, "max": 10},
                "height_m": height,
            },
            "target": {
                "distance_m": distance,
                "bearing_deg": {"type": "uniform", "min": 40, "max": 80},
                "height_m": target,
            },
        },
        "sensors": {
            f"front{turn}": {
                "resolution": [320, 240],
                "fov_deg": fov,
                "outputs": list(outputs),
                "mount": {"rotation_deg": [0, turn, 0]},
            }
            for turn in ((0, 90, 180, 270) if scene == "around" else (0,))
        },
    }
    if not count:
        del made["objects"], made["materials"]["stone"], made["labels"]["class"]["rock"]
    return made


def session(stage: Path, backend: str, spp: int, outputs: tuple[str, ...]) -> dict[str, float]:
    """CPU and wall seconds: of loading (reader, renderer, exact caster), and of all frames.

    Kernels are compiled and libraries loaded by a frame of the stage before; that does not count.
    """
    _drawn_once(stage, backend, spp, outputs, samples=1)
    loads = [_drawn_once(stage, backend, spp, outputs, samples=1)["load, s"] for _ in range(_LOADS)]
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
    pruned, bare = measured(study, content, Keep.SEEN), measured(study, bare, Keep.SEEN)
    for name, value in whole.items():
        ratios = [value / found[name] if found[name] else None for found in (pruned, bare)]
        ratios = [None, None] if name == "prune, s" else ratios
        yield [scene, name, value, pruned[name], bare[name], *ratios]


def prove(study: Study, count: int, color: bool) -> None:
    """Drawn scenes, pruned and whole, by the exact caster.

    Raises:
        ScenecError: A pixel differs.
    """
    outputs = ("rgb", "label", "instance") if color else ("label", "instance")
    frames = pixels = 0
    for seed in range(count):
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            drawn = drawn_cfg(seed, folder, outputs)
            pruned, whole = (compiled(folder, drawn, k) for k in (Keep.SEEN, Keep.UNPRUNED))
            for (name, one), (_, other) in zip(annotation(pruned), annotation(whole), strict=True):
                for key, values in other.items():
                    if not np.array_equal(one[key], values, equal_nan=values.dtype.kind == "f"):
                        raise ScenecError(f"scene {seed}, {name}: {key} differs")
                frames, pixels = frames + 1, pixels + one["depth"].size
    study.say(f"{count} scenes, {frames} frames, {pixels:,} pixels: the same to the bit")


def pictures(study: Study, count: int, spp: int) -> None:
    """Drawn scenes, pruned and whole, as Mitsuba draws them: a row each, and all together."""
    found = []

    def scenes() -> Iterator[list[Cell]]:
        for seed in range(count):
            with tempfile.TemporaryDirectory(dir=study.scratch) as temporary:
                folder = Path(temporary)
                drawn = drawn_cfg(seed, folder, ("rgb",))
                pruned, whole = (compiled(folder, drawn, k) for k in (Keep.SEEN, Keep.UNPRUNED))
                one = difference(pruned, whole, spp)
                kept, all_ = (
                    len(read_stage(batch / "stage.usda").rows.mesh) for batch in (pruned, whole)
                )
            if one.blocks:
                found.append(one)
                yield [seed, f"{100 * kept / all_:.0f} %", f"{one.mean:+.5f}", f"{one.paired:.5f}",
                       f"{one.noise:.5f}", one.z2, one.control]  # fmt: skip

    header = ["scene", "kept", "mean", "same seed", "noise", "z^2", "of itself"]
    study.table(header, scenes())
    weights = np.array([one.blocks for one in found], float)
    z2, control = (
        float((weights * [getattr(one, name) for one in found]).sum() / weights.sum())
        for name in ("z2", "control")
    )
    worst = max(found, key=lambda one: one.paired)
    study.say(
        f"{len(found)} lit scenes, {int(weights.sum()):,} values: z^2 {z2:.3f}, of whole stages "
        f"and themselves {control:.3f}; largest difference with equal seeds "
        f"{100 * worst.paired:.3f} % (noise there {100 * worst.noise:.3f} %), largest mean "
        f"{100 * max(abs(one.mean) for one in found):.4f} %"
    )


def main(study: Study) -> None:
    """Prints what the module says."""
    options = study.options
    if options.proof and options.pictures:
        pictures(study, options.proof, options.pictures)
    elif options.proof:
        prove(study, options.proof, options.color)
    else:
        chosen = options.scenes[: 1 if study.fast else None]
        header = ["scene", "", "whole", "pruned", "no rocks", "whole / pruned", "whole / no rocks"]
        study.table(header, (row for scene in chosen for row in rows(study, scene)))


if __name__ == "__main__":
    outputs = ("label", "instance", "depth")
    run(main, count=100_000, samples=30, outputs=outputs, backends=("pyrender",), spp=4,
        scenes=tuple(_LOOKS), proof=int, pictures=int, color=False)  # fmt: skip
