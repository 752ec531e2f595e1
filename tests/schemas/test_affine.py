"""Affine maps and quaternions against NumPy's and SciPy's own."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scenec.importers.poses import without_scale
from scenec.schemas.affine import (
    boxes_around,
    composed,
    inverses_or_identity,
    mirrored,
    orthonormal,
)
from scenec.schemas.quaternions import quaternions, rotation_entries

RNG = np.random.default_rng(4)
MAPS = RNG.normal(size=(200, 3, 4))


def test_a_map_after_its_inverse_is_the_identity() -> None:
    np.testing.assert_allclose(
        composed(inverses_or_identity(MAPS), MAPS) - np.eye(4)[:3], 0.0, atol=1e-9
    )


def test_a_box_around_a_box_is_that_of_its_corners() -> None:
    boxes = np.sort(RNG.normal(size=(200, 2, 3)), axis=1)
    corners = np.stack([boxes[:, [i, j, k], [0, 1, 2]] for i in (0, 1) for j in (0, 1)
                        for k in (0, 1)], axis=1)  # fmt: skip
    moved = np.einsum("nij,nkj->nki", MAPS[..., :3], corners) + MAPS[:, None, :, 3]
    expected = np.stack([moved.min(axis=1), moved.max(axis=1)], axis=1)
    found = boxes_around(MAPS[..., :3], boxes, MAPS[..., 3])
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("off", [0.0, 1e-3])
def test_rotations_and_mirror_images_are_told_from_other_matrices(off) -> None:
    turns = Rotation.random(50, rng=3).as_matrix() + off * RNG.normal(size=(50, 3, 3))
    assert (orthonormal(turns, 1e-5) == (off == 0.0)).all()
    assert not mirrored(turns).any()
    assert mirrored(turns * (1.0, -1.0, 1.0)).all()


def test_quaternions_are_those_of_scipy_and_back() -> None:
    turns = Rotation.random(500, rng=5)
    found = quaternions(turns.as_matrix())
    np.testing.assert_allclose(found, turns.as_quat(canonical=True), atol=1e-15)
    back = np.stack(rotation_entries(*found.T, 2.0), axis=1).reshape(-1, 3, 3)
    np.testing.assert_allclose(back, turns.as_matrix(), atol=1e-15)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_scale_and_a_mirror_image_are_taken_off_a_rotation(mirror) -> None:
    turn = Rotation.random(rng=6).as_matrix()
    found, scale = without_scale(2.5 * turn * (mirror, 1.0, 1.0))
    np.testing.assert_allclose(found, turn, atol=1e-14)
    assert scale == pytest.approx(2.5)
