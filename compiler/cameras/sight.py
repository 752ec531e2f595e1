"""How closely the cameras of a batch look at each part of the terrain."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from scenec.compiler.scene import Rig
from scenec.compiler.terrain.grid import HeightField

#: Views reach this far beyond their picture's border, in parts of its size: what lies just outside
#: is seen from the next pixel's corner, and casts the nearest shadows.
MARGIN = 0.05
#: No sample counts as nearer than this, meters.
NEAREST_M = 0.05


def pixels_per_meter(
    field: HeightField, rigs: tuple[Rig, ...], unseen: float
) -> NDArray[np.float64]:
    """Pixels that a meter across the view takes at each sample, in the view that shows it largest.

    A sample outside of a view counts with a fraction of that: its shadows and the light it sends
    on may still be seen. What hides behind hills counts as seen.

    Args:
        field: The terrain.
        rigs: Cameras at every sample; none: 0 everywhere.
        unseen: The fraction, in [0, 1].

    Returns:
        float64 [ny, nx].
    """
    views = []
    for rig in rigs:
        for sensor in rig.sensors:
            for pose in rig.to_world:
                camera = np.zeros((3, 4))
                for i in range(3):
                    for j in range(3):
                        for k in range(3):
                            camera[i, j] += pose[i, k] * sensor.to_rig[k, j]
                    camera[i, 3] = pose[i, 3] + sum(
                        pose[i, k] * sensor.to_rig[k, 3] for k in range(3)
                    )
                views.append((camera, (*sensor.intrinsics, *map(float, sensor.resolution))))
    out = np.zeros(field.grid.shape)
    if views:
        _nearest_views(
            np.stack([camera for camera, _ in views]),
            np.array([numbers for _, numbers in views]),
            field.grid.x(),
            field.grid.y(),
            field.height,
            unseen,
            out,
        )
    return out


@njit(cache=True, error_model="numpy", parallel=True)
def _nearest_views(cameras, numbers, x, y, height, unseen, out):  # type: ignore[no-untyped-def]
    for j in prange(y.size):
        for i in range(x.size):
            best = 0.0
            for c in range(cameras.shape[0]):
                m = cameras[c]
                fx, fy, cx, cy, skew, width, rows = numbers[c]
                px, py, pz = x[i] - m[0, 3], y[j] - m[1, 3], height[j, i] - m[2, 3]
                distance = max(np.sqrt(px * px + py * py + pz * pz), 0.05)
                value = max(fx, fy) / distance
                # Most views lose here, which spares the rest.
                if value <= best:
                    continue
                depth = m[0, 2] * px + m[1, 2] * py + m[2, 2] * pz
                seen = False
                if depth > 0.0:
                    right = (m[0, 0] * px + m[1, 0] * py + m[2, 0] * pz) / depth
                    down = (m[0, 1] * px + m[1, 1] * py + m[2, 1] * pz) / depth
                    u = fx * right + skew * down + cx
                    v = fy * down + cy
                    seen = -0.05 * width <= u <= 1.05 * width and -0.05 * rows <= v <= 1.05 * rows
                if not seen:
                    value *= unseen
                best = max(best, value)
            out[j, i] = best
