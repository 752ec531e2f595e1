"""Quaternions, rigid poses, numbers as text, and depth in 16 bits."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from scenec.datasets.formats.contract import Info
from scenec.datasets.formats.depth_png import LARGEST, to_16_bits
from scenec.datasets.formats.poses import (
    inverse,
    number,
    opencv,
    product,
    relative,
    rotation_matrix,
)
from scenec.datasets.formats.tum import Tum
from scenec.schemas.errors import OutputError
from scenec.schemas.quaternions import quaternion

angles = st.floats(-np.pi, np.pi)
rotations = st.builds(lambda a, b, c: Rotation.from_euler("xyz", [a, b, c]), angles, angles, angles)


@given(rotations)
@example(Rotation.from_quat([1, 0, 0, 0]))
@example(Rotation.from_quat([0, 1, 0, 0]))
@example(Rotation.from_quat([0, 0, 1, 0]))
@example(Rotation.from_quat([0, 0, 0, 1]))
@example(Rotation.from_quat([0.6, 0.8, 0, 1e-9]))
@example(Rotation.from_quat([0.5, -0.5, 0.5, 1e-16]))
def test_a_quaternion_turns_as_its_matrix_does_whatever_the_rotation(rotation):
    matrix = rotation.as_matrix()
    found = quaternion(matrix)
    assert found[3] >= 0.0
    assert abs(np.linalg.norm(found) - 1.0) < 1e-15
    assert np.abs(Rotation.from_quat(found).as_matrix() - matrix).max() < 1e-14
    assert np.abs(rotation_matrix(found) - matrix).max() < 1e-14


@given(rotations, rotations, hnp.arrays(float, (2, 3), elements=st.floats(-1e4, 1e4)))
def test_a_relative_pose_takes_points_from_one_frame_to_the_other(a, b, places):
    first, second = np.eye(4), np.eye(4)
    first[:3, :3], second[:3, :3] = a.as_matrix(), b.as_matrix()
    first[:3, 3], second[:3, 3] = places
    found = relative(first, second)
    assert np.abs(product(first, found) - second).max() < 1e-10
    assert np.abs(product(inverse(first), first) - np.eye(4)).max() < 1e-10


def test_the_first_pose_relative_to_itself_is_the_identity_to_the_bit():
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [1, 2, 3]).as_matrix()
    pose[:3, 3] = 1e7, -1e-7, 1 / 3
    assert (relative(pose, pose) == np.eye(4)).all()


def test_opencv_has_whole_numbers_where_pixels_have_their_centers():
    k = np.array([[100.0, 0.5, 32.0], [0.0, 90.0, 24.0], [0.0, 0.0, 1.0]])
    assert opencv(k).tolist() == [[100.0, 0.5, 31.5], [0.0, 90.0, 23.5], [0.0, 0.0, 1.0]]


@given(st.floats(allow_nan=False, allow_infinity=False))
@example(1e-05)
@example(-0.0)
def test_a_number_reads_back_the_same_in_yaml_too(value):
    assert float(number(value)) == value
    assert yaml.safe_load(number(value)) == value
    assert not number(0.0 * value).startswith("-")


@given(
    hnp.arrays(np.float32, (3, 4), elements=st.floats(0, 1e6, width=32)),
    st.sampled_from([256.0, 1000.0, 5000.0]),
)
def test_depth_in_16_bits_is_off_by_half_a_step_or_not_there(depth, scale):
    found = to_16_bits(depth, scale)
    there = found.steps > 0
    error = np.abs(found.steps / scale - depth.astype(float))
    assert error[there].max(initial=0.0) <= 0.5 / scale * (1 + 1e-9)
    assert (depth[~there] * scale <= 0.5).sum() == found.under
    assert (depth[~there] * scale > 0.5).sum() == found.beyond
    assert found.hits == depth.size


def test_depth_at_the_end_of_the_range_is_kept_and_beyond_it_is_none():
    depth = np.array([[LARGEST / 256.0, (LARGEST + 1) / 256.0, np.inf, np.nan]])
    found = to_16_bits(depth, 256.0)
    assert found.steps.tolist() == [[LARGEST, 0, 0, 0]]
    assert (found.hits, found.beyond, found.under) == (2, 1, 0)


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "fast", ""])
def test_a_scale_that_makes_no_sense_is_refused(text):
    with pytest.raises(OutputError, match="expected a number above 0"):
        Tum(Info("x", {}, "class", (), (), {"depth_scale": text}))
