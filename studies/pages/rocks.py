"""Writes docs/rocks.md: the families of rocks, near and far, and what their levels of detail cost.

    python studies/pages/rocks.py [--fast] [-o FOLDER]

Needs the extras "mitsuba" and "demo". Pictures take some minutes on two cores; tables are facts of
the code.
"""

from __future__ import annotations

import json
import math
from functools import partial
from typing import Any

import numpy as np
from PIL import Image

from scenec.backends.run.render import render
from scenec.compiler.cfg.load import load
from scenec.compiler.draw.batch import draw
from scenec.compiler.objects.rocks import build_chains
from scenec.schemas.frames import read_frame
from scenec.schemas.picture import develop
from scenec.studies.runner import Page, run, table

HEAD = """# Rocks

The families of `objects` of type `rocks` ([keys](cfg.md#objects-rocks)). Every rock is a radius
over the directions from a point inside of it, on a subdivided icosahedron: its mesh is closed,
manifold, and cannot meet itself. Vertices near the creases of broken blocks and of slabs are moved
onto them.
({versions}; {cores} cores.)

Each picture shows one family as Mitsuba draws it under a low sun: from about 1 m at the default
`lod_px` of 0.5, the same with `lod_px` 10, and thousands from 3 m up, out to 60 m.
"""

FAMILIES = {
    "weathered": "worn blocks, the default",
    "angular": "three pairs of joints, random fractures, chipped corners, scars of flakes",
    "rounded": "lopsided superellipsoids with worn flats and pits",
    "slab": "plates of layered rock, their sides stepped; they lie along the ground",
    "vesicular": "worn blocks with open bubbles, darker inside",
}
_SIZE = (360, 240)
_GAP = 6
#: Stones of a contact sheet, and pixels of the side of each one's square.
_STONES = 4
_STONE_PX = 400


def cfg(family: str, far: bool, lod_px: float, subdivisions: int = 5) -> dict[str, Any]:
    """A plain with one class of rocks, and one camera."""
    rocks = {
        "type": "rocks",
        "family": family,
        "material": "rock",
        "subdivisions": subdivisions,
        "prototypes": 8,
        "lod_px": lod_px,
        "embed": {"type": "uniform", "min": 0.05, "max": 0.25},
        "orientation": "normal",
    }
    if far:
        rocks |= {
            "count": 6000,
            "size_m": {"type": "log_uniform", "min": 0.1, "max": 1.6},
            "density": {"type": "noise", "scale_m": 12, "contrast": 2},
        }
    else:
        rocks |= {"count": 32, "size_m": {"type": "log_uniform", "min": 0.15, "max": 0.55}}
    extent = 120 if far else 2.4
    pose = {
        "type": "random_target",
        "position": {"x_m": 0, "y_m": -50 if far else -1.19, "height_m": 3 if far else 0.6},
        "target": {
            "distance_m": 20 if far else 1.1,
            "bearing_deg": 0,
            "height_m": 0 if far else 0.05,
        },
    }
    return {
        "version": 1,
        "name": "rocks",
        "samples": 1,
        "labels": {},
        "outputs": ["rgb"],
        "terrain": {
            "size_m": [extent, extent],
            "spacing_m": extent / 240,
            "relief": [
                {"type": "plane"},
                {
                    "type": "multifractal",
                    "amplitude_m": 0.8 if far else 0.05,
                    "scale_m": 25 if far else 1.5,
                    "octaves": 8,
                },
            ],
            "ground": [{"material": "soil"}],
        },
        "materials": {
            "soil": {"base_color": [0.3, 0.24, 0.18], "variation": 0.2},
            "rock": {"base_color": [0.2, 0.18, 0.16], "variation": 0.45},
        },
        "objects": {"rocks": rocks},
        "light": {
            "sun": {"elevation_deg": 22, "azimuth_deg": 250, "irradiance": 900},
            "sky": {"type": "clear", "irradiance": 120},
        },
        "rigs": {"camera": {"pose": pose, "sensors": {"eye": {
            "resolution": list(_SIZE), "fov_deg": 55 if far else 48,
        }}}},
    }  # fmt: skip


