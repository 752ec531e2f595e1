"""Makes the tables of docs/experiments.md: what made pictures teach a network.

python lab/experiments/segmentation.py [--fast] [--full] [--only A,B] [-o DIR] [--work DIR]

The experiment of section IV-B of the OAISYS paper. It takes minutes on two cores; ``--full`` makes
more and larger pictures for a larger network. ``--only transfer`` leaves out what is left out of
pictures, ``--only ablations`` the renderers. ``--work`` keeps the frames and the networks' answers,
and goes on where an earlier run left off. Needs the extras `mitsuba`, `cycles`, `pyrender`,
`denoise`, `plots` and `networks`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.datasets.colors import label_colors
from scenec.datasets.evaluate.labels import evaluate_labels
from scenec.datasets.pictures import picture
from scenec.datasets.source import Source
from scenec.lab.experiments.renders import (
    Frames,
    chosen,
    file_name,
    of_page,
    on_all_cores,
)
from scenec.lab.experiments.terrains import CLASSES, FULL, LEVEL, SETTINGS
from scenec.lab.experiments.torch_modules import needing_torch
from scenec.lab.runner import Page, run

Numbers = NDArray[np.float64]

#: Of rgb, and of what all networks are tested on; the last is what ablations are made with.
_BACKENDS = ("pyrender", "cycles", "mitsuba")
_OWN = "mitsuba"
#: Beside a network's answers: CPU seconds of it.
_SECONDS = "cpu.json"
#: Of trainings.
_SEEDS = (1, 2, 3)


@dataclass(frozen=True)
class _Training:
    """One network, trained and asked.

    Attributes:
        setting: Of the pictures it learns from.
        backend: Of these pictures.
        seed: Its own.
    """

    setting: str
    backend: str
    seed: int


class Experiment:
    """Makes pictures, trains networks on them and judges these, each once.

    Args:
        page: Where it is told.
    """

    def __init__(self, page: Page) -> None:
        self.parts = chosen(page, _PARTS)
        self.networks = needing_torch("networks")
        self.renders = of_page(page)
        full, fast = page.options.full, page.fast
        recipe = ("large", 8000) if full else ("small", 3 if fast else 150)
        self.recipe = self.networks.Recipe(*recipe)
        self.seeds = _SEEDS[:1] if fast else _SEEDS

    @property
    def pictures(self) -> list[tuple[str, str]]:
        """What is made: (setting, backend)."""
        backends = _BACKENDS if "transfer" in self.parts else (_OWN,)
        settings = SETTINGS if "ablations" in self.parts else (FULL,)
        return [
            *((FULL, name) for name in backends),
            *((name, _OWN) for name in settings if name != FULL),
        ]

    @property
    def trainings(self) -> list[_Training]:
        """All networks."""
        return [_Training(*which, seed) for which in self.pictures for seed in self.seeds]

    def frames(self, setting: str, backend: str, batches: range) -> Frames:
        """Pictures of some batches."""
        return Frames(self.renders.out(setting), backend, batches)

    def answers(self, one: _Training) -> Path:
        """Folder of a network's answers."""
        return self.renders.work / "answers" / file_name(one.setting) / one.backend / str(one.seed)

    def train_all(self, trainings: Sequence[_Training]) -> None:
        """Trains networks that are not trained yet, one a core."""
        left = [one for one in trainings if not (self.answers(one) / _SECONDS).exists()]
        calls = [
            (
                self.networks.judged_by,
                self.frames(one.setting, one.backend, self.renders.train),
                self._tests(one.setting),
                self.recipe,
                one.seed,
                self.answers(one),
            )
            for one in left
        ]
        for one, spent in zip(left, on_all_cores(calls), strict=True):
            (self.answers(one) / _SECONDS).write_text(json.dumps(spent), encoding="utf-8")

    def seconds(self) -> tuple[float, float]:
        """CPU seconds of making the pictures, and of the networks."""
        cost, count = self.renders.cost, self.renders.count
        trained = [json.loads((self.answers(one) / _SECONDS).read_text()) for one in self.trainings]
        return sum(cost(*one) * count(one[0]) for one in self.pictures), sum(trained)

    def ious(self, setting: str, backend: str, test: str) -> Numbers:
        """IoU of each seed and class, [seeds, classes]."""
        found = []
        for seed in self.seeds:
            folder = self.answers(_Training(setting, backend, seed)) / test
            truth = Source(self.renders.out(FULL), test, batches=self.renders.held_out)
            judged = evaluate_labels(folder, truth, {}, level=LEVEL, classes=CLASSES)
            by_class = {row[0]: row[1] for row in judged.tables[0].rows}
            found.append([by_class.get(name) for name in CLASSES])
        return np.array(found, np.float64)

    def _tests(self, setting: str) -> dict[str, Frames]:
        """What a network of pictures of a setting is asked about: by backend."""
        backends = _BACKENDS if setting == FULL and "transfer" in self.parts else (_OWN,)
        return {name: self.frames(FULL, name, self.renders.held_out) for name in backends}


