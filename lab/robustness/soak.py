"""Makes many frames, and compiles many cfgs, in one process each: does anything pile up?

    python lab/robustness/soak.py [--frames N] [--compiles N] [--works A,B,...] [-o FOLDER]

Each work runs in a fresh process that nothing supervises, so that nothing is replaced when it
grows. Forty-eight times, after a frame or an output, its resident memory, what it has allocated by
the C library, Python's blocks, file descriptors, threads and child processes are counted; before
that, what is free goes back to the system. The first quarter warms up. Growth is the slope of a
line through the means of twelve parts of the rest; its standard error is that of the parts about
the line. ``openusd`` writes layers of twenty prims by OpenUSD alone: what of a compilation's growth
is not scenec's.
"""

from __future__ import annotations

import ctypes
import gc
import math
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from scenec.lab.runner import Page, apart, names, run
from scenec.testing.small import small_cfg, write_cfg

#: Readings; the share of them that warm up, and parts of the others.
READINGS, WARM, PARTS = 48, 0.25, 12
RENDERERS = {"annotation": 1, "mitsuba": 4, "cycles": 4, "pyrender": 1}
PASSES = ("label", "instance", "depth", "normal")


class _MallInfo(ctypes.Structure):
    """``struct mallinfo2`` of glibc 2.33."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks",
                     "uordblks", "fordblks", "keepcost")
    )  # fmt: skip


def _allocated() -> int:
    """Bytes that this process holds of the C library, once what is free has gone back."""
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallinfo2"):
        return 0
    libc.malloc_trim(0)
    libc.mallinfo2.restype = _MallInfo
    found = libc.mallinfo2()
    return int(found.uordblks + found.hblkhd)


#: What is read of a process: bytes, Python's blocks, and numbers of the others.
READ: dict[str, Callable[[psutil.Process], int]] = {
    "allocated": lambda _: _allocated(),
    "memory": lambda own: own.memory_info().rss,
    "blocks": lambda _: sys.getallocatedblocks(),
    "descriptors": lambda own: own.num_fds(),
    "threads": lambda own: own.num_threads(),
    "processes": lambda own: len(own.children(recursive=True)),
}


class Count:
    """What a process holds after some turns.

    Attributes:
        every: Turns between two readings.
        read: Each reading, by name.
        turns, seconds: Of the work.
    """

    def __init__(self, turns: int) -> None:
        self.every = max(1, turns // READINGS)
        self.read: dict[str, list[int]] = {name: [] for name in READ}
        self.turns, self.seconds = 0, 0.0

    def take(self, *_: object) -> None:
        """Looks at this process."""
        self.turns += 1
        if self.turns % self.every == 0:
            # What is only in cycles is not held.
            gc.collect()
            for name, reading in READ.items():
                self.read[name].append(reading(psutil.Process()))


def scanned_cfg(**how: int) -> dict[str, Any]:
    """Makes a ``small_cfg`` of few rocks, with a lidar."""
    cfg = small_cfg(**how)
    cfg["terrain"]["spacing_m"] = 0.5
    cfg["objects"]["rocks"] |= {"count": 60, "prototypes": 2, "subdivisions": 1}
    beams = {"beams": 4, "elevation_deg": [-20, 0], "azimuths": 90}
    cfg["rigs"]["rover"]["lidars"] = {"top": beams}
    return cfg


def _cfg(folder: Path, samples: int, seed: int = 0) -> Path:
    cfg = scanned_cfg(samples=samples)
    cfg["terrain"]["relief"][0]["slope"][0] += 1e-3 * seed
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [32, 24]
    return write_cfg(folder, cfg)


def frames(backend: str, out: Path, count: int) -> Count:
    """Renders all frames of an output."""
    from scenec.backends.run.render import render
    from scenec.schemas.units import LocalExecutor

    passes = PASSES if backend == "annotation" else ("rgb", *PASSES)
    return _counted(
        lambda progress: render(
            out,
            backend,
            passes=passes,
            spp=RENDERERS[backend],
            executor=LocalExecutor(),
            progress=progress,
        ),
        count,
    )


def scans(out: Path, count: int) -> Count:
    """Scans all samples of an output."""
    from scenec.backends.run.scan import scan_output
    from scenec.schemas.units import LocalExecutor

    here = LocalExecutor()
    return _counted(lambda progress: scan_output(out, executor=here, progress=progress), count)


def _counted(work: Callable[[Callable[..., None]], Any], count: int) -> Count:
    found, start = Count(count), time.process_time()
    work(found.take)
    assert found.turns >= count, f"{found.turns} of {count}"
    found.seconds = time.process_time() - start
    return found


def compiles(folder: Path, count: int) -> Count:
    """Compiles cfgs, each another one, with a cache as a command has it."""
    from scenec.compiler.compile import compile_cfg

    def work(took: Callable[..., None]) -> None:
        for seed in range(count):
            cfg = _cfg(folder, 2, seed)
            compile_cfg(cfg, seed=seed, out=folder / "out", cache=folder / "steps")
            shutil.rmtree(folder / "out")
            took()

    return _counted(work, count)


def layers(count: int) -> Count:
    """Makes layers of twenty prims in memory, with nothing of scenec's."""
    from pxr import Sdf

    def work(took: Callable[..., None]) -> None:
        for _ in range(count):
            layer = Sdf.Layer.CreateAnonymous()
            for number in range(20):
                Sdf.CreatePrimInLayer(layer, f"/World/Prim_{number}")
            took()

    return _counted(work, count)


