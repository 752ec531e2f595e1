"""Renders the cfgs of configs/ into docs/pictures/, and the README's first picture and its table.

    python studies/pages/gallery.py [--only NAME] [--spp 64] [--keep FOLDER] [-o FOLDER] [--fast]

Each picture shows one frame as Mitsuba draws it, made smaller (64 samples per pixel become 114 per
pixel shown), and one of its label levels beside it. The README's first picture is the contact sheet
of jacksboro's samples, as ``make demo`` makes it with fewer samples per pixel. Needs the extras
"mitsuba" and "demo"; takes some minutes on two cores. With --keep, compiled stages and frames stay
in FOLDER, and frames that are there are not made again.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.datasets.colors import label_colors, paint_labels
from scenec.datasets.sheet import write_sheet
from scenec.schemas.errors import ScenecError
from scenec.schemas.files import atomic
from scenec.schemas.frames import read_frame
from scenec.schemas.picture import develop
from scenec.studies.runner import ROOT, Page, names, run

README = ROOT / "README.md"
#: The cfg of the README's first picture, and how many of its samples that shows.
FIRST, ROWS = "jacksboro", 4
BEGIN, END = "<!-- gallery -->", "<!-- /gallery -->"

SEED = 1
WIDTH = 480
_GAP = 8
_LEGEND = 26
_INK = (34, 34, 34)
#: A color on this part of a picture at least fills areas.
_AREA = 0.002
#: So many of them at most.
_FLAT = 128


@dataclass(frozen=True)
class Entry:
    """One row of the table.

    Attributes:
        name: Of the cfg.
        sample: Which sample is shown.
        level: Which label level.
        about: What the table says of it.
    """

    name: str
    sample: int
    level: str
    about: str


ENTRIES = (
    Entry("jacksboro", 0, "surface", "measured relief, scaled; three grounds mixed by noise"),
    Entry(
        "mars_yard",
        2,
        "surface",
        "layered bedrock, rippled sand, wheel tracks, rocks from pebbles to boulders",
    ),
    Entry(
        "landing_site",
        5,
        "surface",
        "rocks by Golombek and Rapp's law, plates, boulders with skirts of debris; a lander, and a "
        "board that moves",
    ),
    Entry(
        "lunar_mare",
        2,
        "surface",
        "craters in equilibrium and young ones with bright ejecta; Hapke's law, the Earth's light",
    ),
    Entry(
        "volcanic_desert",
        1,
        "surface",
        "an eroded cinder cone at its angle of repose, lava flows, ash, pale dunes in the hollows",
    ),
    Entry(
        "meadow_edge",
        0,
        "surface",
        "23,000 tufts of grass, flowers, shrubs and trees; a track, a plowed field, a dry channel",
    ),
)


def picture(entry: Entry, out: Path, spp: int) -> Image.Image:
    """Compiles, renders and lays out one entry.

    Raises:
        ScenecError: It cannot be compiled, or a frame could not be made.
    """
    compile_cfg(ROOT / "configs" / f"{entry.name}.json", seed=SEED, out=out)
    report = render(out, "mitsuba", spp=spp, passes=("rgb", "label"), samples=[entry.sample])
    if not report.frames:
        raise ScenecError(f"{entry.name}: {'; '.join(report.failed) or 'no frame was made'}")
    frame = read_frame(report.frames[0])
    photograph = develop(frame.passes["rgb"], float(frame.sidecar["exposure_ev"]))
    labels = frame.passes[f"label.{entry.level}"]
    names = {int(i): name for i, name in frame.sidecar["labels"][entry.level].items()}
    colors = label_colors(list(names))
    tile = (WIDTH, round(WIDTH * photograph.shape[0] / photograph.shape[1]))
    sheet = Image.new("RGB", (2 * tile[0] + _GAP, tile[1] + _LEGEND), (255, 255, 255))
    sheet.paste(Image.fromarray(photograph).resize(tile, Image.Resampling.LANCZOS), (0, 0))
    # Ids must not be blended: only the photograph is filtered.
    painted = Image.fromarray(paint_labels(labels, colors))
    sheet.paste(painted.resize(tile, Image.Resampling.NEAREST), (tile[0] + _GAP, 0))
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    shown = [(i, name) for i, name in sorted(names.items()) if np.any(labels == i)]
    x = sheet.width
    for number, name in reversed(shown):
        x -= round(draw.textlength(name, font))
        draw.text((x, tile[1] + 6), name, _INK, font)
        x -= 22
        draw.rectangle((x, tile[1] + 8, x + 16, tile[1] + 21), colors[number])
        x -= 12
    return sheet


def first_picture(out: Path, spp: int) -> Image.Image:
    """The contact sheet of the first samples, in an output folder named after the cfg.

    Raises:
        ScenecError: It cannot be compiled, or a frame could not be made.
    """
    compile_cfg(ROOT / "configs" / f"{FIRST}.json", seed=SEED, out=out)
    report = render(out, "mitsuba", spp=spp, samples=range(ROWS))
    if report.failed:
        raise ScenecError(f"{FIRST}: {'; '.join(report.failed)}")
    with tempfile.TemporaryDirectory() as folder:
        path = write_sheet(out, Path(folder) / "sheet.png", count=ROWS).path
        with Image.open(path) as sheet:
            return sheet.convert("RGB")


def save(sheet: Image.Image, path: Path) -> None:
    """Writes a small PNG: a palette of 256 colors, dithered, or skies would have steps."""
    small = sheet.quantize(palette=_palette(sheet), dither=Image.Dither.FLOYDSTEINBERG)
    with atomic(path) as temporary:
        small.save(temporary, format="PNG", optimize=True)


def _palette(sheet: Image.Image) -> Image.Image:
    """A picture of 256 colors: those that fill areas (paper, labels) exactly, the best others."""
    pixels = np.asarray(sheet).reshape(-1, 3)
    colors, of_pixel, counts = np.unique(pixels, axis=0, return_inverse=True, return_counts=True)
    common = np.argsort(-counts, kind="stable")[:_FLAT]
    flat = common[counts[common] >= _AREA * len(pixels)]
    numbers: list[int] = colors[flat].ravel().tolist()
    rest = pixels[~np.isin(of_pixel, flat)][None]
    if rest.size:
        others = Image.fromarray(rest).quantize(
            256 - len(flat), method=Image.Quantize.MEDIANCUT, kmeans=5
        )
        numbers += others.getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette(numbers)
    return palette


def entries_table() -> str:
    """The README's table, between its markers."""
    lines = [BEGIN, "", "| cfg | seed 1, as Mitsuba draws it, and the labels of one level |"]
    lines.append("| --- | --- |")
    for entry in ENTRIES:
        cfg = f"configs/{entry.name}.json"
        labels = json.loads((ROOT / cfg).read_text())["labels"]
        levels = ", ".join(f"`{level}`" for level in labels)
        image = f"docs/pictures/gallery_{entry.name}.png"
        alt = f"{entry.name}, sample {entry.sample}: RGB and labels of the level {entry.level}"
        about = f"**[{entry.name}]({cfg})**<br>{entry.about}.<br>Levels: {levels}"
        lines.append(f"| {about} | ![{alt}]({image}) |")
    return "\n".join([*lines, "", END])


