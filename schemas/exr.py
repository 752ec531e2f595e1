"""Frames as multi-part OpenEXR: one part per pass, with full channel names.

Names, channels and types of passes: ``scenec.schemas.passes``. ``depth`` is the channel ``Z``,
``rgb`` has ``R``, ``G``, ``B``, others are layers: ``normal.X``, ``label.<level>.id``. A pass of
another package is read as its file has it, channels in order of their names: nothing of that
package is needed. Float32 where memory has float64, half floats where it has float16. ZIP
compression, except of passes whose bits are noise (``_packed_worth``). The same arrays give the
same bytes.
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.exr_parts import without_parts
from scenec.schemas.files import atomic
from scenec.schemas.passes import PassFormat, built_in
from scenec.schemas.records import HalfRecord

if TYPE_CHECKING:
    import OpenEXR

#: A pass is compressed if that saves this share of it, by every so many-th of its rows; also if
#: these hold fewer bytes.
_LEAST_SAVED, _TRIED, _FEW_BYTES = 0.1, 16, 1 << 14
_ORDERED = ("R", "G", "B")


def write_exr(
    path: Path, passes: Mapping[str, NDArray], formats: Mapping[str, PassFormat] | None = None
) -> None:
    """Write passes, in their order, by atomic rename.

    Args:
        path: Ends in ``.exr``.
        passes: Pass name -> [h, w] or [h, w, channels]; ids unsigned, the rest floating; float16
            stays so.
        formats: Formats of the passes that are not ours, by name.

    Raises:
        OutputError: The file cannot be written.
        FrameError: A pass of unknown name or wrong shape.
    """
    import OpenEXR

    parts = []
    for name, array in passes.items():
        of = built_in(name) or (formats or {}).get(name)
        if of is None:
            raise FrameError(f"{path}: unknown pass {name!r}")
        channels = of.channel_names
        planes = array[..., None] if array.ndim == 2 else array
        if planes.ndim != 3 or planes.shape[2] != len(channels):
            raise FrameError(f"{path}: pass {name!r} has shape {array.shape}")
        planes = planes.astype("float16" if planes.dtype == np.float16 else of.dtype, copy=False)
        parts.append(_part(name, channels, planes, compressed=_packed_worth(channels, planes)))

    with atomic(path) as temporary:
        try:
            OpenEXR.File(parts).write(str(temporary))
        except RuntimeError as error:
            raise OutputError(f"{path}: cannot be written: {error}") from error


def as_half(rgb: NDArray[np.float32]) -> tuple[NDArray[np.float16], HalfRecord]:
    """Rounds radiance to half floats, and counts what these do not hold to 11 bits.

    Relative error at most 2^-11 from 2^-14 (6.1e-5) to 65504; absolute error at most 2^-25 below;
    finite values beyond are clamped. NaN and infinity stay.
    """
    size = np.abs(rgb)
    most = np.float32(np.finfo(np.float16).max)
    beyond = np.isfinite(rgb) & (size > most)
    small = (size > 0) & (size < np.finfo(np.float16).tiny)
    stored = np.where(beyond, np.copysign(most, rgb), rgb).astype(np.float16)
    counts = {"clamped": np.count_nonzero(beyond), "subnormal": np.count_nonzero(small)}
    return stored, HalfRecord(**{name: int(count) for name, count in counts.items()})


def _part(
    name: str, channels: Sequence[str], planes: NDArray, *, compressed: bool = True
) -> OpenEXR.Part:
    import OpenEXR

    packing = OpenEXR.ZIP_COMPRESSION if compressed else OpenEXR.NO_COMPRESSION
    header = {"type": OpenEXR.scanlineimage, "compression": packing}
    if tuple(channels) == _ORDERED:
        # The library's own name for the three together, which it takes as they lie.
        return OpenEXR.Part(header, {"RGB": np.ascontiguousarray(planes)}, name=name)
    data = {each: np.ascontiguousarray(planes[..., i]) for i, each in enumerate(channels)}
    return OpenEXR.Part(header, data, name=name)


def _packed_worth(channels: Sequence[str], planes: NDArray) -> bool:
    """Tells whether compression saves a tenth of a pass; only of floats, and by some of its rows.

    The last bits of Monte Carlo radiance are noise: to save 9 % of it takes 30 ms of 640 x 480.
    """
    import OpenEXR

    rows = planes[_TRIED // 2 :: _TRIED]
    if planes.dtype != np.float32 or rows.nbytes < _FEW_BYTES:
        return True
    tried = io.BytesIO()
    OpenEXR.File([_part("tried", channels, rows)]).write(tried)
    return tried.tell() < (1.0 - _LEAST_SAVED) * rows.nbytes


def read_exr(path: Path, unused: Collection[str] = ()) -> dict[str, NDArray]:
    """Passes of a frame: floats as float32, ids as uint32, [h, w] or [h, w, channels].

    Args:
        path: The file.
        unused: Names of passes that are not decoded and left out.

    Raises:
        FrameError: The file is missing, truncated, corrupt, or not a frame of this contract.
    """
    if not path.is_file():
        raise FrameError(f"{path}: no such frame")
    with _captured_stderr() as noise:
        passes = _read_passes(path, unused)
    if noise[0].strip():
        raise FrameError(f"{path}: damaged: {noise[0].strip().splitlines()[0]}")
    if len({array.shape[:2] for array in passes.values()}) != 1:
        raise FrameError(f"{path}: passes differ in size, or there are none")
    return passes


def _read_passes(path: Path, unused: Collection[str]) -> dict[str, NDArray]:
    import OpenEXR

    try:
        if unused:
            rest = io.BytesIO(without_parts(path.read_bytes(), unused))
            file = OpenEXR.File(rest, separate_channels=True)
        else:
            file = OpenEXR.File(str(path), separate_channels=True)
    except (RuntimeError, ValueError, TypeError, OSError) as error:
        raise FrameError(f"{path}: not an OpenEXR file, or cut short") from error
    passes: dict[str, NDArray] = {}
    for part in file.parts:
        name = part.name()
        if name in unused:
            continue
        found = built_in(name)
        channels = tuple(sorted(part.channels)) if found is None else found.channel_names
        if not channels or (found is None and not all(c.startswith(f"{name}.") for c in channels)):
            raise FrameError(f"{path}: unknown pass {name!r}; not a frame of scenec")
        types = {"uint32", "float32"} if found is None else {found.dtype}
        if "float32" in types:
            types = {*types, "float16"}
        planes = []
        for channel in channels:
            # A broken chunk leaves its channel out, with a line on stderr and no exception.
            pixels = part.channels[channel].pixels if channel in part.channels else None
            if pixels is None or pixels.shape != (part.height(), part.width()):
                raise FrameError(f"{path}: pass {name!r} is damaged or cut short")
            if pixels.dtype.name not in types:
                raise FrameError(f"{path}: channel {channel!r} has type {pixels.dtype}")
            types = {pixels.dtype.name}
            planes.append(pixels.astype(np.float32) if pixels.dtype == np.float16 else pixels)
        passes[name] = planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)
    return passes


@contextlib.contextmanager
def _captured_stderr() -> Iterator[list[str]]:
    """Collect what the native library prints: its only sign of some kinds of damage."""
    captured: list[str] = []
    with tempfile.TemporaryFile() as store:
        saved = os.dup(2)
        os.dup2(store.fileno(), 2)
        try:
            yield captured
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            store.seek(0)
            captured.append(store.read().decode(errors="replace"))


def write_rgb(path: Path, picture: NDArray[np.float32]) -> None:
    """Writes a linear Rec.709 picture, float32 [h, w, 3], as R, G, B with ZIP compression.

    Raises:
        OutputError: The file cannot be written.
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {"RGB": np.ascontiguousarray(picture, dtype=np.float32)}
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(str(path))
    except (RuntimeError, OSError) as error:
        raise OutputError(f"{path}: cannot be written: {error}") from error


def read_rgb(path: Path, gray: bool = False) -> NDArray[np.float32]:
    """Channels R, G, B of an OpenEXR picture, float32 [h, w, 3].

    Args:
        path: The file.
        gray: Whether one with a channel Y instead is taken, too: [h, w, 1].

    Raises:
        ValueError: It is none, or lacks one of them.
    """
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True) as source:
            channels = source.channels()
            names = ("Y",) if gray and "R" not in channels else ("R", "G", "B")
            planes = [channels[name].pixels for name in names]
            return np.stack(planes, axis=-1).astype(np.float32)
    except (RuntimeError, OSError, KeyError, TypeError, ValueError) as error:
        wanted = "R, G, B or Y" if gray else "R, G, B"
        raise ValueError(f"not an OpenEXR picture with channels {wanted} ({error})") from error
