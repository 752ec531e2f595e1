"""Relief made of noise: each variant against its formula, cells against a search of all points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from one_octave import perlin2
from scipy.spatial import cKDTree

from scenec.compiler.noise.fractal import Fractal
from scenec.compiler.noise.lattice import hash2, mix, subkey, subkeys
from scenec.compiler.noise.octaves import octave_at, tabulate
from scenec.compiler.noise.worley import (
    block,
    blocks2_points,
    feature_point,
    worley2,
    worley2_points,
)
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.worley import Worley
from scenec.schemas.threads import at_most
from scenec.testing.examples import examples

VARIANTS = ["fbm", "hetero", "hybrid", "ridged", "billow"]
FRACTAL = Multifractal(
    key=7, amplitude_m=3.0, scale_m=25.0, octaves=6, lacunarity=2.13, gain=0.6, variant="fbm"
)
CELLS = Worley(key=9, amplitude_m=2.0, scale_m=8.0)
GRID = Grid((60.0, 40.0), (41, 61))


def apply(operator, grid: Grid = GRID) -> np.ndarray:
    return operator.apply(grid, np.zeros(grid.shape))[0]


def part(key: int, index: int) -> np.uint64:
    return np.uint64(subkey(np.uint64(key), index))


def fbm2(key: int, x: float, y: float, octaves: int, gain: float, lacunarity: float) -> float:
    """The sum at a point, in the product's order of operations."""
    total, amplitude = 0.0, 1.0
    for octave in range(octaves):
        total += amplitude * perlin2(part(key, octave), x, y)
        amplitude *= gain
        x, y = lacunarity * (0.8 * x - 0.6 * y), lacunarity * (0.6 * x + 0.8 * y)
    return total


def musgrave(operator: Multifractal, x: float, y: float) -> float:
    """A variant as its docstring has it, one point at a time."""
    u, v = x / operator.scale_m, y / operator.scale_m
    if operator.distortion:
        moved = [fbm2(part(operator.key, (1 << 20) + i), u, v, 2, 0.5, 2.0) for i in (0, 1)]
        u, v = u + operator.distortion * moved[0], v + operator.distortion * moved[1]
    n, g = [], [operator.gain**o for o in range(operator.octaves)]
    for octave in range(operator.octaves):
        n.append(perlin2(part(operator.key, octave), u, v))
        turned = 0.8 * u - 0.6 * v, 0.6 * u + 0.8 * v
        u, v = operator.lacunarity * turned[0], operator.lacunarity * turned[1]

    def total(n: list[float]) -> float:
        b = operator.offset
        if operator.variant == "fbm":
            return sum(w * s for w, s in zip(g, n, strict=True))
        if operator.variant == "billow":
            return sum(w * (2 * abs(s) - 0.5) for w, s in zip(g, n, strict=True))
        if operator.variant == "hetero":
            value = b + n[0]
            for w, s in zip(g[1:], n[1:], strict=True):
                value += w * (s + b) * value
            return value
        value, weight = 0.0, 1.0
        for w, s in zip(g, n, strict=True):
            if operator.variant == "hybrid":
                weight = min(weight, 1.0) * w * (s + b)
                value += weight
            else:
                weight = (b - abs(s)) ** 2 * min(max(2.0 * weight, 0.0), 1.0)
                value += w * weight
        return value

    flat = total([0.0] * len(n))
    if operator.variant == "hetero":
        return operator.amplitude_m * (total(n) * operator.offset / flat - operator.offset)
    if operator.variant == "ridged":
        return operator.amplitude_m * (total(n) - 0.5 * sum(w * operator.offset**2 for w in g))
    return operator.amplitude_m * (total(n) - (flat if operator.variant == "hybrid" else 0.0))


@pytest.mark.parametrize("distortion", [0.0, 0.8])
@pytest.mark.parametrize("variant", VARIANTS)
def test_relief_is_its_formula_at_every_sample(variant, distortion):
    operator = replace(FRACTAL, octaves=4, variant=variant, distortion=distortion)
    height = apply(operator)
    x, y = GRID.x(), GRID.y()
    for j, i in [(0, 0), (40, 60), (0, 60), (17, 23), (31, 5), (20, 30)]:
        assert height[j, i] == pytest.approx(musgrave(operator, x[i], y[j]), rel=1e-12, abs=1e-12)


def test_noise_of_many_points_has_the_bits_of_one():
    x, y = np.linspace(-7.3, 11.1, 57), np.linspace(-2.0, 3.0, 31)
    grid = Fractal(5, 7, 0.6, 2.1).on(x, y)
    plain = [[fbm2(5, u, v, 7, 0.6, 2.1) for u in x] for v in y]
    assert np.array_equal(grid, np.array(plain))
    v, u = (a.ravel() for a in np.meshgrid(y, x, indexing="ij"))
    for order in (np.arange(u.size), np.random.default_rng(0).permutation(u.size)):
        scattered = Fractal(5, 7, 0.6, 2.1).at(u[order], v[order])
        assert np.array_equal(scattered, grid.ravel()[order])