def rewrite(readme: str) -> str:
    """The README with the table between its markers renewed.

    Raises:
        ScenecError: The markers are not there, once each and in order.
    """
    head, begin, rest = readme.partition(BEGIN)
    _old, end, tail = rest.partition(END)
    if not begin or not end or BEGIN in rest or END in tail:
        raise ScenecError(f"{README.name}: needs one {BEGIN} and one {END} after it")
    return head + entries_table() + tail


def main(page: Page) -> None:
    """Renders the pictures and renews the README's table."""
    options, spp = page.options, 2 if page.fast else page.options.spp
    folder = options.keep or page.scratch
    rewrite(README.read_text())  # Missing markers are known before the minutes of rendering.
    for entry in ENTRIES:
        if not options.only or entry.name in options.only:
            print(f"{entry.name}: compiling and rendering", flush=True)
            save(picture(entry, folder / entry.name, spp), page.picture(entry.name))
    if not options.only or FIRST in options.only:
        print(f"{FIRST}: rendering its first {ROWS} samples", flush=True)
        sheet = first_picture(folder / FIRST, spp)
        save(sheet, page.folder / "pictures" / f"{FIRST}.png")
    if page.folder == ROOT / "docs":
        README.write_text(rewrite(README.read_text()))


if __name__ == "__main__":
    run(main, page="gallery", only=names, spp=64, keep=Path)
