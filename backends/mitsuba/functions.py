"""Elementary functions of Dr.Jit's arrays, as ``backends.reflectance`` takes them."""

from __future__ import annotations

from typing import Any


def drjit_functions() -> Any:
    """``reflectance.Functions`` of Dr.Jit, which is imported for them."""
    import drjit as dr

    class DrJit:
        """``reflectance.Functions``."""

        sqrt, exp, log = dr.sqrt, dr.exp, dr.log
        arccos, maximum, minimum = dr.acos, dr.maximum, dr.minimum

    return DrJit()
