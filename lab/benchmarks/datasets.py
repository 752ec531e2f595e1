"""Exports: COCO's seconds by stage and memory over frames, HDF5 against plain writing.

    python lab/benchmarks/datasets.py [--frames N] [--workers N] [--folder FOLDER] [--fast]

Frames of 640 x 480, some 200 instances, labels, depth and noisy rgb: a few contents, rendered by
pyrender, each under many sample numbers. *coco* makes a dataset of 100, 300 and all of them, by
processes of its own: on a machine that others use, CPU seconds over cores say what the wall clock
would. Its stages are timed one by one in this process; the loop that they are held against takes
the same arrays and does with pycocotools what an exporter does: each id's mask, its run lengths,
area and box. Polygons are filled by pycocotools and held against the masks. *hdf5* writes frames of
1280 x 720 of noise that are in memory, through the exporter's own file, and plainly, the bytes of
their arrays; both are synced, take turns, and the figure is the median of the ratios.
"""

from __future__ import annotations

import json
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import mean, median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from scenec.backends.run.executors import make_executor
from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.datasets.export import Choice
from scenec.datasets.export import export as export_frames
from scenec.datasets.formats.coco import Coco
from scenec.datasets.formats.coco_parts import dumps, place_picture
from scenec.datasets.formats.contract import Info, Task
from scenec.datasets.formats.hdf5 import Hdf5
from scenec.datasets.outlines import outlines
from scenec.datasets.source import FrameRef, LoadedFrame, Source
from scenec.datasets.statistics import measure
from scenec.lab.benchmarks.cfgs import rocks_on_hills
from scenec.lab.runner import Cell, Study, apart, in_turns, run, times
from scenec.schemas import rle
from scenec.schemas.budget import usable_cores
from scenec.schemas.exr import read_exr
from scenec.schemas.files import sha256, write_json
from scenec.schemas.instances import read_frame_table
from scenec.schemas.records import FileDigest, FrameRecord

_LOOP = "pycocotools' loop over run lengths, areas and boxes"
_MASKS, _ALL = "run lengths, areas, boxes", "all that the format does"
CONTENTS = 20


def write_output(study: Study, out: Path, count: int) -> str:
    """Renders frames and links them under other sample numbers; says what they are."""
    rendered = min(2 if study.fast else CONTENTS, count)
    cfg = rocks_on_hills(1600, samples=count)
    cfg["objects"]["rocks"]["size_m"] = {"type": "log_uniform", "min": 0.25, "max": 1.2}
    cfg["rigs"]["rover"]["pose"]["position"]["x_m"] = {"type": "uniform", "min": -20, "max": 20}
    compile_cfg(study.cfg(cfg), seed=1, out=out)
    report = render(out, "pyrender", spp=2, samples=range(rendered))
    size, seen = [], []
    for stem in report.frames:
        size.append(stem.with_suffix(".exr").stat().st_size)
        seen.append(len(read_frame_table(stem)["id"]))
    for sample in range(rendered, count):
        twin = report.frames[sample % rendered]
        stem = twin.with_name(f"{sample:06d}")
        sidecar = json.loads(twin.with_suffix(".json").read_bytes())
        for suffix in (".exr", ".png", ".instances.csv"):
            if Path(f"{twin}{suffix}").exists():
                os.link(f"{twin}{suffix}", f"{stem}{suffix}")
        write_json(stem.with_suffix(".json"), {**sidecar, "sample": sample, "time_s": 0.1 * sample})
    return (
        f"{count} frames of 640 x 480, {mean(seen):.0f} instances, EXR of {mean(size) / 1e6:.1f} MB"
    )


def export(out: Path, folder: Path, count: int, workers: int) -> None:
    """Exports the first frames."""
    with make_executor(workers) as executor:
        export_frames(out, "coco", folder, Choice(samples=range(count)), executor=executor)


def coco(study: Study) -> None:
    """Prints the tables of COCO."""
    count, out = 30 if study.fast else study.options.frames, study.scratch / "out"
    workers = study.options.workers or usable_cores()
    study.say(f"{write_output(study, out, count)}; {workers} processes.\n")

    def exports() -> Iterator[list[Cell]]:
        apart(export, out, study.scratch / "warm", min(2, count), 1)
        for some in sorted({min(100, count), min(300, count), count}):
            cost = apart(export, out, study.scratch / f"set_{some}", some, workers)
            yield [some, cost.wall_s, cost.cpu_s, cost.cpu_s / workers, cost.peak_mib]

    header = ["frames", "wall s", "CPU s", "CPU s / process", "largest process, MiB"]
    study.table(header, exports())
    source, folder = Source(out), study.scratch / "one"
    folder.mkdir()
    form = Coco(Info("bench", source.labels, "class", source.passes(), ("all",), {}))
    each = [
        of_frame(source.load(ref, (), ("rgb",)), form, folder)
        for ref in source.frames[: 1 if study.fast else 3]
    ]
    found = {name: mean(one[name] for one in each) for name in each[0]}
    study.table(["one process, of a frame", "CPU ms, bytes or pixels"], map(list, found.items()))
    study.say(
        f"{_LOOP}: {found[_LOOP] / found[_MASKS]:.0f} times as long as ours, "
        f"{found[_LOOP] / found[_ALL]:.1f} times as long as {_ALL}.\n"
    )


