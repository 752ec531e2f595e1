"""Counts a dataset's content in numbers that add up over frames, in any order, bit for bit.

Everything is a whole number in fixed bins (``scenec.datasets.bins``), a least or a greatest value,
or a set of ids: no sum of floats, whose last bits would tell in which order frames came.

Instances are lines of the frames' tables (``scenec.schemas.instances``) after filters, those that
are to be ignored left out; *distinct* ones count once a batch, however many frames show them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets import bins
from scenec.datasets.idset import IdSet, packed
from scenec.datasets.source import LoadedFrame
from scenec.schemas.codec import UNSET, JsonObject, encode
from scenec.schemas.picture import luminance

#: Version of what stands in ``statistics.json``.
VERSION = 1

#: Nested dictionaries whose leaves are whole numbers.
Counts = JsonObject

_UNLABELED = ""
#: Angles are rounded to this many decimals before they are put in a bin, since the last bit of an
#: arc tangent is not the same on every machine and round angles are common.
_DECIMALS = 6
#: Of a sidecar's shutter, what is the camera's.


def measure(frame: LoadedFrame) -> JsonObject:
    """A frame's part of the statistics: JSON values, small, that ``Statistics.add`` takes."""
    counts: Counts = {"frames": 1, "pixels": frame.width * frame.height}
    bounds: dict[str, list[float]] = {}
    levels = {
        level: _labels(frame.passes[f"label.{level}"], names)
        for level, names in frame.labels.items()
        if f"label.{level}" in frame.passes
    }
    if levels:
        counts["levels"] = levels
    if "depth" in frame.passes:
        depth = bins.length_counts(frame.passes["depth"])
        counts["depth"] = {"bins": depth.counts, "nothing": depth.infinite}
        if depth.low <= depth.high:
            bounds["depth_m"] = [depth.low, depth.high]
    ids_of_batch: dict[str, dict[str, str]] = {}
    if frame.table:
        counts["instances"], ids = _instances(frame)
        shown = float((~frame.ignored).sum())
        bounds["instances"] = [shown, shown]
        ids_of_batch = {frame.ref.batch_name: ids}
    counts["view"] = _view(frame, bounds)
    sun = _sun(frame, bounds)
    if sun:
        counts["sun"] = sun
    counts["made"] = _rendering(frame, bounds)
    return {"counts": counts, "bounds": bounds, "seen": ids_of_batch}


