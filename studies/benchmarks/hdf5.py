"""HDF5 export against plain writing: the same frames, the same disk, the same run.

    python studies/benchmarks/hdf5.py [OUT] [FOLDER]

Frames are in memory. *plain* writes the bytes of their arrays to one file and syncs it; *hdf5*
writes the same arrays through the exporter's own file and syncs that. They take turns, and the
figure is the median of the ratios of rounds that follow each other: on a busy machine a single one
says little. With OUT, an output folder with frames, there is the whole way as well: reading and
checking EXR (ZIP inside), the table, digests and statistics, writing.
"""

from __future__ import annotations

import os
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.contract import Info
from scenec.datasets.formats.hdf5 import Hdf5
from scenec.datasets.source import FrameRef, LoadedFrame, Source

#: A file of the exporter has up to 500; these are few different ones, over and over.
FRAMES = 48
DIFFERENT = 16
ROUNDS = 9
WIDTH, HEIGHT = 1280, 720
INSTANCES = 500
LABELS = {"class": {1: "sky", 2: "ground", 3: "rock"}}


def main() -> None:
    """Prints the tables."""
    folder = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(tempfile.gettempdir())
    work = Path(tempfile.mkdtemp(dir=folder))
    try:
        in_memory(work)
        if len(sys.argv) > 1:
            end_to_end(Path(sys.argv[1]), work)
    finally:
        shutil.rmtree(work)


def in_memory(work: Path) -> None:
    """Writes frames that are in memory already."""
    frames = [made(number) for number in range(DIFFERENT)] * (FRAMES // DIFFERENT)
    size = sum(array.nbytes for frame in frames for array in stored(frame))
    print(f"{FRAMES} frames of {WIDTH} x {HEIGHT}, {INSTANCES} instances each, {size / 1e6:.0f} MB")
    print(f"{'synced':14}{'s':>8}{'best s':>8}{'MB/s':>8}{'CPU s':>8}")

    def plain(path: Path) -> None:
        with path.open("wb") as file:
            for frame in frames:
                for array in stored(frame):
                    file.write(array.data)

    form = Hdf5(Info("bench", LABELS, "class", tuple(frames[0].passes), ("all",), {}))

    def hdf5(path: Path) -> None:
        form.write_file(path, iter(frames), FRAMES)

    ways = {"plain write": plain, "hdf5": hdf5}
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    busy: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(ROUNDS + 1):
        # By turns the first, so that what a write leaves to the disk to do falls on both.
        for name, write in sorted(ways.items(), reverse=bool(turn % 2)):
            path = work / "frames"
            start, cpu = time.perf_counter(), time.process_time()
            write(path)
            with path.open("rb+") as file:
                os.fsync(file.fileno())
            # The first round warms up.
            if turn:
                seconds[name].append(time.perf_counter() - start)
                busy[name].append(time.process_time() - cpu)
            path.unlink()
    for name in ways:
        middle, best = statistics.median(seconds[name]), min(seconds[name])
        print(
            f"{name:14}{middle:8.2f}{best:8.2f}{size / 1e6 / best:8.0f}"
            f"{statistics.median(busy[name]):8.2f}"
        )
    pairs = zip(seconds["plain write"], seconds["hdf5"], strict=True)
    ratios = sorted(plain_s / hdf5_s for plain_s, hdf5_s in pairs)
    print(
        f"speed of hdf5 by that of plain: median of rounds {statistics.median(ratios):.0%}; "
        f"all of them {', '.join(f'{ratio:.0%}' for ratio in ratios)}"
    )


def end_to_end(out: Path, work: Path) -> None:
    """Exports an output folder with one worker, and says what reading alone costs of it."""
    source = Source(out)
    start = time.perf_counter()
    raw = 0
    for ref in source.frames:
        raw += sum(array.nbytes for array in source.load(ref).passes.values())
    reading = time.perf_counter() - start
    start = time.perf_counter()
    export(out, "hdf5", work / "dataset", Choice(), workers=1)
    whole = time.perf_counter() - start
    count = len(source)
    print(
        f"\n{count} frames end to end, one worker: {whole:.2f} s, {raw / 1e6 / whole:.0f} MB/s; "
        f"reading and checking the EXR alone {reading:.2f} s ({reading / whole:.0%})"
    )


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
    sidecar = {
        "resolution": [WIDTH, HEIGHT],
        "intrinsics": np.eye(3).tolist(),
        "camera_to_world": np.eye(4).tolist(),
        "time_s": float(number),
        "exposure_ev": 0.0,
    }
    ref = FrameRef(number, 0, "batch_0000", "none", "camera", number, Path(f"{number:06d}"))
    return LoadedFrame(ref, passes, sidecar, table, LABELS, np.zeros(INSTANCES, np.bool_))


if __name__ == "__main__":
    main()
