"""What the preview's effects cost, and what FLIP to a path tracer they buy.

    python lab/benchmarks/preview.py [--cfgs NAME,NAME] [--spp N] [--reference N] [--fast]

The first picture of each cfg, drawn by pyrender as it is and with one effect left out at a time:
CPU seconds of a further picture, the least of three, and LDR-FLIP to Mitsuba with ``--reference``
samples, both developed at the exposure that shows Mitsuba's mean as a gray card.
"""

from __future__ import annotations

from collections.abc import Iterator
from time import process_time
from unittest.mock import patch

import flip_evaluator
import numpy as np
from numpy.typing import NDArray

from scenec.backends.pyrender import Pyrender, adapter
from scenec.backends.registry import open_backend
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.lab.benchmarks.adapters import narrowed
from scenec.lab.runner import CONFIGS, Cell, Study, run
from scenec.schemas.picture import develop, luminance

#: Effects by what programs are compiled without.
_WITHOUT = {
    "leaves before the sky": ("WITH_CANOPY",),
    "second scale of pictures": ("WITH_FAR",),
    "gloss": ("WITH_GLOSS",),
    "light through sheets": ("WITH_THROUGH",),
}


def drawn(backend: Pyrender, scene: RenderScene, width: int, spp: int) -> tuple[NDArray, float]:
    """Radiance of a picture, and the CPU seconds of another one."""
    camera = narrowed(scene.cameras[0][0], width)
    radiance, took = backend.radiance(camera, 0, spp, 0), []
    for _ in range(3):
        start = process_time()
        radiance = backend.radiance(camera, 0, spp, 0)
        took.append(process_time() - start)
    return radiance.halves.mean(axis=0), min(took)


def rows(study: Study, name: str) -> Iterator[list[Cell]]:
    """The rows of a cfg."""
    spp, many = (4, 4) if study.fast else (study.options.spp, study.options.reference)
    width = 64 if study.fast else 640
    scene = read_stage(study.batch(CONFIGS / f"{name}.json") / "stage.usda")
    tracer = open_backend("mitsuba")
    tracer.load(scene)
    light = tracer.radiance(narrowed(scene.cameras[0][0], width), 0, many, 1)
    wanted = light.halves.mean(axis=0)
    level = float(luminance(wanted[light.coverage > 0.0].astype(np.float64)).mean())
    exposure = float(np.log2(0.18 / level))

    def flip(picture: NDArray) -> float:
        shown = [develop(p, exposure).astype(np.float32) / 255.0 for p in (wanted, picture)]
        return float(np.mean(flip_evaluator.evaluate(*shown, "LDR", applyMagma=False)[0]))

    backend = Pyrender("cpu")
    backend.load(scene)

    def row(what: str) -> list[Cell]:
        picture, seconds = drawn(backend, scene, width, spp)
        return [name, what, seconds, flip(picture)]

    yield row("as it is")
    assert backend._renderer is not None
    for what, left_out in _WITHOUT.items():
        defines = backend._renderer._defines
        if any(define in defines for define in left_out):
            kept = {key: value for key, value in defines.items() if key not in left_out}
            with patch.object(backend._renderer, "_defines", kept):
                yield row(f"without {what}")
    with patch.object(adapter, "fit_shadow_maps", lambda *_: []):
        yield row("without shadows")
    with patch.object(type(backend._renderer), "shadow_size", 1024):
        backend._renderer._targets.pop("shadows").delete()
        yield row("shadow maps of half the size")
    backend._renderer._targets.pop("shadows").delete()
    # No two faces are alike where none has a normal.
    with patch.object(backend, "_normals", np.zeros_like(backend._normals)):
        yield row("each face shaded for itself")


def main(study: Study) -> None:
    """Prints the table."""
    header = ["cfg", "effect", "CPU s a picture", "FLIP"]
    chosen = study.options.cfgs[: 1 if study.fast else None]
    study.table(header, (row for name in chosen for row in rows(study, name)))


if __name__ == "__main__":
    cfgs = ("jacksboro", "mars_yard", "lunar_mare", "meadow_edge")
    run(main, cfgs=cfgs, spp=16, reference=256)
