"""Label maps: confusion and intersection over union (IoU) by class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.evaluate.breakdown import Attribute, Attributes, filled, pixel_bins
from scenec.datasets.evaluate.evaluation import Cell, Evaluation, Table, finite
from scenec.datasets.evaluate.predictions import predicted, read_labels, unrendered
from scenec.datasets.source import Source
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.spelling import nearest
from scenec.schemas.units import Progress

_NONE = "(none)"
Counts = NDArray[np.int64]


def evaluate_labels(
    folder: Path,
    source: Source,
    attributes: Attributes,
    *,
    level: str | None = None,
    classes: Sequence[str] | None = None,
    skip_missing: bool = False,
    progress: Progress | None = None,
) -> Evaluation:
    """Hold label maps against frames.

    Every pixel that has a label in the frame counts once. IoU of a class: pixels that are of it in
    both, of those that are of it in either; a pixel that predicts none is a miss.

    Args:
        folder: A PNG a frame (``predictions.predicted``).
        source: The frames.
        attributes: Bins.
        level: Of labels; None takes the first.
        classes: Names of the classes that the values 0, 1, 2 … stand for, by position: a name may
            be there twice, "" and "(none)" are no class. None: values are label ids as frames have
            them, 0 for none.
        skip_missing: Whether frames without a prediction are left out.
        progress: Called after each frame.

    Raises:
        FrameError: A frame or a prediction cannot be read, or holds a value that is no class.
        OutputError: There is no such level or class; a prediction is missing.
    """
    known = source.labels()
    level = level or next(iter(known), None)
    if level is None or level not in known:
        raise OutputError(f"--level {level}: no such label level{nearest(str(level), known)}")
    ids = sorted(known[level])
    names = [known[level][number] for number in ids]
    values = _values(ids, names, classes)
    pairs, notes = predicted(folder, source.frames, (".png",), skip_missing)
    confusion = np.zeros((len(ids), len(ids) + 1), np.int64)
    parts: dict[str, Counts] = {}
    for done, (ref, path) in enumerate(pairs, 1):
        frame = source.load(ref, [f"label.{level}"], ["rgb"])
        guess = _classes(path, read_labels(path, (frame.height, frame.width)), values, names)
        truth = _slots(frame.passes[f"label.{level}"], np.array(ids))
        judged = truth >= 0
        cell = truth[judged] * confusion.shape[1] + guess[judged]
        confusion += np.bincount(cell, minlength=confusion.size).reshape(confusion.shape)
        for name, bins in pixel_bins(frame, attributes).items():
            count = attributes[name].count
            bin_ = bins[judged]
            inside = bin_ >= 0
            found = np.bincount(
                bin_[inside] * confusion.size + cell[inside], minlength=count * confusion.size
            ).reshape(count, *confusion.shape)
            parts[name] = parts.get(name, np.zeros_like(found)) + found
        if progress:
            progress(done, len(pairs), ref.name)
    if not confusion.any():
        raise OutputError(f"{source.out}: no pixel of these frames has a label of level {level}")
    result = Evaluation(
        "labels",
        folder,
        source.out,
        {"level": level, "frames": len(pairs), "frames_not_rendered": len(source.missing)},
    )
    result.notes = [*notes, *unrendered(source)]
    result.measures = _measures(confusion)
    result.arrays["confusion"] = confusion
    result.tables = [
        _by_class(names, confusion),
        Table(
            "confusion", "pixels by true class (rows) and predicted one (columns)",
            ("true class", *names, _NONE),
            [(name, *row) for name, row in zip(names, confusion.tolist(), strict=True)],
        ),
        *(_by_bin(attributes[name], names, part) for name, part in parts.items() if part.any()),
    ]  # fmt: skip
    return result


def iou(confusion: Counts) -> NDArray[np.float64]:
    """Returns each class's IoU, [n]; NaN where the truth lacks it: wrong pixels cost other classes.

    Args:
        confusion: Pixels by true class and predicted one, the last column predicting none,
            [n, n + 1].
    """
    both = np.diagonal(confusion)
    true = confusion.sum(axis=1)
    either = true + confusion[:, :-1].sum(axis=0) - both
    return np.where(true > 0, both / np.maximum(either, 1), np.nan)


def _measures(confusion: Counts) -> dict[str, float | None]:
    of = iou(confusion)
    shares = confusion.sum(axis=1) / max(int(confusion.sum()), 1)
    return {
        "mean_iou": float(np.nanmean(of)) if np.isfinite(of).any() else None,
        "frequency_weighted_iou": float(np.nansum(shares * of)),
        "pixel_accuracy": float(np.diagonal(confusion).sum() / max(int(confusion.sum()), 1)),
        "pixels": int(confusion.sum()),
    }


def _by_class(names: Sequence[str], confusion: Counts) -> Table:
    rows: list[tuple[Cell, ...]] = []
    of = iou(confusion)
    for i, name in enumerate(names):
        true, guessed = int(confusion[i].sum()), int(confusion[:, i].sum())
        both = int(confusion[i, i])
        if true or guessed:
            precision = both / guessed if guessed else None
            recall = both / true if true else None
            rows.append((name, finite(of[i]), precision, recall, true, guessed))
    columns = ("class", "iou", "precision", "recall", "pixels", "predicted")
    return Table("class", "by class", columns, rows)


def _by_bin(one: Attribute, names: Sequence[str], parts: Counts) -> Table:
    shown = [i for i in range(len(names)) if parts[:, i].any()]
    rows = [
        (
            whole["mean_iou"],
            whole["pixel_accuracy"],
            whole["pixels"],
            *map(finite, iou(part)[shown]),
        )
        if part.any()
        else None
        for part in parts
        for whole in [_measures(part)]
    ]
    of_classes = (f"iou {names[i]}" for i in shown)
    columns = (one.name, "mean_iou", "pixel_accuracy", "pixels", *of_classes)
    return Table(one.name, f"by {one.name}: {one.what}", columns, filled(one, rows))


def _values(
    ids: Sequence[int], names: Sequence[str], classes: Sequence[str] | None
) -> dict[int, int]:
    """Value of a pixel -> class, the last of which is none."""
    if classes is None:
        return {0: len(ids)} | {number: i for i, number in enumerate(ids)}
    for name in classes:
        if name not in (*names, _NONE, ""):
            raise OutputError(f"--classes: the level has no label {name!r}{nearest(name, names)}")
    return {
        value: names.index(name) if name in names else len(ids)
        for value, name in enumerate(classes)
    }


def _classes(
    path: Path, picture: NDArray[np.int64], values: Mapping[int, int], names: Sequence[str]
) -> NDArray[np.int64]:
    """Class of each pixel."""
    keys = np.array(sorted(values), np.int64)
    found = _slots(picture, keys)
    if (found < 0).any():
        known = ", ".join(
            f"{key} {names[values[key]] if values[key] < len(names) else _NONE}"
            for key in keys.tolist()
        )
        raise FrameError(
            f"{path}: holds the value {picture[found < 0][0]}, which is no class; expected {known}"
            " (--classes says what the values 0, 1, 2 … are)"
        )
    return np.array([values[key] for key in keys.tolist()], np.int64)[found]


def _slots(picture: NDArray[np.integer], keys: NDArray[np.integer]) -> NDArray[np.int64]:
    """Index of each value among ascending keys, -1 where it is none of them."""
    at = np.minimum(np.searchsorted(keys, picture), len(keys) - 1)
    return np.where(keys[at] == picture, at, -1)
