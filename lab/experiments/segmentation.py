"""Writes docs/segmentation.md: what made pictures teach a network, renderer by renderer.

python lab/experiments/segmentation.py [--fast] [--full] [--only A,B] [-o DIR] [--work DIR]

The experiment of section IV-B of the OAISYS paper. It takes minutes on two cores; ``--full`` makes
more and larger pictures for a larger network. ``--only transfer`` leaves out what is left out of
pictures, ``--only ablations`` the renderers. ``--work`` keeps the frames and the networks' answers,
and goes on where an earlier run left off. Needs the extras `mitsuba`, `cycles`, `pyrender`,
`denoise`, `plots` and `networks`.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.datasets.colors import label_colors
from scenec.datasets.evaluate.labels import evaluate_labels
from scenec.datasets.pictures import picture
from scenec.datasets.source import Source
from scenec.lab.experiments.renders import PREVIEW, Frames, file_name, of_page, words
from scenec.lab.experiments.terrains import CLASSES, FULL, LEVEL, SEED, SETTINGS
from scenec.lab.experiments.torch_modules import needing_torch
from scenec.lab.runner import Page, run, table
from scenec.schemas.errors import OutputError
from scenec.schemas.spelling import nearest

Numbers = NDArray[np.float64]

#: Of rgb, and of what all networks are tested on; the last is what ablations are made with.
_BACKENDS = ("pyrender", "cycles", "mitsuba")
_OWN = "mitsuba"
#: Beside a network's answers: CPU seconds of it.
_SECONDS = "cpu.json"
#: Of trainings.
_SEEDS = (1, 2, 3)
_PARTS = ("transfer", "ablations")

HEAD = """\
# Semantic segmentation

What do made pictures teach a network, and which part of their realism pays? This is the experiment
of section IV-B of the OAISYS paper: sky, sand, gravel, dried mud and rock, told apart pixel by
pixel. The paper tests on 18 photographs labelled by hand. There are none here, so pictures of
**another renderer** stand for what a network has not seen, and nothing below says how well a
network does on photographs.

`python lab/experiments/segmentation.py{words}` made this page on {{cores}} cores
({{versions}}): {batches} terrains, {samples} pictures of {size} pixels of each, seed {seed}; no
network is trained on the last {held} terrains, where all are tested. Every terrain draws its own
relief, grounds, colors, rocks and air; colors of the classes overlap. {spp}

