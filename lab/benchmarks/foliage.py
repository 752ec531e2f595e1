"""Measures what levels of detail of plants change in frames of Mitsuba, and save.

    python lab/benchmarks/foliage.py [--models A,B] [--spp 32] [--fast]

Twelve plants on a plane, 20 to 55 m off (small ones 3 to 9 m), 640 pixels across 60 degrees,
at rising ``lod_px``. Coverage is the share of pixels with a part of a plant in their middles,
luminance the mean over what a plant covers at the finest level; both beside the finest. What is
left of each pixel's luminance apart is root mean square, after 8 by 8 pixels are averaged, and
holds the noise of both pictures: the first row, another seed, is that alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.run.render import render
from scenec.lab.benchmarks.cfgs import rocks_on_hills
from scenec.lab.runner import Cell, Study, run
from scenec.schemas.frames import read_frame
from scenec.schemas.picture import luminance
from scenec.schemas.report import BatchReport, read_output_record

MODELS = ("oak", "birch_old", "spruce_old", "pine_old", "grass_tall", "fern")
RUNGS = (0.5, 1.0, 2.0, 4.0)
#: Models that are looked at from near.
SMALL = ("grass", "fern", "litter", "clover", "daisy", "poppy", "rose", "hazel", "juniper")


def main(study: Study) -> None:
    """One table for all models."""
    header = ("model", "lod_px", "triangles", "coverage", "luminance", "apart")
    study.table(header, _rows(study))


def _rows(study: Study) -> Iterator[list[Cell]]:
    rungs = RUNGS[:1] if study.fast else RUNGS
    for name in study.options.models[: 1 if study.fast else None]:
        finest, triangles = _seen(study, name, 0.0, 1)
        covered = finest[0] > 0
        for lod_px, seed in ((0.0, 2), *((rung, 1) for rung in rungs)):
            (labels, light), count = _seen(study, name, lod_px, seed)
            reference = finest[1][covered].mean()
            difference = _averaged(light - finest[1])[_averaged(covered) > 0.0]
            yield [
                name,
                f"{lod_px:g}",
                f"{count:,} ({100 * count / triangles:.0f} %)",
                f"{100 * ((labels > 0).sum() / covered.sum() - 1.0):+.2f} %",
                f"{100 * (light[covered].mean() / reference - 1.0):+.2f} %",
                f"{100 * np.sqrt((difference**2).mean()) / reference:.1f} %",
            ]


def _averaged(picture: NDArray[Any]) -> NDArray[np.float64]:
    """Over squares of 8 by 8 pixels."""
    rows, columns = (n // 8 for n in picture.shape)
    blocks = picture[: 8 * rows, : 8 * columns].reshape(rows, 8, columns, 8)
    return blocks.astype(np.float64).mean(axis=(1, 3))


def _seen(
    study: Study, name: str, lod_px: float, seed: int
) -> tuple[tuple[NDArray[Any], NDArray[np.float64]], int]:
    """Renders plants: where they are, the luminance of each pixel, the number of triangles."""
    size = 9.0 if name.startswith(SMALL) else 55.0
    plants = {
        "type": "meshes",
        "models": [{"file": f"package:assets/models/{name}.glb"}],
        "labels": {"class": "rock"},
        "count": 12,
        "where": [{"type": "camera", "min_m": 0.35 * size, "max_m": size}],
        "lod_px": lod_px,
    }
    cfg = rocks_on_hills(0, 2.4 * size, 100)
    cfg["objects"] = {"plants": plants}
    cfg["materials"] = {"sand": cfg["materials"]["sand"]}
    cfg["terrain"]["relief"] = [{"type": "plane"}]
    cfg["outputs"] = ["rgb", "label"]
    batch, spp = study.batch(cfg), 4 if study.fast else study.options.spp
    drawn = render(batch.parent, "mitsuba", spp=spp, noise_seed=seed, replace=True)
    passes = read_frame(drawn.frames[0]).passes
    report = read_output_record(batch / "report.json", BatchReport)
    light = luminance(passes["rgb"].astype(np.float64))
    return (passes["label.class"] == 3, light), report.objects["plants"].triangles


if __name__ == "__main__":
    run(main, models=MODELS, spp=32)