@pytest.mark.parametrize("far", [0.0, -3e5, 2.0**49])
def test_octaves_have_the_same_bits_with_a_table_and_without(far):
    u, v = np.random.default_rng(1).uniform(far, far + 30.0, (2, 1000))
    keys = subkeys(np.uint64(5), 1)
    with_table = tabulate(keys, np.sort(u), np.sort(v), 2.0, 10_000, 0.0)
    without = tabulate(keys, u, v, 2.0, 0, 0.0)
    assert (with_table.start.tolist(), without.start.tolist()) == ([0], [-1])
    plain = [perlin2(keys[0], a, b) for a, b in zip(u, v, strict=True)]
    for octaves in (with_table, without):
        out = np.empty(u.size)
        octave_at(octaves, 0, u, v, out)
        assert np.array_equal(out, plain)


def test_a_table_that_would_be_too_large_is_left_out_without_a_trace():
    # Two rows, ten thousand cells apart: turned, they lie in a box of a hundred million cells.
    x, y = np.linspace(0.0, 10_000.0, 40), np.array([0.0, 10_000.0])
    assert tabulate(subkeys(np.uint64(5), 2), x, y, 2.0, 80, 0.0).start.tolist() == [-1, -1]
    plain = [[fbm2(5, u, v, 2, 0.5, 2.0) for u in x] for v in y]
    assert np.array_equal(Fractal(5, 2, 0.5, 2.0).on(x, y), np.array(plain))


def test_beyond_what_float64_tells_apart_there_is_no_noise():
    far = np.array([2.0**52, -(2.0**60), 1e300])
    assert np.abs(Fractal(5, 3, 0.5, 2.0).at(far, far)).max() == 0.0


@pytest.mark.parametrize("operator", [replace(FRACTAL, distortion=0.4), CELLS])
def test_relief_does_not_depend_on_the_number_of_threads(operator):
    with at_most(1):
        alone = apply(operator)
    assert np.array_equal(alone, apply(operator))


def test_hybrid_relief_is_smooth_in_its_valleys_and_billow_has_creases():
    grid = Grid.with_spacing((400.0, 400.0), 0.8)
    hybrid = apply(replace(FRACTAL, scale_m=80.0, variant="hybrid", offset=0.4), grid)
    rough = np.abs(np.diff(hybrid, 2, axis=1))
    middle = hybrid[:, 1:-1]
    high, low = middle > np.quantile(middle, 0.8), middle < np.quantile(middle, 0.2)
    assert rough[high].mean() > 2.0 * rough[low].mean()
    # Creases are bottoms: bends are far sharper upward than downward.
    billow = apply(replace(FRACTAL, scale_m=80.0, octaves=1, variant="billow"), grid)
    bend = np.diff(billow, 2, axis=1)
    assert bend.max() > 3.0 * -bend.min()


def test_a_warp_moves_the_noise_by_its_strength_at_most():
    plain = replace(FRACTAL, octaves=1, distortion=0.0)
    warped = apply(replace(plain, distortion=0.01))
    # One octave of unit noise rises by less than 3 in a unit; the warp is 0.02 at most.
    assert 0.0 < np.abs(warped - apply(plain)).max() < 3.0 * 0.02 * plain.amplitude_m


@examples(60)
@given(
    octaves=st.integers(0, 24),
    lacunarity=st.floats(1.0, 8.0),
    gain=st.floats(0.0, 2.0),
    amplitude=st.sampled_from([0.0, 1e-3, 1.0, 1e6]),
    size=st.sampled_from([1e-3, 1.0, 1e3, 1e6]),
    variant=st.sampled_from([*VARIANTS, "f1", "f2-f1", "blocks"]),
    offset=st.floats(-2.0, 2.0),
    distortion=st.sampled_from([0.0, 0.5, 10.0]),
)
def test_noise_is_finite_over_the_whole_range(
    octaves, lacunarity, gain, amplitude, size, variant, offset, distortion
):
    grid = Grid.with_spacing((size, size), size / 16)
    if variant in VARIANTS:
        operator = Multifractal(
            key=3,
            amplitude_m=amplitude,
            scale_m=size / 3,
            octaves=octaves,
            lacunarity=lacunarity,
            gain=gain,
            variant=variant,
            offset=offset,
            distortion=distortion,
        )
    else:
        operator = Worley(
            key=3,
            amplitude_m=amplitude,
            scale_m=size / 3,
            distance=variant,
            octaves=octaves,
            lacunarity=lacunarity,
            gain=gain,
        )
    height = apply(operator, grid)
    assert np.isfinite(height).all()
    if amplitude == 0.0 or octaves == 0:
        assert np.abs(height).max() == 0.0


