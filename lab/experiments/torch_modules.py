"""Imports what needs PyTorch when an experiment runs, and says what to install without it."""

from __future__ import annotations

import importlib
from typing import Any

from scenec.schemas.errors import OutputError


def needing_torch(name: str) -> Any:
    """One of the experiments' modules.

    Raises:
        OutputError: PyTorch or torchvision is not installed.
    """
    try:
        return importlib.import_module(f"scenec.lab.experiments.{name}")
    except ModuleNotFoundError as error:
        if error.name not in ("torch", "torchvision"):
            raise
        raise OutputError(
            f"networks need the package {error.name}: pip install 'scenec[networks]'"
        ) from error
