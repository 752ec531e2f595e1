"""Does the meter expose as its rule would, were it given the frames that Mitsuba makes.

    python lab/benchmarks/exposure.py [--cfgs A,B] [--spp 16] [--fast]

All frames of the first batch. CPU seconds are the meter's, for all samples, without building the
caster, which annotation needs anyway.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from scenec.backends.exact.caster import ExactCaster
from scenec.backends.picture.exposure import Meter, expose, level
from scenec.backends.picture.metering import Seen
from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.lab.runner import CONFIGS, Cell, Study, run
from scenec.schemas.errors import ScenecError
from scenec.schemas.frames import read_frame
from scenec.schemas.picture import luminance

CFGS = ("jacksboro", "jacksboro_hdri", "lunar_mare", "mars_yard", "volcanic_desert", "landing_site")


def main(study: Study) -> None:
    """One row a cfg."""
    header = ("cfg", "ev metered", "ev of the frames", "difference", "single samples", "CPU s")
    study.table(header, _rows(study))


def _rows(study: Study) -> Iterator[list[Cell]]:
    for name in study.options.cfgs[: 1 if study.fast else None]:
        yield _row(study, name)


def _row(study: Study, name: str) -> list[Cell]:
    batch = study.batch(CONFIGS / f"{name}.json")
    scene = read_stage(batch / "stage.usda")
    caster = ExactCaster(scene)
    # Whatever the cfg's exposure is.
    cameras = [replace(at[0], exposure_per="batch") for at in scene.cameras]
    # Compiled, and the air known.
    Meter(scene).exposed(cameras[0], 0, lambda: caster)
    start = time.process_time()
    metered = Meter(scene).exposed(cameras[0], 0, lambda: caster)[0].exposure_ev
    seconds = time.process_time() - start
    drawn = render(batch.parent, "mitsuba", spp=1 if study.fast else study.options.spp)
    if drawn.failed:
        raise ScenecError(f"{name}: {'; '.join(drawn.failed)}")
    seen = [_seen(path) for path in drawn.frames]
    ev = expose(Seen(*(np.concatenate(part) for part in zip(*seen, strict=True))), len(seen)).ev
    apart = []
    for i, (camera, (surfaces, _)) in enumerate(zip(cameras, seen, strict=True)):
        alone = replace(camera, exposure_per="sample")
        own = Meter(scene).exposed(alone, i, lambda: caster)[1]["luminance"]
        apart.append(float(np.log2(own / level(surfaces)[0])))
    between = f"{min(apart):+.2f} to {max(apart):+.2f}"
    return [name, f"{metered:.2f}", f"{ev:.2f}", f"{metered - ev:+.2f}", between, seconds]


def _seen(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Luminance of a frame's pixels: those that surfaces fill, the others."""
    passes = read_frame(path).passes
    values = luminance(passes["rgb"].astype(np.float64))
    filled = np.isfinite(passes["depth"])
    return values[filled], values[~filled]


if __name__ == "__main__":
    run(main, cfgs=CFGS, spp=16)
