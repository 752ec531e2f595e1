"""Writes docs/ego_motion.md: how far visual odometry is off, flight by flight, one thing varied.

python lab/experiments/ego_motion.py [--fast] [--full] [--only A,B] [-o FOLDER] [--work FOLDER]

The experiment of section IV-A of the OAISYS paper. It takes minutes on two cores; ``--full``
flies all the way in pictures of 640 x 480, and varies more finely. ``--only texture,sun`` varies no
more than these (blur costs most: its pictures are means of sub-frames). ``--work`` keeps the
frames, and goes on where an earlier run left off. Needs the extras `pyrender`, `evaluate`,
`plots` and `lab`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from scenec.datasets.evaluate.breakdown import ATTRIBUTES
from scenec.datasets.evaluate.evaluation import Evaluation
from scenec.datasets.evaluate.plots import COLORS, tracks_from_above
from scenec.datasets.evaluate.tracks import Track, evaluate_track, track_of
from scenec.datasets.source import Source
from scenec.lab.experiments.flights import (
    BASELINE_M,
    FLIGHTS,
    LEFT,
    RIGHT,
    SEED,
    VARIED,
    WHOLE,
    Flight,
    cfg,
    write_track,
)
from scenec.lab.experiments.odometry import SEED as RANSAC_SEED
from scenec.lab.experiments.odometry import stereo, with_depth
from scenec.lab.runner import SCENEC, Page, command, run, table
from scenec.schemas.errors import OutputError
from scenec.schemas.spelling import nearest

STEREO, DEPTH = "stereo (toy-vo)", "depth (ORB and PnP)"
#: Supersampling: pyrender has no noise of its own, which would count as a sensor's.
_SPP = 8
#: What is varied is varied on this one.
_VARIED_ON = FLIGHTS[1]

HEAD = """\
# Ego-motion

How far off is visual odometry on made pictures, and what does that depend on? This is the
experiment of section IV-A of the OAISYS paper: three flights of a small aircraft over a generated
surface, the first with fast turns, the second and third gentle. Only a simulator can then vary one
thing alone.

Two odometries see the pictures. *Stereo* is the package toy-vo, which others wrote (optical flow,
keyframes, bundle adjustment in a window), on two cameras {baseline:g} m apart. *Depth* is OpenCV's
ORB features and `solvePnPRansac` put together from frame to frame in the plainest way, without
keyframes or a map, on one picture and its exact depth. evo judges both, as
[`scenec evaluate`](evaluate.md) does: the absolute error (ATE) is the distance from the true
position after the best rigid alignment, rms over all frames; the relative error (RPE) is what one
frame's motion is off, rms.

