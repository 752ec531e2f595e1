"""Maps of bare ground: below zero, on a sphere, in a strip, from a DEM that is upside down."""

from __future__ import annotations

import pytest

from scenec.lab.robustness.extreme_maps import cases

#: Errors over the promised scale; a chord of 4 m x 4 m lies 2 mm below a sphere of 2 km.
MOST = {"map: on a sphere of 2 km": 2e-4}


@pytest.mark.parametrize("case", cases(), ids=lambda case: case[0])
def test_heights_of_a_map_are_those_of_its_closed_form(case, tmp_path):
    name, work, _ = case
    if "DEM" in name:
        pytest.importorskip("rasterio")
    said, error = work(tmp_path)
    assert error <= MOST.get(name, 1e-7), said
