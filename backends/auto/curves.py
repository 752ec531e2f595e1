"""What is known of a backend on a stage: seconds and error over samples.

Curves come from ``scenec converge`` (``OUT/converge/converge.json``) or from a short calibration
(``auto.calibrate``, ``OUT/converge/calibration.json``); what is decided from them is the same.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

#: Of the error over samples, where it has not been measured: -1/2 for independent samples; Cycles'
#: are well spread, and the error of such ones at edges within a pixel falls as n**-3/4
#: (Mitchell 1996, Consequences of stratified sampling in graphics).
SLOPES = {"cycles": -0.75}
INDEPENDENT = -0.5
#: The 95 % bound over the estimate, where no picture tells.
USUAL_WIDENING = 1.1


@dataclass(frozen=True)
class Light:
    """A picture of n samples per pixel.

    Attributes:
        fixed_s, sample_s: It takes ``fixed_s + n * sample_s`` seconds.
        error, slope: Its relative rms error is ``error * n**slope``.
        widening: Its 95 % bound over that.
        size_s: Seconds once for each n that is new to the process: kernels are compiled for it.
    """

    fixed_s: float
    sample_s: float
    error: float
    slope: float
    widening: float
    size_s: float = 0.0

    def seconds(self, spp: float) -> float:
        """Of one picture."""
        return self.fixed_s + spp * self.sample_s

    def noise(self, spp: float) -> float:
        """Relative rms error of one picture."""
        return self.error * spp**self.slope


@dataclass(frozen=True)
class Curve:
    """One backend.

    Attributes:
        backend, version, device: Who, and where it ran.
        stochastic: Whether it has noise.
        start_s: Seconds until a first picture is there: process, stage, scene, kernels.
        annotation_s: Of a frame's annotation.
        pixels: Of a frame it was measured on.
        light: None if it was asked for no light.
        floor: Relative rms distance to backends with noise (to the farthest, if there are
            several) of one that has none, however many samples; 0 for those with noise, which
            converge to what they mean; None if it is not known.
    """

    backend: str
    version: str
    device: str
    stochastic: bool
    start_s: float
    annotation_s: float
    pixels: float
    light: Light | None
    floor: float | None


def slope_of(backend: str) -> float:
    """What theory says of a backend's sampler."""
    return SLOPES.get(backend, INDEPENDENT)


def line(spp: Sequence[float], seconds: Sequence[float]) -> tuple[float, float]:
    """``fixed_s`` and ``sample_s``, neither negative: least squares of relative differences."""
    # Imported here: the curves of a file that does not match are never fitted.
    from scipy.optimize import nnls

    t = np.maximum(np.asarray(seconds, float), 1e-9)
    if len(set(spp)) < 2:
        return 0.0, float(np.mean(t / np.asarray(spp, float)))
    system = np.stack([1.0 / t, np.asarray(spp, float) / t], axis=1)
    fixed, each = nnls(system, np.ones(len(t)))[0]
    return float(fixed), float(each)


def of_report(report: Mapping[str, Any]) -> list[Curve]:
    """The curves in ``converge.json``, of pictures that are not denoised.

    Raises:
        KeyError, TypeError, ValueError: It is no such report.
    """
    found = []
    for name, about in report["backends"].items():
        steps = _steps(report, name)
        if not steps:
            continue
        stochastic = bool(about["stochastic"])
        seconds = [float(step["seconds"]) for step in steps]
        if stochastic:
            light = _light(report, name, steps, seconds)
        else:
            light = Light(float(np.mean(seconds)), 0.0, 0.0, 0.0, 1.0)
        start = about["start_s"]
        found.append(
            Curve(
                name,
                str(about["version"]),
                str(about["device"]),
                stochastic,
                0.0 if start is None else float(start),
                float(about["annotation_s"]),
                float(about["pixels"]),
                light,
                0.0 if stochastic else _floor(report, name),
            )
        )
    return found


def _steps(report: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """A backend's rungs: against itself; of one without noise, its one against any other."""
    of = [s for s in report["series"] if s["backend"] == name and not s["denoised"]]
    of.sort(key=lambda series: not series["own"])
    return list(of[0]["steps"]) if of else []


def _light(
    report: Mapping[str, Any], name: str, steps: Sequence[dict[str, Any]], seconds: list[float]
) -> Light:
    spp = [float(step["spp"]) for step in steps]
    own = next(s for s in report["series"] if s["backend"] == name and s["own"])
    fit = own["over_spp"]
    if fit is None:
        last = steps[-1]
        slope = slope_of(name)
        error = float(last["mean"] or last["estimated"]) / spp[-1] ** slope
    else:
        slope, error = float(fit["slope"]), float(np.exp(fit["intercept"]))
    ratios = [s["bound"] / s["estimated"] for s in steps if s["bound"] and s["estimated"]]
    widening = float(np.median(ratios)) if ratios else USUAL_WIDENING
    firsts = [max(0.0, float(s["first_s"]) - float(s["seconds"])) for s in steps]
    return Light(*line(spp, seconds), error, slope, widening, float(np.median(firsts)))


def _floor(report: Mapping[str, Any], name: str) -> float | None:
    noisy = {other for other, about in report["backends"].items() if about["stochastic"]}
    floors = [
        float(floor["relative_rms"] or 0.0)
        for floor in report["floors"]
        if name in (floor["backend"], floor["against"])
        and noisy & {floor["backend"], floor["against"]}
    ]
    return max(floors, default=None)


def as_json(curves: Sequence[Curve]) -> list[dict[str, Any]]:
    """For ``calibration.json``."""
    return [asdict(curve) for curve in curves]


def of_json(values: Sequence[Mapping[str, Any]]) -> list[Curve]:
    """Back again.

    Raises:
        KeyError, TypeError, ValueError: They are no curves.
    """
    return [
        Curve(**{**value, "light": None if value["light"] is None else Light(**value["light"])})
        for value in values
    ]


def read(path: Path) -> dict[str, Any] | None:
    """A JSON file; None if there is none, or it is none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None
