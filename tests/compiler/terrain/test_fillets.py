"""Fines about the feet of stones: heights, where they meet stones, what stands on them."""

from __future__ import annotations

import hashlib
import json
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
import test_adaptive
import trimesh
from elsewhere import digest_elsewhere
from hypothesis import given
from hypothesis import strategies as st
from laying import SIZE, plan

from scenec.backends.run.render import render
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.geometry.rotations import turned
from scenec.compiler.mesh.mesh import Meshing
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.objects.build import Placing, shape_objects
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.terrain.fillets import SIDES, Feet, Fillets, directions
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.views.needed import Keep, Needs
from scenec.compiler.views.resolution import pixels_of_balls, pixels_per_meter, views_of
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.tessellation import tessellation
from scenec.schemas.frames import read_frame
from scenec.testing.examples import examples
from scenec.testing.overhangs import shelter, write
from scenec.testing.small import small_cfg, write_cfg

RNG = np.random.default_rng


def feet(rng, n: int, spread: float = 3.0) -> Feet:
    return Feet(
        *rng.uniform(-spread, spread, (2, n)),
        rng.uniform(0.01, 0.2, n),
        rng.uniform(0.02, 1.0, n),
        rng.uniform(0.0, 0.6, (n, SIDES)),
        rng.uniform(0.3, 1.7, (n, SIDES)),
    )


def round_foot(x: float, y: float, radius: float, height: float, reach: float) -> Feet:
    one = np.ones(1)
    table = np.ones((1, SIDES))
    return Feet(x * one, y * one, height * one, reach * one, radius * table, table)


def ground(amplitude_m: float = 0.0, size=SIZE, spacing: float = 0.4) -> GroundSurface:
    grid = Grid.with_spacing(size, spacing)
    height = np.zeros(grid.shape)
    if amplitude_m:
        height = Multifractal(
            key=1, amplitude_m=amplitude_m, scale_m=8.0, octaves=5, variant="fbm"
        ).apply(grid, height)[0]
    return GroundSurface(HeightField(grid, height))


def among(
    surface: GroundSurface, eye=(0.0, -15.0), tolerance_px: float | None = 0.2
) -> PlacementContext:
    views = views_of((test_adaptive.one_rig(surface.field, eye),))
    return PlacementContext(surface, np.zeros((0, 3)), views, 0.125, tolerance_px)


def built(around: PlacementContext, *plans):
    placing = Placing(around, np.zeros(1), lambda _: nullcontext())
    placing.place(plans, shape_objects(plans, {}, Needs(False, False, False), placing.timed)[0])
    objects, facts = placing.choose(None)
    return SimpleNamespace(objects=objects, surface=around.surface, facts=facts)


STONES = {
    "name": "stones", "count": 40, "size_m": 0.8, "orientation": "normal", "apart": {},
    "embed": 0.3, "fillet": {"height": 0.08, "reach": 0.4},
}  # fmt: skip


def test_about_a_round_outline_heights_are_those_of_the_formula():
    radius, height, reach = 0.5, 0.08, 0.3
    heaped = Fillets.of(round_foot(1.0, -2.0, radius, height, reach))
    turn = RNG(1).uniform(0.0, 2.0 * np.pi, 500)
    r = np.linspace(0.0, 1.2, 500)
    at = heaped.at(1.0 + r * np.cos(turn), -2.0 + r * np.sin(turn))
    outside = r >= radius
    t = np.clip((r - radius) / reach, 0.0, 1.0)
    np.testing.assert_allclose(at[outside], (height * (1.0 - t) ** 2)[outside], atol=1e-15)
    # Inside: no lower, up to half again as high, and no step or edge where it begins.
    assert (at[~outside] >= height).all()
    assert at[0] == at.max() == 1.5 * height
    d = 1e-6
    below, here, above = heaped.at(1.0 + radius + np.array([-d, 0.0, d]), np.full(3, -2.0))
    assert (here - above) / d == pytest.approx(2.0 * height / reach, rel=1e-4)
    assert (below - here) / d == pytest.approx(2.0 * height / reach, rel=1e-4)


