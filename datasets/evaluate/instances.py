"""Instances and boxes: average precision and recall, by pycocotools' own COCOeval.

The numbers of the whole are COCO's (https://cocodataset.org/#detection-eval). In parts, an object
outside of the part is one to be ignored, exactly as COCO ignores objects of other areas: finding
it is neither right nor wrong. A detection that finds nothing belongs to no distance, size or
occlusion, so it counts in each of their parts; to a part by light it belongs with its picture.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.evaluate.breakdown import Attribute, Attributes, filled
from scenec.datasets.evaluate.evaluation import Cell, Evaluation, Table
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import OutputError

NEEDED = "instances are judged by pycocotools: pip install 'scenec[coco]'"
#: Most detections of a picture and class, as COCO has it.
MAX_DETECTIONS = 100
_TITLES = {"segm": "masks", "bbox": "boxes"}
#: Row of COCO's precision and recall -> name of the area's range.
_AREAS = ("", "_small", "_medium", "_large")

Coco = JsonObject


def evaluate_instances(
    path: Path,
    detections: Sequence[JsonObject],
    against: Path,
    truth: Coco,
    attributes: Attributes,
    max_detections: int = MAX_DETECTIONS,
) -> Evaluation:
    """Hold detections against annotations.

    Args:
        path: Where the detections are from.
        detections: As ``coco_files.read_detections`` returns them.
        against: Where the truth is from.
        truth: A COCO document; annotations may hold ``depth``, ``size``, ``occlusion`` and
            ``truncation``, images ``sun_elevation_deg``.
        attributes: Bins.
        max_detections: Of a picture and class; the surest of them count.

    Raises:
        OutputError: pycocotools is not installed, or the truth holds no object.
    """
    if not any(not one.get("iscrowd") for one in truth["annotations"]):
        raise OutputError(f"{against}: holds no object to be found")
    masked = [all("segmentation" in a for a in of) for of in (truth["annotations"], detections)]
    kinds = ["segm"] if detections and all(masked) else []
    found = Evaluation("instances", path, against)
    found.settings = {
        "kinds": [*kinds, "bbox"], "max_detections": max_detections,
        "images": len(truth["images"]), "objects": len(truth["annotations"]),
        "detections": len(detections),
    }  # fmt: skip
    if not kinds and any("segmentation" in d for d in detections):
        lacking = "the truth" if not masked[0] else "a detection"
        found.notes.append(f"masks are not judged: {lacking} has an object without one")
    fullest = _most_in_a_class(truth["annotations"])
    if fullest > max_detections:
        found.notes.append(
            f"a picture shows {fullest} objects of one class, and only {max_detections} detections "
            "of each count, as COCO has it; --max-detections counts more"
        )
    for number, kind in enumerate([*kinds, "bbox"]):
        judge = _judge(truth, detections, kind, max_detections)
        for name, value in summary(judge).items():
            found.measures[f"{kind}_{name}"] = value
        found.tables.append(_by_class(judge, truth, detections, kind))
        if number == 0:
            found.arrays["precision"] = _precision_curve(judge)
            for one in attributes.values():
                table = _by_bin(one, truth, detections, kind, max_detections)
                if table is not None:
                    found.tables.append(table)
    return found


def summary(judge: Any) -> dict[str, float | None]:
    """COCO's twelve numbers of a ``COCOeval`` that accumulated, at its most detections.

    ``summarize`` of COCOeval gives the same, but for other most detections than 100.
    """
    measures: dict[str, float | None] = {
        "ap": _mean(judge.eval["precision"][:, :, :, 0, -1]),
        "ap50": _mean(judge.eval["precision"][0, :, :, 0, -1]),
        "ap75": _mean(judge.eval["precision"][5, :, :, 0, -1]),
    }
    for number, name in enumerate(_AREAS):
        if name:
            measures[f"ap{name}"] = _mean(judge.eval["precision"][:, :, :, number, -1])
    for number, most in enumerate(judge.params.maxDets):
        measures[f"ar_{most}"] = _mean(judge.eval["recall"][:, :, 0, number])
    for number, name in enumerate(_AREAS):
        if name:
            measures[f"ar{name}"] = _mean(judge.eval["recall"][:, :, number, -1])
    return measures


def _mean(values: NDArray[Any]) -> float | None:
    """Over what is defined; COCOeval writes -1 where there is no object."""
    known = values[values > -1]
    return float(known.mean()) if known.size else None


def _precision_curve(judge: Any) -> NDArray[np.float64]:
    """Precision at COCO's 101 recalls for IoU 0.5, 0.75 and the mean of all, [101, 3]."""
    precision = np.where(judge.eval["precision"] > -1, judge.eval["precision"], np.nan)
    whole = precision[:, :, :, 0, -1]
    defined = np.isfinite(whole).any(axis=(0, 1))
    mean = np.nanmean(whole[:, :, defined], axis=2)
    return np.stack([mean[0], mean[5], mean.mean(axis=0)], axis=1)


