"""COCO export: seconds of each stage, memory over frames, and pycocotools' own loop beside it.

    python lab/benchmarks/coco.py [--frames N] [--workers N] [--fast]

Frames of 640 x 480 with 200 instances, two label levels, depth and noisy RGB are written by the
frame writer, as renderers write them: a few contents, each under many sample numbers. ``export``
then makes a COCO dataset of 100, 300 and all of them, by processes of its own, whose seconds of
CPU and largest resident memory are shown: on a machine that others use, CPU seconds over cores say
what the wall clock would. The stages are timed one by one in this process, in CPU milliseconds a
frame; the loop that they are held against takes the same arrays and does with pycocotools what an
exporter does: each id's mask, its run lengths, area and box. Polygons are filled by pycocotools and
held against the masks.
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import mean, median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from scenec.backends.annotation.instances import Seen
from scenec.backends.run.executors import make_executor
from scenec.backends.run.facts import FrameResult, RendererFacts, describe_frame
from scenec.backends.run.writer import write_frame
from scenec.backends.stage.scene import Camera, Lighting, RenderScene, Rows
from scenec.datasets.export import Choice
from scenec.datasets.export import export as export_frames
from scenec.datasets.formats.coco import Coco
from scenec.datasets.formats.coco_parts import dumps, place_picture
from scenec.datasets.formats.contract import Info, Task
from scenec.datasets.outlines import outlines
from scenec.datasets.source import LoadedFrame, Source
from scenec.datasets.statistics import measure
from scenec.lab.runner import Cell, Study, apart, run, times
from scenec.schemas import rle
from scenec.schemas.exr import read_exr
from scenec.schemas.files import sha256, write_json
from scenec.schemas.frames import FrameKey, frame_stem
from scenec.schemas.instances import read_frame_table
from scenec.schemas.manifest import read_manifest, stage_digest

_LOOP = "pycocotools' loop over run lengths, areas and boxes"
_MASKS, _ALL = "run lengths, areas, boxes", "all that the format does"
WIDTH, HEIGHT = 640, 480
INSTANCES = 200
CONTENTS = 20
NAMES = {
    "class": {1: "sky", 2: "ground", 3: "rock", 4: "plant"},
    "surface": {7: "sky", 20: "sand", 21: "gravel", 30: "basalt", 31: "granite", 40: "leaf"},
}
#: Of instances: (class, surface).
KINDS = ((3, 30), (3, 31), (4, 40))


def content(seed: int) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """A frame as a renderer would give it: 200 blobs that hide one another, on rough ground."""
    draw = np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    horizon = 90 + 15 * np.sin(x / 70 + seed)
    sky = y < horizon
    below = np.maximum(y - horizon, 0)
    depth = np.where(sky, np.inf, 900 / (below + 12) + 0.02 * draw.normal(size=y.shape))
    wave = np.sin(x / 40 + seed) + np.sin(y / 25 - x / 90)
    labels = {
        "class": np.where(sky, 1, 2).astype(np.uint32),
        "surface": np.where(sky, 7, np.where(wave > 0.3, 21, 20)).astype(np.uint32),
    }
    albedo = np.where(sky, 0.6, np.where(wave > 0.3, 0.25, 0.4))
    instance = np.zeros((HEIGHT, WIDTH), np.uint32)
    # Drawn until there are as many as there shall be: far ones first, near ones hide them.
    rank = 0
    while True:
        todo = INSTANCES - len(np.unique(instance[instance > 0]))
        if todo <= 0:
            break
        for _ in range(todo):
            rank += 1
            paint(draw, rank, x, y, instance, labels, depth, albedo)
    keep = np.unique(instance[instance > 0])[:INSTANCES]
    instance = rle.only(instance, keep)
    light = albedo[..., None] * np.array([0.9, 0.7, 0.5]) * 3000
    rgb = light * (1 + 0.15 * draw.normal(size=(HEIGHT, WIDTH, 3)))
    passes = {
        "rgb": np.maximum(rgb, 0).astype(np.float32),
        **{f"label.{level}": ids for level, ids in labels.items()},
        "instance": instance,
        "depth": depth.astype(np.float32),
    }
    return passes, table(passes, keep)


def paint(
    draw: np.random.Generator,
    rank: int,
    x: NDArray[Any],
    y: NDArray[Any],
    instance: NDArray[Any],
    labels: dict[str, NDArray[Any]],
    depth: NDArray[Any],
    albedo: NDArray[Any],
) -> None:
    """Paint one blob with a ragged edge over what is there."""
    size = float(np.exp(draw.uniform(np.log(4), np.log(26))))
    cx, cy = draw.uniform(0, WIDTH), draw.uniform(110, HEIGHT)
    low = np.maximum([int(cy - 1.5 * size), int(cx - 1.5 * size)], 0)
    part = (
        slice(low[0], int(cy + 1.5 * size) + 1),
        slice(low[1], int(cx + 1.5 * size) + 1),
    )
    dx, dy = x[part] - cx, (y[part] - cy) * 1.3
    angle = np.arctan2(dy, dx)
    edge = size * (1 + 0.15 * np.sin(3 * angle + rank) + 0.08 * np.sin(11 * angle - rank))
    inside = np.hypot(dx, dy) < edge
    number = rank * 7 + 3
    kind = KINDS[rank % 3]
    instance[part][inside] = number
    labels["class"][part][inside], labels["surface"][part][inside] = kind
    depth[part][inside] = (8 + 900 / (cy - 60) - 0.05 * np.cos(angle) * dx)[inside]
    albedo[part][inside] = (0.2 + 0.1 * np.cos(angle))[inside]


def table(passes: dict[str, NDArray[Any]], ids: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The frame's table, with all its columns."""
    draw = np.random.default_rng(int(ids.sum()))
    areas, boxes = rle.boxes(passes["instance"], ids)
    n = len(ids)
    kinds = [KINDS[(number - 3) // 7 % 3] for number in ids.tolist()]
    columns: dict[str, NDArray[Any]] = {
        "id": ids,
        "class": np.full(n, "/World/Objects/rocks"),
        "local_id": ids,
        "label.class": np.array([NAMES["class"][kind[0]] for kind in kinds]),
        "label.surface": np.array([NAMES["surface"][kind[1]] for kind in kinds]),
        "pixels": areas,
        "x_min": boxes[:, 0],
        "y_min": boxes[:, 1],
        "x_max": boxes[:, 0] + boxes[:, 2] - 1,
        "y_max": boxes[:, 1] + boxes[:, 3] - 1,
        "truncated": np.zeros(n, np.int64),
    }
    floats = ("depth_min", "depth_mean", "depth_max")
    columns |= {name: draw.uniform(5, 30, n) for name in floats}
    columns |= {"amodal": areas + 5, "amodal_full": areas + 5, "amodal_bounded": areas * 0 + 1}
    pose = ("x", "y", "z", "qx", "qy", "qz", "qw")
    box = ("size_x", "size_y", "size_z", "box_x", "box_y", "box_z")
    names = (*(f"cam_{name}" for name in pose), *pose, *box)
    return columns | {name: draw.uniform(-20, 20, n) for name in names}


def write_output(out: Path, count: int) -> int:
    """Write ``count`` frames; returns the bytes of a frame's EXR, on average."""
    name = "batch_0000"
    manifest = {
        "name": "bench",
        "seed": 0,
        "batches": [{"index": 0, "path": name, "stage": f"{name}/stage.usda", "samples": count}],
        "files": {f"{name}/stage.usda": {"sha256": hashlib.sha256(b"bench").hexdigest()}},
    }
    write_json(out / "manifest.json", manifest)
    digest = stage_digest(read_manifest(out), name)
    intrinsics = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    camera = Camera("front", "/World/Rigs/front", WIDTH, HEIGHT, intrinsics, np.eye(4), -11.0)
    scene = RenderScene(
        out / name / "stage.usda", digest, count, (),
        Rows(np.zeros(0, "i4"), np.zeros((0, 3, 4)), np.zeros(0, "u4"), np.zeros(0, "f4")),
        (), tuple(NAMES), NAMES, {"class": 1, "surface": 7}, ((camera,),) * count,
        (Lighting((), ()),) * count,
        np.zeros((2, 3)), {"/World/Objects/rocks": 0}, 0.1 * np.arange(count),
    )  # fmt: skip
    sizes = []
    for sample in range(count):
        stem = frame_stem(out / name, "mitsuba", "front", sample)
        if sample < CONTENTS:
            passes, columns = content(sample)
            key = FrameKey(digest, tuple(passes), 64, 0, "mitsuba", "bench")
            renderer = RendererFacts("mitsuba", "bench", "cpu", None, None)
            record = describe_frame(scene, camera, sample, renderer)
            write_frame(stem, FrameResult(passes, record, Seen(columns)), key, scene, camera)
            sizes.append(stem.with_suffix(".exr").stat().st_size)
            continue
        twin = stem.with_name(f"{sample % CONTENTS:06d}")
        sidecar = json.loads(twin.with_suffix(".json").read_bytes())
        for suffix in (".exr", ".png", ".instances.csv"):
            os.link(f"{twin}{suffix}", f"{stem}{suffix}")
        write_json(stem.with_suffix(".json"), {**sidecar, "sample": sample, "time_s": 0.1 * sample})
    return int(mean(sizes))


def export(out: Path, folder: Path, count: int, workers: int) -> None:
    """Exports the first frames."""
    with make_executor(workers) as executor:
        export_frames(out, "coco", folder, Choice(samples=range(count)), executor=executor)


def exports(study: Study, out: Path, count: int, workers: int) -> Iterator[list[Cell]]:
    """The rows of the first table: each an export by processes of its own."""
    apart(export, out, study.scratch / "warm", min(2, count), 1)
    for some in sorted({min(100, count), min(300, count), count}):
        cost = apart(export, out, study.scratch / f"set_{some}", some, workers)
        yield [some, cost.wall_s, cost.cpu_s, cost.cpu_s / workers, cost.peak_mib]


def _ms(call: Callable[[], Any], runs: int = 5) -> float:
    return 1e3 * median(times(call, runs).cpu)


def stages(study: Study, out: Path) -> None:
    """What each stage takes, on one frame of each of three contents."""
    source, folder = Source(out), study.scratch / "one"
    folder.mkdir()
    coco = Coco(Info("bench", NAMES, "class", source.passes(), ("all",), {}))
    each = [
        of_frame(source.load(ref, (), ("rgb",)), coco, folder)
        for ref in source.frames[: 1 if study.fast else 3]
    ]
    found = {name: mean(one[name] for one in each) for name in each[0]}
    study.table(["one process, of a frame", "CPU ms, bytes or pixels"], map(list, found.items()))
    study.say(
        f"{_LOOP}: {found[_LOOP] / found[_MASKS]:.0f} times as long as ours, "
        f"{found[_LOOP] / found[_ALL]:.1f} times as long as {_ALL}."
    )


def of_frame(frame: LoadedFrame, coco: Coco, folder: Path) -> dict[str, float]:
    """CPU milliseconds of each stage of one frame; then sizes and the error of polygons."""
    ref = frame.ref
    instance, ids = frame.passes["instance"], frame.table["id"].astype(np.uint32)
    exr, task = ref.stem.with_suffix(".exr"), Task(ref.index, "all", (ref,))
    png = exr.with_suffix(".png")
    times = {
        "checksum of the EXR": _ms(lambda: sha256(exr)),
        "EXR without rgb": _ms(lambda: read_exr(exr, ("rgb",))),
        "EXR, all passes (for comparison)": _ms(lambda: read_exr(exr)),
        "table of instances": _ms(lambda: read_frame_table(ref.stem)),
        "digest of the annotation": _ms(frame.annotation_digest),
        "checksum of the picture": _ms(lambda: sha256(png)),
        "statistics": _ms(lambda: measure(frame)),
        _ALL: _ms(lambda: coco.write(task, [frame], folder, folder)),
        _MASKS: _ms(lambda: masks(instance, ids)),
        "picture (hard link)": _ms(lambda: place_picture(frame, folder / "a.png", "link")),
        "polygons (for comparison)": _ms(lambda: outlines(instance, ids)),
        _LOOP: _ms(lambda: loop(instance, ids), 1),
    }
    texts = rle.compressed(*rle.encode_ids(instance, ids))
    polygons = outlines(instance, ids)
    wrong = 0
    for number, parts in zip(ids, polygons, strict=True):
        encoded = coco_mask.merge(coco_mask.frPyObjects(parts, HEIGHT, WIDTH))
        wrong += int((coco_mask.decode(encoded).astype(bool) != (instance == number)).sum())
    return times | {
        "bytes of a mask as run lengths": len(dumps(texts)) / len(ids),
        "as polygons": len(dumps(polygons)) / len(ids),
        "pixels that differ when pycocotools fills the polygons": wrong,
    }


def masks(instance: NDArray[Any], ids: NDArray[Any]) -> Any:
    """What the exporter does about masks."""
    return rle.compressed(*rle.encode_ids(instance, ids)), rle.boxes(instance, ids)


def loop(instance: NDArray[Any], ids: NDArray[Any]) -> Any:
    """The same with pycocotools, mask by mask."""
    found = []
    for number in ids.tolist():
        encoded = coco_mask.encode(np.asfortranarray(instance == number).view(np.uint8))
        found.append((encoded, coco_mask.area(encoded), coco_mask.toBbox(encoded)))
    return found


def main(study: Study) -> None:
    """Prints the tables."""
    # pycocotools' own call of NumPy.
    warnings.filterwarnings("ignore", "__array__ implementation", DeprecationWarning)
    count, out = 30 if study.fast else study.options.frames, study.scratch / "out"
    workers = study.options.workers or os.process_cpu_count() or 1
    size = write_output(out, count)
    study.say(
        f"{count} frames of {WIDTH} x {HEIGHT}, {INSTANCES} instances each, EXR of "
        f"{size / 1e6:.1f} MB; {workers} processes.\n"
    )
    header = ["frames", "wall s", "CPU s", "CPU s / process", "largest process, MiB"]
    study.table(header, exports(study, out, count, workers))
    stages(study, out)


if __name__ == "__main__":
    run(main, frames=1000, workers=int)
