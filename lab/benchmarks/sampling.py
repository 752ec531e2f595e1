"""Mitsuba's error and CPU seconds by samples a pixel: its own independent ones, and Sobol' points.

    python lab/benchmarks/sampling.py [--width N] [--reference N] [--spp N,N] [--fast]

Two scenes, the demo and 30,000 rocks of plain colors, seed 1, first sample. The true error is the
rms difference to a reference of independent samples, less the reference's own variance, over the
mean; beside it what the picture's halves state, and how far the means are apart with the standard
error of that. Error times the root of seconds tells samplers apart whatever the samples: half of it
is a quarter of the time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Radiance
from scenec.backends.mitsuba import Mitsuba
from scenec.backends.picture.noise import estimate
from scenec.backends.stage.read import read_stage
from scenec.lab.benchmarks.cfgs import rocks_on_hills
from scenec.lab.runner import DEMO, Cell, Study, run

#: Pictures of each kind, of their own seeds.
SEEDS = 3


class Independent(Mitsuba):
    """With Mitsuba's own sampler of independent numbers."""

    def __init__(self) -> None:
        super().__init__()

        def seeded(seed: Any, pixel: Any, index: Any) -> Any:
            sampler = self._mi.load_dict({"type": "independent"})
            # Passes begin at samples of their own.
            apart = self._mi.UInt32(0x9E3779B9 * index[0] & 0xFFFFFFFF)
            sampler.seed(seed + apart, len(pixel))
            return sampler

        self._sampler = seeded


def main(study: Study) -> None:
    """Prints a table for each scene."""
    plain = rocks_on_hills(30_000)
    plain["objects"]["rocks"]["prototypes"] = 10
    for name, cfg in {"plain": study.cfg(plain), "demo": DEMO}.items():
        compare(study, name, study.batch(cfg))
        if study.fast:
            break


def compare(study: Study, name: str, batch: Path) -> None:
    """Prints one table."""
    scene = read_stage(batch / "stage.usda")
    camera = scene.cameras[0][0]
    scale = study.options.width / camera.width
    small = {"width": study.options.width, "height": round(camera.height * scale)}
    intrinsics = camera.intrinsics * np.array([[scale], [scale], [1.0]])
    camera = replace(camera, intrinsics=intrinsics, **small)
    backends = {"independent": Independent(), "sobol": Mitsuba()}
    for backend in backends.values():
        backend.load(scene)
        # Compiles.
        backend.radiance(camera, 0, 4, 0)
    count = 64 if study.fast else study.options.reference
    truth = backends["independent"].radiance(camera, 0, count, 1 << 20)

    def rows() -> Iterator[list[Cell]]:
        for spp in study.options.spp[: 2 if study.fast else None]:
            for label, backend in backends.items():
                drawn: list[Radiance] = []
                seconds = []
                for seed in range(SEEDS):
                    start = time.process_time()
                    drawn.append(backend.radiance(camera, 0, spp, seed))
                    seconds.append(time.process_time() - start)
                yield [label, spp, min(seconds), *errors(drawn, truth, min(seconds))]

    study.say(f"{name}, {camera.width} x {camera.height}, reference of {count:,} samples.\n")
    header = ["sampler", "samples", "CPU s", "true error, %", "stated, %", "error x sqrt(CPU s), %"]
    study.table([*header, "bias, %", "its standard error, %"], rows())


def errors(drawn: list[Radiance], truth: Radiance, seconds: float) -> Iterator[float]:
    """True and stated error, the former times the root of seconds, bias, its standard error: %."""

    def halves(picture: Radiance) -> NDArray[np.float64]:
        return picture.halves.astype(np.float64)

    covered = truth.coverage > 0.0
    reference = halves(truth).mean(axis=0)
    noise = (0.5 * np.subtract(*halves(truth))) ** 2
    level = float(reference[covered].mean())
    squares = [((halves(one).mean(axis=0) - reference) ** 2 - noise)[covered] for one in drawn]
    true = math.sqrt(max(float(np.mean(squares)), 0.0)) / level
    yield 100.0 * true
    stated = [estimate(halves(one), covered).relative_rms or 0.0 for one in drawn]
    yield 100.0 * math.sqrt(float(np.mean(np.square(stated))))
    yield 100.0 * true * math.sqrt(seconds)
    mean = float(np.mean([halves(one)[:, covered].mean() for one in drawn]))
    yield 100.0 * (mean / level - 1.0)
    # Channels of a pixel share its samples.
    variance = np.mean([(0.5 * np.subtract(*halves(one)).mean(axis=-1)) ** 2 for one in drawn], 0)
    own = 0.25 * np.subtract(*halves(truth)).mean(axis=-1) ** 2
    total = float((variance / len(drawn) + own)[covered].sum())
    yield 100.0 * math.sqrt(total) / np.count_nonzero(covered) / level


if __name__ == "__main__":
    run(main, width=320, reference=4096, spp=(4, 16, 64, 256))