@examples(25)
@given(seed=st.integers(0, 10**6), n=st.sampled_from([1, 2, 60]))
def test_where_ramps_overlap_the_highest_counts_and_bins_find_it(seed, n):
    rng = RNG(seed)
    all_feet = feet(rng, n)
    x, y = rng.uniform(-5.0, 5.0, (2, 400))
    alone = [Fillets.of(Feet._make(each[k : k + 1] for each in all_feet)) for k in range(n)]
    heaped = Fillets.of(all_feet)
    found = heaped.at(x, y)
    assert np.array_equal(found, np.max([one.at(x, y) for one in alone], axis=0))
    # A disk that holds a point on a ramp knows of one; none but coarse ones count as coarse.
    shift = rng.uniform(-0.5, 0.5, (2, 400))
    radius = np.hypot(*shift) * (1.0 + 1e-9)
    amplitude = heaped.finer_at(x + shift[0], y + shift[1], radius, np.full(400, np.inf))
    assert (amplitude[found > 0.0] > 0.0).all()
    assert not heaped.finer_at(x, y, radius, np.full(400, 2.0 * all_feet.reach.min())).any()


@examples(25)
@given(seed=st.integers(0, 10**6), most=st.sampled_from([0.9, 1.7]))
def test_no_ramp_is_higher_than_its_spectrum(seed, most):
    rng = RNG(seed)
    all_feet = feet(rng, 30)
    all_feet = all_feet._replace(share=rng.uniform(0.3, most, (30, SIDES)))
    heaped = Fillets.of(all_feet)
    x, y = rng.uniform(-4.0, 4.0, (2, 400))
    x[:30], y[:30] = all_feet.x, all_feet.y
    found, shape = heaped.at(x, y), x.shape
    assert found.max() <= heaped.spectrum().amplitude_m[0]
    # What the height at the outline is not.
    assert (found > heaped.finer_at(x, y, np.zeros(shape), np.full(shape, np.inf))).any()


def test_the_ground_meets_stones_in_their_outlines():
    surface = ground()
    one = built(among(surface), plan(**STONES))
    (stones,), (heaped,) = one.objects, one.surface.details
    assert one.facts["objects"]["stones"]["fillets"] == len(heaped.feet.x) == stones.count
    turns = turned(stones.orientations, stones.scales)
    for n in range(stones.count):
        mesh = stones.prototypes[stones.prototype[n]]
        points = mesh.points @ turns[n].T + stones.positions[n]
        lift = heaped.feet.height[n]
        middle = np.array([heaped.feet.x[n], heaped.feet.y[n]])
        around = middle + heaped.feet.outline[n][:, None] * directions()
        at = np.column_stack([around, np.full(SIDES, lift)])
        corners = np.repeat(points[mesh.faces][None], SIDES, axis=0).reshape(-1, 3, 3)
        near = trimesh.triangles.closest_point(corners, np.repeat(at, len(mesh.faces), axis=0))
        off = np.linalg.norm(near.reshape(SIDES, -1, 3) - at[:, None], axis=2).min(axis=1)
        assert off.max() < 1e-5
        # The ramp hides a third of what stands out at most, and stands where it does.
        assert 0.0 < lift <= 0.3 * points[:, 2].max() * (1.0 + 1e-5)
        assert heaped.feet.reach[n] == pytest.approx(lift * 0.4 / 0.08)


