"""Writes docs/assets.md: the models that come with scenec, each as Mitsuba draws it, and a scene.

    python lab/pages/assets.py [--only farmyard,trees] [--spp 24] [--fast] [-o FOLDER]

Needs the extras "mitsuba" and "denoise"; takes some minutes on two cores. With --only, other
pictures stay as they are.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont

from scenec.backends.run.render import render
from scenec.compiler.assets.library import Asset, shipped, snippet
from scenec.datasets.colors import label_colors, paint_labels
from scenec.lab.runner import Page, names, run, table
from scenec.schemas.frames import read_frame
from scenec.schemas.picture import develop

HEAD = """# Assets: models that come with scenec

Plants, stones, things of farm and street, vehicles, a person, targets for calibration: {count}
models, {megabytes:.1f} MB, for objects from files ([objects.md](objects.md)). They are scenec's
own, made by `lab/models/make.py` from numbers alone, and given away under CC0 1.0. Sizes are
real, in meters; the origin is on the ground; what has a front looks to −y. Each part has a
name and a material.

    scenec assets              list them
    scenec assets car          parts, materials, and the lines for a cfg
    scenec assets --json       for scripts

In a cfg a model is `"package:assets/models/NAME.glb"`:

    "objects": {{
      "cars": {{
        "type": "placed",
        "models": [ {{ "file": "package:assets/models/car.glb" }} ],
        "labels": {{ "class": "car" }},
        "parts": {{ "windows": {{ "labels": {{ "class": "glass" }} }} }},
        "poses": [ {{ "x_m": 4, "y_m": 2, "rotation_deg": [0, 0, 30] }} ]
      }}
    }}

