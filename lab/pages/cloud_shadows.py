"""The part of docs/clouds.md on shadows: a view in all renderers, what they err and cost."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scenec.backends.registry import open_backend
from scenec.backends.stage.read import read_stage
from scenec.lab.pictures import frames, photograph, save, sheet
from scenec.lab.runner import Page, held, in_turns

BACKENDS = ("mitsuba", "cycles", "pyrender")
#: Hills of heath and sand, 2.4 km wide, seen from 40 m above.
HEATH: dict[str, Any] = json.loads(
    Path(__file__).with_name("heath.json").read_text(encoding="utf-8")
)


def shadows(page: Page) -> None:
    """Draws shadows on the land in all renderers, and times a frame with and without."""
    out, tiles = page.scratch / "heath", []
    for name in BACKENDS:
        (frame,) = frames(page.cfg(HEATH), out, name, spp=4 if page.fast else 48)
        tiles.append(("", photograph(frame)))
    save(sheet([tiles], 460), page.picture("shadows"))
    _frames(page, out / "batch_0000" / "stage.usda")


def _frames(page: Page, stage: Path) -> None:
    """What a frame costs more with shadows than without, by renderer."""
    rows = []
    for name in BACKENDS:
        with held() as process:
            cost, over = process(frame_cost, name, stage, 2 if page.fast else 7).value
        rows.append([name, f"{cost:.2f}", f"{100.0 * (over - 1.0):+.1f} %"])
    page.rows(rows)


def frame_cost(name: str, stage: Path, runs: int) -> tuple[float, float]:
    """CPU seconds of a frame without shadows, and those with over those."""
    scene = read_stage(stage)
    (camera,) = scene.cameras[0]
    k = camera.intrinsics.copy()
    k[0] *= 320 / camera.width
    k[1] *= 240 / camera.height
    camera = replace(camera, width=320, height=240, intrinsics=k)
    with_, suns = scene.lighting[0], scene.lighting[0].suns
    without = replace(with_, suns=tuple(replace(sun, gobo=None) for sun in suns))
    both = replace(
        scene, samples=2, lighting=(with_, without), cameras=((camera,),) * 2, haze=(),
        times=np.zeros(2),
    )  # fmt: skip
    backend = open_backend(name)
    backend.load(both)
    found = in_turns(
        {
            "with": lambda turn: backend.radiance(camera, 0, 32, turn),
            "without": lambda turn: backend.radiance(camera, 1, 32, turn),
        },
        runs,
    )
    # The least: what else the machine does only adds.
    cost = {name: min(one.cpu) for name, one in found.items()}
    return cost["without"], cost["with"] / cost["without"]
