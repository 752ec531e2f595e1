"""Evaluates predictions."""

from __future__ import annotations

from pathlib import Path

from scenec.api.declare import Spread
from scenec.api.options import EvaluateOptions
from scenec.datasets.evaluate import breakdown
from scenec.datasets.evaluate.evaluation import Evaluation
from scenec.datasets.evaluate.predictions import unrendered
from scenec.datasets.source import Source
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.manifest import MANIFEST, STAGE_SUFFIXES

#: Option -> the tasks that it says something about.
BELONGS = {
    "split": ("instances",),
    "max_detections": ("instances",),
    "level": ("instances", "labels"),
    "classes": ("labels",),
    "missing": ("labels", "depth"),
    "depth_scale": ("depth",),
    "median_scaling": ("depth",),
    "min_depth": ("depth",),
    "max_depth": ("depth",),
    "align": ("track",),
    "delta": ("track",),
    "delta_unit": ("track",),
    "max_time_difference": ("track",),
}


@Spread(EvaluateOptions).two
def evaluate(predictions: Path | str, against: Path | str, options: EvaluateOptions) -> Evaluation:
    """Judges predictions: AP, IoU, depth, tracks.

    Args:
        predictions: COCO results (.json), a trajectory (.txt, as TUM has it), or a folder of label
            or depth maps named as frames.
        against: Output folder with frames, a dataset of export coco or tum, or a file of either.
        options: As fields of ``EvaluateOptions``.

    Raises:
        OutputError: What is asked for makes no sense.
        FrameError: A file cannot be read.
    """
    path, against = Path(predictions), Path(against)
    for given in (path, against):
        if not given.exists():
            raise OutputError(f"{given}: no such file or folder")
    task = options.task or _task_of(path, options.depth_scale is not None)
    for name, tasks in BELONGS.items():
        if getattr(options, name) is not None and task not in tasks:
            raise OutputError(
                f"--{name.replace('_', '-')}: is about {' and '.join(tasks)}, and {path} is judged "
                f"as {task} (--task)"
            )
    attributes = breakdown.parse_bins(options.bins)
    return _JUDGES[task](path, against, attributes, options)


def _task_of(path: Path, scaled: bool) -> str:
    """Returns the task of predictions, by their files."""
    if path.is_file():
        task = {".json": "instances", ".txt": "track", ".tum": "track"}.get(path.suffix.lower())
        if task is None:
            raise OutputError(
                f"{path}: expected COCO results (.json), a trajectory (.txt) or a folder of maps; "
                "--task says what it is"
            )
        return task
    suffixes = {one.suffix.lower() for one in path.rglob("*")}
    if suffixes & {".npy", ".exr"} or scaled:
        return "depth"
    if ".png" not in suffixes:
        raise OutputError(f"{path}: holds no .png, .npy or .exr; expected a map for each frame")
    from PIL import Image

    from scenec.datasets.evaluate.predictions import DEEP

    first = min(one for one in path.rglob("*") if one.suffix.lower() == ".png")
    try:
        with Image.open(first) as picture:
            deep = picture.mode in DEEP
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise FrameError(f"{first}: no picture that can be read: {error}") from error
    if deep:
        raise OutputError(
            f"{first}: has 16 bits a pixel, which may be labels or depth; say --task labels, or "
            "--task depth with --depth-scale"
        )
    return "labels"


def _source(against: Path, options: EvaluateOptions) -> Source:
    if not _is_output(against):
        raise OutputError(
            f"{against}: expected an output folder with frames (a {MANIFEST}), or a USD file that "
            "was rendered"
        )
    return Source(
        against,
        options.backend,
        batches=options.batches,
        cameras=options.cameras,
        samples=options.samples,
    )


def _is_output(path: Path) -> bool:
    return (path / MANIFEST).is_file() or path.suffix.lower() in STAGE_SUFFIXES


def _instances(
    path: Path, against: Path, attributes: breakdown.Attributes, options: EvaluateOptions
) -> Evaluation:
    from scenec.datasets.evaluate import coco_files, instances

    source = _source(against, options) if _is_output(against) else None
    if source is not None:
        truth = coco_files.truth_of(source, options.level)
    else:
        _refuse_choice(against, options, "level", "backend", "batches", "cameras", "samples")
        against, truth = coco_files.read_truth(against, options.split)
    detections = coco_files.read_detections(path, truth)
    most = options.max_detections or instances.MAX_DETECTIONS
    found = instances.evaluate_instances(path, detections, against, truth, attributes, most)
    return _without_unrendered(found, source)


def _labels(
    path: Path, against: Path, attributes: breakdown.Attributes, options: EvaluateOptions
) -> Evaluation:
    from scenec.datasets.evaluate.labels import evaluate_labels

    return evaluate_labels(
        path,
        _source(against, options),
        attributes,
        level=options.level,
        classes=options.classes,
        skip_missing=options.missing == "skip",
        progress=options.listener.steps("judged"),
    )


def _depth(
    path: Path, against: Path, attributes: breakdown.Attributes, options: EvaluateOptions
) -> Evaluation:
    from scenec.datasets.evaluate.depth import evaluate_depth

    return evaluate_depth(
        path,
        _source(against, options),
        attributes,
        scale=options.depth_scale,
        median_scaling=bool(options.median_scaling),
        least_m=options.min_depth or 0.0,
        most_m=options.max_depth or float("inf"),
        skip_missing=options.missing == "skip",
        progress=options.listener.steps("judged"),
    )


def _track(
    path: Path, against: Path, attributes: breakdown.Attributes, options: EvaluateOptions
) -> Evaluation:
    from scenec.datasets.evaluate import tracks

    estimate = tracks.read_tum(path)
    source = _source(against, options) if _is_output(against) else None
    if source is not None:
        truth = tracks.track_of(source)
    else:
        _refuse_choice(against, options, "backend", "batches", "cameras", "samples")
        truth = tracks.read_tum(_only_truth(against))
    found = tracks.evaluate_track(
        estimate,
        truth,
        attributes,
        align=options.align or "se3",
        delta=options.delta or 1.0,
        delta_unit=options.delta_unit or "frames",
        max_difference_s=options.max_time_difference or 0.01,
    )
    return _without_unrendered(found, source)


def _without_unrendered(evaluation: Evaluation, source: Source | None) -> Evaluation:
    """Says which frames of the truth there are none of."""
    if source is not None:
        missing = {"frames_not_rendered": len(source.missing)}
        evaluation.settings = {**evaluation.settings, **missing}
        evaluation.notes += unrendered(source)
    return evaluation


def _only_truth(against: Path) -> Path:
    """The true trajectory: a file, or the only one of a dataset."""
    from scenec.datasets.evaluate.tracks import TRUTH

    if against.is_file():
        return against
    files = sorted(against.rglob(TRUTH))
    if len(files) != 1:
        names = ", ".join(one.parent.relative_to(against).as_posix() for one in files[:12])
        raise OutputError(
            f"{against}: expected one {TRUTH}, found {len(files)}"
            + (f"; choose one of the sequences {names}" if files else "")
        )
    return files[0]


def _refuse_choice(against: Path, options: EvaluateOptions, *names: str) -> None:
    """Options that choose frames say nothing about files that hold none."""
    for name in names:
        if getattr(options, name) is not None:
            raise OutputError(f"--{name}: chooses frames of an output folder; {against} is none")


_JUDGES = {"instances": _instances, "labels": _labels, "depth": _depth, "track": _track}