def sheet_cfg(family: str, subdivisions: int = 6) -> dict[str, Any]:
    """Single stones side by side on gray ground under a grazing sun, and one camera."""
    step_m, away_m, up_m = 0.62, 4.0, 1.3
    wide_m = _STONES * step_m
    rocks = {
        f"stone_{i}": {
            "type": "rocks",
            "family": family,
            "material": "rock",
            "count": 1,
            "prototypes": 1,
            "subdivisions": subdivisions,
            "lod_px": 0,
            "size_m": 0.5,
            "embed": 0.12,
            "orientation": "normal",
            "where": [{
                "type": "point", "x_m": (i - 0.5 * (_STONES - 1)) * step_m, "y_m": 0,
                "max_m": 0.04,
            }],
        }
        for i in range(_STONES)
    }  # fmt: skip
    pose = {
        "type": "random_target",
        "position": {"x_m": 0, "y_m": -away_m, "height_m": up_m},
        "target": {"distance_m": away_m, "bearing_deg": 0, "height_m": 0.14},
    }
    fov = 2.0 * math.degrees(math.atan2(0.5 * wide_m, math.hypot(away_m, up_m)))
    return {
        "version": 1,
        "name": "stones",
        "samples": 1,
        "labels": {},
        "outputs": ["rgb"],
        "terrain": {
            "size_m": [8, 8],
            "spacing_m": 0.02,
            "relief": [{"type": "plane"}],
            "ground": [{"material": "gray"}],
        },
        "materials": {
            "gray": {"base_color": [0.2, 0.2, 0.2], "specular": 0},
            "rock": {"base_color": [0.11, 0.1, 0.09], "variation": 0.45},
        },
        "objects": rocks,
        "light": {
            "sun": {"elevation_deg": 20, "azimuth_deg": 225, "irradiance": 900},
            "sky": {"type": "clear", "irradiance": 90},
        },
        "rigs": {"camera": {"pose": pose, "sensors": {"eye": {
            "resolution": [_STONES * _STONE_PX, _STONE_PX], "fov_deg": fov,
        }}}},
    }  # fmt: skip


def shot(page: Page, content: dict[str, Any], spp: int) -> tuple[Image.Image, dict[str, Any]]:
    """One frame, and what the report says of its rocks."""
    batch = page.batch(content, seed=4)
    frame = read_frame(render(batch.parent, "mitsuba", spp=spp, passes=("rgb",)).frames[0])
    facts = json.loads((batch / "report.json").read_text())["objects"]["rocks"]
    picture = develop(frame.passes["rgb"], float(frame.sidecar["exposure_ev"]))
    return Image.fromarray(picture), facts


def family_part(page: Page, family: str) -> str:
    """A family's pictures and numbers."""
    spp = 4 if page.fast else 48
    sheet = Image.new("RGB", (3 * _SIZE[0] + 2 * _GAP, _SIZE[1]), (255, 255, 255))
    rows = []
    views = (("near", False, 0.5), ("near, coarse", False, 10.0), ("far", True, 0.5))
    for i, (name, far, lod_px) in enumerate(views):
        picture, facts = shot(page, cfg(family, far, lod_px, 3 if page.fast else 5), spp)
        sheet.paste(picture, (i * (_SIZE[0] + _GAP), 0))
        rows.append([
            name, f"{facts['count']:,}", f"{facts['triangles_finest']:,}",
            f"{facts['triangles']:,}", f"{lod_px:g}", f"{facts['lod_error_max_px']:.2f}",
        ])  # fmt: skip
    small = sheet.quantize(256, kmeans=2, dither=Image.Dither.NONE)
    small.save(page.picture(family), optimize=True)
    header = ["view", "rocks", "triangles, finest", "triangles", "px asked", "px worst"]
    return (
        f"## {family.capitalize()}\n\n{FAMILIES[family].capitalize()}.\n\n"
        + page.shown(family)
        + "\n"
        + table(header, rows)
    )


def levels(page: Page) -> str:
    """Errors of the levels, axis ratios, and seconds."""
    subdivisions = 4
    rows, speed = [], []
    for family in FAMILIES:
        path = page.cfg(cfg(family, False, 0.5, subdivisions))
        (plan,) = draw(load(path), 4, 0).objects
        chains = build_chains(plan.source.shapes)
        errors = np.array([[rock.error for rock in chain] for chain in chains]).mean(axis=0)
        extents = np.array([np.ptp(chain[0].points, axis=0) for chain in chains])
        ratios = (extents / extents.max(axis=1)[:, None]).mean(axis=0)
        rows.append([family, *(f"{100 * e:.1f}" for e in errors[1:]),
                     f"{ratios[1]:.2f}", f"{ratios[2]:.2f}"])  # fmt: skip
        speed.append(f"{family} {page.timed(partial(build_chains, plan.source.shapes)):.2f}")
    header = ["family", *(f"{20 * 4**s:,}" for s in range(subdivisions - 1, -1, -1))]
    return (
        "## Levels\n\nThe distance of each level from the finest (5,120 triangles) in percent of "
        "the rock's size, as the mean of eight shapes, and the shapes' mean axis ratios.\n\n"
        + table([*header, "b/a", "c/a"], rows)
        + f"\nSeconds to make eight shapes with all levels: {', '.join(speed)}.\n"
    )


def main(page: Page) -> None:
    """Writes the page and its pictures."""
    parts = [levels, *(partial(family_part, family=family) for family in FAMILIES)]
    page.write(HEAD, ("scenec", "numpy", "numba", "mitsuba"), parts)


if __name__ == "__main__":
    run(main, page="rocks")
