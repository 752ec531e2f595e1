"""Depth maps: the seven errors that papers on depth state.

D. Eigen, C. Puhrsch, R. Fergus, Depth map prediction from a single image using a multi-scale deep
network, NeurIPS 2014, section 4.2: with prediction d and truth t over all judged pixels,

    abs_rel   mean of |d - t| / t
    sq_rel    mean of (d - t)^2 / t, meters
    rmse      root of the mean of (d - t)^2, meters
    rmse_log  root of the mean of (ln d - ln t)^2
    delta_k   share of pixels with max(d / t, t / d) < 1.25^k

Every pixel counts the same, whichever frame it is in. A pixel is judged where the truth is a hit
between the least and the greatest depth, and the prediction is finite and above 0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.evaluate.breakdown import Attribute, Attributes, filled, pixel_bins
from scenec.datasets.evaluate.evaluation import Cell, Evaluation, Table
from scenec.datasets.evaluate.predictions import predicted, read_depth, unrendered
from scenec.datasets.source import Source
from scenec.schemas.errors import OutputError
from scenec.schemas.units import Progress

MEASURES = ("abs_rel", "sq_rel", "rmse", "rmse_log", "delta_1", "delta_2", "delta_3")
UNITS = {"sq_rel": "m", "rmse": "m"}
_ROOTS = ("rmse", "rmse_log")


def evaluate_depth(
    folder: Path,
    source: Source,
    attributes: Attributes,
    *,
    scale: float | None = None,
    median_scaling: bool = False,
    least_m: float = 0.0,
    most_m: float = np.inf,
    skip_missing: bool = False,
    progress: Progress | None = None,
) -> Evaluation:
    """Hold depth maps against frames.

    Args:
        folder: A file a frame (``predictions.predicted``): ``.npy``, ``.exr`` or ``.png``.
        source: The frames; their depth is along the optical axis, meters.
        attributes: Bins.
        scale: Steps of a PNG a meter.
        median_scaling: Whether each prediction is scaled so that its median is the truth's, over
            the pixels that are judged (what monocular depth is judged by).
        least_m, most_m: Truth outside of these is not judged; the range includes both.
        skip_missing: Whether frames without a prediction are left out.
        progress: Called after each frame.

    Raises:
        FrameError: A frame or a prediction cannot be read.
        OutputError: A prediction is missing, or no pixel can be judged.
    """
    pairs, notes = predicted(folder, source.frames, (".npy", ".exr", ".png"), skip_missing)
    whole = np.zeros(len(MEASURES) + 1)
    parts: dict[str, NDArray[np.float64]] = {}
    frames: list[tuple[Cell, ...]] = []
    ratios: list[float] = []
    wanted = 0
    for done, (ref, path) in enumerate(pairs, 1):
        frame = source.load(ref, ["depth"], ["rgb"])
        truth = frame.passes["depth"].astype(np.float64)
        guess = read_depth(path, truth.shape, scale)
        valid = np.isfinite(truth) & (truth > 0.0) & (truth >= least_m) & (truth <= most_m)
        wanted += int(valid.sum())
        valid &= np.isfinite(guess) & (guess > 0.0)
        if not valid.any():
            frames.append((ref.name, *[None] * len(MEASURES), 0))
            continue
        t, d = truth[valid], guess[valid]
        if median_scaling:
            ratios.append(float(np.median(t) / np.median(d)))
            d = d * ratios[-1]
        terms = _terms(d, t)
        sums = terms.sum(axis=1)
        whole += sums
        frames.append((ref.name, *means(sums), int(sums[-1])))
        for name, bins in pixel_bins(frame, attributes).items():
            bin_, count = bins[valid], attributes[name].count
            inside = bin_ >= 0
            found = np.stack(
                [np.bincount(bin_[inside], row[inside], minlength=count) for row in terms], axis=1
            )
            parts[name] = parts.get(name, np.zeros_like(found)) + found
        if progress:
            progress(done, len(pairs), ref.name)
    if not whole[-1]:
        raise OutputError(f"{folder}: no pixel has both a true depth and a predicted one above 0")
    settings = {
        "frames": len(pairs),
        "frames_not_rendered": len(source.missing),
        "median_scaling": median_scaling,
        "depth_scale": scale,
        "least_m": least_m,
        "most_m": most_m if np.isfinite(most_m) else None,
    }
    result = Evaluation("depth", folder, source.out, settings, units=dict(UNITS), notes=notes)
    result.notes += unrendered(source)
    result.measures = dict(zip(MEASURES, means(whole), strict=True))
    result.measures |= {"pixels": int(whole[-1]), "coverage": float(whole[-1] / wanted)}
    if ratios:
        result.measures["scale_median"] = float(np.median(ratios))
        result.measures["scale_spread"] = float(np.std(np.array(ratios) / np.median(ratios)))
    result.tables = [
        *(_by_bin(attributes[name], part) for name, part in parts.items() if part.any()),
        Table("frame", "by frame", ("frame", *MEASURES, "pixels"), frames),
    ]
    return result


def _terms(d: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Computes the terms to be averaged, pixel by pixel: one row a measure, then ones, [8, n]."""
    off = d - t
    ratio = np.maximum(d / t, t / d)
    deltas = [(ratio < 1.25**k).astype(np.float64) for k in (1, 2, 3)]
    log = np.log(d) - np.log(t)
    return np.stack([np.abs(off) / t, off**2 / t, off**2, log**2, *deltas, np.ones_like(t)])


def means(sums: NDArray[np.float64]) -> list[float | None]:
    """The measures of summed terms [8]; None of no pixel."""
    if not sums[-1]:
        return [None] * len(MEASURES)
    found = sums[:-1] / sums[-1]
    return [
        float(np.sqrt(value) if name in _ROOTS else value)
        for name, value in zip(MEASURES, found, strict=True)
    ]


def _by_bin(one: Attribute, parts: NDArray[np.float64]) -> Table:
    rows = [(*means(part), int(part[-1])) if part[-1] else None for part in parts]
    columns = (one.name, *MEASURES, "pixels")
    return Table(one.name, f"by {one.name}: {one.what}", columns, filled(one, rows))
