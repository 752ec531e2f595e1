"""A batch from above, as the page stores it: heights in 16 bits, and the largest objects."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.view.layers import Layer, store_depth
from scenec.datasets.view.record import short
from scenec.datasets.view.site import Site, site_planes
from scenec.schemas.errors import FrameError
from scenec.schemas.instances import read_table
from scenec.schemas.manifest import FRAMES, Batch
from scenec.schemas.model import Model


@dataclass(frozen=True)
class Ground:
    """A batch from above.

    Attributes:
        corner: x and y of the middle of the first cell, meters.
        step: Width of a cell along x and y, meters.
        heights: Of the highest ground over each cell's middle, NaN where there is none, meters,
            row 0 at the least y: float [ny, nx].
        suns: Elevation and azimuth (clockwise from +y), degrees, of the first sun at each sample;
            None where it has none.
        model: The batch in three dimensions; None where the page shall have none of it.
        site: What the ground is to a vehicle, and where it lies; None where nobody looked.
    """

    corner: tuple[float, float]
    step: tuple[float, float]
    heights: NDArray[np.floating]
    suns: tuple[tuple[float, float] | None, ...] = ()
    model: Model | None = None
    site: Site | None = None


def ground_text(ground: Ground, side: int) -> bytes:
    """Its element's content: a line of JSON, a line of base64; at most ``side`` cells a side."""
    every = max(1, -(-max(ground.heights.shape) // side))
    heights = ground.heights[::every, ::every].astype(np.float64)
    low = float(np.nanmin(heights)) if np.isfinite(heights).any() else 0.0
    # Not a number is "no hit" of a depth; counted from the lowest point it is stored evenly.
    layer = store_depth("ground", np.where(np.isnan(heights), np.inf, heights - low), 16)
    facts = {
        **layer.facts,
        "low": low,
        "corner": [short(v, 12) for v in ground.corner],
        "step": [short(every * v, 12) for v in ground.step],
        "size": [heights.shape[1], heights.shape[0]],
    }
    line = json.dumps(facts, allow_nan=False, separators=(",", ":")).encode()
    return line + b"\n" + layer.text()


def site_text(site: Site, side: int) -> bytes:
    """Its element's content: a line of JSON, a line of base64; at most ``side`` cells a side."""
    facts, data = site_planes(site, side)
    line = json.dumps(facts, allow_nan=False, separators=(",", ":")).encode()
    return line + b"\n" + Layer({}, zlib.compress(data, 9)).text()


def objects_text(batch: Batch, most: int) -> bytes | None:
    """The largest instances of a batch: how many there are, then x, y and radius as float32.

    A radius is half the mean extent of the instance's box. None where the batch has no table.
    """
    try:
        table = read_table(batch.folder / FRAMES)
    except FrameError:
        return None
    radius = 0.5 * (table.box[:, 1] - table.box[:, 0]).astype(np.float64).mean(axis=1)
    order = np.argsort(-radius, kind="stable")[:most]
    values = np.column_stack([table.position[order, :2], radius[order]]).astype("<f4")
    facts = {"all": len(radius), "count": len(order)}
    layer = Layer(facts, zlib.compress(np.ascontiguousarray(values.T).tobytes(), 9))
    return json.dumps(facts, separators=(",", ":")).encode() + b"\n" + layer.text()
