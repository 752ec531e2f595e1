"""Coatings of rocks: where they lie, and what of them arrives in a renderer's scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenec.backends.stage.read import read_stage
from scenec.compiler.cfg.fill import fill
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.objects.coatings import CoatingPlan, coat
from scenec.compiler.objects.rocks import Chain, build_chains
from scenec.compiler.scene.objects import Prototype
from scenec.schemas.errors import CfgError
from scenec.testing.small import small_cfg, write_cfg

NOTHING = CoatingPlan(
    material="dust", tops=0.0, max_slope_deg=35.0, hollows=0.0, foot=0.0, foot_height=0.15, key=7
)


@pytest.fixture(scope="module")
def stones() -> tuple[Chain, ...]:
    cfg = small_cfg()
    cfg["objects"]["rocks"] |= {"family": "vesicular", "prototypes": 3, "subdivisions": 5}
    rocks = fill(cfg)["objects"]["rocks"]
    plan = draw_kind("objects", rocks, "objects/rocks", Context(Streams(1, 0)))
    return build_chains(plan.source.shapes)


def coated(stones: tuple[Chain, ...], embed: float = 0.2, **change: float) -> list[Prototype]:
    """The finest levels, with one coating."""
    return [chain[0] for chain in coat(stones, [replace(NOTHING, **change)], embed)]


def test_what_covers_nothing_has_no_share(stones):
    for mesh in coated(stones):
        assert not mesh.coatings[0].weights.any()


def test_tops_are_covered_as_asked_and_what_is_steep_or_faces_down_is_bare(stones):
    for mesh in coated(stones, tops=0.7, max_slope_deg=40.0):
        weight, up = mesh.coatings[0].weights, mesh.normals[:, 2]
        assert 0.35 < weight[up > 0.95].mean() <= 0.7
        assert weight.max() <= np.float32(0.7)
        # Borders are ragged, but not so far.
        assert not weight[up < 0.2].any()


def test_hollows_hold_more_than_what_stands_out(stones):
    for mesh in coated(stones, hollows=1.0):
        weight, up = mesh.coatings[0].weights, mesh.normals[:, 2]
        # Insides of bubbles are what is dark of these rocks.
        inside = mesh.variation < -0.4
        assert weight[inside & (up > 0.0)].mean() > 4.0 * weight[~inside].mean()
        assert not weight[up < -0.6].any()


def test_a_foot_ends_above_the_ground_that_embed_puts_there(stones):
    for mesh in coated(stones, embed=0.3, foot=1.0, foot_height=0.1):
        weight, height = mesh.coatings[0].weights, mesh.points[:, 2]
        part = (height - height.min()) / np.ptp(height)
        assert weight[(part > 0.25) & (part < 0.3)].mean() > 0.8
        assert weight[part > 0.5].mean() < 0.01


def test_all_levels_have_it_and_keep_their_shape(stones):
    for before, after in zip(stones, coat(stones, [NOTHING], 0.2), strict=True):
        for bare, mesh in zip(before, after, strict=True):
            assert len(mesh.coatings[0].weights) == len(mesh.points)
            assert mesh.points is bare.points
            assert mesh.error == bare.error


def dusty_cfg(**change: object) -> dict:
    cfg = small_cfg()
    cfg["materials"]["dust"] = {"base_color": [0.5, 0.3, 0.2]}
    cfg["objects"]["rocks"] |= {
        "count": 12, "prototypes": 1, "lod_px": 0, "orientation": "normal",
        "coatings": [{"material": "dust"}, {"material": "mud", "tops": 0, "hollows": 0}],
    } | change  # fmt: skip
    return cfg


def test_renderers_read_rocks_as_merges_of_their_coatings(tmp_path):
    out = compile_cfg(write_cfg(tmp_path, dusty_cfg()), seed=1, out=tmp_path / "out").out
    scene = read_stage(out / "batch_0000" / "stage.usda")
    (mesh,) = [one for one in scene.meshes if "/Objects/rocks/" in one.path]
    colors = [scene.surfaces[layer].base_color for layer in mesh.layers]
    assert colors == [pytest.approx(c) for c in ([0.15, 0.12, 0.1], [0.5, 0.3, 0.2],
                                                 [0.3, 0.25, 0.2])]  # fmt: skip
    assert mesh.weights.shape == (2, len(mesh.points))
    assert mesh.weights.max(axis=1).min() > 0.9
    assert mesh.weights.min() >= 0.0


@pytest.mark.parametrize(("change", "message"), [
({"orientation": "random"}, "has no top that a coating could lie on"),
({"coatings": [{"material": "dusk"}]}, 'no material "dusk".*did you mean "dust"'),
])  # fmt: skip
def test_coatings_that_cannot_be_are_refused(tmp_path, change, message):
    with pytest.raises(CfgError, match=message):
        load(write_cfg(tmp_path, dusty_cfg(**change)))
