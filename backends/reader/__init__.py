"""Reads a USD stage, ours or anybody's, into a RenderScene."""

from scenec.backends.reader.stage import read_stage

__all__ = ["read_stage"]
