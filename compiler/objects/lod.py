"""Chooses levels of detail: each instance as coarse as no view can tell, all within a budget."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.boxes import boxes_of
from scenec.compiler.geometry.rotations import turned
from scenec.compiler.kinds import forms, key
from scenec.compiler.objects.rocks import Chain
from scenec.compiler.scene.objects import Prototype, Scatter
from scenec.compiler.views.resolution import NEAREST_M, Views, pixels_of_balls
from scenec.schemas.codec import Facts
from scenec.schemas.errors import SceneError

#: A ball of this radius is looked at in parts.
LARGE_M = 1.0


@dataclass(frozen=True, kw_only=True)
class ObjectDetail:
    """How much geometry all objects have together."""

    EXAMPLE: ClassVar = {"max_triangles": 20_000_000}

    TITLE: ClassVar = "Object detail"
    max_triangles: int | None = key(forms.COUNT, optional=True, at_least=1, at_most=10_000_000_000)
    """Most triangles of all objects together, each instance counted in full. It coarsens all
    classes beyond lod_px by one factor, which the report states. Left out, lod_px alone decides."""


@dataclass(frozen=True)
class Levels:
    """Holds what the levels of detail of a class's instances would show.

    Attributes:
        scatter: Instances of the finest levels.
        meshes: All levels, chain after chain.
        triangles, errors: Of each mesh; errors in its own unit.
        finest: Index of each instance's finest mesh, int64 [n].
        lengths: Length of each instance's chain, int64 [n].
        near: Pixels of a meter at each instance in the view that shows it largest, [n]; None
            without views.
        tolerance_px: Largest error asked for; 0 keeps the finest level everywhere.
    """

    scatter: Scatter
    meshes: tuple[Prototype, ...]
    triangles: NDArray[np.int64]
    errors: NDArray[np.float64]
    finest: NDArray[np.int64]
    lengths: NDArray[np.int64]
    near: NDArray[np.float64] | None
    tolerance_px: float

    @property
    def size(self) -> NDArray[np.float64]:
        """Scale of each instance, [n]."""
        return self.scatter.scales.max(axis=1, initial=0.0).astype(np.float64)

    def levels_at(
        self, level: int
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.float64]]:
        """Returns which instances have a level; its mesh; its error in pixels, or meters."""
        there = level < self.lengths
        index = np.where(there, self.finest + level, self.finest)
        error = self.errors[index] * self.size
        return there, index, error if self.near is None else error * self.near

    def chosen(self, factor: float | None = None) -> NDArray[np.int64]:
        """Mesh of each instance: the coarsest whose error is at most ``factor`` as large as asked.

        Without a factor, errors are as asked, and where there are no views none is made.
        """
        chosen = self.finest
        if factor is None:
            factor = 0.0 if self.near is None else 1.0
        limit = self.tolerance_px * factor
        if limit == 0.0:
            return chosen
        # Errors do not fall along a chain: the last level that passes is the coarsest.
        for level in range(1, int(self.lengths.max(initial=1))):
            there, index, error = self.levels_at(level)
            chosen = np.where(there & (error <= limit), index, chosen)
        return chosen


def see_levels(
    scatter: Scatter,
    chains: Sequence[Chain],
    views: Views,
    unseen: float,
    tolerance_px: float,
    small_pieces: bool = False,
) -> Levels:
    """Measures what the levels of a class would show in the views.

    Args:
        scatter: Instances of the finest levels.
        views: The cameras; what hides behind the ground counts as seen, for a rock stands over it.
        unseen: Part that a pixel counts where no view shows the instance.
        small_pieces: Whether what differs between levels are leaves, each near to its corners, so
            that large instances are looked at in parts.
    """
    lengths = np.array([len(chain) for chain in chains], np.int64)
    first = np.cumsum(lengths) - lengths
    meshes = tuple(mesh for chain in chains for mesh in chain)
    near = None
    if len(views.eye):
        near = np.zeros(scatter.count)
        if tolerance_px > 0.0:
            radius = scatter.radii()
            # Small rocks can be looked at from nearer.
            nearest = min(NEAREST_M, float(radius.min(initial=NEAREST_M)))
            near = pixels_of_balls(
                views, scatter.positions.astype(np.float64), radius, unseen, nearest
            )
        if tolerance_px > 0.0 and small_pieces:
            coarsest = np.array([chain[-1].error for chain in chains])[scatter.prototype]
            which = np.flatnonzero(coarsest * near * scatter.scales.max(axis=1) > tolerance_px)
            _look_closer(
                scatter,
                which,
                near,
                partial(pixels_of_balls, views, unseen=unseen, nearest_m=nearest),
            )
    return Levels(
        scatter,
        meshes,
        np.array([len(mesh.faces) for mesh in meshes], np.int64),
        np.array([mesh.error for mesh in meshes]),
        first[scatter.prototype],
        lengths[scatter.prototype],
        near,
        tolerance_px,
    )


def _look_closer(
    scatter: Scatter,
    which: NDArray[np.int64],
    near: NDArray[np.float64],
    pixels: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
) -> None:
    """Pixels of a meter at large models by what of them is nearest, not by the ball around all.

    Args:
        which: The instances that are looked at, of which some are large.
        near: Of the balls around instances; becomes what their parts have.
        pixels: Of balls, by their middles and radii.
    """
    radii = scatter.radii()
    for index, mesh in enumerate(scatter.prototypes):
        some = which[(scatter.prototype[which] == index) & (radii[which] > LARGE_M)]
        if not len(some):
            continue
        middles, reach = _balls(mesh.points.astype(np.float64))
        scale = scatter.scales[some].astype(np.float64).max(axis=1)
        turns = turned(scatter.orientations[some], scatter.scales[some])
        at = scatter.positions[some].astype(np.float64)[:, None] + (
            turns[:, None] * middles[:, None]
        ).sum(axis=-1)
        found = pixels(at.reshape(-1, 3), (scale[:, None] * reach).ravel())
        near[some] = np.minimum(near[some], found.reshape(len(some), -1).max(axis=1))


def _balls(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Balls that hold points together, one for each part of a grid that has any: [b, 3], [b]."""
    low, high = points.min(axis=0), points.max(axis=0)
    extent = high - low
    side = max(0.6 * float(extent.min()), 0.2 * float(extent.max()))
    cells = np.minimum((points - low) / side, 5.0).astype(np.int64)
    cell = cells[:, 0] + 8 * (cells[:, 1] + 8 * cells[:, 2])
    number = np.cumsum(np.bincount(cell) > 0) - 1
    cell, count = number[cell], int(number[-1]) + 1
    lowest, highest = boxes_of(points, cell, count)
    middles = 0.5 * (lowest + highest)
    away = points - middles[cell]
    squares = np.zeros(count)
    away *= away
    np.maximum.at(squares, cell, away[:, 0] + away[:, 1] + away[:, 2])
    # Of the numbers' rounding, too.
    return middles, np.sqrt(squares) * (1.0 + 1e-6)