`python lab/experiments/ego_motion.py{words}` made this page on {{cores}} cores ({{versions}}):
{size} pixels, {frames} frames at 10 Hz a flight, pyrender with {spp} samples a pixel, seed {seed},
RANSAC's seed {ransac}.
"""


#: What is changed in the cfg.
Change = Callable[[dict[str, Any]], None] | None


def _some(values: dict[str, Change], every: bool) -> dict[str, Change]:
    """All values, or what the cfg has and the hardest."""
    last = list(values)[-1]
    return {name: one for name, one in values.items() if every or one is None or name == last}


class Experiment:
    """Flies, renders and judges, each setting once.

    Args:
        page: Where it is told.
    """

    def __init__(self, page: Page) -> None:
        full = page.options.full
        self.frames = WHOLE if full else 8 if page.fast else 30
        self.varied = WHOLE if full else 8 if page.fast else 20
        self.size = (640, 480) if full else (160, 120) if page.fast else (320, 240)
        for name in page.options.only:
            if name not in VARIED:
                raise OutputError(f"--only: nothing is varied by {name!r}{nearest(name, VARIED)}")
        self.vary = {name: _some(VARIED[name], full) for name in page.options.only}
        self.work = Path(page.options.work) if page.options.work else page.scratch
        self._found: dict[tuple[str, int], dict[str, Evaluation | None]] = {}

    def judged(
        self, name: str, flight: Flight, count: int, change: Change = None
    ) -> dict[str, Evaluation | None]:
        """Each odometry's errors; None where it lost track.

        Args:
            name: Of the setting, and of its folder.
            flight: Which one.
            count: Its first frames.
            change: Made to the cfg.
        """
        key = name, count
        if key not in self._found:
            samples = range(count)
            out = self._rendered(name, flight, count, change)
            source = Source(out, "pyrender", samples=samples)
            frames = {
                camera: [source.load(ref) for ref in source.frames if ref.camera == camera]
                for camera in (LEFT, RIGHT)
            }
            truth = track_of(Source(out, "pyrender", cameras=[LEFT], samples=samples))
            self._found[key] = {
                STEREO: _errors(stereo(frames[LEFT], frames[RIGHT], BASELINE_M), truth),
                DEPTH: _errors(with_depth(frames[LEFT]), truth),
            }
        return self._found[key]

    def _rendered(self, name: str, flight: Flight, count: int, change: Change) -> Path:
        folder = self.work / name.replace(" ", "_")
        folder.mkdir(parents=True, exist_ok=True)
        write_track(folder / "track.csv", flight, self.frames)
        made = cfg(folder / "track.csv", self.size)
        if change:
            change(made)
        file = folder / "cfg.json"
        file.write_text(json.dumps(made), encoding="utf-8")
        out = folder / "out"
        command((*SCENEC, "compile", file, "--seed", str(SEED), "-o", out))
        command((*SCENEC, "render", out, "--backend", "pyrender", "--spp", str(_SPP),
                 "--samples", f"0:{count}"))  # fmt: skip
        return out


def _errors(estimate: Track, truth: Track) -> Evaluation | None:
    try:
        return evaluate_track(estimate, truth, ATTRIBUTES)
    except OutputError:
        # Too few poses, or all in one place: nothing is left to be aligned.
        return None


def _cells(found: Evaluation | None) -> list[Any]:
    if found is None:
        return [None] * 4 + [0.0]
    of = found.measures
    return [
        of["ate_rmse"],
        of["ate_percent_of_path"],
        1000.0 * float(of["rpe_translation_rmse"] or 0.0),
        of["rpe_rotation_rmse"],
        100.0 * float(of["tracked"] or 0.0),
    ]


_COLUMNS = ("ATE, m", "% of path", "RPE, mm a frame", "RPE, deg a frame", "tracked, %")


def flights(page: Page, experiment: Experiment) -> str:
    """All flights as they are."""
    figure, axes = plt.subplots(1, len(FLIGHTS), figsize=(14, 4.6), constrained_layout=True)
    rows = []
    for panel, flight in zip(axes, FLIGHTS, strict=True):
        found = experiment.judged(flight.name, flight, experiment.frames)
        true = None
        tracks = []
        for name, one in found.items():
            length = None if one is None else one.measures["path_length"]
            rows.append([f"{flight.name}: {flight.what}", name, length, *_cells(one)])
            if one is not None:
                true = one.arrays["true"]
                tracks.append((name, one.arrays["estimated"]))
        if true is not None:
            tracks_from_above(panel, true, tracks)
        panel.set_title(f"{flight.name}: {flight.what}", fontsize=10)
    return (
        "## Three flights\n\n"
        + table(("flight", "odometry", "path tracked, m", *_COLUMNS), rows)
        + "\n"
        + page.save(figure, "tracks")
        + "\nTrue and estimated tracks from above, as in the paper's figure 8; circles are where "
        "they begin.\n"
    )


def varied(page: Page, experiment: Experiment) -> str:
    """One thing at a time."""
    figure, axes = plt.subplots(
        1, len(experiment.vary), figsize=(15, 4.2), constrained_layout=True, squeeze=False
    )
    parts = [
        f"## One thing varied\n\nOn the first {experiment.varied} frames of flight "
        f"{_VARIED_ON.name}. Ground, rocks, path and all else "
        "stay the same. A dash is a lost track.\n"
    ]
    for panel, (what, values) in zip(axes[0], experiment.vary.items(), strict=True):
        rows: list[list[Any]] = []
        errors: dict[str, list[float]] = {STEREO: [], DEPTH: []}
        for value, change in values.items():
            name = _VARIED_ON.name if change is None else f"{what} {value}"
            judged = experiment.judged(name, _VARIED_ON, experiment.varied, change)
            for odometry, one in judged.items():
                rows.append([value, odometry, *_cells(one)])
                error = None if one is None else one.measures["ate_rmse"]
                errors[odometry].append(float("nan") if error is None else error)
        parts.append(f"### {what.capitalize()}\n\n" + table((what, "odometry", *_COLUMNS), rows))
        for (odometry, line), color in zip(errors.items(), COLORS, strict=False):
            panel.plot(range(len(line)), line, "o-", color=color, label=odometry)
        panel.set_xticks(range(len(values)), list(values), rotation=25, ha="right", fontsize=8)
        panel.set_yscale("log")
        panel.set_title(what)
        panel.grid(visible=True, which="both", linewidth=0.3, alpha=0.6)
    axes[0, 0].set_ylabel("ATE, m")
    axes[0, 0].legend(fontsize=8)
    parts.append(page.save(figure, "varied"))
    return "\n".join(parts)


def main(page: Page) -> None:
    """Writes the page."""
    start = time.perf_counter()
    experiment = Experiment(page)
    only = page.options.only
    head = HEAD.format(
        words="" if only == tuple(VARIED) else f" --only {','.join(only)}",
        baseline=BASELINE_M,
        size="{} × {}".format(*experiment.size),
        frames=experiment.frames,
        spp=_SPP,
        seed=SEED,
        ransac=RANSAC_SEED,
    )
    packages = ("toy-vo", "opencv-python-headless", "evo", "pyrender-maintained")
    page.write(
        head,
        packages,
        (lambda page: flights(page, experiment), lambda page: varied(page, experiment)),
    )
    print(f"{time.perf_counter() - start:.0f} s in all")


if __name__ == "__main__":
    run(main, page="ego_motion", full=False, only=tuple(VARIED), work="")
