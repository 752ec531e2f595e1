"""Frames as multi-part OpenEXR: one part per pass, with full channel names.

==================  =======================================  ==========
pass (part name)    channels                                 type
==================  =======================================  ==========
``rgb``             ``R``, ``G``, ``B``                      float
``depth``           ``Z``                                    float
``range``           ``range.Z``                              float
``label.<level>``   ``label.<level>.id``                     uint
``instance``        ``instance.id``                          uint
``face``            ``face.id``                              uint
``normal``          ``normal.X``, ``normal.Y``, ``normal.Z``       float
``position``        ``position.X``, ``position.Y``, ``position.Z``  float
``flow``            ``flow.U``, ``flow.V``                   float
``scene_flow``      ``scene_flow.X``, ``scene_flow.Y``, ``scene_flow.Z``  float
``disparity``       ``disparity.U``                          float
``depth_measured``  ``depth_measured.Z``                     float
``occlusion``       ``occlusion.id``                         uint
==================  =======================================  ==========

``flow_backward`` is as ``flow``, ``occlusion_backward`` and ``disparity_occlusion`` are as
``occlusion`` (``scenec.schemas.correspondence``). ZIP compression, float32 where memory has
float64. The same arrays give the same bytes.
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.correspondence import CORRESPONDENCES
from scenec.schemas.depth_camera import MEASURED
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.exr_parts import without_parts
from scenec.schemas.files import atomic

_FIXED_CHANNELS: dict[str, tuple[str, ...]] = {
    "rgb": ("R", "G", "B"),
    "depth": ("Z",),
    "range": ("range.Z",),
    "instance": ("instance.id",),
    "face": ("face.id",),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "position": ("position.X", "position.Y", "position.Z"),
    "flow": ("flow.U", "flow.V"),
    "flow_backward": ("flow_backward.U", "flow_backward.V"),
    "scene_flow": ("scene_flow.X", "scene_flow.Y", "scene_flow.Z"),
    "disparity": ("disparity.U",),
    MEASURED: (f"{MEASURED}.Z",),
    "occlusion": ("occlusion.id",),
    "occlusion_backward": ("occlusion_backward.id",),
    "disparity_occlusion": ("disparity_occlusion.id",),
}


#: Passes as they are asked for; "label" stands for all levels. "amodal" is no part of the EXR, but
#: a file of its own (``scenec.schemas.amodal``).
PASSES = (
    *("rgb", "label", "instance", "depth", "range", "normal", "position", "face", "amodal"),
    *CORRESPONDENCES,
    MEASURED,
)


def channel_names(name: str) -> tuple[str, ...]:
    """Channels of a pass, in the order of the array's last axis.

    Raises:
        FrameError: No such pass.
    """
    if name in _FIXED_CHANNELS:
        return _FIXED_CHANNELS[name]
    if name.startswith("label.") and len(name) > len("label."):
        return (f"{name}.id",)
    raise FrameError(f"unknown pass {name!r}")


def is_id_pass(name: str) -> bool:
    """Whether a pass holds ids (uint32) instead of floats."""
    return _FIXED_CHANNELS.get(name, (f"{name}.id",)) == (f"{name}.id",)


def write_exr(path: Path, passes: Mapping[str, NDArray]) -> None:
    """Write passes, in their order, by atomic rename.

    Args:
        path: Ends in ``.exr``.
        passes: Pass name -> [h, w] or [h, w, channels]; ids unsigned, the rest floating.

    Raises:
        OutputError: The file cannot be written.
        FrameError: A pass of unknown name or wrong shape.
    """
    import OpenEXR

    parts = []
    for name, array in passes.items():
        channels = channel_names(name)
        dtype = np.uint32 if is_id_pass(name) else np.float32
        planes = array[..., None] if array.ndim == 2 else array
        if planes.ndim != 3 or planes.shape[2] != len(channels):
            raise FrameError(f"{path}: pass {name!r} has shape {array.shape}")
        header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
        data = {
            channel: np.ascontiguousarray(planes[..., i], dtype)
            for i, channel in enumerate(channels)
        }
        parts.append(OpenEXR.Part(header, data, name=name))

    with atomic(path) as temporary:
        try:
            OpenEXR.File(parts).write(str(temporary))
        except RuntimeError as error:
            raise OutputError(f"{path}: cannot be written: {error}") from error


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
        try:
            channels = channel_names(name)
        except FrameError as error:
            raise FrameError(f"{path}: {error}; not a frame of scenec") from error
        planes = []
        for channel in channels:
            # A broken chunk leaves its channel out, with a line on stderr and no exception.
            pixels = part.channels[channel].pixels if channel in part.channels else None
            expected = np.uint32 if is_id_pass(name) else np.float32
            if pixels is None or pixels.shape != (part.height(), part.width()):
                raise FrameError(f"{path}: pass {name!r} is damaged or cut short")
            if pixels.dtype != expected:
                raise FrameError(f"{path}: channel {channel!r} has type {pixels.dtype}")
            planes.append(pixels)
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


def read_rgb(path: Path) -> NDArray[np.float32]:
    """Channels R, G, B of an OpenEXR picture, float32 [h, w, 3].

    Raises:
        ValueError: It is none, or lacks one of them.
    """
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True) as source:
            channels = source.channels()
            planes = [channels[name].pixels for name in ("R", "G", "B")]
    except (RuntimeError, OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"not an OpenEXR picture with channels R, G, B ({error})") from error
    return np.stack(planes, axis=-1).astype(np.float32)
