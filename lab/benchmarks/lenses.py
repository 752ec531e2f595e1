"""What pictures through lenses cost, and how far off they are, each way: prints a table.

    python lab/benchmarks/lenses.py [--backends A,B] [--fast]

160 x 120 pixels of stones around the camera, without light, so that coverage alone is compared:
with that of 16 x 16 exact rays a pixel. Its rms error over pixels at edges (which holds the noise
of as many samples, and is beside that of a pinhole drawn by the same backend), the error of its
mean, and processor seconds over the pinhole's of the same size and samples. Each backend draws
lenses by its own rays where it can, and by resampled pinhole views; Mitsuba is shown both ways.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays, subpixel_directions
from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.picture import resample
from scenec.backends.registry import open_backend
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.backends.testing.scenes import mesh, scene, surface
from scenec.lab.runner import Cell, Study, run, times
from scenec.schemas.lens import Lens
from scenec.testing.lens_scenes import BROWN, FISHEYE, PANORAMA, with_lens
from scenec.testing.scenes import icosphere

WIDTH, HEIGHT, SPP = 160, 120, 64
SIDE = 16
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


def pictures(study: Study, backends: tuple[str, ...]) -> Iterator[list[Cell]]:
    """The rows of the table."""
    world = stones()
    cameras = dict(list(CAMERAS.items())[: 2 if study.fast else None])
    truth = {name: exact_coverage(camera, world) for name, camera in cameras.items()}
    for name in backends:
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


def main(study: Study) -> None:
    """Prints the table."""
    header = ["backend", "lens", "way", "views", "edge rms", "mean", "pinhole = 1"]
    chosen = study.options.backends[: 1 if study.fast else None]
    study.table(header, pictures(study, chosen))


if __name__ == "__main__":
    run(main, backends=("mitsuba", "cycles", "pyrender"))
