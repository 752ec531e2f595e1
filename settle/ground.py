"""The ground under bodies as small height fields, as fine as each body's size asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.mesh.surface import GroundSurface

#: Cells of one height field: MuJoCo keeps 50 contacts of a pair of geometries, so 2 * 5 * 5.
_CELLS = 5
#: The ground is lowered by this part of a body's size, and felt from so far: of bodies that are not
#: yet in it the direction of contact is sound, where between its cells it would be sideways.
SHELL = 0.02


@dataclass(frozen=True)
class GroundTile:
    """A square of ground, in the units and about the origin of its neighborhood.

    Attributes:
        size: Of the bodies it is for: whole part of the binary logarithm of their diameter.
        middle: Where its middle is in plan, and its lowest point in height.
        side: Of the square.
        rise: Of its highest point over its lowest one.
        part: Heights as parts of the rise, float64 [6, 6]: rows from south to north.
    """

    size: int
    middle: tuple[float, float, float]
    side: float
    rise: float
    part: NDArray[np.float64]


def tiles_under(
    surface: GroundSurface,
    center: NDArray[np.float64],
    half: NDArray[np.float64],
    size: NDArray[np.int64],
    cells: int,
    unit: float,
    origin: NDArray[np.float64],
) -> list[GroundTile]:
    """The tiles under squares around bodies; bodies of one size share theirs.

    Args:
        surface: The ground.
        center: Of the squares, [n, 2 or more], units.
        half: Half of their sides, [n], units.
        size: Of the bodies, [n], see ``GroundTile``.
        cells: Across 2**size.
        unit: Meters to a unit.
        origin: In the world, meters, [3].
    """
    wanted: set[tuple[int, int, int]] = set()
    for n, power in enumerate(size.tolist()):
        side = _CELLS * float(1 << power) / cells
        low = np.floor((center[n, :2] - half[n]) / side).astype(int)
        high = np.floor((center[n, :2] + half[n]) / side).astype(int)
        wanted.update(
            (power, a, b) for a in range(low[0], high[0] + 1) for b in range(low[1], high[1] + 1)
        )
    listed = sorted(wanted)
    cell = np.array([float(1 << power) / cells for power, _, _ in listed])
    corner = np.array([[a, b] for _, a, b in listed]) * (_CELLS * cell)[:, None]
    j, i = np.meshgrid(np.arange(_CELLS + 1), np.arange(_CELLS + 1), indexing="ij")
    x = corner[:, 0, None, None] + i * cell[:, None, None]
    y = corner[:, 1, None, None] + j * cell[:, None, None]

    def height(dx: NDArray[np.float64], dy: NDArray[np.float64]) -> NDArray[np.float64]:
        at = [
            (v * unit + origin[axis]).ravel()
            for axis, v in enumerate((x + dx[:, None, None], y + dy[:, None, None]))
        ]
        return ((surface.height_at(*at) - origin[2]) / unit).reshape(x.shape)

    none, step = np.zeros(len(cell)), 0.5 * cell
    gx = (height(step, none) - height(-step, none)) / cell[:, None, None]
    gy = (height(none, step) - height(none, -step)) / cell[:, None, None]
    shell = SHELL * cells * cell[:, None, None]
    z = height(none, none) - shell * np.sqrt(1.0 + gx * gx + gy * gy)
    found = []
    for n, (power, _, _) in enumerate(listed):
        low_z = float(z[n].min())
        rise = max(float(z[n].max()) - low_z, 1e-6)
        side = _CELLS * float(cell[n])
        middle = (float(corner[n, 0]) + 0.5 * side, float(corner[n, 1]) + 0.5 * side, low_z)
        found.append(GroundTile(power, middle, side, rise, (z[n] - low_z) / rise))
    return found
