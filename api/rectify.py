"""Takes cameras of an output to pinholes, for exports that are asked for that."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from scenec.api.options import ExportOptions
from scenec.backends.run.rectify import RectifiedOpening, RectifyFrame
from scenec.datasets.formats.rectify import pinholes
from scenec.datasets.source import Source
from scenec.schemas.errors import FrameError
from scenec.schemas.manifest import RECTIFIED
from scenec.schemas.units import Executor, run_all


def rectify(out: Path, options: ExportOptions, executor: Executor) -> frozenset[tuple[int, str]]:
    """Writes the rectified frames of those that an export takes, unless they are there.

    Args:
        out: Output folder, or a USD file that was rendered.
        options: Of the export.
        executor: Who makes them.

    Returns:
        Batches and cameras that have any.

    Raises:
        FrameError: There are no frames, or one is damaged (unless such are to be skipped).
        StageError: A stage is not there, or not the one that was rendered.
        OutputError: A camera has a rolling shutter, or a file cannot be written.
    """
    chosen = options.batches, options.cameras, options.samples
    source = Source(out, options.backend, batches=chosen[0], cameras=chosen[1], samples=chosen[2])
    units: list[RectifyFrame] = []
    done: set[tuple[int, str]] = set()
    for number in sorted({ref.batch for ref in source.frames}):
        frames = [ref for ref in source.frames if ref.batch == number]
        views = pinholes(frames)
        stage = source.stages[frames[0].batch_name].absolute()
        opening = RectifiedOpening(str(stage), tuple(sorted(views.items())))
        for ref in (ref for ref in frames if ref.camera in views):
            stem = ref.stem.absolute()
            folder = stem.parents[3] / RECTIFIED
            done.add((number, ref.camera))
            units.append(
                RectifyFrame(opening, ref.name, stem, folder / stem.relative_to(stem.parents[2]))
            )
    listener = options.listener
    steps = listener.steps("rectified", unit="frame")
    unseen = 0
    with closing(run_all(executor, units)) as ended:
        for count, (unit, outcome) in enumerate(ended, 1):
            for line in outcome.warnings:
                listener.warn(line)
            try:
                unseen += outcome.result()
            except FrameError:
                # Told, with others like it, where the export meets it.
                if options.faults == "stop":
                    raise
            steps(count, len(units), unit.what)
    cameras = ", ".join(sorted({camera for _, camera in done})) or "no camera: all are pinholes"
    listener.say(f"rectified {cameras}")
    if unseen:
        listener.warn(
            f"{unseen:,} pixels of rectified pictures are black, as the lens's picture does not "
            "reach there; they are annotated all the same"
        )
    return frozenset(done)
