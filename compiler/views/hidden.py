"""Which parts of the terrain hide behind others from an eye: a coarse test that errs one way."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.terrain.grid import HeightField
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

# Blocks have at least so many cells along a side, and more where the work, which grows as the eyes
# times the blocks to the power 3/2, would take more than a second.
_CELLS = 4
_STEPS = 4e8


@memoized("views")
def hidden_blocks(
    field: HeightField, eyes: NDArray[np.float64], margin_m: float = 0.0
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Blocks of cells that no ray from an eye reaches, because terrain stands before them.

    A block counts as hidden only if rays to its highest sample pass below the lowest sample of some
    three by three blocks on their way: wherever in the block they end, and wherever between its
    samples they pass. So none that can be seen is lost; many that cannot are not found.

    Args:
        field: The terrain.
        eyes: Positions, float64 [c, 3].
        margin_m: How far the ground may lie above or below the terrain.

    Returns:
        bool [c, by, bx], and x and y of the first block's corner and a block's width in both.
    """
    ny, nx = field.grid.shape
    cells = _CELLS
    while True:
        blocks = -(-(nx - 1) // cells) * -(-(ny - 1) // cells)
        if blocks == 1 or len(eyes) * blocks * math.sqrt(blocks) <= _STEPS:
            break
        cells *= 2
    low, high = _extremes(field.height, cells)
    x0, y0, dx, dy = field.frame()
    frame = np.array([x0, y0, cells * dx, cells * dy])
    hidden = np.zeros((len(eyes), *low.shape), np.bool_)
    over_threads(
        _find,
        len(eyes) * low.shape[0],
        _lowest_around(low) - margin_m,
        high + margin_m,
        frame,
        eyes,
        hidden,
    )
    return hidden, frame


@kernel
def _extremes_part(first, last, height, cells, low, high):  # type: ignore[no-untyped-def]
    ny, nx = height.shape
    for j in range(first, last):
        for row in range(j * cells, min((j + 1) * cells + 1, ny)):
            for i in range(low.shape[1]):
                for column in range(i * cells, min((i + 1) * cells + 1, nx)):
                    low[j, i] = min(low[j, i], height[row, column])
                    high[j, i] = max(high[j, i], height[row, column])


def _extremes(height, cells):  # type: ignore[no-untyped-def]
    """Lowest and highest sample of each block, those on its border included."""
    ny, nx = height.shape
    low = np.full((-(-(ny - 1) // cells), -(-(nx - 1) // cells)), np.inf)
    high = np.full(low.shape, -np.inf)
    over_threads(_extremes_part, low.shape[0], height, cells, low, high)
    return low, high


def _lowest_around(low: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lowest of three by three blocks; beyond the terrain there is nothing to hide behind."""
    wide = np.full((low.shape[0] + 2, low.shape[1] + 2), -np.inf)
    wide[1:-1, 1:-1] = low
    rows, columns = low.shape
    return np.minimum.reduce(
        [wide[j : j + rows, i : i + columns] for j in range(3) for i in range(3)]
    )


@kernel
def _find(first, last, low, high, blocks, eyes, hidden):  # type: ignore[no-untyped-def]
    rows, columns = low.shape
    wide, tall = blocks[2], blocks[3]
    # Half of a block's diagonal, and the length of a step: no block is stepped over.
    reach = 0.5 * np.sqrt(wide * wide + tall * tall)
    step = min(wide, tall)
    for n in range(first, last):
        c = n // rows
        j = n % rows
        ex, ey, ez = eyes[c]
        for i in range(columns):
            tx = blocks[0] + (i + 0.5) * wide - ex
            ty = blocks[1] + (j + 0.5) * tall - ey
            distance = np.sqrt(tx * tx + ty * ty)
            rise = high[j, i] - ez
            # The end that makes the ray highest on its way: near if it rises, far if it falls.
            run = distance - reach if rise > 0.0 else distance + reach
            away = step
            while away < distance - 2.0 * reach:
                bi = int(np.floor((ex + tx * away / distance - blocks[0]) / wide))
                bj = int(np.floor((ey + ty * away / distance - blocks[1]) / tall))
                inside = 0 <= bi < columns and 0 <= bj < rows
                if inside and low[bj, bi] > ez + rise * away / run:
                    hidden[c, j, i] = True
                    break
                away += step
