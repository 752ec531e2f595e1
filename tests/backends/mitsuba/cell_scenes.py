"""Ground in cells, for ``test_mitsuba_stack``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Mesh, RenderScene
from scenec.backends.testing import looks
from scenec.backends.testing.looks import CELLS, COLOR, FAR, SIZE
from scenec.backends.testing.looks import ORIGIN as OFFSET
from scenec.backends.testing.scenes import mesh, plane

__all__ = ["CELLS", "COLOR", "FAR", "OFFSET", "SIZE", "scene", "waves", "write_picture"]


def write_picture(folder: Path, kind: str) -> Path:
    """A small picture without symmetry."""
    return looks.write_picture(folder, "base_color" if kind == "color" else kind)


def scene(folder: Path, kind: str) -> RenderScene:
    """One board of ``looks.mapped``."""
    looks.write_pictures(folder)
    return looks.boards({kind: looks.mapped(folder)[kind]})


def waves(height: float) -> tuple[Mesh, NDArray[np.float32]]:
    """Smooth low ground, and weights of two merges on it."""
    points, faces = plane(8.0, cells=6)
    x, y = points[:, 0], points[:, 1]
    points[:, 2] = height * np.sin(0.5 * x) * np.cos(0.4 * y)
    slope_x = 0.5 * height * np.cos(0.5 * x) * np.cos(0.4 * y)
    slope_y = -0.4 * height * np.sin(0.5 * x) * np.sin(0.4 * y)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    weights = np.stack([np.clip(0.5 + 0.12 * x, 0, 1), np.clip(0.3 - 0.1 * y, 0, 1)])
    return mesh(points, faces, normals=normals), weights.astype(np.float32)
