"""Arrays of a frame as the files of several formats hold them: pictures, ids, numbers of a type."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats.contract import Format
from scenec.datasets.pictures import picture
from scenec.datasets.source import FrameRef, LoadedFrame, record_of, sequences
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import atomic

_UNSIGNED = (np.uint8, np.uint16, np.uint32)


def chunks(frames: Sequence[FrameRef], size: int) -> list[tuple[FrameRef, ...]]:
    """Runs of at most ``size`` frames; 0 takes all in one; none of no frames."""
    step = size or max(len(frames), 1)
    return [tuple(frames[i : i + step]) for i in range(0, len(frames), step)]


def resolutions(frames: Sequence[FrameRef]) -> Iterator[tuple[FrameRef, tuple[int, int]]]:
    """Each frame with its width and height, as the first readable sidecar of its sequence has them.

    (0, 0) where a sequence has none that can be read.
    """
    for run in sequences(frames):
        size = next((s for s in map(_resolution, run) if s is not None), (0, 0))
        for ref in run:
            yield ref, size


def _resolution(ref: FrameRef) -> tuple[int, int] | None:
    record = record_of(ref)
    return None if record is None else record.resolution


def whole_option(form: Format, name: str, lowest: int = 0) -> int:
    """An option that is a whole number.

    Raises:
        OutputError: It is none, or below the lowest.
    """
    text = form.option(name)
    try:
        value = int(text)
    except ValueError:
        value = lowest - 1
    if value < lowest:
        raise OutputError(
            f"format {form.name}, option {name}: expected a whole number from {lowest}, "
            f"not {text!r}"
        )
    return value


def number_option(form: Format, name: str) -> float:
    """An option that is a number above 0.

    Raises:
        OutputError: It is none.
    """
    text = form.option(name)
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not (np.isfinite(value) and value > 0.0):
        raise OutputError(
            f"format {form.name}, option {name}: expected a number above 0, not {text!r}"
        )
    return value


def id_type(highest: int) -> type[np.unsignedinteger[Any]]:
    """The smallest unsigned type that holds ids up to ``highest``."""
    return next(t for t in _UNSIGNED if highest <= int(np.iinfo(t).max))


def label_type(names: Mapping[int, str]) -> type[np.unsignedinteger[Any]]:
    """The smallest unsigned type that holds all ids of a level."""
    return id_type(max(names, default=0))


def narrowed(
    frame: LoadedFrame, name: str, dtype: type[np.unsignedinteger[Any]]
) -> NDArray[np.unsignedinteger[Any]]:
    """A pass of ids in a narrower type.

    Raises:
        FrameError: An id does not fit: none is ever cut.
    """
    ids = frame.passes[name]
    highest = int(ids.max(initial=0))
    if highest > int(np.iinfo(dtype).max):
        raise FrameError(
            f"{frame.ref.stem}.exr: pass {name} holds id {highest}, which has no name in the "
            "sidecar's labels and does not fit the type that those need"
        )
    return np.ascontiguousarray(ids, dtype)


def picture_png(frame: LoadedFrame) -> bytes:
    """The 8-bit sRGB picture of a frame as a PNG file: the frame's own where it is there.

    Raises:
        FrameError: It has none, or the file cannot be read.
    """
    path = frame.png
    if path is not None and path.is_file():
        return file_bytes(path)
    return encoded(picture(frame))


def file_bytes(path: Path) -> bytes:
    """What is in a frame's file.

    Raises:
        FrameError: It cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise FrameError(f"{path}: cannot be read: {error.strerror or error}") from error


def encoded(pixels: NDArray[Any], kind: str = "PNG", **options: Any) -> bytes:
    """A picture as a file: uint8 [h, w(, 3 or 4)], uint16 [h, w], or float32 [h, w] (TIFF only).

    Args:
        pixels: The picture.
        kind: As Pillow names it: PNG, JPEG, TIFF.
        options: Of Pillow's writer.
    """
    from PIL import Image

    store = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(store, format=kind, **options)
    return store.getvalue()


def write_bytes(path: Path, content: bytes) -> None:
    """Writes a file by atomic rename.

    Raises:
        OutputError: It cannot be written.
    """
    with atomic(path) as temporary:
        temporary.write_bytes(content)


def split_ids(ids: NDArray[np.unsignedinteger[Any]]) -> NDArray[np.uint8]:
    """32-bit ids as four bytes: id = R + 256 G + 65536 B + 16777216 A, uint8 [h, w, 4]."""
    little = np.ascontiguousarray(ids, "<u4")
    return little.view(np.uint8).reshape(*little.shape, 4)


def instance_label(frame: LoadedFrame, level: str) -> NDArray[np.int64]:
    """The label id of each line of the frame's table at a level; 0 where its faces differ, [n]."""
    numbers = {name: number for number, name in frame.labels.get(level, {}).items()}
    column = frame.table.get(f"label.{level}")
    if column is None:
        return np.zeros(len(frame.table.get("id", ())), np.int64)
    return np.array([numbers.get(name, 0) for name in column.tolist()], np.int64)
