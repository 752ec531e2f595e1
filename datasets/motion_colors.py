"""Colors for what compares two pictures, or measures: flow, scene flow, disparity, occlusion.

Flow has the color wheel of the Middlebury benchmark (Baker and others 2011, A Database and
Evaluation Methodology for Optical Flow, IJCV 92; its ``colorcode.cpp``): the hue says where to, the
saturation how far, white is no motion, and what goes beyond the scale is darker. What is not a
number is black, which no other value is.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.colors import viridis
from scenec.schemas.correspondence import CODES, HIDDEN, NOTHING, OUTSIDE, VISIBLE

FLOWS = ("flow", "flow_backward")
VECTORS = ("scene_flow",)
SIZES = ("disparity",)
OCCLUSIONS = ("occlusion", "occlusion_backward", "disparity_occlusion")
#: All that have a scale of their own, with its unit.
UNITS = {**dict.fromkeys((*FLOWS, *SIZES), "px"), **dict.fromkeys(VECTORS, "m")}

#: Of codes of the occlusion passes; any other is black.
CODE_COLORS: dict[int, tuple[int, int, int]] = {
    VISIBLE: (222, 226, 230),
    HIDDEN: (204, 68, 51),
    OUTSIDE: (68, 119, 170),
    NOTHING: (119, 119, 119),
}
CODE_NAMES = CODES
#: Part of all pixels that is within a scale.
WITHIN = 0.99


def _wheel() -> NDArray[np.float64]:
    """Red, yellow, green, cyan, blue, magenta, with as many steps between as look alike wide."""
    steps = (("R", "Y", 15), ("Y", "G", 6), ("G", "C", 4), ("C", "B", 11), ("B", "M", 13),
             ("M", "R", 6))  # fmt: skip
    corner = {"R": (1, 0, 0), "Y": (1, 1, 0), "G": (0, 1, 0), "C": (0, 1, 1), "B": (0, 0, 1),
              "M": (1, 0, 1)}  # fmt: skip
    rows = []
    for a, b, count in steps:
        one, other = np.array(corner[a]), np.array(corner[b])
        # As there, in whole numbers of 255: the last digit is theirs.
        rows += [np.where(one < other, 255 * i // count, np.where(one > other,
                 255 - 255 * i // count, 255 * one)) for i in range(count)]  # fmt: skip
    return np.array(rows) / 255.0


#: Colors of the wheel, [55, 3]; motion to the right is the first one.
WHEEL = _wheel()


def paint_flow(flow: NDArray[np.floating], scale: float) -> NDArray[np.uint8]:
    """Flow [h, w, 2] on the color wheel: uint8 [h, w, 3].

    Args:
        flow: Right and down.
        scale: How far the rim is; beyond it colors are darker.
    """
    known = np.isfinite(flow).all(axis=2)
    u, v = np.where(known[..., None], flow, 0.0).astype(np.float64).transpose(2, 0, 1) / scale
    far = np.hypot(u, v)
    at = (np.arctan2(-v, -u) / np.pi + 1.0) / 2.0 * (len(WHEEL) - 1)
    low = at.astype(int)
    part = (at - low)[..., None]
    hue = (1.0 - part) * WHEEL[low] + part * WHEEL[(low + 1) % len(WHEEL)]
    color = np.where(far[..., None] <= 1.0, 1.0 - far[..., None] * (1.0 - hue), 0.75 * hue)
    return np.where(known[..., None], (255.0 * color).astype(np.uint8), np.uint8(0))


def paint_vectors(vectors: NDArray[np.floating], scale: float) -> NDArray[np.uint8]:
    """Vectors [h, w, 3] as shades around gray, x red, y green, z blue: uint8 [h, w, 3]."""
    known = np.isfinite(vectors).all(axis=2)[..., None]
    part = np.clip(np.where(known, vectors, 0.0) / scale, -1.0, 1.0)
    return np.where(known, np.rint(128.0 + 127.0 * part).astype(np.uint8), np.uint8(0))


def paint_sizes(values: NDArray[np.floating], scale: float) -> NDArray[np.uint8]:
    """The size of values [h, w], from 0 dark to the scale bright: uint8 [h, w, 3]."""
    known = np.isfinite(values)
    part = np.where(known, np.abs(values), 0.0) / scale
    return np.where(known[..., None], viridis(part), np.uint8(0))


def paint_codes(codes: NDArray[np.unsignedinteger]) -> NDArray[np.uint8]:
    """Codes of an occlusion pass [h, w]: uint8 [h, w, 3]."""
    out = np.zeros((*codes.shape, 3), np.uint8)
    for code, color in CODE_COLORS.items():
        out[codes == code] = color
    return out


def lengths(values: NDArray[np.floating]) -> NDArray[np.float32]:
    """Returns the length of each pixel's value: float32 [h, w], NaN where that is not a number."""
    wide = values.astype(np.float64)
    far = np.abs(wide) if values.ndim == 2 else np.sqrt((wide * wide).sum(axis=2))
    return np.where(np.isfinite(far), far, np.nan).astype(np.float32)


def scale_of(name: str, arrays: Iterable[NDArray[np.floating]]) -> float:
    """Returns a bound on 99 % of all pixels, rounded up to two digits; 1 where nothing moves.

    Pixels are measured from corner to corner at most: beyond, a point is outside anyway.

    Args:
        name: Of the pass.
        arrays: Of some frames.
    """
    every = list(arrays)
    found = np.concatenate([np.zeros(0), *(lengths(array).ravel() for array in every)])
    found = found[np.isfinite(found)]
    far = float(np.quantile(found, WITHIN)) if found.size else 0.0
    if UNITS[name] == "px" and every:
        far = min(far, max(float(np.hypot(*array.shape[:2])) for array in every))
    if far <= 0.0:
        return 1.0
    step = 10.0 ** (np.floor(np.log10(far)) - 1)
    return float(np.ceil(far / step) * step)


def wheel_picture(side: int) -> NDArray[np.uint8]:
    """The legend: the color of each direction, up to the rim; white around it. [side, side, 3]."""
    at = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    flow = np.stack(np.meshgrid(at, at), axis=2)
    outside = np.hypot(flow[..., 0], flow[..., 1]) > 1.0
    return np.where(outside[..., None], np.uint8(255), paint_flow(flow, 1.0))
