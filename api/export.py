"""Frames to a dataset, stages to files of 3D formats."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from scenec.api.declare import Spread
from scenec.api.maps import export_maps
from scenec.api.models import ModelsReport, export_models
from scenec.api.options import ExportOptions
from scenec.api.rectify import rectify
from scenec.api.steps import hire
from scenec.api.tracks import export_tracks
from scenec.datasets.export import Choice, ExportReport
from scenec.datasets.export import export as export_frames
from scenec.datasets.filters import make_filters
from scenec.datasets.maps import MAP
from scenec.datasets.models import MODEL_FORMATS
from scenec.datasets.remap import Remap, read_remap
from scenec.datasets.splits import parse_splits
from scenec.datasets.tracks import TAPVID
from scenec.schemas.budget import usable_cores
from scenec.schemas.errors import OutputError
from scenec.schemas.imu import RigState
from scenec.schemas.sweep import is_sweep


@Spread(ExportOptions).two
def export(out: Path | str, format: str, options: ExportOptions) -> ExportReport | ModelsReport:
    """Exports frames to a dataset: COCO, HDF5, TUM, …; or stages to glTF, USDZ, maps, point tracks.

    Args:
        out: Output folder with frames, a whole sweep of such, or a USD file that was rendered.
        format: Its name, see ``scenec export --list``.
        options: As fields of ``ExportOptions``.

    Raises:
        FrameError: A frame is missing, foreign or damaged.
        OutputError: What is asked for makes no sense, or there is another dataset.
    """
    if format in (MAP, TAPVID, *MODEL_FORMATS) and is_sweep(Path(out)):
        raise OutputError(f"{out}: is a sweep; format {format} takes the output of one point")
    if format == MAP:
        return export_maps(Path(out), options)
    if format == TAPVID:
        return export_tracks(Path(out), options)
    if format in MODEL_FORMATS:
        return export_models(Path(out), format, options)
    workers = options.workers if options.workers is not None else usable_cores()
    with hire(replace(options, workers=workers)) as executor:
        choice = choice_of(options)
        if options.rectify:
            choice = replace(choice, rectified=rectify(Path(out), options, executor))
        return export_frames(
            out,
            format,
            options.folder,
            choice,
            executor=executor,
            replace=options.replace,
            progress=options.listener.steps("exported", unit="step"),
            say=options.listener.say,
        )


def choice_of(options: ExportOptions) -> Choice:
    """Returns the choice of frames and options that an export's options describe.

    Raises:
        OutputError: An option makes no sense.
    """
    settings: dict[str, str] = {}
    for text in options.settings:
        name, equals, value = text.partition("=")
        if not equals:
            raise OutputError(f"--set {text!r}: expected NAME=VALUE")
        settings[name.strip()] = value.strip()
    return Choice(
        backend=options.backend,
        batches=options.batches,
        cameras=options.cameras,
        samples=options.samples,
        filters=make_filters(options.keep, options.rejected),
        remap=read_remap(options.remap) if options.remap else Remap(),
        splits=parse_splits(options.split) if options.split else {},
        split_seed=options.split_seed,
        level=options.level,
        options=settings,
        faults=options.faults,
        rigs=_read_rigs,
    )


def _read_rigs(stage: Path) -> tuple[RigState, ...]:
    """Reads the rigs of a stage; none where it is gone and its frames remain."""
    if not stage.is_file():
        return ()
    # OpenUSD is loaded here, where a format asks for rigs.
    from scenec.backends.stage.rigs import read_rigs

    return read_rigs(stage)
