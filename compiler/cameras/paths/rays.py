"""Casts rays against the grid's heights: does a camera see ground, and how steeply."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import HeightField, surface_height
from scenec.schemas.kernels import kernel


def span_of(field: HeightField) -> NDArray[np.float64]:
    """Lowest and highest height, float64 [2]: once for all rays."""
    return np.array([float(field.height.min()), float(field.height.max())])


def hits(
    field: HeightField,
    span: NDArray[np.float64],
    eye: NDArray[np.float64],
    way: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Returns how far each ray goes until it is below the terrain, meters; inf where it never is.

    Steps are half a spacing long in plan, or shorter near the ground, and the crossing is bisected;
    a spike narrower than that can be missed, which only a limit on what is seen hears of.

    Args:
        field: The terrain; beyond it there is nothing.
        eye: float64 [3].
        way: Unit directions, float64 [n, 3].
    """
    out = np.empty(len(way))
    half = 0.5 * np.array(field.grid.size_m)
    _hits(field.height, field.frame(), half, span, eye, np.ascontiguousarray(way), out)
    return out


def normal_at(field: HeightField, x: float, y: float) -> NDArray[np.float64]:
    """Unit normal of the ground over two spacings, float64 [3]."""
    dx, dy = field.grid.spacing_m
    frame = field.frame()
    east = surface_height(field.height, *frame, x + dx, y)
    west = surface_height(field.height, *frame, x - dx, y)
    north = surface_height(field.height, *frame, x, y + dy)
    south = surface_height(field.height, *frame, x, y - dy)
    normal = np.array([(west - east) / (2.0 * dx), (south - north) / (2.0 * dy), 1.0])
    return normal / np.sqrt((normal * normal).sum())


@kernel
def _hits(height, frame, half, span, eye, way, out):  # type: ignore[no-untyped-def]
    """Fills ``out`` for ``hits``; ``frame`` is the field's, ``half`` its half extent in x and y."""
    x0, y0, dx, dy = frame
    step_plan = 0.5 * min(dx, dy)
    for n in range(len(way)):
        out[n] = np.inf
        # The part of the ray over the terrain and below its highest point.
        low, high = 0.0, np.inf
        for k in range(3):
            bottom = -half[k] if k < 2 else span[0] - 1.0
            top = half[k] if k < 2 else span[1] + 1e-9 * (1.0 + abs(span[1]))
            if abs(way[n, k]) < 1e-300:
                if eye[k] < bottom or eye[k] > top:
                    high = -1.0
                continue
            a = (bottom - eye[k]) / way[n, k]
            b = (top - eye[k]) / way[n, k]
            low = max(low, min(a, b))
            high = min(high, max(a, b))
        if high < low:
            continue
        level = np.sqrt(way[n, 0] * way[n, 0] + way[n, 1] * way[n, 1])
        # A ray that is all but vertical crosses the ground within few steps of height.
        step = step_plan / max(level, 1e-3)
        steps = int(np.ceil((high - low) / step)) + 1
        before = low
        for i in range(steps + 1):
            t = min(low + i * step, high)
            x, y, z = eye[0] + t * way[n, 0], eye[1] + t * way[n, 1], eye[2] + t * way[n, 2]
            if z <= surface_height(height, x0, y0, dx, dy, x, y):
                near, far = before, t
                for _ in range(40):
                    t = 0.5 * (near + far)
                    x, y = eye[0] + t * way[n, 0], eye[1] + t * way[n, 1]
                    z = eye[2] + t * way[n, 2]
                    if z <= surface_height(height, x0, y0, dx, dy, x, y):
                        far = t
                    else:
                        near = t
                out[n] = far
                break
            before = t