class Statistics:
    """Sums over frames; of a size that does not grow with their number.

    What grows is the sets of ids seen, a bit an instance of a batch at most; ``close`` turns those
    of a batch that is over into a number.
    """

    def __init__(self) -> None:
        self._counts: Counts = {}
        self._bounds: dict[str, list[float]] = {}
        self._seen: dict[str, dict[str, IdSet]] = {}
        self._closed: dict[str, int] = {}

    @property
    def frames(self) -> int:
        """Counts the frames added."""
        return int(self._counts.get("frames", 0))

    def add(self, measured: JsonObject) -> None:
        """Add what ``measure`` or ``state`` returned."""
        _sum_into(self._counts, measured["counts"])
        for name, (low, high) in measured["bounds"].items():
            mine = self._bounds.setdefault(name, [low, high])
            mine[:] = [min(mine[0], low), max(mine[1], high)]
        for batch, classes in measured["seen"].items():
            for name, text in classes.items():
                self._seen.setdefault(batch, {}).setdefault(name, IdSet()).add_text(text)
        for name, count in measured.get("closed", {}).items():
            self._closed[name] = self._closed.get(name, 0) + count

    merge = add

    def close(self, batch: str) -> None:
        """Forget which instances of a batch were seen, and keep how many: no more will come."""
        for name, found in self._seen.pop(batch, {}).items():
            self._closed[name] = self._closed.get(name, 0) + len(found)

    def state(self) -> JsonObject:
        """All of it as JSON values that ``merge`` takes; the same whatever order frames came in."""
        return {
            "counts": _sorted(self._counts),
            "bounds": _sorted(self._bounds),
            "seen": {
                batch: {name: found.text() for name, found in sorted(classes.items())}
                for batch, classes in sorted(self._seen.items())
            },
            "closed": _sorted(self._closed),
        }

    def as_json(self) -> JsonObject:
        """Returns the content of ``statistics.json``: histograms with edges, shares, angles."""
        counts = _sorted(self._counts)
        result: dict[str, Any] = {
            "version": VERSION,
            "frames": self.frames,
            "pixels": counts.get("pixels", 0),
            "levels": {
                level: _level_json(entry) for level, entry in counts.get("levels", {}).items()
            },
        }
        if "depth" in counts:
            result["depth"] = {
                **bins.LENGTH.table(counts["depth"]["bins"]),
                "nothing": counts["depth"]["nothing"],
                "range_m": self._bounds.get("depth_m"),
            }
        if "instances" in counts:
            result["instances"] = _instances_json(counts["instances"], self._distinct())
            result["instances"]["most_in_a_frame"] = int(self._bounds["instances"][1])
        if "view" in counts:
            result["view"] = _view_json(counts["view"], self._bounds)
        if "sun" in counts:
            result["sun"] = {
                "elevation_edges_deg": list(bins.ELEVATION.edges),
                "azimuth_edges_deg": [float(k) for k in range(0, 361, 30)],
                "frames": {
                    row: [columns.get(str(k), 0) for k in range(12)]
                    for row, columns in sorted(
                        counts["sun"].get("directions", {}).items(), key=lambda item: int(item[0])
                    )
                },
                "without": counts["sun"].get("without", 0),
                "elevation_deg": self._bounds.get("sun_elevation_deg"),
                "irradiance": self._bounds.get("sun_irradiance"),
            }
        result["made"] = {
            key: [{**json.loads(text), "frames": count} for text, count in values.items()]
            for key, values in counts.get("made", {}).items()
        }
        if "noise" in self._bounds:
            result["relative_rms_noise"] = self._bounds["noise"]
        return result

    def _distinct(self) -> dict[str, int]:
        distinct = dict(self._closed)
        for classes in self._seen.values():
            for name, found in classes.items():
                distinct[name] = distinct.get(name, 0) + len(found)
        return distinct


def _labels(picture: NDArray[Any], names: Mapping[int, str]) -> Counts:
    """Pixels of each label, and that this frame has it."""
    keys = np.array(sorted(names), np.uint32)
    numbers, none, other = bins.id_counts(picture, keys)
    pixels = {
        names[key]: count
        for key, count in zip(keys.tolist(), numbers.tolist(), strict=True)
        if count
    }
    if none:
        pixels[_UNLABELED] = none
    counts: Counts = {
        "labels": {name: {"pixels": count, "frames": 1} for name, count in pixels.items()},
        "ids": {name: {str(number): 0} for number, name in names.items()},
    }
    if other:
        counts["unknown"] = other
    return counts


def _instances(frame: LoadedFrame) -> tuple[Counts, dict[str, str]]:
    """Histograms of a frame's instances class by class, and which they are, as ``packed``."""
    taken = ~frame.ignored
    table = {name: column[taken] for name, column in frame.table.items()}
    counts: Counts = {
        "ignored": int(frame.ignored.sum()),
        "per_frame": bins.COUNT.counts(np.array([taken.sum()], np.float64)),
        "classes": {},
    }
    ids: dict[str, str] = {}
    kinds, kind = np.unique(table["class"], return_inverse=True)
    for number, name in enumerate(kinds.tolist()):
        one = {key: column[kind == number] for key, column in table.items()}
        counts["classes"][name] = {"frames": 1, "seen": len(one["id"]), **_histograms(one)}
        ids[name] = packed(np.unique(one["id"]))
    return counts, ids


