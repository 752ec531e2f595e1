"""Keys that all kinds of a choice have, beside their own: see ``table.Choice.shared``.

Kinds of this package declare most of them themselves, each with what it means there.
"""

from __future__ import annotations

from typing import Any

from scenec.compiler.kinds import forms
from scenec.compiler.kinds.declare import Form, bounded
from scenec.compiler.kinds.table import is_builtin
from scenec.schemas.codec import JsonObject

#: Keys with their keywords, and whether they must be given.
Keys = dict[str, tuple[JsonObject, bool]]


def _optional(**keys: Form) -> Keys:
    return {name: (dict(form.keywords), False) for name, form in keys.items()}


def of_relief(kind: type[Any]) -> Keys:
    """Returns the mask, which every operator can have."""
    return _optional(mask=forms.MASK)


def of_conditions(kind: type[Any]) -> Keys:
    """Returns the bounds of another package's quantity, which may have a ``UNIT``."""
    if is_builtin(kind):
        return {}
    unit = getattr(kind, "UNIT", "")
    end = f"_{unit}" if unit else ""
    bound = bounded(forms.PER_BATCH, unit=unit or None)
    return _optional(**{
        f"min{end}": bound.but(description="Smallest."),
        f"max{end}": bound.but(description="Largest."),
        f"softness{end}": bounded(bound, at_least=0).but(
            default=0, description="Width over which it fades about a bound."
        ),
        "ragged": forms.RAGGED,
    })  # fmt: skip


def of_surfaces(kind: type[Any]) -> Keys:
    """Returns whether the relief becomes geometry; with a ``SCHEMA``, all that is asked of one."""
    if not hasattr(kind, "SCHEMA"):
        return _optional(displacement=forms.SURFACE_DISPLACEMENT)
    return _optional(
        relief_m=forms.SURFACE_RELIEF_M,
        contrast=forms.SURFACE_CONTRAST,
        resolution=forms.SURFACE_RESOLUTION,
        displacement=forms.SURFACE_DISPLACEMENT,
    )


def of_skies(kind: type[Any]) -> Keys:
    """Returns the labels, which every sky can have."""
    return _optional(labels=forms.SKY_LABELS, labels_below=forms.SKY_LABELS_BELOW)


def of_poses(kind: type[Any]) -> Keys:
    """Returns when another package's motion is sampled, if it does not declare it itself."""
    if not hasattr(kind, "SCHEMA"):
        return {}
    return _optional(sampling=forms.SAMPLING)
