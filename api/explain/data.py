"""Reads the inputs of ``scenec explain``: reports, timings, sidecars of frames."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from scenec.schemas.manifest import FRAMES, REPORT, TIMINGS, find_batches, read_manifest
from scenec.schemas.report import BatchReport, Timings, read_output_record
from scenec.schemas.sidecars import read_sidecar


@dataclass(frozen=True)
class FrameTimes:
    """Holds the times of one backend's frames.

    Attributes:
        backend: Its name.
        frames: How many there are.
        seconds: Per step, of all frames together.
        error: Mean of their estimated errors of ``rgb``, relative; None where it is not known.
    """

    backend: str
    frames: int
    seconds: dict[str, float]
    error: float | None


@dataclass(frozen=True)
class BatchData:
    """One batch, as it was compiled and rendered.

    Attributes:
        name: Of its folder.
        folder: Its folder.
        stage: Its root layer.
        report: report.json.
        seconds: Of each pass of the compilation; empty where they are not known.
        frames: By backend, in alphabetical order.
    """

    name: str
    folder: Path
    stage: Path
    report: BatchReport
    seconds: Mapping[str, float]
    frames: tuple[FrameTimes, ...] = field(default=())


def read_batches(out: Path, batches: Collection[int] | None = None) -> list[BatchData]:
    """The batches of an output folder.

    Args:
        out: Output folder of a compile.
        batches: Only these; None takes all.

    Raises:
        OutputError: No manifest, or a file that is damaged.
        StageError: A batch that is not there.
    """
    read_manifest(out)
    path = out / TIMINGS
    timings = read_output_record(path, Timings) if path.is_file() else Timings()
    return [
        BatchData(
            batch.name,
            batch.folder,
            batch.stage,
            read_output_record(batch.folder / REPORT, BatchReport),
            timings.compile.get(batch.name, {}),
            tuple(_frames(batch.folder)),
        )
        for batch in find_batches(out, batches)
    ]


def _frames(folder: Path) -> list[FrameTimes]:
    found = []
    for backend in sorted(path for path in (folder / FRAMES).glob("*") if path.is_dir()):
        records = [read_sidecar(path) for path in sorted(backend.glob("*/*.json"))]
        if not records:
            continue
        seconds: dict[str, float] = {}
        errors = []
        for record in records:
            for step, value in (record.seconds or {}).items():
                seconds[step] = seconds.get(step, 0.0) + value
            if record.error.relative_rms is not None:
                errors.append(record.error.relative_rms)
        mean = sum(errors) / len(errors) if errors else None
        found.append(FrameTimes(backend.name, len(records), seconds, mean))
    return found
