"""Measures growth of time and memory: objects, the ground's mesh, whole cfgs, a million of each.

    python lab/benchmarks/growth.py [--of objects,mesh,memory,million] [--fast]
        [--counts N,N] [--cases A,B]                                    of objects
        [--scenes NAME,NAME] [--cfgs]                                   of memory
        [--count N] [--kinds A,B] [--backends A,B] [--spp N] [--keep FOLDER]    of million

Each row is a process of its own. *objects*: seconds of drawing, placing and seating rocks, and the
memory that they take beyond terrain and kernels; the overlap-free case has radii that cover about a
quarter of the terrain. *mesh*: thirty cameras over a hectare, then the ground alone over its
triangles, the fastest of three; memory is that above the smallest mesh before it. *memory*: peaks
of compiling beside what ``compiler/estimate.py`` says before; each scene makes one key large,
``--cfgs`` adds those that ship. *million*: compiled and rendered by every backend; *rocks* have
levels of detail, of *finest* and *trees* (oaks, birches, spruces) each is as it was made. Seconds
are of the whole command, the peak of a render is its worker's, beside what loading was estimated to
take.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from scenec.backends.registry import backend_class
from scenec.backends.stage.read import read_stage
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.fill import fill
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw import draw
from scenec.compiler.estimate import BASE_BYTES, needs_of
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.objects.rocks import build_chains
from scenec.compiler.objects.scatter import scatter
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.lab.benchmarks.cfgs import fbm, rocks_on_hills
from scenec.lab.runner import (
    CONFIGS,
    ROOT,
    SCENEC,
    Cell,
    Study,
    apart,
    command,
    names,
    peak_mib,
    run,
)
from scenec.schemas.codec import read_facts
from scenec.schemas.errors import ScenecError
from scenec.schemas.report import BatchReport, GroundFacts, read_output_record
from scenec.schemas.sidecars import read_sidecar

_SIZE = 400.0
CASES: dict[str, dict[str, Any]] = {
    "uniform": {},
    "noise": {"density": {"type": "noise", "scale_m": 20}},
    "clusters": {"density": {"type": "clusters", "parents": 200, "sigma_m": 4}},
    "slope": {"where": [{"type": "slope", "max_deg": 20, "softness_deg": 5}]},
    "overlap-free": {"apart": {}},
}


def measure(count: int, name: str) -> tuple[float, ...]:
    """Returns count, seconds to draw, to make shapes, to place; memory beyond before, peak."""
    grid = Grid.with_spacing((_SIZE, _SIZE), 0.4)
    height = fbm(1, 3.0, 40.0).apply(grid, np.zeros(grid.shape))[0]
    surface = GroundSurface(HeightField(grid, height))
    cameras = np.array([[x, 0.0, 2.0] for x in np.linspace(-100, 100, 100)])
    context = Context(Streams(1, 0), (_SIZE, _SIZE))
    terrain = {"size_m": [_SIZE, _SIZE], "spacing_m": 0.4, "relief": [], "ground": [{}]}

    def once(n: int) -> tuple[float, ...]:
        largest = 0.5 * _SIZE / max(n, 1) ** 0.5
        size = {"type": "power_law", "exponent": 2.5, "min": 0.2 * largest, "max": 4 * largest}
        rocks = {"type": "rocks", "count": n, "material": "stone", "subdivisions": 1}
        cfg = {"terrain": terrain, "materials": {}, "rigs": {},
               "objects": {"rocks": rocks | {"size_m": size} | CASES[name]}}  # fmt: skip
        filled = fill(cfg)["objects"]["rocks"]
        clock = [time.process_time()]
        plan = draw_kind("objects", filled, "objects/rocks", context)
        clock.append(time.process_time())
        chains = build_chains(plan.source.shapes, coarser=False)
        clock.append(time.process_time())
        made = scatter(plan, chains, PlacementContext(surface, cameras), {})
        clock.append(time.process_time())
        return made.count, *np.diff(clock).tolist()

    once(100)
    before = peak_mib()
    found = once(count)
    return *found, peak_mib() - before, peak_mib()


def objects(study: Study) -> None:
    """Prints the table of objects."""
    counts = study.options.counts[:1] if study.fast else study.options.counts
    rows = ([name, *apart(measure, count, name).value]
            for name in study.options.cases for count in counts)  # fmt: skip
    header = ["case", "objects", "draw, CPU s", "shapes", "place and seat", "memory, MiB"]
    study.table([*header, "peak, MiB"], rows)


def hectare(**terrain: Any) -> dict[str, Any]:
    """Three grounds on a hectare, seen by thirty random cameras."""
    cfg = copy.deepcopy(rocks_on_hills(0, name="hectare", samples=30))
    cfg["outputs"] = ["rgb", "label", "instance", "depth"]
    cfg["labels"]["class"] = {"sky": 1, "ground": 2, "gravel": 3, "mud": 4}
    cfg["light"]["sun"] = {"elevation_deg": 35, "azimuth_deg": 140}
    cfg["rigs"]["rover"]["sensors"]["mast"]["fov_deg"] = 65
    del cfg["objects"], cfg["materials"]["stone"]
    cfg["materials"]["sand"]["variation"] = 0.2
    cfg["materials"] |= {"gravel": {"base_color": [0.2, 0.2, 0.2]},
                         "mud": {"base_color": [0.3, 0.25, 0.2], "roughness": 0.5}}  # fmt: skip
    cfg["terrain"] |= {
        "spacing_m": 0.1,
        "relief": [
            {"type": "plane", "slope": [0.05, -0.02]},
            {"type": "multifractal", "amplitude_m": 1.5, "scale_m": 40, "octaves": 9, "gain": 0.45},
        ],
        "mesh": {"tolerance_px": 0.5},
    } | terrain
    cfg["terrain"]["ground"] += [
        {"material": "gravel", "labels": {"class": "gravel"}, "noise": {"scale_m": 11},
         "coverage": 0.4},
        {"material": "mud", "labels": {"class": "mud"}, "noise": {"scale_m": 17, "octaves": 3},
         "coverage": 0.25},
    ]  # fmt: skip

    def within(low: float, high: float) -> dict[str, Any]:
        return {"type": "uniform", "min": low, "max": high}

    cfg["rigs"]["rover"]["pose"] |= {
        "position": {"x_m": within(-45, 45), "y_m": within(-45, 45), "height_m": within(1, 2)},
        "target": {"distance_m": within(5, 15)},
    }
    return cfg


def seconds_of(cfg: Path, folder: Path, seed: int) -> float:
    """Wall seconds of a compilation."""
    start = time.perf_counter()
    compile_cfg(cfg, seed=seed, out=folder / f"{cfg.stem}_{seed}", batches=range(1))
    return time.perf_counter() - start


def built(small: Path, cfg: Path) -> tuple[float, float, float]:
    """Seconds of the ground, faces, and MiB above what the smallest one, which loads all, takes."""
    build(draw(load(small), 1, 0), BuildLog())
    before, log = peak_mib(), BuildLog()
    build(draw(load(cfg), 1, 0), log)
    return (
        log.seconds["ground"],
        read_facts(log.facts["ground"], GroundFacts).faces,
        peak_mib() - before,
    )


def mesh(study: Study) -> None:
    """Prints the tables of the ground's mesh."""
    path, runs = study.cfg(hectare(), "hectare"), 1 if study.fast else 3
    apart(seconds_of, path, study.scratch, 1)
    costs = [apart(seconds_of, path, study.scratch, seed) for seed in range(2, 2 + runs)]
    took = [cost.value for cost in costs]
    study.say("30 cameras of 640 x 480 over 100 m x 100 m at 0.5 px, whole compilation; asked:")
    study.say("10 s and 3072 MiB at most.\n")
    peak = max(cost.peak_mib for cost in costs)
    study.table(["s, best", "s, worst", "peak, MiB"], [[min(took), max(took), peak]])
    counts = (70, 224, 707) if study.fast else (70, 125, 224, 400, 707, 1250, 2236)
    for title, more in (
        ("whole grid, finer and finer", {"mesh": {"tolerance_px": 0}}),
        ("adaptive to 0.5 px, on finer and finer grids", {}),
    ):
        cfgs = [hectare(spacing_m=100 / n, **more) for n in counts]
        _growth(study, title, [study.cfg(cfg, f"{title[:5]}{i}") for i, cfg in enumerate(cfgs)])


