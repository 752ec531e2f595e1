"""Renders pictures of docs/gallery.md, counterparts of the OAISYS paper's figures 1, 4 and 5.

    python lab/pages/figures.py [--only NAME] [--spp 16] [--keep FOLDER] [-o FOLDER] [--fast]

Needs the extra "cycles" (tracks: "pyrender"); takes minutes on two cores. With --keep, cfgs, stages
and frames stay in FOLDER, and frames that are there are not made again.
"""

from __future__ import annotations

import copy
import json
import sys
from pathlib import Path
from typing import Any

from PIL import Image

import scenec
from scenec.compiler.cfg.load import load
from scenec.compiler.kinds.table import CHOICES
from scenec.datasets.colors import paint_instances
from scenec.lab.benchmarks.cfgs import looking, plain
from scenec.lab.pictures import Tile, frames, labels, photograph, save, sheet
from scenec.lab.runner import CONFIGS, Page, names, run
from scenec.schemas.frames import Frame

#: Of a tile, pixels.
_WIDTH = 320


def _frame(page: Page, name: str, cfg: Any, **passes: Any) -> Frame:
    folder = page.options.keep or page.scratch
    folder.mkdir(parents=True, exist_ok=True)
    if isinstance(cfg, dict):
        cfg = _written(folder / f"{name}.json", cfg)
    spp = 2 if page.fast else page.options.spp
    return frames(cfg, folder / name, "cycles", spp=spp, samples=[0], **passes)[0]


def _written(path: Path, cfg: dict[str, Any]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(cfg, indent=1), encoding="utf-8")
    return path


def passes(page: Page) -> list[list[Tile]]:
    """Figures 1 and 5: RGB, two label levels, instances."""
    small = f"rigs.rover.sensors.front.resolution=[{_WIDTH}, 240]"
    spec = load(CONFIGS / "jacksboro.json", [small])
    found = _frame(page, "jacksboro", spec, passes=("rgb", "label", "instance"))
    tiles = [("jacksboro: RGB", photograph(found))]
    tiles += [(f"labels: {level}", labels(found, level)) for level in ("class", "surface")]
    painted = Image.fromarray(paint_instances(found.passes["instance"]))
    return [[*tiles, ("instances", painted)]]


def merging(page: Page) -> list[list[Tile]]:
    """Figure 4: a level square of 6 m from above; two textures merged step by step."""

    def texture(kind: str, color: tuple[float, ...]) -> dict[str, Any]:
        maps = {"procedural": {"type": kind, "resolution": 512}}
        return {"base_color": list(color), "specular": 0, "maps": maps}

    look = {"type": "direction", "bearing_deg": 0, "pitch_deg": -90}
    pose = {"type": "random", "region_m": [[-0.001, -0.001], [0.001, 0.001]], "height_m": 6}
    sensors = {"eye": {"resolution": [320, 240], "fov_deg": 50}}
    sand, gravel = texture("sand", (0.46, 0.31, 0.19)), texture("gravel", (0.2, 0.19, 0.18))
    black, white = ({"base_color": [v] * 3, "specular": 0} for v in (0.0, 0.8))
    second = {"material": "above", "labels": {"ground": "gravel"}, "sharpness": 2.5,
              "noise": {"scale_m": 2.2, "octaves": 3}, "threshold": 0.5}  # fmt: skip
    usual = plain(
        8, 0.05, sand, {"pose": pose | {"look": look}, "sensors": sensors},
        labels={"ground": {"sky": 1, "sand": 2}}, outputs=["rgb", "label"],
        light={"sun": {"elevation_deg": 50, "azimuth_deg": 315},
               "sky": {"type": "clear", "labels": {"ground": "sky"}}},
    )  # fmt: skip
    usual["terrain"]["ground"][0]["labels"] = {"ground": "sand"}
    tiles: list[Tile] = []
    for number, (name, below, above) in enumerate((
        ("texture 1: sand", sand, None), ("texture 2: gravel", gravel, None),
        ("merging noise", black, white), ("merged", sand, gravel),
    )):  # fmt: skip
        cfg = copy.deepcopy(usual)
        cfg["materials"] = {"ground": below} | ({"above": above} if above else {})
        if above:
            cfg["terrain"]["ground"].append(second)
            cfg["labels"]["ground"]["gravel"] = 3
        found = _frame(page, f"merging_{number}", cfg)
        tiles.append((name, photograph(found)))
    return [[*tiles, ("labels", labels(found, "ground"))]]


