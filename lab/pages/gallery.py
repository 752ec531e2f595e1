"""Renders the pictures of docs/gallery.md, views of the cfgs of configs/, and the README's.

    python lab/pages/gallery.py [--only CFG] [--spp 64] [--keep FOLDER] [-o FOLDER] [--fast]

Photographs are 1280 × 720, as Mitsuba draws them and Open Image Denoise leaves them; the first of
each cfg has one of its label levels below it. The README's are a row of these, and the contact
sheet of jacksboro's samples, as ``make demo`` makes it with fewer samples per pixel. Needs the
extras "mitsuba", "denoise" and "demo"; takes some quarter of an hour on two cores. With --keep,
compiled stages and frames stay in FOLDER, and frames that are there are not made again.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from scenec.compiler.cfg.load import load
from scenec.datasets.colors import label_colors
from scenec.datasets.sheet import write_sheet
from scenec.lab.pictures import INK, PAPER, frames, labels, photograph, save
from scenec.lab.runner import CONFIGS, Page, names, run
from scenec.schemas.frames import Frame

#: The cfg of the README's picture, and how many of its samples that shows.
FIRST, ROWS = "jacksboro", 4
WIDTH, HEIGHT = 1280, 720
_LABELS, _LEGEND = (640, 360), 26
#: What the README shows first, and the size of each.
WORLDS, _TILE = ("landing_site", "lunar_mare", "volcanic_desert", "meadow_edge"), (400, 225)


@dataclass(frozen=True)
class Entry:
    """Views of a cfg; docs/gallery.md shows them.

    Attributes:
        sensor: The camera, as its rig and its name in the cfg.
        samples: What is shown of it as it is.
        level: Which label level.
        weather: What is set for one more view, and of which sample.
        fewer: What the samples a pixel are divided by: among leaves they are dear.
    """

    sensor: str
    samples: tuple[int, ...]
    level: str = "surface"
    weather: tuple[str, int] | None = None
    fewer: int = 1


_OVERCAST = (
    'light.sky={"type": "overcast", "labels": {"class": "sky", "surface": "sky", "part": "other"}}'
)
ENTRIES = {
    "jacksboro": Entry("rover.sensors.front", (0, 2)),
    "mars_yard": Entry("rover.sensors.mast", (2, 0)),
    "landing_site": Entry("rover.sensors.mast", (5, 1)),
    "lunar_mare": Entry("rover.sensors.mast", (2, 0)),
    "south_pole": Entry("rover.sensors.left", (2, 1)),
    "mars_delta": Entry("rover.sensors.mast", (3, 0)),
    "volcanic_desert": Entry(
        "rover.sensors.mast", (1, 3), weather=('light.clouds={"cumulus": {}}', 1)
    ),
    "meadow_edge": Entry("rover.sensors.mast", (0, 2)),
    "forest_edge": Entry("walker.sensors.front", (0, 2), weather=(_OVERCAST, 0), fewer=8),
}


def views(page: Page, name: str, folder: Path, spp: int) -> None:
    """Compiles and renders a cfg's views, and writes their pictures."""
    entry = ENTRIES[name]
    weather = [] if entry.weather is None else [(entry.weather[0], (entry.weather[1],))]
    for setting, samples in [("", entry.samples), *weather]:
        rig, _, sensor = entry.sensor.split(".")
        pair = json.loads((CONFIGS / f"{name}.json").read_text())["rigs"][rig]["sensors"]
        wide = [f"rigs.{rig}.sensors.{own}.resolution=[{WIDTH}, {HEIGHT}]" for own in pair]
        spec = load(CONFIGS / f"{name}.json", [*wide, *([setting] if setting else [])])
        found = frames(
            spec, folder / ("weather" if setting else "views") / name, denoise=True,
            spp=max(spp // entry.fewer, 1), passes=("rgb", "label"), samples=samples, replace=True,
            cameras=[f"{rig}_{sensor}"],
        )  # fmt: skip
        by_sample = {frame.sidecar.sample: frame for frame in found}
        for sample in samples:
            file = f"{name}_{sample}" + ("_weather" if setting else "")
            save(photograph(by_sample[sample]), page.picture(file).with_suffix(".jpg"))
        if not setting:
            painted = with_names(by_sample[samples[0]], entry.level)
            save(painted, page.picture(f"{name}_labels"))


def with_names(frame: Frame, level: str) -> Image.Image:
    """Labels of a level in colors, and below them their names, in as many rows as they take."""
    ids = frame.passes[f"label.{level}"]
    of = {int(i): name for i, name in frame.sidecar.labels[level].items()}
    colors, font = label_colors(list(of)), ImageFont.load_default(14)
    width, height = _LABELS
    places, x, y = [], 0, height
    for number, name in sorted(of.items()):
        if np.any(ids == number):
            wide = 22 + round(font.getlength(name))
            if x + wide > width:
                x, y = 0, y + _LEGEND
            places.append((x, y, number, name))
            x += wide + 12
    sheet = Image.new("RGB", (width, y + _LEGEND), PAPER)
    # Ids must not be blended.
    sheet.paste(labels(frame, level).resize(_LABELS, Image.Resampling.NEAREST), (0, 0))
    draw = ImageDraw.Draw(sheet)
    for x, y, number, name in places:
        draw.text((x + 22, y + 6), name, INK, font)
        draw.rectangle((x, y + 8, x + 16, y + 21), colors[number])
    return sheet


def worlds(folder: Path) -> Image.Image:
    """Some of the pictures beside each other, their labels below."""
    width, height = _TILE
    sheet = Image.new("RGB", (len(WORLDS) * width, 2 * height), PAPER)
    for column, name in enumerate(WORLDS):
        with Image.open(folder / f"gallery_{name}_{ENTRIES[name].samples[0]}.jpg") as picture:
            tile = picture.resize(_TILE, Image.Resampling.LANCZOS)
            sheet.paste(tile, (column * width, 0))
        with Image.open(folder / f"gallery_{name}_labels.png") as painted:
            tile = painted.convert("RGB").crop((0, 0, *_LABELS))
            tile = tile.resize(_TILE, Image.Resampling.NEAREST)
            sheet.paste(tile, (column * width, height))
    return sheet


def main(page: Page) -> None:
    """Renders the pictures."""
    options, spp = page.options, 2 if page.fast else page.options.spp
    folder = options.keep or page.scratch
    for name in options.only or ENTRIES:
        print(f"{name}: compiling and rendering", flush=True)
        views(page, name, folder, spp)
    if not options.only or FIRST in options.only:
        print(f"{FIRST}: rendering its first {ROWS} samples", flush=True)
        out = folder / FIRST
        frames(CONFIGS / f"{FIRST}.json", out, spp=spp, samples=range(ROWS), replace=True)
        path = write_sheet(out, page.scratch / "sheet.png", count=ROWS).path
        with Image.open(path) as sheet:
            save(sheet.convert("RGB"), page.folder / "pictures" / f"{FIRST}.png")
    if not options.only:
        save(worlds(page.folder / "pictures"), page.folder / "pictures" / "worlds.jpg")
    page.refresh((), ())


if __name__ == "__main__":
    run(main, page="gallery", only=names, spp=64, keep=Path)
