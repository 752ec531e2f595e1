"""From a stage's units and up axis to the contract's frame: meters, Z up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.schemas.errors import StageError
from scenec.schemas.spelling import shown

#: Y-up to Z-up: x stays, y becomes z, z becomes -y.
_Y_TO_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

#: Units that a stage may have: from less than a nanometer to more than a light year.
_LEAST_M, _MOST_M = 1e-12, 1e17


@dataclass(frozen=True)
class StageFrame:
    """Converts the stage's world to the contract's.

    Attributes:
        meters_per_unit: Length of a stage unit.
        turn: Rotation to Z up, float64 [3, 3].
    """

    meters_per_unit: float
    turn: NDArray[np.float64]

    @classmethod
    def of(cls, stage: Usd.Stage) -> StageFrame:
        """Reads the frame that the stage declares.

        Raises:
            StageError: A unit or an axis that cannot be.
        """
        unit = UsdGeom.GetStageMetersPerUnit(stage)
        if not _LEAST_M <= unit <= _MOST_M:
            name = stage.GetRootLayer().GetDisplayName()
            raise StageError(
                f"{name}: metersPerUnit is {unit:g}, expected a number above 0, from {_LEAST_M:g} "
                f"to {_MOST_M:g}"
            )
        up = UsdGeom.GetStageUpAxis(stage)
        if up not in (UsdGeom.Tokens.y, UsdGeom.Tokens.z):
            name = stage.GetRootLayer().GetDisplayName()
            raise StageError(f"{name}: upAxis is {shown(str(up))}, expected Y or Z")
        return cls(unit, _Y_TO_Z if up == UsdGeom.Tokens.y else np.eye(3))

    def affine(self, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        """Local-to-world in meters, Z up, from one in stage units: float64 [..., 3, 4]."""
        if self.meters_per_unit == 1.0 and (self.turn == np.eye(3)).all():
            return matrix
        return self.meters_per_unit * (self.turn @ matrix)

    def pose(self, matrices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Unit axes and origins (meters, Z up) of local-to-world matrices: float64 [..., 4, 4].

        Args:
            matrices: Float64 [..., 3, 4], in stage units.
        """
        poses = np.zeros((*matrices.shape[:-2], 4, 4))
        axes = self.turn @ matrices[..., :3]
        poses[..., :3, :3] = axes / np.sqrt((axes * axes).sum(axis=-2, keepdims=True))
        poses[..., :3, 3] = self.meters_per_unit * (self.turn @ matrices[..., 3:])[..., 0]
        poses[..., 3, 3] = 1.0
        return poses


def composed(parent: NDArray[np.float64], child: NDArray[np.float64]) -> NDArray[np.float64]:
    """Parent * child for affine matrices [..., 3, 4], broadcast over leading axes."""
    out = parent[..., :3] @ child
    out[..., 3] += parent[..., 3]
    return out
