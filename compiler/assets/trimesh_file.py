"""Reads STL by trimesh's loader, and offers what ``ply_model`` needs of it.

The loaders are called below trimesh's own meshes and scenes, which merge, reorder and compose: what
comes back has the file's values and its order. The formats say nothing of units or of the upward
axis. Where a loader is known to take a wrong file for a right one, the file is checked
first.
"""

from __future__ import annotations

import io
import logging
import struct
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.shells import ParsedModel, Shell

#: What trimesh, NumPy and the standard library raise for files that are no meshes.
FAULTS = (
    ValueError, TypeError, LookupError, AttributeError, AssertionError, ArithmeticError, NameError,
    RuntimeError, EOFError, ImportError, struct.error, DeprecationWarning,
)  # fmt: skip

MIXED = "cut short, or its polygons differ in their numbers of corners: export it as triangles"
#: What loaders and NumPy say, and what it means to a user.
_MEANINGS = {
    "could not be read to its end": "something else where a number belongs",
    "could not convert string": "something else where a number belongs",
    "invalid literal for int": "something else where a whole number belongs",
    "PLY is unexpected length": MIXED,
    "inhomogeneous": "rows of different lengths",
    "values to unpack": "a header line with too few or too many words",
    "cannot reshape": "its header and its data do not fit",
    "buffer size must be": "its header and its data do not fit",
}


def read_stl(file: Path, looks: bool) -> ParsedModel:
    """Reads an ``.stl`` file; its parts are its solids.

    Raises:
        MeshFileError: trimesh is not installed, or the file is not sound.
    """
    load = loader(".stl")
    with sound(".stl"):
        return ParsedModel(_stl(file.read_bytes(), load), (), None, None)


def loader(suffix: str) -> Callable[..., dict[str, Any]]:
    """The loader of trimesh for an ending, which opens no other files.

    Raises:
        MeshFileError: trimesh is not installed.
    """
    try:
        from trimesh.exchange.load import mesh_loaders
    except ModuleNotFoundError as error:
        raise MeshFileError(
            f"reading {suffix} needs the extra 'meshes': pip install 'scenec[meshes]'"
        ) from error

    def load(content: bytes | str, **choices: Any) -> dict[str, Any]:
        stream = io.StringIO(content) if isinstance(content, str) else io.BytesIO(content)
        # A resolver is what would open other files.
        loader: Callable[..., dict[str, Any]] = mesh_loaders[suffix[1:]]
        return loader(file_obj=stream, file_type=suffix[1:], resolver=_NoOtherFiles(), **choices)

    return load


@contextmanager
def sound(suffix: str) -> Iterator[None]:
    """Reports whatever a broken file of this ending can raise as one fault.

    Raises:
        MeshFileError: For ``FAULTS`` and endless recursion.
    """
    name = "glTF" if suffix == ".glb" else suffix[1:].upper().replace("GLTF", "glTF")
    try:
        with _strict_and_silent():
            yield
    except RecursionError as error:
        raise MeshFileError(f"not a sound {name} file: nested without end") from error
    except FAULTS as error:
        raise MeshFileError(f"not a sound {name} file: {_reason(error)}") from error


class _NoOtherFiles:
    """Refuses the files that a file refers to, which trimesh asks it for."""

    def get(self, name: str) -> bytes:
        raise MeshFileError(f"refers to another file ({name[:60]}): export it as one")

    __getitem__ = get


@contextmanager
def _strict_and_silent() -> Iterator[None]:
    """Text that is no number is an error; what trimesh only remarks is not for users."""
    # The parent of all of trimesh's loggers.
    log, silent = logging.getLogger("trimesh"), logging.NullHandler()
    before = log.propagate
    log.addHandler(silent)
    log.propagate = False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # What NumPy before 2.5 says where later ones raise.
            warnings.filterwarnings("error", "string or file could not be read to its end")
            yield
    finally:
        log.propagate = before
        log.removeHandler(silent)


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    for words, meaning in _MEANINGS.items():
        if words in text:
            return meaning
    if isinstance(error, UnicodeError):
        return "bytes that are no text"
    if isinstance(error, KeyError):
        return f"{text[:60]} is missing or not known"
    if isinstance(error, ImportError):
        return f"trimesh lacks a package for it: {text[:160]}"
    # Other kinds of exceptions speak of the loader's own variables.
    return text[:160] if text and type(error) is ValueError else "its structure makes no sense"


def _part(path: str, loaded: dict[str, Any]) -> Shell:
    """Returns a loader's answer as a mesh; an empty one without faces (points, lines, nothing)."""
    faces = np.asarray(loaded.get("faces", np.zeros((0, 3), np.int64)))
    points = np.asarray(loaded.get("vertices", np.zeros((0, 3))))
    if not faces.size:
        return Shell(path, np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "iuf":
        raise MeshFileError(f"expected vertices of three numbers, found {points.shape}")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise MeshFileError(f"expected faces of three vertices, found {faces.shape}")
    return Shell(path, points.astype(np.float64), faces.astype(np.int64))


def _stl(data: bytes, load: Callable[..., dict[str, Any]]) -> tuple[Shell, ...]:
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else 0
    if len(data) != 84 + 50 * count:
        if b"facet" not in data:
            raise MeshFileError(
                "cut short, or not an STL file: expected text with facets, or 84 bytes and 50 for "
                f"each of {count} triangles, found {len(data)} bytes"
            )
        text = data.decode("utf-8", errors="replace").lower()
        if text.rfind("endsolid") < text.rfind("vertex"):
            raise MeshFileError("cut short: it does not end with 'endsolid'")
        data = data.decode("utf-8", errors="replace").encode()
    loaded = load(data)
    if "geometry" in loaded:
        return tuple(_part(name, mesh) for name, mesh in loaded["geometry"].items())
    return (_part("", loaded),)
