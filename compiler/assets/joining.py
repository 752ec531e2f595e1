"""Parts of a file as one mesh: in meters, z up, welded, without faces that have no area."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.parts import MeshFileError, is_of
from scenec.compiler.assets.shells import Shell
from scenec.compiler.geometry import affine
from scenec.compiler.geometry.normals import face_normals

#: Largest coordinate, meters: beyond it squares of areas leave float64's range too easily.
_LARGEST_M = 1e9


def chosen_parts(parts: tuple[Shell, ...], name: str | None) -> list[Shell]:
    """The parts of a name; all of them without one.

    Raises:
        MeshFileError: There are none, or they have no faces.
    """
    if name is None:
        chosen = list(parts)
    else:
        chosen = [part for part in parts if is_of(part.path, name)]
        if not chosen:
            names = [part.path for part in parts if part.path]
            shown = ", ".join(names[:8]) + (", …" if len(names) > 8 else "")
            raise MeshFileError(f"no part {name!r}; it has {shown or 'none with a name'}")
    if not any(len(part.faces) for part in chosen):
        raise MeshFileError("it holds no faces")
    return chosen


@dataclass(frozen=True)
class Joined:
    """Parts as one mesh, as ``Model`` describes it.

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


def join(parts: Sequence[Shell], unit_m: float, up: str) -> Joined:
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
    n = face_normals(points, faces).T
    sound = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) > 0.0
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
