"""What few sub-frames get wrong of blur, and what many cost: prints a table for each kind.

    python lab/benchmarks/blur.py [--backends A,B] [--fast]

Stones on the ground under a sun and a gray sky, 96 x 64 pixels, seen through an aperture (circles
of confusion up to about 12 pixels), while the camera pans (by about 12 pixels), and with a rolling
shutter as it does. All pictures have the same samples per pixel; of them each sub-frame has its
share. Error: rms difference from a picture of many sub-frames and 16 times the samples, over the
mean, beside what the halves' difference estimates, mean of three seeds. Cost: processor seconds
over those of the plain pinhole's picture with as many samples, drawn in the same run.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.exact import ExactCaster
from scenec.backends.picture.blur import measure
from scenec.backends.picture.compose import Picture, compose
from scenec.backends.picture.subframes import Drawing
from scenec.backends.registry import open_backend
from scenec.backends.stage.scene import Camera, Focus, RenderScene
from scenec.backends.testing.scenes import dome, look_at, mesh, plane, scene, sun, surface
from scenec.lab.runner import Cell, Study, run, times
from scenec.schemas.shutter import Shutter
from scenec.testing.blur_scenes import shaken
from scenec.testing.scenes import icosphere

WIDTH, HEIGHT, SPP = 96, 64, 64
COUNTS = (1, 2, 4, 8, 16)
SEEDS = 3


def stones(count: int = 60) -> RenderScene:
    """Stones on level ground, near and far."""
    points, faces = icosphere(1)
    rng = np.random.default_rng(3)
    rows = [(0, np.eye(4)[:3])]
    for _ in range(count):
        x = 1.5 * 20.0 ** rng.random()
        size = rng.uniform(0.05, 0.15) * np.sqrt(x)
        place = np.array([x, rng.uniform(-0.5, 0.5) * x, 0.5 * size])
        rows.append((1, np.concatenate([size * np.eye(3), place[:, None]], axis=1)))
    ground, stone = mesh(*plane(60.0)), mesh(points, faces, (1,))
    colors = [surface((0.5, 0.4, 0.3)), surface((0.2, 0.2, 0.2))]
    return scene([ground, stone], colors, rows=rows, lights=[sun(35.0, 60.0), dome(60.0)])


def cameras() -> dict[str, Camera]:
    """The plain one, and one of each kind of blur."""
    plain = look_at([0.0, 0.0, 0.6], [4.0, 0.0, 0.2], WIDTH, HEIGHT)
    focal = float(plain.intrinsics[0, 0])

    def turning(t: float) -> tuple[NDArray[np.float64], float]:
        return np.zeros(3), t * 12.0 / focal / 0.02

    return {
        "pinhole": plain,
        "aperture": dataclasses.replace(plain, focus=Focus(1.7, 0.08)),
        "motion": shaken(plain, Shutter(0.02), turning),
        "rolling": shaken(plain, Shutter(0.005, 0.03), turning),
    }


def main(study: Study) -> None:
    """Prints the tables of some backends."""
    world = stones()
    for name in study.options.backends:
        backend, seen = open_backend(name), cameras()
        backend.load(world)
        camera = seen.pop("pinhole")
        drawn = times(lambda c=camera, b=backend: compose(b.radiance(c, 0, SPP, 0), world, c, 0), 2)
        plain = min(drawn.cpu)
        study.say(f"{name}: a pinhole's picture of {SPP} samples takes {plain:.2f} CPU s.\n")
        for kind, camera in list(seen.items())[: 1 if study.fast else None]:
            blurred(study, kind, camera, backend, world, plain)


def blurred(
    study: Study, kind: str, camera: Camera, backend: Any, world: RenderScene, plain: float
) -> None:
    """Prints one table."""
    caster = ExactCaster(world)
    blur = measure(camera, caster)
    assert blur is not None

    def drawn(spp: int, seed: int, most: int) -> tuple[Picture, Drawing]:
        drawing = Drawing(blur, backend, world, 0, caster)
        return compose(drawing.draw(spp, seed, most), world, camera, 0), drawing

    truth = drawn(16 * SPP, 999, 8 * COUNTS[-1])[0].rgb.astype(np.float64)

    def rows() -> Iterator[list[Cell]]:
        for most in COUNTS[:2] if study.fast else COUNTS:
            errors, estimates, costs = [], [], []
            for seed in range(SEEDS):
                start = time.process_time()
                picture, drawing = drawn(SPP, seed, most)
                costs.append((time.process_time() - start) / plain)
                errors.append(float(np.sqrt(np.mean((picture.rgb - truth) ** 2)) / truth.mean()))
                estimates.append(picture.noise.relative_rms or float("nan"))
            facts = drawing.facts
            counts = [facts["sub_frames_per_row"], facts["sub_frames"], facts["spacing_px"]]
            yield [*counts, np.mean(errors), np.mean(estimates), min(costs)]

    study.say(
        f"{backend.name}, {kind}: circles of confusion {blur.disk_px:.1f} px, motion "
        f"{blur.motion_px:.1f} px.\n"
    )
    header = ["sub-frames a row", "drawn", "spacing, px", "rms error", "estimated", "cost"]
    study.table(header, rows())


if __name__ == "__main__":
    run(main, backends=("mitsuba",))
