"""Depth that the whole numbers of a format do not hold is said, with what would hold it."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.contract import Narrowed
from scenec.datasets.formats.depth_png import fitting_scale, to_16_bits
from scenec.testing.made_frames import make_out

#: Format, options, steps a meter.
FORMATS = [
    ("tum", {}, 5000.0),
    ("tum", {"depth_scale": "20000"}, 20000.0),
    ("bop", {}, 1000.0),
    ("kitti", {"depth": "yes"}, 256.0),
    ("cityscapes", {"depth": "depth"}, 256.0),
    ("parquet", {"depth": "png", "depth_scale": "5000"}, 5000.0),
]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_out(tmp_path_factory.mktemp("out") / "made")


@pytest.mark.parametrize(("name", "options", "scale"), FORMATS)
def test_lost_depth_is_said_with_its_share_and_with_what_holds_it(
    made, tmp_path, name, options, scale
):
    said: list[str] = []
    choice = Choice(options=options)
    report = export(made.out, name, tmp_path / "d", choice, say=said.append)
    depth = np.stack([frame["depth"] for frame in made.passes.values()]).astype(float)
    hits = np.isfinite(depth).sum()
    steps = np.rint(depth[np.isfinite(depth)] * scale)
    lost = ((steps > 65535) | (steps < 1)).sum()
    assert lost
    (line,) = [line for line in said if "16 bits hold" in line]
    assert line.startswith(f"warning: {lost:,} of {hits:,} ({100 * lost / hits:.3g} %) hits")
    assert f"to {65535 / scale:.5g} m" in line
    (told,) = json.loads((tmp_path / "d/export.json").read_bytes())["narrowed"].values()
    assert (told["lost"], told["of"]) == (lost, hits)
    assert told["most"] == pytest.approx(depth[np.isfinite(depth)].max())
    assert line.removeprefix("warning: ") in (tmp_path / "d/README.md").read_text()
    assert sum(one.lost for one in report.narrowed.values()) == lost
    mend = re.search(r"--set (depth_scale)=([0-9.e+-]+)", line)
    if name == "kitti":
        assert mend is None
        assert "one scale" in line
        return
    choice = Choice(options={**options, mend[1]: mend[2]})
    again = export(made.out, name, tmp_path / "e", choice)
    assert max((one.most for one in again.narrowed.values()), default=0.0) == 0.0


def test_disparity_of_what_is_too_near_is_said_with_the_baseline_that_holds_it(made, tmp_path):
    said: list[str] = []
    options = {"depth": "disparity", "baseline_m": "50"}
    export(made.out, "cityscapes", tmp_path / "d", Choice(options=options), say=said.append)
    (line,) = [line for line in said if "no disparity" in line]
    mend = re.search(r"--set (baseline_m)=([0-9.e+-]+)", line)
    choice = Choice(options={**options, mend[1]: mend[2]})
    assert export(made.out, "cityscapes", tmp_path / "e", choice).narrowed == {}


@given(st.floats(1e-3, 1e9))
def test_the_scale_that_fits_holds_the_farthest_and_hardly_more(farthest):
    scale = float(f"{fitting_scale(farthest):g}")
    assert 0.9 * 65535 < scale * farthest <= 65535.5


def test_a_picture_of_nothing_but_sky_loses_nothing():
    (one,) = to_16_bits(np.full((2, 3), np.inf), 256.0).narrowed.values()
    assert one == Narrowed(0, 0, 0.0)
