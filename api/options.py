"""Declares the options of each call.

A field made by ``option`` is an option of a command, too, whose help, form and default it has.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenec.api import forms
from scenec.api.declare import CallOptions, held, option
from scenec.schemas.errors import ScenecError
from scenec.schemas.passes import PASSES

if TYPE_CHECKING:
    from scenec.schemas.units import Executor

#: As in ``scenec.compiler.compile``, which would cost the import of NumPy; a test compares them.
FAULTS = ("stop", "skip", "redraw")


def _span(help: str) -> Any:
    return option(None, help, form=forms.span, metavar="A:B")


def _workers(default: str) -> Any:
    return option(
        None,
        "processes that work side by side, each with its share of the cores; 0: none but this "
        f"one (default: {default})",
        form=forms.workers,
        metavar="N",
    )


def _workers_or_auto() -> Any:
    return option(
        None,
        "processes that work side by side, each with its share of the cores; 0: none but this "
        "one; auto: as many as cores, memory and GPU suggest (default: $SCENEC_WORKERS, or auto)",
        form=forms.workers_or_auto,
        metavar="N|auto",
    )


@dataclass(frozen=True, kw_only=True)
class WorkOptions(CallOptions):
    """Holds options of workers.

    Attributes:
        executor: Who works, in the place of ``workers`` and ``cluster``.
    """

    workers: int | str | None = _workers("$SCENEC_WORKERS, or 1")
    cluster: str | None = option(
        None,
        "workers of a dask cluster instead: its scheduler's address or file, or local "
        "(docs/cluster.md)",
        metavar="ADDRESS",
    )
    executor: Executor | None = None


@dataclass(frozen=True, kw_only=True)
class StageOptions(WorkOptions):
    """Holds options of stages' compilation.

    Attributes:
        cache: True for the folder that ``$SCENEC_CACHE`` names, or the user's; a folder; or False,
            to make all anew and keep nothing.
    """

    keep: str = option(
        "seen",
        "seen: what cameras can see the effect of (default); unpruned: all, as fine as then; "
        "all: all, as fine out of view as in view, for walking around in a viewer",
        choices=("seen", "unpruned", "all"),
    )
    cache: bool | Path | str = option(
        True,
        "folder of what earlier compilations made, taken where nothing it depends on has "
        "changed: the same bytes, sooner (default: $SCENEC_CACHE, or scenec in the user's folder "
        "for caches; at most $SCENEC_CACHE_MAX, 4G; safe to delete)",
        metavar="DIR",
    )
    replace: bool = option(
        False,
        "replace what OUT holds of another cfg, seed, --keep or version: its batches go, and "
        "frames and scans of stages that change; run and sweep render frames again, too, that are "
        "there with other options; files of your own stay",
    )
    faults: str = option(
        "stop",
        "at a batch that cannot be built: stop (default), skip it and leave with exit status "
        "1, or redraw it, the same each time, and skip it after 16 attempts",
        choices=FAULTS,
    )
    batches: range | None = _span("only batches A to B-1")


@dataclass(frozen=True, kw_only=True)
class CompileOptions(StageOptions):
    """Holds options of ``compile``."""

    settings: Sequence[str] = option(
        (),
        "put a value, JSON or a bare word, at a place of the cfg: terrain.spacing_m=0.2, "
        "'terrain.relief[0].amplitude_m=3', objects.rocks=null to take a key away (repeatable)",
        flag="--set",
        many=True,
        metavar="PATH=VALUE",
    )
    seed: int = option(0, "whole number from 0 to 2^64 - 1 (default: 0)", form=forms.seed)
    workers: int | str | None = _workers("0")


@dataclass(frozen=True, kw_only=True)
class PictureOptions(WorkOptions):
    """Holds options of pictures: their passes, quality and renderer.

    Attributes:
        cameras: Only these, by name.
    """

    backend: str = option(
        "mitsuba",
        "renderer of rgb (default: mitsuba); auto is the first that works here, the most "
        "efficient first where scenec converge has measured; without rgb none is needed",
    )
    spp: int | None = option(
        None,
        "samples per pixel of rgb (default: 64); with --error or --seconds the most there may "
        "be (default: 4096)",
        form=forms.positive,
    )
    error: float | None = option(
        None,
        "render rgb in rounds until its relative rms error is below E (0.05 is 5 %%), by its "
        "95 %% bound",
        form=forms.amount,
        metavar="E",
    )
    seconds: float | None = option(
        None,
        "render rgb in rounds for S seconds a frame; not reproducible, since machines differ",
        form=forms.amount,
        metavar="S",
    )
    passes: Sequence[str] | None = option(
        None,
        f"of {','.join(PASSES)}; default: the cfg's, with --backend annotation all of these "
        "but rgb",
        form=forms.passes,
        metavar="A,B,…",
    )
    samples: Collection[int] | None = _span("only these samples of each batch")
    noise_seed: int = option(0, "seed of the renderer's noise (default: 0)", form=forms.seed)
    device: str = option(
        "auto",
        "where the renderer runs: cpu, cuda, or what else it has (default: auto, the fastest "
        "that works here)",
        metavar="NAME",
    )
    denoise: bool = option(
        False,
        "denoise rgb, if the renderer has a denoiser; refused where a camera has an aperture "
        "or moves while its shutter is open",
    )
    rgb: str = option(
        "float",
        "rgb in frames as float, or as half: a fourth of the bytes, 11 bits of each number, "
        "65504 at most (default: float)",
        choices=("float", "half"),
    )
    timeout: float | None = option(
        None,
        "end and retry a frame that takes longer; a fresh process's first one may take 60 s "
        "more (default: only what hangs is ended, after 120 s without progress)",
        form=forms.amount,
        metavar="SECONDS",
    )
    memory_limit: float | None = option(
        None,
        "memory a renderer's process may hold before it is replaced "
        "(default: 80 %% of what there is)",
        form=forms.amount,
        metavar="GB",
    )
    cameras: Sequence[str] | None = held(None, form=forms.names)


#: Of ``render``, ``scan`` and ``check`` alike.
ALLOW_MISSING = (
    "read what is there of a stage that lacks layers, prims or pictures, or whose files "
    "are not those of the manifest (default: that is an error)"
)


@dataclass(frozen=True, kw_only=True)
class RenderOptions(PictureOptions):
    """Holds options of ``render``.

    Attributes:
        folder: Where frames go; None puts them into the batches' own folders.
    """

    batches: Collection[int] | None = _span("only batches A to B-1")
    replace: bool = option(
        False,
        "render frames again that are there with other samples, target, noise seed, denoising "
        "or passes (default: that is an error; frames that hold more passes count as made)",
    )
    allow_missing: bool = option(False, ALLOW_MISSING)
    workers: int | str | None = _workers_or_auto()
    folder: Path | str | None = None


@dataclass(frozen=True, kw_only=True)
class ScanOptions(WorkOptions):
    """Holds options of ``scan``."""

    samples: Collection[int] | None = _span("only these samples")
    lidars: Sequence[str] | None = option(
        None, "only these, by name: RIG_LIDAR", form=forms.listed, metavar="A,B,…"
    )
    ply: bool = option(False, "write clouds of points as PLY, too, in the lidar's frame")
    pcd: bool = option(False, "the same as PCD")
    las: bool = option(False, "the same as LAS, in the world; needs the extra las")
    allow_missing: bool = option(False, ALLOW_MISSING)
    batches: Collection[int] | None = _span("only batches A to B-1")


@dataclass(frozen=True, kw_only=True)
class RunOptions(CompileOptions, PictureOptions):
    """Holds options of ``run``, which compiles and renders."""

    workers: int | str | None = _workers_or_auto()


@dataclass(frozen=True, kw_only=True)
class SweepOptions(StageOptions, PictureOptions):
    """Holds options of ``sweep``: values to vary, and how to compile and render."""

    values: Mapping[str, Sequence[object]] | Sequence[str] = option(
        (),
        "values of a place of the cfg, as of run --set; several are all combined (repeatable)",
        flag="--set",
        many=True,
        metavar="PATH=VALUE,…",
    )
    in_step: bool = option(
        False,
        "the first values of all lists together, then the second ones …, not each with each",
        flag="--zip",
    )
    seeds: Sequence[int] = option(
        range(1), "seeds A to B-1 (default: 0:1)", form=forms.span, metavar="A:B"
    )
    compile_only: bool = option(False, "make the stages alone: render and scan nothing")

    def __post_init__(self) -> None:
        """Holds each seed to be one, too, of whatever type.

        Raises:
            ScenecError: One is none.
        """
        super().__post_init__()
        seeds = self.seeds
        try:
            # Of a range its ends tell, however long it is.
            given = [*seeds[:1], *seeds[-1:]] if isinstance(seeds, range) else seeds
            read = [forms.seed(str(one)) for one in given]
            object.__setattr__(self, "seeds", seeds if isinstance(seeds, range) else read)
        except ScenecError as error:
            raise ScenecError(f"seeds: {error}") from error


@dataclass(frozen=True, kw_only=True)
class PreviewOptions(CallOptions):
    """Holds options of a preview.

    Attributes:
        settings, seed, cache: As of ``CompileOptions``.
    """

    backend: str = option("auto", "who draws (default: auto, the quickest that works here)")
    spp: int | None = option(
        None, "samples a pixel (default: 8, of a path tracer 4, denoised)", form=forms.positive
    )
    width: int = option(480, "of pictures (default: 480)", form=forms.positive, metavar="PX")
    settings: Sequence[str] = held((), many=True)
    seed: int = held(0, form=forms.seed)
    cache: bool | Path | str = True


@dataclass(frozen=True, kw_only=True)
class CheckOptions(CallOptions):
    """Holds options of ``check``: what to check besides the files."""

    backends: Sequence[str] = option(
        (),
        "compare the frames of these pixel by pixel; missing ones are rendered",
        form=forms.listed,
        metavar="A,B,…",
    )
    exact: bool = option(
        False, "cast every pixel of the frames there are through the exact ray caster"
    )
    against: Path | str | None = option(
        None,
        "another dataset or output folder: is the annotation of all frames the same",
        metavar="OTHER",
    )
    spp: int = option(64, "of rgb that has to be rendered (default: 64)", form=forms.positive)
    passes: Sequence[str] | None = option(
        None, "compare only these", form=forms.passes, metavar="A,B,…"
    )
    samples: Collection[int] | None = _span("compare only these samples")
    floor: bool = option(
        False, "render the first backend with another noise seed too: the FLIP of noise alone"
    )
    pictures: int = option(
        8,
        "pictures of where two backends differ, in OUT/check (default: 8 a pair)",
        form=forms.counted,
        metavar="N",
    )
    allow_missing: bool = option(False, ALLOW_MISSING)


@dataclass(frozen=True, kw_only=True)
class FrameOptions(CallOptions):
    """Selects frames of an output."""

    backend: str | None = option(None, "whose frames (default: the first there is)")
    batches: Collection[int] | None = _span("only batches A to B-1")
    cameras: Sequence[str] | None = option(
        None, "only these cameras", form=forms.names, metavar="A,B,…"
    )
    samples: Collection[int] | None = _span("only these samples")


@dataclass(frozen=True, kw_only=True)
class ExportOptions(FrameOptions, WorkOptions):
    """Holds options of ``export``.

    Attributes:
        folder: Of the dataset; None takes ``OUT/datasets/FORMAT``.
    """

    keep: Sequence[str] = option(
        (),
        "only instances of which it holds, see below; may be given several times",
        many=True,
        metavar="CONDITION",
    )
    rejected: str = option(
        "drop",
        "drop the other instances, or keep them marked as not to be judged (default: drop)",
        choices=("drop", "ignore"),
    )
    remap: Path | str | None = option(
        None, "file of other label names and ids: {level: {old: new}}", metavar="JSON"
    )
    level: str | None = option(None, "level whose labels are the categories (default: the first)")
    split: str | None = option(
        None,
        "splits by whole batches: shares (train=0.8,val=0.2) or ranges (train=0:8,val=8:10)",
        metavar="A=X,B=Y,…",
    )
    split_seed: int = option(0, "of the assignment (default: 0)", form=forms.seed, metavar="N")
    settings: Sequence[str] = option(
        (),
        "option of the format, see --list; may be given several times",
        flag="--set",
        many=True,
        metavar="NAME=VALUE",
    )
    faults: str = option(
        "stop",
        "what to do about missing, foreign and damaged frames (default: stop)",
        choices=("stop", "skip"),
    )
    rectify: bool = option(
        False,
        "take cameras with lenses to pinholes, and partners to rectified pairs: pictures are "
        "resampled, annotation is exact",
    )
    replace: bool = option(False, "replace another dataset in the same folder")
    workers: int | None = _workers("one a core")
    folder: Path | str | None = None


@dataclass(frozen=True, kw_only=True)
class ViewOptions(CallOptions):
    """Holds options of ``view``, a page of frames.

    Attributes:
        page: The HTML file; None takes ``OUT/view.html``.
    """

    backend: Sequence[str] | None = option(
        None,
        "whose frames (default: all there are; with --rerun the first)",
        form=forms.names,
        metavar="A,B,…",
    )
    budget_mb: float = option(
        200.0,
        "size of the page at most; frames are stored as finely as that allows (default: 200)",
        form=forms.amount,
        metavar="MB",
    )
    no_ground: bool = option(
        False, "do not read the stages: no ground on the map, no sun in the statistics"
    )
    faults: str = option(
        "skip",
        "frames that are damaged or foreign: name them on the page, or stop (default: skip)",
        choices=("skip", "stop"),
    )
    workers: int | None = option(
        None, "processes (default: one a core)", form=forms.positive, metavar="N"
    )
    page: Path | str | None = None


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(FrameOptions):
    """Holds options of ``evaluate``; each is about the tasks that its help begins with."""

    task: str | None = option(
        None,
        "what the predictions are (default: by their files)",
        choices=("instances", "labels", "depth", "track"),
    )
    bins: Sequence[str] = option(
        (),
        "other edges for distance, size, area, occlusion, truncation or sun",
        many=True,
        metavar="NAME=A,B,…",
    )
    split: str | None = option(None, "instances: of a dataset with several", metavar="NAME")
    max_detections: int | None = option(
        None,
        "instances: of a picture and class (default: 100, as COCO has it)",
        form=forms.positive,
        metavar="N",
    )
    level: str | None = option(
        None, "instances, labels: which labels (default: the first)", metavar="NAME"
    )
    classes: Sequence[str] | None = option(
        None,
        "labels: what the values 0, 1, 2 … are, by position; names may repeat, (none) or "
        "nothing between two commas is no class (default: values are label ids)",
        form=forms.positions,
        metavar="A,B,…",
    )
    missing: str | None = option(
        None,
        "labels, depth: frames without a prediction (default: stop)",
        choices=("stop", "skip"),
    )
    depth_scale: float | None = option(
        None, "depth: steps of a PNG a meter", form=forms.amount, metavar="N"
    )
    median_scaling: bool | None = option(
        None, "depth: scale each frame's prediction to the true median", const=True
    )
    min_depth: float | None = option(
        None, "depth: nearer truth is not judged", form=forms.amount, metavar="M"
    )
    max_depth: float | None = option(
        None, "depth: farther truth is not judged", form=forms.amount, metavar="M"
    )
    align: str | None = option(
        None,
        "track: how positions are laid on the truth (default: se3)",
        choices=("se3", "sim3", "origin", "none"),
    )
    delta: float | None = option(
        None, "track: step of the relative error (default: 1)", form=forms.amount, metavar="N"
    )
    delta_unit: str | None = option(
        None, "track: of that step (default: frames)", choices=("frames", "m")
    )
    max_time_difference: float | None = option(
        None,
        "track: of poses that are compared (default: 0.01)",
        form=forms.amount,
        metavar="S",
    )
