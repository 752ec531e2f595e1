"""Checks of lidar scans: whole, and of this stage."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from scenec.backends.check.finding import Finding
from scenec.schemas.errors import FrameError
from scenec.schemas.scans import SCANS, read_scan
from scenec.schemas.strays import Firing, stray_scans


def check_scans(
    folder: Path, digest: str | None, firing: Firing | None = None
) -> Iterator[Finding]:
    """Findings on all scans of a batch.

    Args:
        folder: The batch's folder.
        digest: Digest of its stage; None where that cannot be read.
        firing: When its lidars are triggered; None: which scans are none of the stage's is not
            asked.
    """
    scans = folder / SCANS
    astray = {} if firing is None else dict(stray_scans(folder, firing))
    for npz in _numbered(scans, "npz"):
        if not npz.with_suffix(".json").is_file():
            yield Finding("scans", "error", _name(npz, folder), "has no sidecar: cut short?")
    for path in _numbered(scans, "json"):
        where = _name(path, folder)
        if path in astray:
            message = (
                f"not of this stage: {astray[path]}; no scan replaces it: delete {path.stem}.*"
            )
            yield Finding("scans", "warning", where, message)
            continue
        try:
            scan = read_scan(path)
        except FrameError as error:
            yield Finding("scans", "error", where, str(error))
            continue
        if digest is not None and scan.sidecar.get("stage_digest") != digest:
            yield Finding("scans", "warning", where, "was made of another stage; scan again")


def _numbered(scans: Path, suffix: str) -> list[Path]:
    """Files of scans; others are a user's."""
    found = sorted(scans.glob(f"*/*.{suffix}"))
    return [path for path in found if path.stem.isascii() and path.stem.isdigit()]


def _name(path: Path, folder: Path) -> str:
    return path.relative_to(folder.parent).as_posix()
