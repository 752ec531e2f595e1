"""Where instances lie: positions by density, orientations, seating on the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from scenec.compiler.noise.perlin import fbm2_points
from scenec.compiler.scene import Prototype
from scenec.compiler.terrain.grid import HeightField, surface_height
from scenec.schemas.errors import SceneError


@dataclass(frozen=True)
class UniformDensity:
    """The same everywhere."""

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative density at points, float64 [n]."""
        return np.ones(x.shape)


@dataclass(frozen=True)
class NoiseDensity:
    """Clusters: density = max(0, 1 + contrast * fBm)^2.

    Attributes:
        key: Noise key.
        scale_m: Size of the clusters, meters.
        octaves: Of the noise.
        contrast: 0 is uniform; from about 1 on there are empty places.
    """

    key: int
    scale_m: float
    octaves: int
    contrast: float

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative density at points, float64 [n]."""
        noise = fbm2_points(np.uint64(self.key), x, y, self.scale_m, self.octaves, 0.5, 2.0, 0.0)
        density = np.maximum(0.0, 1.0 + self.contrast * noise)
        return density * density


def place(
    field: HeightField, density: UniformDensity | NoiseDensity, u: NDArray[np.float64], name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions with a given density: exactly one for each row of ``u``.

    The density is taken as constant over each grid cell; a cell is picked by inverting the
    cumulative sum over cells, the place in it is uniform. No point is rejected, so the count is
    exact, and raising it leaves the first points where they are.

    Args:
        field: The terrain.
        density: Relative density.
        u: Uniform numbers in [0, 1), float64 [n, 3].
        name: Object class, for the message.

    Returns:
        x and y, float64 [n], meters.

    Raises:
        SceneError: The density is zero everywhere.
    """
    grid = field.grid
    ny, nx = grid.shape[0] - 1, grid.shape[1] - 1
    dx, dy = grid.spacing_m
    x0, y0 = -0.5 * grid.size_m[0], -0.5 * grid.size_m[1]
    cy, cx = np.meshgrid(np.arange(ny) + 0.5, np.arange(nx) + 0.5, indexing="ij")
    cumulative = np.cumsum(density.at(x0 + dx * cx.ravel(), y0 + dy * cy.ravel()))
    total = cumulative[-1]
    if len(u) and not total > 0.0:
        raise SceneError(f"objects/{name}: its density is zero everywhere; lower its contrast")
    cell = np.searchsorted(cumulative, u[:, 0] * total, side="right")
    # u < 1, yet u * total can round up to total itself.
    cell = np.minimum(cell, len(cumulative) - 1)
    return x0 + dx * (cell % nx + u[:, 1]), y0 + dy * (cell // nx + u[:, 2])


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


def seat(
    field: HeightField,
    prototypes: tuple[Prototype, ...],
    prototype: NDArray[np.int32],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    orientations: NDArray[np.float16],
    size_m: NDArray[np.float64],
    embed: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Heights at which instances sit in the ground by a given part of their own height.

    Every vertex of the turned and scaled rock is held against the surface below it; the rock is let
    down until the deepest of them is ``embed`` times the rock's height under the ground.

    Returns:
        z of each instance's origin, float64 [n].
    """
    offsets = np.cumsum([0] + [len(p.points) for p in prototypes])
    points = np.concatenate([p.points for p in prototypes]).astype(np.float64)
    return _seat(
        field.height,
        *field.frame(),
        points,
        offsets,
        prototype,
        x,
        y,
        orientations.astype(np.float64),
        size_m,
        embed,
    )


@njit(cache=True, error_model="numpy")
def rotation_rows(q: NDArray) -> tuple[float, ...]:
    """The nine entries, row by row, of the rotation of a quaternion (x, y, z, w) of any length."""
    x, y, z, w = q
    s = 2.0 / (x * x + y * y + z * z + w * w)
    return (
        1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w),
        s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w),
        s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y),
    )  # fmt: skip


@njit(cache=True, error_model="numpy", parallel=True)
def _seat(
    height: NDArray,
    x0: float,
    y0: float,
    dx: float,
    dy: float,
    points: NDArray,
    offsets: NDArray,
    prototype: NDArray,
    x: NDArray,
    y: NDArray,
    orientations: NDArray,
    size: NDArray,
    embed: NDArray,
) -> NDArray:
    out = np.empty(x.size)
    for n in prange(x.size):
        r = rotation_rows(orientations[n])
        low = np.inf
        high = -np.inf
        clearance = np.inf
        for p in range(offsets[prototype[n]], offsets[prototype[n] + 1]):
            a, b, c = points[p]
            px = x[n] + size[n] * (r[0] * a + r[1] * b + r[2] * c)
            py = y[n] + size[n] * (r[3] * a + r[4] * b + r[5] * c)
            pz = size[n] * (r[6] * a + r[7] * b + r[8] * c)
            low = min(low, pz)
            high = max(high, pz)
            clearance = min(clearance, pz - surface_height(height, x0, y0, dx, dy, px, py))
        out[n] = -clearance - embed[n] * (high - low)
    return out
