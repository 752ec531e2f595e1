"""Mitsuba 3 as a backend: one flattened mesh per material, sky and suns as one emitter."""

from scenec.backends.mitsuba.adapter import Mitsuba

__all__ = ["Mitsuba"]
