"""How much ground drains through each place of a relief."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.operators.drainage import SIDES, drain, outlet_samples
from scenec.schemas.kernels import kernel


def upslope_area(height: NDArray[np.float64], dx: float, dy: float) -> NDArray[np.float64]:
    """Area that drains through each sample, its own cell included: float64 [ny, nx], m^2.

    Water leaves over all four borders. On a slope it parts among all lower neighbors, by slope
    times the width of contour (Quinn et al. 1991), which keeps the stripes of single-direction (D8)
    routing away. In a depression it takes the one way of ``drainage.drain`` to the lowest pass:
    there, and along valley floors, flow is one sample wide and has eight directions.

    Args:
        height: Finite, float64 [ny, nx].
        dx, dy: Spacing.
    """
    ways = drain(height, outlet_samples(height.shape, SIDES), dx, dy)
    return _accumulate(height, ways.receiver, ways.order, dx, dy)


@kernel
def _accumulate(
    height: NDArray, receiver: NDArray, order: NDArray, dx: float, dy: float
) -> NDArray:
    ny, nx = height.shape
    n = order.size
    source = height.reshape(-1)
    rank = np.empty(n, np.int32)
    for k in range(n):
        rank[order[k]] = k
    area = np.full(n, dx * dy)
    diagonal = np.sqrt(dx * dx + dy * dy)
    # Contour widths: half the cell's width for straight neighbors, and for diagonal ones what makes
    # sqrt(2) / 4 of a square cell's.
    corner = 0.5 * dx * dy / diagonal
    share = np.empty(9)
    for k in range(n - 1, -1, -1):
        at = order[k]
        if receiver[at] == at:
            continue
        j = at // nx
        i = at - j * nx
        total = 0.0
        m = 0
        for b in range(max(j - 1, 0), min(j + 2, ny)):
            for a in range(max(i - 1, 0), min(i + 2, nx)):
                other = b * nx + a
                share[m] = 0.0
                # Only to what is drained later: so no water goes around in a circle.
                if rank[other] < k and source[other] < source[at]:
                    drop = source[at] - source[other]
                    if b == j:
                        share[m] = 0.5 * dy * (drop / dx)
                    elif a == i:
                        share[m] = 0.5 * dx * (drop / dy)
                    else:
                        share[m] = corner * (drop / diagonal)
                    total += share[m]
                m += 1
        if not (total > 0.0 and total < np.inf):
            area[receiver[at]] += area[at]
            continue
        m = 0
        for b in range(max(j - 1, 0), min(j + 2, ny)):
            for a in range(max(i - 1, 0), min(i + 2, nx)):
                if share[m] > 0.0:
                    area[b * nx + a] += area[at] * (share[m] / total)
                m += 1
    return area.reshape(height.shape)
