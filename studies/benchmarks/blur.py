"""What few sub-frames get wrong of blur, and what many cost: prints a table for each kind.

    python studies/benchmarks/blur.py [BACKEND ...]

Stones on the ground under a sun and a gray sky, 96 x 64 pixels, seen through an aperture (circles
of confusion up to about 12 pixels), while the camera pans (by about 12 pixels), and with a rolling
shutter as it does. All pictures have the same samples per pixel; of them each sub-frame has its
share. Error: rms difference from a picture of many sub-frames and 16 times the samples, over the
mean, beside what the halves' difference estimates, mean of three seeds. Cost: processor seconds
over those of the plain pinhole's picture with as many samples, drawn in the same run.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "backends"))
from blur_scenes import shaken
from mitsuba_scenes import dome, look_at, mesh, plane, scene, sun, surface
from scenes import icosphere

from scenec.backends.exact import ExactCaster
from scenec.backends.picture.compose import compose
from scenec.backends.picture.noise import Noise
from scenec.backends.picture.subframes import Drawing, measure
from scenec.backends.registry import open_backend
from scenec.backends.stage.scene import Camera, Focus, RenderScene
from scenec.schemas.shutter import Shutter

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


def timed(function: Callable[[], Any]) -> tuple[Any, float]:
    """What it returns, and processor seconds."""
    start = time.process_time()
    made = function()
    return made, time.process_time() - start


def main(names: list[str]) -> None:
    """Print the tables of some backends."""
    for name in names:
        backend, of = open_backend(name), stones()
        backend.load(of)
        seen = cameras()
        plain = plainly(seen.pop("pinhole"), backend, of)
        print(f"\n{name}: a pinhole's picture of {SPP} samples takes {plain:.2f} s")
        for kind, camera in seen.items():
            report(kind, camera, backend, of, ExactCaster(of), plain)


def plainly(camera: Camera, backend: Any, of: RenderScene) -> float:
    """Processor seconds of a plain picture."""
    # The first may compile.
    backend.radiance(camera, 0, SPP, 0)
    return min(
        timed(lambda seed=seed: compose(backend.radiance(camera, 0, SPP, seed), of, camera, 0))[1]
        for seed in (1, 2)
    )


def report(
    kind: str, camera: Camera, backend: Any, of: RenderScene, caster: ExactCaster, plain: float
) -> None:
    """Print one table."""
    blur = measure(camera, caster)
    assert blur is not None

    def drawn(spp: int, seed: int, most: int) -> tuple[NDArray[np.float32], Noise, Drawing]:
        drawing = Drawing(blur, backend, of, 0, caster)
        picture = compose(drawing.draw(spp, seed, most), of, camera, 0)
        return picture.rgb, picture.noise, drawing

    truth = drawn(16 * SPP, 999, 8 * COUNTS[-1])[0].astype(np.float64)
    print(
        f"\n{backend.name}, {kind}: circles of confusion {blur.disk_px:.1f} px, motion "
        f"{blur.motion_px:.1f} px\n"
        "sub-frames a row   drawn   spacing px   rms error   estimated    cost"
    )
    for most in COUNTS:
        errors, estimates, costs = [], [], []
        for seed in range(SEEDS):
            made, seconds = timed(lambda s=seed, m=most: drawn(SPP, s, m))
            rgb, noise, drawing = made
            errors.append(float(np.sqrt(np.mean((rgb - truth) ** 2)) / truth.mean()))
            estimates.append(noise.relative_rms or float("nan"))
            costs.append(seconds / plain)
        facts = drawing.facts
        print(
            f"{facts['sub_frames_per_row']:16d} {facts['sub_frames']:7d} "
            f"{facts['spacing_px']:12.2f} {np.mean(errors):11.4f} {np.mean(estimates):11.4f} "
            f"{np.min(costs):7.2f}"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("backends", nargs="*", default=["mitsuba"])
    main(parser.parse_args().backends)
