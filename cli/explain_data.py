"""What ``scenec explain`` reads: reports, timings, sidecars of frames."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenec.schemas.errors import OutputError
from scenec.schemas.manifest import FRAMES, REPORT, TIMINGS, find_batches, read_manifest
from scenec.schemas.shape import read_shaped
from scenec.schemas.sidecars import read_sidecar


@dataclass(frozen=True)
class FrameTimes:
    """What the frames of one backend took.

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
    report: dict[str, Any]
    seconds: dict[str, float]
    frames: tuple[FrameTimes, ...] = field(default=())

    @property
    def report_path(self) -> Path:
        """Where the report lies."""
        return self.folder / REPORT


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
    timings = _read(out / TIMINGS).get("compile", {}) if (out / TIMINGS).is_file() else {}
    found = []
    for batch in find_batches(out, batches):
        seconds = timings.get(batch.name, {}) if isinstance(timings, dict) else {}
        found.append(
            BatchData(
                batch.name,
                batch.folder,
                batch.stage,
                _read(batch.folder / REPORT),
                seconds if isinstance(seconds, dict) else {},
                tuple(_frames(batch.folder)),
            )
        )
    return found


def _frames(folder: Path) -> list[FrameTimes]:
    found = []
    for backend in sorted(path for path in (folder / FRAMES).glob("*") if path.is_dir()):
        sidecars = [read_sidecar(path) for path in sorted(backend.glob("*/*.json"))]
        if not sidecars:
            continue
        seconds: dict[str, float] = {}
        errors = []
        for sidecar in sidecars:
            for step, value in (sidecar.get("seconds") or {}).items():
                seconds[step] = seconds.get(step, 0.0) + value
            error = (sidecar.get("estimated_error") or {}).get("relative_rms")
            errors += [] if error is None else [error]
        mean = sum(errors) / len(errors) if errors else None
        found.append(FrameTimes(backend.name, len(sidecars), seconds, mean))
    return found


def _read(path: Path) -> dict[str, Any]:
    try:
        value: dict[str, Any] = read_shaped(path, dict, OutputError, "report of scenec")
    except FileNotFoundError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror}") from error
    return value
