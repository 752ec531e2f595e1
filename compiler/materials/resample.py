"""Resamples pictures to other sizes: all repeat, and texels stand for their middles."""

from __future__ import annotations

import numpy as np

from scenec.compiler.materials.periodic import Plane


def resampled(plane: Plane, high: int, wide: int) -> Plane:
    """A repeating picture looked up at the texel centers of another, bilinearly.

    Where it is to become smaller by whole powers of two it is averaged first.
    """
    while plane.shape[0] >= 2 * high and plane.shape[1] >= 2 * wide:
        if plane.shape[0] % 2 or plane.shape[1] % 2:
            break
        plane = box(plane)
    rows, columns = plane.shape
    y = (np.arange(high) + 0.5) * (rows / high) - 0.5
    x = (np.arange(wide) + 0.5) * (columns / wide) - 0.5
    j, i = np.floor(y).astype(np.int64), np.floor(x).astype(np.int64)
    down = (y - j).astype(np.float32)[:, None]
    across = (x - i).astype(np.float32)[None, :]
    upper, lower = plane[j % rows], plane[(j + 1) % rows]
    one = np.float32(1.0)
    top = upper[:, i % columns] * (one - across) + upper[:, (i + 1) % columns] * across
    bottom = lower[:, i % columns] * (one - across) + lower[:, (i + 1) % columns] * across
    return np.asarray(top * (one - down) + bottom * down, np.float32)


def box(plane: Plane) -> Plane:
    """Means of two by two texels of a picture [h, w, ...] of even sides."""
    even, odd = plane[0::2], plane[1::2]
    total = (even[:, 0::2] + even[:, 1::2]) + (odd[:, 0::2] + odd[:, 1::2])
    return np.asarray(total * np.float32(0.25), np.float32)


def doubled(plane: Plane) -> Plane:
    """A picture of twice the sides, bilinear: ``resampled``, sooner."""
    for axis in (0, 1):
        near = plane * np.float32(0.75)
        far = plane * np.float32(0.25)
        low, high = near + np.roll(far, 1, axis), near + np.roll(far, -1, axis)
        shape = list(plane.shape)
        shape[axis] *= 2
        plane = np.stack([low, high], axis=axis + 1).reshape(shape)
    return plane
