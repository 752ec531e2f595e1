"""Writes docs/rocks.md: the families of rocks, their coatings, and their levels of detail.

    python lab/pages/rocks.py [--fast] [-o FOLDER]

Needs the extras "mitsuba" and "demo". Pictures take some minutes on two cores; tables are facts of
the code.
"""

from __future__ import annotations

import json
import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from scenec.backends.run.render import render
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.objects.rocks import build_chains
from scenec.lab.runner import Page, run, table
from scenec.schemas.frames import read_frame
from scenec.schemas.picture import develop

HEAD = """# Rocks

The families of `objects` of type `rocks` ([keys](cfg.md#objects-rocks)). Every rock is a radius
over the directions from a point inside of it, on a subdivided icosahedron: its mesh is closed,
manifold, and cannot meet itself. Vertices near the creases of broken blocks and of slabs are moved
onto them.
({versions}; {cores} cores.)

Each sheet shows four stones of a family as Mitsuba draws them under a grazing sun, each 0.5 m wide
and 300 pixels or so, at 81,920 triangles, with the surface that is named.
"""


class Family(NamedTuple):
    """What the page shows of a family.

    Attributes:
        what: It is.
        unlike: In what it differs from stones in nature.
        surface: Of the stones on its sheet; None for a plain material.
    """

    what: str
    unlike: str
    surface: dict[str, Any] | None


FAMILIES = {
    "weathered": Family(
        "Worn blocks between joints and fractures, the default: edges rounded unevenly, faces "
        "smoother than edges, spalls, patches of pits. The finest relief has waves of a twentieth "
        "of a radius, however many triangles there are.",
        "It has no open cracks, and no overhang below a spall's edge.",
        {"type": "weathered"},
    ),
    "angular": Family(
        "Three pairs of joints, random fractures, chipped corners, scars of flakes.",
        "Fresh faces are as grainy as old ones, without hackle.",
        {"type": "basalt", "vesicles": 0.1},
    ),
    "rounded": Family(
        "Cobbles of rivers and beaches: lopsided superellipsoids with worn flats and pits.",
        "Pits are all of one size.",
        {"type": "granite"},
    ),
    "slab": Family(
        "Plates of layered rock, their sides stepped; they lie along the ground.",
        "What is left of the next layer on top ends in curls, where nature has angular edges.",
        {"type": "sandstone", "bedding": 0.2},
    ),
    "vesicular": Family(
        "Worn blocks with open bubbles, darker inside.",
        "The smallest bubbles are a thirtieth of the stone; what is finer is for the surface.",
        {"type": "basalt", "vesicles": 0},
    ),
    "ventifact": Family(
        "Stones that blown sand has cut: two to four faces, fluted where they are flat and pitted "
        "where they are steep, which meet in keels. They stand on their uncut half. One face of "
        "each looks into the field's wind, within 30 degrees: that of the relief's dunes, barchans "
        "or ripples, or else one that is drawn for the batch.",
        "Flutes run up every face alike; in nature they run with the wind, whichever way a face "
        "looks.",
        {"type": "basalt", "vesicles": 0.1},
    ),
    "bedded": Family(
        "Blocks of layered rock between joints. Beds differ in thickness; soft ones have weathered "
        "back; some are cross-bedded.",
        "Deep notches are ragged at the scale of the mesh, for a radius over directions has no "
        "overhang.",
        {"type": "sandstone", "bedding": 0.2},
    ),
    "breccia": Family(
        "Angular pieces of many sizes in a matrix that has weathered back around them.",
        "Pieces are of one rock each, and none is itself a breccia.",
        None,
    ),
}
_SIZE = (360, 240)
_GAP = 6
#: Stones of a contact sheet, the width of each one's place, and the height of all, in pixels.
_STONES = 4
_STONE_PX = 400
_SHEET_PX = 300
#: Of the picture of coatings, one a stone: name, the coating's keys, its material.
COATINGS: tuple[tuple[str, dict[str, Any], dict[str, Any]], ...] = (
    ("none", {}, {}),
    ("dust", {}, {"base_color": [0.33, 0.2, 0.12], "specular": 0}),
    ("snow", {"tops": 1, "max_slope_deg": 55}, {"base_color": [0.85, 0.87, 0.9], "specular": 0}),
    (
        "wet foot",
        {"tops": 0, "hollows": 0, "foot_height": 0.25},
        {"base_color": [0.035, 0.03, 0.027], "specular": 0.03, "roughness": 0.45},
    ),
)


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


def sheet_cfg(family: str, surface: dict[str, Any] | None, subdivisions: int = 6) -> dict[str, Any]:
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
            "rock": {"base_color": [0.11, 0.1, 0.09], "variation": 0.45}
            | ({"maps": {"procedural": surface}} if surface else {}),
        },
        "objects": rocks,
        "light": {
            "sun": {"elevation_deg": 20, "azimuth_deg": 225, "irradiance": 900},
            "sky": {"type": "clear", "irradiance": 90},
        },
        "rigs": {"camera": {"pose": pose, "sensors": {"eye": {
            "resolution": [_STONES * _STONE_PX, _SHEET_PX], "fov_deg": fov,
        }}}},
    }  # fmt: skip


