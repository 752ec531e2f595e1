"""Models from files, for terrain and objects: a mesh with coordinates, parts and materials."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.joining import chosen_parts, join
from scenec.compiler.assets.looks import (
    FileLook,
    ModelMaterial,
    finished_look,
    is_warning,
)
from scenec.compiler.assets.parse import faults_of, parse_model
from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.shells import ParsedModel, Shell
from scenec.compiler.geometry import affine
from scenec.compiler.geometry.normals import face_normals
from scenec.compiler.geometry.rounding import rounding_of
from scenec.schemas.errors import SceneError
from scenec.schemas.files import Stamp, stamp

#: Files that are kept once they are read: for checking, hashing and all batches.
_MOST = 64
_parsed: dict[Path, tuple[list[Stamp], ParsedModel]] = {}
#: Part of a model's size by which float32 may move its vertices: half a pixel of 5000.
_ROUNDED = 1e-4
#: A point of a model in meters, z up, that becomes its origin; or "base", see ``base_of``.
Origin = str | tuple[float, float, float] | None
_MEANING = {"unit_m": "how long its unit is", "up": "which axis points upward"}


@dataclass(frozen=True)
class MeshModel:
    """A model from a file: meters, Z up, right-handed.

    Vertices of exactly equal position are one, in the order in which they come first: texture
    coordinates and normals stand at the corners of faces, so that their seams do not split the
    surface. Faces without area are dropped, as are vertices that no face uses.

    Attributes:
        points: float64 [n, 3].
        faces: int32 [m, 3], counter-clockwise seen from outside.
        uv: Texture coordinates of the faces' corners, v up as USD's ``st``, float32 [m, 3, 2]; 0
            where a part has none; None where none has. What a material does to its coordinates
            is done.
        part_of_face: Index into ``parts``, int32 [m].
        parts: Names of the file's meshes, with those above them; each once.
        material_of_face: Index into ``materials``, int32 [m]; -1 for none.
        colors: Factors of the base color at the faces' corners, linear, float32 [m, 3, 3]; None
            where none varies: then they are in the materials.
        materials: Those in use, in the file's order; their names are unique.
        normals: Shading normals of the faces' corners, unit, float32 [m, 3, 3]; None where the
            file has none. A face without them has its geometric one.
        notes: What of the file is left out, in words for a user.
        warnings: Those of them, and of what is unsound, that are to be told on the screen.
        degenerate: Faces dropped.
        welded: Vertices that were copies.
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32] | None
    part_of_face: NDArray[np.int32]
    parts: tuple[str, ...]
    material_of_face: NDArray[np.int32]
    materials: tuple[ModelMaterial, ...]
    normals: NDArray[np.float32] | None
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    degenerate: int
    welded: int
    colors: NDArray[np.float32] | None = None


def read_model(
    file: Path,
    *,
    unit_m: float | None = None,
    up: str | None = None,
    part: str | None = None,
    looks: bool = True,
) -> MeshModel:
    """Reads a file of one of ``parse.SUFFIXES``.

    Args:
        file: PLY and STL need the extra ``meshes``, ``.blend`` the extra ``cycles``.
        unit_m: Meters per unit; None takes what the file says.
        up: Upward axis: x, y, z, -x, -y or -z; None takes what the file says.
        part: One of its meshes, or a name above some of them; None takes all.
        looks: As of ``parse_model``.

    Raises:
        SceneError: The file, or one that belongs to it, cannot be read; it is no mesh; it has no
            such part; or neither the arguments nor the file say the unit or the axis.
    """
    parsed = parse_model(file, looks=looks)
    for missing in parsed.missing(unit_m, up):
        raise SceneError(f"{file.name}: does not say {_MEANING[missing]}: give {missing}")
    return finish_model(file, parsed, unit_m=unit_m, up=up, part=part)


def finish_model(
    file: Path,
    parsed: ParsedModel,
    *,
    unit_m: float | None = None,
    up: str | None = None,
    part: str | None = None,
    origin: Origin = None,
) -> MeshModel:
    """Turns a parsed file into a model, as ``read_model`` does; the defaults are 1 m and z.

    Args:
        origin: What of it becomes the model's origin.

    Raises:
        SceneError: It is no sound mesh, has no such part, or a picture is broken.
    """
    with faults_of(file):
        unit = parsed.unit_m if unit_m is None else unit_m
        axis = (parsed.up if up is None else up) or "z"
        made = _finished(
            chosen_parts(parsed.parts, part), parsed, 1.0 if unit is None else unit, axis
        )
        if origin is None:
            return made
        place = base_of(made.points) if isinstance(origin, str) else np.array(origin)
        return replace(made, points=made.points - place)