def slope(values: Sequence[int]) -> tuple[float, float]:
    """Growth a reading after warming up, and its standard error."""
    settled = np.asarray(values[int(WARM * len(values)) :], dtype=np.float64)
    parts = np.array_split(settled, PARTS)
    y = np.array([part.mean() for part in parts])
    x = np.cumsum([len(part) for part in parts]) - np.array([len(part) / 2 for part in parts])
    x -= x.mean()
    growth = float(x @ (y - y.mean()) / (x @ x))
    rest = y - y.mean() - growth * x
    return growth, math.sqrt(float(rest @ rest) / (len(parts) - 2) / float(x @ x))


def _of(values: Sequence[int]) -> str:
    settled = values[int(WARM * len(values))]
    return f"{settled}" if values[-1] == settled else f"{settled} → {values[-1]}"


def main(page: Page) -> None:
    """Refreshes a row a work."""
    count = 40 if page.fast else page.options.frames
    compiled = 24 if page.fast else page.options.compiles
    out = page.batch(_cfg(page.scratch, count)).parent
    folder = page.scratch / "compiles"
    folder.mkdir()
    works: dict[str, tuple[Any, ...]] = {
        "scan": (scans, out, count), "compile": (compiles, folder, compiled),
        "openusd": (layers, count),
    }  # fmt: skip
    rows = []
    for name in page.options.works or (*RENDERERS, *works):
        found: Count = apart(*works.get(name, (frames, name, out, count))).value
        read = found.read
        row: list[str | float] = [name, found.turns, found.seconds / found.turns]
        memory = read["memory"]
        row += [memory[int(WARM * len(memory))] / 2**20, memory[-1] / 2**20]
        for each, unit in (("memory", 1024), ("allocated", 1024), ("blocks", 1)):
            growth, error = (one / (unit * found.every) for one in slope(read[each]))
            row.append(f"{growth:.3g} ± {error:.2g}")
        row += [_of(read[each]) for each in ("descriptors", "threads", "processes")]
        rows.append(row)
        print(row, flush=True)
    header = [
        "work", "turns", "CPU s a turn", "MiB warm", "MiB at the end", "KiB a turn",
        "KiB allocated a turn", "Python's blocks a turn", "descriptors", "threads",
        "child processes",
    ]  # fmt: skip
    page.table(header, rows)
    if page.whole:
        scanned = f"{count:,} scans, {compiled:,} compilations"
        page.value("soaked", f"{len(RENDERERS) * count:,} frames, {scanned}")
        # The page says in words that no descriptor, thread or process is left.
        page.block("soak", header[:8], (row[:8] for row in rows))
        page.refresh((), ())


if __name__ == "__main__":
    run(main, page="robustness", frames=500, compiles=50, works=names)
