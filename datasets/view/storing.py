"""All layers of a frame that the page shows, in the order it shows them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.datasets import pictures
from scenec.datasets.motion_colors import OCCLUSIONS, UNITS
from scenec.datasets.source import LoadedFrame
from scenec.datasets.view.fields import store_field, store_integers
from scenec.datasets.view.layers import (
    Fineness,
    Layer,
    store_depth,
    store_ids,
    store_normal,
    store_picture,
    thinned,
)
from scenec.schemas.depth_camera import MEASURED


def store_frame(
    frame: LoadedFrame, fineness: Fineness
) -> tuple[list[Layer], tuple[int, int], NDArray[np.uint32]]:
    """The layers of a frame.

    Args:
        frame: Its ``rgb`` need not be decoded: the picture is the PNG's.
        fineness: How fine.

    Returns:
        Layers, their (width, height), and the instance ids that the stored picture shows.

    Raises:
        FrameError: A picture is missing or damaged.
    """
    passes = frame.passes
    size = fineness.size(frame.width, frame.height)
    layers = _pictures(frame, size, fineness.quality)
    layers += [
        store_ids(name, thinned(ids, size))[0]
        for name, ids in passes.items()
        if name.startswith("label.")
    ]
    shown = np.zeros(0, np.uint32)
    if "instance" in passes:
        layer, shown = store_ids("instance", thinned(passes["instance"], size))
        layers.append(layer)
    for name in ("depth", "range", MEASURED):
        if name in passes:
            meters = thinned(passes[name], size)
            if name == MEASURED:
                # As nothing hit: its own code, and no part of the scale.
                meters = np.where(meters > 0.0, meters, np.inf)
            layers.append(store_depth(name, meters, fineness.depth_bits))
    if "normal" in passes:
        layers.append(store_normal(thinned(passes["normal"], size)))
    layers += [store_field(n, thinned(passes[n], size)) for n in UNITS if n in passes]
    layers += [store_ids(n, thinned(passes[n], size))[0] for n in OCCLUSIONS if n in passes]
    return layers, size, shown


def _pictures(frame: LoadedFrame, size: tuple[int, int], quality: int) -> list[Layer]:
    if not pictures.has_picture(frame):
        return []
    found = [store_picture("rgb", pictures.picture(frame), size, quality)]
    for kind in pictures.kinds(frame.sidecar):
        pixels = pictures.beside(frame, kind)
        if kind == "raw":
            found.append(store_integers(kind, thinned(pixels, size)))
        else:
            found.append(store_picture(kind, pixels, size, quality))
    return found
