"""Draws the rocks that docs/objects.md shows: their families and coatings.

    python lab/pages/rocks.py [--fast] [-o FOLDER]

Needs the extra "mitsuba"; takes some minutes on two cores.
"""

from __future__ import annotations

import math
from typing import Any

from PIL import Image

from scenec.lab.benchmarks.cfgs import looking, plain
from scenec.lab.pictures import frames, photograph, save
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


def main(page: Page) -> None:
    """Draws all pictures."""
    for family in FAMILIES:
        family_part(page, family)
    coatings(page)
    page.refresh((), ())


if __name__ == "__main__":
    run(main, page="objects")
