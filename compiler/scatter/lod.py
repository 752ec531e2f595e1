"""Levels of detail: each instance as coarse as no view can tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from scenec.compiler.cameras.sight import NEAREST_M, Views, pixels_of_balls
from scenec.compiler.scatter.rocks import Chain
from scenec.compiler.scene import Prototype, Scatter


def choose_levels(
    scatter: Scatter, chains: Sequence[Chain], views: Views, unseen: float, tolerance_px: float
) -> tuple[Scatter, dict[str, Any]]:
    """Gives every instance the coarsest level whose error no view shows larger than asked.

    Only the shape changes: places, ids and all else stay, and so does the order of instances.
    Meshes that no instance has are dropped.

    Args:
        scatter: Instances of the finest levels.
        chains: The levels of each of its prototypes.
        views: The cameras; what hides behind the ground counts as seen, for a rock stands over it.
        unseen: Part that a pixel counts where no view shows the instance.
        tolerance_px: Largest error; 0 keeps the finest level everywhere.

    Returns:
        The scatter with the levels in use, and what was done, for report.json.
    """
    lengths = np.array([len(chain) for chain in chains], np.int64)
    first = np.cumsum(lengths) - lengths
    meshes = [mesh for chain in chains for mesh in chain]
    triangles = np.array([len(mesh.faces) for mesh in meshes], np.int64)
    errors = np.array([mesh.error for mesh in meshes])
    finest = first[scatter.prototype]
    chosen = finest
    size = scatter.scales.max(axis=1, initial=0.0).astype(np.float64)
    near = np.zeros(scatter.count)
    if len(views.poses) and tolerance_px > 0.0:
        # Small rocks can be looked at from nearer.
        nearest = min(NEAREST_M, 0.5 * float(size.min(initial=NEAREST_M)))
        near = pixels_of_balls(
            views, scatter.positions.astype(np.float64), scatter.radii(), unseen, nearest
        )
        # Errors do not fall along a chain: the last level that passes is the coarsest.
        for level in range(1, int(lengths.max(initial=1))):
            there = level < lengths[scatter.prototype]
            index = np.where(there, finest + level, finest)
            fits = there & (errors[index] * size * near <= tolerance_px)
            chosen = np.where(fits, index, chosen)
    used, prototype = np.unique(chosen, return_inverse=True)
    reached = errors[chosen] * size
    facts = {
        "prototypes": len(used),
        "prototypes_of": len(meshes),
        "triangles": int(triangles[chosen].sum()),
        "triangles_finest": int(triangles[finest].sum()),
        "lod_px": tolerance_px,
        "lod_error_max_px": float((reached * near).max(initial=0.0)),
        "lod_error_max_m": float(reached.max(initial=0.0)),
    }
    return (
        replace(
            scatter,
            prototypes=tuple(meshes[i] for i in used),
            prototype=prototype.astype(np.int32),
        ),
        facts,
    )


def finest(chains: Sequence[Chain]) -> tuple[Prototype, ...]:
    """The finest level of each chain."""
    return tuple(chain[0] for chain in chains)
