"""A ball with a map from three sides, for ``test_mitsuba_stack``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import RenderScene
from scenec.backends.testing import looks, reference
from scenec.backends.testing.looks import write_picture

__all__ = ["differences", "scene", "write_picture"]


def scene(folder: Path, projection: str, kind: str) -> RenderScene:
    """One board of ``looks.projected``."""
    looks.write_pictures(folder)
    name = f"{projection} {kind.removeprefix('base_')}, plain"
    return looks.boards({name: looks.projected(folder)[name]})


def differences(got: NDArray, made: RenderScene) -> tuple[float, float, int]:
    """Root mean square and mean of (got / expected - 1) over sound pixels, and their number."""
    expected = reference.picture(made)
    off = got[expected.sound] / expected.radiance[expected.sound] - 1.0
    return float(np.sqrt(np.mean(off**2))), float(np.mean(off)), int(expected.sound.sum())
