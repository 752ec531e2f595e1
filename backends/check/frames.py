"""Checks of frames and lidar scans: whole, of this stage, and consistent in themselves."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from scenec.backends.check.finding import Finding
from scenec.backends.check.instances import check_batch_table, table_faults
from scenec.backends.picture.brightness import FrameBrightness, brief, picture_warning, sky_warning
from scenec.schemas.codec import Unset
from scenec.schemas.consistency import frame_faults
from scenec.schemas.errors import FrameError
from scenec.schemas.exposures import EXPOSURES, read_exposures
from scenec.schemas.frames import read_frame
from scenec.schemas.manifest import FRAMES, Batch
from scenec.schemas.scans import SCANS, read_scan
from scenec.schemas.strays import Firing, stray_scans, strays

#: Missing frames of a sensor that are named.
_LISTED = 5


#: Sensors that have something, by the folder that it is in beside a stage: "frames/mitsuba".
type Found = Mapping[str, Collection[str]]


def sensors_with_frames(batches: Iterable[Batch]) -> dict[str, set[str]]:
    """Lists sensors that have frames or scans in any of some batches; see ``Found``."""
    sensors: dict[str, set[str]] = {}
    for batch in batches:
        for pattern in (f"{FRAMES}/*/*/*.json", f"{SCANS}/*/*.json"):
            for path in batch.folder.glob(pattern):
                kind = path.parents[1].relative_to(batch.folder).as_posix()
                sensors.setdefault(kind, set()).add(path.parent.name)
    return sensors


def check_frames(
    folder: Path, digest: str | None, firing: Firing | None = None, sensors: Found | None = None
) -> Iterator[Finding]:
    """Findings on all frames of a batch.

    Args:
        folder: The batch's folder.
        digest: Digest of its stage; None where that cannot be read.
        firing: When its cameras are triggered; None likewise.
        sensors: What any batch of the output has; None: this one alone counts.
    """
    frames = folder / FRAMES
    check = _Check("frames", folder, digest, sensors or {})
    astray = {} if firing is None else dict(strays(folder, firing))
    yield from check_batch_table(frames, digest, check.name(frames))
    yield from check.exposures(frames / EXPOSURES)
    yield from check.cut_short(frames.glob("*/*/*.exr"))
    backends = {path.name for path in frames.glob("*") if path.is_dir()}
    backends |= {name.removeprefix(f"{FRAMES}/") for name in check.found if name != SCANS}
    for backend in sorted(backends):
        yield from check.missing(frames / backend, firing or ())
    pictures: dict[Path, list[FrameBrightness]] = {}
    for path in sorted(frames.glob("*/*/*.json")):
        if path in astray:
            why = f"{astray[path]}; no render replaces it and exports pass it over"
            yield check.astray(path, why)
            continue
        try:
            frame = read_frame(path)
        except FrameError as error:
            yield check.finding(path, str(error))
            continue
        pictures.setdefault(path.parent, []).append(brief(frame.sidecar))
        yield from check.stale(
            path, frame.sidecar.stage_digest, "was rendered from another stage; render again"
        )
        for message in (*frame_faults(frame.passes, frame.sidecar), *table_faults(frame)):
            yield check.finding(path, message)
    for camera, briefs in pictures.items():
        for name, line in (("brightness", picture_warning(briefs)), ("sky", sky_warning(briefs))):
            if line is not None:
                yield Finding(name, "warning", check.name(camera), line)


def check_scans(
    folder: Path, digest: str | None, firing: Firing | None = None, sensors: Found | None = None
) -> Iterator[Finding]:
    """Findings on all lidar scans of a batch; arguments as of ``check_frames``."""
    scans = folder / SCANS
    check = _Check("scans", folder, digest, sensors or {})
    astray = {} if firing is None else dict(stray_scans(folder, firing))
    yield from check.cut_short(_numbered(scans, "npz"))
    if scans.is_dir() or SCANS in check.found:
        yield from check.missing(scans, firing or ())
    for path in _numbered(scans, "json"):
        if path in astray:
            yield check.astray(path, f"{astray[path]}; no scan replaces it")
            continue
        try:
            scan = read_scan(path)
        except FrameError as error:
            yield check.finding(path, str(error))
            continue
        yield from check.stale(
            path, scan.sidecar.stage_digest, "was made of another stage; scan again"
        )


def _numbered(scans: Path, suffix: str) -> list[Path]:
    """Files of scans; others are a user's."""
    found = sorted(scans.glob(f"*/*.{suffix}"))
    return [path for path in found if path.stem.isascii() and path.stem.isdigit()]


@dataclass(frozen=True)
class _Check:
    """Holds what checks of frames and of scans share."""

    kind: str
    folder: Path
    digest: str | None
    found: Found

    def name(self, path: Path) -> str:
        return path.relative_to(self.folder.parent).as_posix()

    def finding(
        self, path: Path, message: str, severity: Literal["error", "warning"] = "error"
    ) -> Finding:
        return Finding(self.kind, severity, self.name(path), message)

    def cut_short(self, paths: Iterable[Path]) -> Iterator[Finding]:
        for path in sorted(paths):
            if not path.with_suffix(".json").is_file():
                yield self.finding(path, "has no sidecar: cut short?")

    def missing(self, folder: Path, firing: Firing) -> Iterator[Finding]:
        """Finds what the stage has a place for and sensors' folders lack."""
        expected: dict[str, list[int]] = {}
        for sample, sensors in enumerate(firing):
            for name, fires in sensors:
                expected.setdefault(name, []).extend([sample] if fires else [])
        elsewhere = self.found.get(folder.relative_to(self.folder).as_posix(), ())
        for name, samples in expected.items():
            gone = [i for i in samples if not (folder / name / f"{i:06d}.json").is_file()]
            # A camera may be left out on purpose, of all batches.
            if gone and name not in elsewhere and not any((folder / name).glob("*.json")):
                message = f"none of its {len(samples)} {self.kind}"
                yield Finding("missing", "warning", self.name(folder / name), message)
            elif gone:
                listed = ", ".join(f"{i:06d}" for i in gone[:_LISTED])
                more = f" and {len(gone) - _LISTED} more" if gone[_LISTED:] else ""
                again = "render" if self.kind == "frames" else "scan"
                message = (
                    f"{len(gone)} of {len(samples)} {self.kind} are missing: {listed}{more}; "
                    f"{again} again"
                )
                yield Finding("missing", "error", self.name(folder / name), message)

    def exposures(self, path: Path) -> Iterator[Finding]:
        """Finds out whether a table is damaged: whoever renders makes up for that."""
        with suppress(FileNotFoundError):
            try:
                read_exposures(path)
            except FrameError as error:
                yield self.finding(path, f"{error}; rendering meters again", "warning")

    def astray(self, path: Path, why: str) -> Finding:
        return self.finding(path, f"not of this stage: {why}: delete {path.stem}.*", "warning")

    def stale(self, path: Path, digest: str | Unset, message: str) -> Iterator[Finding]:
        if self.digest is not None and digest != self.digest:
            yield self.finding(path, message, "warning")
