"""Meshes a height field, uncut: the whole grid, or what shows of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import count
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.forms import CONSTANT, COUNT
from scenec.compiler.mesh import adaptive
from scenec.compiler.mesh.cut import CutMesh
from scenec.compiler.mesh.merge import Merge, label_index
from scenec.compiler.mesh.refine import RefineLimits, refine
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.terrain.grid import HeightField, cuts_main_diagonal, gradient
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.compiler.views.resolution import Views
from scenec.schemas.codec import Facts
from scenec.schemas.kernels import kernel

#: What a shading deviation is allowed to be: of a weight, of the albedo variation, of a slope.
WEIGHT_STEP, VARIATION_STEP, SLOPE_STEP = 0.15, 0.2, 0.1
# Shortest legs in parts of the grid's spacing; how the tolerance grows while over the budget.
_FINEST = 32.0
_RELAX = 1.189207115002721
_TRIES = 16
_LEAP = 1e60


@dataclass(frozen=True)
class Meshing:
    """Triangles are as large as no view shows an error above tolerance_px: of height, of label
    lines, and of shading where legs exceed six times that. Near cameras they are finer than the
    grid.
    """

    EXAMPLE: ClassVar = {"tolerance_px": 0.5, "max_triangles": 2_000_000}

    tolerance_px: float | None = key(CONSTANT, default=0.5, at_least=0, at_most=1000, unit="px")
    """Error that may show; 0 keeps every height sample."""
    max_triangles: int = key(COUNT, default=8_000_000, at_least=2, at_most=1_000_000_000)
    """Budget, before cuts along label lines; where it binds, tolerance is raised and reported."""
    unseen: float = key(CONSTANT, default=0.125, at_least=0, at_most=1)
    """How much a pixel counts where no view shows the ground, which may still cast shadows and
    light into one."""
    finest_m: float | None = key(CONSTANT, optional=True, above=0, at_most=1_000_000, unit="m")
    """Shortest leg of a triangle that is still halved; left out, a 32nd of the spacing. From
    spacing_m on, nothing is finer than the grid."""

    def finest(self, spacing_m: float) -> float:
        """Shortest leg that may be halved, on a grid of a spacing, meters."""
        return spacing_m / _FINEST if self.finest_m is None else self.finest_m


@dataclass(frozen=True)
class GroundAppearance:
    """Holds the layers and albedo of the ground, at points of any shape.

    Attributes:
        sides: Of the merges, float64 [k, ...].
        variation: Of the albedo, float64 [...].
    """

    sides: NDArray[np.float64]
    variation: NDArray[np.float64]


def grid_mesh(field: HeightField) -> CutMesh:
    """Two triangles a cell."""
    return _mesh(field, _grid_faces(*field.grid.shape))[0]


def base_mesh(surface: MeshSurface) -> CutMesh:
    """The triangles of a surface that is a mesh, ordered by the cells that their middles lie over.

    What lies beyond the terrain's rectangle counts to the cells at its border.
    """
    x0, y0, dx, dy = surface.frame()
    rows, columns = (n - 1 for n in surface.grid.shape)
    middle = surface.points[surface.faces, :2].mean(axis=1)
    # Clipped as floats: far outside they must not overflow an index.
    column = np.clip((middle[:, 0] - x0) / dx, 0, columns - 1).astype(np.int32)
    row = np.clip((middle[:, 1] - y0) / dy, 0, rows - 1).astype(np.int32)
    cell = row * columns + column
    order = np.argsort(cell, kind="stable")
    return CutMesh.uncut(surface.points, surface.faces[order], cell[order], surface.vertex_normals)


def adaptive_mesh(
    surface: GroundSurface,
    appearance: GroundAppearance,
    pixels_per_m: NDArray[np.float64],
    views: Views,
    meshing: Meshing,
) -> tuple[CutMesh, GroundAppearance, Facts]:
    """Triangles as large as the tolerance lets them be.

    Args:
        appearance: What lies on the ground, at the grid's samples.
        pixels_per_m: See ``views.resolution``.
        views: The cameras, for triangles finer than the grid.

    Returns:
        The mesh; what lies at its vertices, as far as that is known: the first ones; and what it
        left out, measured against the grid's samples and against the surface.
    """
    assert meshing.tolerance_px is not None
    field = surface.field
    channels = _channels(field, surface.merges, appearance, pixels_per_m)
    # Only where the budget binds.
    errors = cache(partial(adaptive.vertex_errors, channels, meshing.tolerance_px))
    spacing = max(field.grid.spacing_m)
    tolerance = meshing.tolerance_px
    factor = _RELAX * _RELAX
    while True:
        tolerance, faces = _within_budget(channels, errors, meshing, tolerance)
        mesh, samples = _mesh(field, faces)
        known = GroundAppearance(
            appearance.sides.reshape(-1, field.height.size)[:, samples],
            appearance.variation.reshape(-1)[samples],
        )
        finer = None
        reached, worst_m, rms_m = _measured(field, faces, pixels_per_m)
        if not surface.smooth:
            break
        limits = RefineLimits(
            tolerance,
            meshing.finest(spacing),
            # Where not even the coarsest mesh is within the budget it is not made finer.
            max(meshing.max_triangles, len(faces)),
            meshing.unseen,
        )
        result = refine(mesh, known.sides, surface, views, limits)
        if result is not None:
            mesh, sides, finer = result
            known = replace(known, sides=sides)
            break
        tolerance *= factor
        # Each try is a whole mesh: far off, their number must stay small.
        factor = min(factor * factor, _LEAP)
    return (
        mesh,
        known,
        {
            "tolerance_px": meshing.tolerance_px,
            "budget_bound": tolerance > meshing.tolerance_px,
            "tolerance_reached_px": tolerance,
            "height_error_max_px": reached,
            "height_error_max_m": worst_m,
            "height_error_rms_m": rms_m,
            "triangles": len(mesh.faces),
            "triangles_of_grid": 2 * (field.grid.shape[0] - 1) * (field.grid.shape[1] - 1),
            **({"finer": finer} if finer else {}),
        },
    )


def _channels(
    field: HeightField,
    merges: Sequence[Merge],
    appearance: GroundAppearance,
    pixels_per_m: NDArray[np.float64],
) -> adaptive.Channels:
    shape, spacing = field.grid.shape, field.grid.spacing_m
    shades = np.empty((3 + len(merges), *shape))
    np.divide(appearance.variation.reshape(shape), VARIATION_STEP, out=shades[0])
    np.divide(gradient(field.height, *spacing), SLOPE_STEP, out=shades[1:3])
    for merge, side, shade in zip(merges, appearance.sides, shades[3:], strict=True):
        np.divide(merge.weight_of_side(side), WEIGHT_STEP, out=shade)
    return adaptive.Channels(field.height, appearance.sides, shades, spacing, pixels_per_m)


def label_error(
    field: HeightField,
    mesh: CutMesh,
    layer: NDArray[np.int32],
    sides: NDArray[np.float64],
    pixels_per_m: NDArray[np.float64],
) -> float:
    """Returns how far beyond the line of its label the worst mislabeled sample is, pixels.

    Args:
        layer: Label of its faces, int32 [m].
        sides: Of the merges at the samples, [k, ny, nx].
        pixels_per_m: See ``views.resolution``.
    """
    right = np.zeros(field.grid.shape, bool)
    truth = label_index(sides)
    x0, y0, dx, dy = field.frame()
    u, v = (mesh.points[:, 0] - x0) / dx, (mesh.points[:, 1] - y0) / dy
    _mark_right(np.stack([u, v], axis=1), mesh.faces, layer, truth, right)
    rows, columns = np.nonzero(~right)
    if not len(rows):
        return 0.0
    distance = np.minimum.reduce([_distances(side, rows, columns, dx, dy) for side in sides])
    return float((distance * pixels_per_m[rows, columns]).max())


@kernel
def _distances(side, rows, columns, dx, dy):  # type: ignore[no-untyped-def]
    """Returns the distances of some samples to a field's zero line, meters, float64 [n]."""
    out = np.empty(len(rows))
    for n in range(len(rows)):
        out[n] = adaptive.distance_to_line(side, rows[n], columns[n], dx, dy)
    return out