def origin_of(value: Any) -> Origin:
    """Returns a model's origin by the cfg's ``origin``; None where it is the file's."""
    return tuple(value) if isinstance(value, list) else value


def base_of(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the middle of a model's extent in plan, at its lowest height: float64 [3]."""
    low, high = points.min(axis=0), points.max(axis=0)
    return np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])


def require_near_origin(file: Path, model: MeshModel) -> None:
    """Refuses a model that is so far from its origin that float32 changes its shape.

    Raises:
        SceneError: It is.
    """
    size = np.ptp(model.points, axis=0)
    size_m, off_m = float(np.sqrt((size * size).sum())), rounding_of(model.points)
    if off_m <= _ROUNDED * size_m:
        return
    base = ", ".join(f"{value:.12g}" for value in base_of(model.points).tolist())
    far_m = np.abs(model.points).max()
    raise SceneError(
        f"{file.name}: it is {size_m:.3g} m large and lies {far_m:,.0f} m from its origin, where "
        f'float32 holds vertices within {off_m:.2g} m: say "origin": "base" to have it stand on '
        f'its pose, or "origin": [x, y, z] near [{base}]'
    )


def parsed_model(file: Path) -> ParsedModel:
    """``parse_model``, once as long as the file and those that belong to it stay as they are.

    Raises:
        SceneError: As ``parse_model``.
    """
    if file in _parsed:
        state, parsed = _parsed[file]
        if state == _state(file, parsed):
            return parsed
        del _parsed[file]
    before = [stamp(file)] if file.is_file() else []
    parsed = parse_model(file)
    state = _state(file, parsed)
    if state[:1] == before:
        # Else it was replaced while it was read.
        if len(_parsed) >= _MOST:
            del _parsed[next(iter(_parsed))]
        _parsed[file] = (state, parsed)
    return parsed


def _state(file: Path, parsed: ParsedModel) -> list[Stamp]:
    """Returns stamps of a model's files, which change with them."""
    try:
        return [stamp(path) for path in (file, *parsed.companions)]
    except OSError:
        return []


def cached_model(
    file: Path, unit_m: float | None, up: str | None, part: str | None, origin: Origin = None
) -> MeshModel:
    """``read_model``, once for the same arguments and files.

    Args:
        file, unit_m, up, part: As of ``read_model``.
        origin: As of ``finish_model``.

    Raises:
        SceneError: As ``read_model``.
    """
    return _finished_once(file, parsed_model(file), unit_m, up, part, origin)


@lru_cache(maxsize=_MOST)
def _finished_once(
    file: Path,
    parsed: ParsedModel,
    unit_m: float | None,
    up: str | None,
    part: str | None,
    origin: Origin,
) -> MeshModel:
    return finish_model(file, parsed, unit_m=unit_m, up=up, part=part, origin=origin)


def _finished(shells: list[Shell], parsed: ParsedModel, unit_m: float, up: str) -> MeshModel:
    joined = join(shells, unit_m, up)
    notes = [*parsed.warnings, *parsed.notes]
    shells, looks = _with_even_colors(shells, parsed.looks)
    owner = np.concatenate([shell.owners() for shell in shells])[joined.sound]
    used = [i for i in range(len(looks)) if (owner == i).any()]
    uv = _texture_coordinates(shells, looks, used, notes)
    materials = []
    names: set[str] = set()
    for i in used:
        material, left_out = finished_look(looks[i])
        notes += left_out
        name, number = material.name, 2
        while name in names:
            name, number = f"{material.name}_{number}", number + 1
        names.add(name)
        materials.append(replace(material, name=name))
    numbers = np.full(len(looks) + 1, -1, np.int32)
    numbers[used] = np.arange(len(used))
    parts = {path: i for i, path in enumerate(dict.fromkeys(shell.path for shell in shells))}
    part_numbers = np.array([parts[shell.path] for shell in shells], np.int32)
    notes = list(dict.fromkeys(notes))
    return MeshModel(
        joined.points,
        joined.faces,
        None if uv is None else np.ascontiguousarray(uv[joined.sound], np.float32),
        part_numbers[joined.owner],
        tuple(parts),
        numbers[owner],
        tuple(materials),
        _normals(shells, joined.points, joined.faces, joined.sound, up),
        tuple(notes),
        tuple(note for note in notes if note in parsed.warnings or is_warning(note)),
        int((~joined.sound).sum()),
        joined.welded,
        _colors(shells, joined.sound),
    )


