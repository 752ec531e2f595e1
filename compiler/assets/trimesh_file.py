"""OBJ, PLY, STL, OFF and glTF by the loaders of trimesh: positions and faces, nothing else.

The loaders are called below trimesh's own meshes and scenes, which merge, reorder and compose: what
comes back has the file's values and its order. OBJ, PLY, STL and OFF say nothing of units or of the
upward axis. Where a loader is known to take a wrong file for a right one, the file is checked
first. Polygons are fans around their first corner; OFF is the exception: there trimesh splits
quads itself, and puts their second halves last.
"""

from __future__ import annotations

import io
import logging
import re
import struct
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.gltf_scene import GltfScene
from scenec.compiler.assets.parts import MeshFileError, Parsed, Part, fans

SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
#: What trimesh, NumPy and the standard library raise for files that are no meshes.
FAULTS = (
    ValueError, TypeError, LookupError, AttributeError, AssertionError, ArithmeticError, NameError,
    RuntimeError, EOFError, ImportError, struct.error, DeprecationWarning,
)  # fmt: skip

_NUMBER = r"[-+]?(?:\d++\.?\d*+|\.\d++|(?i:nan|inf(?:inity)?))(?:[eE][-+]?\d++)?"
#: A vertex without three numbers, or a face that is no list of indices other than 0.
_OBJ_FAULT = re.compile(
    rf"\n(?:v(?! +{_NUMBER} +{_NUMBER} +{_NUMBER}[ \n])"
    r"|f(?!(?: +-?0*+[1-9]\d*+(?:/-?\d*+){0,2})+ *\n))(?: .*)?(?=\n)"
)
_FREE_FORM = re.compile(r"\n(?:curv2?|surf|cstype|bmat|parm) ")
_BACKWARD = re.compile(r"\nf (?:.* )?-")
#: Texture coordinates and normals of a corner.
_REFERENCES = re.compile(r"/\S*")
_MIXED = "cut short, or its polygons differ in their numbers of corners: export it as triangles"
#: What loaders and NumPy say, and what it means to a user.
_MEANINGS = {
    "could not be read to its end": "something else where a number belongs",
    "could not convert string": "something else where a number belongs",
    "invalid literal for int": "something else where a whole number belongs",
    "PLY is unexpected length": _MIXED,
    "inhomogeneous": "rows of different lengths",
    "values to unpack": "a header line with too few or too many words",
    "cannot reshape": "its header and its data do not fit",
    "buffer size must be": "its header and its data do not fit",
}


def read(file: Path) -> Parsed:
    """Reads a file of one of ``SUFFIXES``.

    An OBJ file's parts are its objects (``o``) or, where it has none, its groups (``g``); an STL
    file's, its solids; a glTF file's, its nodes' meshes, under the names of the nodes down to them.

    Raises:
        MeshFileError: trimesh is not installed; or the file is not sound, holds no triangles or
            polygons, or refers to other files for them.
    """
    suffix = file.suffix.lower()
    load = _loader(suffix)
    with sound(suffix):
        data = file.read_bytes()
        if suffix == ".obj":
            return Parsed(_obj(data, load), None, None)
        if suffix == ".ply":
            return Parsed((_ply(data, load),), None, None)
        if suffix == ".stl":
            return Parsed(_stl(data, load), None, None)
        if suffix == ".off":
            text = data.decode("utf-8", errors="replace")
            if "OFF" not in text[:4096]:
                raise MeshFileError("not an OFF file: it does not begin with 'OFF'")
            return Parsed((_part("", load(text)),), None, None)
        scene = GltfScene(data, suffix == ".glb")
        loaded = load(scene.geometry())["geometry"].values()
        parts = [_part("", mesh) for mesh in loaded]
        return Parsed(scene.placed([(p.points, p.faces) for p in parts]), 1.0, "y")


def read_ply(file: Path) -> PlyMesh:
    """Reads a ``.ply`` file.

    Raises:
        MeshFileError: As ``read``.
    """
    load = _loader(".ply")
    with sound(".ply"):
        return _ply_mesh(file.read_bytes(), load)


