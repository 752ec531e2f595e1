"""Renders the pictures of docs/gallery.md, views of the cfgs of configs/, and the README's.

    python lab/pages/gallery.py [--only CFG] [--spp 64] [--keep FOLDER] [-o FOLDER] [--fast]

Photographs are 1280 × 720, as Mitsuba draws them and Open Image Denoise leaves them; the first of
each cfg has one of its label levels below it. The README's picture is the contact sheet of
jacksboro's samples, as ``make demo`` makes it with fewer samples per pixel. Needs the extras
"mitsuba", "denoise" and "demo"; takes some quarter of an hour on two cores. With --keep, compiled
stages and frames stay in FOLDER, and frames that are there are not made again.
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
    """Labels of a level in colors, and below them their names."""
    ids = frame.passes[f"label.{level}"]
    of = {int(i): name for i, name in frame.sidecar.labels[level].items()}
    colors = label_colors(list(of))
    width, height = _LABELS
    sheet = Image.new("RGB", (width, height + _LEGEND), PAPER)
    # Ids must not be blended.
    sheet.paste(labels(frame, level).resize(_LABELS, Image.Resampling.NEAREST), (0, 0))
    draw, font, x = ImageDraw.Draw(sheet), ImageFont.load_default(14), width
    for number, name in reversed([(i, n) for i, n in sorted(of.items()) if np.any(ids == i)]):
        x -= round(draw.textlength(name, font))
        draw.text((x, height + 6), name, INK, font)
        draw.rectangle((x - 22, height + 8, x - 6, height + 21), colors[number])
        x -= 34
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
    page.refresh((), ())


if __name__ == "__main__":
    run(main, page="gallery", only=names, spp=64, keep=Path)
