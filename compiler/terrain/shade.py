"""Shades the ground by what it is: dark where it is steep, bright where dust gathers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scenec.compiler.terrain.condition import Condition, product
from scenec.compiler.terrain.grid import HeightField
from scenec.compiler.terrain.quantities import Quantities


@dataclass(frozen=True)
class Shade:
    """Ground that is darker or lighter.

    Attributes:
        by: What is added to the albedo's variation, below 0 for darker ground.
        where: Conditions; their weights multiply.
    """

    by: float
    where: tuple[Condition, ...]


def shade(shades: Sequence[Shade], field: HeightField) -> HeightField | None:
    """What all of them add at a relief's samples, and between them; None: there are none."""
    if not shades:
        return None
    quantities = Quantities(field.grid, field.height)
    added = np.zeros(field.grid.shape)
    for one in shades:
        added += one.by * product(one.where, quantities)
    return HeightField(field.grid, added)