def _mean(ious: Numbers) -> tuple[float, float]:
    """Mean over classes, in percent: of all seeds, and its standard deviation over them."""
    means = 100.0 * np.nanmean(ious, axis=1)
    return float(means.mean()), float(means.std(ddof=1)) if len(means) > 1 else 0.0


def _said(ious: Numbers) -> str:
    mean, spread = _mean(ious)
    return f"{mean:.1f} ± {spread:.1f}" if len(ious) > 1 else f"{mean:.1f}"


def transfer(page: Page, experiment: Experiment) -> None:
    """Tests networks of one renderer on another."""
    found = {
        (learned, asked): experiment.ious(FULL, learned, asked)
        for learned in _BACKENDS
        for asked in _BACKENDS
    }
    costs = {name: experiment.renders.cost(FULL, name) for name in _BACKENDS}
    page.block(
        "transfer",
        ("trained on", *(f"tested on {name}" for name in _BACKENDS), "CPU s a picture"),
        ((a, *(_said(found[a, b]) for b in _BACKENDS), costs[a]) for a in _BACKENDS),
    )
    means = {key: _mean(ious)[0] for key, ious in found.items()}
    gaps = {
        asked: means[asked, asked]
        - np.mean([means[other, asked] for other in _BACKENDS if other != asked])
        for asked in _BACKENDS
    }
    page.value("gap", ", ".join(f"{value:+.1f} on {name}" for name, value in gaps.items()))
    _shown(page, experiment, means)


def _shown(page: Page, experiment: Experiment, means: dict[tuple[str, str], float]) -> None:
    """The table as a picture, beside answers."""
    figure = plt.figure(figsize=(13, 4.6), constrained_layout=True)
    left, right = figure.subfigures(1, 2, width_ratios=(1, 2.6))
    axes = left.subplots()
    square = np.array([[means[a, b] for b in _BACKENDS] for a in _BACKENDS])
    axes.imshow(square, cmap="viridis", vmin=0, vmax=100)
    for (row, column), value in np.ndenumerate(square):
        axes.text(column, row, f"{value:.1f}", ha="center", va="center",
                  color="white" if value < 60 else "black")  # fmt: skip
    axes.set_xticks(range(len(_BACKENDS)), _BACKENDS)
    axes.set_yticks(range(len(_BACKENDS)), _BACKENDS)
    axes.set_xlabel("tested on")
    axes.set_ylabel("trained on")
    axes.set_title("mean IoU, %", fontsize=10)
    ids = list(range(1, len(CLASSES) + 1))
    palette = label_colors(ids)
    colors = np.array([palette[number] for number in ids], np.uint8)
    frames = experiment.frames(FULL, _OWN, experiment.renders.held_out)
    source = Source(frames.out, _OWN, batches=experiment.renders.held_out)
    chosen = source.frames[:: max(len(source.frames) // 4, 1)][:4]
    rows = ["picture", "truth", *(f"by {name}" for name in _BACKENDS)]
    panels = right.subplots(len(chosen), len(rows), squeeze=False)
    for line, ref in zip(panels, chosen, strict=True):
        frame = source.load(ref, ["rgb", f"label.{LEVEL}"])
        shown = [picture(frame), colors[frame.passes[f"label.{LEVEL}"] - 1]]
        for name in _BACKENDS:
            training = _Training(FULL, name, _SEEDS[0])
            with Image.open(experiment.answers(training) / _OWN / f"{ref.key}.png") as answer:
                shown.append(colors[np.asarray(answer)])
        for panel, image, title in zip(line, shown, rows, strict=True):
            panel.imshow(image, interpolation="nearest")
            panel.set_axis_off()
            if ref is chosen[0]:
                panel.set_title(title, fontsize=9)
    page.save(figure, "transfer", dpi=80)


def ablations(page: Page, experiment: Experiment) -> None:
    """Leaves something out of the pictures learned from."""
    found = {name: experiment.ious(name, _OWN, _OWN) for name in SETTINGS}
    costs = {name: experiment.renders.cost(name, _OWN) for name in SETTINGS}
    whole = _mean(found[FULL])[0]
    page.block(
        "ablations",
        ("learned from", "CPU s a picture", "mean IoU, %", "points"),
        (
            (name, costs[name], _said(ious), f"{_mean(ious)[0] - whole:+.1f}")
            for name, ious in found.items()
        ),
    )


_PARTS = {"transfer": transfer, "ablations": ablations}


def main(page: Page) -> None:
    """Refreshes the page."""
    experiment = Experiment(page)
    for one in experiment.pictures:
        experiment.renders.cost(*one)
    experiment.train_all(experiment.trainings)
    made, trained = experiment.seconds()
    print(f"{made:.0f} CPU s of pictures, {trained:.0f} of training")
    recipe, device = experiment.recipe, experiment.networks.device_name()
    page.value("backbone", recipe.backbone)
    page.value("steps", f"{recipe.steps} steps of {recipe.pictures} pictures, AdamW, {device}")
    parts = [partial(_PARTS[name], experiment=experiment) for name in experiment.parts]
    page.refresh(("torch", "torchvision"), parts)


if __name__ == "__main__":
    run(main, page="experiments", full=False, only=tuple(_PARTS), work="")
