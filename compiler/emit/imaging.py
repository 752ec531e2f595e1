"""Writes a sensor's imaging as attributes of its camera (``scenec.schemas.imaging``)."""

from __future__ import annotations

from collections.abc import Sequence

from pxr import Sdf, Usd

from scenec.compiler.emit.layer import author
from scenec.schemas import imaging as formulas
from scenec.schemas.imaging import Imaging


def write_imaging(prim: Usd.Prim, samples: Sequence[Imaging]) -> None:
    """Author what differs from the defaults, and the rule, which says that there is imaging.

    Args:
        prim: The camera.
        samples: At each sample.
    """
    usual = Imaging()
    for field, kind in formulas.TYPES.items():
        values = [getattr(imaging, field) for imaging in samples]
        if field != "rule" and all(value == getattr(usual, field) for value in values):
            continue
        made = prim.CreateAttribute(
            formulas.attribute(field), getattr(Sdf.ValueTypeNames, kind), custom=True
        )
        author(made, [list(v) if isinstance(v, tuple) else v for v in values])
