"""Makes counterparts of the OAISYS paper's figures 1, 4, 5 and 6, and writes docs/figures.md.

    python studies/pages/figures.py [--only NAME] [--spp 32] [--keep FOLDER] [-o FOLDER] [--fast]

Needs the extra "cycles" and bpy's HDRIs; takes minutes on two cores. With --keep, cfgs, stages
and frames stay in FOLDER, and frames that are there are not made again.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from gallery import save
from lights import CASES, make_cfg
from PIL import Image, ImageDraw, ImageFont

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.datasets.colors import label_colors, paint_instances, paint_labels
from scenec.schemas.errors import ScenecError
from scenec.schemas.frames import Frame, read_frame
from scenec.schemas.picture import develop
from scenec.studies.runner import ROOT, Page, names, run

SEED = 1
_GAP, _LEGEND, _INK = 6, 22, (34, 34, 34)
#: Of a tile, pixels.
_WIDTH = 320

HEAD = """\
# Figures

Counterparts of figures of the OAISYS paper (IROS 2021), made by `python studies/pages/figures.py`
on {cores} cores ({versions}): Cycles, seed 1. With `--keep FOLDER` the cfgs, stages and frames
stay in FOLDER.
"""

Tile = tuple[str, np.ndarray]


def frame(page: Page, name: str, cfg: Path, sample: int = 0, **passes: Any) -> Frame:
    """One sample of a cfg, compiled and rendered.

    Raises:
        ScenecError: It cannot be.
    """
    out = (page.options.keep or page.scratch) / name
    compile_cfg(cfg, seed=SEED, out=out)
    spp = 2 if page.fast else page.options.spp
    report = render(out, "cycles", spp=spp, samples=[sample], **passes)
    if not report.frames:
        raise ScenecError(f"{name}: {'; '.join(report.failed) or 'no frame was made'}")
    return read_frame(report.frames[0])


def photograph(found: Frame, exposure: float | None = None) -> np.ndarray:
    """The picture, by its own exposure or another's."""
    own = float(found.sidecar["exposure_ev"])
    return develop(found.passes["rgb"], own if exposure is None else exposure)


def labels(found: Frame, level: str) -> np.ndarray:
    """The labels of a level, painted."""
    ids = [int(i) for i in found.sidecar["labels"][level]]
    return paint_labels(found.passes[f"label.{level}"], label_colors(ids))


def sheet(rows: Sequence[Sequence[Tile]]) -> Image.Image:
    """Tiles in rows, the name below each."""
    height, width = rows[0][0][1].shape[:2]
    size = (_WIDTH, round(_WIDTH * height / width))
    step = (size[0] + _GAP, size[1] + _LEGEND)
    whole = (max(map(len, rows)) * step[0] - _GAP, len(rows) * step[1])
    made = Image.new("RGB", whole, (255, 255, 255))
    draw, font = ImageDraw.Draw(made), ImageFont.load_default(14)
    for y, row in enumerate(rows):
        for x, (name, pixels) in enumerate(row):
            # Ids must not be blended: what is painted is not filtered.
            how = Image.Resampling.NEAREST if "label" in name or "inst" in name else None
            tile = Image.fromarray(pixels).resize(size, how or Image.Resampling.LANCZOS)
            made.paste(tile, (x * step[0], y * step[1]))
            draw.text((x * step[0] + 2, y * step[1] + size[1] + 3), name, _INK, font)
    return made


def shown(page: Page, name: str, rows: Sequence[Sequence[Tile]], what: str) -> str:
    """Saves a sheet; the Markdown that shows it."""
    save(sheet(rows), page.picture(name))
    return page.shown(name, what)


#: Scenes of the first figure and of the passes: name and sample.
_SCENES = (("jacksboro", 0), ("mars_yard", 2), ("meadow_edge", 0))


def passes(page: Page) -> str:
    """Figures 1 and 5: RGB, two label levels, instances."""
    rows = []
    for name, sample in _SCENES:
        cfg = ROOT / "configs" / f"{name}.json"
        found = frame(page, name, cfg, sample, passes=("rgb", "label", "instance"))
        tiles = [(f"{name}: RGB", photograph(found))]
        tiles += [(f"labels: {level}", labels(found, level)) for level in ("class", "surface")]
        rows.append([*tiles, ("instances", paint_instances(found.passes["instance"]))])
    picture = shown(page, "passes", rows, "RGB, two label levels and instances of three scenes")
    return f"""## Four passes (figures 1 and 5)

RGB, two label levels and instances of cfgs that ship. Every pass but the first is exact, of the ray
through the middle of the pixel.

{picture}"""


