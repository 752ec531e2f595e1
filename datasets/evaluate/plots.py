"""Plots of evaluations. Needs matplotlib, which nothing else here does."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scenec.datasets.evaluate.evaluation import Evaluation, Table
from scenec.schemas.files import atomic

#: Colors that color-blind people tell apart (Okabe and Ito 2008).
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
WHOLE, PARTS = "evaluation.png", "parts.png"
#: Task -> measures shown in parts.
_SHOWN = {
    "instances": ("ar", "ap"),
    "labels": ("mean_iou", "pixel_accuracy"),
    "depth": ("abs_rel", "delta_1"),
    "track": ("ate_rmse",),
}
#: Tables that are no parts.
_OTHER = ("confusion", "frame", "pose")


def draw(folder: Path, evaluation: Evaluation) -> list[Path]:
    """A plot of the whole, where the task has one, and bars of its parts.

    Raises:
        OutputError: One cannot be written.
    """
    made = []
    whole = {
        "instances": _precision, "labels": _confusion, "track": _tracks
    }.get(evaluation.task)  # fmt: skip
    if whole is not None:
        made.append(_save(folder / WHOLE, whole(evaluation)))
    shown = _SHOWN[evaluation.task]
    parts = [
        table
        for table in evaluation.tables
        if table.name not in _OTHER and table.rows and any(name in table.columns for name in shown)
    ]
    if parts:
        made.append(_save(folder / PARTS, _parts(parts, shown)))
    return made


def _precision(evaluation: Evaluation) -> Figure:
    figure = Figure(figsize=(6, 4.8), layout="constrained")
    axes = figure.subplots()
    recall = np.linspace(0.0, 1.0, len(evaluation.arrays["precision"]))
    names = ("IoU 0.5", "IoU 0.75", "IoU 0.5 to 0.95")
    for name, line, color in zip(names, evaluation.arrays["precision"].T, COLORS, strict=False):
        axes.plot(recall, line, color=color, label=name)
    axes.set(xlim=(0, 1), ylim=(0, 1.02), xlabel="recall", ylabel="precision, mean over classes")
    axes.legend()
    _grid(axes)
    return figure


def _confusion(evaluation: Evaluation) -> Figure:
    (table,) = (table for table in evaluation.tables if table.name == "confusion")
    counts = evaluation.arrays["confusion"].astype(np.float64)
    shown = np.flatnonzero(counts.sum(axis=1) + counts.sum(axis=0)[:-1])
    columns = [*shown.tolist(), *([counts.shape[1] - 1] if counts[:, -1].any() else [])]
    picked = counts[np.ix_(shown, columns)]
    shares = picked / np.maximum(picked.sum(axis=1, keepdims=True), 1.0)
    side = 2.0 + 0.6 * len(columns)
    figure = Figure(figsize=(side + 1.0, side), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(shares, vmin=0.0, vmax=1.0, cmap="Blues")
    names = list(table.columns[1:])
    axes.set_xticks(range(len(columns)), [names[i] for i in columns], rotation=60, ha="right")
    axes.set_yticks(range(len(shown)), [names[i] for i in shown])
    axes.set(xlabel="predicted", ylabel="true")
    if len(columns) <= 20:
        for y, x in np.ndindex(*shares.shape):
            axes.text(x, y, f"{100 * shares[y, x]:.0f}", ha="center", va="center", fontsize=8,
                      color="white" if shares[y, x] > 0.5 else "black")  # fmt: skip
    figure.colorbar(image, label="share of the true class's pixels (in cells: percent)")
    return figure


def _tracks(evaluation: Evaluation) -> Figure:
    figure = Figure(figsize=(10, 4.8), layout="constrained")
    above, over_time = figure.subplots(1, 2, width_ratios=(1.2, 1))
    tracks_from_above(
        above, evaluation.arrays["true"], [("estimated", evaluation.arrays["estimated"])]
    )
    over_time.plot(evaluation.arrays["error"], color=COLORS[1])
    over_time.set(xlabel="pose", ylabel="distance from the true position, m", ylim=(0, None))
    _grid(over_time)
    return figure


def tracks_from_above(axes: Any, true: Any, estimates: Sequence[tuple[str, Any]]) -> None:
    """The true positions [n, 3] and estimates of them in one view from above, a circle at t = 0."""
    axes.plot(true[:, 0], true[:, 1], color="0.3", linewidth=2.5, label="true")
    for (name, points), color in zip(estimates, COLORS, strict=False):
        axes.plot(points[:, 0], points[:, 1], color=color, linewidth=1.2, label=name)
    axes.plot(*true[0, :2], "o", color="0.3", markersize=6)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x, m", ylabel="y, m")
    axes.legend(fontsize=8)
    _grid(axes)


def _parts(tables: Sequence[Table], measures: Sequence[str]) -> Figure:
    columns = min(3, len(tables))
    rows = -(-len(tables) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.4 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(tables) :]:
        panel.set_axis_off()
    for axes, table in zip(panels, tables, strict=False):
        shown = [name for name in measures if name in table.columns]
        width = 0.8 / len(shown)
        at = np.arange(len(table.rows))
        for i, name in enumerate(shown):
            column = table.columns.index(name)
            values = [np.nan if row[column] is None else float(row[column]) for row in table.rows]  # type: ignore[arg-type]
            axes.bar(at + i * width, values, width, color=COLORS[i], label=name)
        texts = [str(row[0]) for row in table.rows]
        axes.set_xticks(at + 0.4 - width / 2, texts, rotation=40, ha="right", fontsize=8)
        axes.set_title(textwrap.fill(table.title, 48), fontsize=9)
        axes.legend(fontsize=7)
        _grid(axes)
    return figure


def _grid(axes: Any) -> None:
    axes.grid(visible=True, linewidth=0.3, alpha=0.6)
    axes.set_axisbelow(True)


def _save(path: Path, figure: Figure) -> Path:
    FigureCanvasAgg(figure)
    with atomic(path) as temporary:
        # matplotlib would leave its version in the file.
        figure.savefig(temporary, format="png", dpi=100, metadata={"Software": None})
    return path
