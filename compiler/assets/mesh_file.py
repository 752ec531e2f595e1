"""Meshes from files: one call for all formats, one form for all that reads them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets import trimesh_file
from scenec.compiler.assets.parts import MeshFileError, Parsed, Part
from scenec.compiler.geometry import affine
from scenec.schemas.errors import SceneError

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
#: What files of each format begin with, to tell a wrong ending.
_MAGIC = {
    b"ply\n": ".ply", b"ply\r": ".ply", b"glTF": ".glb", b"PXR-USDC": ".usdc", b"#usda": ".usda",
}  # fmt: skip
#: Largest coordinate, meters: beyond it squares of areas leave float64's range too easily.
_LARGEST_M = 1e9


@dataclass(frozen=True)
class MeshFile:
    """A mesh from a file: meters, Z up, right-handed.

    Vertices of exactly equal position are one, in the order in which they come first: formats that
    split them along seams of texture or shading leave a connected surface. Faces without area are
    dropped, as are vertices that no face uses.

    Attributes:
        points: float64 [n, 3].
        faces: int32 [m, 3], counter-clockwise seen from outside; polygons are fans.
        part_of_face: Index into ``parts``, int32 [m].
        parts: Names of the file's meshes, with those above them.
        degenerate: Faces dropped.
        welded: Vertices that were copies.
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    part_of_face: NDArray[np.int32]
    parts: tuple[str, ...]
    degenerate: int
    welded: int


def read_mesh(
    file: Path, *, unit_m: float | None = None, up: str | None = None, part: str | None = None
) -> MeshFile:
    """Reads OBJ, PLY, STL, OFF, glTF or USD.

    Args:
        file: ``.obj``, ``.ply``, ``.stl``, ``.off``, ``.glb``, ``.gltf``, ``.usd``, ``.usda``,
            ``.usdc``, ``.usdz``. All but USD need the extra ``meshes``.
        unit_m: Meters per unit; None takes what the file says.
        up: Upward axis: x, y, z, -x, -y or -z; None takes what the file says.
        part: One of its meshes, or a name above some of them; None takes all.

    Raises:
        SceneError: The file cannot be read or is no mesh; it has no such part; or neither the
            arguments nor the file say the unit or the axis.
    """
    parsed = parse_mesh(file)
    for missing in missing_keys(parsed, unit_m, up):
        raise SceneError(f"{file.name}: does not say {MEANING[missing]}: give {missing}")
    return finish_mesh(file, parsed, unit_m=unit_m, up=up, part=part)


def finish_mesh(
    file: Path,
    parsed: Parsed,
    *,
    unit_m: float | None = None,
    up: str | None = None,
    part: str | None = None,
) -> MeshFile:
    """What ``read_mesh`` makes of a parsed file; where nobody says them, 1 m and z.

    Raises:
        SceneError: It is no sound mesh, or has no such part.
    """
    try:
        chosen = chosen_parts(parsed.parts, part)
        joined = join(chosen, *unit_and_up(parsed, unit_m, up))
    except MeshFileError as fault:
        raise SceneError(f"{file.name}: {fault}") from fault
    return MeshFile(
        joined.points,
        joined.faces,
        joined.owner,
        tuple(part.path for part in chosen),
        int((~joined.sound).sum()),
        joined.welded,
    )


MEANING = {"unit_m": "how long its unit is", "up": "which axis points upward"}


class Measured(Protocol):
    """A parsed file that may say its unit and its upward axis, as ``Parsed`` does."""

    @property
    def unit_m(self) -> float | None: ...  # noqa: D102

    @property
    def up(self) -> str | None: ...  # noqa: D102


def unit_and_up(parsed: Measured, unit_m: float | None, up: str | None) -> tuple[float, str]:
    """What is given, else what the file says, else 1 m and z."""
    unit = parsed.unit_m if unit_m is None else unit_m
    return 1.0 if unit is None else unit, (parsed.up if up is None else up) or "z"


def missing_keys(parsed: Measured, unit_m: float | None, up: str | None) -> list[str]:
    """Which of ``unit_m`` and ``up`` the file leaves open and nobody gives."""
    given = {
        "unit_m": parsed.unit_m if unit_m is None else unit_m,
        "up": parsed.up if up is None else up,
    }
    return [key for key, value in given.items() if value is None]


def parse_mesh(file: Path) -> Parsed:
    """A file's meshes as it has them, unchecked.

    Raises:
        SceneError: The file cannot be read, or is none of the formats.
    """
    with faults_of(file):
        return _reader(file)(file)


@contextmanager
def faults_of(file: Path) -> Iterator[None]:
    """Checks that there is something to read, and names the file in what goes wrong within.

    Raises:
        SceneError: There is nothing to read, or what the block raises as ``MeshFileError``.
    """
    try:
        if not file.is_file():
            raise MeshFileError("not a file" if file.exists() else "there is no such file")
        if file.stat().st_size == 0:
            raise MeshFileError("the file is empty")
        yield
    except MeshFileError as fault:
        raise SceneError(f"{file.name}: {fault}") from fault
    except (OSError, MemoryError) as error:
        reason = str(error) or "it does not fit into memory"
        raise SceneError(f"{file.name}: cannot be read: {reason}") from error


def checked_suffix(file: Path) -> str:
    """The file's ending in lower case, once its first bytes do not speak against it.

    Raises:
        MeshFileError: They are those of another format.
    """
    suffix = file.suffix.lower()
    with file.open("rb") as stream:
        head = stream.read(8)
    for magic, true_suffix in _MAGIC.items():
        if head.startswith(magic) and not _fits(suffix, true_suffix):
            raise MeshFileError(f"its content is that of a {true_suffix} file: rename it")
    if suffix == ".ply" and not head.startswith((b"ply\n", b"ply\r")):
        raise MeshFileError("not a PLY file: it does not begin with 'ply'")
    return suffix


