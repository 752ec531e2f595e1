"""Pruning: what it leaves out, what that spares, and the proof that it shows nowhere.

    python benchmarks/bench_prune.py [--count N] [--samples N] [--outputs label,instance,depth]
        [--backends pyrender,mitsuba] [--spp N] [--scenes drive,drone,around]
    python benchmarks/bench_prune.py --proof 50 [--color] [--pictures SPP]

The first compiles scenes of 500 m by 500 m with and without pruning, and without any rock, and
prints, as ratios of whole to pruned: bytes of the stage, and of each backend the seconds of loading
(reader, its own scene, exact caster; the median of five) and of drawing all frames, without the
start of Python and of libraries. The last column is the ratio of the whole to the one without
rocks: more than that no pruning of rocks can reach.
*drive* looks along hilly ground, *drone* straight down, *around* has four cameras for all bearings.
The second compares annotation of drawn scenes (``tests/pruned_scenes.py``), bit by bit; with
``--pictures`` it renders them whole and pruned with Mitsuba, and says how far the light of blocks
of 8 by 8 pixels differs: with equal noise seeds, and with others in parts of their noise.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import hills
import numpy as np

sys.path[:0] = [str(hills.ROOT / "tests")]
from pruned_scenes import annotation, compiled, difference, drawn_cfg  # noqa: E402

from scenec.backends.run.session import Session  # noqa: E402
from scenec.backends.stage.read import read_stage  # noqa: E402
from scenec.compiler.passes.keep import Keep  # noqa: E402

#: Height, distance and height of the target, field of view.
_LOOKS = {"drive": (1.5, 10, 0, 65), "drone": (25, 0.01, 0, 60), "around": (1.5, 10, 0, 90)}
#: A stage is loaded so often, and once more with all frames.
_LOADS = 4


def cfg(scene: str, count: int, samples: int, outputs: list[str]) -> dict[str, Any]:
    """Hills of 18 m with rocks of Golombek and Rapp's sizes."""
    height, distance, target, fov = _LOOKS[scene]
    turns = (0, 90, 180, 270) if scene == "around" else (0,)
    sensors = {
        f"front{turn}": {
            "resolution": [320, 240],
            "fov_deg": fov,
            "outputs": outputs,
            "mount": {"rotation_deg": [0, turn, 0]},
        }
        for turn in turns
    }

    def within(reach: float) -> dict[str, Any]:
        return {"type": "uniform", "min": -reach, "max": reach}

    pose = {
        "type": "random_target",
        "position": {"x_m": within(40), "y_m": within(10), "height_m": height},
        "target": {
            "distance_m": distance,
            "bearing_deg": {"type": "uniform", "min": 40, "max": 80},
            "height_m": target,
        },
    }
    rocks = {
        "count": count,
        "prototypes": 8,
        "subdivisions": 2,
        "size_m": {"type": "golombek_rapp", "k": 0.05, "min": 0.1, "max": 2},
    }
    made = hills.cfg(
        500.0, 1.0, rocks, (18.0, 140.0), samples=samples,
        rigs={"rover": {"pose": pose, "sensors": sensors}},
    )  # fmt: skip
    made["terrain"]["mesh"] = {"tolerance_px": 2}
    return made


def drawn_by(stage: Path, backend: str, spp: int, outputs: list[str]) -> dict[str, float]:
    """What a worker takes for a stage, by a process of its own that has drawn another before.

    Raises:
        SystemExit: It failed.
    """
    words = [sys.executable, __file__, "--session", str(stage), "--backends", backend]
    words += ["--spp", str(spp), "--outputs", ",".join(outputs)]
    done = subprocess.run(words, capture_output=True, text=True, env=os.environ)
    if done.returncode:
        raise SystemExit(done.stderr)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def session(stage: Path, backend: str, spp: int, outputs: list[str]) -> dict[str, float]:
    """CPU and wall seconds: of loading (reader, renderer, exact caster), and of all frames.

    Kernels are compiled and libraries loaded by a frame of the stage before; that does not count.
    """
    _drawn_once(stage, backend, spp, outputs, samples=1)
    loads = [_drawn_once(stage, backend, spp, outputs, samples=1)["load, s"] for _ in range(_LOADS)]
    found = _drawn_once(stage, backend, spp, outputs)
    return found | {"load, s": statistics.median([*loads, found["load, s"]])}


def _drawn_once(
    stage: Path, backend: str, spp: int, outputs: list[str], samples: int | None = None
) -> dict[str, float]:
    """The stage loaded and its first samples drawn."""
    start = time.perf_counter(), time.process_time()
    held = Session.open(stage, backend)
    held.pictures = "rgb" in outputs
    before = time.perf_counter() - start[0], time.process_time() - start[1]
    load = cpu = wall = 0.0
    for sample, cameras in enumerate(held.scene.cameras[:samples]):
        for camera in cameras:
            start = time.perf_counter(), time.process_time()
            details = held.render(camera, sample, held.passes(outputs, camera), spp, 1)[1]
            wall += time.perf_counter() - start[0]
            cpu += time.process_time() - start[1]
            load += details["seconds"].get("load", 0.0)
    return {
        "load, s": before[0] + load,
        "frames, s": wall - load,
        "load and frames, CPU s": before[1] + cpu,
    }


