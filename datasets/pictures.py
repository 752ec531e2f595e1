"""The pictures of a frame: one place for all that shows frames or hands them on.

A frame's picture is what its camera gives: of a sensor with ``imaging`` what that took, else
radiance under the shared tone curve; either way the PNG beside the EXR. ``rgb`` itself stays
radiance. On request a sensor leaves two more beside it (``schemas.frames.BESIDE``): ``clean``, the
picture without noise, pattern, defects, mosaic and JPEG, and ``raw``, the converter's numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.source import LoadedFrame
from scenec.schemas.codec import JSON, UNSET, encode
from scenec.schemas.errors import FrameError
from scenec.schemas.files import sha256
from scenec.schemas.frames import Frame, beside_path
from scenec.schemas.picture import develop
from scenec.schemas.records import FileDigest, FrameRecord

if TYPE_CHECKING:
    from PIL.Image import Image

#: What each picture beside the picture is, for files that say what they hold.
TOLD = {
    "clean": "the sensor's picture without noise, pattern, defects, mosaic, rounding and JPEG",
    "raw": "the converter's numbers behind the mosaic of colors: parameters.mosaic of its "
    "imaging names the colors, from the top-left pixel on, black_level and bits its range",
}


def picture(frame: LoadedFrame | Frame) -> NDArray[np.uint8]:
    """The frame's picture, sRGB, uint8 [h, w, 3].

    Raises:
        FrameError: It has none, or the file is missing or damaged.
    """
    stem, sidecar = _stem(frame), frame.sidecar
    path = stem.with_suffix(".png")
    if sidecar.png and (path.is_file() or taken(sidecar)):
        pixels: NDArray[np.uint8] = _read(path, sidecar, "RGB")
        return pixels
    if "rgb" not in frame.passes:
        raise FrameError(f"{stem}.exr: has no rgb; render with --passes …,rgb")
    return develop(frame.passes["rgb"], sidecar.exposure_ev)


def has_picture(frame: LoadedFrame | Frame) -> bool:
    """Whether there is light in it at all."""
    return frame.sidecar.png or "rgb" in frame.passes


def taken(record: FrameRecord) -> bool:
    """Whether the picture is a sensor's (``imaging``), and so more than radiance developed."""
    return record.imaging is not None


def kinds(record: FrameRecord) -> tuple[str, ...]:
    """Which of ``BESIDE`` a frame has."""
    return tuple(_digests(record))


def _digests(record: FrameRecord) -> dict[str, FileDigest]:
    if record.imaging is None:
        return {}
    both = {"clean": record.imaging.clean, "raw": record.imaging.raw}
    return {kind: digest for kind, digest in both.items() if digest}


def imaging(record: FrameRecord) -> dict[str, JSON]:
    """What a sidecar says of its sensor, which ``raw`` cannot be read without; {} without imaging.

    Colors of the mosaic, level of black, bits, exposure, gain and more, as in ``imaging``, but for
    what vouches for files.
    """
    if record.imaging is None:
        return {}
    found: dict[str, JSON] = encode(replace(record.imaging, clean=UNSET, raw=UNSET))
    return found


def beside(frame: LoadedFrame | Frame, kind: str) -> NDArray[Any]:
    """A picture beside the picture: ``clean`` uint8 [h, w, 3], ``raw`` uint16 [h, w].

    Raises:
        FrameError: It has none, or the file is not the one that its sidecar names.
    """
    return _read(beside_file(frame, kind), frame.sidecar, "I;16" if kind == "raw" else "RGB")


def beside_file(frame: LoadedFrame | Frame, kind: str) -> Path:
    """The file of a picture beside the picture, held against the sidecar's checksum.

    Raises:
        FrameError: It has none, or the file is not the one that its sidecar names.
    """
    path = beside_path(_stem(frame), kind)
    digest = _digests(frame.sidecar).get(kind)
    if digest is None:
        raise FrameError(f"{path}: its sensor was not asked for it (imaging, {kind!r})")
    if not path.is_file():
        raise FrameError(f"{path}: missing, though its sidecar names it; render it again")
    if sha256(path) != digest.sha256:
        raise FrameError(
            f"{path}: truncated, damaged or changed since it was written (its checksum is not the "
            "sidecar's); render it again"
        )
    return path


def vouch(frame: LoadedFrame, held: Collection[str]) -> None:
    """Hold the picture, and those beside it, against the sidecar before anything is made of them.

    A PNG's own checksums say whether it is whole; those beside it have the sidecar's.

    Args:
        frame: The frame.
        held: Kinds of ``BESIDE`` that are going to be read.

    Raises:
        FrameError: A file is missing, damaged, or not the one that the sidecar names.
    """
    for kind in kinds(frame.sidecar):
        if kind in held:
            beside_file(frame, kind)
    if frame.png is not None:
        with _opened(frame.png, frame.sidecar) as image:
            image.verify()


def mosaic(record: FrameRecord) -> str:
    """Colors of the first 2 x 2 pixels of ``raw``, as in ``rggb``."""
    parameters = None if record.imaging is None else record.imaging.parameters
    return str((parameters or {}).get("mosaic", ""))


def _stem(frame: LoadedFrame | Frame) -> Path:
    return frame.path.with_suffix("") if isinstance(frame, Frame) else frame.ref.stem


def _read(path: Path, record: FrameRecord, mode: str) -> NDArray[Any]:
    with _opened(path, record) as image:
        return np.asarray(image.convert("RGB") if mode == "RGB" else image)


@contextmanager
def _opened(path: Path, record: FrameRecord) -> Iterator[Image]:
    """A picture of the frame's size; errors of reading it are a ``FrameError``."""
    from PIL import Image, UnidentifiedImageError

    if not path.is_file():
        raise FrameError(f"{path}: missing, though its sidecar is there; render it again")
    try:
        with Image.open(path) as image:
            if image.size != record.resolution:
                raise FrameError(
                    f"{path}: is {image.width} x {image.height} pixels, unlike its EXR"
                )
            yield image
    except (OSError, ValueError, SyntaxError, UnidentifiedImageError) as error:
        raise FrameError(f"{path}: not a picture, or a damaged one: {error}") from error
