"""Checks of frames and lidar scans: whole, of this stage, and consistent in themselves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from scenec.backends.check.finding import Finding
from scenec.backends.check.instances import check_batch_table, table_faults
from scenec.backends.picture.brightness import brief, told, told_of_sky
from scenec.schemas.errors import FrameError
from scenec.schemas.frames import Frame, read_frame
from scenec.schemas.manifest import FRAMES
from scenec.schemas.scans import SCANS, read_scan
from scenec.schemas.strays import Firing, stray_scans, strays

_NO_FACE = 0xFFFFFFFF


def check_frames(
    folder: Path, digest: str | None, firing: Firing | None = None
) -> Iterator[Finding]:
    """Findings on all frames of a batch.

    Args:
        folder: The batch's folder.
        digest: Digest of its stage; None where that cannot be read.
        firing: When its cameras are triggered; None likewise.
    """
    frames = folder / FRAMES
    check = _Check("frames", folder, digest)
    astray = {} if firing is None else dict(strays(folder, firing))
    yield from check_batch_table(frames, digest, check.name(frames))
    yield from check.cut_short(frames.glob("*/*/*.exr"))
    pictures: dict[Path, list[dict[str, Any]]] = {}
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
        yield from check.stale(path, frame.sidecar, "was rendered from another stage; render again")
        for message in (*inconsistencies(frame), *table_faults(frame)):
            yield check.finding(path, message)
    for camera, sidecars in pictures.items():
        for name, line in (("brightness", told(sidecars)), ("sky", told_of_sky(sidecars))):
            if line is not None:
                yield Finding(name, "warning", check.name(camera), line)


def check_scans(
    folder: Path, digest: str | None, firing: Firing | None = None
) -> Iterator[Finding]:
    """Findings on all lidar scans of a batch; arguments as of ``check_frames``."""
    scans = folder / SCANS
    check = _Check("scans", folder, digest)
    astray = {} if firing is None else dict(stray_scans(folder, firing))
    yield from check.cut_short(_numbered(scans, "npz"))
    for path in _numbered(scans, "json"):
        if path in astray:
            yield check.astray(path, f"{astray[path]}; no scan replaces it")
            continue
        try:
            scan = read_scan(path)
        except FrameError as error:
            yield check.finding(path, str(error))
            continue
        yield from check.stale(path, scan.sidecar, "was made of another stage; scan again")


def _numbered(scans: Path, suffix: str) -> list[Path]:
    """Files of scans; others are a user's."""
    found = sorted(scans.glob(f"*/*.{suffix}"))
    return [path for path in found if path.stem.isascii() and path.stem.isdigit()]


@dataclass(frozen=True)
class _Check:
    """What checks of frames and of scans say alike."""

    kind: str
    folder: Path
    digest: str | None

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

    def astray(self, path: Path, why: str) -> Finding:
        return self.finding(path, f"not of this stage: {why}: delete {path.stem}.*", "warning")

    def stale(self, path: Path, sidecar: Mapping[str, Any], message: str) -> Iterator[Finding]:
        if self.digest is not None and sidecar.get("stage_digest") != self.digest:
            yield self.finding(path, message, "warning")


def inconsistencies(frame: Frame) -> Iterator[str]:
    """What a frame's passes say against its sidecar and each other."""
    width, height = frame.sidecar["resolution"]
    passes = frame.passes
    for name, array in passes.items():
        if array.shape[:2] != (height, width):
            yield f"{name} is {array.shape[1]} x {array.shape[0]}, expected {width} x {height}"
            return
    missing = [name for name in frame.sidecar["passes"] if name not in passes]
    if missing:
        yield f"lacks {', '.join(missing)}"
    if "rgb" in passes and not (np.isfinite(passes["rgb"]).all() and passes["rgb"].min() >= 0.0):
        yield "rgb holds values that are negative or not finite"
    if "depth" in passes:
        depth = passes["depth"]
        if np.isnan(depth).any() or depth.min(initial=1.0) <= 0.0:
            yield "depth holds NaN, or values that are not above 0"
        for name in ("instance", "face"):
            if name in passes:
                nothing = 0 if name == "instance" else _NO_FACE
                count = int((np.isinf(depth) & (passes[name] != nothing)).sum())
                if count:
                    yield f"{count} pixels have a {name} but no depth"
    yield from _unknown_labels(passes, frame.sidecar)


def _unknown_labels(passes: dict[str, Any], sidecar: dict[str, Any]) -> Iterator[str]:
    for name, array in passes.items():
        if not name.startswith("label."):
            continue
        known = {0, *map(int, sidecar["labels"].get(name.removeprefix("label."), {}))}
        unknown = sorted(set(np.unique(array).tolist()) - known)
        if unknown:
            yield f"{name} holds ids {unknown[:5]} that the table lacks"
