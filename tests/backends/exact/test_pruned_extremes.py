"""Pruning at its limits: whatever the view, the ground, the light, annotation stays to the bit."""

from __future__ import annotations

import json
from importlib.util import find_spec

import numpy as np
import pytest

from scenec.compiler.views.needed import Keep
from scenec.testing.pruned_extremes import CASES, pruned_cfg
from scenec.testing.pruned_scenes import annotation, compiled, difference

#: Those where a view, the ground or lengths are at an end: light hardly matters.
HARDEST = ("all_round", "far_above", "low", "narrow", "steep", "wide", "wide_land")


def _both(folder, cfg):
    """Folders of the batch, pruned and whole, and how many instances are left out of it."""
    pruned, whole = (compiled(folder, cfg, keep) for keep in (Keep.SEEN, Keep.UNPRUNED))
    facts = json.loads((pruned / "report.json").read_text(encoding="utf-8"))["prune"]
    counts = facts["objects"]["rocks"]
    kept = sum(counts.get(name, 0) for name in ("seen", "shadow", "light"))
    return pruned, whole, sum(counts.values()) - kept, facts


def _assert_same(pruned, whole):
    for (name, one), (other_name, other) in zip(annotation(pruned), annotation(whole), strict=True):
        assert name == other_name
        for key, values in other.items():
            same = np.array_equal(one[key], values, equal_nan=values.dtype.kind == "f")
            assert same, f"{name}: {key} differs"


@pytest.mark.parametrize("name", HARDEST)
def test_few_rocks_are_annotated_alike(name, tmp_path):
    cfg = pruned_cfg(CASES[name], ("label", "instance"))
    cfg["objects"]["rocks"]["count"] = 300
    cfg["terrain"]["mesh"]["tolerance_px"] = 4
    pruned, whole, gone, _ = _both(tmp_path, cfg)
    assert gone > 0
    _assert_same(pruned, whole)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_annotation_holds_with_color(name, tmp_path):
    pruned, whole, gone, facts = _both(tmp_path, pruned_cfg(CASES[name]))
    _assert_same(pruned, whole)
    assert facts["light"]["everywhere"] == (name == "mirror")
    if facts["light"]["everywhere"]:
        assert gone == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["usual", "sun_8", "sun_1", "no_sky", "snow", "haze", "night"])
def test_light_differs_by_less_than_a_thousandth_and_the_noise(name, tmp_path):
    # Not imported here: Dr.Jit looks for its LLVM once, at its first import.
    if find_spec("mitsuba") is None:
        pytest.skip("mitsuba is not installed")
    pruned, whole, gone, _ = _both(tmp_path, pruned_cfg(CASES[name]))
    assert gone > 0
    found = difference(pruned, whole, spp=16)
    assert found.blocks > 0
    assert found.paired <= min(1e-3, found.noise)
