"""COCO export: seconds of each stage, memory over frames, and pycocotools' own loop beside it.

    python studies/benchmarks/coco.py [FRAMES] [WORKERS]

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
import shutil
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from scenec.backends.annotation.instances import Seen
from scenec.backends.run.writer import write_frame
from scenec.backends.stage.scene import Camera, Lighting, RenderScene, Rows
from scenec.datasets.formats.coco import Coco
from scenec.datasets.formats.coco_parts import dumps, place_picture
from scenec.datasets.formats.contract import Info, Task
from scenec.datasets.outlines import outlines
from scenec.datasets.source import LoadedFrame, Source
from scenec.datasets.statistics import measure
from scenec.schemas import rle
from scenec.schemas.exr import read_exr
from scenec.schemas.files import sha256, write_json
from scenec.schemas.frames import FrameKey, frame_stem
from scenec.schemas.instances import read_frame_table
from scenec.schemas.manifest import stage_digest

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
    digest = stage_digest(manifest, name)
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
            write_frame(stem, passes, key, scene, camera, sample, {}, Seen(columns))
            sizes.append(stem.with_suffix(".exr").stat().st_size)
            continue
        twin = stem.with_name(f"{sample % CONTENTS:06d}")
        sidecar = json.loads(twin.with_suffix(".json").read_bytes())
        for suffix in (".exr", ".png", ".instances.csv"):
            os.link(f"{twin}{suffix}", f"{stem}{suffix}")
        write_json(stem.with_suffix(".json"), {**sidecar, "sample": sample, "time_s": 0.1 * sample})
    return int(statistics.mean(sizes))


EXPORT = """
import sys
from scenec.datasets.export import Choice, export
out, folder, count, workers = sys.argv[1:]
export(out, "coco", folder, Choice(samples=range(int(count))), workers=int(workers))
"""


def export(out: Path, folder: Path, count: int, workers: int) -> tuple[float, float, float]:
    """Wall and CPU seconds of an export and its processes, and MiB of the largest of them."""
    command = [sys.executable, "-c", EXPORT, str(out), str(folder), str(count), str(workers)]
    start = time.perf_counter()
    pid = os.posix_spawn(command[0], command, os.environ)
    _, status, usage = os.wait4(pid, 0)
    if status:
        raise SystemExit(f"exit status {os.waitstatus_to_exitcode(status)}")
    seconds = time.perf_counter() - start
    return seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def milliseconds(call: Callable[[], Any], repeat: int = 5) -> float:
    """CPU time of a call, the median of some."""
    call()
    times = []
    for _ in range(repeat):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return 1e3 * statistics.median(times)


def stages(out: Path, folder: Path) -> None:
    """Prints what each stage takes, on one frame of each of three contents."""
    source = Source(out)
    coco = Coco(Info("bench", NAMES, "class", source.passes(), ("all",), {}))
    rows: dict[str, list[float]] = {}
    for ref in source.frames[:3]:
        for name, value in of_frame(source.load(ref, (), ("rgb",)), coco, folder).items():
            rows.setdefault(name, []).append(value)
    found = {name: statistics.mean(values) for name, values in rows.items()}
    print("\none process, CPU milliseconds a frame")
    for name in list(found)[:-3]:
        print(f"  {name:36}{found[name]:9.2f}")
    print(
        f"\npycocotools' loop over run lengths, areas and boxes: "
        f"{found['pycocotools'] / found['run lengths, areas, boxes']:.0f} times as long as ours, "
        f"{found['pycocotools'] / found['all that the format does']:.1f} times as long as all that "
        "the format does"
    )
    print(
        f"bytes of a mask: {found['as run lengths']:.0f} as run lengths, "
        f"{found['as polygons']:.0f} as polygons; {sum(rows['pixels that differ']):.0f} pixels are "
        "others when pycocotools fills the polygons"
    )


def of_frame(frame: LoadedFrame, coco: Coco, folder: Path) -> dict[str, float]:
    """CPU milliseconds of each stage of one frame; then sizes and the error of polygons."""
    ref = frame.ref
    instance, ids = frame.passes["instance"], frame.table["id"].astype(np.uint32)
    exr, task = ref.stem.with_suffix(".exr"), Task(ref.index, "all", (ref,))
    png = exr.with_suffix(".png")
    times = {
        "checksum of the EXR": milliseconds(lambda: sha256(exr)),
        "EXR without rgb": milliseconds(lambda: read_exr(exr, ("rgb",))),
        "EXR, all passes (for comparison)": milliseconds(lambda: read_exr(exr)),
        "table of instances": milliseconds(lambda: read_frame_table(ref.stem)),
        "digest of the annotation": milliseconds(frame.annotation_digest),
        "checksum of the picture": milliseconds(lambda: sha256(png)),
        "statistics": milliseconds(lambda: measure(frame)),
        "all that the format does": milliseconds(lambda: coco.write(task, [frame], folder, folder)),
        "run lengths, areas, boxes": milliseconds(lambda: masks(instance, ids)),
        "picture (hard link)": milliseconds(lambda: place_picture(frame, folder / "a.png", "link")),
        "polygons (for comparison)": milliseconds(lambda: outlines(instance, ids)),
        "pycocotools": milliseconds(lambda: loop(instance, ids), 1),
    }
    texts = rle.compressed(*rle.encode_ids(instance, ids))
    polygons = outlines(instance, ids)
    wrong = 0
    for number, parts in zip(ids, polygons, strict=True):
        encoded = coco_mask.merge(coco_mask.frPyObjects(parts, HEIGHT, WIDTH))
        wrong += int((coco_mask.decode(encoded).astype(bool) != (instance == number)).sum())
    return times | {
        "as run lengths": len(dumps(texts)) / len(ids),
        "as polygons": len(dumps(polygons)) / len(ids),
        "pixels that differ": wrong,
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


def main() -> None:
    """Prints the tables."""
    # pycocotools' own call of NumPy.
    warnings.filterwarnings("ignore", "__array__ implementation", DeprecationWarning)
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    workers = int(sys.argv[2]) if len(sys.argv) > 2 else os.process_cpu_count() or 1
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        size = write_output(folder / "out", count)
        print(
            f"{count} frames of {WIDTH} x {HEIGHT}, {INSTANCES} instances each, EXR of "
            f"{size / 1e6:.1f} MB; {workers} processes, {os.process_cpu_count()} cores, load "
            f"{os.getloadavg()[0]:.1f}"
        )
        export(folder / "out", folder / "warm", min(2, count), 1)
        print(f"{'frames':>8}{'wall s':>9}{'CPU s':>9}{'CPU s / core':>14}{'largest MiB':>13}")
        for some in sorted({min(100, count), min(300, count), count}):
            wall, cpu, memory = export(folder / "out", folder / "set", some, workers)
            print(f"{some:8}{wall:9.1f}{cpu:9.1f}{cpu / workers:14.1f}{memory:13.0f}")
            shutil.rmtree(folder / "set")
        (folder / "scratch").mkdir()
        stages(folder / "out", folder / "scratch")


if __name__ == "__main__":
    main()
