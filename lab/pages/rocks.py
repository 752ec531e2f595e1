"""Makes what docs/rocks.md shows: families of rocks, their coatings and levels of detail.

    python lab/pages/rocks.py [--fast] [-o FOLDER]

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

from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.objects.rocks import build_chains
from scenec.lab.benchmarks.cfgs import looking, plain
from scenec.lab.pictures import frames, photograph, save, sheet
from scenec.lab.runner import Page, run

#: Surfaces of the stones on the sheet of each family; None for a plain material.
FAMILIES: dict[str, dict[str, Any] | None] = {
    "weathered": {"type": "weathered"},
    "angular": {"type": "basalt", "vesicles": 0.1},
    "rounded": {"type": "granite"},
    "slab": {"type": "sandstone", "bedding": 0.2},
    "vesicular": {"type": "basalt", "vesicles": 0},
    "ventifact": {"type": "basalt", "vesicles": 0.1},
    "bedded": {"type": "sandstone", "bedding": 0.2},
    "breccia": None,
}
_SIZE = (360, 240)
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
    rocks: dict[str, Any] = {
        "type": "rocks", "family": family, "material": "rock", "subdivisions": subdivisions,
        "prototypes": 8, "lod_px": lod_px, "orientation": "normal",
        "embed": {"type": "uniform", "min": 0.05, "max": 0.25},
    }  # fmt: skip
    if far:
        rocks |= {"count": 6000, "size_m": {"type": "log_uniform", "min": 0.1, "max": 1.6},
                  "density": {"type": "noise", "scale_m": 12, "contrast": 2}}  # fmt: skip
        rig = looking((0, -50, 3), 20, resolution=list(_SIZE), fov_deg=55)
    else:
        rocks |= {"count": 32, "size_m": {"type": "log_uniform", "min": 0.15, "max": 0.55}}
        rig = looking((0, -1.19, 0.6), 1.1, 0.05, resolution=list(_SIZE), fov_deg=48)
    extent = 120 if far else 2.4
    light = {"sun": {"elevation_deg": 22, "azimuth_deg": 250, "irradiance": 900},
             "sky": {"type": "clear", "irradiance": 120}}  # fmt: skip
    made = plain(extent, extent / 240, {"base_color": [0.3, 0.24, 0.18], "variation": 0.2}, rig,
                 objects={"rocks": rocks}, light=light)  # fmt: skip
    made["materials"]["rock"] = {"base_color": [0.2, 0.18, 0.16], "variation": 0.45}
    hills = {"amplitude_m": 0.8, "scale_m": 25} if far else {"amplitude_m": 0.05, "scale_m": 1.5}
    made["terrain"]["relief"].append({"type": "multifractal", "octaves": 8} | hills)
    return made


def sheet_cfg(family: str, subdivisions: int) -> dict[str, Any]:
    """Single stones side by side on gray ground under a grazing sun, and one camera."""
    step_m, away_m, up_m = 0.62, 4.0, 1.3
    stone = {
        "type": "rocks", "family": family, "material": "rock", "count": 1, "prototypes": 1,
        "subdivisions": subdivisions, "lod_px": 0, "size_m": 0.5, "embed": 0.12,
        "orientation": "normal",
    }  # fmt: skip
    places = [(i - 0.5 * (_STONES - 1)) * step_m for i in range(_STONES)]
    objects = {f"stone_{i}": stone | {"where": [{"type": "point", "x_m": x, "y_m": 0,
                                                 "max_m": 0.04}]}
               for i, x in enumerate(places)}  # fmt: skip
    fov = 2.0 * math.degrees(math.atan2(0.5 * _STONES * step_m, math.hypot(away_m, up_m)))
    rig = looking((0, -away_m, up_m), away_m, 0.14, resolution=[_STONES * _STONE_PX, _SHEET_PX],
                  fov_deg=fov)  # fmt: skip
    light = {"sun": {"elevation_deg": 20, "azimuth_deg": 225, "irradiance": 900},
             "sky": {"type": "clear", "irradiance": 90}}  # fmt: skip
    made = plain(8, 0.02, {"base_color": [0.2] * 3, "specular": 0}, rig, objects=objects,
                 light=light)  # fmt: skip
    surface = FAMILIES[family]
    maps = {"maps": {"procedural": surface}} if surface else {}
    made["materials"]["rock"] = {"base_color": [0.11, 0.1, 0.09], "variation": 0.45} | maps
    return made


def shot(page: Page, content: dict[str, Any], name: str, spp: int) -> Image.Image:
    """A picture; its stage is left in a scratch folder of that name."""
    out = page.scratch / name
    (frame,) = frames(page.cfg(content), out, seed=4, spp=4 if page.fast else spp, passes=("rgb",))
    return photograph(frame)


def family_part(page: Page, family: str) -> None:
    """Renders a family's contact sheet."""
    content = sheet_cfg(family, 3 if page.fast else 6)
    save(shot(page, content, family, 32), page.picture(family))


def coatings(page: Page) -> None:
    """Renders one family with several coatings."""
    content = sheet_cfg("ventifact", 3 if page.fast else 6)
    for (_, keys, material), stone in zip(COATINGS, content["objects"].values(), strict=True):
        stone["embed"] = 0.2
        if material:
            name = f"coat_{len(content['materials'])}"
            content["materials"][name] = material
            stone["coatings"] = [{"material": name, **keys}]
    content["light"]["sun"]["elevation_deg"] = 35
    save(shot(page, content, "coatings", 32), page.picture("coatings"))
    page.rows([name, f"`{json.dumps(keys)}`" if material else ""]
              for name, keys, material in COATINGS)  # fmt: skip


def levels(page: Page) -> None:
    """Tables errors of the levels, axis ratios, seconds, and what views come to."""
    rows, speed = [], []
    for family in FAMILIES:
        (plan,) = draw(load(page.cfg(cfg(family, False, 0.5, 4))), 4, 0).objects
        chains = build_chains(plan.source.shapes)
        errors = np.array([[rock.error for rock in chain] for chain in chains]).mean(axis=0)
        extents = np.array([np.ptp(chain[0].points, axis=0) for chain in chains])
        ratios = (extents / extents.max(axis=1)[:, None]).mean(axis=0)
        rows.append([family, *(f"{100 * e:.1f}" for e in errors[1:]),
                     f"{ratios[1]:.2f}", f"{ratios[2]:.2f}"])  # fmt: skip
        speed.append(f"{family} {page.timed(partial(build_chains, plan.source.shapes)):.2f}")
    page.rows(rows)
    page.value("speed", ", ".join(speed))
    tiles, told = [], []
    views = (("near", False, 0.5), ("near, coarse", False, 10.0), ("far", True, 0.5))
    for name, far, lod_px in views:
        content = cfg("angular", far, lod_px, 3 if page.fast else 5)
        tiles.append(("", shot(page, content, name, 48)))
        report = (page.scratch / name / "batch_0000" / "report.json").read_text()
        facts = json.loads(report)["objects"]["rocks"]
        told.append([
            name, f"{facts['count']:,}", f"{facts['triangles_finest']:,}",
            f"{facts['triangles']:,}", f"{lod_px:g}", f"{facts['lod_error_max_px']:.2f}",
        ])  # fmt: skip
    save(sheet([tiles], _SIZE[0]), page.picture("levels"))
    page.rows(told)


def main(page: Page) -> None:
    """Refreshes the page and its pictures."""
    parts = [*(partial(family_part, family=family) for family in FAMILIES), coatings, levels]
    page.refresh(("scenec", "numpy", "numba", "mitsuba"), parts)


if __name__ == "__main__":
    run(main, page="rocks")