def _histograms(table: Mapping[str, NDArray[Any]]) -> Counts:
    counts: Counts = {"area": bins.AREA.counts(table["pixels"].astype(np.float64))}
    if "truncated" in table:
        counts["at_border"] = int(table["truncated"].sum())
    if "size_x" in table:
        sides = [table[f"size_{axis}"] for axis in "xyz"]
        counts["size"] = bins.LENGTH.counts(np.max(np.stack(sides), axis=0))
    if "depth_mean" in table:
        counts["distance"] = bins.LENGTH.counts(table["depth_mean"])
    if "amodal" in table:
        counts["occlusion"] = bins.share_counts(table["pixels"], table["amodal"])
    if "amodal_full" in table:
        counts["truncation"] = bins.share_counts(table["amodal"], table["amodal_full"])
    return counts


def _view(frame: LoadedFrame, bounds: dict[str, list[float]]) -> Counts:
    """Counts the camera's position and direction."""
    pose = frame.camera_to_world
    x_axis, forward = pose[:3, 0].tolist(), pose[:3, 2].tolist()
    level = math.hypot(forward[0], forward[1])
    pitch = math.degrees(math.atan2(forward[2], level))
    counts: Counts = {"pitch": _angle(bins.ELEVATION, pitch, 90.0)}
    if level > 1e-6:
        # Looking straight up or down there is no heading, and no roll about it.
        counts["heading"] = _angle(
            bins.BEARING, math.degrees(math.atan2(forward[0], forward[1])) % 360.0
        )
        # The level direction to the right of the heading, and what is above it.
        right = (forward[1] / level, -forward[0] / level, 0.0)
        up = (right[1] * forward[2], -right[0] * forward[2], level)
        counts["roll"] = _angle(
            bins.ROLL,
            -math.degrees(math.atan2(_dot(x_axis, up), _dot(x_axis, right))),
        )
    for axis, value in zip("xyz", pose[:3, 3].tolist(), strict=True):
        bounds[f"camera_{axis}_m"] = [value, value]
    height = frame.sidecar.height_above_surface_m
    if height is not None and height is not UNSET:
        counts["height"] = bins.LENGTH.counts(np.array([height], np.float64))
        bounds["camera_height_m"] = [float(height), float(height)]
    return counts


def _dot(a: Iterable[float], b: Iterable[float]) -> float:
    return math.fsum(x * y for x, y in zip(a, b, strict=True))


def _angle(of: bins.Bins, degrees: float, closed: float | None = None) -> Counts:
    """One angle's bin; ``closed`` is an edge that belongs to the bin below it."""
    value = round(degrees, _DECIMALS)
    if of is bins.BEARING:
        value %= 360.0
    elif of is bins.ROLL and value >= 180.0:
        value -= 360.0
    if value == closed:
        value = math.nextafter(value, 0.0)
    return of.counts(np.array([value]))