What a file holds, where its colors come from, and how the boards are laid out:
[assets/models/README.md](../assets/models/README.md). Below, each bar is as long as it says, at the
object's distance. (Mitsuba, {spp} samples a pixel, denoised.)
"""

GROUPS = {
    "Trees and shrubs": ("tree", "shrub"),
    "Herbs, litter, dead wood": ("grass", "flower", "fern", "litter", "dead_wood"),
    "Stones": ("stone", "wall"),
    "Farm": ("fence", "bale", "building", "bench", "tractor"),
    "Street and site": ("sign", "pole", "cone", "drum", "pallet", "car"),
    "People, probes, targets": ("person", "rover", "lander", "target"),
}
_TILE, _COLUMNS, _FOV_DEG, _SPACING_M = (236, 216), 4, 30.0, 60.0
_INK, _PAPER = (34, 34, 34), (255, 255, 255)
#: Turns about z that show more than 30 degrees do.
_YAW = {
    "sphere_gray": 0, "sphere_mirror": 0, "apriltag_board": 18, "calibration_board": 18,
    "sign_stop": 14, "sign_give_way": -14, "sign_speed_limit": 14, "street_lamp": 60, "car": 38,
    "hay_bale": 40,
}  # fmt: skip


def _base(
    objects: dict[str, Any], rigs: dict[str, Any], extent: tuple[float, float]
) -> dict[str, Any]:
    """A cfg of a plain under a clear sky."""
    return {
        "version": 1,
        "name": "assets",
        "samples": 1,
        "labels": {},
        "outputs": ["rgb"],
        "terrain": {
            "size_m": list(extent),
            "spacing_m": 1,
            "relief": [{"type": "plane"}],
            "ground": [{"material": "soil"}],
        },
        "materials": {"soil": {"base_color": [0.27, 0.24, 0.19], "variation": 0.15}},
        "objects": objects,
        "light": {
            "sun": {"elevation_deg": 40, "azimuth_deg": 220, "irradiance": 900},
            "sky": {"type": "clear", "irradiance": 190},
        },
        "rigs": rigs,
    }


def _rig(
    x: float, y: float, height: float, distance: float, target: float, **sensor: Any
) -> dict[str, Any]:
    return {
        "pose": {
            "type": "random_target",
            "position": {"x_m": x, "y_m": y, "height_m": height},
            "target": {"distance_m": distance, "bearing_deg": 0, "height_m": target},
        },
        "sensors": {"eye": sensor},
    }


def tiles(page: Page, assets: dict[str, Asset], spp: int) -> dict[str, Image.Image]:
    """A picture of each model, with a bar of known length."""
    wide = _SPACING_M * len(assets)
    objects: dict[str, Any] = {}
    rigs: dict[str, Any] = {}
    meters: dict[str, float] = {}
    half = math.tan(math.radians(0.5 * _FOV_DEG))
    for number, asset in enumerate(assets.values()):
        x = _SPACING_M * (number + 0.5) - 0.5 * wide
        yaw = _YAW.get(asset.name, 30)
        objects[asset.name] = {
            "type": "placed",
            "models": [{"file": f"package:assets/models/{asset.name}.glb"}],
            "poses": [{"x_m": x, "y_m": 0, "rotation_deg": [0, 0, yaw]}],
        }
        a, (width, depth, height) = math.radians(yaw), asset.size_m
        across = width * abs(math.cos(a)) + depth * abs(math.sin(a))
        ratio = _TILE[1] / _TILE[0]
        distance = 0.53 * max(across, 1.06 * height / ratio) / half
        distance += 0.35 * (width * abs(math.sin(a)) + depth * abs(math.cos(a)))
        rise = math.radians(9.0 if height > 1.2 else 17.0)
        rigs[asset.name] = _rig(
            x, -distance * math.cos(rise), 0.47 * height + distance * math.sin(rise),
            distance * math.cos(rise), 0.47 * height, resolution=list(_TILE), fov_deg=_FOV_DEG,
        )  # fmt: skip
        meters[asset.name] = _TILE[0] / (2.0 * half * distance)
    batch = page.batch(_base(objects, rigs, (wide + 240.0, 240.0)))
    report = render(batch.parent, "mitsuba", spp=spp, passes=("rgb",), denoise=True)
    shown = {}
    for path in report.frames:
        name = path.parent.name.removesuffix("_eye")
        frame = read_frame(path)
        picture = Image.fromarray(develop(frame.passes["rgb"], frame.sidecar.exposure_ev))
        shown[name] = _captioned(picture, name, meters[name])
    return shown


def _captioned(picture: Image.Image, name: str, pixels_a_meter: float) -> Image.Image:
    tile = Image.new("RGB", (_TILE[0], _TILE[1] + 24), _PAPER)
    tile.paste(picture, (0, 0))
    draw, font = ImageDraw.Draw(tile), ImageFont.load_default(13)
    draw.text((2, _TILE[1] + 4), name, _INK, font)
    fitting = [
        m for m in (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0) if m * pixels_a_meter < 0.3 * _TILE[0]
    ]
    length = fitting[-1]
    text = f"{length:g} m"
    right = _TILE[0] - 4
    left = right - round(length * pixels_a_meter)
    draw.line((left, _TILE[1] + 12, right, _TILE[1] + 12), _INK, 3)
    draw.text((left - draw.textlength(text, font) - 6, _TILE[1] + 4), text, _INK, font)
    return tile


def group(page: Page, title: str, chosen: list[Asset]) -> str:
    """The table of a group, below its contact sheet."""
    header = ["name", "what it is", "x × y × z, m", "triangles", "label", "parts"]
    lines = [
        [
            f"`{a.name}`", a.about, " × ".join(f"{v:.2f}" for v in a.size_m), f"{a.triangles:,}",
            a.label, ", ".join(a.parts),
        ]
        for a in chosen
    ]  # fmt: skip
    return f"## {title}\n\n{_shown(page, title)}\n\n{table(header, lines)}"


def contact_sheet(page: Page, title: str, chosen: list[Asset], spp: int) -> None:
    """Renders the models of a group into one picture."""
    shown = tiles(page, {asset.name: asset for asset in chosen}, spp)
    wide, high = _TILE[0] + 8, _TILE[1] + 30
    rows = -(-len(chosen) // _COLUMNS)
    sheet = Image.new("RGB", (_COLUMNS * wide - 8, rows * high), _PAPER)
    for number, asset in enumerate(chosen):
        row, column = divmod(number, _COLUMNS)
        sheet.paste(shown[asset.name], (column * wide, row * high))
    _save(page, sheet, title)


def _slug(title: str) -> str:
    """What ``--only`` calls a picture: the first long word of its title."""
    return next(word for word in title.lower().replace(",", "").split() if len(word) > 1)


def _file(page: Page, title: str) -> Path:
    return page.picture(_slug(title)).with_suffix(".jpg")


def _shown(page: Page, title: str) -> str:
    return f"![{title}](pictures/{_file(page, title).name})"


def _save(page: Page, picture: Image.Image, title: str) -> None:
    picture.save(_file(page, title), quality=84, optimize=True)


YARD_TITLE = "A farmyard"
#: Of the scene: name, then x, y, turn about z of each copy.
YARD: dict[str, list[tuple[float, float, float]]] = {
    "shed": [(-6.2, 4.0, 22)],
    "tractor": [(-1.6, 2.2, 38)],
    "car": [(5.6, 0.6, -52)],
    "person": [(1.5, -3.4, 20), (-4.1, -0.2, -60)],
    "hay_bale": [(2.6, 6.4, 8), (4.3, 6.2, -12), (6.1, 6.7, 20)],
    "fence_panel": [(-13.5 + 1.8 * k, 9.5, 0) for k in range(7)],
    "gate": [(-0.1, 9.5, 0)],
    "boulder_wall": [(3.2 + 3.0 * k, 9.5, 0) for k in range(4)],
    "bench": [(-8.8, 0.6, 40)],
    "oil_drum": [(-3.9, 3.6, 0), (-3.3, 4.0, 40)],
    "pallet": [(-8.0, -2.6, 15)],
    "traffic_cone": [(3.2, -1.6, 5), (4.2, -2.6, 30), (7.9, -2.4, 60)],
    "sign_stop": [(8.9, 2.6, 8)],
    "street_lamp": [(10.6, 4.6, -40)],
    "delineator": [(9.6, 0.2, 0), (11.6, 5.2, 0)],
    "apriltag_board": [(-5.0, -3.4, -24)],
    "sphere_gray": [(-2.6, -4.6, 0)],
    "sphere_mirror": [(-1.8, -4.4, 0)],
    "stone_weathered": [(0.6, 4.6, 0), (9.2, -2.9, 70)],
    "stone_angular": [(-0.6, -3.0, 40)],
    "oak": [(-10.5, 15.0, 0), (13.0, 20.0, 90)],
    "birch": [(3.6, 15.5, 0)],
    "birch_young": [(6.2, 13.5, 120)],
    "spruce": [(10.0, 17.0, 0), (-3.6, 18.0, 30)],
    "spruce_young": [(12.6, 13.5, 0)],
    "pine": [(-16.5, 18.0, 0), (0.4, 22.0, 200)],
    "snag": [(15.5, 12.5, 0)],
    "hazel": [(-6.6, 11.4, 0)],
    "juniper": [(8.0, 11.6, 0), (12.2, 10.9, 80)],
}
_GRASS = ("grass_short", "grass_tall", "grass_dry", "daisy")


def yard(page: Page, assets: dict[str, Asset], spp: int) -> None:
    """Renders one scene of many of them, and its labels."""
    labels: dict[str, dict[str, int]] = {"class": {"sky": 1, "ground": 2}}
    objects: dict[str, Any] = {}
    for name in (*YARD, *_GRASS):
        lines = snippet(assets[name], assets)
        labels["class"] |= lines["labels"]["class"]
        entry = lines["objects"][name]
        del entry["parts"]
        if name in YARD:
            for key in ("count", "embed"):
                entry.pop(key, None)
            entry |= {"type": "placed"}
            entry["poses"] = [
                {"x_m": x, "y_m": y, "rotation_deg": [0, 0, turn]} for x, y, turn in YARD[name]
            ]
        else:
            entry |= {"count": 300 if name == "daisy" else 5000, "clearance_m": 0.5}
            entry["density"] = {"type": "noise", "scale_m": 6, "contrast": 1.5}
            entry["where"] = [
                {"type": "object", "of": of, "min_m": 0.05}
                for of in ("shed", "tractor", "car", "hay_bale", "pallet", "bench")
            ]
        objects[name] = entry
    rig = _rig(0.3, -15.0, 2.6, 15.0, 1.2, resolution=[880, 495], fov_deg=62)
    cfg = _base(objects, {"camera": rig}, (70.0, 70.0))
    cfg |= {"labels": labels, "outputs": ["rgb", "label"]}
    cfg["terrain"]["spacing_m"] = 0.5
    cfg["terrain"]["ground"] = [
        {"material": "soil", "labels": {"class": "ground"}},
        {"material": "turf", "labels": {"class": "ground"}, "noise": {"scale_m": 7}},
    ]
    cfg["materials"]["turf"] = {"base_color": [0.11, 0.13, 0.045], "variation": 0.3}
    cfg["light"]["sky"]["labels"] = {"class": "sky"}
    batch = page.batch(cfg)
    report = render(batch.parent, "mitsuba", spp=spp, passes=("rgb", "label"), denoise=True)
    frame = read_frame(report.frames[0])
    picture = Image.fromarray(develop(frame.passes["rgb"], frame.sidecar.exposure_ev))
    numbers = frame.passes["label.class"]
    painted = Image.fromarray(paint_labels(numbers, label_colors(sorted(labels["class"].values()))))
    small = painted.resize((440, 248), Image.Resampling.NEAREST).quantize(64)
    small.save(page.picture("yard_labels"), optimize=True)
    _save(page, picture, YARD_TITLE)


def main(page: Page) -> None:
    """Renders the pictures and writes the page."""
    assets, only = shipped(), page.options.only
    spp = 2 if page.fast else page.options.spp
    parts = [
        f"## {YARD_TITLE}\n\n{len(YARD) + len(_GRASS)} of them in one scene, and the labels of its "
        "level `class`. The cfg is in `lab/pages/assets.py`.\n\n"
        f"{_shown(page, YARD_TITLE)}\n\n{page.shown('yard_labels')}"
    ]
    if not only or _slug(YARD_TITLE) in only:
        yard(page, assets, spp)
    for title, labels in GROUPS.items():
        chosen = [a for label in labels for a in assets.values() if a.label == label]
        parts.append(group(page, title, chosen))
        if not only or _slug(title) in only:
            contact_sheet(page, title, chosen, spp)
    megabytes = sum(a.bytes for a in assets.values()) / 1e6
    head = HEAD.format(count=len(assets), megabytes=megabytes, spp=spp)
    note = "<!-- Generated by lab/pages/assets.py. Do not edit. -->\n\n"
    text = "\n".join([note + head, *parts])
    Path(page.folder, "assets.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    run(main, page="assets", only=names, spp=24)