def _by_class(judge: Any, truth: Coco, detections: Sequence[dict[str, Any]], kind: str) -> Table:
    names = {one["id"]: one["name"] for one in truth["categories"]}
    rows: list[tuple[Cell, ...]] = []
    for at, number in enumerate(judge.params.catIds):
        precision = judge.eval["precision"][:, :, at, 0, -1]
        rows.append(
            (
                names[number],
                _mean(precision),
                _mean(precision[0]),
                _mean(judge.eval["recall"][:, at, 0, -1]),
                sum(1 for a in truth["annotations"] if a["category_id"] == number),
                sum(1 for d in detections if d["category_id"] == number),
            )
        )
    columns = ("class", "ap", "ap50", "ar", "objects", "detections")
    return Table(f"class_{kind}", f"{_TITLES[kind]} by class", columns, rows)


def _by_bin(
    one: Attribute,
    truth: Coco,
    detections: Sequence[dict[str, Any]],
    kind: str,
    max_detections: int,
) -> Table | None:
    """Measures by bins; None where the truth has the attribute of no object, or as no number."""
    whole = one.of is not None
    try:
        of_image = {
            image["id"]: float(image.get(one.key, np.nan)) if whole else np.nan
            for image in truth["images"]
        }
        values = [
            # Parts have none of what is known of whole objects alone.
            of_image[a["image_id"]] if whole else float(a.get(one.key, np.nan))
            for a in truth["annotations"]
        ]
    except (TypeError, ValueError):
        return None
    bins = one.numbers(np.array(values, np.float64))
    counts = np.bincount(
        bins[[not a.get("iscrowd") for a in truth["annotations"]] & (bins >= 0)],
        minlength=one.count,
    )
    shown = np.flatnonzero(counts)
    if not len(shown):
        return None
    # COCOeval ignores what is outside of a range of areas. With the number of the bin in the area's
    # place it does so for any quantity; NaN lies outside of no range.
    numbered: Coco = {
        **truth,
        "annotations": [
            {**a, "area": number} for a, number in zip(truth["annotations"], bins, strict=True)
        ],
    }
    image_bins = dict(zip(of_image, one.numbers(np.array(list(of_image.values()))), strict=True))
    areas = [image_bins[d["image_id"]] if whole else np.nan for d in detections]
    judge = _judge(numbered, detections, kind, max_detections, areas, shown.tolist())
    rows: list[tuple[Cell, ...] | None] = [None] * one.count
    for at, number in enumerate(shown.tolist()):
        precision = judge.eval["precision"][:, :, :, at, -1]
        recall = _mean(judge.eval["recall"][:, :, at, -1])
        rows[number] = (recall, _mean(precision), _mean(precision[0]), int(counts[number]))
    columns = (one.name, "ar", "ap", "ap50", "objects")
    title = f"{_TITLES[kind]} by {one.name}: {one.what}"
    return Table(one.name, title, columns, filled(one, rows))


def _judge(
    truth: Coco,
    detections: Sequence[dict[str, Any]],
    kind: str,
    max_detections: int,
    areas: Sequence[float] | None = None,
    ranges: Sequence[int] = (),
) -> Any:
    """A ``COCOeval`` that accumulated.

    Args:
        truth: A COCO document.
        detections: Likewise.
        kind: ``segm`` or ``bbox``.
        max_detections: As above.
        areas: Of the detections; None takes those of their masks or boxes.
        ranges: Values that an area must have, one range each; none takes COCO's ranges.
    """
    try:
        from pycocotools.coco import COCO
        from pycocotools.cocoeval import COCOeval
    except ImportError as error:
        raise OutputError(f"{NEEDED} ({error})") from error
    own = "mask_area" if kind == "segm" else "box_area"
    with quiet():
        true, guessed = COCO(), COCO()
        # Numbered from 1, since COCOeval takes a match with 0 for none.
        true.dataset = {
            **truth,
            "annotations": [
                {"iscrowd": 0, **a, "id": i} for i, a in enumerate(truth["annotations"], 1)
            ],
        }
        guessed.dataset = {
            **truth,
            "annotations": [
                {**d, "id": i, "iscrowd": 0, "area": d[own] if areas is None else areas[i - 1]}
                for i, d in enumerate(detections, 1)
            ],
        }
        for one in (true, guessed):
            one.createIndex()
        judge = COCOeval(true, guessed, kind)
        few = [1, 10] if max_detections > 10 else [1] if max_detections > 1 else []
        judge.params.maxDets = [*few, max_detections]
        if ranges:
            judge.params.areaRng = [[number, number] for number in ranges]
            judge.params.areaRngLbl = [str(number) for number in ranges]
        judge.evaluate()
        judge.accumulate()
    return judge


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Swallows what pycocotools prints: standard output is for results."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def _most_in_a_class(annotations: Sequence[Mapping[str, Any]]) -> int:
    counts: dict[tuple[int, int], int] = {}
    for one in annotations:
        key = one["image_id"], one["category_id"]
        counts[key] = counts.get(key, 0) + 1
    return max(counts.values())
