"""A plot of a scene's ladders: one panel each, errors over seconds and over bytes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenec.quality.ladder.results import Ladder, LadderReport
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Colors that color-blind people tell apart (Okabe and Ito 2008).
_SECONDS, _BYTES = "#0072B2", "#D55E00"
_COLUMNS = 3
_MIB = 1024.0 * 1024.0
#: Axes span this factor at least; beyond the other they are labeled at powers of ten only.
_LEAST_SPAN, _WIDE = 10.0, 300.0


def draw(path: Path, report: LadderReport) -> None:
    """Writes the plot; an error of 0 has no place on logarithms and is left out.

    Args:
        path: A file that ends in .png, .svg or .pdf.
        report: Of one scene.

    Raises:
        OutputError: matplotlib is not installed, there is nothing to draw, or the file cannot be
            written.
    """
    if path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise OutputError(f"{path}: expected a name that ends in .png, .svg or .pdf")
    if not report.ladders:
        raise OutputError(f"{path}: the scene has none of these approximations: nothing to draw")
    figure = picture(report)
    with atomic(path) as temporary:
        # matplotlib would leave its version or the day in the file.
        told = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
        figure.savefig(temporary, dpi=90, metadata=told[path.suffix.lower()])


def picture(report: LadderReport) -> Figure:
    """The plot as matplotlib's figure, for other pages to save.

    Raises:
        OutputError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OutputError(
            "plots need matplotlib, which is not installed: pip install 'scenec[plots]'"
        ) from error
    rows = -(-len(report.ladders) // _COLUMNS)
    columns = min(len(report.ladders), _COLUMNS)
    figure = Figure(figsize=(4.6 * columns, 3.7 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(
        f"{report.scene}: measured error (filled), claimed (open), over seconds and MiB; "
        "the square is the cfg's value",
        fontsize=10,
    )
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, ladder in zip(panels, report.ladders, strict=False):
        _panel(axes, ladder)
    for axes in panels[len(report.ladders) :]:
        axes.set_visible(False)
    return figure


def _panel(axes: Any, ladder: Ladder) -> None:
    axes.set_title(_title(ladder), fontsize=9)
    axes.set_ylabel(f"{ladder.claim_of} error, {ladder.unit}", fontsize=8)
    if not any(ladder.measured(rung) > 0.0 for rung in ladder.rungs):
        axes.text(0.5, 0.5, "no error", ha="center", va="center", transform=axes.transAxes)
        axes.set_xticks([])
        axes.set_yticks([])
        return
    other = axes.twiny()
    _curve(axes, ladder, [rung.seconds for rung in ladder.rungs], _SECONDS, "-")
    _curve(other, ladder, [rung.bytes / _MIB for rung in ladder.rungs], _BYTES, "--")
    for one, color, label in ((axes, _SECONDS, "seconds"), (other, _BYTES, "MiB")):
        one.set_xscale("log")
        one.set_yscale("log")
        one.set_xlabel(label, fontsize=8, color=color)
        one.tick_params(axis="x", colors=color, labelsize=7, which="both")
        _ticks(one.xaxis, one.get_xlim(), one.set_xlim)
    axes.tick_params(axis="y", labelsize=7, which="both")
    _ticks(axes.yaxis, axes.get_ylim(), axes.set_ylim)
    axes.grid(visible=True, linewidth=0.3, alpha=0.6)


def _ticks(axis: Any, limits: tuple[float, float], limit: Callable[[float, float], object]) -> None:
    """Few labels in plain numbers, over a factor of ten at least."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    low, high = limits
    if low > 0.0 and high < _LEAST_SPAN * low:
        wider = float(np.sqrt(_LEAST_SPAN * low / high))
        low, high = low / wider, high * wider
        limit(low, high)
    wide = high > _WIDE * low
    axis.set_major_locator(LogLocator(base=10.0, subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def _curve(axes: Any, ladder: Ladder, cost: list[float], color: str, dashes: str) -> None:
    known = [
        (c, ladder.measured(rung), rung)
        for c, rung in zip(cost, ladder.rungs, strict=True)
        if c > 0.0 and ladder.measured(rung) > 0.0
    ]
    if not known:
        return
    axes.plot(
        [c for c, _, _ in known], [e for _, e, _ in known], dashes, color=color, marker="o",
        markersize=4, linewidth=1,
    )  # fmt: skip
    for c, e, rung in known:
        if rung.used:
            axes.plot([c], [e], "s", color=color, markersize=8)
    claims = [(c, rung.claimed) for c, _, rung in known if rung.claimed]
    axes.plot(
        [c for c, _ in claims], [e for _, e in claims], "o", color=color, markersize=7,
        markerfacecolor="none",
    )  # fmt: skip


def _title(ladder: Ladder) -> str:
    text = ladder.what if len(ladder.what) < 52 else ladder.what[:50] + "…"
    return f"{ladder.name}: {text}"