The network is torchvision's LR-ASPP on MobileNetV3-{backbone}, from random weights, since the
experiment downloads nothing: {steps} steps of {pictures} pictures, AdamW, {device}. Each is
trained {runs} times, by seeds {seeds}; "±" is the standard deviation over them.
[`scenec evaluate`](evaluate.md) counts the intersection over union (IoU) of each class over all
held-out pictures. Making the pictures took {made:.0f} CPU s, where stages that are shared count for
each that shows them; training and answering took {trained:.0f} CPU s.
"""


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
        for name in page.options.only:
            if name not in _PARTS:
                raise OutputError(f"--only: there is no part {name!r}{nearest(name, _PARTS)}")
        self.parts = page.options.only
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
        with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
            jobs = [
                pool.submit(
                    self.networks.judged_by,
                    self.frames(one.setting, one.backend, self.renders.train),
                    self._tests(one.setting),
                    self.recipe,
                    one.seed,
                    self.answers(one),
                )
                for one in left
            ]
            for one, job in zip(left, jobs, strict=True):
                text = json.dumps(job.result())
                (self.answers(one) / _SECONDS).write_text(text, encoding="utf-8")

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


def _by_class(ious: Numbers) -> list[str]:
    return [f"{100.0 * value:.1f}" for value in np.nanmean(ious, axis=0)]


def transfer(page: Page, experiment: Experiment) -> str:
    """Trained on one renderer, tested on another."""
    found = {
        (learned, asked): experiment.ious(FULL, learned, asked)
        for learned in _BACKENDS
        for asked in _BACKENDS
    }
    whole = table(
        ("trained on", *(f"tested on {name}" for name in _BACKENDS), "CPU s a picture"),
        [
            (
                learned,
                *(_said(found[learned, asked]) for asked in _BACKENDS),
                experiment.renders.cost(FULL, learned),
            )
            for learned in _BACKENDS
        ],
    )
    classes = table(
        ("trained on", "tested on", *CLASSES),
        [(learned, asked, *_by_class(ious)) for (learned, asked), ious in found.items()],
    )
    means = {key: _mean(ious)[0] for key, ious in found.items()}
    gaps = {
        asked: means[asked, asked]
        - np.mean([means[other, asked] for other in _BACKENDS if other != asked])
        for asked in _BACKENDS
    }
    gap = ", ".join(f"{value:+.1f} on {name}" for name, value in gaps.items())
    return (
        "## From renderer to renderer\n\nMean IoU over the five classes, percent. All three draw "
        "the same stages; pyrender is a rasterizer, whose light from surface to surface is an "
        f"estimate. A CPU second counts compiling, rendering and annotating.\n\n{whole}\n"
        f"What training on the tested renderer itself gains over the mean of the others: {gap} "
        "points. A gain within the spreads is none: then pictures of the one are as good a "
        f"teacher for the other as its own.\n\nBy class, percent, means over seeds:\n\n{classes}\n"
        + _shown(page, experiment, means)
    )


def _shown(page: Page, experiment: Experiment, means: dict[tuple[str, str], float]) -> str:
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
    shown_as = page.save(figure, "transfer", dpi=80)
    return (
        f"{shown_as}\nRight: held-out pictures of {_OWN}, and the answers of networks trained on "
        f"frames of each renderer (seed {_SEEDS[0]}).\n"
    )


def ablations(page: Page, experiment: Experiment) -> str:
    """What is left out of the pictures learned from."""
    found = {name: experiment.ious(name, _OWN, _OWN) for name in SETTINGS}
    costs = {name: experiment.renders.cost(name, _OWN) for name in SETTINGS}
    whole = _mean(found[FULL])[0]
    rows = [
        (name, costs[name], _said(ious), f"{_mean(ious)[0] - whole:+.1f}", *_by_class(ious))
        for name, ious in found.items()
    ]
    figure, axes = plt.subplots(figsize=(8, 4.4), constrained_layout=True)
    for name, ious in found.items():
        mean, spread = _mean(ious)
        axes.errorbar(costs[name], mean, spread, fmt="o", capsize=3, label=name)
    axes.set_xlabel("CPU s a picture")
    axes.set_ylabel("mean IoU on full pictures, %")
    axes.set_xlim(left=0)
    axes.grid(visible=True, linewidth=0.3, alpha=0.6)
    axes.legend(fontsize=8)
    header = ("learned from", "CPU s a picture", "mean IoU, %", "points", *CLASSES)
    return (
        "## What realism pays\n\nNetworks learn from pictures that lack one thing, and are tested "
        f"on held-out ones that have everything; all by {_OWN}. Terrains, "
        "rocks, suns and places stay the same. Points are those lost or won "
        f"against everything; those within the spreads say nothing.\n\n{table(header, rows)}\n"
        + page.save(figure, "ablations")
        + "\nError bars are one standard deviation over seeds of training.\n"
    )


def main(page: Page) -> None:
    """Writes the page."""
    start = time.perf_counter()
    experiment = Experiment(page)
    renders = experiment.renders
    for one in experiment.pictures:
        experiment.renders.cost(*one)
    experiment.train_all(experiment.trainings)
    made, trained = experiment.seconds()
    only = page.options.only
    parts = {"transfer": transfer, "ablations": ablations}
    head = HEAD.format(
        words=words(page) + ("" if only == _PARTS else f" --only {','.join(only)}"),
        batches=renders.batches,
        samples=renders.samples,
        size="{} × {}".format(*renders.resolution),
        seed=SEED,
        held=renders.held,
        spp=f"Cycles and Mitsuba take {SETTINGS[FULL].words[-1]} samples a pixel, pyrender "
        f"{PREVIEW[-1]}.",
        backbone=experiment.recipe.backbone,
        steps=experiment.recipe.steps,
        pictures=experiment.recipe.pictures,
        device=experiment.networks.device_name(),
        runs=len(experiment.seeds),
        seeds=", ".join(map(str, experiment.seeds)),
        made=made,
        trained=trained,
    )
    packages = ("torch", "torchvision", "mitsuba", "bpy", "pyrender-maintained")
    page.write(
        head,
        packages,
        [lambda page, part=parts[name]: part(page, experiment) for name in experiment.parts],
    )
    print(f"{time.perf_counter() - start:.0f} s in all")


if __name__ == "__main__":
    run(main, page="segmentation", full=False, only=_PARTS, work="")
