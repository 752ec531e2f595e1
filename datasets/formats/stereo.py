"""Finds stereo pairs among the cameras of a rig."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from scenec.datasets.formats.poses import RIGID, relative
from scenec.datasets.source import FrameRef, record_of
from scenec.schemas.codec import UNSET
from scenec.schemas.records import FrameRecord


def pair_up(cameras: Mapping[str, Sequence[FrameRef]]) -> list[tuple[str, ...]]:
    """Groups cameras of a rig into rectified pairs (left, right), and single ones.

    Pairs first of which both are the other's partner, then those of which one is, then any others;
    none of a camera whose partner is here but another.

    Args:
        cameras: Name -> frames.
    """
    partners = {name: partner_of(refs) for name, refs in cameras.items()}

    def links(pair: tuple[str, str]) -> int:
        """Counts how many of the two name the other."""
        return sum(partners[a] == b for a, b in (pair, pair[::-1]))

    pairs: dict[str, tuple[str, ...]] = {}
    every = list(itertools.combinations(cameras, 2))
    for a, b in sorted(every, key=links, reverse=True):
        elsewhere = not links((a, b)) and any(partners[name] in cameras for name in (a, b))
        if a in pairs or b in pairs or elsewhere:
            continue
        apart = baseline(cameras[a], cameras[b])
        if apart:
            pairs[a] = pairs[b] = (a, b) if apart > 0.0 else (b, a)
    # In the order of their first cameras, each once.
    return list(dict.fromkeys(pairs.get(name, (name,)) for name in cameras))


def partner_of(frames: Sequence[FrameRef]) -> str | None:
    """Returns the camera that disparity goes to, by the first readable sidecar."""
    record = first_record(frames)
    return None if record is None else record.partner or None


def before_partners(frames: Sequence[FrameRef]) -> bool:
    """Tells whether a camera's frames have disparity and do not say to which camera."""
    record = first_record(frames)
    return record is not None and "disparity" in record.passes and record.partner is UNSET


def first_record(frames: Sequence[FrameRef]) -> FrameRecord | None:
    """Finds the first record that can be read."""
    return next((one for one in map(record_of, frames) if one is not None), None)


def baseline(a: Sequence[FrameRef], b: Sequence[FrameRef]) -> float:
    """Returns how far b lies to the right of a, meters; 0 if they are no rectified pair."""
    others = {ref.sample: ref for ref in b}
    for ref in a:
        if ref.sample not in others:
            continue
        one, two = record_of(ref), record_of(others[ref.sample])
        if one is None or two is None:
            continue
        if (one.resolution, one.intrinsics) != (two.resolution, two.intrinsics):
            return 0.0
        offset = relative(np.array(one.camera_to_world), np.array(two.camera_to_world))
        aligned = np.eye(4)
        aligned[0, 3] = offset[0, 3]
        if np.abs(offset - aligned).max() > RIGID or abs(offset[0, 3]) <= RIGID:
            return 0.0
        return float(offset[0, 3])
    return 0.0