def budget_factor(classes: Sequence[Levels], max_triangles: int, base: int = 0) -> float | None:
    """Returns the factor by which errors must exceed their tolerances to keep to a budget.

    Args:
        classes: All that counts; those whose tolerance is 0 keep their finest levels.
        max_triangles: Most triangles of all instances together, each counted.

    Returns:
        The least factor; None where nothing has to be coarser than asked.

    Raises:
        SceneError: Even the coarsest levels are more.
    """
    total = base + sum(int(c.triangles[c.chosen()].sum()) for c in classes)
    if total <= max_triangles:
        return None
    thresholds, savings = [np.zeros(0)], [np.zeros(0, np.int64)]
    for levels in classes:
        if levels.tolerance_px == 0.0:
            continue
        before = levels.chosen()
        # Errors do not fall along a chain, so these come one after the other at each instance.
        for level in range(1, int(levels.lengths.max(initial=1))):
            there, index, error = levels.levels_at(level)
            there &= index > before
            thresholds.append(error[there] / levels.tolerance_px)
            savings.append(levels.triangles[index[there] - 1] - levels.triangles[index[there]])
    threshold, saved = np.concatenate(thresholds), np.concatenate(savings)
    order = np.argsort(threshold, kind="stable")
    left = total - np.cumsum(saved[order])
    if not len(left) or left[-1] > max_triangles:
        least = int(left[-1]) if len(left) else total
        raise SceneError(
            f"object_detail/max_triangles: all objects together have {least:,} triangles at their "
            f"coarsest levels, more than the {max_triangles:,} asked for: raise it, take fewer "
            "objects, or let classes whose lod_px is 0 have levels"
        )
    # The next larger number, lest the product with the tolerance round below the error.
    reached = float(threshold[order][int(np.argmax(left <= max_triangles))])
    return reached * (1.0 + 1e-12)


def choose_levels(levels: Levels, factor: float | None = None) -> tuple[Scatter, Facts]:
    """Gives every instance its level.

    Only the shape changes: places, ids and all else stay, and so does the order of instances.
    Meshes that no instance has are dropped.

    Returns:
        The scatter with the levels in use, and what was done, for report.json.
    """
    chosen = levels.chosen(factor)
    in_use = np.bincount(chosen, minlength=len(levels.meshes)) > 0
    used, prototype = np.flatnonzero(in_use), (np.cumsum(in_use) - 1)[chosen]
    reached = levels.errors[chosen] * levels.size
    near = 0.0 if levels.near is None else levels.near
    starts = np.unique(levels.finest)
    finest = {i: int(starts[starts <= i].max()) for i in used.tolist()}
    facts: Facts = {
        "prototypes": len(used),
        "prototypes_of": len(levels.meshes),
        "triangles": int(levels.triangles[chosen].sum()),
        "triangles_finest": int(levels.triangles[levels.finest].sum()),
        "lod_px": levels.tolerance_px,
        "lod_error_max_px": float((reached * near).max(initial=0.0)),
        "lod_error_max_m": float(reached.max(initial=0.0)),
        # Errors in parts of an instance's size, for ``scenec explain --why``.
        "levels": {
            levels.meshes[i].name: {
                "triangles": int(levels.triangles[i]),
                "error": float(levels.errors[i]),
                **_color_error(levels.meshes[first], levels.meshes[i]),
            }
            for i, first in finest.items()
        },
    }
    return (
        replace(
            levels.scatter,
            prototypes=tuple(levels.meshes[i] for i in used),
            prototype=prototype.astype(np.int32),
        ),
        facts,
    )


def _color_error(finest: Prototype, mesh: Prototype) -> dict[str, float]:
    """How far a level's mean color of corners is from the finest one's, in the worst channel."""
    if finest.colors is None:
        return {}
    return {"color_error": float(np.abs(_mean_color(mesh) - _mean_color(finest)).max())}


def _mean_color(mesh: Prototype) -> NDArray[np.float64]:
    """Factors of the base color, the mean over a mesh's area, [3]."""
    assert mesh.colors is not None
    a, b, c = (mesh.points[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    normal = np.cross(b - a, c - a)
    area = np.sqrt((normal * normal).sum(axis=1))
    of_face = mesh.colors.astype(np.float64).mean(axis=1)
    mean: NDArray[np.float64] = (of_face * area[:, None]).sum(axis=0) / area.sum()
    return mean
