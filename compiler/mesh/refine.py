"""Refines beyond the grid: triangles halved until a surface's error is too small to see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.bisect import Bisection
from scenec.compiler.geometry.growing import Growing
from scenec.compiler.geometry.normals import normal_of
from scenec.compiler.mesh.cut import CutMesh
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.views.resolution import NEAREST_M, Views, pixels_of_balls
from scenec.schemas.codec import Facts
from scenec.schemas.kernels import kernel

#: Part of the amplitude of what is finer than a triangle that it may be wrong by: octaves of noise
#: have a root mean square of 0.3, and the middles of edges show some of it.
_UNRESOLVED = 0.35
#: Part of the tolerance that the middles of edges may use up: the worst point lies elsewhere.
_SLACK = 0.9
#: Slope, from crest to trough, beyond which such detail is taken for rough no more.
_STEEP = 0.5
#: The error is measured in no fewer faces than this, where there are so many.
_CHECKED = 200_000
#: Fractions of the golden ratio's plastic cousin: where a face is checked differs from the next.
_STEP = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True)
class RefineLimits:
    """Says when refinement stops.

    Attributes:
        tolerance_px: Error that may show.
        finest_m: No triangle with a shorter leg is halved.
        max_triangles: No more triangles than this.
        unseen: Part that pixels count out of view.
    """

    tolerance_px: float
    finest_m: float
    max_triangles: int
    unseen: float


@dataclass(frozen=True)
class _Work:
    """A mesh with what is known at its vertices and at the middles of its edges.

    Attributes:
        mesh: The triangles.
        points: Vertices on the surface, float64 [n, 3].
        sides: Of the merges at them, float64 [n, k].
        shares: Of the displaced layers at them, float64 [n, l].
        middles: Heights of the surface above the middles of the edges, float64 [e]; NaN where none
            was asked for yet.
        middle_sides: Of the merges there, float64 [e, k].
        refined: Faces that were halved, bool [m].
        cell: Grid cell of each face, int32 [m].
        pixels: That a meter of each face takes at most, float64 [m]; NaN where none was asked for.
    """

    mesh: Bisection
    points: Growing
    sides: Growing
    shares: Growing
    middles: Growing
    middle_sides: Growing
    refined: Growing
    cell: Growing
    pixels: Growing


def refine(
    mesh: CutMesh,
    sides: NDArray[np.float64],
    surface: GroundSurface,
    views: Views,
    limits: RefineLimits,
) -> tuple[CutMesh, NDArray[np.float64], Facts] | None:
    """A mesh of a grid's samples, made finer where a view shows that it is too coarse.

    A face is halved while the surface above the middle of one of its edges, or the detail finer
    than it, is off by more than the tolerance in the nearest view, or a label line is.

    Args:
        mesh: Not cut yet; newest vertices first.
        sides: Of the merges at its vertices, float64 [k, n].

    Returns:
        The mesh, the merges' sides at its vertices, and the error left, measured at points inside
        of its faces. None if it has more triangles than are allowed.
    """
    work = _start(mesh, sides, surface)
    new = _doubtful(work, surface, views, limits)
    while len(work.mesh.faces) <= limits.max_triangles:
        wanted = new[_wanted(work, new, surface, views, limits)]
        if not len(wanted):
            finer, report = _finish(mesh, work, surface, views, limits)
            return finer, np.ascontiguousarray(work.sides.rows.T), report
        new = _halved(work, wanted, surface)
    return None


def _start(mesh: CutMesh, sides: NDArray[np.float64], surface: GroundSurface) -> _Work:
    bisection = Bisection(len(mesh.points), mesh.faces)
    x, y = np.ascontiguousarray(mesh.points[:, :2].T)
    height = surface.height_at(x, y, sides)
    edges = len(bisection.edges)
    return _Work(
        bisection,
        Growing(np.stack([x, y, height], axis=1)),
        Growing(np.ascontiguousarray(sides.T)),
        Growing(surface.displaced(sides, len(x))),
        Growing(np.full(edges, np.nan)),
        Growing(np.empty((edges, len(sides)))),
        Growing(np.zeros(len(mesh.faces), bool)),
        Growing(mesh.cell),
        Growing(np.full(len(mesh.faces), np.nan)),
    )


def _doubtful(
    work: _Work, surface: GroundSurface, views: Views, limits: RefineLimits
) -> NDArray[np.integer]:
    """Faces of the grid's mesh that can be wrong between the samples, where it was not measured.

    The others are flat to the tolerance at their samples, no line crosses them, and neither detail
    nor the surface's bend within a cell is large enough to show.
    """
    points, faces = work.points.rows, work.mesh.faces
    center, radius, leg = _balls(points, faces)
    pixels = _pixels(work, np.arange(len(faces)), center, radius, views, limits)
    field = surface.field
    bend = _bends(field.height, points, faces, *field.frame())
    everything = np.full(len(leg), np.inf)
    detail = surface.finer_than(everything, work.shares.rows, faces, (center, radius))
    off = detail + bend
    crossed = np.zeros(len(leg), bool)
    for side in work.sides.rows.T:
        above = side >= 0.0
        a, b, c = (above[faces[:, k]] for k in range(3))
        crossed |= (a != b) | (a != c)
    return np.flatnonzero(
        (np.where(crossed, leg, off) * pixels > limits.tolerance_px) & (leg > limits.finest_m)
    )


def _pixels(
    work: _Work,
    which: NDArray[np.integer],
    center: NDArray[np.float64],
    radius: NDArray[np.float64],
    views: Views,
    limits: RefineLimits,
) -> NDArray[np.float64]:
    """Pixels that a meter of some faces takes, float64 [n]: evaluated once for each face."""
    pixels = work.pixels.rows[which]
    new = np.flatnonzero(np.isnan(pixels))
    pixels[new] = pixels_of_balls(
        views, center[new], radius[new], limits.unseen, _nearest_m(limits)
    )
    work.pixels.rows[which[new]] = pixels[new]
    return pixels


def _nearest_m(limits: RefineLimits) -> float:
    """No point of a face counts as nearer to a camera than this."""
    return min(NEAREST_M, limits.finest_m)


def _know(work: _Work, surface: GroundSurface, which: NDArray[np.integer]) -> None:
    """Evaluates the surface above the middles of some edges, int [n], where it was not yet."""
    unknown = _unknown(which, work.middles.rows)
    height, sides = surface.evaluate(*_halfway(work.points.rows, work.mesh.edges, unknown))
    work.middles.rows[unknown] = height
    _put(np.reshape(sides, (len(sides), len(unknown))), unknown, work.middle_sides.rows)


def _wanted(
    work: _Work,
    which: NDArray[np.integer],
    surface: GroundSurface,
    views: Views,
    limits: RefineLimits,
) -> NDArray[np.bool_]:
    """Selects the faces that show too large an error."""
    faces = work.mesh.faces[which]
    center, radius, leg = _balls(work.points.rows, faces)
    # What is coarse enough needs no view.
    large = leg > limits.finest_m
    some = np.flatnonzero(large)
    pixels = np.zeros(len(which))
    pixels[some] = _pixels(work, which[some], center[some], radius[some], views, limits)
    finer = surface.finer_than(2.0 * leg, work.shares.rows, faces, (center, radius))
    finer = np.minimum(_UNRESOLVED * finer, _STEEP * leg)
    most = _SLACK * limits.tolerance_px
    out: NDArray[np.bool_] = finer * pixels > most
    # Where detail is reason enough, what lies above the middles need not be known.
    rest = np.flatnonzero(~out)
    faces, face_edges = faces[rest], work.mesh.face_edges[which[rest]]
    _know(work, surface, face_edges.ravel())
    error = _errors(
        work.points.rows, work.sides.rows, work.middles.rows, work.middle_sides.rows,
        faces, face_edges, leg[rest],
    )  # fmt: skip
    out[rest] = error * pixels[rest] > most
    return out


def _halved(
    work: _Work, wanted: NDArray[np.integer], surface: GroundSurface
) -> NDArray[np.integer]:
    """Halves some faces, and what must follow; the faces that are new."""
    halved = work.mesh.halve(wanted)
    x, y = _halfway(work.points.rows, work.mesh.edges, halved.middle_of)
    _know(work, surface, halved.middle_of)
    work.points.append(np.stack([x, y, work.middles.rows[halved.middle_of]], axis=1))
    sides = work.middle_sides.rows[halved.middle_of]
    work.sides.append(sides)
    work.shares.append(surface.displaced(np.ascontiguousarray(sides.T), len(sides)))
    edges = len(work.mesh.edges) - len(work.middles.rows)
    work.middles.add(edges)[:] = np.nan
    work.middle_sides.add(edges)
    work.refined.add(len(halved.origin))
    work.refined.rows[halved.parts] = True
    work.cell.append(work.cell.rows[halved.origin])
    work.pixels.add(len(halved.origin))
    work.pixels.rows[halved.parts] = np.nan
    return halved.parts


def _finish(
    coarse: CutMesh,
    work: _Work,
    surface: GroundSurface,
    views: Views,
    limits: RefineLimits,
) -> tuple[CutMesh, dict[str, Any]]:
    order, points = work.mesh.order, work.points.rows
    faces, refined = work.mesh.faces[order], work.refined.rows[order]
    normals = np.zeros((len(points), 3))
    normals[: len(coarse.normals)] = coarse.normals
    _refined_normals(points, faces, refined, normals)
    mesh = CutMesh.uncut(points, faces, work.cell.rows[order], normals)
    return mesh, {
        "triangles": len(faces),
        "triangles_refined": int(refined.sum()),
        "finest_leg_m": float(_balls(points, faces)[2].min()),
        **_measured(points, faces, surface, views, limits.unseen),
    }


def _measured(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    surface: GroundSurface,
    views: Views,
    unseen: float,
) -> dict[str, Any]:
    """Measures the error at one point inside of each face, or of every few where there are many.

    No bound: other points may err by more.
    """
    face = np.arange(0, len(faces), max(1, len(faces) // _CHECKED))
    u, v = ((np.arange(1, len(face) + 1) * step) % 1.0 for step in _STEP)
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    a, b, c = (points[faces[face, k]] for k in range(3))
    at = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    x, y = np.ascontiguousarray(at[:, :2].T)
    error = np.abs(surface.height_at(x, y) - at[:, 2])
    shown = error * pixels_of_balls(views, at, np.zeros(len(at)), unseen, NEAREST_M)
    order = np.sort(shown, kind="stable")
    return {
        "checked_points": len(face),
        "surface_error_found_px": float(order[-1]),
        "surface_error_99_9_px": float(order[int(0.999 * (len(order) - 1))]),
        "surface_error_rms_px": float(np.sqrt((shown * shown).mean())),
        "surface_error_found_m": float(error.max()),
    }


@kernel
def _put(columns, at, rows):  # type: ignore[no-untyped-def]
    """Columns, float64 [k, n], into some rows, [e, k]."""
    for n in range(len(at)):
        for k in range(len(columns)):
            rows[at[n], k] = columns[k, n]


@kernel
def _unknown(which, middles):  # type: ignore[no-untyped-def]
    """Selects the edges that are not measured yet, each once, int64 [u].

    Args:
        which: Edges, [n].
        middles: float64 [e], NaN where it is not known; infinite of those returned.
    """
    out = np.empty(len(which), np.int64)
    count = 0
    for e in which:
        if np.isnan(middles[e]):
            middles[e] = np.inf
            out[count] = e
            count += 1
    return out[:count]


@kernel
def _halfway(points, edges, some):  # type: ignore[no-untyped-def]
    """X and y of the middles of some edges."""
    x, y = np.empty(len(some)), np.empty(len(some))
    for n in range(len(some)):
        low, high = points[edges[some[n], 0]], points[edges[some[n], 1]]
        x[n], y[n] = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])
    return x, y


@kernel
def _balls(points, faces):  # type: ignore[no-untyped-def]
    """Middle and radius of balls about faces; their legs, as if they were half squares in plan."""
    center = np.empty((len(faces), 3))
    radius = np.empty(len(faces))
    leg = np.empty(len(faces))
    for f in range(len(faces)):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        for axis in range(3):
            center[f, axis] = (a[axis] + b[axis] + c[axis]) / 3.0
        worst = 0.0
        for k in range(3):
            square = 0.0
            for axis in range(3):
                d = points[faces[f, k], axis] - center[f, axis]
                square += d * d
            worst = max(worst, square)
        radius[f] = np.sqrt(worst)
        leg[f] = np.sqrt(abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])))
    return center, radius, leg


@kernel
def _bends(height, points, faces, x0, y0, dx, dy):  # type: ignore[no-untyped-def]
    """About how far the surface bends away between samples of faces as small as cells, meters.

    Second differences at the faces' corners; cubics stay within a quarter of their sum. The terrain
    ends level at its border.
    """
    ny, nx = height.shape
    out = np.empty(len(faces))
    for f in range(len(faces)):
        worst = 0.0
        for k in range(3):
            i = int(np.round((points[faces[f, k], 0] - x0) / dx))
            j = int(np.round((points[faces[f, k], 1] - y0) / dy))
            i0, i1 = max(i - 1, 0), min(i + 1, nx - 1)
            j0, j1 = max(j - 1, 0), min(j + 1, ny - 1)
            h = 2.0 * height[j, i]
            bend = abs(height[j, i0] + height[j, i1] - h)
            bend += abs(height[j0, i] + height[j1, i] - h)
            mixed = height[j1, i1] - height[j1, i0] - height[j0, i1] + height[j0, i0]
            worst = max(worst, bend + 0.5 * abs(mixed))
        out[f] = 0.25 * worst
    return out


@kernel
def _errors(points, sides, middles, middle_sides, faces, face_edges, leg):  # type: ignore[no-untyped-def]
    """Largest error at the middles of faces' edges, of height or of a label line, meters."""
    out = np.zeros(len(faces))
    for f in range(len(faces)):
        worst = 0.0
        for k in range(3):
            p, q = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            e = face_edges[f, k]
            worst = max(worst, abs(middles[e] - 0.5 * (points[p, 2] + points[q, 2])))
            for s in range(sides.shape[1]):
                value = middle_sides[e, s]
                # The line crosses the edge elsewhere than thought, or twice.
                if (value >= 0.0) == (0.5 * (sides[p, s] + sides[q, s]) >= 0.0):
                    continue
                a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
                steep = max(
                    abs(sides[b, s] - sides[a, s]),
                    max(abs(sides[c, s] - sides[a, s]), abs(sides[c, s] - sides[b, s])),
                )
                off = leg[f] if steep == 0.0 else min(leg[f], leg[f] * abs(value) / steep)
                worst = max(worst, off)
        out[f] = worst
    return out


@kernel
def _refined_normals(points, faces, refined, normals):  # type: ignore[no-untyped-def]
    """Replaces the normals of halved faces' vertices by those of the mesh, weighted by area."""
    touched = np.zeros(len(points), np.bool_)
    for f in range(len(faces)):
        if refined[f]:
            for k in range(3):
                touched[faces[f, k]] = True
    for n in range(len(points)):
        if touched[n]:
            normals[n, :] = 0.0
    for f in range(len(faces)):
        nx, ny, nz = normal_of(points, faces[f, 0], faces[f, 1], faces[f, 2])
        for k in range(3):
            n = faces[f, k]
            if touched[n]:
                normals[n, 0] += nx
                normals[n, 1] += ny
                normals[n, 2] += nz
    for n in range(len(points)):
        if touched[n]:
            x, y, z = normals[n]
            length = np.sqrt(x * x + y * y + z * z)
            for axis in range(3):
                normals[n, axis] /= length
