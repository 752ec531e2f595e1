"""One picture of several frames: pictures, label levels, ids, depth, motion, with legends."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from scenec.datasets.colors import (
    NO_LABEL,
    STEEP,
    TRAVERSABILITY_COLORS,
    label_colors,
    paint_classes,
    paint_depth,
    paint_instances,
    paint_labels,
    paint_slope,
    viridis,
)
from scenec.datasets.motion_colors import (
    CODE_COLORS,
    CODE_NAMES,
    FLOWS,
    OCCLUSIONS,
    SIZES,
    UNITS,
    VECTORS,
    paint_codes,
    paint_flow,
    paint_sizes,
    paint_vectors,
    scale_of,
    wheel_picture,
)
from scenec.schemas.vehicle import TRAVERSABILITY

_INK = (34, 34, 34)
_PAPER = (255, 255, 255)
_GAP = 10
_HEAD = 34
_LEGEND_LINE = 24


@dataclass(frozen=True)
class SheetFrame:
    """Holds the pictures of one frame on the sheet.

    Attributes:
        title: Said beside the row.
        picture: 8-bit RGB, uint8 [h, w, 3], or None.
        labels: Per level, label ids [h, w].
        instance: Ids [h, w], or None.
        depth: Meters [h, w], +inf where nothing was hit, or None.
        clean: A sensor's picture without noise, like ``picture``, or None.
        tracks: ``picture`` with point tracks on it, or None.
        measured: What a depth camera said, meters [h, w], 0 without an answer, or None.
        motion: Flow, scene flow, disparity and occlusion by their passes' names.
        terrain: Slope and what places are to a vehicle, by their passes' names.
    """

    title: str
    picture: NDArray[np.uint8] | None
    labels: dict[str, NDArray[np.unsignedinteger]]
    instance: NDArray[np.unsignedinteger] | None
    depth: NDArray[np.floating] | None
    clean: NDArray[np.uint8] | None = None
    tracks: NDArray[np.uint8] | None = None
    measured: NDArray[np.floating] | None = None
    motion: Mapping[str, NDArray] = field(default_factory=dict)
    terrain: Mapping[str, NDArray] = field(default_factory=dict)


#: How passes of ``SheetFrame.terrain`` are painted.
TERRAIN: Mapping[str, Callable[[NDArray], NDArray[np.uint8]]] = {
    "slope": paint_slope,
    "traversable": paint_classes,
}
#: Columns of photographs: they alone may be blended.
_PHOTOGRAPHS = ("rgb", "clean", "tracks")
_TITLES = {
    "rgb": "RGB", "clean": "RGB without noise", "tracks": "point tracks (a ring: hidden)",
    "instance": "instances", "depth": "depth (planar)",
    "depth_measured": "depth as measured", "flow": "flow", "flow_backward": "flow, backward",
    "scene_flow": "scene flow", "disparity": "disparity", "occlusion": "occlusion",
    "slope": "slope of the ground", "traversable": "for the sensor's vehicle",
    "occlusion_backward": "occlusion, backward", "disparity_occlusion": "occlusion by disparity",
}  # fmt: skip


def contact_sheet(
    frames: Sequence[SheetFrame],
    label_names: dict[str, dict[int, str]],
    heading: str,
    tile_width: int = 480,
) -> Image.Image:
    """The sheet: a row a frame, a column a pass, a legend under each column.

    Args:
        frames: At least one.
        label_names: Per level, id -> name.
        heading: Said on top.
        tile_width: Width of each picture on the sheet, pixels.
    """
    columns = list(dict.fromkeys(column for frame in frames for column in _columns(frame)))
    height, width = _size(frames[0])
    tile = (tile_width, max(1, round(tile_width * height / width)))
    near, far = _depth_range(frames)
    scales = {
        name: scale_of(name, [f.motion[name] for f in frames if name in f.motion]) for name in UNITS
    }
    colors = {level: label_colors(list(names)) for level, names in label_names.items()}
    least = 4 if any(name in columns for name in (*OCCLUSIONS, "traversable")) else 3
    legend = max([least] + [len(names) + 1 for names in label_names.values()]) * _LEGEND_LINE
    size = (
        _GAP + len(columns) * (tile[0] + _GAP),
        2 * _HEAD + len(frames) * (tile[1] + _GAP) + legend + _GAP,
    )
    sheet = Image.new("RGB", size, _PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((_GAP, 8), heading, _INK, _font(19))
    bottom = 2 * _HEAD + len(frames) * (tile[1] + _GAP)
    for i, column in enumerate(columns):
        x = _GAP + i * (tile[0] + _GAP)
        draw.text((x, _HEAD + 8), _title(column), _INK, _font(17))
        for j, frame in enumerate(frames):
            y = 2 * _HEAD + j * (tile[1] + _GAP)
            picture = Image.fromarray(_paint(frame, column, colors, near, far, scales))
            # Ids must not be blended: only photographs are filtered.
            photograph = column in _PHOTOGRAPHS
            filtering = Image.Resampling.LANCZOS if photograph else Image.Resampling.NEAREST
            sheet.paste(picture.resize(tile, filtering), (x, y))
            if i == 0:
                _tag(draw, (x, y), frame.title)
        corner = (x, bottom)
        if column in UNITS or column in OCCLUSIONS:
            _motion_legend(sheet, draw, corner, tile[0], column, scales.get(column, 1.0))
        else:
            _legend(sheet, draw, corner, tile[0], column, label_names, colors, near, far)
    return sheet


def _columns(frame: SheetFrame) -> list[str]:
    columns = ["rgb"] if frame.picture is not None else []
    columns += ["clean"] if frame.clean is not None else []
    columns += ["tracks"] if frame.tracks is not None else []
    columns += [f"label.{level}" for level in frame.labels]
    columns += ["instance"] if frame.instance is not None else []
    columns += ["depth"] if frame.depth is not None else []
    columns += ["depth_measured"] if frame.measured is not None else []
    columns += [name for name in (*UNITS, *OCCLUSIONS) if name in frame.motion]
    columns += [name for name in TERRAIN if name in frame.terrain]
    return columns


def _size(frame: SheetFrame) -> tuple[int, int]:
    every = (frame.picture, *frame.labels.values(), frame.instance, frame.depth, frame.measured)
    for array in (*every, *frame.motion.values(), *frame.terrain.values()):
        if array is not None:
            return array.shape[0], array.shape[1]
    return 1, 1


def _title(column: str) -> str:
    return _TITLES.get(column, f"labels, level '{column.removeprefix('label.')}'")


def _depth_range(frames: Sequence[SheetFrame]) -> tuple[float, float]:
    """The depths between which 99 % of all hits lie, rounded outward to two digits."""
    hits = [f.depth[np.isfinite(f.depth) & (f.depth > 0)] for f in frames if f.depth is not None]
    all_hits = np.concatenate([*hits, np.zeros(0)])
    if not all_hits.size:
        return 1.0, 10.0
    near, far = np.quantile(all_hits, [0.005, 0.995])
    step = 10.0 ** (np.floor(np.log10([near, far])) - 1)
    return float(np.floor(near / step[0]) * step[0]), float(np.ceil(far / step[1]) * step[1])


def _paint(
    frame: SheetFrame,
    column: str,
    colors: dict[str, dict[int, tuple[int, int, int]]],
    near: float,
    far: float,
    scales: Mapping[str, float],
) -> NDArray[np.uint8]:
    level = column.removeprefix("label.")
    if column == "rgb" and frame.picture is not None:
        return frame.picture
    if column == "clean" and frame.clean is not None:
        return frame.clean
    if column == "tracks" and frame.tracks is not None:
        return frame.tracks
    if column in frame.motion:
        return _paint_motion(column, frame.motion[column], scales.get(column, 1.0))
    if column in frame.terrain:
        return TERRAIN[column](frame.terrain[column])
    if column == "depth_measured" and frame.measured is not None:
        answers = np.where(frame.measured > 0.0, frame.measured, np.inf)
        return paint_depth(answers, near, far)
    if column == "instance" and frame.instance is not None:
        return paint_instances(frame.instance)
    if column == "depth" and frame.depth is not None:
        return paint_depth(frame.depth, near, far)
    if level in frame.labels:
        return paint_labels(frame.labels[level], colors.get(level, {}))
    # Frames can differ in their passes: what one lacks stays blank.
    return np.full((*_size(frame), 3), 255, np.uint8)


def _paint_motion(column: str, values: NDArray, scale: float) -> NDArray[np.uint8]:
    if column in FLOWS:
        return paint_flow(values, scale)
    if column in VECTORS:
        return paint_vectors(values, scale)
    return paint_sizes(values, scale) if column in SIZES else paint_codes(values)


@lru_cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def _tag(draw: ImageDraw.ImageDraw, corner: tuple[int, int], text: str) -> None:
    """A small title inside of the picture's corner."""
    at = (corner[0] + 8, corner[1] + 6)
    box = draw.textbbox(at, text, _font(14))
    draw.rectangle((box[0] - 5, box[1] - 4, box[2] + 5, box[3] + 4), _PAPER)
    draw.text(at, text, _INK, _font(14))


