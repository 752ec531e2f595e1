"""Frames for the Rerun viewer: pictures, depth, labels and boxes before moving pinhole cameras.

Entities, on the timelines ``sample`` and ``time`` (seconds)::

    /                             right-handed, Z up (the stage's world frame, meters)
    /<batch>/<camera>             Transform3D of the camera, Pinhole (axes right, down, forward)
    /<batch>/<camera>/rgb         the picture: of a sensor what it took, else radiance developed
    /<batch>/<camera>/clean       a sensor's picture without noise, where it was asked for
    /<batch>/<camera>/raw         its numbers behind the mosaic, uint16, where they were asked for
    /<batch>/<camera>/depth       DepthImage, float32 meters; 0 where nothing is hit
    /<batch>/<camera>/label/<level>  SegmentationImage, and its AnnotationContext: names, colors
    /<batch>/<camera>/slope       its colors, 0 to 45 degrees
    /<batch>/<camera>/traversable  SegmentationImage of what places are to the sensor's vehicle
    /<batch>/<camera>/instance    the colors of instances, and their boxes with class and id

Rerun's class ids have 16 bits: labels beyond are an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenec.datasets import pictures
from scenec.datasets.colors import (
    NO_LABEL,
    TRAVERSABILITY_COLORS,
    label_colors,
    paint_instances,
    paint_slope,
)
from scenec.datasets.formats.encode import file_bytes, picture_png
from scenec.datasets.source import LoadedFrame, Source
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import atomic, check_output
from scenec.schemas.units import Progress, Say
from scenec.schemas.vehicle import TRAVERSABILITY
from scenec.schemas.versions import optional

if TYPE_CHECKING:
    from types import ModuleType

_MOST_LABEL = 2**16 - 1


@dataclass
class Recording:
    """Reports what was logged.

    Attributes:
        frames: How many.
        faults: How many could not be read.
        first_fault: What was wrong with the first of them.
    """

    frames: int = 0
    faults: int = 0
    first_fault: str = ""


def log_frames(
    out: Path,
    *,
    backend: str | None = None,
    save: Path | None = None,
    faults: str = "skip",
    progress: Progress = lambda done, total, text: None,
    warn: Say = lambda line: None,
) -> Recording:
    """Logs all frames of one backend.

    Args:
        out: Output folder of compile and render, or a USD file that was rendered.
        backend: Whose frames; None takes the first there is.
        save: Recording (``.rrd``) to write; None starts the viewer and logs into it.
        faults: ``skip`` warns of frames that cannot be read and goes on, ``stop`` stops.
        progress: Called with done, total, and a name.
        warn: Called with a line a fault.

    Raises:
        FrameError: There are no frames, none can be read, or one is faulty and ``faults`` is
            ``stop``.
        OutputError: Rerun is not installed, its viewer does not start, a label id has more than 16
            bits, or the recording cannot be written.
    """
    rerun = optional("rerun", "Rerun is not installed; get it with: pip install 'scenec[rerun]'")
    source = Source(out, backend)
    names = source.labels()
    large = [i for table in names.values() for i in table if i > _MOST_LABEL]
    if large:
        raise OutputError(
            f"{out}: label id {large[0]}: Rerun's class ids have 16 bits, at most {_MOST_LABEL}"
        )
    stream = rerun.RecordingStream("scenec", recording_id=source.out.resolve().name)
    report = Recording()
    if save is None:
        try:
            stream.spawn()
        except (RuntimeError, OSError) as error:
            raise OutputError(f"the Rerun viewer does not start: {error}") from error
        _log_all(rerun, stream, source, names, faults, progress, warn, report)
        return report
    check_output(save)
    with atomic(save) as temporary:
        stream.save(temporary)
        _log_all(rerun, stream, source, names, faults, progress, warn, report)
        # Closes the file.
        stream.disconnect()
    return report


def _log_all(
    rerun: ModuleType,
    stream: Any,
    source: Source,
    names: dict[str, dict[int, str]],
    faults: str,
    progress: Progress,
    warn: Say,
    report: Recording,
) -> None:
    stream.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    logged: set[tuple[str, str]] = set()
    for number, ref in enumerate(source.frames, start=1):
        try:
            frame = source.load(ref)
        except FrameError as error:
            if faults == "stop":
                raise
            warn(str(error))
            report.faults += 1
            report.first_fault = report.first_fault or str(error)
            continue
        entity = f"/{ref.batch_name}/{ref.camera}"
        if (ref.batch_name, ref.camera) not in logged:
            logged.add((ref.batch_name, ref.camera))
            for level, table in names.items():
                context = _context(table)
                stream.log(f"{entity}/label/{level}", rerun.AnnotationContext(context), static=True)
        stream.set_time("sample", sequence=ref.sample)
        stream.set_time("time", duration=frame.time_s)
        _log(rerun, stream, entity, frame)
        report.frames += 1
        progress(number, len(source.frames), ref.name)
    if not report.frames:
        raise FrameError.none_readable(source.out, len(source.frames), report.first_fault)


def _context(table: dict[int, str]) -> list[tuple[int, str, tuple[int, int, int]]]:
    colors = label_colors(list(table))
    known = [(number, table[number], colors[number]) for number in sorted(table) if number]
    return [(0, "no label", NO_LABEL), *known]


def _log(rerun: ModuleType, stream: Any, entity: str, frame: LoadedFrame) -> None:
    pose, passes = frame.camera_to_world, frame.passes
    stream.log(entity, rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    # Rerun knows pinholes alone: pictures through a lens are shown, but not in space.
    if frame.lens is None:
        stream.log(
            entity,
            rerun.Pinhole(
                image_from_camera=frame.intrinsics,
                resolution=[frame.width, frame.height],
                camera_xyz=rerun.ViewCoordinates.RDF,
            ),
        )
    if pictures.has_picture(frame):
        # The PNG as it is: what a sensor's noise looks like would not survive another JPEG.
        stream.log(f"{entity}/rgb", _png(rerun, picture_png(frame)))
    for kind in pictures.kinds(frame.sidecar):
        if kind == "raw":
            stream.log(f"{entity}/{kind}", rerun.Image(pictures.beside(frame, kind), "L"))
        else:
            content = file_bytes(pictures.extra_picture_file(frame, kind))
            stream.log(f"{entity}/{kind}", _png(rerun, content))
    if "depth" in passes:
        depth = np.where(np.isfinite(passes["depth"]), passes["depth"], 0.0).astype(np.float32)
        stream.log(f"{entity}/depth", rerun.DepthImage(depth, meter=1.0))
    if "slope" in passes:
        stream.log(f"{entity}/slope", rerun.Image(paint_slope(passes["slope"])))
    if "traversable" in passes:
        known = [(k, name, TRAVERSABILITY_COLORS[k]) for k, name in enumerate(TRAVERSABILITY)]
        stream.log(f"{entity}/traversable", rerun.AnnotationContext(known), static=True)
        ids = passes["traversable"].astype(np.uint8)
        stream.log(f"{entity}/traversable", rerun.SegmentationImage(ids))
    for name, ids in passes.items():
        if name.startswith("label."):
            path = f"{entity}/label/{name.removeprefix('label.')}"
            stream.log(path, rerun.SegmentationImage(ids.astype(np.uint16)))
    if "instance" in passes:
        stream.log(f"{entity}/instance", rerun.Image(paint_instances(passes["instance"])))
        stream.log(f"{entity}/instance/boxes", _boxes(rerun, frame))


def _png(rerun: ModuleType, content: bytes) -> Any:
    return rerun.EncodedImage(contents=content, media_type="image/png")


def _boxes(rerun: ModuleType, frame: LoadedFrame) -> Any:
    table = frame.table
    low = np.column_stack([table["x_min"], table["y_min"]]).astype(np.float32)
    high = np.column_stack([table["x_max"], table["y_max"]]).astype(np.float32)
    names = [path.rsplit("/", 1)[-1] for path in table["class"].tolist()]
    numbers = table["id"].tolist()
    return rerun.Boxes2D(
        mins=low,
        sizes=high - low + 1.0,
        labels=[f"{name} {number}" for name, number in zip(names, numbers, strict=True)],
        colors=paint_instances(table["id"].astype(np.uint32)[None])[0],
        show_labels=False,
    )
