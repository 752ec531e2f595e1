"""Colors for labels, instances and depth that can be told apart and read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Tol's "muted" qualitative scheme (Paul Tol, Colour Schemes, SRON/EPS/TN/09-002), reordered so that
# the first ones look like what outdoor levels tend to hold: sky, sand, rock, plants, ...
_LABELS = np.array(
    [
        [136, 204, 238],
        [221, 204, 119],
        [136, 34, 85],
        [17, 119, 51],
        [204, 102, 119],
        [51, 34, 136],
        [153, 153, 51],
        [68, 170, 153],
        [170, 68, 153],
    ],
    np.uint8,
)
NO_LABEL = (221, 221, 221)
# Anchors of the colormap viridis (van der Walt and Smith 2015, CC0), at equal steps.
_VIRIDIS = np.array(
    [
        [68, 1, 84],
        [71, 44, 122],
        [59, 81, 139],
        [44, 113, 142],
        [33, 144, 141],
        [39, 173, 129],
        [92, 200, 99],
        [170, 220, 50],
        [253, 231, 37],
    ],
    np.float64,
)

#: What places are to a vehicle (``schemas.vehicle.TRAVERSABILITY``), of Okabe and Ito (2008), which
#: color-blind eyes tell apart: gray, blue, yellow, vermilion.
TRAVERSABILITY_COLORS = ((204, 204, 204), (0, 114, 178), (240, 228, 66), (213, 94, 0))
#: Slope, degrees, from which on all have one color.
STEEP = 45.0


def paint_classes(classes: NDArray[np.unsignedinteger]) -> NDArray[np.uint8]:
    """Colors of what places are to a vehicle: uint8 [h, w, 3]."""
    return np.array(TRAVERSABILITY_COLORS, np.uint8)[
        np.minimum(classes, len(TRAVERSABILITY_COLORS) - 1)
    ]


def paint_slope(degrees: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Slopes on a viridis scale that ends at ``STEEP``; nothing hit is white. uint8 [h, w, 3]."""
    known = np.isfinite(degrees)
    part = np.clip(np.where(known, degrees, 0.0) / STEEP, 0.0, 1.0)
    return np.where(known[..., None], viridis(part), np.uint8(255))


def label_colors(ids: list[int]) -> dict[int, tuple[int, int, int]]:
    """A color of its own for each label id, in order; beyond nine, lighter and darker ones."""
    colors = {0: NO_LABEL}
    for place, number in enumerate(sorted(i for i in ids if i)):
        color = _LABELS[place % len(_LABELS)].astype(np.float64)
        turn = place // len(_LABELS)
        for _ in range((turn + 1) // 2):
            color = color * 0.6 if turn % 2 else 0.5 * (color + 255.0)
        red, green, blue = color.astype(int).tolist()
        while (red, green, blue) in colors.values():
            # Of very many labels: some readers tell them apart by color alone.
            green, blue = (green + (blue == 255)) % 256, (blue + 1) % 256
        colors[number] = (red, green, blue)
    return colors


def paint_labels(
    labels: NDArray[np.unsignedinteger], colors: dict[int, tuple[int, int, int]]
) -> NDArray[np.uint8]:
    """Colors of a label map [h, w]: uint8 [h, w, 3]."""
    out = np.empty((*labels.shape, 3), np.uint8)
    for number in np.unique(labels).tolist():
        out[labels == number] = colors.get(number, (0, 0, 0))
    return out


def paint_instances(ids: NDArray[np.unsignedinteger]) -> NDArray[np.uint8]:
    """A color of its own for each instance, the same in every frame; 0 is near white.

    Hues follow the golden ratio, so that neighboring ids differ most; lightness varies by a hash.
    """
    number = ids.astype(np.float64)
    hue = (number * 0.6180339887498949) % 1.0
    other = (number * 0.7548776662466927) % 1.0
    saturation, value = 0.45 + 0.5 * other, 0.95 - 0.45 * ((number * 0.5698402909980532) % 1.0)
    sector = hue[..., None] * 6.0 + np.array([5.0, 3.0, 1.0])
    k = np.abs((sector % 6.0) - 3.0) - 1.0
    rgb = value[..., None] * (1.0 - saturation[..., None] * (1.0 - np.clip(k, 0.0, 1.0)))
    rgb[ids == 0] = 0.94
    return np.round(255.0 * rgb).astype(np.uint8)


def paint_depth(depth: NDArray[np.floating], near: float, far: float) -> NDArray[np.uint8]:
    """Depth on a logarithmic viridis scale, near bright; nothing hit is white. uint8 [h, w, 3]."""
    hit = np.isfinite(depth)
    safe = np.where(hit, np.clip(depth, near, far), far)
    span = np.log(far / near) if far > near else 1.0
    return np.where(hit[..., None], viridis(1.0 - np.log(safe / near) / span), np.uint8(255))


def viridis(t: NDArray[np.floating]) -> NDArray[np.uint8]:
    """The colormap at t in [0, 1]: uint8 [..., 3]."""
    at = np.clip(t, 0.0, 1.0) * (len(_VIRIDIS) - 1)
    low = np.minimum(at.astype(int), len(_VIRIDIS) - 2)
    part = (at - low)[..., None]
    return np.round(_VIRIDIS[low] + part * (_VIRIDIS[low + 1] - _VIRIDIS[low])).astype(np.uint8)
