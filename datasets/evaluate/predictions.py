"""Files of predictions: which frame each is of, and what is in it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.datasets.source import FrameRef, Source
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import NUMPY_FAULTS
from scenec.schemas.manifest import FRAMES
from scenec.schemas.native import native_reading

#: Of a PNG with 16 bits a pixel, as Pillow calls its mode.
DEEP = ("I;16", "I;16B", "I")
#: Depths whose errors have a square and a ratio in double precision, meters.
DEPTHS_M = 1e-30, 1e30


def predicted(
    folder: Path, frames: Sequence[FrameRef], suffixes: Sequence[str], skip_missing: bool
) -> tuple[list[tuple[FrameRef, Path]], list[str]]:
    """Each frame's file in a folder of predictions.

    A file is called as the frame is: ``batch_0000_rover_left_000003.png`` anywhere in the folder,
    or ``batch_0000/rover_left/000003.png``, with or without the folders that frames of an output
    have between (``frames/mitsuba``).

    Args:
        folder: Of the predictions.
        frames: To be predicted.
        suffixes: In lower case, with the dot. Of two files of a frame that of the suffix that
            stands first counts.
        skip_missing: Whether frames without a file are left out.

    Returns:
        (frame, file) in order of frames; notes on what was left out.

    Raises:
        OutputError: A frame has no file, or two; or no file is a frame's.
    """
    if not folder.is_dir():
        raise OutputError(f"{folder}: expected a folder with a file for each frame")
    files: dict[str, Path] = {}
    wanted = {ref.key: ref for ref in frames}
    extra: list[Path] = []
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() not in suffixes:
            continue
        key = _key(path.relative_to(folder).with_suffix(""), wanted)
        if key is None:
            extra.append(path)
        elif key in files and _rank(files[key], suffixes) != _rank(path, suffixes):
            files[key] = min(files[key], path, key=lambda one: _rank(one, suffixes))
        elif key in files:
            raise OutputError(f"{path}: {files[key]} is a prediction of the same frame; keep one")
        else:
            files[key] = path
    example = f"{frames[0].key}{suffixes[0]}"
    if not files:
        raise OutputError(
            f"{folder}: no file is called as a frame is; expected {example} or "
            f"{frames[0].name}{suffixes[0]}"
            + (f", found {extra[0].relative_to(folder)}" if extra else "")
        )
    missing = [ref for ref in frames if ref.key not in files]
    if missing and not skip_missing:
        raise OutputError(
            f"{folder / missing[0].key}{suffixes[0]}: missing, with {len(missing)} of "
            f"{len(frames)} frames' predictions; --missing skip judges the others alone"
        )
    notes = []
    if missing:
        notes.append(f"{len(missing)} of {len(frames)} frames have no prediction and do not count")
    if extra:
        notes.append(f"{len(extra)} files are no frame's, such as {extra[0].relative_to(folder)}")
    return [(ref, files[ref.key]) for ref in frames if ref.key in files], notes


def unrendered(source: Source) -> list[str]:
    """Notes frames of the truth that were not rendered, and so are not judged."""
    missing = source.missing
    if not missing:
        return []
    more = f" and {len(missing) - 1} more" if missing[1:] else ""
    return [
        f"{len(missing)} of {len(missing) + len(source)} frames of {source.out} were not rendered "
        f"and do not count: {missing[0].name}{more}"
    ]


def _rank(path: Path, suffixes: Sequence[str]) -> int:
    return suffixes.index(path.suffix.lower())


def _key(path: Path, wanted: dict[str, FrameRef]) -> str | None:
    if path.name in wanted:
        return path.name
    parts = path.parts
    key = "_".join(parts[-3:])
    if key not in wanted and parts[-4:-3] == (FRAMES,):
        key = "_".join((parts[-5], *parts[-2:])) if len(parts) > 4 else ""
    return key if key in wanted else None


def read_labels(path: Path, shape: tuple[int, int]) -> NDArray[np.int64]:
    """A label map, [h, w]: a PNG of one channel (8 or 16 bits), or the indices of one with colors.

    Raises:
        FrameError: It is none, or of another size.
    """
    picture = _png(path)
    if picture.mode not in ("L", "P", "1", *DEEP):
        raise FrameError(
            f"{path}: expected one number a pixel (gray, or a palette's indices), not the mode "
            f"{picture.mode} of {len(picture.getbands())} channels"
        )
    return _sized(path, np.asarray(picture).astype(np.int64), shape)


def read_depth(path: Path, shape: tuple[int, int], scale: float | None) -> NDArray[np.float64]:
    """Depth in meters, [h, w]; 0, negative or not finite where there is none.

    Args:
        path: ``.npy`` in meters, ``.exr`` with a channel ``Z`` in meters, or ``.png`` in steps.
        shape: As the frame has it.
        scale: Steps of a PNG a meter.

    Raises:
        FrameError: It cannot be read, is of another size, or holds a depth that no measure of error
            can be made of.
        OutputError: A PNG without a scale.
    """
    values = _depth_of(path, shape, scale)
    said = np.isfinite(values) & (values > 0.0)
    odd = said & ((values < DEPTHS_M[0]) | (values > DEPTHS_M[1]))
    if odd.any():
        row, column = map(int, np.argwhere(odd)[0])
        raise FrameError(
            f"{path}: has the depth {values[row, column]:g} m at column {column}, row {row}; "
            f"expected {DEPTHS_M[0]:g} to {DEPTHS_M[1]:g} m, and 0, negative or not finite for none"
        )
    return values


def _depth_of(path: Path, shape: tuple[int, int], scale: float | None) -> NDArray[np.float64]:
    suffix = path.suffix.lower()
    if suffix == ".png":
        if scale is None:
            raise OutputError(
                f"{path}: depth in a PNG needs --depth-scale, its steps a meter (TUM has 5000, "
                "KITTI 256, millimeters are 1000)"
            )
        picture = _png(path)
        if picture.mode not in ("L", *DEEP):
            raise FrameError(f"{path}: expected gray of 16 bits, not the mode {picture.mode}")
        return _sized(path, np.asarray(picture).astype(np.float64) / scale, shape)
    if suffix == ".exr":
        return _sized(path, _exr_depth(path), shape)
    try:
        values = np.load(path)
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
            raise ValueError("not an array of real numbers")
    except NUMPY_FAULTS as error:
        raise FrameError(f"{path}: no array that NumPy reads: {error}") from error
    return _sized(path, values.squeeze().astype(np.float64), shape)


def _exr_depth(path: Path) -> NDArray[np.float64]:
    """The channel ``Z`` of the first part that has one, as frames of an output and others do."""
    import OpenEXR

    try:
        with native_reading(path):
            parts = OpenEXR.File(str(path), separate_channels=True).parts
    except (RuntimeError, ValueError, TypeError, OSError) as error:
        raise FrameError(f"{path}: not an OpenEXR file, or cut short") from error
    for part in parts:
        pixels = part.channels["Z"].pixels if "Z" in part.channels else None
        if pixels is not None:
            return np.asarray(pixels, np.float64)
    raise FrameError(f"{path}: has no channel Z, which depth in meters is expected in")


def _png(path: Path) -> Image.Image:
    try:
        with Image.open(path) as picture:
            picture.load()
            return picture
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise FrameError(f"{path}: no picture that can be read: {error}") from error


def _sized(path: Path, values: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    if values.shape != shape:
        found = "x".join(map(str, values.shape[::-1]))
        raise FrameError(f"{path}: is {found} pixels, and its frame {shape[1]}x{shape[0]}")
    return values
