"""What keeps maps from repeating, how layers heed heights, and what surfaces give off."""

from __future__ import annotations

import math

import numpy as np
from pxr import Usd, UsdGeom

from scenec.backends.stage import values
from scenec.backends.stage.scene import Cells
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError


def read_cells(prim: Usd.Prim, projection: str) -> Cells | None:
    """A material's cells, or None; the seed is 0 where it is not authored.

    Raises:
        StageError: A size that is not above 0, or another projection than from above.
    """
    attribute = prim.GetAttribute(names.ATTR_MAP_CELL_SIZE)
    if values.value_of(attribute) is None:
        return None
    size_m = values.number(attribute, 0.0) * UsdGeom.GetStageMetersPerUnit(prim.GetStage())
    if not 0.0 < size_m < math.inf:
        raise StageError(f"{prim.GetPath()}: {names.ATTR_MAP_CELL_SIZE} must be above 0")
    _require_above(prim, names.ATTR_MAP_CELL_SIZE, projection)
    seed = values.whole(prim.GetAttribute(names.ATTR_MAP_CELL_SEED), 0)
    if not 0 <= seed < 2**32:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_MAP_CELL_SEED} is {seed}, expected a whole number "
            "from 0 to 2**32 - 1"
        )
    return Cells(size_m, seed)


def read_far(prim: Usd.Prim, projection: str) -> tuple[float, float] | None:
    """A material's (factor, share) of the colors' larger scale, or None.

    Raises:
        StageError: A factor below 1, a share outside of [0, 1], or another projection than from
            above.
    """
    found = values.vector(prim.GetAttribute(names.ATTR_MAP_FAR), 2)
    if found is None:
        return None
    factor, share = found
    if not (1.0 <= factor < math.inf and 0.0 <= share <= 1.0):
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_MAP_FAR} is ({factor:g}, {share:g}), expected a factor "
            "of at least 1 and a share in [0, 1]"
        )
    _require_above(prim, names.ATTR_MAP_FAR, projection)
    return (factor, share) if share > 0.0 else None


def read_emission(prim: Usd.Prim) -> tuple[float, float, float]:
    """Radiance that a material gives off; black where none is authored.

    Raises:
        StageError: Not three finite numbers, none below 0.
    """
    found = values.vector(prim.GetAttribute(names.ATTR_EMISSION), 3)
    if found is None:
        return (0.0, 0.0, 0.0)
    red, green, blue = found
    if not all(0.0 <= value < math.inf for value in found):
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_EMISSION} is {found}, expected finite numbers, none "
            "below 0"
        )
    return (red, green, blue)


def read_height_blends(prim: Usd.Prim, merges: int) -> tuple[float, ...]:
    """Depths of a mesh's merges; empty where all are 0.

    Raises:
        StageError: Not one finite number, not below 0, for each merge.
    """
    name = names.ATTR_HEIGHT_BLENDS
    attribute = prim.GetAttribute(name)
    if values.value_of(attribute) is None:
        return ()
    found = tuple(values.array(attribute, np.float64).tolist())
    if len(found) != merges or not all(0.0 <= depth < math.inf for depth in found):
        raise StageError(
            f"{prim.GetPath()}: {name} must hold {merges} finite floats, one a merge and none "
            f"below 0, has {list(found)}"
        )
    return found if any(found) else ()


def _require_above(prim: Usd.Prim, name: str, projection: str) -> None:
    if projection != "above":
        raise StageError(
            f"{prim.GetPath()}: {name} is for maps of the projection above, not {projection}"
        )
