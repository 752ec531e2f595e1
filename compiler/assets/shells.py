"""What the readers of models have in common: parts with all that stands at their corners."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.looks import Look
from scenec.compiler.geometry import affine


@dataclass(frozen=True)
class Shell:
    """One mesh of a file, placed where the file puts it, in the file's axes and unit.

    Attributes:
        path: Its name; in files with a hierarchy, the names down to it, joined by ``/``.
        points: float64 [n, 3].
        faces: int64 [m, 3]; indices as the file has them, in range or not.
        uv: Texture coordinates by the name of their set, the first one first, v up; [m, 3, 2].
        normals: At the corners, of any length, in the file's axes as the points: [m, 3, 3].
        colors: At the corners, linear Rec.709: [m, 3, 3].
        material: Index into ``ParsedModel.looks``, or -1: int64 [m].
    """

    path: str
    points: NDArray[np.float64]
    faces: NDArray[np.int64]
    uv: dict[str, NDArray] = field(default_factory=dict)
    normals: NDArray | None = None
    colors: NDArray | None = None
    material: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def owners(self) -> NDArray[np.int64]:
        """Index of each face's material; -1 for all where the part has none."""
        none = np.full(len(self.faces), -1, np.int64)
        return self.material if len(self.material) == len(self.faces) else none


@dataclass(frozen=True, eq=False)
class ParsedModel:
    """A model file as it is; equal to itself alone, so that it can be a key.

    Attributes:
        parts: In the file's order; names may repeat.
        looks: Its materials.
        unit_m: Meters per unit, where the format or the file says so.
        up: Upward axis, where the format or the file says so.
        companions: Files beside it that belong to it, in the order in which they are named.
        notes: What is left out.
    """

    parts: tuple[Shell, ...]
    looks: tuple[Look, ...]
    unit_m: float | None
    up: str | None
    companions: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()


def placed(shell: Shell, matrix: NDArray[np.float64], *, turned: bool | None = None) -> Shell:
    """A shell under a map; what turns right into left turns the faces, too.

    Args:
        shell: The part.
        matrix: float64 [4, 4], for columns.
        turned: Whether to turn the faces; None: where the map mirrors.
    """
    mirrored = affine.mirrors(matrix)
    step = -1 if (mirrored if turned is None else turned) else 1
    normals = shell.normals
    if normals is not None:
        (a, b, c), (d, e, f), (g, h, i) = matrix[:3, :3]
        cofactors = np.zeros((4, 4))
        cofactors[:3, :3] = [
            [e * i - f * h, f * g - d * i, d * h - e * g],
            [c * h - b * i, a * i - c * g, b * g - a * h],
            [b * f - c * e, c * d - a * f, a * e - b * d],
        ]
        if mirrored:
            # The inverse's transpose is the cofactors over the determinant.
            cofactors = -cofactors
        flat = np.asarray(normals, np.float64).reshape(-1, 3)
        normals = affine.applied(cofactors, flat).reshape(-1, 3, 3)[:, ::step]
    return Shell(
        shell.path,
        affine.applied(matrix, shell.points),
        shell.faces[:, ::step],
        {name: uv[:, ::step] for name, uv in shell.uv.items()},
        normals,
        None if shell.colors is None else shell.colors[:, ::step],
        shell.material,
    )


def compact(shell: Shell) -> Shell:
    """Without the points that no face uses; faces that use none of the points stay as they are."""
    if not len(shell.faces):
        return shell
    if shell.faces.min() < 0 or shell.faces.max() >= len(shell.points):
        return shell
    # Sorting is for the many small parts of a large file.
    if 20 * len(shell.faces) < len(shell.points):
        used, corners = np.unique(shell.faces.ravel(), return_inverse=True)
        faces = corners.reshape(-1, 3)
    else:
        marked = np.zeros(len(shell.points), bool)
        marked[shell.faces.ravel()] = True
        used, faces = np.flatnonzero(marked), (np.cumsum(marked) - 1)[shell.faces]
    return Shell(
        shell.path, shell.points[used], faces, shell.uv, shell.normals, shell.colors, shell.material
    )
