"""The camera of a stage that comes nearest to a point."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenec.schemas import stage as names

#: No camera counts as nearer, meters: the compiler's own measure (``compiler.views.resolution``).
_NEAREST_M = 0.05


@dataclass(frozen=True)
class Sight:
    """Holds the nearest camera's view of a point.

    Attributes:
        camera: Prim path.
        sample: Time code.
        distance_m: From it to the point.
        pixels_per_m: That a meter across the view takes there.
    """

    camera: str
    sample: int
    distance_m: float
    pixels_per_m: float

    @property
    def text(self) -> str:
        """In one line."""
        return f"{self.camera} at sample {self.sample}, {self.distance_m:.3g} m away"


def nearest_camera(path: Path, point: tuple[float, float, float]) -> Sight | None:
    """The camera and sample from which a meter at a point takes the most pixels.

    Whether the camera looks at the point is not asked.

    Args:
        path: Root layer of a stage of ours.
        point: World, meters.

    Returns:
        None where there is no camera.
    """
    from scenec.backends.stage.sources import open_stage

    with open_stage(path) as stage:
        return _nearest(stage, point)


def _nearest(stage: Any, point: tuple[float, float, float]) -> Sight | None:
    from pxr import Usd, UsdGeom

    codes = range(int(stage.GetStartTimeCode()), int(stage.GetEndTimeCode()) + 1)
    best: Sight | None = None
    for prim in stage.Traverse():
        if not prim.IsA(UsdGeom.Camera):
            continue
        k = prim.GetAttribute(names.ATTR_INTRINSICS).Get()
        if k is None:
            continue
        focal = max(float(k[0]), float(k[4]))
        for code in codes:
            matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode(code))
            away = np.array(matrix.ExtractTranslation()) - np.array(point)
            distance = math.sqrt(float((away * away).sum()))
            pixels = focal / max(distance, _NEAREST_M)
            if best is None or pixels > best.pixels_per_m:
                best = Sight(str(prim.GetPath()), code, distance, pixels)
    return best
