"""Reads a USD stage, ours or anybody's, into a RenderScene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenec.backends.reader.stage import read_stage

__all__ = ["read_stage"]


def __getattr__(name: str) -> Any:
    # Who only opens a stage, as ``scenec explain`` does, loads no kernels.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from scenec.backends.reader import stage

    return getattr(stage, name)
