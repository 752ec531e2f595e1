"""How far off the light of ground is whose relief is a map of normals, with and without facets.

    python lab/benchmarks/far_relief.py [--spp 64] [--fast]

The heights of a kind of surface, once as triangles between all texels, whose shadows and hidden
sides Mitsuba traces, and once as a level plane with the map of normals of the same heights: with
each facet drawn on its own, and with what ``scenec.backends.surface.facets`` makes of them. What
is compared is mean radiance over one repeat, under the sun alone, seen from 10 degrees above the
horizon (a camera 1.5 m high at 8.5 m), all colors the same.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.mitsuba.adapter import Mitsuba
from scenec.backends.stage.scene import Lighting, Maps, RenderScene, Surface
from scenec.backends.testing.scenes import affine, at_samples, look_at, mesh, plane, scene, sun
from scenec.compiler.kinds.table import kind_of
from scenec.compiler.materials.heights import painted_look, relief_m
from scenec.lab.runner import Cell, Study, run

KINDS = ("gravel", "soil", "regolith", "sand", "mud_cracks", "pavement", "turf")
SUNS_DEG = (10.0, 20.0, 40.0)
#: The sun's azimuth from the viewer's: behind, beside and before them.
AZIMUTHS_DEG = (0.0, 90.0, 180.0)
VIEW_DEG, HEADING_DEG = 10.0, 20.0
TEXELS = 512
ALBEDO = 0.2
#: Meters between what is compared, and from there to the camera.
APART_M, AWAY_M = 100.0, 400.0


def relief(kind: str, texels: int) -> tuple[NDArray[np.float64], float]:
    """Heights of one repeat, [y, x], meters, and its side, as a cfg has them that says no more."""
    made = kind_of("surface", kind)(key=7, resolution=texels)
    heights = np.asarray(painted_look(made, made.SIZE_M).height, np.float64)
    heights -= heights.mean()
    return heights * (
        relief_m(made, made.SIZE_M, float(heights.std())) / heights.std()
    ), made.SIZE_M


def compared(folder: Path, kind: str, texels: int) -> RenderScene:
    """The relief, normals alone, and facets: in this order along x."""
    heights, side = relief(kind, texels)
    texel = side / texels
    # The middle repeat is seen, those about it shade it.
    count = 3 * texels + 1
    points, faces = plane(1.5 * side, 3 * texels)
    points[:, 2] = np.pad(np.tile(heights, (3, 3)), ((0, 1), (0, 1)), mode="wrap").ravel()
    assert len(points) == count * count
    x, y = (
        (np.roll(heights, -1, axis) - np.roll(heights, 1, axis)) / (2.0 * texel) for axis in (1, 0)
    )
    normals = np.stack([-x, -y, np.ones_like(x)], axis=-1)
    normals /= np.sqrt((normals * normals).sum(axis=-1, keepdims=True))
    picture = folder / f"{kind}.png"
    codes = np.rint((0.5 * normals[::-1] + 0.5) * 255.0).astype(np.uint8)
    Image.fromarray(codes).save(picture)
    dull = Surface("", (ALBEDO,) * 3, 0.0, 1.0, 0.0)
    alone = dataclasses.replace(dull, maps=Maps(side, normal=picture))
    lean = float(np.sqrt(1.0 - normals[..., 2] ** 2).mean())
    drawn = dataclasses.replace(alone, maps=Maps(side, normal=picture, lean=lean))
    level = plane(4.0 * side)
    made = scene(
        [mesh(points, faces, (0,)), mesh(*level, (1,)), mesh(*level, (2,))],
        [dull, alone, drawn],
        rows=[(i, affine(offset=(APART_M * i, 0.0, 0.0))) for i in range(3)],
    )
    heading, rise = math.radians(HEADING_DEG), math.radians(VIEW_DEG)
    toward = np.array([math.cos(rise) * math.cos(heading), math.cos(rise) * math.sin(heading),
                       math.sin(rise)])  # fmt: skip
    wide = 96
    high = round(wide * math.sin(rise))
    cameras, lights = [], []
    for elevation in SUNS_DEG:
        for azimuth in AZIMUTHS_DEG:
            for i in range(3):
                middle = np.array([APART_M * i, 0.0, 0.0])
                fov = math.degrees(side / AWAY_M)
                cameras.append(look_at(middle + AWAY_M * toward, middle, wide, high, fov))
                lights.append(Lighting((sun(elevation, HEADING_DEG + azimuth),), ()))
    return at_samples(made, lights, cameras)


def measured(halves: NDArray[np.float32]) -> tuple[float, float]:
    """Mean radiance, and the deviation of pixels beside it, which the halves' noise is out of."""
    first, second = halves.astype(np.float64).mean(axis=-1)
    mean = 0.5 * float(first.mean() + second.mean())
    together = float(((first - first.mean()) * (second - second.mean())).mean())
    return mean, math.sqrt(max(together, 0.0)) / mean


def main(study: Study) -> None:
    """One row a kind and sun: the error without facets, and with them; the same of contrast."""
    sides = ["behind the viewer", "beside", "before"]
    contrast = [f"contrast {side}" for side in sides]
    study.table(["ground", "lean", "sun at", *sides, *contrast], _rows(study))


def _rows(study: Study) -> Iterator[list[Cell]]:
    backend = Mitsuba()
    for kind in KINDS[: 1 if study.fast else None]:
        made = compared(study.scratch, kind, 64 if study.fast else TEXELS)
        backend.load(made)
        spp = 4 if study.fast else study.options.spp
        found = [
            measured(backend.radiance(made.cameras[sample][0], sample, spp, 0).halves)
            for sample in range(made.samples)
        ]
        means, contrasts = np.reshape(found, (len(SUNS_DEG), len(AZIMUTHS_DEG), 3, 2)).T
        truth, alone, drawn = means
        maps = made.surfaces[2].maps
        assert maps is not None
        for k, elevation in enumerate(SUNS_DEG):
            cells = [
                f"{alone[j, k] / truth[j, k] - 1.0:+.0%} → {drawn[j, k] / truth[j, k] - 1.0:+.0%}"
                for j in range(len(AZIMUTHS_DEG))
            ]
            # Of triangles, and of facets.
            cells += [f"{contrasts[0, j, k]:.2f}, {contrasts[2, j, k]:.2f}" for j in range(3)]
            yield [kind, f"{maps.lean:.2f}", f"{elevation:g}°", *cells]


if __name__ == "__main__":
    run(main, spp=64)