def _sun(frame: LoadedFrame, bounds: dict[str, list[float]]) -> Counts:
    """Counts the sun's direction; nothing where the sidecar does not say it."""
    sun = frame.sidecar.sun
    if sun is UNSET:
        return {}
    if sun is None:
        return {"without": 1}
    elevation = round(float(sun.elevation_deg), _DECIMALS)
    azimuth = round(float(sun.azimuth_deg), _DECIMALS) % 360.0
    row = min(int((elevation + 90.0) // 10.0), 17)
    bounds["sun_elevation_deg"] = [elevation, elevation]
    light = np.array(sun.irradiance, np.float64)
    bounds["sun_irradiance"] = [float(luminance(light))] * 2
    return {"directions": {str(row): {str(int(azimuth // 30.0)): 1}}}


def _rendering(frame: LoadedFrame, bounds: dict[str, list[float]]) -> Counts:
    """Counts the backend and the camera of the frame."""
    record = frame.sidecar
    how = {
        "backend": record.backend,
        "version": record.backend_version,
        "samples_per_pixel": record.spp,
        "noise_seed": record.noise_seed,
        "denoised": record.denoised,
        "passes": record.passes,
        **({} if record.half is None else {"rgb": "half"}),
    }
    shutter = record.shutter
    camera = {
        "camera": frame.ref.camera,
        "resolution": record.resolution,
        "intrinsics": record.intrinsics,
        **({} if record.lens is None else {"lens": encode(record.lens)}),
        # Where it is while the shutter is open is another in each frame.
        **(
            {}
            if shutter is None
            else {"shutter": {"readout_s": shutter.readout_s, "direction": shutter.direction}}
        ),
    }
    noise = record.error.relative_rms
    if noise is not None:
        bounds["noise"] = [float(noise), float(noise)]
    return {
        "rendering": {json.dumps(how, ensure_ascii=False): 1},
        "cameras": {json.dumps(camera, ensure_ascii=False): 1},
    }


def _level_json(entry: Counts) -> dict[str, Any]:
    labels = entry["labels"]
    total = sum(label["pixels"] for label in labels.values()) + entry.get("unknown", 0)
    ids = {name: min(map(int, numbers)) for name, numbers in entry.get("ids", {}).items()}
    rest = labels.get(_UNLABELED, {"pixels": 0, "frames": 0})
    return {
        "pixels": total,
        "unlabeled": rest["pixels"],
        "unknown": entry.get("unknown", 0),
        "labels": {
            name: {
                "id": number,
                **labels.get(name, {"pixels": 0, "frames": 0}),
                "share": labels.get(name, {"pixels": 0})["pixels"] / total if total else 0.0,
            }
            for name, number in sorted(ids.items(), key=lambda item: item[1])
        },
    }


_TABLES = {
    "area": bins.AREA.table,
    "size": bins.LENGTH.table,
    "distance": bins.LENGTH.table,
    "occlusion": bins.share_table,
    "truncation": bins.share_table,
}


def _instances_json(counts: Counts, distinct: Mapping[str, int]) -> dict[str, Any]:
    classes = counts["classes"]
    total: Counts = {}
    for entry in classes.values():
        _sum_into(total, entry)
    return {
        "seen": total.get("seen", 0),
        "distinct": sum(distinct.values()),
        "ignored": counts["ignored"],
        "per_frame": bins.COUNT.table(counts["per_frame"]),
        "all": _tables(total),
        "classes": {
            name: {
                "seen": entry["seen"],
                "distinct": distinct.get(name, 0),
                "frames": entry["frames"],
                "at_border": entry.get("at_border", 0),
                **_tables(entry),
            }
            for name, entry in classes.items()
        },
    }


def _tables(entry: Counts) -> dict[str, Any]:
    return {name: table(entry[name]) for name, table in _TABLES.items() if name in entry}


def _view_json(counts: Counts, bounds: Mapping[str, list[float]]) -> dict[str, Any]:
    angles = {"pitch": bins.ELEVATION, "roll": bins.ROLL, "heading": bins.BEARING}
    result: dict[str, Any] = {
        name: of.table(counts[name]) for name, of in angles.items() if name in counts
    }
    if "height" in counts:
        result["height_above_surface"] = {
            **bins.LENGTH.table(counts["height"]),
            "range_m": bounds["camera_height_m"],
        }
    result["position_m"] = {axis: bounds[f"camera_{axis}_m"] for axis in "xyz"}
    return result


def _sum_into(mine: Counts, other: Mapping[str, Any]) -> None:
    for key, value in other.items():
        if isinstance(value, Mapping):
            _sum_into(mine.setdefault(key, {}), value)
        else:
            mine[key] = mine.get(key, 0) + value


def _sorted(value: Any) -> Any:
    """A copy with keys in order, whatever order they came in."""
    if isinstance(value, Mapping):
        return {key: _sorted(value[key]) for key in sorted(value)}
    return list(value) if isinstance(value, list) else value