def _with_even_colors(
    shells: list[Shell], looks: tuple[FileLook, ...]
) -> tuple[list[Shell], list[FileLook]]:
    """Colors at corners that are all the same become a factor of a part's material."""
    out, known = [], list(looks)
    for shell in shells:
        if shell.colors is None or not len(shell.faces):
            out.append(shell)
            continue
        owners = shell.owners().copy()
        new, colors = owners.copy(), np.array(shell.colors, np.float64)
        for owner in sorted({int(i) for i in owners}):
            of_owner = owners == owner
            corners = colors[of_owner]
            even = (corners == corners[:1, :1]).all()
            average = corners.reshape(-1, 3).mean(axis=0).tolist() if even else [1.0, 1.0, 1.0]
            if average == [1.0, 1.0, 1.0] and owner >= 0:
                continue
            base = known[owner] if owner >= 0 else FileLook("", base_color=(1.0, 1.0, 1.0))
            red, green, blue = (c * a for c, a in zip(base.base_color, average, strict=True))
            new[of_owner] = len(known)
            known.append(replace(base, base_color=(red, green, blue)))
            if even:
                colors[of_owner] = 1.0
        own = colors if (colors != 1.0).any() else None
        out.append(replace(shell, material=new, colors=own))
    return out, known


def _colors(shells: list[Shell], sound: NDArray[np.bool_]) -> NDArray[np.float32] | None:
    if all(shell.colors is None for shell in shells):
        return None
    blocks = [np.ones((len(s.faces), 3, 3)) if s.colors is None else s.colors for s in shells]
    return np.ascontiguousarray(np.concatenate(blocks)[sound], np.float32)


def _texture_coordinates(
    shells: list[Shell], looks: list[FileLook], used: list[int], notes: list[str]
) -> NDArray[np.float64] | None:
    if not any(shell.uv for shell in shells):
        notes += [
            f"{looks[i].title}: its pictures lie on no texture coordinates"
            for i in used
            if looks[i].slots
        ]
        return None
    blocks = []
    for shell in shells:
        block = np.zeros((len(shell.faces), 3, 2))
        first = next(iter(shell.uv.values()), None)
        if first is not None:
            block[...] = first
        owners = shell.owners()
        for i in used:
            of_look = owners == i
            if not (looks[i].slots and of_look.any()):
                continue
            name, (a, b, c, d, e, f) = looks[i].coordinates()
            chosen = shell.uv.get(name) if name else first
            if chosen is None:
                notes.append(
                    f"{looks[i].title}: {shell.path or 'the mesh'} does not have its texture "
                    "coordinates"
                )
                continue
            u, v = np.asarray(chosen, np.float64)[of_look][..., 0], chosen[of_look][..., 1]
            block[of_look] = np.stack([a * u + b * v + c, d * u + e * v + f], axis=-1)
            outside = (block[of_look] < -1e-6) | (block[of_look] > 1.0 + 1e-6)
            if not looks[i].repeats and outside.any():
                notes.append(f"{looks[i].title}: its pictures repeat, where it asks for their edge")
        blocks.append(block)
    uv = np.concatenate(blocks)
    if not (np.abs(uv) < 1e9).all():
        raise MeshFileError("a texture coordinate is not finite, or above 1e9")
    return uv


def _normals(
    shells: list[Shell],
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    sound: NDArray[np.bool_],
    up: str,
) -> NDArray[np.float32] | None:
    if all(shell.normals is None for shell in shells):
        return None
    given = np.concatenate(
        [
            np.zeros((len(shell.faces), 3, 3))
            if shell.normals is None
            else np.asarray(shell.normals, np.float64)
            for shell in shells
        ]
    )[sound]
    turn = np.eye(4)
    turn[:3, :3] = affine.TO_Z_UP[up]
    given = affine.applied(turn, given.reshape(-1, 3)).reshape(-1, 3, 3)
    flat = face_normals(points, faces)
    given = np.where(np.isfinite(given).all(axis=2, keepdims=True), given, 0.0)
    # Largest first, so that squares neither vanish nor overflow.
    largest = np.abs(given).max(axis=2, keepdims=True)
    missing = largest[..., 0] == 0.0
    given = np.where(missing[..., None], flat[:, None, :], given)
    given = given / np.abs(given).max(axis=2, keepdims=True)
    x, y, z = given[..., 0], given[..., 1], given[..., 2]
    length = np.sqrt(x * x + y * y + z * z)
    return np.ascontiguousarray(given / length[..., None], np.float32)
