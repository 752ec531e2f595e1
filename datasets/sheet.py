"""The contact sheet of an output folder: which frames it shows, and where they are."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.datasets import pictures
from scenec.datasets.contact_sheet import TERRAIN, SheetFrame, contact_sheet
from scenec.datasets.motion_colors import OCCLUSIONS, UNITS
from scenec.datasets.source import FrameRef, LoadedFrame, Source
from scenec.datasets.tracks import TAPVID
from scenec.datasets.tracks.sheet import draw_tracks
from scenec.schemas.codec import JSON
from scenec.schemas.depth_camera import MEASURED
from scenec.schemas.errors import ForeignFrameError, FrameError
from scenec.schemas.files import NUMPY_FAULTS, atomic, check_output, read_json

#: Where an output's point tracks are, unless they were put elsewhere.
EXPORTED = f"datasets/{TAPVID}"
#: Of a line of a row's title, so that it stays within the first picture.
_TITLE_LETTERS = 44


@dataclass(frozen=True)
class Sheet:
    """A written sheet.

    Attributes:
        path: The PNG.
        folder: Folder of the frames shown.
        left_out: A line each of frames that are none of the output's (strays, foreign ones) and so
            not shown; the sheet's heading counts them.
        frames: Names of the frames shown.
    """

    path: Path
    folder: Path
    left_out: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()


def write_sheet(out: Path, output: Path, *, backend: str | None = None, count: int = 4) -> Sheet:
    """Writes the contact sheet of an output's first frames; of a sweep, of its points' first ones.

    Args:
        out: Output folder of compile and render, a sweep, or a USD file that was rendered.
        output: The PNG to write.
        backend: Whose frames; None takes the first there is.
        count: How many at most.

    Raises:
        FrameError: There are no frames, or one to be shown is damaged.
        OutputError: ``out`` is no output, or ``output`` cannot be written.
    """
    check_output(output)
    source = Source(out, backend)
    left_out = [fault.message for fault in source.strays]
    frames: list[LoadedFrame] = []
    for ref in _across_points(source.frames):
        try:
            if source.is_foreign(ref):
                # Without reading all of them: after a new compile all may be.
                raise ForeignFrameError(
                    f"{ref.stem}.json: foreign: was rendered from another stage; render it again"
                )
            frames.append(source.load(ref))
        except ForeignFrameError as error:
            left_out.append(str(error))
        if len(frames) == max(count, 1):
            break
    if not frames:
        raise FrameError(f"{out}: all frames are of another stage, such as {left_out[-1]}")
    frames.sort(key=lambda frame: frame.ref.index)
    first = frames[0].sidecar
    heading = f"{out.resolve().name}: {first.backend}"
    if first.spp:
        heading += f", {first.spp} samples per pixel"
    if left_out:
        heading += f"; not shown: {len(left_out)} frames of another stage"
    several = len({frame.ref.batch for frame in frames}) > 1
    rows = [_sheet_frame(frame, several) for frame in frames]
    picture = contact_sheet(rows, source.labels(), heading)
    with atomic(output) as temporary:
        picture.save(temporary, format="PNG")
    shown = tuple(frame.ref.name for frame in frames)
    return Sheet(output, frames[0].ref.stem.parent, tuple(left_out), shown)


def _across_points(frames: Sequence[FrameRef]) -> list[FrameRef]:
    """The first frame of each point of a sweep, then the second ones; of others, as they come."""
    seen: Counter[JSON] = Counter()
    rounds: list[tuple[int, FrameRef]] = []
    for ref in frames:
        point = ref.settings.get("point")
        rounds.append((seen[point], ref))
        seen[point] += 1
    return [ref for _, ref in sorted(rounds, key=lambda one: one[0])]


def _title(frame: LoadedFrame, several: bool) -> list[str]:
    """Lines beside a row; the batch where there are several; in a sweep its point's folder."""
    folder = textwrap.wrap(str(frame.ref.settings.get("folder", "")), _TITLE_LETTERS)
    batch = f"batch {frame.ref.batch}, " if several else ""
    return [*folder, f"{batch}{frame.sidecar.camera}, sample {frame.sidecar.sample}"]


def _sheet_frame(frame: LoadedFrame, several: bool) -> SheetFrame:
    passes = frame.passes
    clean = "clean" in pictures.kinds(frame.sidecar)
    picture = pictures.picture(frame) if pictures.has_picture(frame) else None
    return SheetFrame(
        title="\n".join(_title(frame, several)),
        picture=picture,
        labels={
            name.removeprefix("label."): array
            for name, array in passes.items()
            if name.startswith("label.")
        },
        instance=passes.get("instance"),
        depth=passes.get("depth"),
        clean=pictures.beside(frame, "clean") if clean else None,
        tracks=None if picture is None else _tracks(frame, picture),
        measured=passes.get(MEASURED),
        motion={name: passes[name] for name in (*UNITS, *OCCLUSIONS) if name in passes},
        terrain={name: passes[name] for name in TERRAIN if name in passes},
    )


def _tracks(frame: LoadedFrame, picture: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """The picture with points on it, where tapvid was exported of its stage; else None.

    Raises:
        FrameError: Their file is damaged.
    """
    stem = frame.ref.stem
    batch, camera, folder = stem.parents[3].name, stem.parent.name, stem.parents[4] / EXPORTED
    path = folder / batch / f"{camera}.npz"
    if not path.is_file():
        return None
    told = read_json(folder / "export.json", FrameError, "export").get("batches", {})
    if told.get(batch, {}).get("stage_digest") != frame.sidecar.stage_digest:
        return None
    try:
        with np.load(path) as arrays:
            found = np.flatnonzero(arrays["sample"] == frame.ref.sample).tolist()
            points, code = arrays["points"], arrays["code"]
            return draw_tracks(picture, points, code, found[0]) if found else None
    except NUMPY_FAULTS as error:
        raise FrameError(f"{path}: damaged: {error}") from None
