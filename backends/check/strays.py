"""Frames that the stage beside them has no place for: left by one compiled before it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from pathlib import Path

from scenec.schemas.manifest import FRAMES

#: Of each sample: a camera's name, and whether it is triggered then.
Firing = Sequence[Sequence[tuple[str, bool]]]


def strays(folder: Path, firing: Firing, backend: str | None = None) -> Iterator[tuple[Path, str]]:
    """Frames of cameras that the stage has not, or at samples that they are not triggered at.

    Args:
        folder: The batch's folder.
        firing: What the stage says of each sample's cameras.
        backend: Whose frames; None: all.

    Yields:
        The sidecar, and why it is none of this stage's.
    """
    # Ascending; looked up by position, since there may be as many strays as samples.
    fires: dict[str, list[int]] = {}
    for i, cameras in enumerate(firing):
        for name, on in cameras:
            at = fires.setdefault(name, [])
            if on:
                at.append(i)
    for path in sorted((folder / FRAMES).glob(f"{backend or '*'}/*/*.json")):
        if not (path.stem.isascii() and path.stem.isdigit()):
            continue
        camera, sample = path.parent.name, int(path.stem)
        if camera not in fires:
            yield path, f"the stage has no camera {camera!r}"
        elif sample >= len(firing):
            yield path, f"the stage has samples 0 to {len(firing) - 1}"
        elif not _holds(at := fires[camera], sample):
            said = ", ".join(map(str, at[:3])) + (", …" if len(at) > 3 else "")
            yield path, f"camera {camera} is triggered at samples {said or 'beyond the last'}"


def _holds(ascending: Sequence[int], value: int) -> bool:
    place = bisect_left(ascending, value)
    return place < len(ascending) and ascending[place] == value
