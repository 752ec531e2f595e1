"""How much light is off where cameras are too far for the mesh to follow a material's relief.

    python studies/benchmarks/far_relief.py [--spp 32] [--fast]

Near, relief is geometry and casts shadows on itself; far, pictures alone stand for it, and normals
cast none. One view of level ground, once with a mesh that follows the relief to 0.3 pixels, once
with one that follows nothing: what their mean radiance differs by is the most that it changes on
the way, beside the noise of either.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from scenec.backends.run.render import render
from scenec.schemas.errors import ScenecError
from scenec.schemas.frames import read_frame
from scenec.schemas.picture import LUMINANCE
from scenec.studies.runner import Cell, Study, run

SUNS_DEG = (10.0, 20.0, 40.0)
FINE_PX, COARSE_PX = 0.3, 200.0
#: By name: what a material has beside its color.
GROUNDS: dict[str, dict[str, Any]] = {
    "fbm, 3 cm high, 40 cm long, 4 octaves": {
        "displacement": [
            {"type": "multifractal", "variant": "fbm", "amplitude_m": 0.03, "scale_m": 0.4,
             "octaves": 4, "gain": 0.6},
        ],
    },
    **{
        kind: {"maps": {"procedural": {"type": kind, "displacement": True}, "cells": {}}}
        for kind in ("pavement", "regolith", "gravel", "soil", "turf")
    },
}  # fmt: skip


def cfg(ground: dict[str, Any], sun_deg: float, tolerance_px: float) -> dict[str, Any]:
    """Level ground of one material, seen from 3 m, under a sun alone."""
    finest = {"finest_m": 0.004} if tolerance_px < 1.0 else {}
    return {
        "version": 1, "name": "far_relief", "samples": 1, "outputs": ["rgb"],
        "labels": {"class": {"ground": 1}},
        "terrain": {
            "size_m": [24, 24], "spacing_m": 0.25, "relief": [{"type": "plane"}],
            "mesh": {"tolerance_px": tolerance_px, **finest},
            "ground": [{"material": "m", "labels": {"class": "ground"}}],
        },
        "materials": {"m": {"base_color": [0.2, 0.2, 0.2], "specular": 0, **ground}},
        "light": {"sun": {"elevation_deg": sun_deg, "azimuth_deg": 300}},
        "rigs": {"r": {
            "pose": {
                "type": "random_target",
                "position": {"x_m": 0, "y_m": -2, "height_m": 3},
                "target": {"distance_m": 3, "bearing_deg": 90, "height_m": 0},
            },
            "sensors": {"c": {"resolution": [320, 240], "fov_deg": 50}},
        }},
    }  # fmt: skip


def main(study: Study) -> None:
    """One row a ground."""
    study.table(["ground", *(f"sun at {sun:g}°" for sun in SUNS_DEG)], _rows(study))


def _rows(study: Study) -> Iterator[list[Cell]]:
    for name, ground in list(GROUNDS.items())[: 1 if study.fast else None]:
        off = [
            _mean(study, cfg(ground, sun, COARSE_PX)) / _mean(study, cfg(ground, sun, FINE_PX)) - 1
            for sun in SUNS_DEG
        ]
        yield [name, *(f"{100.0 * each:+.1f} %" for each in off)]


def _mean(study: Study, content: dict[str, Any]) -> float:
    batch = study.batch(content)
    drawn = render(batch.parent, "mitsuba", spp=2 if study.fast else study.options.spp)
    if drawn.failed:
        raise ScenecError("; ".join(drawn.failed))
    return float(np.mean(read_frame(drawn.frames[0]).passes["rgb"].astype(np.float64) @ LUMINANCE))


if __name__ == "__main__":
    run(main, spp=32)