def _loader(suffix: str) -> Callable[..., dict[str, Any]]:
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
    """What a broken file of this ending can raise within, as one fault.

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
    """What trimesh asks for files that a file refers to."""

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


def _part(path: str, loaded: dict[str, Any]) -> Part:
    """Of a loader's answer: a mesh if it has faces; else points, lines or nothing."""
    faces = np.asarray(loaded.get("faces", np.zeros((0, 3), np.int64)))
    points = np.asarray(loaded.get("vertices", np.zeros((0, 3))))
    if not faces.size:
        return Part(path, np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "iuf":
        raise MeshFileError(f"expected vertices of three numbers, found {points.shape}")
    if faces.ndim != 2 or faces.dtype.kind not in "iu":
        raise MeshFileError(f"expected faces as lists of vertices, found {faces.dtype}")
    counts = np.full(len(faces), faces.shape[1], np.int64)
    return Part(path, points.astype(np.float64), fans(counts, faces.ravel().astype(np.int64)))


def obj_text(data: bytes) -> str:
    """An OBJ file with one statement a line, words separated by spaces, between line feeds.

    Raises:
        MeshFileError: A vertex or a face is malformed, or there are free-form surfaces.
    """
    # What is not ASCII can stand in names and comments only.
    text = data.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    text = "\n" + text.replace("\\\n", " ").replace("\t", " ") + "\n"
    if "\n " in text or " #" in text:
        text = re.sub(r"\n +", "\n", re.sub(r" +#.*", "", text))
    fault = _FREE_FORM.search(text)
    if fault:
        raise MeshFileError(f"{_line(text, fault)}: a free-form surface: export it as polygons")
    fault = _OBJ_FAULT.search(text)
    if fault:
        kind, expected = (
            ("vertex", "three numbers")
            if fault[0].startswith("\nv")
            else ("face", "vertices, counted from 1")
        )
        raise MeshFileError(
            f"{_line(text, fault)}: {fault[0].strip()[:60]!r} is no {kind} of an OBJ file: "
            f"expected {expected}"
        )
    return text


def _obj(data: bytes, load: Callable[..., dict[str, Any]]) -> tuple[Part, ...]:
    text = obj_text(data)
    backward = _BACKWARD.search(text)
    if backward and text.rfind("\nv ") > backward.start():
        raise MeshFileError(
            f"{_line(text, backward)}: vertices counted backward, with more vertices after it: "
            "export it with vertices counted from the first"
        )
    if "/" in text:
        # They would split vertices, and reorder them.
        text = "\n".join(
            _REFERENCES.sub("", line) if line.startswith("f ") else line
            for line in text.split("\n")
        )
    by_object = "\no " in text
    by_group = not by_object and "\ng " in text
    try:
        loaded = load(
            text,
            group_material=False,
            skip_materials=True,
            split_objects=by_object,
            split_groups=by_group,
        ).get("geometry", {})
    except IndexError as error:
        at = re.search(r"index (-?\d+).* size (\d+)", str(error))
        which = f"vertex {at[1]} (from 0) of {at[2]}" if at else "a vertex that is not there"
        raise MeshFileError(f"a face uses {which}") from error
    named = by_object or by_group
    # The loader takes chunks of faces from the last to the first.
    return tuple(_part(name if named else "", mesh) for name, mesh in reversed(loaded.items()))


def _line(text: str, place: re.Match[str]) -> str:
    return f"line {text.count('\n', 0, place.start()) + 1}"


@dataclass(frozen=True)
class PlyMesh:
    """A PLY file as it is.

    Attributes:
        points: float64 [n, 3].
        counts: Corners of each polygon, int64 [p].
        corners: All their corners, int64 [sum of counts].
        values: Single numbers of the vertices, by name, each [n].
        face_keys: Names of what the faces have.
    """

    points: NDArray[np.float64]
    counts: NDArray[np.int64]
    corners: NDArray[np.int64]
    values: dict[str, NDArray]
    face_keys: tuple[str, ...]


def _ply(data: bytes, load: Callable[..., dict[str, Any]]) -> Part:
    mesh = _ply_mesh(data, load)
    return Part("", mesh.points, fans(mesh.counts, mesh.corners))


def _ply_mesh(data: bytes, load: Callable[..., dict[str, Any]]) -> PlyMesh:
    head, *body = data.split(b"end_header", 1)
    if not body:
        raise MeshFileError("not a PLY file: its header has no end_header")
    # Comments may stand before the format, and in any encoding.
    head = re.sub(rb"^(?:comment|obj_info)\b.*\n", b"", head, flags=re.MULTILINE)
    loaded = load(b"end_header".join((head, *body)), fix_texture=False, skip_materials=True)
    # As the file has it: what trimesh makes of it puts quads behind triangles.
    raw = loaded["metadata"]["_ply_raw"]
    if "face" not in raw:
        raise MeshFileError("a PLY file without the element 'face': expected a mesh")
    vertices, faces = raw["vertex"], raw["face"]
    if not vertices["length"] or not faces["length"]:
        empty = np.zeros(0, np.int64)
        return PlyMesh(np.zeros((0, 3)), empty, empty, {}, ())
    points = np.column_stack([np.ravel(vertices["data"][axis]) for axis in "xyz"])
    name = next((n for n in ("vertex_indices", "vertex_index") if n in faces["properties"]), None)
    if name is None:
        raise MeshFileError("its faces have no list vertex_indices")
    rows = faces["data"][name]
    if len(points) != vertices["length"] or len(rows) != faces["length"]:
        raise MeshFileError(
            "cut short, or not one line for each vertex and face: its header promises "
            f"{vertices['length']} and {faces['length']}"
        )
    if rows.dtype.names:
        # Binary: each row has its own count, and as many corners as the first.
        if (rows["f0"] != rows["f0"][0]).any():
            raise MeshFileError(_MIXED)
        rows = rows["f1"]
    if rows.dtype == object:
        counts = np.array([len(row) for row in rows], np.int64)
        corners = np.concatenate(list(rows)).astype(np.int64)
    else:
        rows = rows.reshape(len(rows), -1)
        counts = np.full(len(rows), rows.shape[1], np.int64)
        corners = rows.ravel().astype(np.int64)
    values = {
        key: np.ravel(vertices["data"][key])
        for key, kind in vertices["properties"].items()
        if "LIST" not in kind
    }
    return PlyMesh(points.astype(np.float64), counts, corners, values, tuple(faces["properties"]))


def _stl(data: bytes, load: Callable[..., dict[str, Any]]) -> tuple[Part, ...]:
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
