"""HDF5 export against plain writing: the same frames, the same disk, the same run.

    python lab/benchmarks/hdf5.py [--folder FOLDER] [--fast]

Frames are in memory. *Plain* writes the bytes of their arrays to one file and syncs it; *hdf5*
writes the same arrays through the exporter's own file and syncs that. They take turns, and the
figure is the median of the ratios of rounds that follow each other: on a busy machine a single one
says little.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from scenec.datasets.formats.contract import Info
from scenec.datasets.formats.hdf5 import Hdf5
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.lab.runner import Study, in_turns, run
from scenec.schemas.records import FileDigest, FrameRecord

#: A file of the exporter has up to 500; these are few different ones, over and over.
FRAMES = 48
DIFFERENT = 16
ROUNDS = 9
WIDTH, HEIGHT = 1280, 720
INSTANCES = 500
LABELS = {"class": {1: "sky", 2: "ground", 3: "rock"}}


def stored(frame: LoadedFrame) -> list[np.ndarray]:
    """The arrays as they lie in the file."""
    return [
        array.astype(np.uint8) if name.startswith("label.") else array
        for name, array in frame.passes.items()
    ]


def made(number: int) -> LoadedFrame:
    """A frame of noise: nothing a file system could make smaller."""
    rng = np.random.default_rng(number)
    shape = (HEIGHT, WIDTH)
    passes = {
        "rgb": rng.random((*shape, 3), np.float32),
        "label.class": rng.integers(0, 4, shape, np.uint32),
        "instance": rng.integers(0, INSTANCES, shape, np.uint32),
        "depth": rng.random(shape, np.float32),
    }
    columns = ("id", "pixels", "x_min", "y_min", "x_max", "y_max", "depth_mean", "x", "y", "z")
    table = {name: np.arange(1, INSTANCES + 1).astype(np.float64) for name in columns}
    sidecar = FrameRecord(
        camera="camera",
        sample=number,
        resolution=(WIDTH, HEIGHT),
        intrinsics=((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        camera_to_world=((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
        time_s=float(number),
        exposure_ev=0.0,
        passes=tuple(passes),
        labels={},
        backend="none",
        stage_digest="",
        exr=FileDigest(sha256=""),
    )
    ref = FrameRef(number, 0, "batch_0000", "none", "camera", number, Path(f"{number:06d}"))
    return LoadedFrame(ref, passes, sidecar, table, LABELS, np.zeros(INSTANCES, np.bool_))


def main(study: Study) -> None:
    """Prints the tables."""
    with tempfile.TemporaryDirectory(dir=study.options.folder) as work:
        in_memory(study, Path(work))


def in_memory(study: Study, work: Path) -> None:
    """Writes frames that are in memory already."""
    count = DIFFERENT if study.fast else FRAMES
    frames = [made(number) for number in range(DIFFERENT)] * (count // DIFFERENT)
    size = sum(array.nbytes for frame in frames for array in stored(frame)) / 1e6
    form = Hdf5(Info("bench", LABELS, "class", tuple(frames[0].passes), ("all",), {}))

    def plain(path: Path) -> None:
        with path.open("wb") as file:
            for frame in frames:
                for array in stored(frame):
                    file.write(array.data)

    def synced(write: Callable[[Path], object]) -> Callable[[int], None]:
        def once(_turn: int) -> None:
            path = work / "frames"
            path.unlink(missing_ok=True)
            write(path)
            with path.open("rb+") as file:
                os.fsync(file.fileno())

        return once

    works = {
        "plain": synced(plain),
        "hdf5": synced(lambda path: form.write_file(path, iter(frames), count)),
    }
    found = in_turns(works, 2 if study.fast else ROUNDS)
    plain_times = found["plain"]
    rows = [
        [name, t.median, min(t.wall), size / min(t.wall), np.median(t.cpu), plain_times.over(t)]
        for name, t in found.items()
    ]
    header = [f"{count} frames of {WIDTH} x {HEIGHT}, {size:.0f} MB", "s", "best s", "MB/s"]
    study.table([*header, "CPU s", "speed by plain's, median of rounds"], rows)


if __name__ == "__main__":
    run(main, folder=Path)