def _reader(file: Path) -> Callable[[Path], Parsed]:
    suffix = checked_suffix(file)
    if suffix in trimesh_file.SUFFIXES:
        return trimesh_file.read
    if suffix in USD_SUFFIXES:
        # Imported here: not every mesh is USD.
        from scenec.compiler.assets.usd import read_usd

        return read_usd
    known = ", ".join((*trimesh_file.SUFFIXES, *USD_SUFFIXES))
    raise MeshFileError(f"expected a mesh ({known}), not {suffix or 'a file without an ending'}")


def _fits(suffix: str, true_suffix: str) -> bool:
    return suffix == true_suffix or (suffix == ".usd" and true_suffix in USD_SUFFIXES)


def chosen_parts[P: Part](parts: tuple[P, ...], name: str | None) -> list[P]:
    """The parts of a name; all of them without one.

    Raises:
        MeshFileError: There are none, or they have no faces.
    """
    if name is None:
        chosen = list(parts)
    else:
        chosen = [part for part in parts if part.is_of(name)]
        if not chosen:
            names = [part.path for part in parts if part.path]
            shown = ", ".join(names[:8]) + (", …" if len(names) > 8 else "")
            raise MeshFileError(f"no part {name!r}; it has {shown or 'none with a name'}")
    if not any(len(part.faces) for part in chosen):
        raise MeshFileError("it holds no faces")
    return chosen


@dataclass(frozen=True)
class Joined:
    """Parts as one mesh, as ``MeshFile`` describes it.

    Attributes:
        points: float64 [n, 3].
        faces: int32 [m, 3].
        owner: Index of each face's part, int32 [m].
        sound: Which of the parts' faces, one part after the other, are in ``faces``: bool.
        welded: Vertices that were copies.
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    owner: NDArray[np.int32]
    sound: NDArray[np.bool_]
    welded: int


def join(parts: Sequence[Part], unit_m: float, up: str) -> Joined:
    """One mesh of several parts: in meters, z up, welded, without faces that have no area.

    Raises:
        MeshFileError: They are no sound mesh.
    """
    if not 0.0 < unit_m < np.inf:
        raise MeshFileError(f"its unit is {unit_m:g} m, expected one above 0")
    blocks: list[NDArray[np.float64]] = []
    corners, total = [], 0
    for part in parts:
        count = len(part.points)
        bad = (part.faces < 0) | (part.faces >= count)
        if bad.any():
            raise MeshFileError(
                f"{part.path or 'a face'} uses vertex {int(part.faces[bad][0])} (from 0) of {count}"
            )
        blocks.append(part.points)
        corners.append(part.faces + total)
        total += count
    points, faces = np.concatenate(blocks), np.concatenate(corners)
    used = np.zeros(len(points), bool)
    used[faces.ravel()] = True
    if not np.isfinite(points[used]).all():
        at = int(np.flatnonzero(used & ~np.isfinite(points).all(axis=1))[0])
        raise MeshFileError(
            f"vertex {at} (from 0) is {points[at].tolist()}: expected finite numbers"
        )
    if not len(faces):
        raise MeshFileError("it holds no faces")

    faces, points = _number(used)[faces], points[used]
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(affine.TO_Z_UP[up], np.float64) * unit_m
    points = affine.applied(matrix, points)
    if not np.abs(points).max() < _LARGEST_M:
        raise MeshFileError(
            f"reaches out to {np.abs(points).max():.3g} m, at most {_LARGEST_M:g} m are taken"
        )
    owner = np.repeat(np.arange(len(parts), dtype=np.int32), [len(part.faces) for part in parts])
    first_of, total = weld(points), len(points)
    points, faces = points[first_of == np.arange(total)], _number_first(first_of)[faces]
    sound = _doubled_areas(points, faces) > 0.0
    if not sound.any():
        raise MeshFileError(f"none of its {len(faces)} faces has an area")
    faces, owner, welded = faces[sound], owner[sound], total - len(points)
    used = np.zeros(len(points), bool)
    used[faces.ravel()] = True
    return Joined(
        np.ascontiguousarray(points[used]),
        np.ascontiguousarray(_number(used)[faces], np.int32),
        owner,
        sound,
        welded,
    )


def _number(used: NDArray[np.bool_]) -> NDArray[np.int64]:
    """New indices once what is not used is gone."""
    return np.cumsum(used) - 1


def _number_first(first_of: NDArray[np.int64]) -> NDArray[np.int64]:
    return _number(first_of == np.arange(len(first_of)))[first_of]


def weld(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """For each point, the first one of exactly its position: int64 [n]."""
    # 0 and -0 are one place, and sort as one.
    order = np.lexsort((points[:, 2], points[:, 1], points[:, 0]))
    ordered = points[order]
    new = np.ones(len(points), bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    # lexsort is stable: the first of each run is the first of all.
    first = np.empty(len(points), np.int64)
    first[order] = order[np.flatnonzero(new)][np.cumsum(new) - 1]
    return first


def _doubled_areas(points: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = (points[faces[:, k]] for k in range(3))
    u, v = b - a, c - a
    n = [
        u[:, i] * v[:, j] - u[:, j] * v[:, i]
        for i, j in ((1, 2), (2, 0), (0, 1))
    ]  # fmt: skip
    return np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