#: Mean colors of the kinds of surfaces; others are gray.
_COLORS = {
    "sand": (0.42, 0.31, 0.19), "mud_cracks": (0.24, 0.18, 0.12), "soil": (0.11, 0.08, 0.055),
    "turf": (0.08, 0.09, 0.03), "pavement": (0.28, 0.16, 0.09), "sandstone": (0.32, 0.2, 0.12),
    "basalt": (0.09, 0.085, 0.08), "regolith": (0.12, 0.11, 0.1), "gravel": (0.25, 0.235, 0.205),
}  # fmt: skip


def grounds(page: Page) -> list[list[Tile]]:
    """A level ground of each kind of surface, under a low sun."""
    tiles = []
    light = {"sun": {"elevation_deg": 22, "azimuth_deg": 300}, "sky": {"type": "atmosphere"}}
    rig = looking((0, -1, 1.1), 1.2, bearing_deg=90, resolution=[_WIDTH, 240], fov_deg=60)
    for kind in sorted(CHOICES["surface"].kinds):
        color = list(_COLORS.get(kind, (0.25, 0.24, 0.22)))
        maps = {"procedural": {"type": kind}, "cells": {}}
        material = {"base_color": color, "specular": 0, "maps": maps}
        found = _frame(page, f"ground_{kind}", plain(24, 0.25, material, rig, light=light))
        tiles.append((kind, photograph(found)))
    return [tiles[i : i + 4] for i in range(0, len(tiles), 4)]


def tracks(page: Page) -> list[list[Tile]]:
    """Points on boulders and ground, followed from a camera that goes around them."""
    stone, sand = (
        {"base_color": color, "specular": 0, "maps": {"procedural": {"type": kind}}}
        for kind, color in (("basalt", [0.2, 0.19, 0.18]), ("sand", [0.42, 0.31, 0.19]))
    )
    rig = {
        "pose": {"type": "orbit", "center": {"type": "point", "x_m": 0, "y_m": 0}, "radius_m": 5,
                 "height_m": 1.5, "period_s": 24, "sampling": {"rate_hz": 4}},
        "sensors": {"eye": {"resolution": [480, 360], "fov_deg": 55}},
    }  # fmt: skip
    cfg = plain(30, 0.1, sand, rig, light={"sun": {"elevation_deg": 38}, "sky": {"type": "clear"}})
    cfg |= {"samples": 5 if page.fast else 17, "materials": {"ground": sand, "stone": stone}}
    size = {"type": "log_uniform", "min": 0.4, "max": 1.6}
    cfg["objects"] = {"rocks": {"type": "rocks", "count": 160, "material": "stone", "size_m": size,
                                "prototypes": 6, "apart": {"gap_m": 0.1}}}  # fmt: skip
    out = (page.options.keep or page.scratch) / "tracks"
    frames(_written(out.with_suffix(".json"), cfg), out, "pyrender", spp=2 if page.fast else 16)
    scenec.export(out, "tapvid", settings=["points=60", "queries=first"], replace=True)
    with Image.open(out / "datasets/tapvid/batch_0000/camera_eye.png") as found:
        wide = found.width // 3
        shown = [found.crop((k * wide, 0, (k + 1) * wide, found.height)) for k in range(3)]
    times = (0, cfg["samples"] // 2 / 4, (cfg["samples"] - 1) / 4)
    return [[(f"{at:g} s", tile) for at, tile in zip(times, shown, strict=True)]]


def main(page: Page) -> None:
    """Renders the pictures that were chosen."""
    for part in (passes, merging, grounds, tracks):
        if not page.options.only or part.__name__ in page.options.only:
            print(f"{part.__name__}: compiling and rendering", file=sys.stderr, flush=True)
            save(sheet(part(page), _WIDTH), page.picture(part.__name__))
    page.refresh((), ())


if __name__ == "__main__":
    run(main, page="gallery", only=names, spp=16, keep=Path)
