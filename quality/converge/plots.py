"""Plots of error over samples and seconds. Needs matplotlib, which nothing else here does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from scenec.quality.converge.fits import Fit
from scenec.schemas.files import atomic

if TYPE_CHECKING:
    from scenec.quality.converge.series import ConvergeReport, Series

#: Colors that color-blind people tell apart (Okabe and Ito 2008).
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
OWN, FLOOR = "convergence.png", "floor.png"


def draw(folder: Path, report: ConvergeReport) -> list[Path]:
    """Both plots, as far as there is something in them.

    Raises:
        OutputError: One cannot be written.
    """
    colors = {name: _COLORS[i % len(_COLORS)] for i, name in enumerate(report.backends)}
    made = []
    own = [series for series in report.series if series.own]
    if own:
        made.append(_save(folder / OWN, _draw_series(own, colors)))
    others = [series for series in report.series if not series.own]
    if others:
        made.append(_save(folder / FLOOR, _floor(others, report, colors)))
    return made


def _draw_series(series: Sequence[Series], colors: dict[str, str]) -> Figure:
    figure = Figure(figsize=(11, 4.8), layout="constrained")
    figure.suptitle("Each backend's convergence to itself (mean and 95 % band of repeated seeds)")
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, over, label in (
        (left, "spp", "samples per pixel"),
        (right, "seconds", "seconds of light a frame"),
    ):
        for one in series:
            fit = one.over_spp if over == "spp" else one.over_seconds
            _curve(axes, one, over, colors[one.backend], fit)
        _finish(axes, label)
    _guide(left)
    left.set_ylabel("relative rms error against own reference")
    for axes in (left, right):
        axes.legend(fontsize=8)
    return figure


def _floor(series: Sequence[Series], report: ConvergeReport, colors: dict[str, str]) -> Figure:
    truths = list(dict.fromkeys(one.against for one in series))
    figure = Figure(figsize=(5.5 * len(truths), 4.8), layout="constrained")
    figure.suptitle("The floor between backends: error against another's reference")
    panels = figure.subplots(1, len(truths), sharey=True, squeeze=False)[0]
    for axes, truth in zip(panels, truths, strict=True):
        for one in series:
            if one.against == truth:
                _curve(axes, one, "seconds", colors[one.backend], None)
        for floor in report.floors:
            pair = {floor.backend, floor.against}
            if truth in pair and floor.relative_rms is not None:
                other = (pair - {truth}).pop()
                axes.axhline(
                    floor.relative_rms, color=colors[other], linestyle=":",
                    label=f"{other}: floor {100 * floor.relative_rms:.3g} %",
                )  # fmt: skip
        axes.set_title(f"against {truth}", fontsize=10)
        _finish(axes, "seconds of light a frame")
        axes.legend(fontsize=8)
    panels[0].set_ylabel("relative rms error")
    return figure


def _curve(axes: Any, one: Series, over: str, color: str, fit: Fit | None) -> None:
    steps = sorted(
        (step for step in one.steps if step.mean is not None), key=lambda step: getattr(step, over)
    )
    if not steps:
        return
    x = np.array([getattr(step, over) for step in steps])
    y = np.array([step.mean for step in steps])
    name = one.name if one.stochastic else f"{one.name}: no noise, one point"
    label = name if fit is None else f"{name}: slope {_slope(fit)}"
    dashes = "--" if one.denoised else "-"
    marker = "o" if one.stochastic else "s"
    # With a fit its line is drawn, not one from point to point.
    fill = "white" if one.denoised else color
    line = dashes if fit is None else "none"
    axes.plot(
        x, y, linestyle=line, marker=marker, color=color, label=label, markersize=5,
        markerfacecolor=fill,
    )  # fmt: skip
    axes.fill_between(
        x, [step.low for step in steps], [step.high for step in steps], color=color, alpha=0.2,
        linewidth=0,
    )  # fmt: skip
    if fit is not None:
        axes.plot(x, np.exp(fit.intercept) * x**fit.slope, dashes, color=color, linewidth=1)


def _slope(fit: Fit) -> str:
    if fit.low is None or fit.high is None:
        return f"{fit.slope:.3f}"
    return f"{fit.slope:.3f} [{fit.low:.3f}, {fit.high:.3f}]"


def _guide(axes: Any) -> None:
    """The slope of independent samples, through the corner of the plot."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    axes.plot([x0, x1], [y1, y1 * (x1 / x0) ** -0.5], color="0.6", linewidth=1, linestyle=":",
              label="slope -1/2")  # fmt: skip
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)


def _finish(axes: Any, label: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(LogLocator(base=10.0, subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(label)
    axes.grid(visible=True, which="both", linewidth=0.3, alpha=0.6)


def _save(path: Path, figure: Figure) -> Path:
    FigureCanvasAgg(figure)
    with atomic(path) as temporary:
        # matplotlib would leave its version in the file.
        figure.savefig(temporary, dpi=110, metadata={"Software": None})
    return path
