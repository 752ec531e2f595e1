"""The part of docs/clouds.md on shadows: a view in all renderers, what they err and cost."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.registry import open_backend
from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.compiler.geometry.poses import facing
from scenec.compiler.light.cloud_fields import Cirrus, Cumulus
from scenec.compiler.light.cloud_rays import beam_left
from scenec.compiler.light.cloud_shadows import Land, cloud_shadows
from scenec.lab.runner import Page, held, in_turns, table
from scenec.schemas.files import atomic
from scenec.schemas.frames import read_frame
from scenec.schemas.picture import develop

BACKENDS = ("mitsuba", "cycles", "pyrender")
RADIUS = float(np.radians(0.265))
#: Hills of heath and sand, 2.4 km wide, seen from 40 m above.
HEATH: dict[str, Any] = {
    "version": 1,
    "name": "heath",
    "batches": 1,
    "samples": 1,
    "outputs": ["rgb"],
    "labels": {"class": {"sky": 1, "ground": 2}},
    "terrain": {
        "size_m": [2400, 2400],
        "spacing_m": 5,
        "relief": [
            {"type": "plane"},
            {"type": "multifractal", "amplitude_m": 22, "scale_m": 420, "octaves": 7},
        ],
        "ground": [
            {"material": "heath", "labels": {"class": "ground"}},
            {
                "material": "sand",
                "labels": {"class": "ground"},
                "noise": {"scale_m": 130, "octaves": 5, "distortion": 0.3},
                "coverage": 0.25,
            },
        ],
        "horizon": {
            "reach_m": 7000,
            "spacing_m": 60,
            "relief": [
                {"type": "plane"},
                {"type": "multifractal", "amplitude_m": 60, "scale_m": 1500, "octaves": 8},
            ],
            "material": "heath",
            "labels": {"class": "ground"},
        },
    },
    "materials": {
        "heath": {"base_color": [0.11, 0.14, 0.05], "variation": 0.35},
        "sand": {"base_color": [0.35, 0.28, 0.17], "variation": 0.2},
    },
    "objects": {},
    "light": {
        "sun": {"elevation_deg": 42, "azimuth_deg": 250},
        "sky": {"type": "atmosphere", "scattering": "multiple", "labels": {"class": "sky"}},
        "haze": {"visibility_m": 40000},
        "clouds": {"cumulus": {"coverage": 0.25, "base_m": 800, "size_m": 450, "thickness_m": 250}},
    },
    "rigs": {
        "view": {
            "pose": {
                "type": "random_target",
                "position": {"x_m": 0, "y_m": -900, "height_m": 40},
                "target": {"distance_m": 700, "bearing_deg": 10, "height_m": 0},
            },
            "sensors": {"eye": {"resolution": [460, 300], "fov_deg": 75}},
        }
    },
}


def shadows(page: Page, layer: Callable[..., Cumulus], none: Cirrus) -> str:
    """A view, errors and costs.

    Args:
        page: The page.
        layer: Makes a layer of cumulus of a coverage.
        none: No cirrus.
    """
    out = page.batch(HEATH)
    panels = []
    for name in BACKENDS:
        report = render(out.parent, name, spp=4 if page.fast else 48)
        frame = read_frame(report.frames[0])
        panels.append(develop(frame.passes["rgb"], frame.sidecar.exposure_ev))
    with atomic(page.picture("shadows")) as target:
        row = Image.fromarray(np.concatenate(panels, axis=1))
        row.quantize(256, dither=Image.Dither.NONE).save(target, format="PNG", optimize=True)
    return (
        "## Shadows on the land\n\nHills 2.4 km wide and land beyond, from 40 m above, by "
        f"{', '.join(BACKENDS)}.\n\n"
        + page.shown("shadows", "Shadows of cumulus on hills in three renderers")
        + "\n"
        + _errors(page, layer(0.4), none)
        + "\n"
        + _frames(page, out / "stage.usda")
    )


def _errors(page: Page, cumulus: Cumulus, none: Cirrus) -> str:
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
    return (
        f"The share of the sun that comes through, at {count} places of land of some width and a "
        "tenth of that half high, against beams to all of the sun's disc; CPU seconds of a "
        "picture:\n\n"
        + table(
            ["land, m", "sun, °", "texels", "a texel, m", "CPU s", "mean error", "99th percentile"],
            rows,
        )
    )


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


def _frames(page: Page, stage: Path) -> str:
    """What a frame costs more with shadows than without, by renderer."""
    rows = []
    for name in BACKENDS:
        with held() as process:
            cost, over = process(frame_cost, name, stage, 2 if page.fast else 7).value
        rows.append([name, f"{cost:.2f}", f"{100.0 * (over - 1.0):+.1f} %"])
    return (
        "A frame of 320 × 240 pixels of that view, 32 samples, and what shadows add to it; the "
        "least of frames in turns (a few percent either way are the machine's). Cycles sends each "
        "ray to the sun and the sky through a plane, and draws the sky's light as well: half of "
        "what is added is its table of directions, once a sample. That halves its noise in the "
        "shade.\n\n" + table(["", "CPU s", "with shadows"], rows)
    )


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