@kernel
def _mark_right(points, faces, layer, truth, right):  # type: ignore[no-untyped-def]
    """Samples that lie in (or on the border of) a face of their label."""
    ny, nx = truth.shape
    hair = 1e-9
    for f in range(len(faces)):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        det = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        first_y = max(int(np.ceil(min(a[1], min(b[1], c[1])) - hair)), 0)
        last_y = min(int(np.floor(max(a[1], max(b[1], c[1])) + hair)), ny - 1)
        first_x = max(int(np.ceil(min(a[0], min(b[0], c[0])) - hair)), 0)
        last_x = min(int(np.floor(max(a[0], max(b[0], c[0])) + hair)), nx - 1)
        for y in range(first_y, last_y + 1):
            for x in range(first_x, last_x + 1):
                if truth[y, x] != layer[f]:
                    continue
                u = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / det
                v = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / det
                if u >= -hair and v >= -hair and u + v <= 1.0 + hair:
                    right[y, x] = True


def _within_budget(
    channels: adaptive.Channels,
    measured: Callable[[], NDArray[np.float32]],
    meshing: Meshing,
    tolerance: float,
) -> tuple[float, NDArray[np.int32]]:
    """A tolerance, or the smallest of 2^(1/4) times it and so on that the budget allows.

    From sixteen times on the steps grow. ``measured`` gives the errors of all samples.
    """
    shape = channels.height.shape
    if tolerance == meshing.tolerance_px:
        faces = adaptive.triangles(adaptive.needed(channels, tolerance), shape)
        if len(faces) <= meshing.max_triangles:
            return tolerance, faces
    errors = measured()
    factor = _RELAX
    for tries in count(1):
        faces = adaptive.triangles(adaptive.activate(errors, tolerance), shape)
        # The coarsest mesh there is may be over the budget: then it is what comes out.
        coarsest = not (errors[np.isfinite(errors)] > tolerance).any()
        if len(faces) <= meshing.max_triangles or coarsest:
            return tolerance, faces
        tolerance *= factor
        if tries >= _TRIES:
            factor = min(factor * factor, _LEAP)
    raise AssertionError("the coarsest mesh is always taken")


