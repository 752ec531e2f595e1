"""Defines what the readers of models return: parts with all values at their corners."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.looks import FileLook
from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.geometry import affine

#: What rounding may leave of the last row of an affine map.
_AFFINE = 1e-9


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
        material: Index into ``ParsedModel.looks``, or -1: int64 [m]; None: no face has one.
    """

    path: str
    points: NDArray[np.float64]
    faces: NDArray[np.int64]
    uv: dict[str, NDArray] = field(default_factory=dict)
    normals: NDArray | None = None
    colors: NDArray | None = None
    material: NDArray[np.int64] | None = None

    def owners(self) -> NDArray[np.int64]:
        """Index of each face's material; -1 for none."""
        return np.full(len(self.faces), -1, np.int64) if self.material is None else self.material

    def chosen(self, selection: NDArray) -> Shell:
        """Some of its faces, by their indices or by a mask, with the points that they use."""
        return replace(
            self,
            faces=self.faces[selection],
            uv={name: uv[selection] for name, uv in self.uv.items()},
            normals=None if self.normals is None else self.normals[selection],
            colors=None if self.colors is None else self.colors[selection],
            material=None if self.material is None else self.material[selection],
        ).compact()

    def compact(self) -> Shell:
        """Without the points that no face uses; with all if a face uses one that there is not."""
        faces, count = self.faces, len(self.points)
        if not len(faces) or faces.min() < 0 or faces.max() >= count:
            return self
        # Sorting is for the many small parts of a large file.
        if 20 * len(faces) < count:
            used, corners = np.unique(faces.ravel(), return_inverse=True)
            faces = corners.reshape(-1, 3)
        else:
            marked = np.zeros(count, bool)
            marked[faces.ravel()] = True
            used, faces = np.flatnonzero(marked), (np.cumsum(marked) - 1)[faces]
        return replace(self, points=self.points[used], faces=faces)


@dataclass(frozen=True, eq=False)
class ParsedModel:
    """A model file as it is; equal to itself alone, so that it can be a key.

    Attributes:
        parts: In the file's order; names may repeat.
        unit_m: Meters per unit, where the format or the file says so.
        up: Upward axis, where the format or the file says so.
        companions: Files beside it that belong to it, in the order in which they are named.
        notes: What is left out.
        warnings: What of the geometry is unsound, to be said on the screen, too.
    """

    parts: tuple[Shell, ...]
    looks: tuple[FileLook, ...]
    unit_m: float | None
    up: str | None
    companions: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def missing(self, unit_m: float | None, up: str | None) -> list[str]:
        """Names which of ``unit_m`` and ``up`` neither the file nor the caller gives."""
        said = {"unit_m": (unit_m, self.unit_m), "up": (up, self.up)}
        return [key for key, values in said.items() if values == (None, None)]


def placed(shell: Shell, matrix: NDArray[np.float64], *, turned: bool | None = None) -> Shell:
    """A shell under a map; what turns right into left turns the faces, too.

    Args:
        matrix: float64 [4, 4], for columns.
        turned: Whether to turn the faces; None: where the map mirrors.

    Raises:
        MeshFileError: The map is projective.
    """
    row = matrix[3].tolist()
    if np.isfinite(row).all() and np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > _AFFINE:
        raise MeshFileError(
            f"{shell.path or 'a mesh'}: its transform is projective: its matrix ends in "
            f"{' '.join(f'{value:.6g}' for value in row)}, expected 0 0 0 1"
        )
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
    return replace(
        shell,
        points=affine.applied(matrix, shell.points),
        faces=shell.faces[:, ::step],
        uv={name: uv[:, ::step] for name, uv in shell.uv.items()},
        normals=normals,
        colors=None if shell.colors is None else shell.colors[:, ::step],
    )


def repeated(
    shell: Shell,
    positions: NDArray[np.float64],
    turns: NDArray[np.float64],
    scales: NDArray[np.float64],
) -> Shell:
    """Copies of a shell as one, a copy after the other; those that mirror turn their faces.

    Args:
        positions: Where each copy's origin is, float64 [k, 3].
        turns: Quaternions (x, y, z, w) of any length but 0, float64 [k, 4].
        scales: Along the shell's axes, before they turn, float64 [k, 3].
    """
    count = len(positions)
    rows = affine.rotations(turns)
    points = affine.turned(rows, scales[:, None] * shell.points) + positions[:, None]
    steps = (np.arange(count) * len(shell.points))[:, None, None]
    faces = shell.faces + steps
    mirrored = (scales < 0.0).sum(axis=1) % 2 == 1
    faces[mirrored] = faces[mirrored][:, :, ::-1]

    def corners(values: NDArray) -> NDArray:
        """Repeats the values at the corners of one copy for all copies."""
        every = np.repeat(values[None], count, axis=0)
        every[mirrored] = every[mirrored][:, :, ::-1]
        return every.reshape(-1, 3, values.shape[-1])

    normals = shell.normals
    if normals is not None:
        # A normal is divided by the scale; times their product, a flat copy keeps its side's.
        x, y, z = np.abs(scales).T
        shares = np.stack([y * z, z * x, x * y], axis=1) * np.where(scales < 0.0, -1.0, 1.0)
        flat = np.asarray(normals, np.float64).reshape(-1, 3)
        turned = affine.turned(rows, shares[:, None] * flat).reshape(count, -1, 3, 3)
        turned[mirrored] = turned[mirrored][:, :, ::-1]
        normals = turned.reshape(-1, 3, 3)
    return replace(
        shell,
        points=points.reshape(-1, 3),
        faces=faces.reshape(-1, 3),
        uv={name: corners(uv) for name, uv in shell.uv.items()},
        normals=normals,
        colors=None if shell.colors is None else corners(shell.colors),
        material=None if shell.material is None else np.tile(shell.material, count),
    )
