"""Shades the ground by what it is: dark where it is steep, bright where dust gathers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from scenec.compiler.kinds import an, forms, key, list_of
from scenec.compiler.terrain.condition import ReliefCondition, product
from scenec.compiler.terrain.grid import HeightField
from scenec.compiler.terrain.quantities import Quantities


@dataclass(frozen=True)
class Shade:
    """Ground darker or lighter where conditions hold: lag on crests, dust in hollows, fresh soil in
    tracks. It crosses borders of layers and has no label.
    """

    EXAMPLE: ClassVar = {
        "by": -0.8,
        "where": [{"type": "slope", "min_deg": 20, "softness_deg": 15}],
    }

    by: float = key(forms.PER_BATCH, at_least=-2, at_most=2)
    """Added to v of the materials' variation, within [-1, 1]: albedo is base_color (1 + variation
    v). Below 0 is darker."""
    where: tuple[ReliefCondition, ...] = key(list_of(an("ground_where"), "One condition.", least=1))
    """Conditions, whose weights multiply; taken at the grid's samples."""


def shade(shades: Sequence[Shade], field: HeightField) -> HeightField | None:
    """Returns the sum of all shades at, and between, a relief's samples; None without shades."""
    if not shades:
        return None
    quantities = Quantities(field.grid, field.height)
    added = np.zeros(field.grid.shape)
    for one in shades:
        added += one.by * product(one.where, quantities)
    return HeightField(field.grid, added)