def shot(page: Page, content: dict[str, Any], spp: int) -> tuple[Image.Image, dict[str, Any]]:
    """One frame, and what the report says of its classes of objects."""
    batch = page.batch(content, seed=4)
    frame = read_frame(render(batch.parent, "mitsuba", spp=spp, passes=("rgb",)).frames[0])
    picture = develop(frame.passes["rgb"], frame.sidecar.exposure_ev)
    return Image.fromarray(picture), json.loads((batch / "report.json").read_text())["objects"]


def keep(page: Page, picture: Image.Image, name: str) -> str:
    """Writes a picture small; returns the Markdown that shows it."""
    small = picture.quantize(64, kmeans=2, dither=Image.Dither.NONE)
    small.save(page.picture(name), optimize=True)
    return page.shown(name)


def family_part(page: Page, family: str) -> str:
    """A family's contact sheet."""
    of = FAMILIES[family]
    content = sheet_cfg(family, of.surface, 3 if page.fast else 6)
    picture, _ = shot(page, content, 4 if page.fast else 32)
    surface = f"Surface: `{of.surface['type']}`." if of.surface else "A plain material."
    return (
        f"## {family.capitalize()}\n\n{of.what} {surface}\n\n"
        f"{keep(page, picture, family)}\nUnlike stones in nature: {of.unlike[0].lower()}"
        f"{of.unlike[1:]}\n"
    )


def coatings(page: Page) -> str:
    """One family with several coatings."""
    content = sheet_cfg("ventifact", FAMILIES["ventifact"].surface, 3 if page.fast else 6)
    for (_, keys, material), stone in zip(COATINGS, content["objects"].values(), strict=True):
        stone["embed"] = 0.2
        if material:
            name = f"coat_{len(content['materials'])}"
            content["materials"][name] = material
            stone["coatings"] = [{"material": name, **keys}]
    content["light"]["sun"]["elevation_deg"] = 35
    picture, _ = shot(page, content, 4 if page.fast else 32)
    rows = [[name, f"`{json.dumps(keys)}`" if material else ""]
            for name, keys, material in COATINGS]  # fmt: skip
    return (
        "## Coatings\n\n"
        "`coatings` ([keys](cfg.md#objects-rocks-coating)) lie on a class's rocks as they rest: on "
        "what faces up, in hollows, and next to the ground. Each is a material, merged over the "
        "rock's own by a weight at the vertices, in all renderers alike; so borders are as fine as "
        "the mesh, and rocks turned at random have none. The foot lies where the mean `embed` of "
        "the class puts the ground. MaterialX in the stage shows the rock's own material; preview "
        "surfaces show the mix, as displayColor.\n\n"
        + keep(page, picture, "coatings")
        + "\n"
        + table(["stone", "keys beside the material"], rows)
    )


def levels(page: Page) -> str:
    """Errors of the levels, axis ratios, seconds, and what views come to."""
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
        + f"\nSeconds to make eight shapes with all levels: {', '.join(speed)}.\n\n"
        + _views(page)
    )


def _views(page: Page) -> str:
    """What levels save, and that nobody sees it."""
    spp = 4 if page.fast else 48
    sheet = Image.new("RGB", (3 * _SIZE[0] + 2 * _GAP, _SIZE[1]), (255, 255, 255))
    rows = []
    views = (("near", False, 0.5), ("near, coarse", False, 10.0), ("far", True, 0.5))
    for i, (name, far, lod_px) in enumerate(views):
        content = cfg("angular", far, lod_px, 3 if page.fast else 5)
        picture, classes = shot(page, content, spp)
        facts = classes["rocks"]
        sheet.paste(picture, (i * (_SIZE[0] + _GAP), 0))
        rows.append([
            name, f"{facts['count']:,}", f"{facts['triangles_finest']:,}",
            f"{facts['triangles']:,}", f"{lod_px:g}", f"{facts['lod_error_max_px']:.2f}",
        ])  # fmt: skip
    header = ["view", "rocks", "triangles, finest", "triangles", "px asked", "px worst"]
    return (
        "Angular rocks from about 1 m at the default `lod_px` of 0.5, the same with `lod_px` 10, "
        "and thousands from 3 m up, out to 60 m:\n\n"
        + keep(page, sheet, "levels")
        + "\n"
        + table(header, rows)
    )


def main(page: Page) -> None:
    """Writes the page and its pictures."""
    parts = [*(partial(family_part, family=family) for family in FAMILIES), coatings, levels]
    page.write(HEAD, ("scenec", "numpy", "numba", "mitsuba"), parts)


if __name__ == "__main__":
    run(main, page="rocks")
