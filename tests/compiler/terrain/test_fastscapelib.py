"""Stream power beside fastscapelib (GPL-3; imported here and by a benchmark alone)."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.stream_power import StreamPower

fastscapelib = pytest.importorskip("fastscapelib")

SPACING = 50.0
GRID = Grid((80 * SPACING, 60 * SPACING), (61, 81))
K, UPLIFT = 1e-5, 1e-3
#: Not n below 1: fastscapelib's Newton steps then leave residuals of meters, ours of 1e-13.
LAWS = [(0.5, 1.0), (0.4, 1.3), (0.5, 1.5)]


def ours(m: float, n: float, uplift: float, step: float, steps: int) -> StreamPower:
    return StreamPower(
        erodibility=K,
        area_exponent=m,
        slope_exponent=n,
        uplift_m_per_a=uplift,
        duration_a=step * steps,
        steps=steps,
    )


def theirs(
    height: np.ndarray, m: float, n: float, uplift: float, step: float, steps: int
) -> np.ndarray:
    """The same with fastscapelib: fixed borders, one receiver, no sinks to be resolved."""
    grid = fastscapelib.RasterGrid(
        list(height.shape), [SPACING, SPACING], fastscapelib.NodeStatus.FIXED_VALUE
    )
    graph = fastscapelib.FlowGraph(grid, [fastscapelib.SingleFlowRouter()])
    eroder = fastscapelib.SPLEroder(graph, K, m, n, 1e-12)
    height = height.copy()
    for _ in range(steps):
        height[1:-1, 1:-1] += uplift * step
        graph.update_routes(height)
        height = height - eroder.erode(height, graph.accumulate(1.0), step)
    return height


@pytest.fixture(scope="module", params=LAWS, ids=str)
def law(request) -> tuple[float, float, np.ndarray]:
    """An exponent pair and its steady state, which has no sinks: what both route alike."""
    m, n = request.param
    noise = np.random.default_rng(2).normal(size=GRID.shape)
    return m, n, ours(m, n, UPLIFT, 1e7, 60).apply(GRID, noise)[0]


@pytest.mark.parametrize("step", [1e2, 1e4, 1e6])
def test_a_step_is_fastscapelib_s(law, step):
    m, n, start = law
    eroded = ours(m, n, 0.0, step, 1).apply(GRID, start)[0]
    assert np.abs(eroded - start).max() > 0.01
    assert np.allclose(eroded, theirs(start, m, n, 0.0, step, 1), rtol=0, atol=1e-9)


def test_our_steady_state_is_one_of_fastscapelib_s(law):
    m, n, steady = law
    assert np.allclose(theirs(steady, m, n, UPLIFT, 1e4, 10), steady, rtol=1e-9, atol=0)
    # And a steady state of another uplift is none.
    other = theirs(steady, m, n, 1.01 * UPLIFT, 1e6, 10)
    assert np.abs(other - steady).max() > 1e-3 * steady.max()
