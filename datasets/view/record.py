"""Builds the page's record of one frame: layers, facts, and its part of the statistics."""

from __future__ import annotations

import json
import math
import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets import bins
from scenec.datasets.motion_colors import UNITS, lengths
from scenec.datasets.source import LoadedFrame
from scenec.datasets.view.layers import Fineness, Layer, depth_error
from scenec.datasets.view.storing import store_frame
from scenec.schemas.codec import JsonObject
from scenec.schemas.records import FrameRecord

#: Edges of the histograms' bins: bin k is from edge k - 1 to edge k. Bin 0 of ``hidden`` is exactly
#: 0, its last one exactly 1.
EDGES = {
    "distances": list(bins.LENGTH.edges),
    "sizes": list(bins.AREA.edges),
    "hidden": list(bins.TENTHS),
}
#: Columns of a frame's table of instances that the page shows.
_TOLD = ("pixels", "amodal", "depth_min", "truncated")
#: JsonObject of a sidecar that the page shows as they are.
_FACTS = ("backend_version", "device", "spp", "noise_seed", "exposure_ev", "denoised", "time_s")


@dataclass
class Tally:
    """Counts over frames; adding two gives that of all their frames.

    Attributes:
        pixels: Level -> label id -> pixels.
        instances: Class -> instances seen, one of them in each frame that shows it.
        sizes: Instances by their pixels, in bins of ``EDGES``.
        distances: Pixels by their depth, likewise.
        hidden: Instances by 1 - pixels / amodal, likewise; empty without that column.
        motion: Pass (flow and its like) -> pixels by how far its values are from 0, in the bins of
            ``distances``.
    """

    pixels: dict[str, Counter[int]] = field(default_factory=dict)
    instances: Counter[str] = field(default_factory=Counter)
    sizes: Counter[int] = field(default_factory=Counter)
    distances: Counter[int] = field(default_factory=Counter)
    hidden: Counter[int] = field(default_factory=Counter)
    motion: dict[str, Counter[int]] = field(default_factory=dict)

    def add(self, other: Tally) -> None:
        """Adds the counts of other frames."""
        for level, counts in other.pixels.items():
            self.pixels.setdefault(level, Counter()).update(counts)
        self.instances.update(other.instances)
        self.sizes.update(other.sizes)
        self.distances.update(other.distances)
        self.hidden.update(other.hidden)
        for name, counts in other.motion.items():
            self.motion.setdefault(name, Counter()).update(counts)

    def as_json(self) -> JsonObject:
        """In a fixed order: pairs of bin and count."""
        return {
            "pixels": {level: sorted(c.items()) for level, c in sorted(self.pixels.items())},
            "instances": sorted(self.instances.items()),
            "sizes": sorted(self.sizes.items()),
            "distances": sorted(self.distances.items()),
            "hidden": sorted(self.hidden.items()),
            "motion": {name: sorted(c.items()) for name, c in sorted(self.motion.items())},
        }


@dataclass(frozen=True)
class Record:
    """A frame on the page.

    Attributes:
        text: Its element's content: a line of JSON, then a line of base64 a layer.
        index: What the page knows of it before it is shown.
        tally: What it adds to the statistics.
        depth_error: Most that a stored depth is off, relative.
        stored: Whether all its pixels are stored.
    """

    text: bytes
    index: JsonObject
    tally: Tally
    depth_error: float
    stored: bool


def _half(frame: LoadedFrame) -> float:
    """Tangent of half of the field of view; of fisheyes and panoramas, of 80 degrees at most."""
    half = 0.5 * frame.width / abs(float(frame.intrinsics[0, 0]))
    if frame.lens is None or frame.lens.planar:
        return half
    return math.tan(min(half, math.radians(80.0)))


