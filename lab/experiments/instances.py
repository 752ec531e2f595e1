"""Makes the tables of docs/experiments.md: rocks found by a network, and followed.

python lab/experiments/instances.py [--fast] [--full] [--only A,B] [-o DIR] [--work DIR]

The experiment of section IV-C of the OAISYS paper. It takes minutes on two cores; ``--full`` makes
more and larger pictures. ``--only tracking`` trains no network, and takes seconds; ``--only
detection`` follows nothing. ``--work`` keeps the frames, which are those of segmentation.py, and
the network's answers, and goes on where an earlier run left off. Needs the extras `mitsuba`,
`coco`, `plots` and `networks`, and TrackEval (``pip install --no-deps trackeval``); tracking needs
`coco`, `plots` and TrackEval alone.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from scenec.datasets.colors import paint_instances
from scenec.datasets.evaluate.coco_files import read_detections, read_truth
from scenec.datasets.evaluate.evaluation import Evaluation
from scenec.datasets.evaluate.instances import evaluate_instances
from scenec.datasets.evaluate.plots import COLORS
from scenec.datasets.pictures import picture
from scenec.datasets.source import Source
from scenec.lab.experiments.renders import (
    Frames,
    Renders,
    chosen,
    of_page,
    on_all_cores,
)
from scenec.lab.experiments.terrains import FULL, SEED, cfg
from scenec.lab.experiments.torch_modules import needing_torch
from scenec.lab.experiments.tracking import Shown, linked_by_boxes, numbered_anew, scores
from scenec.lab.runner import SCENEC, Page, command, run

_BACKEND = "mitsuba"
#: Of trainings.
_SEEDS = (1, 2, 3)
#: COCO's numbers of masks and boxes.
_MEASURES = ("ap", "ap50", "ap75", "ar_100")


class Experiment:
    """Makes pictures, trains networks on them and judges these.

    Args:
        page: Where it is told.
    """

    def __init__(self, page: Page) -> None:
        self.detection = needing_torch("detection")
        self.renders = of_page(page)
        steps = 20_000 if page.options.full else 3 if page.fast else 400
        self.recipe = self.detection.recipe(steps)
        self.seeds = _SEEDS[:1] if page.fast else _SEEDS
        self.made = self.renders.cost(FULL, _BACKEND) * self.renders.count(FULL)
        self.dataset = self._export()
        self.trained = sum(self._answered())
        self.truth = read_truth(self.dataset, "val")[1]
        self.judged = [self._judge(seed) for seed in self.seeds]

    @property
    def test(self) -> Frames:
        """Held-out pictures."""
        return Frames(self.renders.out(FULL), _BACKEND, self.renders.held_out)

    def answers(self, seed: int) -> Path:
        """A network's answers, as COCO's results."""
        return self.renders.work / "answers" / f"instances_{seed}.json"

    def _export(self) -> Path:
        """All pictures as COCO; what is too small to be asked for is marked as not to be judged."""
        folder = self.renders.work / "coco"
        held = self.renders.held_out
        splits = f"train=0:{held.start},val={held.start}:{held.stop}"
        command((*SCENEC, "export", self.renders.out(FULL), "--format", "coco",
                 "--backend", _BACKEND, "--split", splits,
                 "--keep", f"area>={self.detection.LEAST_PIXELS}", "--rejected", "ignore",
                 "--replace", "-o", folder))  # fmt: skip
        return folder

    def _answered(self) -> list[float]:
        """Trains networks that are not trained yet, one a core; returns CPU seconds of each."""
        numbers = [one["id"] for one in read_truth(self.dataset, "val")[1]["images"]]
        seconds = {seed: self.answers(seed).with_suffix(".cpu.json") for seed in self.seeds}
        left = [seed for seed, file in seconds.items() if not file.exists()]
        train = Frames(self.renders.out(FULL), _BACKEND, self.renders.train)
        self.answers(0).parent.mkdir(parents=True, exist_ok=True)
        same = self.detection.detected_by, train, self.test, self.renders.resolution, self.recipe
        calls = [(*same, seed) for seed in left]
        for seed, (found, spent) in zip(left, on_all_cores(calls), strict=True):
            named = [one | {"image_id": numbers[one["image_id"] - 1]} for one in found]
            self.answers(seed).write_text(json.dumps(named), encoding="utf-8")
            seconds[seed].write_text(json.dumps(spent), encoding="utf-8")
        return [json.loads(file.read_text(encoding="utf-8")) for file in seconds.values()]

    def _judge(self, seed: int) -> Evaluation:
        found = read_detections(self.answers(seed), self.truth)
        return evaluate_instances(self.answers(seed), found, self.dataset, self.truth, {})


def _spread(values: Iterable[float | None], factor: float = 100.0) -> str | None:
    known = [factor * value for value in values if value is not None]
    if not known:
        return None
    if len(known) == 1:
        return f"{known[0]:.1f}"
    return f"{np.mean(known):.1f} ± {np.std(known, ddof=1):.1f}"


def found(page: Page) -> None:
    """Finds rocks in single pictures."""
    experiment = Experiment(page)
    page.block(
        "found",
        ("", "AP", "AP at IoU 0.5", "AP at IoU 0.75", "recall, at most 100"),
        (
            (
                what,
                *(_spread(e.measures[f"{kind}_{m}"] for e in experiment.judged) for m in _MEASURES),
            )
            for what, kind in (("masks", "segm"), ("boxes", "bbox"))
        ),
    )
    recipe, truth = experiment.recipe, experiment.truth
    print(f"{experiment.made:.0f} CPU s of pictures, {experiment.trained:.0f} of training")
    page.value("rcnn_steps", f"{recipe.steps} steps of {recipe.pictures} pictures")
    page.value("rocks", str(sum(not one["iscrowd"] for one in truth["annotations"])))
    page.value("pictures", str(len(truth["images"])))
    _drawn(page, experiment)


def _drawn(page: Page, experiment: Experiment) -> None:
    """Held-out pictures with what was found, and precision against recall."""
    from pycocotools import mask as run_lengths

    figure = plt.figure(figsize=(13, 4.4), constrained_layout=True)
    left, right = figure.subfigures(1, 2, width_ratios=(1, 2.4))
    axes = left.subplots()
    recall = np.linspace(0, 1, 101)
    for seed, one, color in zip(experiment.seeds, experiment.judged, COLORS, strict=False):
        axes.plot(recall, one.arrays["precision"][:, 0], color=color, label=f"seed {seed}")
    axes.set_xlabel("recall")
    axes.set_ylabel("precision, IoU 0.5")
    axes.set_ylim(0, 1)
    axes.grid(visible=True, linewidth=0.3, alpha=0.6)
    axes.legend(fontsize=8)
    source = Source(experiment.test.out, _BACKEND, batches=experiment.test.batches)
    answers = json.loads(experiment.answers(experiment.seeds[0]).read_text(encoding="utf-8"))
    numbers = [one["id"] for one in experiment.truth["images"]]
    step = max(len(source.frames) // 4, 1)
    chosen = list(zip(source.frames, numbers, strict=True))[::step][:4]
    panels = right.subplots(3, len(chosen), squeeze=False)
    for column, (ref, number) in zip(panels.T, chosen, strict=True):
        frame = source.load(ref, ["rgb", "instance"])
        ids = np.zeros((frame.height, frame.width), np.uint32)
        sure = [a for a in answers if a["image_id"] == number and a["score"] >= 0.5]
        for i, one in enumerate(sorted(sure, key=lambda a: a["score"]), 1):
            ids[run_lengths.decode(one["segmentation"]) > 0] = i
        images = picture(frame), paint_instances(frame.passes["instance"]), paint_instances(ids)
        for panel, image in zip(column, images, strict=True):
            panel.imshow(image, interpolation="nearest")
            panel.set_axis_off()
    for panel, title in zip(panels[:, 0], ("picture", "truth", "found"), strict=True):
        panel.set_title(title, fontsize=9, loc="left")
    page.save(figure, "found", dpi=80)


def followed(page: Page) -> None:
    """Follows rocks through a sequence."""
    frames = 6 if page.fast else 24
    out = _sequence(of_page(page), frames)
    dataset = out / "datasets" / "coco"
    command((*SCENEC, "export", out, "--format", "coco", "--replace", "-o", dataset))
    truth = _true(out)
    exported = _exported(dataset)
    trackers = {
        "ids as exported": [one.ids for one in exported],
        "linked by overlapping boxes": linked_by_boxes(exported),
        "numbered anew in each picture": numbered_anew(exported),
    }
    found = {name: scores(truth, exported, ids) for name, ids in trackers.items()}
    page.block(
        "tracked",
        ("tracker", *next(iter(found.values()))),
        (
            (name, *(f"{one[c]:.0f}" if c == "switches" else f"{one[c]:.3f}" for c in one))
            for name, one in found.items()
        ),
    )
    rocks = len(np.unique(np.concatenate([one.ids for one in truth])))
    seen = sum(len(one.ids) for one in truth)
    page.value("sequence", f"{frames} pictures, {rocks} rocks, seen {seen} times in all")


def _sequence(renders: Renders, frames: int) -> Path:
    """Output folder of one terrain that a camera circles over; annotation alone."""
    made = cfg(renders.resolution, 1, frames)
    made["outputs"] = ["label", "instance"]
    made["rigs"]["rover"]["pose"] = {
        "type": "orbit", "center": {"type": "point", "x_m": 0, "y_m": 0}, "radius_m": 6,
        "height_m": 2.5, "sweep_deg": 5 * (frames - 1),
    }  # fmt: skip
    folder = renders.work / "sequence"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cfg.json").write_text(json.dumps(made), encoding="utf-8")
    command((*SCENEC, "run", folder / "cfg.json", "--seed", str(SEED), "--replace",
             "--backend", "annotation", "--passes", "label,instance",
             "-o", folder / "out"))  # fmt: skip
    return folder / "out"


def _true(out: Path) -> list[Shown]:
    """Rocks as the frames have them."""
    source = Source(out)
    found = []
    for ref in source.frames:
        frame = source.load(ref, ["instance"])
        ids = frame.table["id"].astype(np.int64)
        masks = frame.passes["instance"].astype(np.int64)[None] == ids[:, None, None]
        corners = [frame.table[k] for k in ("x_min", "y_min", "x_max", "y_max")]
        boxes = np.stack(corners, axis=-1).astype(np.float64)
        # Columns and rows that are the last of it.
        boxes[:, 2:] += 1.0
        found.append(Shown(ids, masks, boxes))
    return found


def _exported(dataset: Path) -> list[Shown]:
    """Rocks as a COCO dataset has them."""
    from pycocotools import mask as run_lengths

    document = read_truth(dataset)[1]
    found = []
    for image in document["images"]:
        mine = [one for one in document["annotations"] if one["image_id"] == image["id"]]
        ids = np.array([one["track_id"] for one in mine], np.int64)
        shape = (0, image["height"], image["width"])
        masks = [run_lengths.decode(one["segmentation"]) > 0 for one in mine]
        boxes = np.array([one["bbox"] for one in mine], np.float64).reshape(-1, 4)
        boxes[:, 2:] += boxes[:, :2]
        found.append(Shown(ids, np.array(masks, bool) if masks else np.zeros(shape, bool), boxes))
    return found


PARTS = {"detection": found, "tracking": followed}


def main(page: Page) -> None:
    """Refreshes the page.

    Raises:
        OutputError: There is no such part, or a package is not installed.
    """
    page.refresh(
        ("torch", "torchvision", "trackeval"), [PARTS[name] for name in chosen(page, PARTS)]
    )


if __name__ == "__main__":
    run(main, page="experiments", full=False, only=tuple(PARTS), work="")
