"""Faults in the keys of scattered objects: each is told where it stands, with what was expected."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from PIL import Image

from scenec.compiler.cfg.load import load
from scenec.schemas.errors import CfgError
from scenec.testing.small import small_cfg, write_cfg

CLUSTERS = {"type": "clusters", "sigma_m": 1}


def load_with(folder, **change: Any) -> None:
    cfg = small_cfg()
    rocks = cfg["objects"]["rocks"] | change
    cfg["objects"]["rocks"] = {key: value for key, value in rocks.items() if value is not None}
    cfg["objects"]["pebbles"] = cfg["objects"]["rocks"] | {
        "count": 1,
        "density": {"type": "uniform"},
    }
    for key in ("where", "apart", "per_m2", "lean_deg"):
        cfg["objects"]["pebbles"].pop(key, None)
    load(write_cfg(folder, cfg))


@pytest.mark.parametrize(
    ("change", "pointer", "words"),
    [
        ({"apart": {"gap": 1}}, "/apart/gap", 'did you mean "gap_m"'),
        ({"per_m2": 1}, "/per_m2", "both say how many"),
        ({"density": {"type": "around", "of": "rocks"}}, "/density/of", "this class itself"),
        ({"density": CLUSTERS}, "/density", "either the key parents or"),
        (
            {"density": CLUSTERS | {"parents": 3, "parents_per_m2": 1}},
            "/density/parents_per_m2",
            "take one away",
        ),
        ({"density": {"type": "image", "file": "black.png"}}, "/density/file", "black everywhere"),
        ({"density": {"type": "wurley"}}, "/density/type", 'did you mean "worley"'),
        ({"where": [{"type": "camera", "min_m": 3, "max_m": 1}]}, "/where/0/min_m", "above max_m"),
        (
            {"where": [{"type": "material", "material": "mud", "layer": 1}]},
            "/where/0/layer",
            "expected 2",
        ),
        ({"clearance_m": -1e7}, "/clearance_m", "at least -1000000 m"),
    ],
)
def test_a_fault_is_told_where_it_stands(tmp_path, change, pointer, words):
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "black.png")
    with pytest.raises(CfgError) as caught:
        load_with(tmp_path, **change)
    faults = {fault.pointer: fault.message for fault in caught.value.faults}
    assert words in faults["/objects/rocks" + pointer]


def test_a_count_is_needed_unless_the_sizes_say_it(tmp_path):
    for size in (0.3, {"type": "golombek_rapp", "k": 0.1, "min": 0.1, "max": 1, "per": "batch"}):
        with pytest.raises(CfgError, match="expected either the key count or the key per_m2"):
            load_with(tmp_path, count=None, size_m=size)


def test_what_goes_together_is_taken(tmp_path):
    sizes = {"type": "golombek_rapp", "k": 0.1, "min": 0.1, "max": 1}
    load_with(
        tmp_path,
        size_m=sizes,
        orientation="normal",
        lean_deg={"type": "uniform", "min": 0, "max": 20},
        apart={"of": ["rocks"], "gap_m": {"type": "uniform", "min": 0, "max": 0.1}},
        where=[
            {"type": "slope", "max_deg": 20, "softness_deg": 2},
            {"type": "material", "material": "gravel"},
            {"type": "camera", "min_m": 1, "ragged": {"amplitude": 0.5, "scale_m": 2}},
        ],
        density=CLUSTERS | {"parents": 5, "background": 0.2},
        shortfall="fewer",
        clearance_m=0,
    )