def _growth(study: Study, title: str, paths: list[Path]) -> None:
    """Prints a series of meshes and the exponents fitted to it."""
    found = []

    def rows() -> Iterator[list[Cell]]:
        for path in paths:
            runs = [apart(built, paths[0], path) for _ in range(1 if study.fast else 3)]
            best = min(runs, key=lambda cost: cost.value[0])
            took, faces, above = best.value
            found.append((faces, took, above))
            yield [faces, took, 1e6 * took / faces, best.peak_mib, above * 2**20 / faces]

    study.say(f"{title}:\n")
    study.table(["triangles", "ground, s", "us each", "peak, MiB", "bytes each"], rows())
    # What a mesh costs beyond the process: below some MiB nothing of it can be told.
    large = [(faces, above) for faces, _, above in found if above > 16.0]
    fitted = [("time", [row[:2] for row in found]), ("memory", large)]
    exponents = [
        f"{name} {np.polyfit(*np.log(pairs).T, 1)[0]:.2f}" for name, pairs in fitted if pairs[1:]
    ]
    steepest = max(
        math.log(b[1] / a[1]) / math.log(b[0] / a[0])
        for a, b in pairwise(found)
        if b[0] > 1.2 * a[0]
    )
    study.say(
        f"Exponents: {', '.join(exponents)}; time between neighboring rows at most {steepest:.2f} "
        "(asked: 1.1 at most).\n"
    )


