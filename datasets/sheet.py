"""The contact sheet of an output folder: which frames it shows, and where they are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scenec.datasets import pictures
from scenec.datasets.contact_sheet import TERRAIN, SheetFrame, contact_sheet
from scenec.datasets.motion_colors import OCCLUSIONS, UNITS
from scenec.datasets.source import FrameRef, LoadedFrame, Source, record_of
from scenec.schemas.depth_camera import MEASURED
from scenec.schemas.errors import ForeignFrameError, FrameError
from scenec.schemas.files import atomic, check_output
from scenec.schemas.manifest import stage_digest


@dataclass(frozen=True)
class Sheet:
    """A written sheet.

    Attributes:
        path: The PNG.
        folder: Folder of the frames shown.
        left_out: A line each of frames that are none of the output's (strays, foreign ones) and so
            not shown; the sheet's heading counts them.
    """

    path: Path
    folder: Path
    left_out: tuple[str, ...] = ()


def write_sheet(out: Path, output: Path, *, backend: str | None = None, count: int = 4) -> Sheet:
    """Writes the contact sheet of an output's first frames.

    Args:
        out: Output folder of compile and render, or a USD file that was rendered.
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
    for ref in source.frames:
        try:
            if _is_foreign(source, ref):
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
    first = frames[0].sidecar
    heading = f"{out.resolve().name}: {first.backend}"
    if first.spp:
        heading += f", {first.spp} samples per pixel"
    if left_out:
        heading += f"; not shown: {len(left_out)} frames of another stage"
    picture = contact_sheet([_sheet_frame(frame) for frame in frames], source.labels(), heading)
    with atomic(output) as temporary:
        picture.save(temporary, format="PNG")
    return Sheet(output, frames[0].ref.stem.parent, tuple(left_out))


def _is_foreign(source: Source, ref: FrameRef) -> bool:
    """Whether a sidecar names another stage than the manifest has."""
    if source.manifest is None:
        return False
    digest = stage_digest(source.manifest, ref.batch_name)
    record = record_of(ref)
    return record is not None and record.stage_digest != digest


def _sheet_frame(frame: LoadedFrame) -> SheetFrame:
    passes = frame.passes
    clean = "clean" in pictures.kinds(frame.sidecar)
    return SheetFrame(
        title=f"{frame.sidecar.camera}, sample {frame.sidecar.sample}",
        picture=pictures.picture(frame) if pictures.has_picture(frame) else None,
        labels={
            name.removeprefix("label."): array
            for name, array in passes.items()
            if name.startswith("label.")
        },
        instance=passes.get("instance"),
        depth=passes.get("depth"),
        clean=pictures.beside(frame, "clean") if clean else None,
        measured=passes.get(MEASURED),
        motion={name: passes[name] for name in (*UNITS, *OCCLUSIONS) if name in passes},
        terrain={name: passes[name] for name in TERRAIN if name in passes},
    )
