"""Bins of what a made dataset knows of every object and pixel: distance, size, occlusion, light."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.evaluate.evaluation import Cell
from scenec.datasets.filters import QUANTITIES, quantity
from scenec.datasets.source import LoadedFrame
from scenec.schemas.errors import OutputError
from scenec.schemas.records import FrameRecord
from scenec.schemas.spelling import nearest


@dataclass(frozen=True)
class Attribute:
    """A quantity and its bins: up to the first edge, between two, above the last.

    Attributes:
        name: As in tables and in ``--bins``.
        unit: Of the edges; empty for shares.
        what: One line.
        edges: Ascending; a bin holds its upper edge and not its lower one.
        key: Where COCO annotations have it, or of a whole picture, ``images``.
        column: Its name in ``scenec.datasets.filters``; empty for what is no instance's.
        of: What the whole picture has, by its sidecar; None where it is not the same all over.
    """

    name: str
    unit: str
    what: str
    edges: tuple[float, ...]
    key: str = ""
    column: str = ""
    of: Callable[[FrameRecord], float] | None = None

    @property
    def count(self) -> int:
        """Counts the bins."""
        return len(self.edges) + 1

    def numbers(self, values: NDArray[Any]) -> NDArray[np.int64]:
        """Bin of each value, -1 where it is not finite."""
        found = np.searchsorted(np.array(self.edges), values, side="left")
        return np.where(np.isfinite(values), found, -1)

    def text(self, number: int) -> str:
        """Describes a bin, for people."""
        unit = f" {self.unit}" if self.unit else ""
        if number == 0:
            # Shares are never below 0.
            return f"{self.edges[0]:g}{unit}" if self.unit == "" else f"to {self.edges[0]:g}{unit}"
        if number == len(self.edges):
            return f"above {self.edges[-1]:g}{unit}"
        return f"{self.edges[number - 1]:g} to {self.edges[number]:g}{unit}"


_QUARTERS = (0.0, 0.25, 0.5, 0.75)


def sun_elevation(record: FrameRecord) -> float:
    """Degrees; NaN where there is no sun or the sidecar does not say."""
    return record.sun.elevation_deg if record.sun else float("nan")


def visibility(record: FrameRecord) -> float:
    """Meters through the haze at z = 0; NaN where there is none or the sidecar does not say."""
    return float("nan") if record.visibility_m is None else record.visibility_m


SUN = Attribute(
    "sun", "deg", "elevation of the sun above the horizon", (0, 5, 10, 20, 30, 45, 60),
    "sun_elevation_deg", of=sun_elevation,
)  # fmt: skip
DISTANCE = Attribute(
    "distance", "m", "depth along the optical axis",
    (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000), "depth", "depth_mean",
)  # fmt: skip
#: In the order of tables.
ATTRIBUTES = {
    one.name: one
    for one in (
        DISTANCE,
        Attribute(
            "size", "m", "longest side of the object's bounding box",
            (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10), "size", "size",
        ),
        Attribute(
            "area", "px", "pixels that show it", (16, 64, 256, 1024, 4096, 16384), "area", "area"
        ),
        Attribute("occlusion", "", QUANTITIES["occlusion"][0], _QUARTERS, "occlusion", "occlusion"),
        Attribute(
            "truncation", "", QUANTITIES["truncation"][0], _QUARTERS, "truncation", "truncation"
        ),
        SUN,
        Attribute(
            "visibility", "m", "how far haze lets one see, where there is any",
            (50, 100, 200, 500, 1000, 2000, 5000, 10000), "visibility_m", of=visibility,
        ),
    )
}  # fmt: skip


#: By name.
Attributes = Mapping[str, Attribute]


def parse_bins(texts: Sequence[str]) -> dict[str, Attribute]:
    """The attributes, some of them with other edges: ``NAME=EDGE,EDGE,…``.

    Raises:
        OutputError: A text is none of this form.
    """
    found = dict(ATTRIBUTES)
    for text in texts:
        name, equals, values = text.partition("=")
        try:
            edges = tuple(float(part) for part in values.split(","))
        except ValueError:
            edges = ()
        sound = bool(edges) and bool(np.isfinite(edges).all()) and list(edges) == sorted(set(edges))
        if name not in ATTRIBUTES:
            raise OutputError(f"--bins {text}: nothing is called {name!r}{nearest(name, found)}")
        if not equals or not sound:
            raise OutputError(
                f"--bins {text}: expected NAME=EDGE,EDGE,… with ascending finite numbers, as in "
                "distance=5,20,80"
            )
        found[name] = replace(found[name], edges=edges)
    return found


def pixel_bins(frame: LoadedFrame, attributes: Attributes) -> dict[str, NDArray[np.int64]]:
    """Bin of each pixel [h, w] for each attribute that the frame has; -1 for none.

    Sizes and shares are those of the instance that a pixel shows; pixels without one have none.
    """
    shape = (frame.height, frame.width)
    result: dict[str, NDArray[np.int64]] = {}
    for name, one in attributes.items():
        if one.of is not None:
            values = np.full(shape, one.of(frame.sidecar))
        elif name == DISTANCE.name:
            if "depth" not in frame.passes:
                continue
            values = frame.passes["depth"]
        else:
            needed = QUANTITIES[one.column][1]
            if not frame.table or any(column not in frame.table for column in needed):
                continue
            ids = frame.table["id"]
            by_id = np.concatenate([quantity(frame, one.column).astype(np.float64), [np.nan]])
            instance = frame.passes["instance"]
            slot = np.minimum(np.searchsorted(ids, instance), len(ids) - 1) if len(ids) else 0
            known = (ids[slot] == instance) if len(ids) else np.zeros(shape, np.bool_)
            values = by_id[np.where(known, slot, len(ids))]
        result[name] = one.numbers(values)
    return result


def filled(one: Attribute, rows: Sequence[tuple[Cell, ...] | None]) -> list[tuple[Cell, ...]]:
    """Rows of a table, each after the text of its bin; None: the bin is empty."""
    return [(one.text(i), *row) for i, row in enumerate(rows) if row is not None]