def test_stones_do_not_move_and_what_comes_later_stands_on_the_ramps():
    bare = {key: value for key, value in STONES.items() if key != "fillet"}
    pebbles = {"name": "pebbles", "count": 4000, "size_m": 0.05, "orientation": "normal"}
    pebbles |= {"density": {"type": "around", "of": "stones", "reach": 1.0}}
    bare, heaped = (
        built(among(ground(1.0)), plan(**stones), plan(**pebbles)) for stones in (bare, STONES)
    )
    assert not bare.surface.details
    stones, later = ([a, b] for a, b in zip(bare.objects, heaped.objects, strict=True))
    assert np.array_equal(stones[0].positions, stones[1].positions)
    x, y = np.ascontiguousarray(later[0].positions[:, :2].T, np.float64)
    assert np.array_equal(later[0].positions[:, :2], later[1].positions[:, :2])
    rise = later[1].positions[:, 2] - later[0].positions[:, 2]
    ramp = heaped.surface.details[0].at(x, y)
    assert (ramp > 0.02).sum() > 100
    # They sit on their deepest points, not on their middles.
    assert np.abs(rise - ramp).max() < 0.03
    assert np.abs(rise[ramp == 0.0]).max() < 0.03
    assert np.abs(rise - ramp).mean() < 0.002


@pytest.mark.parametrize("embed", [0.0, 1.0])
def test_stones_on_the_ground_have_ramps_and_buried_ones_none(embed):
    one = built(among(ground()), plan(**{**STONES, "embed": embed}))
    assert one.facts["objects"]["stones"]["fillets"] == (STONES["count"] if embed == 0.0 else 0)
    assert len(one.surface.details) == (embed == 0.0)


def test_what_is_too_small_to_see_or_on_a_grid_has_none():
    for change, tolerance in (({"size_m": 0.01}, 0.5), ({}, None), ({"count": 0}, 0.5)):
        assert not built(
            among(ground(), tolerance_px=tolerance), plan(**STONES | change)
        ).surface.details
    nobody = PlacementContext(ground(), np.zeros((0, 3)), tolerance_px=0.5)
    assert not built(nobody, plan(**STONES)).surface.details


def test_a_hundred_thousand_at_the_border_and_over_each_other_are_finite():
    small = ground(0.2, (3.0, 2.0), 0.1)
    crowd = plan(
        name="crowd", count=100_000, size_m={"type": "log_uniform", "min": 1e-3, "max": 3.0},
        fillet={"height": {"type": "uniform", "min": 0.0, "max": 1.0}, "reach": 10.0},
        clearance_m=-1e6, orientation="normal",
    )  # fmt: skip
    one = built(among(small, (0.3, -0.5)), crowd)
    (heaped,) = one.surface.details
    x, y = RNG(3).uniform(-2.0, 2.0, (2, 2000))
    height = heaped.at(x, y)
    assert np.isfinite(height).all()
    # No towers: the highest alone counts.
    assert 0.0 < height.max() <= 1.5 * 1.7 * 3.0 * 0.3


@pytest.fixture(scope="module")
def meshed():
    surface = ground(0.5, (24.0, 20.0), 0.2)
    around = among(surface, (1.0, -6.0))
    surface = built(around, plan(**STONES)).surface
    meshing = Meshing(0.5, 10**7, 0.125, 0.005)
    sight = pixels_per_meter(surface.field, around.views, 0.125)
    bare, _ = build_tiles(ground(0.5, (24.0, 20.0), 0.2), 1, meshing, sight, around.views)
    return surface, around, bare, *build_tiles(surface, 1, meshing, sight, around.views)


def test_the_mesh_follows_ramps_within_the_tolerance_and_is_no_finer_elsewhere(meshed):
    surface, around, bare, tiles, report = meshed
    (heaped,) = surface.details
    errors, corners = [], []
    for tile in tiles:
        at = (tile.points.astype(np.float64) + tile.translate)[tile.faces]
        corners.append(at)
        middle = at.mean(axis=1)
        x, y = np.ascontiguousarray(middle[:, :2].T)
        pixels = pixels_of_balls(around.views, middle, np.zeros(len(x)), 0.125, 0.05)
        off = np.abs(surface.height_at(x, y) - middle[:, 2]) * pixels
        errors.append(off[heaped.at(x, y) > 0.0])
    errors = np.concatenate(errors)
    assert len(errors) > 3000
    assert np.quantile(errors, 0.99) < 0.5
    assert np.quantile(errors, 0.999) < 0.6
    assert report["mesh"]["finer"]["surface_error_99_9_px"] < 0.6
    plain = {tuple(p) for tile in bare for p in (tile.points + tile.translate)[:, :2].round(6)}
    new = [
        p for p in np.concatenate(corners).reshape(-1, 3)[:, :2].round(6) if tuple(p) not in plain
    ]
    x, y = np.array(new).T
    away = np.hypot(x[:, None] - heaped.feet.x, y[:, None] - heaped.feet.y) - heaped.far
    assert len(new) > 3000
    assert away.min(axis=1).max() < 1.0