def of_frame(frame: LoadedFrame, form: Coco, folder: Path) -> dict[str, float]:
    """CPU milliseconds of each stage of one frame; then sizes and the error of polygons."""
    ref = frame.ref
    instance, ids = frame.passes["instance"], frame.table["id"].astype(np.uint32)
    exr, task = ref.stem.with_suffix(".exr"), Task(ref.index, "all", (ref,))
    png = exr.with_suffix(".png")
    works: dict[str, Callable[[], Any]] = {
        "checksum of the EXR": lambda: sha256(exr),
        "EXR without rgb": lambda: read_exr(exr, ("rgb",)),
        "EXR, all passes (for comparison)": lambda: read_exr(exr),
        "table of instances": lambda: read_frame_table(ref.stem),
        "digest of the annotation": frame.annotation_digest,
        "checksum of the picture": lambda: sha256(png),
        "statistics": lambda: measure(frame),
        _ALL: lambda: form.write(task, [frame], folder, folder),
        _MASKS: lambda: (
            rle.compressed(*rle.encode_ids(instance, ids)), rle.boxes(instance, ids)
        ),
        "picture (hard link)": lambda: place_picture(frame, folder / "a.png", "link"),
        "polygons (for comparison)": lambda: outlines(instance, ids),
        _LOOP: lambda: loop(instance, ids),
    }  # fmt: skip
    found = {name: 1e3 * median(times(work, 3).cpu) for name, work in works.items()}
    texts = rle.compressed(*rle.encode_ids(instance, ids))
    polygons = outlines(instance, ids)
    wrong = 0
    for number, parts in zip(ids, polygons, strict=True):
        encoded = coco_mask.merge(coco_mask.frPyObjects(parts, *instance.shape))
        wrong += int((coco_mask.decode(encoded).astype(bool) != (instance == number)).sum())
    return found | {
        "bytes of a mask as run lengths": len(dumps(texts)) / len(ids),
        "as polygons": len(dumps(polygons)) / len(ids),
        "pixels that differ when pycocotools fills the polygons": wrong,
    }


def loop(instance: NDArray[Any], ids: NDArray[Any]) -> Any:
    """Run lengths, areas and boxes with pycocotools, mask by mask."""
    found = []
    for number in ids.tolist():
        encoded = coco_mask.encode(np.asfortranarray(instance == number).view(np.uint8))
        found.append((encoded, coco_mask.area(encoded), coco_mask.toBbox(encoded)))
    return found


def noise(number: int) -> LoadedFrame:
    """A frame of noise: nothing a file system could make smaller."""
    rng, shape, instances = np.random.default_rng(number), (720, 1280), 500
    passes = {
        "rgb": rng.random((*shape, 3), np.float32),
        "label.class": rng.integers(0, 4, shape, np.uint32),
        "instance": rng.integers(0, instances, shape, np.uint32),
        "depth": rng.random(shape, np.float32),
    }
    columns = ("id", "pixels", "x_min", "y_min", "x_max", "y_max", "depth_mean", "x", "y", "z")
    table = {name: np.arange(1, instances + 1).astype(np.float64) for name in columns}
    sidecar = FrameRecord(
        camera="camera", sample=number, resolution=(1280, 720), time_s=float(number),
        intrinsics=((1, 0, 0), (0, 1, 0), (0, 0, 1)), exposure_ev=0.0, passes=tuple(passes),
        camera_to_world=((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)), labels={},
        backend="none", stage_digest="", exr=FileDigest(sha256=""),
    )  # fmt: skip
    ref = FrameRef(number, 0, "batch_0000", "none", "camera", number, Path(f"{number:06d}"))
    labels = {"class": {1: "sky", 2: "ground", 3: "rock"}}
    return LoadedFrame(ref, passes, sidecar, table, labels, np.zeros(instances, np.bool_))


def hdf5(study: Study) -> None:
    """Prints the table of HDF5."""
    # A file of the exporter has up to 500; these are few different ones, over and over.
    frames = [noise(number) for number in range(16)] * (1 if study.fast else 3)
    arrays = [
        array.astype(np.uint8) if name.startswith("label.") else array
        for frame in frames for name, array in frame.passes.items()
    ]  # fmt: skip
    size = sum(array.nbytes for array in arrays) / 1e6
    form = Hdf5(Info("bench", frames[0].labels, "class", tuple(frames[0].passes), ("all",), {}))

    def plain(path: Path) -> None:
        with path.open("wb") as file:
            for array in arrays:
                file.write(array.data)

    with tempfile.TemporaryDirectory(dir=study.options.folder) as work:

        def synced(write: Callable[[Path], object]) -> Callable[[int], None]:
            def once(_turn: int) -> None:
                path = Path(work, "frames")
                path.unlink(missing_ok=True)
                write(path)
                with path.open("rb+") as file:
                    os.fsync(file.fileno())

            return once

        found = in_turns(
            {
                "plain": synced(plain),
                "hdf5": synced(lambda path: form.write_file(path, iter(frames), len(frames))),
            },
            2 if study.fast else 9,
        )
    rows = [
        [name, t.median, min(t.wall), size / min(t.wall), np.median(t.cpu), found["plain"].over(t)]
        for name, t in found.items()
    ]
    header = [f"{len(frames)} frames of 1280 x 720, {size:.0f} MB", "s", "best s", "MB/s"]
    study.table([*header, "CPU s", "speed by plain's, median of rounds"], rows)


def main(study: Study) -> None:
    """Prints the tables."""
    # pycocotools' own call of NumPy.
    warnings.filterwarnings("ignore", "__array__ implementation", DeprecationWarning)
    coco(study)
    hdf5(study)


if __name__ == "__main__":
    run(main, frames=1000, workers=int, folder=Path)
