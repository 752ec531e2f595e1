"""The C2 spline through poses, against SciPy's, against closed forms, and against differences."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from scenec.compiler.geometry.pose_spline import spline_poses
from scenec.testing import tumbling
from scenec.testing.examples import examples
from scenec.testing.tumbling import quaternions, rotations, top

keys = partial(tumbling.keys, seed=1)


def test_positions_are_scipy_s_cubic_spline_with_the_same_velocities_at_its_ends():
    time, p, r = keys(200, 1.0)
    at = np.linspace(time[0], time[-1], 5000)
    found = spline_poses(time, p, quaternions(r), at)
    ends = tuple((1, found.velocity[k]) for k in (0, -1))
    other = CubicSpline(time, p, bc_type=ends)
    for order, ours in enumerate((found.position, found.velocity, found.acceleration)):
        assert np.allclose(ours, other(at, order), rtol=0, atol=1e-11)


def test_turns_are_scipy_s_rotation_spline_away_from_its_ends():
    # Its velocities at the ends are others; what that changes falls by 3.7 or more from key to key.
    time, p, r = keys(200, 1.5)
    at = np.linspace(time[30], time[-30], 5000)
    found, other = spline_poses(time, p, quaternions(r), at), RotationSpline(time, r)
    assert (rotations(found.quaternion).inv() * other(at)).magnitude().max() < 1e-11
    assert np.allclose(found.spin, other(at, 1), rtol=0, atol=1e-10)
    assert np.allclose(found.spin_rate, other(at, 2), rtol=0, atol=1e-8)


@examples(60)
@given(
    n=st.integers(1, 12),
    seed=st.integers(0, 2**32),
    largest=st.sampled_from([0.0, 1e-9, 0.1, 1.0, 2.0, 3.0]),
)
def test_it_goes_through_every_key_and_its_second_derivatives_have_no_jumps(n, seed, largest):
    time, p, r = tumbling.keys(n, largest, seed)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (n, 1))
    at_keys = spline_poses(time, p, signs * quaternions(r), time)
    assert np.array_equal(at_keys.position, p)
    assert np.array_equal(at_keys.quaternion, signs * quaternions(r))
    before = spline_poses(time, p, quaternions(r), time[1:-1] * (1 - 1e-14))
    for ours, earlier in zip(at_keys[2:], before[2:], strict=True):
        size = 1.0 + np.abs(ours).max(initial=0.0)
        # A difference of two times is a rounding: 1e-14 s of the third derivative.
        assert np.abs(ours[1:-1] - earlier).max(initial=0.0) < 1e-8 * size


def test_all_derivatives_are_those_of_the_curve_by_differences():
    time, p, r = keys(20, 2.0)
    at, e = np.linspace(time[0] + 0.1, time[-1] - 0.1, 997), 1e-5
    q = quaternions(r)
    here, after, before = (spline_poses(time, p, q, at + d) for d in (0.0, e, -e))
    inner = np.abs(at[:, None] - time).min(axis=1) > 2 * e
    for of, order in (
        ("position", "velocity"),
        ("velocity", "acceleration"),
        ("spin", "spin_rate"),
    ):
        slope = (getattr(after, of) - getattr(before, of)) / (2 * e)
        assert np.abs(slope - getattr(here, order))[inner].max() < 1e-4
    turned = rotations(before.quaternion).inv() * rotations(after.quaternion)
    assert np.abs(turned.as_rotvec() / (2 * e) - here.spin)[inner].max() < 1e-6


def test_constant_accelerations_and_constant_angular_velocities_come_back_exactly():
    time = np.array([0.0, 0.4, 0.5, 1.3, 2.0, 2.2])
    g, v, w = np.array([0.3, -9.8, 1.0]), np.array([1.0, 2.0, 3.0]), np.array([0.9, -0.4, 0.7])
    at = np.linspace(0, 2.2, 301)
    q = quaternions(Rotation.from_rotvec(time[:, None] * w))
    p = time[:, None] * v + 0.5 * time[:, None] ** 2 * g
    found = spline_poses(time, p, q, at)
    assert np.allclose(found.acceleration, g, rtol=0, atol=1e-12)
    assert np.allclose(found.velocity, v + at[:, None] * g, rtol=0, atol=1e-12)
    assert np.allclose(found.spin, w, rtol=0, atol=1e-13)
    assert np.abs(found.spin_rate).max() < 1e-12


@pytest.mark.parametrize(("of", "power"), [("turn", 4), ("spin", 3), ("spin_rate", 2)])
def test_errors_on_a_free_top_fall_as_powers_of_the_keys_distance(of, power):
    at = np.linspace(4, 6, 1001)
    attitude, rate, change = top(at)
    errors = []
    for hz in (10, 20, 40):
        time = np.arange(10 * hz + 1) / hz
        found = spline_poses(time, np.zeros((len(time), 3)), quaternions(top(time)[0]), at)
        off = {
            "turn": (attitude.inv() * rotations(found.quaternion)).magnitude(),
            "spin": np.abs(found.spin - rate),
            "spin_rate": np.abs(found.spin_rate - change),
        }
        errors.append(off[of].max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.abs(orders - power).max() < 0.15


def test_one_pose_stands_still_and_beyond_the_ends_the_poses_are_theirs():
    time, p, r = keys(5, 1.0)
    one = spline_poses(time[:1], p[:1], quaternions(r)[:1], np.array([0.0, 5.0]))
    assert np.array_equal(one.position, p[[0, 0]])
    assert not one.velocity.any()
    beyond = spline_poses(time, p, quaternions(r), np.array([time[0] - 1, time[-1] + 1]))
    assert np.array_equal(beyond.position, p[[0, -1]])
