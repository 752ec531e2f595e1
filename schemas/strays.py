"""Frames and scans that the stage beside them has no place for: left by one compiled before it.

Nothing makes them again, and nothing removes them: what they cost may be more than what they are in
the way of. Who meets them says so: compiling, rendering, scanning, checks, exports.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby, islice
from pathlib import Path

from scenec.schemas.exposures import EXPOSURES, exposures_digest
from scenec.schemas.instances import BATCH_TABLE, table_digest
from scenec.schemas.manifest import FRAMES
from scenec.schemas.scans import SCANS

#: Of each sample: the name of a camera (or lidar), and whether it is triggered then.
Firing = Sequence[Sequence[tuple[str, bool]]]
#: A sidecar, and why it is none of the stage's.
Stray = tuple[Path, str]
#: Names of a frame's or a scan's files.
_FILE = re.compile(
    r"([0-9]{6,})\.(?:json|exr|(?:clean\.|raw\.)?png|instances\.csv|(?:amodal\.)?npz|ply)"
)


def strays(folder: Path, firing: Firing, backend: str | None = None) -> Iterator[Stray]:
    """Frames of cameras that the stage has not, or at samples that they are not triggered at.

    Args:
        folder: The batch's folder.
        firing: What the stage says of each sample's cameras.
        backend: Whose frames; None: all.

    Yields:
        The sidecar, and why it is none of this stage's.
    """
    found = (folder / FRAMES).glob(f"{backend or '*'}/*/*.json")
    yield from _astray(found, firing, "camera")


def stray_scans(folder: Path, firing: Firing) -> Iterator[Stray]:
    """The same of scans.

    Args:
        folder: The batch's folder.
        firing: What the stage says of each sample's lidars; those that do not scan may be missing.

    Yields:
        The sidecar, and why it is none of this stage's.
    """
    yield from _astray((folder / SCANS).glob("*/*.json"), firing, "lidar")


def stray_line(strays: Sequence[Stray]) -> str:
    """A line about some, at least one.

    Args:
        strays: As above, of one folder or several.
    """
    path, why = strays[0]
    more = f" (and {len(strays) - 1} more in {_batch(path)})" if len(strays) > 1 else ""
    return (
        f"{path}: not of this stage: {why}{more}; nothing replaces it: delete it (scenec check "
        "names all)"
    )


def rendered_files(folder: Path, digest: str | None = None) -> Iterator[Path]:
    """Files of frames and scans that are not of a stage.

    Args:
        folder: The batch's folder.
        digest: Of the stage, as sidecars have it; None: of no stage, so that all files count.

    Yields:
        What scenec wrote there, by its name; nothing else.
    """
    files = [path for path in _rendered(folder, "*") if _FILE.fullmatch(path.name)]
    for stem, parts in groupby(files, lambda path: path.with_name(path.name.partition(".")[0])):
        if digest is None or _digest(stem.with_suffix(".json")) != digest:
            yield from parts
    for name, digest_of in ((BATCH_TABLE, table_digest), (EXPOSURES, exposures_digest)):
        path = folder / FRAMES / name
        if path.is_file() and (digest is None or digest_of(path) != digest):
            yield path


def count_rendered(folders: Iterable[Path]) -> tuple[int, int]:
    """Counts the frames and scans in some batches' folders."""
    found = [path for folder in folders for path in _rendered(folder, "*.json")]
    scans = sum(path.parents[1].name == SCANS for path in found)
    return len(found) - scans, scans


def _rendered(folder: Path, name: str) -> list[Path]:
    return [
        *sorted((folder / FRAMES).glob(f"*/*/{name}")),
        *sorted((folder / SCANS).glob(f"*/{name}")),
    ]


def _digest(sidecar: Path) -> str | None:
    try:
        return str(json.loads(sidecar.read_bytes())["stage_digest"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _batch(sidecar: Path) -> str:
    """The name of the batch that a frame or a scan lies in."""
    inside = {FRAMES, SCANS}
    return next((p.parent.name for p in sidecar.parents if p.name in inside), "")


def _astray(paths: Iterable[Path], firing: Firing, what: str) -> Iterator[Stray]:
    # Ascending keys: there may be as many strays as samples.
    fires: dict[str, dict[int, None]] = {}
    for i, sensors in enumerate(firing):
        for name, on in sensors:
            at = fires.setdefault(name, {})
            if on:
                at[i] = None
    for path in sorted(paths):
        if not (path.stem.isascii() and path.stem.isdigit()):
            continue
        sensor, sample = path.parent.name, int(path.stem)
        if sensor not in fires:
            yield path, f"the stage has no {what} {sensor!r}"
        elif sample >= len(firing):
            yield path, f"the stage has samples 0 to {len(firing) - 1}"
        elif sample not in (at := fires[sensor]):
            said = ", ".join(map(str, islice(at, 3))) + (", …" if len(at) > 3 else "")
            yield path, f"{what} {sensor} is triggered at samples {said or 'beyond the last'}"
