"""Versions of what is installed."""

from __future__ import annotations

from functools import cache


@cache
def version_of(distribution: str = "scenec") -> str:
    """As the package says; asked for once a process, for looking takes some milliseconds.

    Args:
        distribution: Name of the package, as pip knows it.

    Raises:
        importlib.metadata.PackageNotFoundError: It is not installed.
    """
    # Commands that have no use for it need not load what reads metadata.
    from importlib.metadata import version

    return version(distribution)
