"""The part of docs/clouds.md on shadows: a view in all renderers, what they err and cost."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.registry import open_backend
from scenec.backends.stage.read import read_stage
from scenec.compiler.geometry.poses import facing
from scenec.compiler.light.cloud_fields import Cirrus, Cumulus
from scenec.compiler.light.cloud_rays import beam_left
from scenec.compiler.light.cloud_shadows import Land, cloud_shadows
from scenec.lab.pictures import frames, photograph, save, sheet
from scenec.lab.runner import Page, held, in_turns

BACKENDS = ("mitsuba", "cycles", "pyrender")
RADIUS = float(np.radians(0.265))
#: Hills of heath and sand, 2.4 km wide, seen from 40 m above.
HEATH: dict[str, Any] = json.loads(
    Path(__file__).with_name("heath.json").read_text(encoding="utf-8")
)


def shadows(page: Page, layer: Callable[..., Cumulus], none: Cirrus) -> None:
    """A view, errors and costs.

    Args:
        page: The page.
        layer: Makes a layer of cumulus of a coverage.
        none: No cirrus.
    """
    out, tiles = page.scratch / "heath", []
    for name in BACKENDS:
        (frame,) = frames(page.cfg(HEATH), out, name, spp=4 if page.fast else 48)
        tiles.append(("", photograph(frame)))
    save(sheet([tiles], 460), page.picture("shadows"))
    _errors(page, layer(0.4), none)
    _frames(page, out / "batch_0000" / "stage.usda")


def _errors(page: Page, cumulus: Cumulus, none: Cirrus) -> None:
    """Against beams to all of the sun's disc, by the size of the land."""
    rows: list[list[str | float]] = []
    count = 40 if page.fast else 400
    for half in (100.0, 500.0, 2500.0):
        land = Land((-half, -half, -0.02 * half), (half, half, 0.05 * half), 0.0)
        for elevation in (60.0, 20.0):
            at = np.radians(elevation)
            way = np.array([0.0, -np.cos(at), np.sin(at)])
            made, moved, seconds = None, 0, 0.0
            while made is None:
                # Small land is seldom crossed by a border.
                pattern = cumulus.pattern._replace(east_m=150.0 * moved)
                moved += 1
                start = time.process_time()
                made = cloud_shadows(way, RADIUS, cumulus._replace(pattern=pattern), none, land)
                seconds = time.process_time() - start
            there = cumulus._replace(pattern=pattern)
            places = np.random.default_rng(1).uniform(land.low, land.high, (count, 3))
            true = np.array([_of_disc(place, way, there, none) for place in places])
            plane = places @ facing(way)[:, :2]
            x, y = ((plane - made.middle_m) / made.texel_m).T
            height, width = made.picture.shape
            column = np.clip(x + 0.5 * width, 0, width - 1).astype(int)
            line = np.clip(0.5 * height - y, 0, height - 1).astype(int)
            off = made.picture[line, column] / 65535.0 - true
            rows.append(
                [
                    f"{2.0 * half:g}", f"{elevation:g}", f"{width} × {height}",
                    f"{made.texel_m:.1f}", f"{seconds:.2f}",
                    f"{100.0 * np.abs(off).mean():.2f} %",
                    f"{100.0 * np.percentile(np.abs(off), 99):.1f} %",
                ]
            )  # fmt: skip
    page.rows(rows)


def _of_disc(
    place: NDArray[np.float64], way: NDArray[np.float64], cumulus: Cumulus, none: Cirrus
) -> float:
    """Share of the disc's light at a place: 64 beams on Vogel's spiral."""
    k = np.arange(64)
    radius, turn = RADIUS * np.sqrt((k + 0.5) / 64), k * np.pi * (3.0 - np.sqrt(5.0))
    aside = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    ways = way + aside @ facing(way)[:, :2].T
    ways /= np.sqrt((ways * ways).sum(axis=1))[:, None]
    total = 0.0
    for one in ways:
        east, north = (place - one * (place[2] / one[2]))[:2]
        total += beam_left(one, float(east), float(north), cumulus, none)
    return total / 64.0


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
