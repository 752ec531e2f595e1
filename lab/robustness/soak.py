"""Makes many frames, and compiles many cfgs, in one process each: does anything pile up?

    python lab/robustness/soak.py [--frames N] [--compiles N] [--works A,B,...] [-o FILE]

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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from scenec.lab.runner import Study, apart, names, run
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


@dataclass
class Count:
    """What a process holds after some turns: bytes, Python's blocks, and numbers of the others.

    Attributes:
        every: Turns between two readings.
        turns: Of the work.
    """

    every: int
    memory: list[int]
    allocated: list[int]
    blocks: list[int]
    descriptors: list[int]
    threads: list[int]
    processes: list[int]
    turns: int = 0
    seconds: float = 0.0

    @classmethod
    def of(cls, turns: int) -> Count:
        """Before the first one."""
        return cls(max(1, turns // READINGS), *([] for _ in range(6)))

    def take(self) -> None:
        """Looks at this process."""
        self.turns += 1
        if self.turns % self.every:
            return
        own = psutil.Process()
        # What is only in cycles is not held.
        gc.collect()
        self.allocated.append(_allocated())
        self.memory.append(own.memory_info().rss)
        self.blocks.append(sys.getallocatedblocks())
        self.descriptors.append(own.num_fds())
        self.threads.append(own.num_threads())
        self.processes.append(len(own.children(recursive=True)))


def _cfg(folder: Path, samples: int, seed: int = 0) -> Path:
    cfg = small_cfg(samples=samples)
    cfg["terrain"]["spacing_m"] = 0.5
    cfg["terrain"]["relief"][0]["slope"][0] += 1e-3 * seed
    cfg["objects"]["rocks"] |= {"count": 60, "prototypes": 2, "subdivisions": 1}
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [32, 24]
    cfg["rigs"]["rover"]["lidars"] = {
        "top": {"beams": 4, "elevation_deg": [-20, 0], "azimuths": 90}
    }
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
    found, start = Count.of(count), time.process_time()
    work(lambda *_: found.take())
    assert found.turns >= count, f"{found.turns} of {count}"
    found.seconds = time.process_time() - start
    return found


def compiles(folder: Path, count: int) -> Count:
    """Compiles cfgs, each another one, with a cache as a command has it."""
    from scenec.compiler.compile import compile_cfg

    found, start = Count.of(count), time.process_time()
    for seed in range(count):
        cfg = _cfg(folder, 2, seed)
        compile_cfg(cfg, seed=seed, out=folder / "out", cache=folder / "steps")
        shutil.rmtree(folder / "out")
        found.take()
    found.seconds = time.process_time() - start
    return found


def layers(count: int) -> Count:
    """Makes layers of twenty prims in memory, with nothing of scenec's."""
    from pxr import Sdf

    found, start = Count.of(count), time.process_time()
    for _ in range(count):
        layer = Sdf.Layer.CreateAnonymous()
        for number in range(20):
            Sdf.CreatePrimInLayer(layer, f"/World/Prim_{number}")
        found.take()
    found.seconds = time.process_time() - start
    return found


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


def main(study: Study) -> None:
    """Prints a row a work."""
    count = 40 if study.fast else study.options.frames
    compiled = 24 if study.fast else study.options.compiles
    chosen = study.options.works or (*RENDERERS, "scan", "compile", "openusd")
    out = study.batch(_cfg(study.scratch, count)).parent
    rows = []
    for name in chosen:
        if name == "compile":
            folder = study.scratch / "compiles"
            folder.mkdir()
            cost = apart(compiles, folder, compiled)
        elif name == "openusd":
            cost = apart(layers, count)
        elif name == "scan":
            cost = apart(scans, out, count)
        else:
            cost = apart(frames, name, out, count)
        found: Count = cost.value
        row: list[str | float] = [name, found.turns, found.seconds / found.turns]
        row += [found.memory[int(WARM * len(found.memory))] / 2**20, found.memory[-1] / 2**20]
        for values, unit in ((found.memory, 1024), (found.allocated, 1024), (found.blocks, 1)):
            growth, error = (each / (unit * found.every) for each in slope(values))
            row.append(f"{growth:.3g} ± {error:.2g}")
        row += [_of(found.descriptors), _of(found.threads), _of(found.processes)]
        rows.append(row)
        print(row, flush=True)
    header = ["work", "turns", "CPU s a turn", "MiB warm", "MiB at the end", "KiB a turn"]
    header += [
        "KiB allocated a turn",
        "Python's blocks a turn",
        "descriptors",
        "threads",
        "child processes",
    ]
    study.table(header, rows)


if __name__ == "__main__":
    run(main, frames=2000, compiles=200, works=names)
