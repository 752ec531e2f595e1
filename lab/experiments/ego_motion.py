"""Makes the tables of docs/ego_motion.md: how far visual odometry is off, one thing varied.

python lab/experiments/ego_motion.py [--fast] [--full] [--only A,B] [-o FOLDER] [--work FOLDER]

The experiment of section IV-A of the OAISYS paper. It takes minutes on two cores; ``--full``
flies all the way in pictures of 640 x 480, and varies more finely. ``--only texture,sun`` varies no
more than these (blur costs most: its pictures are means of sub-frames). ``--work`` keeps the
frames, and goes on where an earlier run left off. Needs the extras `pyrender`, `evaluate`,
`plots` and `lab`.
"""

from __future__ import annotations

import json
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
from scenec.lab.experiments.odometry import stereo, with_depth
from scenec.lab.experiments.renders import chosen
from scenec.lab.runner import SCENEC, Page, command, run
from scenec.schemas.errors import OutputError

STEREO, DEPTH = "stereo (toy-vo)", "depth (ORB and PnP)"
#: Supersampling: pyrender has no noise of its own, which would count as a sensor's.
_SPP = 8
#: What is varied is varied on this one.
_VARIED_ON = FLIGHTS[1]

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
        full, self.only = page.options.full, chosen(page, VARIED)
        self.frames = WHOLE if full else 8 if page.fast else 30
        self.count = WHOLE if full else 8 if page.fast else 20
        self.size = (640, 480) if full else (160, 120) if page.fast else (320, 240)
        self.vary = {name: _some(VARIED[name], full) for name in self.only}
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

    def flights(self, page: Page) -> None:
        """Flies all flights as they are."""
        figure, axes = plt.subplots(1, len(FLIGHTS), figsize=(14, 4.6), constrained_layout=True)
        rows = []
        for panel, flight in zip(axes, FLIGHTS, strict=True):
            found = self.judged(flight.name, flight, self.frames)
            for name, one in found.items():
                length = None if one is None else one.measures["path_length"]
                rows.append([f"{flight.name}: {flight.what}", name, length, *_cells(one)])
            shown = {name: one.arrays for name, one in found.items() if one is not None}
            if shown:
                true = list(shown.values())[-1]["true"]
                tracks = [(name, arrays["estimated"]) for name, arrays in shown.items()]
                tracks_from_above(panel, true, tracks)
            panel.set_title(f"{flight.name}: {flight.what}", fontsize=10)
        page.rows(rows)
        page.save(figure, "tracks")

    def varied(self, page: Page) -> None:
        """Varies one thing at a time; a dash is a lost track."""
        figure, axes = plt.subplots(
            1, len(self.vary), figsize=(15, 4.2), constrained_layout=True, squeeze=False
        )
        panels = iter(axes[0])
        for what in VARIED:
            if what not in self.vary:
                page.rows(None)
                continue
            panel, values = next(panels), self.vary[what]
            rows: list[list[Any]] = []
            errors: dict[str, list[float]] = {STEREO: [], DEPTH: []}
            for value, change in values.items():
                name = _VARIED_ON.name if change is None else f"{what} {value}"
                for odometry, one in self.judged(name, _VARIED_ON, self.count, change).items():
                    rows.append([value, odometry, *_cells(one)])
                    error = None if one is None else one.measures["ate_rmse"]
                    errors[odometry].append(float("nan") if error is None else error)
            page.rows(rows)
            for (odometry, line), color in zip(errors.items(), COLORS, strict=False):
                panel.plot(range(len(line)), line, "o-", color=color, label=odometry)
            panel.set_xticks(range(len(values)), list(values), rotation=25, ha="right", fontsize=8)
            panel.set_yscale("log")
            panel.set_title(what)
            panel.grid(visible=True, which="both", linewidth=0.3, alpha=0.6)
        axes[0, 0].set_ylabel("ATE, m")
        axes[0, 0].legend(fontsize=8)
        page.save(figure, "varied")


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


def main(page: Page) -> None:
    """Refreshes the page."""
    own = Experiment(page)
    page.value("size", "{} × {}".format(*own.size))
    page.value("frames", str(own.frames))
    page.value("count", str(own.count))
    packages = ("toy-vo", "opencv-python-headless", "evo", "pyrender-maintained")
    page.refresh(packages, (own.flights, own.varied))


if __name__ == "__main__":
    run(main, page="ego_motion", full=False, only=tuple(VARIED), work="")
