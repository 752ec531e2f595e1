"""Trackers that link detections of a sequence, and TrackEval's numbers of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from scenec.datasets.evaluate.instances import quiet
from scenec.schemas.errors import OutputError

Ids = NDArray[np.int64]
#: Least overlap of boxes that are linked.
_LEAST_IOU = 0.2


@dataclass(frozen=True)
class Shown:
    """What one picture of a sequence shows.

    Attributes:
        ids: Of objects, [n].
        masks: Their pixels, bool [n, h, w].
        boxes: x0, y0, x1, y1, ends excluded, [n, 4].
    """

    ids: Ids
    masks: NDArray[np.bool_]
    boxes: NDArray[np.float64]


def numbered_anew(frames: Sequence[Shown]) -> list[Ids]:
    """No tracker: every object gets a new number in every picture."""
    ends = np.cumsum([len(one.ids) for one in frames])
    return [np.arange(end - len(one.ids), end) for one, end in zip(frames, ends, strict=True)]


def linked_by_boxes(frames: Sequence[Shown]) -> list[Ids]:
    """A plain tracker: boxes of neighboring pictures that overlap most are the same object."""
    found: list[Ids] = []
    last: Shown | None = None
    free = 0
    for one in frames:
        ids = np.full(len(one.ids), -1)
        if last is not None:
            overlap = _box_iou(one.boxes, last.boxes)
            for new, old in zip(*linear_sum_assignment(-overlap), strict=True):
                if overlap[new, old] >= _LEAST_IOU:
                    ids[new] = found[-1][old]
        new = ids < 0
        ids[new] = free + np.arange(new.sum())
        free += int(new.sum())
        found.append(ids)
        last = one
    return found


def _box_iou(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    both = np.prod(np.maximum(high - low, 0), axis=-1)
    areas = [np.prod(boxes[:, 2:] - boxes[:, :2], axis=-1) for boxes in (a, b)]
    return both / (areas[0][:, None] + areas[1][None] - both)


def scores(truth: Sequence[Shown], found: Sequence[Shown], ids: Sequence[Ids]) -> dict[str, float]:
    """TrackEval's HOTA, MOTA and IDF1, and how often a number changed.

    Args:
        truth: Each picture's objects.
        found: Each picture's detections.
        ids: Which the tracker gave them.

    Raises:
        OutputError: TrackEval is not installed.
    """
    with quiet():
        try:
            from trackeval.metrics import CLEAR, HOTA, Identity
        except ImportError as error:
            raise OutputError(
                "tracks are judged by TrackEval: pip install --no-deps trackeval (its other "
                f"packages are those of the extras) ({error})"
            ) from error
    data = _sequence(truth, found, ids)
    printed = {"PRINT_CONFIG": False}
    hota = HOTA().eval_sequence(data)
    clear = CLEAR(printed).eval_sequence(data)
    identity = Identity(printed).eval_sequence(data)
    return {
        "HOTA": float(np.mean(hota["HOTA"])),
        "DetA": float(np.mean(hota["DetA"])),
        "AssA": float(np.mean(hota["AssA"])),
        "MOTA": float(clear["MOTA"]),
        "IDF1": float(identity["IDF1"]),
        "switches": float(clear["IDSW"]),
    }


def _sequence(truth: Sequence[Shown], found: Sequence[Shown], ids: Sequence[Ids]) -> dict[str, Any]:
    """As TrackEval's metrics take it: ids from 0 without gaps."""
    true_ids = _without_gaps([one.ids for one in truth])
    own_ids = _without_gaps(ids)
    overlaps = [_mask_iou(a.masks, b.masks) for a, b in zip(truth, found, strict=True)]
    return {
        "num_timesteps": len(truth),
        "gt_ids": true_ids,
        "tracker_ids": own_ids,
        "similarity_scores": overlaps,
        "num_gt_dets": sum(map(len, true_ids)),
        "num_tracker_dets": sum(map(len, own_ids)),
        "num_gt_ids": len(np.unique(np.concatenate(true_ids))),
        "num_tracker_ids": len(np.unique(np.concatenate(own_ids))),
    }


def _without_gaps(ids: Sequence[Ids]) -> list[Ids]:
    known = np.unique(np.concatenate(ids))
    return [np.searchsorted(known, one) for one in ids]


def _mask_iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> NDArray[np.float64]:
    x, y = (m.reshape(len(m), -1).astype(np.float64) for m in (a, b))
    both = x @ y.T
    return both / np.maximum(x.sum(axis=1)[:, None] + y.sum(axis=1)[None] - both, 1.0)
