"""Looks up installed packages: those of extras, and versions."""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any

from scenec.schemas.errors import OutputError


@cache
def version_of(distribution: str = "scenec") -> str:
    """Returns a package's version; looked up once a process, since that takes milliseconds.

    Args:
        distribution: Name of the package, as pip knows it.

    Raises:
        importlib.metadata.PackageNotFoundError: It is not installed.
    """
    # Commands that have no use for it need not load what reads metadata.
    from importlib.metadata import version

    return version(distribution)


def optional(package: str, message: str) -> Any:
    """A package that an extra brings.

    Raises:
        OutputError: It is not installed; ``message`` says what to do.
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise OutputError(message) from error
