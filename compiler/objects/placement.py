"""Where instances lie on heights: places by density, and how they turn with the ground."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.objects.density import Density, UniformDensity
from scenec.compiler.objects.lattice import Lattice
from scenec.compiler.objects.places import Places
from scenec.compiler.objects.surroundings import Surroundings
from scenec.compiler.objects.where import Place
from scenec.compiler.terrain.grid import HeightField
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import kernel


def places_on(
    field: HeightField, density: Density, where: Sequence[Place], around: Surroundings, name: str
) -> Places:
    """Where objects of a density lie on heights: it is taken as constant over each cell.

    Args:
        field: The terrain.
        density: Relative density.
        where: What it is multiplied with.
        around: What it may depend on.
        name: Object class, for messages.

    Raises:
        SceneError: It is zero everywhere.
    """
    if isinstance(density, UniformDensity) and not where:
        return Places(Lattice.over(field.grid), np.zeros(0), np.zeros((0, 3, 2)), 1.0)
    lattice = lattice_of(field, density, where, around)
    dense = density.on(lattice, around)
    whole = float(dense.sum())
    for place in where:
        dense = dense * place.weight(lattice, around)
    cumulative = np.cumsum(dense.ravel())
    require_somewhere(whole, float(cumulative[-1]), name)
    share = 1.0 if not where else float(dense.sum()) / whole
    return Places(lattice, cumulative, np.zeros((0, 3, 2)), share)


def lattice_of(
    field: HeightField, density: Density, where: Sequence[Place], around: Surroundings
) -> Lattice:
    """Cells fine enough for a density and its conditions."""
    finest = [density.finest_m(around), *(place.finest_m(around) for place in where)]
    return Lattice.over(field.grid, min((f for f in finest if f is not None), default=None))


def require_somewhere(whole: float, left: float, name: str) -> None:
    """Refuses a density that is zero everywhere.

    Raises:
        SceneError: It is.
    """
    if not whole > 0.0:
        raise SceneError(
            f"objects/{name}: its density is zero everywhere; lower its contrast, widen it, "
            "or give it a background"
        )
    if not np.isfinite(left):
        raise SceneError(f"objects/{name}: its density overflows; use smaller numbers")
    if not left > 0.0:
        raise SceneError(
            f"objects/{name}: nowhere on the terrain do density and where both allow anything; "
            "widen the bounds"
        )


def align_to_normals(
    orientations: NDArray[np.float64], normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Orientations followed by the shortest turn from +z to each normal.

    Args:
        orientations: Unit quaternions (x, y, z, w), float64 [n, 4].
        normals: Unit vectors with z > -1, float64 [n, 3].
    """
    w = 1.0 + normals[:, 2]
    turn = np.stack([-normals[:, 1], normals[:, 0], np.zeros(len(w)), w], axis=1)
    turn /= np.sqrt((turn * turn).sum(axis=1))[:, None]
    ax, ay, az, aw = turn.T
    bx, by, bz, bw = orientations.T
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=1,
    )


@kernel
def rotation_rows(q: NDArray) -> tuple[float, ...]:
    """The nine entries, row by row, of the rotation of a quaternion (x, y, z, w) of any length."""
    x, y, z, w = q
    s = 2.0 / (x * x + y * y + z * z + w * w)
    return (
        1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w),
        s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w),
        s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y),
    )  # fmt: skip


def turned(orientations: NDArray[np.float16], scales: NDArray[np.float32]) -> NDArray[np.float32]:
    """Matrices from prototypes' axes to the world's, scale included, float32 [n, 3, 3].

    Args:
        orientations: Quaternions (x, y, z, w) of any length, [n, 4].
        scales: Of the three axes, [n, 3].
    """
    out = np.empty((len(scales), 3, 3), np.float32)
    _turned(orientations.astype(np.float64), scales, out)
    return out


@kernel
def _turned(turns, scales, out):  # type: ignore[no-untyped-def]
    for n in range(len(turns)):
        rows = rotation_rows(turns[n])
        for k in range(9):
            out[n, k // 3, k % 3] = rows[k] * scales[n, k % 3]