def merging_cfgs() -> dict[str, dict[str, Any]]:
    """A level square of 6 m from above: each texture alone, the merging noise, and the merge."""

    def texture(kind: str, color: tuple[float, ...], **keys: Any) -> dict[str, Any]:
        maps = {"procedural": {"type": kind, "resolution": 512, **keys}}
        return {"base_color": list(color), "specular": 0, "maps": maps}

    sand = texture("sand", (0.46, 0.31, 0.19))
    gravel = texture("gravel", (0.2, 0.19, 0.18))
    merge = {"noise": {"scale_m": 2.2, "octaves": 3}, "sharpness": 2.5, "threshold": 0.5}

    def cfg(below: dict[str, Any], above: dict[str, Any] | None) -> dict[str, Any]:
        ground: list[dict[str, Any]] = [{"material": "below", "labels": {"ground": "sand"}}]
        ids, materials = {"sky": 1, "sand": 2}, {"below": below}
        if above is not None:
            ground.append({"material": "above", "labels": {"ground": "gravel"}, **merge})
            ids["gravel"], materials["above"] = 3, above
        return {
            "version": 1,
            "name": "merging",
            "labels": {"ground": ids},
            "outputs": ["rgb", "label"],
            "terrain": {"size_m": [8, 8], "spacing_m": 0.05, "relief": [{"type": "plane"}],
                        "ground": ground},
            "materials": materials,
            "light": {"sun": {"elevation_deg": 50, "azimuth_deg": 315},
                      "sky": {"type": "clear", "labels": {"ground": "sky"}}},
            "rigs": {"above": {
                "pose": {"type": "random", "region_m": [[-0.001, -0.001], [0.001, 0.001]],
                         "height_m": 6,
                         "look": {"type": "direction", "bearing_deg": 0, "pitch_deg": -90}},
                "sensors": {"eye": {"resolution": [320, 240], "fov_deg": 50}},
            }},
        }  # fmt: skip

    black, white = ({"base_color": [v] * 3, "specular": 0} for v in (0.0, 0.8))
    return {
        "texture 1: sand": cfg(sand, None),
        "texture 2: gravel": cfg(gravel, None),
        "merging noise": cfg(black, white),
        "merged": cfg(sand, gravel),
    }


def merging(page: Page) -> str:
    """Figure 4: two textures merged step by step."""
    folder = page.options.keep or page.scratch
    folder.mkdir(parents=True, exist_ok=True)
    tiles: list[Tile] = []
    for number, (name, cfg) in enumerate(merging_cfgs().items()):
        file = folder / f"merging_{number}.json"
        file.write_text(json.dumps(cfg, indent=1), encoding="utf-8")
        found = frame(page, f"merging_{number}", file)
        tiles.append((name, photograph(found)))
    tiles.append(("labels", labels(found, "ground")))
    layer = json.dumps(merging_cfgs()["merged"]["terrain"]["ground"][1])
    picture = shown(page, "merging", [tiles], "two textures, merging noise, merged, labels")
    return f"""## Merging (figure 4)

Two textures, the noise by which they merge, the ground that comes of it, and its labels: colors
merge smoothly by the weight, labels have a sharp border where it crosses one half. The ground is
cut along that line, so each face has one label. The second layer:

    {layer}

{picture}"""


#: The light of each case falls on this scene, seen from here.
_LIT = {"cfg": "jacksboro", "place": (0.0, 0.0, 1.8), "look": (9.0, 20.0, 0.3), "fov_deg": 65.0}


def lights(page: Page) -> str:
    """Figure 6: one scene in six lights."""
    folder = page.options.keep or page.scratch
    (folder / "configs").mkdir(parents=True, exist_ok=True)
    if not (folder / "assets").exists():
        (folder / "assets").symlink_to(ROOT / "assets")
    tiles: list[Tile] = []
    for case in CASES:
        ev = case.ev if abs(case.ev) < 2 else -1.0
        cfg = make_cfg(replace(case, ev=ev, **_LIT), folder / "configs")
        tiles.append((case.title, photograph(frame(page, f"lights_{case.name}", cfg))))
    rows = [tiles[:3], tiles[3:]]
    picture = shown(page, "lights", rows, "one scene in six lights")
    return f"""## Six lights (figure 6)

The ground of `configs/jacksboro.json` in the lights of [six lights](lights.md), which has them in
all three renderers. Each picture is exposed for its own light.

{picture}"""


PARTS: dict[str, Callable[[Page], str]] = {
    "passes": passes,
    "merging": merging,
    "lights": lights,
}


def main(page: Page) -> None:
    """Makes the pictures; writes the page where all were made."""
    chosen = page.options.only or tuple(PARTS)
    if set(chosen) >= set(PARTS):
        page.write(HEAD, ("bpy",), list(PARTS.values()))
        return
    for name in chosen:
        print(f"{name}: compiling and rendering", file=sys.stderr, flush=True)
        PARTS[name](page)


if __name__ == "__main__":
    run(main, page="figures", only=names, spp=32, keep=Path)
