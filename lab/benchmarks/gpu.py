"""Every device that works here: first frame, steady frames, samples a second, memory.

    python lab/benchmarks/gpu.py [--backends A,B,...] [--spp N] [--frames N] [--count N] [--cpu]
        [--fast] [-o FILE]

The demo, and a million rocks, light alone. Frames of a GPU have to have the mean light of those of
the CPU before their seconds are told. Memory of a GPU is what its driver says is taken, less what
was before. Without a GPU it ends with status 2, unless the CPU's rows are asked for (``--cpu``).
"""

from __future__ import annotations

import shutil
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from scenec.backends.registry import backend_class, backend_names
from scenec.backends.run.doctor import start
from scenec.backends.run.executors import ask
from scenec.backends.run.units import OfBackend
from scenec.lab.benchmarks.growth import of_kind
from scenec.lab.runner import ROOT, SCENEC, Cell, Study, command, names, run
from scenec.schemas.errors import BackendError
from scenec.schemas.exr import read_exr
from scenec.schemas.records import FrameRecord
from scenec.schemas.sidecars import read_sidecar

#: By which mean light may differ; noise of whole pictures is far below.
_OFF = 2e-3


def works(backend: str, device: str) -> str:
    """Why a device of a backend does not work here; "" where it does."""
    try:
        ask(OfBackend(backend, partial(start, device)))
    except BackendError as error:
        return str(error)
    return ""


def devices(backends: Sequence[str]) -> tuple[list[tuple[str, str]], list[str]]:
    """Devices of backends that work here, the CPU's first; and why others do not."""
    found, lines = [], []
    for backend in backends:
        try:
            there = backend_class(backend).devices
        except BackendError as error:
            lines.append(str(error))
            continue
        for device in sorted(there, key=lambda name: name != "cpu"):
            why = works(backend, device)
            if why:
                lines.append(f"{backend} on {device}: {why}")
            else:
                found.append((backend, device))
    return found, lines


def gpu_now() -> tuple[float, float]:
    """Percent that the busiest GPU is busy, and MiB taken of all; zeros where no driver tells."""
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return 0.0, 0.0
    words = [tool, "--query-gpu=utilization.gpu,memory.used", "--format=csv,noheader,nounits"]
    said = subprocess.run(words, capture_output=True, text=True, check=False).stdout
    rows = [line.split(",") for line in said.splitlines()]
    # What a GPU does not tell it calls so: "[N/A]".
    numbers = [[float(word) if word.strip().isdigit() else 0.0 for word in row] for row in rows]
    return max((row[0] for row in numbers), default=0.0), sum(row[-1] for row in numbers)


@contextmanager
def watched() -> Iterator[list[tuple[float, float, float]]]:
    """Fills a list meanwhile: when (``time.perf_counter``), percent that GPUs are busy, MiB."""
    found, done = [(time.perf_counter(), *gpu_now())], threading.Event()

    def look() -> None:
        while not done.wait(0.2):
            found.append((time.perf_counter(), *gpu_now()))

    watcher = threading.Thread(target=look, daemon=True)
    watcher.start()
    try:
        yield found
    finally:
        done.set()
        watcher.join()


def most_gib(found: list[tuple[float, float, float]]) -> float:
    """The most that was taken of GPUs, GiB above what was taken before."""
    taken = [mib for _, _, mib in found]
    return (max(taken) - taken[0]) / 1024


def frames_of(out: Path, backend: str) -> list[FrameRecord]:
    """Reads sidecars, in order."""
    files = sorted((out / "batch_0000" / "frames" / backend).rglob("0*.json"))
    return [read_sidecar(path) for path in files]


def mean_light(out: Path, backend: str) -> float:
    """Averages the light of all frames."""
    files = sorted((out / "batch_0000" / "frames" / backend).rglob("0*.exr"))
    return float(np.mean([read_exr(path)["rgb"].mean(dtype=np.float64) for path in files]))


def measured(out: Path, backend: str, device: str, spp: int, frames: int) -> list[Cell]:
    """Seconds, samples a second, and memory of a render, and its light."""
    shutil.rmtree(out / "batch_0000" / "frames", ignore_errors=True)
    words = ["render", out, "--backend", backend, "--device", device, "--passes", "rgb"]
    with watched() as taken:
        cost = command([*SCENEC, *words, "--spp", str(spp), "--samples", f"0:{frames}"])
    told = frames_of(out, backend)
    steps = [frame.seconds or {} for frame in told]
    seconds = [sum(one.values()) for one in steps]
    steady = float(np.median(seconds[1:])) if len(seconds) > 1 else seconds[0]
    drawn = float(np.median([one["radiance"] for one in steps[1:] or steps]))
    width, height = told[0].resolution
    rate = width * height * spp / drawn / 1e6
    host = max(frame.peak_memory_gb or 0.0 for frame in told)
    return [cost.wall_s, seconds[0], steady, rate, host, most_gib(taken), mean_light(out, backend)]


def main(study: Study) -> None:
    """Prints what works, and the table."""
    options = study.options
    found, lines = devices(options.backends or backend_names())
    if lines:
        study.say("".join(f"- {line}\n" for line in lines))
    if not options.cpu and all(device == "cpu" for _, device in found):
        raise BackendError("no GPU works here with any backend; see the lines above")
    frames, spp = (2, 4) if study.fast else (options.frames, options.spp)
    count = 10_000 if study.fast else options.count
    scenes = {
        "demo": ROOT / "configs/jacksboro.json",
        f"{count:,} rocks": study.cfg(of_kind("rocks", count) | {"samples": frames}, "rocks"),
    }

    def rows() -> Iterator[list[Cell]]:
        for name, path in scenes.items():
            out = study.scratch / name.replace(" ", "_").replace(",", "")
            command([*SCENEC, "compile", path, "--seed", "1", "-o", out])
            of_cpu: dict[str, float] = {}
            for backend, device in found:
                cells = measured(out, backend, device, spp, frames)
                light = of_cpu.setdefault(backend, float(cells[-1] or 0.0))
                off = float(cells[-1] or 0.0) / light - 1.0
                if not abs(off) <= _OFF:
                    raise BackendError(f"{backend} on {device}: mean light is {off:+.2%} off")
                cells[-1] = off
                yield [name, backend, device, *cells]

    study.table(
        ["scene", "backend", "device", "s in all", "first frame, s", "a frame, s",
         "million samples a s", "peak, GB", "of the GPU, GiB", "mean light off the CPU's"],
        rows(),
    )  # fmt: skip


if __name__ == "__main__":
    run(main, backends=names, spp=64, frames=4, count=1_000_000, cpu=False)
