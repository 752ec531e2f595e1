"""PLY files as models: texture coordinates of vertices, and their colors."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.looks import Look, Slot, linear_array
from scenec.compiler.assets.parts import fan_corners
from scenec.compiler.assets.pictures import companion
from scenec.compiler.assets.shells import ParsedModel, Shell
from scenec.compiler.assets.trimesh_file import PlyMesh, read_ply

_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_TEXTURE = re.compile(rb"^comment\s+TextureFile\s+(.+?)\s*$", re.MULTILINE | re.IGNORECASE)


def read_ply_model(file: Path) -> ParsedModel:
    """Reads a ``.ply`` file: one part.

    Raises:
        MeshFileError: As ``trimesh_file.read``; its picture is missing.
    """
    mesh = read_ply(file)
    corners, _ = fan_corners(mesh.counts)
    faces = mesh.corners[corners]
    inside = bool(len(faces)) and faces.min() >= 0 and faces.max() < len(mesh.points)
    looks: list[Look] = []
    notes: list[str] = []
    companions: list[Path] = []
    uv: dict[str, NDArray] = {}
    coordinates = next((_columns(mesh, n) for n in _UV_NAMES if set(n) <= set(mesh.values)), None)
    if coordinates is not None and inside:
        uv["st"] = coordinates[faces]
    if "texcoord" in mesh.face_keys and not uv:
        notes.append("texture coordinates of its faces are left out: store them with the vertices")
    header = file.read_bytes().split(b"end_header", 1)[0]
    pictures = [name.decode("utf-8", errors="replace") for name in _TEXTURE.findall(header)]
    if pictures and uv:
        companions.append(companion(file, pictures[0], "picture"))
        slot = Slot(companions[0], pictures[0])
        looks.append(Look("", base_color=(1.0, 1.0, 1.0), slots={"base_color": slot}))
        if len(pictures) > 1:
            notes.append(f"only the first of its {len(pictures)} pictures is shown")
    elif pictures:
        notes.append(f"its picture {pictures[0]} lies on no texture coordinates of vertices")
    colors = None
    if inside and {"red", "green", "blue"} <= set(mesh.values) and not looks:
        stored = _columns(mesh, ("red", "green", "blue"))
        kind = mesh.values["red"].dtype
        codes = stored / np.iinfo(kind).max if kind.kind in "iu" else stored
        colors = linear_array(np.nan_to_num(codes))[faces]
    normals = None
    if inside and {"nx", "ny", "nz"} <= set(mesh.values):
        normals = _columns(mesh, ("nx", "ny", "nz"))[faces]
    owners = np.full(len(faces), 0 if looks else -1, np.int64)
    shell = Shell("", mesh.points, faces, uv, normals, colors, owners)
    return ParsedModel((shell,), tuple(looks), None, None, tuple(companions), tuple(notes))


def _columns(mesh: PlyMesh, names: tuple[str, ...]) -> NDArray[np.float64]:
    return np.stack([mesh.values[name].astype(np.float64) for name in names], axis=1)
