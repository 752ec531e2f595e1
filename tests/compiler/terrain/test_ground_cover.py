"""Conditions on the ground's layers, out of a cfg: what is drawn, compiled, reported, refused."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from elsewhere import printed_elsewhere

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.kinds.table import CHOICES, kind_of
from scenec.compiler.mesh.cover import fit_merges
from scenec.compiler.terrain.condition import Interval, Slope
from scenec.compiler.terrain.freshness import Freshness
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.program import run
from scenec.schemas.errors import CfgError, SceneError
from scenec.testing.small import small_cfg, write_cfg

_EDGE = {"amplitude": 0.2, "scale_m": 2}
WHERE = [
    {"type": "height", "min_m": -3, "softness_m": 0.2},
    {"type": "slope", "max_deg": 40, "softness_deg": 5, "ragged": {**_EDGE, "octaves": 2}},
    {"type": "curvature", "max_per_m": 9, "softness_per_m": 0.3},
    {"type": "flow", "max_m2": 9000, "over_m": 0.5},
    {"type": "crater_freshness", "min": {"type": "uniform", "min": 0.1, "max": 0.2}},
    {"type": "noise", "scale_m": 6, "min": -0.4},
    {"type": "point", "x_m": 1, "y_m": 0, "max_m": 12},
    {"type": "path", "file": "path.csv", "max_m": 5, "ragged": _EDGE},
]


def write(folder: Path, *layers: dict, relief: list[dict] | None = None) -> Path:
    """The small cfg with conditions added to its layers."""
    cfg = small_cfg()
    (folder / "path.csv").write_text("x_m,y_m\n-9,-6\n0,2\n9,5\n")
    cfg["terrain"]["relief"] += relief or [
        {"type": "craters", "min_diameter_m": 1, "max_diameter_m": 6}
    ]
    for node, change in zip(cfg["terrain"]["ground"][1:], layers, strict=False):
        for key, value in change.items():
            if value is None:
                node.pop(key)
            else:
                node[key] = value
    return write_cfg(folder, cfg)


def laid(path: Path, seed: int = 5):
    plan = draw(load(path), seed, 0).terrain
    field = run(plan.relief, Grid.with_spacing(plan.size_m, plan.spacing_m)).field
    return fit_merges(plan.merges, plan.coverage, field)[0], field


def test_a_layer_with_conditions_and_no_noise_lies_wherever_they_hold(tmp_path):
    slope = {"type": "slope", "min_deg": 10}
    (bare, _), field = laid(write(tmp_path, {"noise": None, "where": [slope]}))
    assert not bare.noisy
    x, y = field.grid.points()
    condition = Interval(Slope(over_m=None), 10.0, None, 0.0)
    value = condition.value_at(bare.limits[0].quantities, x, y)
    assert np.array_equal(bare.side(x, y) >= 0.0, value >= 10.0)
    # With a noise it lies where that is, too: less, and not elsewhere.
    (both, _), _ = laid(write(tmp_path, {"where": [slope]}))
    assert both.noisy
    inside = both.side(x, y) >= 0.0
    assert np.array_equal(inside, (value >= 10.0) & (both.noise(x, y) >= both.center))
    assert 0 < inside.sum() < (value >= 10.0).sum()


def test_the_default_smoothing_on_the_ground_is_two_spacings_and_reported(tmp_path):
    path = write(tmp_path, {"noise": None, "where": [{"type": "slope", "min_deg": 10}]})
    log = BuildLog()
    build(draw(load(path), 5, 0), log)
    first, second = log.facts["cover"]
    assert first["conditions"][0]["smoothed_over_m"] == pytest.approx(0.4)
    assert second["conditions"] == []
    assert second["covers"] == pytest.approx(0.3, abs=1e-3)
    assert first["shows"] < first["covers"]
    json.dumps(log.facts["cover"], allow_nan=False)


def test_freshness_is_of_all_craters_of_the_relief_and_of_their_masks(tmp_path):
    pits = {"type": "craters", "min_diameter_m": 2, "max_diameter_m": 6}
    east = {"type": "point", "x_m": 10, "y_m": 0, "max_m": 10}
    path = write(
        tmp_path,
        {"where": [{"type": "crater_freshness", "min": 0.5}]},
        relief=[pits, {"type": "smooth", "length_m": 0.2}, {**pits, "mask": [east]}],
    )
    (condition,) = draw(load(path), 5, 0).terrain.merges[0].where
    assert isinstance(condition.quantity, Freshness)
    assert [len(mask) for _, mask in condition.quantity.craters] == [0, 1]


@pytest.mark.parametrize("kind", [node["type"] for node in WHERE])
def test_every_condition_compiles_on_the_ground(tmp_path, kind):
    node = next(node for node in WHERE if node["type"] == kind)
    scene = build(draw(load(write(tmp_path, {"where": [node]})), 5, 0), BuildLog())
    layers = np.concatenate([tile.layer for tile in scene.ground.tiles])
    assert {0, 1, 2} >= set(layers.tolist()) > {0}


def test_a_coverage_that_cannot_be_reached_is_told(tmp_path):
    where = [{"type": "height", "min_m": 1e6}]
    path = write(tmp_path, {"where": where, "coverage": 0.2})
    with pytest.raises(SceneError, match=r"terrain/ground/1/coverage: 0\.2 .* hold on 0 of it"):
        build(draw(load(path), 5, 0), BuildLog())


@pytest.mark.parametrize(
    ("layer", "pointer", "words"),
    [
        ({"where": [{"type": "height", "min_m": 3, "max_m": 1}]}, "where/0/min_m", "below"),
        ({"where": [{"type": "flow", "max_m2": -1}]}, "where/0/max_m2", "more than 0"),
    ],
)
def test_faults_in_conditions_are_found_in_the_cfg(tmp_path, layer, pointer, words):
    with pytest.raises(CfgError) as caught:
        load(write(tmp_path, layer))
    (fault,) = caught.value.faults
    assert fault.pointer == f"/terrain/ground/1/{pointer}"
    assert words in fault.message


@pytest.mark.parametrize("name", CHOICES["ground_where"].kinds)
def test_every_condition_has_to_have_bounds(tmp_path, name):
    example = kind_of("ground_where", name).EXAMPLE
    where = [{key: v for key, v in example.items() if not key.startswith(("min", "max"))}]
    with pytest.raises(CfgError, match="no bounds: expected a smallest value"):
        load(write(tmp_path, {"where": where}))


def test_freshness_without_craters_is_a_fault(tmp_path):
    where = [{"type": "crater_freshness", "min": 0.5}]
    path = write(tmp_path, {"where": where}, relief=[{"type": "smooth", "length_m": 0.1}])
    with pytest.raises(CfgError, match="no craters in the relief"):
        load(path)


_SIDES = """
import sys
from test_ground_cover import digests
print(digests(sys.argv[1]))
"""


def digests(path: str) -> list[str]:
    """Of every layer's side at the samples and at points between them."""
    merges, field = laid(Path(path))
    x, y = field.grid.points()
    between = 0.97 * x + 0.03 * y, 0.95 * y - 0.02 * x
    return [
        hashlib.sha256(merge.side(*at).tobytes()).hexdigest()
        for merge in merges
        for at in ((x, y), between)
    ]


@pytest.mark.invariant
@pytest.mark.slow
def test_conditions_give_the_same_bytes_in_all_circumstances_at_once(tmp_path):
    path = write(tmp_path, {"where": WHERE}, {"where": WHERE[1:4]})
    assert printed_elsewhere(_SIDES, path).strip() == str(digests(str(path)))
