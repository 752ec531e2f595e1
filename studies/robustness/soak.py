"""Makes many frames, and compiles many cfgs, in one process each: does anything pile up?

    python studies/robustness/soak.py [--frames N] [--compiles N] [--works A,B,...] [-o FILE]

Each work runs in a fresh process that nothing supervises, so that nothing is replaced when it
grows. After each frame or output its resident memory, Python's blocks, file descriptors, threads
and child processes are counted. The first quarter warms up. Growth is the slope of a line through
the means of the rest's parts, which are long, so that allocators' steps average out within them;
its standard error is that of the parts about the line.
"""

from __future__ import annotations

import gc
import math
import shutil
import sys
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from scenec.studies.runner import Study, apart, names, run

# Behind ``runner``, which says where these are.
from small import small_cfg, write_cfg

#: Share of the turns that warm up, and parts of the others.
WARM, PARTS = 0.25, 12
RENDERERS = {"annotation": 1, "mitsuba": 4, "cycles": 4, "pyrender": 1}
PASSES = ("label", "instance", "depth", "normal")


@dataclass
class Count:
    """What a process holds after each turn: bytes, Python's blocks, and numbers of the others."""

    memory: array[int]
    blocks: array[int]
    descriptors: array[int]
    threads: array[int]
    processes: array[int]
    seconds: float = 0.0

    @classmethod
    def none(cls) -> Count:
        """Before the first turn."""
        return cls(*(array("q") for _ in range(5)))

    def take(self) -> None:
        """Looks at this process."""
        own = psutil.Process()
        # What is only in cycles is not held.
        if len(self.memory) % 50 == 0:
            gc.collect()
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
    from scenec.backends.run.executors import Here
    from scenec.backends.run.render import render

    passes = PASSES if backend == "annotation" else ("rgb", *PASSES)
    return _counted(
        lambda progress: render(
            out, backend, passes=passes, spp=RENDERERS[backend], executor=Here(), progress=progress
        ),
        count,
    )


def scans(out: Path, count: int) -> Count:
    """Scans all samples of an output."""
    from scenec.backends.run.executors import Here
    from scenec.backends.run.scan import scan_output

    return _counted(lambda progress: scan_output(out, executor=Here(), progress=progress), count)


def _counted(work: Callable[[Callable[..., None]], Any], count: int) -> Count:
    found, start = Count.none(), time.process_time()
    work(lambda *_: found.take())
    assert len(found.memory) >= count, f"{len(found.memory)} of {count}"
    found.seconds = time.process_time() - start
    return found


def compiles(folder: Path, count: int) -> Count:
    """Compiles cfgs, each another one, with a cache as a command has it."""
    from scenec.compiler.compile import compile_cfg

    found, start = Count.none(), time.process_time()
    for seed in range(count):
        cfg = _cfg(folder, 2, seed)
        compile_cfg(cfg, seed=seed, out=folder / "out", cache=folder / "steps")
        shutil.rmtree(folder / "out")
        found.take()
    found.seconds = time.process_time() - start
    return found


def slope(values: Sequence[int]) -> tuple[float, float]:
    """Growth a turn after warming up, and its standard error."""
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
    chosen = study.options.works or (*RENDERERS, "scan", "compile")
    out = study.batch(_cfg(study.scratch, count)).parent
    rows = []
    for name in chosen:
        if name == "compile":
            folder = study.scratch / "compiles"
            folder.mkdir()
            cost = apart(compiles, folder, compiled)
        elif name == "scan":
            cost = apart(scans, out, count)
        else:
            cost = apart(frames, name, out, count)
        found: Count = cost.value
        row: list[str | float] = [name, len(found.memory), found.seconds / len(found.memory)]
        row += [found.memory[int(WARM * len(found.memory))] / 2**20, found.memory[-1] / 2**20]
        for values, unit in ((found.memory, 1024.0), (found.blocks, 1.0)):
            growth, error = slope(values)
            row.append(f"{growth / unit:.3g} ± {error / unit:.2g}")
        row += [_of(found.descriptors), _of(found.threads), _of(found.processes)]
        rows.append(row)
        print(row, flush=True)
    header = ["work", "turns", "CPU s a turn", "MiB warm", "MiB at the end", "KiB a turn"]
    header += ["Python's blocks a turn", "descriptors", "threads", "child processes"]
    study.table(header, rows)


if __name__ == "__main__":
    run(main, frames=2000, compiles=200, works=names)
