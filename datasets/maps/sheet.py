"""One picture of a map's layers, in colors that color-blind eyes tell apart."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from scenec.datasets.colors import (
    TRAVERSABILITY_COLORS,
    label_colors,
    paint_classes,
    paint_instances,
    paint_labels,
    viridis,
)
from scenec.schemas.files import atomic
from scenec.schemas.site_map import LAYERS, MapGrid
from scenec.schemas.vehicle import TRAVERSABILITY

_INK, _PAPER = (34, 34, 34), (255, 255, 255)
#: Pixels along the longer side of a layer's picture.
SIDE = 480
_GAP, _HEAD, _LEGEND = 14, 28, 60
_COLUMNS = 4
#: Share of the values that a scale may leave out at either end.
_BEYOND = 0.5
#: Elevation of the light that shades heights, degrees; it comes from the north-west.
_LIGHT = 45.0


def write_map_sheet(
    path: Path,
    layers: Mapping[str, NDArray[Any]],
    grid: MapGrid,
    label_names: Mapping[str, Mapping[int, str]],
) -> None:
    """Draws all layers, north up.

    Args:
        path: The PNG to write.
        layers: By name, in order; neither side above ``SIDE``.
        grid: The cells that they are a part of.
        label_names: Level -> id -> name.
    """
    columns = min(_COLUMNS, len(layers))
    rows = -(-len(layers) // columns)
    tall = round(SIDE * grid.height / max(grid.width, grid.height))
    step = SIDE + _GAP, _HEAD + max(1, tall) + _LEGEND
    sheet = Image.new("RGB", (columns * step[0] + _GAP, rows * step[1] + _GAP), _PAPER)
    draw = ImageDraw.Draw(sheet)
    shade = _shade(layers["height"], grid) if "height" in layers else None
    for number, (name, values) in enumerate(layers.items()):
        x, y = _GAP + number % columns * step[0], _GAP + number // columns * step[1]
        unit = LAYERS[name.split("_")[0]][0]
        draw.text((x, y), f"{name} [{unit}]" if unit else name, _INK, _font(17))
        picture, legend = _paint(name, values, label_names)
        if shade is not None and name in ("height", "traversability"):
            picture = np.round(picture * shade[..., None]).astype(np.uint8)
        scale = SIDE / max(picture.shape[:2])
        size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
        # Ids must not be blended.
        sheet.paste(Image.fromarray(picture).resize(size, Image.Resampling.NEAREST), (x, y + _HEAD))
        _draw_legend(sheet, draw, (x, y + _HEAD + size[1] + 6), legend)
    with atomic(path) as temporary:
        sheet.save(temporary, format="PNG", compress_level=3)


type _Legend = tuple[float, float] | list[tuple[tuple[int, int, int], str]]


def _paint(
    name: str, values: NDArray, label_names: Mapping[str, Mapping[int, str]]
) -> tuple[NDArray[np.uint8], _Legend]:
    """Colors [h, w, 3]; the ends of a scale, or colors and what they stand for."""
    if name == "traversability":
        return paint_classes(values), list(zip(TRAVERSABILITY_COLORS, TRAVERSABILITY, strict=True))
    if name == "instance":
        return paint_instances(values), []
    if name.startswith("label_"):
        names = label_names[name.removeprefix("label_")]
        colors = label_colors(list(names))
        shown = [number for number in np.unique(values).tolist() if number in names]
        return paint_labels(values, colors), [(colors[k], f"{names[k]} ({k})") for k in shown]
    known = np.isfinite(values)
    low, high = (0.0, 1.0)
    if name != "sun" and known.any():
        low, high = np.percentile(values[known], (_BEYOND, 100.0 - _BEYOND)).tolist()
    span = high - low or 1.0
    shades = viridis((np.where(known, values, low) - low) / span)
    return np.where(known[..., None], shades, np.uint8(255)), (low, high)


def _shade(layer: NDArray[Any], grid: MapGrid) -> NDArray[np.float64]:
    """How bright a matte surface is, lit from the north-west, relative to a level one."""
    heights = layer.astype(np.float64)
    step = grid.cell_m * max(1, -(-max(grid.width, grid.height) // SIDE))
    if min(heights.shape) < 2:
        return np.ones(heights.shape)
    south, east = np.gradient(np.nan_to_num(heights, nan=float(np.nanmean(heights))), step)
    flat, up = math.cos(math.radians(_LIGHT)) * math.sqrt(0.5), math.sin(math.radians(_LIGHT))
    # Rows run south; to the light: west and north.
    cosine = (flat * east + flat * south + up) / np.sqrt(1.0 + east * east + south * south)
    return np.clip(cosine / up, 0.25, 1.0)


def _draw_legend(
    sheet: Image.Image, draw: ImageDraw.ImageDraw, corner: tuple[int, int], legend: _Legend
) -> None:
    x, y = corner
    if isinstance(legend, tuple):
        bar = np.repeat(viridis(np.linspace(0.0, 1.0, SIDE))[None], 14, axis=0)
        sheet.paste(Image.fromarray(bar), (x, y))
        for part in (0.0, 0.5, 1.0):
            text = f"{legend[0] + part * (legend[1] - legend[0]):.3g}"
            left = x + part * (SIDE - draw.textlength(text, _font(14)))
            draw.text((left, y + 17), text, _INK, _font(14))
        return
    for color, text in legend:
        wide = 34 + round(draw.textlength(text, _font(14)))
        if x + wide > corner[0] + SIDE:
            x, y = corner[0], y + 22
        draw.rectangle((x, y + 2, x + 20, y + 16), color)
        draw.text((x + 25, y), text, _INK, _font(14))
        x += wide + 8


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
