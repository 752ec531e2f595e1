"""Pictures for pages: cfgs compiled and rendered, frames developed, tiles laid out, files small."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from scenec.backends.run.render import render
from scenec.compiler.cfg.load import Spec
from scenec.compiler.compile import compile_cfg
from scenec.datasets.colors import label_colors, paint_labels
from scenec.lab.runner import ROOT
from scenec.schemas.errors import ScenecError
from scenec.schemas.files import atomic
from scenec.schemas.frames import Frame, read_frame
from scenec.schemas.picture import develop

INK, PAPER, GAP = (34, 34, 34), (255, 255, 255), 6
Tile = tuple[str, Image.Image]
#: A color on this part of a picture at least fills areas; so many of them at most.
_AREA, _FLAT = 0.002, 128


def beside_assets(folder: Path) -> Path:
    """A folder for cfgs that name files as those of configs/ do."""
    (folder / "configs").mkdir(parents=True, exist_ok=True)
    if not (folder / "assets").exists():
        (folder / "assets").symlink_to(ROOT / "assets")
    return folder / "configs"


def frames(
    cfg: Path | Spec, out: Path, backend: str = "mitsuba", seed: int = 1, **how: Any
) -> list[Frame]:
    """Frames of a cfg's first batch, compiled and rendered into a folder.

    Raises:
        ScenecError: It cannot be compiled, or a frame could not be made.
    """
    compile_cfg(cfg, seed=seed, out=out, batches=range(1), cache=out.parent / "cache")
    report = render(out, backend, batches=range(1), **how)
    if report.failed or not report.frames:
        why = "; ".join(report.failed) or "no frame was made"
        raise ScenecError(f"{out.name}, {backend}: {why}")
    return [read_frame(path) for path in report.frames]


def photograph(frame: Frame, ev: float | None = None) -> Image.Image:
    """Develops a frame with its exposure, or another one."""
    exposure = frame.sidecar.exposure_ev if ev is None else ev
    return Image.fromarray(develop(frame.passes["rgb"], exposure))


def labels(frame: Frame, level: str) -> Image.Image:
    """The labels of a level in colors."""
    colors = label_colors([int(i) for i in frame.sidecar.labels[level]])
    return Image.fromarray(paint_labels(frame.passes[f"label.{level}"], colors))


def sheet(rows: Sequence[Sequence[Tile]], width: int) -> Image.Image:
    """Tiles in rows, the name below each; labels and instances, by their names, unfiltered."""
    first = rows[0][0][1]
    size = (width, round(width * first.height / first.width))
    captions = any(name for row in rows for name, _ in row)
    step = (size[0] + GAP, size[1] + (22 if captions else 0))
    made = Image.new("RGB", (max(map(len, rows)) * step[0] - GAP, len(rows) * step[1]), PAPER)
    draw, font = ImageDraw.Draw(made), ImageFont.load_default(14)
    for y, row in enumerate(rows):
        for x, (name, tile) in enumerate(row):
            # Ids must not be blended.
            painted = "label" in name or "instance" in name
            how = Image.Resampling.NEAREST if painted else Image.Resampling.LANCZOS
            made.paste(tile.resize(size, how), (x * step[0], y * step[1]))
            draw.text((x * step[0] + 2, y * step[1] + size[1] + 3), name, INK, font)
    return made


def save(picture: Image.Image, path: Path) -> None:
    """Writes a small file: JPEG by its name, or PNG of 256 colors, dithered as skies need it."""
    if path.suffix == ".jpg":
        with atomic(path) as temporary:
            picture.save(temporary, format="JPEG", quality=84, optimize=True)
        return
    small = picture.quantize(palette=_palette(picture), dither=Image.Dither.FLOYDSTEINBERG)
    with atomic(path) as temporary:
        small.save(temporary, format="PNG", optimize=True)


def _palette(picture: Image.Image) -> Image.Image:
    """A picture of 256 colors: those that fill areas (paper, labels) exactly, the best others."""
    pixels = np.asarray(picture).reshape(-1, 3)
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
