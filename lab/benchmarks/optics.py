"""Measures error and cost of pictures through lenses, apertures and shutters, by backend.

    python lab/benchmarks/optics.py [--backends A,B] [--of lenses,blur] [--fast]

*lenses*: 160 x 120 pixels of stones around the camera, without light, so that coverage alone is
compared, with that of 16 x 16 exact rays a pixel: its rms error over pixels at edges (which holds
the noise of as many samples, and is beside that of a pinhole by the same backend), the error of its
mean, and processor seconds over the pinhole's. Each backend draws lenses by its own rays where it
can, and by resampled pinhole views; Mitsuba is shown both ways. *blur*: stones on the ground, 96 x
64 pixels, through an aperture (circles of confusion up to about 12 pixels), while the camera pans
(by about 12 pixels), and with a rolling shutter as it does, by rising numbers of sub-frames that
share the samples. Error: rms difference from a picture of many sub-frames and 16 times the samples,
over the mean, beside what the halves' difference estimates, mean of three seeds; cost over the
pinhole's.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays, subpixel_directions
from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.picture import resample
from scenec.backends.picture.blur import measure
from scenec.backends.picture.compose import Picture, compose
from scenec.backends.picture.subframes import Drawing
from scenec.backends.registry import open_backend
from scenec.backends.stage.scene import Camera, Focus, RenderScene
from scenec.backends.testing.scenes import dome, look_at, mesh, plane, scene, sun, surface
from scenec.lab.runner import Cell, Study, run, times
from scenec.schemas.lens import Lens
from scenec.schemas.shutter import Shutter
from scenec.testing.blur_scenes import shaken
from scenec.testing.lens_scenes import BROWN, FISHEYE, PANORAMA, with_lens
from scenec.testing.scenes import icosphere

WIDTH, HEIGHT, SPP, SIDE = 160, 120, 64, 16
COUNTS, SEEDS = (1, 2, 4, 8, 16), 3
#: A pinhole, and a lens of each kind; of the fisheye, a circle of 220 degrees.
CAMERAS = {
    "pinhole": dataclasses.replace(with_lens(BROWN, WIDTH, HEIGHT), lens=None),
    "brown_conrady": with_lens(BROWN, WIDTH, HEIGHT),
    "kannala_brandt": with_lens(FISHEYE, WIDTH, HEIGHT, 0.25 * WIDTH),
    "equirectangular": with_lens(PANORAMA, WIDTH, HEIGHT),
}
# Cycles has no pinholes with a skew.
CAMERAS["pinhole"].intrinsics[0, 1] = 0.0


def stones(count: int = 120) -> RenderScene:
    """Stones on all sides of the camera."""
    points, faces = icosphere(2)
    rng = np.random.default_rng(1)
    rows = []
    for _ in range(count):
        away = rng.normal(size=3)
        away *= rng.uniform(2.0, 10.0) / np.linalg.norm(away)
        size = rng.uniform(0.2, 0.7) * np.eye(3)
        rows.append(
            (0, np.concatenate([size, (away + np.array([0.3, -0.2, 1.4]))[:, None]], axis=1))
        )
    return scene([mesh(points, faces)], [surface()], rows=rows)


def exact_coverage(camera: Camera, world: RenderScene) -> NDArray[np.float64]:
    """Share of exact rays within each pixel that meet something."""
    caster = ExactCaster(world)
    steps = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    dv, du = (a.ravel() for a in np.meshgrid(steps, steps, indexing="ij"))
    rays = camera_rays(camera)
    bent = camera
    if camera.lens is None:
        bent = dataclasses.replace(camera, lens=Lens("brown_conrady", (0.0,) * 8))
    out = np.zeros(len(rays.origins))
    for start in range(0, len(out), 2048):
        index = np.arange(start, min(start + 2048, len(out)))
        around = subpixel_directions(bent, index, du, dv).reshape(-1, 3)
        origins = np.ascontiguousarray(np.broadcast_to(rays.origins[0], around.shape))
        t = caster.cast(Rays(origins, around, (len(index), SIDE * SIDE)))[2]
        out[index] = np.isfinite(t).reshape(len(index), -1).mean(axis=1)
    if rays.known is not None:
        out[~rays.known] = 0.0
    return out.reshape(rays.shape)


def lenses(study: Study) -> Iterator[list[Cell]]:
    """The rows of the table."""
    world = stones()
    cameras = dict(list(CAMERAS.items())[: 2 if study.fast else None])
    truth = {name: exact_coverage(camera, world) for name, camera in cameras.items()}
    for name in study.options.backends[: 1 if study.fast else None]:
        backend = open_backend(name)
        backend.load(world)
        plain = 0.0
        for lens, camera in cameras.items():
            ways = ["rays"] if backend.follows_lenses else []
            for way in ["pinhole"] if camera.lens is None else [*ways, "resampled"]:
                views = None if way != "resampled" else resample.plan_views(camera)

                def draw(
                    camera: Camera = camera, views: Any = views, backend: Any = backend
                ) -> Any:
                    if views is None:
                        return backend.radiance(camera, 0, SPP, 5)
                    return resample.draw(backend, camera, views, 0, SPP, 5, False)

                found = times(draw, 2)
                cost = min(found.cpu)
                plain = plain or cost
                off = found.value.coverage - truth[lens]
                edge = (truth[lens] > 0.02) & (truth[lens] < 0.98)
                number = 1 if views is None else len(views.cameras)
                rms = np.sqrt((off[edge] ** 2).mean())
                yield [name, lens, way, number, rms, off.sum() / truth[lens].sum(), cost / plain]


def stones_on_ground(count: int = 60) -> RenderScene:
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
    plain = look_at([0.0, 0.0, 0.6], [4.0, 0.0, 0.2], 96, 64)
    focal = float(plain.intrinsics[0, 0])

    def turning(t: float) -> tuple[NDArray[np.float64], float]:
        return np.zeros(3), t * 12.0 / focal / 0.02

    return {
        "pinhole": plain,
        "aperture": dataclasses.replace(plain, focus=Focus(1.7, 0.08)),
        "motion": shaken(plain, Shutter(0.02), turning),
        "rolling": shaken(plain, Shutter(0.005, 0.03), turning),
    }


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
            facts = drawing.record
            counts = [facts.sub_frames_per_row, facts.sub_frames, facts.spacing_px]
            yield [*counts, np.mean(errors), np.mean(estimates), min(costs)]

    study.say(
        f"{backend.name}, {kind}: circles of confusion {blur.disk_px:.1f} px, motion "
        f"{blur.motion_px:.1f} px.\n"
    )
    header = ["sub-frames a row", "drawn", "spacing, px", "rms error", "estimated", "cost"]
    study.table(header, rows())


def blur(study: Study) -> None:
    """Prints the tables of some backends."""
    world = stones_on_ground()
    for name in study.options.backends[: 1 if study.fast else None]:
        backend, seen = open_backend(name), cameras()
        backend.load(world)
        camera = seen.pop("pinhole")
        drawn = times(lambda c=camera, b=backend: compose(b.radiance(c, 0, SPP, 0), world, c, 0), 2)
        plain = min(drawn.cpu)
        study.say(f"{name}: a pinhole's picture of {SPP} samples takes {plain:.2f} CPU s.\n")
        for kind, camera in list(seen.items())[: 1 if study.fast else None]:
            blurred(study, kind, camera, backend, world, plain)


def main(study: Study) -> None:
    """Prints the tables."""
    if "lenses" in study.options.of:
        header = ["backend", "lens", "way", "views", "edge rms", "mean", "pinhole = 1"]
        study.table(header, lenses(study))
    if "blur" in study.options.of:
        blur(study)


if __name__ == "__main__":
    run(main, backends=("mitsuba", "cycles", "pyrender"), of=("lenses", "blur"))
