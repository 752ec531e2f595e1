"""The contact sheet of an output folder: which frames it shows, and where they are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scenec.datasets import pictures
from scenec.datasets.contact_sheet import SheetFrame, contact_sheet
from scenec.datasets.motion_colors import OCCLUSIONS, UNITS
from scenec.schemas.depth_camera import MEASURED
from scenec.schemas.errors import FrameError
from scenec.schemas.files import atomic
from scenec.schemas.frames import Frame, read_frame
from scenec.schemas.manifest import FRAMES, find_batches


@dataclass(frozen=True)
class Sheet:
    """A written sheet.

    Attributes:
        path: The PNG.
        folder: Folder of the frames shown.
    """

    path: Path
    folder: Path


def write_sheet(out: Path, output: Path, *, backend: str | None = None, count: int = 4) -> Sheet:
    """Writes the contact sheet of an output's first frames.

    Args:
        out: Output folder of compile and render, or a USD file that was rendered.
        output: The PNG to write.
        backend: Whose frames; None takes the first there is.
        count: How many at most.

    Raises:
        FrameError: There are no frames.
        OutputError: ``out`` is no output, or ``output`` cannot be written.
    """
    sidecars = find_frames(out, backend)[: max(count, 1)]
    frames = [read_frame(path) for path in sidecars]
    first = frames[0].sidecar
    names = {
        level: {int(number): name for number, name in table.items()}
        for level, table in first.get("labels", {}).items()
    }
    heading = f"{out.resolve().name}: {first['backend']}"
    if first.get("spp"):
        heading += f", {first['spp']} samples per pixel"
    picture = contact_sheet([_shown(frame) for frame in frames], names, heading)
    with atomic(output) as temporary:
        picture.save(temporary, format="PNG")
    return Sheet(output, sidecars[0].parent)


def find_frames(out: Path, backend: str | None = None) -> list[Path]:
    """Sidecars of all frames of one backend, over batches, cameras and samples in order.

    Raises:
        FrameError: There are none.
    """
    folders = [batch.folder / FRAMES for batch in find_batches(out)]
    backends = sorted(
        {b.name for folder in folders if folder.is_dir() for b in folder.iterdir() if b.is_dir()}
    )
    if backend is None and backends:
        backend = backends[0]
    found = [p for f in folders for p in sorted((f / str(backend)).glob("*/*.json"))]
    if not found:
        known = f"; there are frames of {', '.join(backends)}" if backends else ""
        whose = f" of {backend}" if backend else ""
        raise FrameError(f"{out}: no frames{whose}{known}; render first: scenec render {out}")
    return found


def _shown(frame: Frame) -> SheetFrame:
    passes = frame.passes
    clean = "clean" in pictures.kinds(frame.sidecar)
    return SheetFrame(
        title=f"{frame.sidecar['camera']}, sample {frame.sidecar['sample']}",
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
    )
