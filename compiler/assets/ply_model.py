"""PLY files as models: texture coordinates of vertices, and their colors."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.looks import (
    NO_FACE_COLORS,
    NO_VERTEX_COLORS,
    OPACITY,
    FileLook,
    Slot,
    linear_array,
)
from scenec.compiler.assets.parts import MeshFileError, polygon_warnings
from scenec.compiler.assets.pictures import companion
from scenec.compiler.assets.shells import ParsedModel, Shell
from scenec.compiler.assets.trimesh_file import MIXED, loader, sound
from scenec.schemas.polygons import triangulate

_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_TEXTURE = re.compile(rb"^comment\s+TextureFile\s+(.+?)\s*$", re.MULTILINE | re.IGNORECASE)


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


def read_ply(file: Path, looks: bool) -> ParsedModel:
    """Reads a ``.ply`` file: one part.

    Raises:
        MeshFileError: trimesh is not installed, the file is not sound, or its picture is missing.
    """
    load = loader(".ply")
    with sound(".ply"):
        data = file.read_bytes()
        mesh = _read(data, load)
        cut = triangulate(mesh.points, mesh.corners, mesh.counts)
        faces, warnings = mesh.corners[cut.corners], polygon_warnings(cut.faults)
    if looks:
        return replace(_with_looks(file, data, mesh, faces), warnings=warnings)
    shell = Shell("", mesh.points, faces)
    return ParsedModel((shell,), (), None, None, warnings=warnings)


def _with_looks(file: Path, data: bytes, mesh: PlyMesh, faces: NDArray[np.int64]) -> ParsedModel:
    inside = bool(len(faces)) and faces.min() >= 0 and faces.max() < len(mesh.points)
    looks: list[FileLook] = []
    notes: list[str] = []
    companions: list[Path] = []
    uv: dict[str, NDArray] = {}
    coordinates = next((_columns(mesh, n) for n in _UV_NAMES if set(n) <= set(mesh.values)), None)
    if coordinates is not None and inside:
        uv["st"] = coordinates[faces]
    if "texcoord" in mesh.face_keys and not uv:
        notes.append("texture coordinates of its faces are left out: store them with the vertices")
    header = data.split(b"end_header", 1)[0]
    pictures = [name.decode("utf-8", errors="replace") for name in _TEXTURE.findall(header)]
    if pictures and uv:
        companions.append(companion(file, pictures[0], "picture"))
        slot = Slot(companions[0], pictures[0])
        looks.append(FileLook("", base_color=(1.0, 1.0, 1.0), slots={"base_color": slot}))
        if len(pictures) > 1:
            notes.append(f"only the first of its {len(pictures)} pictures is shown")
    elif pictures:
        notes.append(f"its picture {pictures[0]} lies on no texture coordinates of vertices")
    colors = None
    names = {"red", "green", "blue"}
    if names <= set(mesh.face_keys):
        notes.append(NO_FACE_COLORS)
    if names <= set(mesh.values) and looks:
        notes.append(NO_VERTEX_COLORS)
    elif inside and names <= set(mesh.values):
        stored = _columns(mesh, ("red", "green", "blue"))
        kind = mesh.values["red"].dtype
        codes = stored / np.iinfo(kind).max if kind.kind in "iu" else stored
        colors = linear_array(np.nan_to_num(codes))[faces]
    alpha = mesh.values.get("alpha")
    if (
        alpha is not None
        and (alpha < (np.iinfo(alpha.dtype).max if alpha.dtype.kind in "iu" else 1.0)).any()
    ):
        notes.append(OPACITY)
    normals = None
    if inside and {"nx", "ny", "nz"} <= set(mesh.values):
        normals = _columns(mesh, ("nx", "ny", "nz"))[faces]
    owners = np.full(len(faces), 0 if looks else -1, np.int64)
    shell = Shell("", mesh.points, faces, uv, normals, colors, owners)
    return ParsedModel((shell,), tuple(looks), None, None, tuple(companions), tuple(notes))


def _columns(mesh: PlyMesh, names: tuple[str, ...]) -> NDArray[np.float64]:
    return np.stack([mesh.values[name].astype(np.float64) for name in names], axis=1)


def _read(data: bytes, load: Callable[..., dict[str, Any]]) -> PlyMesh:
    head, *body = data.split(b"end_header", 1)
    if not body:
        raise MeshFileError("not a PLY file: its header has no end_header")
    # Comments may stand before the format, and in any encoding.
    head = re.sub(rb"^(?:comment|obj_info)\b.*\n", b"", head, flags=re.MULTILINE)
    if b"\nformat ascii" in head:
        # Text is as precise as it is spelled, whatever type stands before it.
        head = re.sub(
            rb"^property\s+float(?:32)?\s+([xyz])\b", rb"property double \1", head, flags=re.M
        )
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
            raise MeshFileError(MIXED)
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