@pytest.mark.parametrize("jitter", [0.0, 0.5, 1.0])
def test_cells_are_the_distances_to_the_two_nearest_feature_points(jitter):
    key = np.uint64(3)
    points = [feature_point(key, i, j, jitter) for i in range(-13, 13) for j in range(-13, 13)]
    at = np.random.default_rng(0).uniform(-9.0, 9.0, (20_000, 2))
    expected = cKDTree(points).query(at, k=2)[0]
    got = [worley2(key, x, y, jitter) for x, y in at]
    assert np.allclose(got, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("jitter", [0.0, 0.5, 1.0])
def test_cells_of_many_points_have_the_bits_of_one(jitter):
    # So many that some have their second nearest point two cells away.
    u, v = np.random.default_rng(1).uniform(-1e4, 1e4, (2, 20_000))
    first, second = np.empty(u.size), np.empty(u.size)
    worley2_points(np.uint64(3), u, v, jitter, first, second)
    one = [worley2(np.uint64(3), x, y, jitter) for x, y in zip(u, v, strict=True)]
    assert np.array_equal(np.stack([first, second], axis=1), one)


def test_a_feature_point_lies_in_its_cell_and_nowhere_in_particular():
    points = np.array([feature_point(np.uint64(1), i, 5, 1.0) for i in range(20_000)])
    inside = points - np.stack([np.arange(20_000), np.full(20_000, 5)], axis=1)
    assert inside.min() > 0.0
    assert inside.max() < 1.0
    assert np.allclose(inside.mean(axis=0), 0.5, atol=0.01)
    assert np.allclose(inside.std(axis=0), np.sqrt(1.0 / 12.0), atol=0.01)
    assert abs(np.corrcoef(inside.T)[0, 1]) < 0.03


def test_cellular_relief_is_its_distance_in_cells_times_its_amplitude():
    key, x, y = part(CELLS.key, 0), GRID.x()[11] / 8.0, GRID.y()[7] / 8.0
    blocks2_points(key, np.array([x]), np.array([y]), 1.0, rubble := np.empty(1))
    assert apply(replace(CELLS, distance="blocks"))[7, 11] == 2.0 * rubble[0]
    for distance in ("f1", "f2-f1"):
        height = apply(replace(CELLS, distance=distance))
        first, second = worley2(key, x, y, 1.0)
        assert height[7, 11] == 2.0 * (second - first if distance == "f2-f1" else first)
        assert height.min() >= 0.0
        assert height.max() <= 2.0 * 1.6


def test_cells_finer_than_the_grid_are_left_out_and_counted():
    height, report = replace(CELLS, octaves=5).apply(GRID, np.zeros(GRID.shape))
    assert (report["octaves"], report["octaves_below_grid"]) == (3, 2)
    assert np.array_equal(height, apply(replace(CELLS, octaves=3)))


def test_rubble_is_the_highest_of_all_blocks_near_and_far():
    key = np.uint64(5)
    u, v = np.random.default_rng(2).uniform(-3.0, 3.0, (2, 2_000))
    out = np.empty(u.size)
    blocks2_points(key, u, v, 1.0, out)
    expected = np.zeros(u.size)
    for i in range(-7, 7):
        for j in range(-7, 7):
            x, y = feature_point(key, i, j, 1.0)
            form = np.uint64(mix(np.uint64(hash2(key, i, j))))
            heights = [block(form, a - x, b - y) for a, b in zip(u, v, strict=True)]
            expected = np.maximum(expected, heights)
    assert np.allclose(out, expected, rtol=0, atol=1e-12)
    assert 0.5 < (out > 0.0).mean() < 0.9
    assert out.max() <= 1.2


def test_rubble_has_level_ground_tilted_tops_and_sides_of_one_slope():
    step = 1e-6
    u, v = np.random.default_rng(3).uniform(-50.0, 50.0, (2, 20_000))
    here, right, up = (np.empty(u.size) for _ in range(3))
    for out, x, y in ((here, u, v), (right, u + step, v), (up, u, v + step)):
        blocks2_points(np.uint64(7), x, y, 0.9, out)
    slope = np.hypot(right - here, up - here) / step
    kinds = [slope < 1e-6, (slope > 1e-6) & (slope < 0.6 * np.sqrt(2.0) + 1e-6),
             np.abs(slope - 3.0) < 1e-4]  # fmt: skip
    # All but what lies on an edge.
    assert sum(kind.mean() for kind in kinds) > 0.9999
    assert min(kind.mean() for kind in kinds) > 0.1
    # Turned any way: no side of the compass has more of the sides than another.
    turned = np.arctan2(up - here, right - here)[kinds[2]]
    assert np.histogram(turned, 8, (-np.pi, np.pi))[0].min() > 0.1 * kinds[2].sum()