def _legend(
    sheet: Image.Image,
    draw: ImageDraw.ImageDraw,
    corner: tuple[int, int],
    width: int,
    column: str,
    label_names: dict[str, dict[int, str]],
    colors: dict[str, dict[int, tuple[int, int, int]]],
    near: float,
    far: float,
) -> None:
    x, y = corner
    if column.startswith("label."):
        level = column.removeprefix("label.")
        for number, name in sorted(label_names.get(level, {}).items()):
            draw.rectangle((x, y + 3, x + 26, y + 19), colors[level].get(number, NO_LABEL))
            draw.text((x + 36, y + 2), f"{name}  ({number})", _INK, _font(15))
            y += _LEGEND_LINE
    elif column in ("depth", "depth_measured"):
        bar = np.repeat(viridis(np.linspace(1.0, 0.0, width))[None], 16, axis=0)
        sheet.paste(Image.fromarray(bar), (x, y + 3))
        for part in (0.0, 0.25, 0.5, 0.75, 1.0):
            text = f"{near * (far / near) ** part:.3g} m"
            length = draw.textlength(text, _font(14))
            draw.text((x + part * (width - length), y + 22), text, _INK, _font(14))
        white = "nothing hit" if column == "depth" else "no answer"
        draw.text((x, y + 44), f"logarithmic; white: {white}", _INK, _font(14))
    elif column == "traversable":
        for color, name in zip(TRAVERSABILITY_COLORS, TRAVERSABILITY, strict=True):
            draw.rectangle((x, y + 3, x + 26, y + 19), color)
            draw.text((x + 36, y + 2), name, _INK, _font(15))
            y += _LEGEND_LINE
    elif column == "slope":
        bar = np.repeat(viridis(np.linspace(0.0, 1.0, width))[None], 16, axis=0)
        sheet.paste(Image.fromarray(bar), (x, y + 3))
        for part, text in ((0.0, "0"), (1.0, f"{STEEP:g}° and steeper")):
            left = x + part * (width - draw.textlength(text, _font(14)))
            draw.text((left, y + 22), text, _INK, _font(14))
        draw.text((x, y + 44), "white: nothing hit", _INK, _font(14))
    elif column == "instance":
        draw.text((x, y), "one color an instance, kept over all frames", _INK, _font(15))
    elif column == "clean":
        draw.text((x, y), "the sensor's picture before noise, mosaic, JPEG", _INK, _font(15))
    else:
        draw.text((x, y), "as the sidecars' tone_curve says", _INK, _font(15))


