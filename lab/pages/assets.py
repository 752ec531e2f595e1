"""Makes what docs/assets.md shows: the models that come with scenec, drawn by Mitsuba, and a scene.

    python lab/pages/assets.py [--only farmyard,trees] [--spp 24] [--fast] [-o FOLDER]

Needs the extras "mitsuba" and "denoise"; takes some minutes on two cores. With --only, other
pictures stay as they are.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont

from scenec.compiler.assets.library import Asset, shipped, snippet
from scenec.lab.benchmarks.cfgs import looking, plain
from scenec.lab.pictures import INK, PAPER, frames, labels, photograph, save
from scenec.lab.runner import Page, names, run

GROUPS = {
    "Trees and shrubs": ("tree", "shrub"),
    "Herbs, litter, dead wood": ("grass", "flower", "fern", "litter", "dead_wood"),
    "Stones": ("stone", "wall"),
    "Farm": ("fence", "bale", "building", "bench", "tractor"),
    "Street and site": ("sign", "pole", "cone", "drum", "pallet", "car"),
    "People, probes, targets": ("person", "rover", "lander", "target"),
}
YARD_TITLE = "A farmyard"
#: Of the scene: name, then x, y, turn about z of each copy.
YARD: dict[str, list[tuple[float, float, float]]] = json.loads(
    Path(__file__).with_name("yard.json").read_text(encoding="utf-8")
)
_GRASS = ("grass_short", "grass_tall", "grass_dry", "daisy")
_TILE, _COLUMNS, _FOV_DEG, _SPACING_M = (236, 216), 4, 30.0, 60.0
#: Turns about z that show more than 30 degrees do.
_YAW = {
    "sphere_gray": 0, "sphere_mirror": 0, "apriltag_board": 18, "calibration_board": 18,
    "sign_stop": 14, "sign_give_way": -14, "sign_speed_limit": 14, "street_lamp": 60, "car": 38,
    "hay_bale": 40,
}  # fmt: skip
_SOIL = {"base_color": [0.27, 0.24, 0.19], "variation": 0.15}
_LIGHT: dict[str, Any] = {
    "sun": {"elevation_deg": 40, "azimuth_deg": 220, "irradiance": 900},
    "sky": {"type": "clear", "irradiance": 190},
}


def _placed(name: str, poses: list[tuple[float, float, float]]) -> dict[str, Any]:
    return {
        "type": "placed",
        "models": [{"file": f"package:assets/models/{name}.glb"}],
        "poses": [{"x_m": x, "y_m": y, "rotation_deg": [0, 0, turn]} for x, y, turn in poses],
    }


def tiles(page: Page, title: str, assets: list[Asset], spp: int) -> dict[str, Image.Image]:
    """A picture of each model, with a bar of known length."""
    wide = _SPACING_M * len(assets)
    objects: dict[str, Any] = {}
    rigs: dict[str, Any] = {}
    meters: dict[str, float] = {}
    half = math.tan(math.radians(0.5 * _FOV_DEG))
    for number, asset in enumerate(assets):
        x = _SPACING_M * (number + 0.5) - 0.5 * wide
        yaw = _YAW.get(asset.name, 30)
        objects[asset.name] = _placed(asset.name, [(x, 0, yaw)])
        a, (width, depth, height) = math.radians(yaw), asset.size_m
        across = width * abs(math.cos(a)) + depth * abs(math.sin(a))
        ratio = _TILE[1] / _TILE[0]
        distance = 0.53 * max(across, 1.06 * height / ratio) / half
        distance += 0.35 * (width * abs(math.sin(a)) + depth * abs(math.cos(a)))
        rise = math.radians(9.0 if height > 1.2 else 17.0)
        away, up = distance * math.cos(rise), 0.47 * height + distance * math.sin(rise)
        rigs[asset.name] = looking(
            (x, -away, up), away, 0.47 * height, resolution=list(_TILE), fov_deg=_FOV_DEG
        )
        meters[asset.name] = _TILE[0] / (2.0 * half * distance)
    cfg = plain(1, 1, _SOIL, {}, objects=objects, light=_LIGHT, rigs=rigs)
    cfg["terrain"]["size_m"] = [wide + 240.0, 240.0]
    shown = {}
    for frame in frames(
        page.cfg(cfg), page.scratch / title, spp=spp, passes=("rgb",), denoise=True
    ):
        name = frame.sidecar.camera.removesuffix("_eye")
        shown[name] = _captioned(photograph(frame), name, meters[name])
    return shown


def _captioned(picture: Image.Image, name: str, pixels_a_meter: float) -> Image.Image:
    tile = Image.new("RGB", (_TILE[0], _TILE[1] + 24), PAPER)
    tile.paste(picture, (0, 0))
    draw, font = ImageDraw.Draw(tile), ImageFont.load_default(13)
    draw.text((2, _TILE[1] + 4), name, INK, font)
    lengths = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
    length = max(m for m in lengths if m * pixels_a_meter < 0.3 * _TILE[0])
    text, right = f"{length:g} m", _TILE[0] - 4
    left = right - round(length * pixels_a_meter)
    draw.line((left, _TILE[1] + 12, right, _TILE[1] + 12), INK, 3)
    draw.text((left - draw.textlength(text, font) - 6, _TILE[1] + 4), text, INK, font)
    return tile


def contact_sheet(page: Page, title: str, chosen: list[Asset], spp: int) -> None:
    """Renders the models of a group into one picture."""
    shown = tiles(page, title, chosen, spp)
    wide, high = _TILE[0] + 8, _TILE[1] + 30
    rows = -(-len(chosen) // _COLUMNS)
    sheet = Image.new("RGB", (_COLUMNS * wide - 8, rows * high), PAPER)
    for number, asset in enumerate(chosen):
        row, column = divmod(number, _COLUMNS)
        sheet.paste(shown[asset.name], (column * wide, row * high))
    save(sheet, page.picture(_slug(title)).with_suffix(".jpg"))


def _slug(title: str) -> str:
    """Returns the name of a picture for ``--only``: the first long word of its title."""
    return next(word for word in title.lower().replace(",", "").split() if len(word) > 1)


def yard(page: Page, assets: dict[str, Asset], spp: int) -> None:
    """Renders one scene of many of them, and its labels."""
    ids: dict[str, dict[str, int]] = {"class": {"sky": 1, "ground": 2}}
    objects: dict[str, Any] = {}
    for name in (*YARD, *_GRASS):
        lines = snippet(assets[name], assets)
        ids["class"] |= lines["labels"]["class"]
        entry = lines["objects"][name]
        del entry["parts"]
        if name in YARD:
            for key in ("count", "embed"):
                entry.pop(key, None)
            entry |= _placed(name, YARD[name])
        else:
            entry |= {"count": 300 if name == "daisy" else 5000, "clearance_m": 0.5}
            entry["density"] = {"type": "noise", "scale_m": 6, "contrast": 1.5}
            entry["where"] = [
                {"type": "object", "of": of, "min_m": 0.05}
                for of in ("shed", "tractor", "car", "hay_bale", "pallet", "bench")
            ]
        objects[name] = entry
    rig = looking((0.3, -15.0, 2.6), 15.0, 1.2, resolution=[880, 495], fov_deg=62)
    light = _LIGHT | {"sky": _LIGHT["sky"] | {"labels": {"class": "sky"}}}
    cfg = plain(70, 0.5, _SOIL, rig, objects=objects, light=light, labels=ids,
                outputs=["rgb", "label"])  # fmt: skip
    first = {"material": "ground", "labels": {"class": "ground"}}
    cfg["terrain"]["ground"] = [first, first | {"material": "turf", "noise": {"scale_m": 7}}]
    cfg["materials"]["turf"] = {"base_color": [0.11, 0.13, 0.045], "variation": 0.3}
    frame = frames(page.cfg(cfg), page.scratch / "yard", spp=spp, passes=("rgb", "label"),
                   denoise=True)[0]  # fmt: skip
    small = labels(frame, "class").resize((440, 248), Image.Resampling.NEAREST)
    save(small, page.picture("yard_labels"))
    save(photograph(frame), page.picture(_slug(YARD_TITLE)).with_suffix(".jpg"))


def main(page: Page) -> None:
    """Renders the pictures and refreshes the page."""
    assets, only = shipped(), page.options.only
    spp = 2 if page.fast else page.options.spp
    if not only or _slug(YARD_TITLE) in only:
        yard(page, assets, spp)
    # That of textures is written by hand.
    page.rows(None)
    for title, of in GROUPS.items():
        chosen = [a for label in of for a in assets.values() if a.label == label]
        page.rows([
            f"`{a.name}`", re.split("[:;] ", a.about)[0], "×".join(f"{v:.2f}" for v in a.size_m),
            f"{a.triangles:,}",
        ] for a in chosen)  # fmt: skip
        if not only or _slug(title) in only:
            contact_sheet(page, title, chosen, spp)
    page.value("count", str(len(assets)))
    page.value("megabytes", f"{sum(a.bytes for a in assets.values()) / 1e6:.1f} MB")
    page.refresh((), ())


if __name__ == "__main__":
    run(main, page="assets", only=names, spp=24)
