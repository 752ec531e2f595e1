"""Declares a scene of BlenderProc, whichever format it is in."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass
class Object:
    """One object.

    Attributes:
        kind: What model it is of.
        poses: From the model to the world, [4, 4], by the number of the picture.
        category: Id of what it is in the source; 0: none is said.
    """

    kind: str
    poses: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    category: int = 0


@dataclass
class ModelKind:
    """A model.

    Attributes:
        names: Names of files that it may have, without endings.
        unit_m: Meters per unit of its file.
        up: Upward axis of its file, which stays as it is.
        low, high: Corners of its box in meters, where that is known.
    """

    names: tuple[str, ...]
    unit_m: float
    up: str = "z"
    low: NDArray[np.float64] | None = None
    high: NDArray[np.float64] | None = None


@dataclass
class Scene:
    """Holds the content of a scene.

    Attributes:
        poses: Of the camera in each picture: from x right, y down, z ahead to the world.
        matrix: The camera's, by row; of today's pixels, whose first one's middle is (0, 0).
        size: Width and height of pictures.
        objects: All of them.
        kinds: Models by name.
    """

    poses: list[NDArray[np.float64]] = field(default_factory=list)
    matrix: list[float] = field(default_factory=list)
    size: tuple[int, int] = (640, 480)
    objects: list[Object] = field(default_factory=list)
    kinds: dict[str, ModelKind] = field(default_factory=dict)


def model_folders(source: Path) -> list[Path]:
    """Folders that models are kept in: beside a scene, or above it."""
    parents = [source, *list(source.resolve().parents)[:3]]
    names = ("models", "models_eval", "models_cad", ".")
    return [parent / name for parent in parents for name in names if (parent / name).is_dir()]