def _motion_legend(
    sheet: Image.Image,
    draw: ImageDraw.ImageDraw,
    corner: tuple[int, int],
    width: int,
    column: str,
    scale: float,
) -> None:
    x, y = corner
    unit = UNITS.get(column, "")
    if column in OCCLUSIONS:
        for code, color in CODE_COLORS.items():
            draw.rectangle((x, y + 3, x + 26, y + 19), color)
            draw.text((x + 36, y + 2), f"{CODE_NAMES[code].partition(':')[0]}  ({code})", _INK,
                      _font(15))  # fmt: skip
            y += _LEGEND_LINE
    elif column in FLOWS:
        sheet.paste(Image.fromarray(wheel_picture(64)), (x, y + 3))
        lines = [f"where to; {scale:.3g} {unit} at the rim", "farther: darker", "black: no number"]
        for i, text in enumerate(lines):
            draw.text((x + 76, y + 2 + 22 * i), text, _INK, _font(15))
    elif column in VECTORS:
        lines = ["red: x right, green: y down, blue: z ahead",
                 f"gray: none; full: {scale:.3g} {unit} and more", "black: no number"]  # fmt: skip
        for i, text in enumerate(lines):
            draw.text((x, y + 2 + 22 * i), text, _INK, _font(15))
    else:
        bar = np.repeat(viridis(np.linspace(0.0, 1.0, width))[None], 16, axis=0)
        sheet.paste(Image.fromarray(bar), (x, y + 3))
        for part in (0.0, 0.5, 1.0):
            text = f"{part * scale:.3g} {unit}"
            length = draw.textlength(text, _font(14))
            draw.text((x + part * (width - length), y + 22), text, _INK, _font(14))
        draw.text((x, y + 44), "whatever its sign; black: no number", _INK, _font(14))