def record(frame: LoadedFrame, fineness: Fineness) -> Record:
    """Builds the page's record of a frame.

    Raises:
        FrameError: A picture of it is missing or damaged.
    """
    layers, size, shown = store_frame(frame, fineness)
    told = _table(frame.table, shown)
    if told:
        layers.append(Layer({"name": "table", "code": "json"}, zlib.compress(plain_json(told), 9)))
    intrinsics, pose, shutter = frame.intrinsics, frame.camera_to_world, frame.sidecar.shutter
    facts = {
        "size": [frame.width, frame.height],
        "stored": list(size),
        "K": [short(v, 12) for v in intrinsics[:2].ravel().tolist()],
        "pose": [short(v, 14) for v in pose[:3].ravel().tolist()],
        **({} if frame.lens is None else {"lens": frame.lens.model}),
        # Its rows have poses of their own.
        **({"rolls": True} if shutter is not None and shutter.readout_s else {}),
        "layers": [layer.facts for layer in layers],
        "facts": {k: v for k in _FACTS if (v := getattr(frame.sidecar, k)) is not None},
    }
    text = b"\n".join([plain_json(facts), *(layer.text() for layer in layers)])
    errors = [depth_error(layer.facts) for layer in layers if layer.facts["code"] == "steps"]
    tally = _measure(frame)
    index = {
        "seconds": {k: short(v, 4) for k, v in (frame.sidecar.seconds or {}).items()},
        "error": short(frame.sidecar.error.relative_rms, 4),
        "eye": [short(v, 9) for v in pose[:3, 3].tolist()],
        "ahead": [short(v, 4) for v in pose[:3, 2].tolist()],
        "half": short(_half(frame), 4),
        "size": [frame.width, frame.height],
        "passes": [layer.facts["name"] for layer in layers if layer.facts["name"] != "table"],
        "pixels": {
            level: {str(i): n for i, n in sorted(c.items())} for level, c in tally.pixels.items()
        },
        "instances": len(frame.table["id"]) if frame.table else None,
        "sun": _sun(frame.sidecar),
    }
    return Record(text, index, tally, max(errors, default=0.0), size == (frame.width, frame.height))


def short(value: object, digits: int) -> float | int | None:
    """A number with so many digits; None where it is none."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return None
    if isinstance(value, int):
        return value
    rounded = float(f"{value:.{digits}g}")
    return int(rounded) if rounded.is_integer() and abs(rounded) < 2**53 else rounded


def plain_json(value: object) -> bytes:
    """JSON that can stand in an element: without what is markup."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("&", "\\u0026").encode()


def _table(table: dict[str, NDArray[Any]], visible: NDArray[np.uint32]) -> dict[str, Any]:
    """The lines of a frame's table that the stored picture shows, as columns."""
    if not table:
        return {}
    keep = np.flatnonzero(np.isin(table["id"], visible))
    classes, of_class = np.unique(table["class"][keep], return_inverse=True)
    return {
        "id": table["id"][keep].tolist(),
        "classes": classes.tolist(),
        "class": of_class.tolist(),
        "local": table["local_id"][keep].tolist(),
        **{
            name: [short(v, 6) for v in table[name][keep].tolist()]
            for name in _TOLD
            if name in table
        },
    }


def _measure(frame: LoadedFrame) -> Tally:
    tally = Tally()
    for name, ids in frame.passes.items():
        if name.startswith("label."):
            found, counts = np.unique(ids, return_counts=True)
            level = name.removeprefix("label.")
            tally.pixels[level] = Counter(dict(zip(found.tolist(), counts.tolist(), strict=True)))
    depth = frame.passes.get("depth")
    if depth is not None:
        tally.distances = _counter(bins.length_counts(depth).counts)
    for name in UNITS:
        if name in frame.passes:
            far = lengths(frame.passes[name])
            tally.motion[name] = _counter(bins.length_counts(far).counts)
    table = frame.table
    if table:
        tally.instances = Counter(table["class"].tolist())
        tally.sizes = _counter(bins.AREA.counts(table["pixels"].astype(np.float64)))
        if "amodal" in table:
            tally.hidden = _counter(bins.share_counts(table["pixels"], table["amodal"]))
    return tally


def _counter(counts: bins.Counts) -> Counter[int]:
    return Counter({int(number): count for number, count in counts.items()})


def _sun(record: FrameRecord) -> list[float | int | None] | None:
    """Elevation and bearing of the brightest sun, degrees; None where the sidecar has none."""
    if not record.sun:
        return None
    return [short(record.sun.elevation_deg, 4), short(record.sun.azimuth_deg, 4)]
