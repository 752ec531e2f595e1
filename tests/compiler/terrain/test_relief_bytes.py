"""Every relief operator gives the same bytes on every CPU and with any number of threads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from elsewhere import printed_elsewhere, printed_here
from test_relief_masks import MASK, PROGRAM, write_program

_HEIGHTS = """
import hashlib, sys
import numpy as np
from scenec.compiler.kinds.table import name_of
from scenec.compiler.draw import draw
from scenec.compiler.cfg.load import load
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.mask import unmasked
plan = draw(load(sys.argv[1]), 11, 0).terrain
grid = Grid.with_spacing(plan.size_m, plan.spacing_m)
height = np.zeros(grid.shape)
for operator in plan.relief:
    height, report = operator.apply(grid, height)
    content = height.tobytes() + repr(report).encode()
    print(name_of("relief", type(unmasked(operator))), hashlib.sha256(content).hexdigest())
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Path:
    """Every operator, and every condition behind one."""
    masked = [{**node, "mask": MASK} for node in PROGRAM[:2]]
    powers = {
        "type": "stream_power", "erodibility": 1e-5, "slope_exponent": 1.4, "area_exponent": 0.6,
        "duration_a": 1e4, "uplift_m_per_a": 1e-5, "steps": 2,
    }  # fmt: skip
    folder = tmp_path_factory.mktemp("bytes")
    np.save(folder / "dem.npy", np.random.default_rng(3).normal(size=(64, 64)).cumsum(axis=0))
    dem = {"type": "dem", "file": "dem.npy", "pixel_m": 0.4, "height_scale": 0.01}
    finer = {"type": "downscale", "slope": 3.1}
    return write_program(folder, [*PROGRAM, powers, *masked, dem, finer])


@pytest.mark.invariant
@pytest.mark.slow
def test_every_operator_gives_the_same_bytes_in_all_circumstances_at_once(program):
    # Hash of heights and report after each operator.
    reference = printed_here(_HEIGHTS, program)
    assert len(reference.splitlines()) == len(PROGRAM) + 6
    assert printed_elsewhere(_HEIGHTS, program) == reference