def _mesh(field: HeightField, faces: NDArray[np.int32]) -> tuple[CutMesh, NDArray[np.int64]]:
    """A mesh whose vertices are the samples in use, in the grid's order; which these are."""
    nx = field.grid.shape[1]
    used = np.zeros(field.height.size, bool)
    used[faces.ravel()] = True
    samples = np.flatnonzero(used)
    number = (np.cumsum(used) - 1).astype(np.int32)
    x, y = field.grid.x()[samples % nx], field.grid.y()[samples // nx]
    points = np.stack([x, y, field.height.ravel()[samples]], axis=1)
    normals = _normals(field.height, *field.grid.spacing_m, samples)
    return CutMesh.uncut(points, number[faces], _cells(faces, nx), normals), samples


@kernel
def _normals(height, dx, dy, samples):  # type: ignore[no-untyped-def]
    """``HeightField.normals`` at some samples, float64 [n, 3]."""
    ny, nx = height.shape
    out = np.empty((len(samples), 3))
    for n in range(len(samples)):
        j, i = divmod(samples[n], nx)
        i0, i1, j0, j1 = max(i - 1, 0), min(i + 1, nx - 1), max(j - 1, 0), min(j + 1, ny - 1)
        gx = (height[j, i1] - height[j, i0]) / ((i1 - i0) * dx)
        gy = (height[j1, i] - height[j0, i]) / ((j1 - j0) * dy)
        length = np.sqrt(gx * gx + gy * gy + 1.0)
        out[n, 0], out[n, 1], out[n, 2] = -gx / length, -gy / length, 1.0 / length
    return out


@kernel
def _cells(faces: NDArray, nx: int) -> NDArray:
    """Cell that holds the middle of each face, int32."""
    out = np.empty(len(faces), np.int32)
    for f in range(len(faces)):
        column = row = 0
        for vertex in faces[f]:
            column += vertex % nx
            row += vertex // nx
        out[f] = row // 3 * (nx - 1) + column // 3
    return out


@kernel
def _grid_faces(ny: int, nx: int) -> NDArray:
    faces = np.empty((2 * (nx - 1) * (ny - 1), 3), np.int32)
    n = 0
    for j in range(ny - 1):
        for i in range(nx - 1):
            a = j * nx + i
            b, c, d = a + 1, a + nx, a + nx + 1
            if cuts_main_diagonal(i, j):
                first, second = (a, b, d), (a, d, c)
            else:
                first, second = (a, b, c), (b, d, c)
            for k in range(3):
                faces[n, k] = first[k]
                faces[n + 1, k] = second[k]
            n += 2
    return faces


def _measured(
    field: HeightField, faces: NDArray[np.int32], pixels_per_m: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Deviation of the mesh from the grid's samples: worst in pixels, worst and rms in meters."""
    error = np.zeros(field.grid.shape)
    _deviations(field.height, faces, error)
    return (
        float((error * pixels_per_m).max()),
        float(error.max()),
        float(np.sqrt((error * error).mean())),
    )


@kernel
def _deviations(height, faces, error):  # type: ignore[no-untyped-def]
    nx = height.shape[1]
    for f in range(len(faces)):
        ax, ay = faces[f, 0] % nx, faces[f, 0] // nx
        bx, by = faces[f, 1] % nx, faces[f, 1] // nx
        cx, cy = faces[f, 2] % nx, faces[f, 2] // nx
        det = float((bx - ax) * (cy - ay) - (cx - ax) * (by - ay))
        h = height[ay, ax]
        for y in range(min(ay, min(by, cy)), max(ay, max(by, cy)) + 1):
            for x in range(min(ax, min(bx, cx)), max(ax, max(bx, cx)) + 1):
                u = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / det
                v = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / det
                if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                    plane = h + u * (height[by, bx] - h) + v * (height[cy, cx] - h)
                    error[y, x] = max(error[y, x], abs(height[y, x] - plane))
