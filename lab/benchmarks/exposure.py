"""Does the meter expose as its rule would, were it given the frames that Mitsuba makes.

    python lab/benchmarks/exposure.py [--cfgs A,B] [--spp 16] [--fast]

All frames of the first batch. CPU seconds are the meter's, for all samples, without building the
caster, which annotation needs anyway.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from scenec.backends.exact.caster import ExactCaster
from scenec.backends.picture.exposure import Meter, expose, level
from scenec.backends.picture.metering import Metering
from scenec.backends.stage.read import read_stage
from scenec.lab.pictures import frames
from scenec.lab.runner import CONFIGS, Cell, Study, run
from scenec.schemas.picture import luminance

CFGS = ("jacksboro", "jacksboro_hdri", "lunar_mare", "mars_yard", "volcanic_desert", "landing_site")


def main(study: Study) -> None:
    """One row a cfg."""
    header = ("cfg", "ev metered", "ev of the frames", "difference", "single samples", "CPU s")
    chosen = study.options.cfgs[: 1 if study.fast else None]
    study.table(header, (_row(study, name) for name in chosen))


def _row(study: Study, name: str) -> list[Cell]:
    out, spp = study.scratch / name, 1 if study.fast else study.options.spp
    seen = [_seen(frame.passes) for frame in frames(CONFIGS / f"{name}.json", out, spp=spp)]
    scene = read_stage(out / "batch_0000" / "stage.usda")
    caster = ExactCaster(scene)
    # Whatever the cfg's exposure is.
    cameras = [replace(at[0], exposure_per="batch") for at in scene.cameras]
    # Compiled, and the air known.
    Meter(scene).exposed(cameras[0], 0, lambda: caster)
    start = time.process_time()
    metered = Meter(scene).exposed(cameras[0], 0, lambda: caster)[0].exposure_ev
    seconds = time.process_time() - start
    ev = expose(Metering(*(np.concatenate(part) for part in zip(*seen, strict=True))), len(seen)).ev
    apart = []
    for i, (camera, (surfaces, _)) in enumerate(zip(cameras, seen, strict=True)):
        alone = replace(camera, exposure_per="sample")
        own = Meter(scene).exposed(alone, i, lambda: caster)[1].luminance
        apart.append(float(np.log2(own / level(surfaces)[0])))
    between = f"{min(apart):+.2f} to {max(apart):+.2f}"
    return [name, f"{metered:.2f}", f"{ev:.2f}", f"{metered - ev:+.2f}", between, seconds]


def _seen(passes: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Luminance of a frame's pixels: those that surfaces fill, the others."""
    values = luminance(passes["rgb"].astype(np.float64))
    filled = np.isfinite(passes["depth"])
    return values[filled], values[~filled]


if __name__ == "__main__":
    run(main, cfgs=CFGS, spp=16)
