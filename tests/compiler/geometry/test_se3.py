"""Interpolation of poses, against SciPy's and against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation, Slerp

from scenec.compiler.geometry.se3 import METHODS, interpolate, matrices
from scenec.testing.examples import examples
from scenec.testing.tumbling import keys, quaternions, rotations

ALL = list(METHODS)


def test_turns_are_those_of_scipy_and_positions_linear():
    time, p, r = keys(200)
    at = np.sort(np.random.default_rng(1).uniform(time[0], time[-1], 5000))
    position, quaternion = interpolate(time, p, quaternions(r), at)
    off = (rotations(quaternion).inv() * Slerp(time, r)(at)).magnitude()
    assert off.max() < 1e-13
    expected = np.stack([np.interp(at, time, p[:, k]) for k in range(3)], axis=1)
    assert np.allclose(position, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("method", ALL)
@examples(60)
@given(data=st.data())
def test_any_keys_give_unit_quaternions_and_come_back_at_their_times(method, data):
    n = data.draw(st.integers(1, 6))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    size = 10.0 ** data.draw(st.integers(-12, 1))
    q = quaternions(Rotation.from_rotvec(size * rng.normal(size=(n, 3))))
    q *= rng.choice([-1.0, 1.0], (n, 1))
    time = np.cumsum(10.0 ** rng.uniform(-6, 3, n))
    p = rng.normal(size=(n, 3)) * 10.0 ** data.draw(st.integers(-3, 7))
    at = np.append(time, rng.uniform(time[0] - 1, time[-1] + 1, 20))
    position, quaternion = interpolate(time, p, q, at, method)
    assert np.abs((quaternion**2).sum(axis=1) - 1.0).max() < 1e-14
    assert np.isfinite(position).all()
    assert np.array_equal(position[:n], p)
    assert np.array_equal(quaternion[:n], q)


@pytest.mark.parametrize("method", ALL)
def test_the_sign_of_a_quaternion_does_not_matter(method):
    time, p, r = keys(50, seed=2)
    q = quaternions(r)
    at = np.linspace(time[0], time[-1], 999)
    one = interpolate(time, p, q, at, method)
    flipped = q * np.random.default_rng(3).choice([-1.0, 1.0], (50, 1))
    other = interpolate(time, p, flipped, at, method)
    assert np.allclose(one[0], other[0], rtol=0, atol=1e-14)
    # The last bits follow the signs, nothing else does.
    assert (rotations(one[1]).inv() * rotations(other[1])).magnitude().max() < 2e-14


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("rate", [1e-9, 1e-3, 1.0, 3.1])
def test_a_constant_angular_velocity_stays_constant(method, rate):
    # Up to almost half a turn a key: 3.1 rad a second at a key a second.
    axis = np.array([0.6, 0.0, -0.8])
    time = np.arange(20.0)
    q = quaternions(Rotation.from_rotvec(rate * time[:, None] * axis))
    at = np.linspace(0, 19, 1234)
    _, quaternion = interpolate(time, np.zeros((20, 3)), q, at, method)
    exact = Rotation.from_rotvec(rate * at[:, None] * axis)
    assert (exact.inv() * rotations(quaternion)).magnitude().max() < 2e-13


def test_keys_of_a_screw_give_the_screw():
    twist = np.zeros((4, 4))
    twist[:3, :3] = Rotation.from_rotvec([0.3, -1.1, 0.9]).as_matrix() * 0
    w, v = np.array([0.3, -1.1, 0.9]), np.array([0.5, 2.0, -1.0])
    twist[:3, :3] = [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
    twist[:3, 3] = v
    begin = np.eye(4)
    begin[:3, :3] = Rotation.from_euler("xyz", [40, 20, -70], degrees=True).as_matrix()
    begin[:3, 3] = [5, -3, 2]
    # 1.45 rad a second, a key each two seconds: 2.9 rad a step.
    time = np.array([0.0, 2.0, 3.0, 5.0])
    poses = np.stack([begin @ expm(twist * t) for t in time])
    q = quaternions(Rotation.from_matrix(poses[:, :3, :3]))
    at = np.linspace(0, 5, 301)
    position, quaternion = interpolate(time, poses[:, :3, 3], q, at, "screw")
    exact = np.stack([begin @ expm(twist * t) for t in at])
    assert np.allclose(matrices(position, quaternion), exact, rtol=0, atol=2e-13)


def test_a_screw_does_not_depend_on_which_point_of_the_body_is_told():
    time, p, r = keys(30, seed=4)
    lever = np.array([0.7, -2.0, 1.5])
    at = np.linspace(time[0], time[-1], 500)
    for method, same in (("screw", True), ("linear", False)):
        here, q = interpolate(time, p, quaternions(r), at, method)
        there, _ = interpolate(time, p + r.apply(lever), quaternions(r), at, method)
        moved = here + rotations(q).apply(lever)
        assert (np.abs(there - moved).max() < 1e-11) == same


def test_a_screw_stays_near_its_chord_as_stated():
    rng = np.random.default_rng(8)
    for _ in range(200):
        turn = rng.normal(size=3)
        angle = rng.uniform(0.01, 3.1)
        turn *= angle / np.linalg.norm(turn)
        way = rng.normal(size=3)
        q = quaternions(Rotation.from_rotvec([np.zeros(3), turn]))
        p = np.stack([np.zeros(3), way])
        position, _ = interpolate(np.array([0.0, 1.0]), p, q, np.linspace(0, 1, 101), "screw")
        along = np.clip(position @ way / (way @ way), 0, 1)
        off = np.linalg.norm(position - along[:, None] * way, axis=1).max()
        assert off <= 0.5 * np.linalg.norm(way) * np.tan(angle / 4) * (1 + 1e-9)


@pytest.mark.parametrize("angle", [1e-300, 1e-160, 1e-30, 1e-9, 1e-8, 1.1e-8, 1e-5, 9e-5, 1.1e-4])
@pytest.mark.parametrize("method", ALL)
def test_rotations_that_are_almost_the_same_are_shared_out_evenly(method, angle):
    q = np.array([[1.0, 0, 0, 0], [1.0, 0, 0.5 * angle, 0]])
    q[1, 0] = np.sqrt(1 - (0.5 * angle) ** 2)
    time, p = np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [1.0, 2, 3]])
    position, quaternion = interpolate(time, p, q, np.array([0.25]), method)
    assert quaternion[0, 2] == pytest.approx(0.125 * angle, rel=1e-8)
    assert np.allclose(position[0], [0.25, 0.5, 0.75], rtol=0, atol=angle + 1e-15)


@pytest.mark.parametrize("way", [[1, 0, 0], [-1, 0, 0], [0, -1, 0], [0, 0, -1], [0, -0.6, 0.8]])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_half_turn_goes_about_the_axis_whose_first_component_is_above_zero(way, sign):
    axis = np.array(way, float)
    q = sign * np.array([[1.0, 0, 0, 0], [0, *axis]])
    time = np.array([0.0, 1.0])
    _, quaternion = interpolate(time, np.zeros((2, 3)), q, np.array([0.5]))
    first = axis[np.flatnonzero(axis)[0]]
    expected = Rotation.from_rotvec(0.5 * np.pi * axis * np.sign(first))
    assert (expected.inv() * rotations(quaternion)).magnitude().max() < 1e-15


def test_beyond_half_a_turn_the_shorter_way_is_the_other_one():
    time = np.array([0.0, 1.0])
    for angle, expected in ((np.pi - 1e-6, 0.5 * np.pi), (np.pi + 1e-6, -0.5 * np.pi)):
        q = quaternions(Rotation.from_rotvec([[0, 0, 0], [0, 0, angle]]))
        _, half = interpolate(time, np.zeros((2, 3)), q, np.array([0.5]))
        assert rotations(half).as_rotvec()[0, 2] == pytest.approx(expected, abs=1e-6)


def test_a_cubic_gives_back_constant_accelerations_whatever_the_stamps():
    time = np.sort(np.random.default_rng(5).uniform(0, 10, 40))
    a, b, c = np.random.default_rng(6).normal(size=(3, 3))

    def way(t):
        return a + b * t[:, None] + c * (t * t)[:, None]

    at = np.linspace(time[0], time[-1], 777)
    q = np.tile([1.0, 0, 0, 0], (40, 1))
    position, _ = interpolate(time, way(time), q, at, "cubic")
    assert np.allclose(position, way(at), rtol=0, atol=1e-11)


def test_a_cubic_has_no_jump_of_velocity_at_its_keys_and_linear_does():
    time, p, r = keys(30, 1.5, 7)
    h = 1e-5
    jumps = {}
    for method in ("linear", "cubic"):
        inner = time[1:-1]
        at = [interpolate(time, p, quaternions(r), inner + k * h, method) for k in (-2, -1, 1, 2)]
        speed = [(at[i + 1][0] - at[i][0]) / h for i in (0, 2)]
        spin = [
            (rotations(at[i][1]).inv() * rotations(at[i + 1][1])).as_rotvec() / h for i in (0, 2)
        ]
        jumps[method] = [np.abs(x[1] - x[0]).max() for x in (speed, spin)]
    # Over 3 h, a velocity that is continuous changes by about 3 h times the acceleration.
    assert max(jumps["cubic"]) < 2e-2
    assert min(jumps["linear"]) > 1.0


def test_the_error_of_cubics_falls_with_the_cube_of_the_step_and_linear_with_its_square():
    def motion(t):
        euler = np.stack([np.sin(t), 0.8 * np.sin(1.7 * t), 0.9 * t], axis=1)
        position = np.stack([np.cos(t), np.sin(1.3 * t), 0.2 * t], axis=1)
        return position, Rotation.from_euler("xyz", euler)

    at = np.linspace(1, 9, 4001)
    p, r = motion(at)
    errors = {}
    for method in ("linear", "cubic"):
        for n in (101, 201):
            time = np.linspace(0, 10, n)
            kp, kr = motion(time)
            position, q = interpolate(time, kp, quaternions(kr), at, method)
            errors[method, n] = np.array(
                [np.abs(position - p).max(), (r.inv() * rotations(q)).magnitude().max()]
            )
    order = {m: np.log2(errors[m, 101] / errors[m, 201]) for m in ("linear", "cubic")}
    assert np.allclose(order["linear"], 2, atol=0.2)
    assert (order["cubic"] > 2.8).all()
    assert (errors["cubic", 201] < 0.05 * errors["linear", 201]).all()


@pytest.mark.parametrize("method", ALL)
def test_one_pose_stays_and_a_hundred_thousand_are_taken(method):
    q = np.array([[0.5, 0.5, -0.5, 0.5]])
    at = np.linspace(-3, 3, 100_000)
    position, quaternion = interpolate(np.array([0.0]), np.array([[1.0, 2, 3]]), q, at, method)
    assert (position == [1, 2, 3]).all()
    assert (quaternion == q).all()
    time = np.linspace(-3, 3, 100_000)
    rng = np.random.default_rng(0)
    keys_q = quaternions(Rotation.random(100_000, random_state=1))
    p = rng.normal(size=(100_000, 3))
    again = interpolate(time, p, keys_q, time, method)
    assert np.array_equal(again[0], p)
    assert np.array_equal(again[1], keys_q)


def test_straight_down_and_up_are_turns_like_any_other():
    # Pitching through the zenith and on: an even rate about the body's x axis, no jump.
    angle = np.linspace(0, 2 * np.pi, 37)
    q = quaternions(Rotation.from_rotvec(angle[:, None] * [1.0, 0, 0]))
    at = np.linspace(0, 1, 1000)
    _, quaternion = interpolate(np.linspace(0, 1, 37), np.zeros((37, 3)), q, at)
    steps = (rotations(quaternion[:-1]).inv() * rotations(quaternion[1:])).magnitude()
    assert np.allclose(steps, 2 * np.pi / 999, rtol=0, atol=1e-12)
