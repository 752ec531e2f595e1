"""Reads poses of cameras and lidars: the rigid part of their transforms, or why there is none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd

from scenec.backends.stage import values
from scenec.backends.stage.frame import StageFrame
from scenec.schemas import affine
from scenec.schemas.errors import StageError

#: By how much lengths of axes may differ, and their angles be off a right one: rounding of floats.
_TOLERANCE = 1e-5
#: Volume of the cell of unit axes below which they lie in a plane.
_FLAT = 1e-9

#: What a transform does to a camera besides moving and turning it, and what becomes of that.
MIRRORED = "a camera is mirrored: its pose is without that, so its picture is the mirror image"
STRETCHED = "a camera is stretched: its pose is without that, so its picture is not stretched"
SHEARED = "a camera is sheared: its pose is without that, so its picture is not sheared"


def camera_poses(
    prim: Usd.Prim, frame: StageFrame, times: Sequence[Usd.TimeCode]
) -> tuple[NDArray[np.float64], list[str]]:
    """Returns poses of a camera's axes (USD's: x right, y up, looking along -z), and faults.

    As in ``GfFrustum::SetPositionAndRotationFromMatrix`` (pxr/base/gf/frustum.cpp) a mirrored one
    has its x axis turned round, and what then is no rotation is made one.

    Returns:
        Float64 [times, 4, 4], proper; lines as ``MIRRORED``.

    Raises:
        StageError: It is projective, has no inverse, or is not finite.
    """
    matrices = values.matrices(prim, times, of_world=True)
    require_invertible(prim, matrices)
    told = [
        line
        for line, found in (
            (MIRRORED, mirrored(matrices)),
            (STRETCHED, stretched(matrices)),
            (SHEARED, sheared(matrices)),
        )
        if found.any()
    ]
    matrices = np.where(mirrored(matrices)[:, None, None], matrices * (-1.0, 1, 1, 1), matrices)
    return frame.pose(straightened(matrices)), told


def lidar_poses(
    prim: Usd.Prim, frame: StageFrame, times: Sequence[Usd.TimeCode]
) -> NDArray[np.float64]:
    """Returns poses of a lidar, float64 [times, 4, 4], proper; its scale is ignored.

    Raises:
        StageError: It is mirrored, sheared or projective, has no inverse, or is not finite.
    """
    matrices = values.matrices(prim, times, of_world=True)
    require_invertible(prim, matrices)
    for word, found in (("mirrored", mirrored(matrices)), ("sheared", sheared(matrices))):
        if found.any():
            at = times[int(np.argmax(found))].GetValue()
            raise StageError(
                f"{prim.GetPath()}: its transform is {word} at time code {at:g}; a lidar has a "
                "pose: expected moves, turns and scales above 0"
            )
    return frame.pose(matrices)


def straightened(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Makes the axes of matrices [n, 3, 4] orthogonal, as USD does, where they are not."""
    found = np.flatnonzero(sheared(matrices))
    matrices = matrices.copy() if len(found) else matrices
    for at in found.tolist():
        turn = Gf.Matrix3d(*matrices[at, :, :3].T.ravel().tolist()).GetOrthonormalized(False)
        matrices[at, :, :3] = np.array(turn).T
    return matrices


def require_invertible(prim: Usd.Prim, matrices: NDArray[np.float64]) -> None:
    """Ends where an axis has no length, or lies in the plane of the others.

    Raises:
        StageError: So it is.
    """
    if flat(matrices).any():
        raise StageError(
            f"{prim.GetPath()}: its transform has no inverse: it needs an invertible transform, as "
            "it has a pose"
        )


def flat(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tells which matrices [..., 3, 4] have no inverse: axes in a plane, or of no length."""
    with np.errstate(all="ignore"):
        axes = matrices[..., :3] / _lengths(matrices)[..., None, :]
        found: NDArray[np.bool_] = ~(np.abs(np.linalg.det(axes)) > _FLAT)
    return found


def mirrored(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tells which matrices [..., 3, 4] are mirrored: right hands become left ones."""
    return affine.mirrored(matrices[..., :3] / _lengths(matrices)[..., None, :])


def stretched(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tells which matrices [..., 3, 4] scale one axis more than another."""
    lengths = _lengths(matrices)
    found: NDArray[np.bool_] = lengths.max(axis=-1) > (1.0 + _TOLERANCE) * lengths.min(axis=-1)
    return found


def sheared(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tells which matrices [..., 3, 4] have axes that are not at right angles."""
    with np.errstate(invalid="ignore"):
        axes = matrices[..., :3] / _lengths(matrices)[..., None, :]
    x, y, z = np.moveaxis(axes, -1, 0)
    cosines = np.stack([(x * y).sum(axis=-1), (y * z).sum(axis=-1), (z * x).sum(axis=-1)])
    found: NDArray[np.bool_] = np.abs(cosines).max(axis=0) > _TOLERANCE
    return found


def _lengths(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths: NDArray[np.float64] = np.sqrt((matrices[..., :3] ** 2).sum(axis=-2))
    return lengths