def measure(scene: str, options: argparse.Namespace, folder: Path) -> None:
    """One scene: prints a line a number."""
    found: dict[str, dict[str, float]] = {}
    for stage_of, keep in (("whole", "unpruned"), ("pruned", "seen"), ("bare", "seen")):
        file = folder / f"{scene}_{stage_of}.json"
        drawn_from = cfg(scene, options.count, options.samples, options.outputs)
        if stage_of == "bare":
            del drawn_from["objects"], drawn_from["materials"]["stone"]
            del drawn_from["labels"]["class"]["rock"]
        file.write_text(json.dumps(drawn_from))
        out = folder / f"{scene}_{stage_of}"
        hills.run(["compile", file, "--seed", "1", "-o", out, "--keep", keep, "--no-cache"])
        batch = out / "batch_0000"
        report = json.loads((batch / "report.json").read_text())
        timings = json.loads((out / "timings.json").read_text())["compile"]["batch_0000"]
        stage = [p for p in batch.rglob("*") if p.is_file() and p.suffix != ".json"]
        read = read_stage(batch / "stage.usda")
        numbers = {"stage, MB": sum(path.stat().st_size for path in stage) / 1e6}
        numbers["instances"] = float((read.rows.instance_id > 0).sum())
        numbers["prune, s"] = timings.get("prune", 0.0)
        for backend in options.backends:
            drawn = drawn_by(batch / "stage.usda", backend, options.spp, options.outputs)
            numbers |= {f"{backend}: {name}": value for name, value in drawn.items()}
        found[stage_of] = numbers
        if "prune" in report and stage_of == "pruned":
            print(f"{scene}: {json.dumps(report['prune'])}")
    for name, whole in found["whole"].items():
        pruned, bare = found["pruned"][name], found["bare"][name]
        ratios = [f"{whole / less:8.2f} x" if less else "" for less in (pruned, bare)]
        line = f"{scene:8} {name:34} {whole:12.3f} {pruned:12.3f} "
        print(line if name == "prune, s" else line + " ".join(ratios), flush=True)


def prove(count: int, color: bool) -> None:
    """Drawn scenes, pruned and whole, by the exact caster.

    Raises:
        SystemExit: A pixel differs.
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
                        raise SystemExit(f"scene {seed}, {name}: {key} differs")
                frames, pixels = frames + 1, pixels + one["depth"].size
    print(f"{count} scenes, {frames} frames, {pixels:,} pixels: the same to the bit")


def picture(count: int, spp: int) -> None:
    """Drawn scenes, pruned and whole, as Mitsuba draws them: a line each, and all together."""
    found, lit = [], 0
    print("scene   kept     mean     same seed   noise     z^2    of itself")
    for seed in range(count):
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            drawn = drawn_cfg(seed, folder, ("rgb",))
            pruned, whole = (compiled(folder, drawn, k) for k in (Keep.SEEN, Keep.UNPRUNED))
            one = difference(pruned, whole, spp)
            kept = len(read_stage(pruned / "stage.usda").rows.mesh)
            kept /= len(read_stage(whole / "stage.usda").rows.mesh)
        if not one.blocks:
            continue
        lit += 1
        found.append(one)
        print(
            f"{seed:5} {100 * kept:5.0f} %  {one.mean:+.5f}  {one.paired:.5f}     "
            f"{one.noise:.5f}  {one.z2:.3f}  {one.control:.3f}",
            flush=True,
        )
    weights = np.array([one.blocks for one in found], float)
    z2, control = (
        float((weights * [getattr(one, name) for one in found]).sum() / weights.sum())
        for name in ("z2", "control")
    )
    worst = max(found, key=lambda one: one.paired)
    print(
        f"{lit} lit scenes, {int(weights.sum()):,} values: z^2 {z2:.3f}, of whole stages and "
        f"themselves {control:.3f}; largest difference with equal seeds "
        f"{100 * worst.paired:.3f} % (noise there {100 * worst.noise:.3f} %), largest mean "
        f"{100 * max(abs(one.mean) for one in found):.4f} %"
    )


def main() -> None:
    """Prints what the module says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--samples", type=int, default=30)
    parser.add_argument("--spp", type=int, default=4)
    parser.add_argument("--proof", type=int)
    parser.add_argument("--color", action="store_true")
    parser.add_argument("--session", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--pictures", type=int, metavar="SPP")
    for name, usual in (
        ("outputs", "label,instance,depth"),
        ("backends", "pyrender"),
        ("scenes", "drive,drone,around"),
    ):
        parser.add_argument(f"--{name}", type=lambda t: [p for p in t.split(",") if p],
                            default=usual.split(","))  # fmt: skip
    options = parser.parse_args()
    if options.session:
        print(json.dumps(session(options.session, options.backends[0], options.spp,
                                 options.outputs)))  # fmt: skip
        return
    if options.proof and options.pictures:
        picture(options.proof, options.pictures)
        return
    if options.proof:
        prove(options.proof, options.color)
        return
    print(f"{'scene':8} {'':34} {'whole':>12} {'pruned':>12}      ratio  no rocks")
    with tempfile.TemporaryDirectory() as temporary:
        for scene in options.scenes:
            measure(scene, options, Path(temporary))


if __name__ == "__main__":
    main()