def _cfg() -> dict:
    cfg = small_cfg(samples=1, batches=1)
    rocks = cfg["objects"]["rocks"]
    rocks |= {"orientation": "normal", "fillet": {}, "count": 60, "size_m": 1.5}
    cfg["terrain"]["mesh"] = {"tolerance_px": 0.5}
    cfg["rigs"]["rover"]["sensors"]["front"]["outputs"] = ["label", "instance", "depth"]
    return cfg


def digest() -> str:
    """Of ramps about stones on hills, at their stones and at points."""
    one = built(among(ground(1.0)), plan(**STONES | {"fillet": {}}))
    (heaped,) = one.surface.details
    made = hashlib.sha256()
    for each in heaped.feet:
        made.update(each.tobytes())
    made.update(one.surface.height_at(*RNG(2).uniform(-15.0, 15.0, (2, 5000))).tobytes())
    return made.hexdigest()


@pytest.mark.invariant
@pytest.mark.slow
def test_bytes_do_not_depend_on_threads_or_the_cpu_s_extras():
    assert digest_elsewhere("test_fillets") == digest()


@pytest.mark.parametrize("why", ["the terrain is a mesh", "the mesh is the plain grid"])
def test_on_a_mesh_and_on_a_plain_grid_there_are_none_and_the_report_says_so(tmp_path, why):
    cfg = _cfg()
    cfg["terrain"]["mesh"] = {"tolerance_px": 0}
    if "terrain" in why:
        write(tmp_path / "cave.ply", *shelter(8))
        base = {"type": "mesh", "file": "cave.ply", "unit_m": 1, "up": "z"}
        cfg["terrain"] |= {"size_m": [20, 20], "spacing_m": 0.4, "relief": [base], "mesh": {}}
        cfg["objects"]["rocks"]["count"] = 10
    log = BuildLog()
    build(draw(load(write_cfg(tmp_path, cfg)), 3, 0), log)
    assert log.facts["objects"]["rocks"]["fillets"] == 0
    what = [(e["what"], e["why"]) for e in log.facts["left_out"] if "fillet" in e["what"]]
    assert what == [("objects/rocks: fillet", why)]


def test_ladders_are_of_the_ground_that_is_meshed(tmp_path):
    log = BuildLog()
    spec = load(write_cfg(tmp_path, _cfg()))
    build(draw(spec, 5, 0), log)
    (ladder,) = tessellation(Base(spec, 5, 0), 1)
    (own,), ground = ladder.rungs, log.facts["ground"]
    assert own.triangles == ground["faces"]
    found = ground["mesh"]["finer"]["surface_error_found_px"]
    assert own.details["found_px"] == max(found, ground["mesh"]["height_error_max_px"])


def test_annotation_is_the_same_pruned_or_not(tmp_path, workers_here):
    file = write_cfg(tmp_path, _cfg())
    passes = []
    for keep in (Keep.SEEN, Keep.UNPRUNED):
        compile_cfg(file, seed=5, out=tmp_path / keep, keep=keep)
        (frame,) = render(
            tmp_path / keep, "reference", passes=("depth", "instance", "label")
        ).frames
        passes.append(read_frame(frame).passes)
        report = json.loads((tmp_path / keep / "batch_0000" / "report.json").read_text())
        assert report["objects"]["rocks"]["fillets"] > 10
    assert passes[0].keys() == passes[1].keys() >= {"depth"}
    for name, values in passes[0].items():
        assert np.array_equal(values, passes[1][name], equal_nan=True)
