"""Cycles as a backend, through Blender as a Python module: one instancer for all rows."""

from scenec.backends.cycles.adapter import Cycles

__all__ = ["Cycles"]
