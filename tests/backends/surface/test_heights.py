"""Merges that heed heights as defined."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.backends.surface import merges
from scenec.backends.surface.algebra import FLOAT64
from scenec.backends.surface.merges import needed

DEPTHS = (1e-9, 1e-3, 0.05, 0.3, 1.0, 40.0)
HEIGHTS = np.linspace(0.0, 1.0, 11)


def heeded(weight, depth, below, above):
    return heeded_weights([weight], (depth,), [below, above])[0]


def heeded_weights(weights, depths, heights):
    return merges.heeded_weights(FLOAT64, weights, merges.all_slopes(FLOAT64, depths), heights)


@pytest.mark.parametrize("depth", DEPTHS)
def test_a_layer_is_absent_at_weight_0_and_alone_at_1_whatever_the_heights(depth):
    below, above = np.meshgrid(HEIGHTS, HEIGHTS)
    np.testing.assert_allclose(heeded(np.zeros(()), depth, below, above), 0.0, atol=1e-9)
    np.testing.assert_allclose(heeded(np.ones(()), depth, below, above), 1.0, atol=1e-9)


@pytest.mark.parametrize("depth", DEPTHS)
def test_weights_grow_with_the_weight_and_the_layer_s_height(depth):
    weight = np.linspace(0.0, 1.0, 201)[:, None, None]
    below, above = np.meshgrid(HEIGHTS, HEIGHTS, indexing="ij")
    found = heeded(weight, depth, below, above)
    assert (np.diff(found, axis=0) >= 0.0).all()
    assert (np.diff(found, axis=1) <= 0.0).all()
    assert (np.diff(found, axis=2) >= 0.0).all()
    assert found.min() >= 0.0
    assert found.max() <= 1.0
    # Continuous: no step is larger than the slope allows.
    assert np.diff(found, axis=0).max() <= 0.005 * (1.0 + 1.0 / max(depth, 1e-3)) + 1e-12


def test_at_equal_weight_the_higher_one_is_seen_and_both_within_the_depth():
    half = np.full(3, 0.5)
    found = heeded(half, 0.2, np.array([0.3, 0.4, 0.7]), np.array([0.6, 0.4, 0.3]))
    np.testing.assert_allclose(found, [1.0, 0.5, 0.0])
    np.testing.assert_allclose(heeded(half[:1], 0.2, 0.45, 0.55), [0.75])


def test_the_mean_weight_stays_a_half_over_even_heights_and_deep_ones_are_the_weight():
    rng = np.random.default_rng(3)
    below, above = rng.normal(0.5, 0.12, (2, 100000)).clip(0.0, 1.0)
    assert abs(heeded(np.full(1, 0.5), 0.1, below, above).mean() - 0.5) < 0.005
    weight = np.linspace(0.0, 1.0, 50)
    np.testing.assert_allclose(heeded(weight, 1e6, 0.2, 0.9), weight, atol=1e-5)
    np.testing.assert_array_equal(heeded(weight, 0.0, 0.2, 0.9), weight)


def test_merges_go_by_the_height_of_what_is_seen_below():
    weights = [np.array(1.0), np.array(0.5), np.array(0.5)]
    heights = [np.array(0.9), np.array(0.2), np.array(0.6), np.array(0.3)]
    first, second, third = heeded_weights(weights, (0.1, 0.1, 0.1), heights)
    # The base is hidden: its height counts for nothing.
    assert first == 1.0
    assert second == 1.0
    assert third == 0.0
    # Without depths weights are as they were.
    assert heeded_weights(weights, (), heights) == weights
    # A merge without depth mixes heights by its weight: (0.9 + 0.2) / 2 lies below 0.6.
    mixed = heeded_weights([np.array(0.5), np.array(0.5)], (0.0, 0.04), heights[:3])
    assert mixed[0] == 0.5
    assert mixed[1] == 1.0


def test_heights_matter_up_to_the_last_merge_with_a_depth():
    assert needed(()) == 0
    assert needed((0.0, 0.0)) == 0
    assert needed((0.2,)) == 2
    assert needed((0.0, 0.2, 0.0)) == 3