def scenes() -> dict[str, dict[str, Any]]:
    """Cfgs with one large key, by name."""
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


def memory(study: Study) -> None:
    """Prints the table of estimates and peaks."""
    chosen = scenes()
    wanted = study.options.scenes or (list(chosen)[:1] if study.fast else list(chosen))
    files = {name: study.cfg(chosen[name], str(i)) for i, name in enumerate(wanted)}
    if study.options.cfgs:
        files |= {file.stem: file for file in sorted(CONFIGS.glob("*.json"))}

    def rows() -> Iterator[list[Cell]]:
        for name, file in files.items():
            said = BASE_BYTES + sum(need.bytes for need in needs_of(load(file), 1, 0))
            took = 2**20 * apart(seconds_of, file, study.scratch, 1).peak_mib
            yield [name, said / 1e9, took / 1e9, f"{100 * (said / took - 1):+.0f} %"]

    study.table(["scene", "estimated, GB", "measured, GB", "off"], rows())


def of_kind(kind: str, count: int) -> dict[str, Any]:
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
            "type": "meshes", "models": [{"file": str(file)} for file in models],
            "labels": {"class": "rock"}, "count": count, "lod_px": 0,
        }  # fmt: skip
        del made["materials"]["stone"]
    return made


def rendered(out: Path, backend: str, spp: int) -> list[Cell]:
    """Seconds, peak, steps of a render; or why there is none."""
    said, passes = "", "label,instance,depth"
    if backend != "annotation":
        stage = out / "batch_0000" / "stage.usda"
        size, what = backend_class(backend).load_cost.of(read_stage(stage))
        said, passes = f"; {size / 1e9:.2f} GB for {what}", f"{passes},rgb"
    words = ["render", out, "--backend", backend, "--passes", passes, "--spp", str(spp)]
    try:
        cost = command([*SCENEC, *words])
    except ScenecError as error:
        return [None, None, f"{error}{said}"]
    sidecar = next((out / "batch_0000" / "frames" / backend).rglob("*.json"))
    record = read_sidecar(sidecar)
    steps = ", ".join(f"{k} {v:.2f} s" for k, v in (record.seconds or {}).items() if v > 0.01)
    return [cost.wall_s, record.peak_memory_gb, steps + said]


def million(study: Study) -> None:
    """Prints the table of a million of each kind."""
    options = study.options
    count = 10_000 if study.fast else options.count

    def steps() -> Iterator[list[Cell]]:
        for kind in options.kinds[: 1 if study.fast else None]:
            folder = (options.keep or study.scratch) / kind
            folder.mkdir(parents=True, exist_ok=True)
            out = folder / "out"
            words = ["compile", study.cfg(of_kind(kind, count), kind), "--seed", "1", "-o", out]
            cost = command([*SCENEC, *words, "--no-cache"])
            report = read_output_record(out / "batch_0000" / "report.json", BatchReport)
            made = report.objects["rocks"]
            what = f"{made.triangles:,} triangles, {report.bytes / 1e6:.0f} MB"
            yield [kind, "compile", cost.wall_s, cost.peak_mib * 2**20 / 1e9, what]
            for backend in options.backends:
                yield [kind, backend, *rendered(out, backend, options.spp)]

    study.table(["kind", "step", "s", "peak, GB", "of these"], steps())


PARTS = {"objects": objects, "mesh": mesh, "memory": memory, "million": million}


def main(study: Study) -> None:
    """Prints the tables of the parts that were chosen."""
    for name in study.options.of:
        PARTS[name](study)


if __name__ == "__main__":
    run(
        main, of=tuple(PARTS), counts=(30_000, 100_000, 300_000, 1_000_000), cases=tuple(CASES),
        scenes=names, cfgs=False, count=1_000_000, kinds=("rocks", "finest", "trees"),
        backends=("cycles", "mitsuba", "pyrender", "annotation"), spp=16, keep=Path,
    )  # fmt: skip
