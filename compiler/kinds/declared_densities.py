"""Declares keys of densities."""

from __future__ import annotations
