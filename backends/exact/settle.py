"""Settling a renderer's visibility: from nearly right to exact.

Annotation is defined as the nearest hit of the ray through the pixel center, in float64, ties to
the lowest (row, face): what ``exact.ExactCaster`` answers. This module is an accelerator for that
definition. It tests the face a renderer reported, exactly, keeps it where nothing speaks against
it, and casts all other pixels (the suspects). A pixel is suspect when

* its ray misses the reported face (or the report names no face of the scene), ``MISSED``;
* its ray passes within a hair of the face's edge, ``HAIR``;
* the face's picture is less than two pixels thick, so that it may hide others, ``SLIVER``;
* the scene holds the same row or face twice, so that a tie decides, ``TWIN``;
* its neighbors in the 3x3 window report another row, nothing, or a surface that the plane of the
  pixel's own face does not lead to, or one of their faces is hit no later, ``DISCONTINUITY``;
* a row whose picture is so small that no ray need have met it may lie before it, ``SMALL_ROW``.

The hair is what float32 can do wrong: ``16 * 2**-24`` of the coordinates involved (vertices and
origin are rounded once, the intersection takes a handful of operations), and at least 1/64 of a
pixel, for rasterizers, which snap vertices to fractions of a pixel.

What these rules take on trust is audited: every 61st accepted pixel is cast too. If one of these is
wrong (surfaces that coincide over an area, a renderer that clips or culls), or more than one in a
hundred of the suspects (a renderer wrong by more than float32 can be), all pixels are cast.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from scenec.backends.contract import NO_ROW, Rays, Visibility
from scenec.backends.exact.bvh import Geometry
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.exact.intersect import (
    hit_details,
    hit_parameter,
    ray_frame,
    row_matrix,
    world_normal,
)
from scenec.backends.exact.small_rows import mark_small_rows
from scenec.backends.render_scene import Camera
from scenec.backends.shutter import is_rolling
from scenec.schemas.errors import BackendError
from scenec.schemas.threads import over_threads

MISSED, HAIR, SLIVER, TWIN, DISCONTINUITY, SMALL_ROW, AUDIT = 1, 2, 4, 8, 16, 32, 64
_REASONS = {
    "missed": MISSED,
    "hair": HAIR,
    "sliver": SLIVER,
    "twin": TWIN,
    "discontinuity": DISCONTINUITY,
    "small_row": SMALL_ROW,
    "audit": AUDIT,
}

_HAIR_FLOAT32 = 16.0 * 2.0**-24
_HAIR_PIXELS = 1.0 / 64.0
_SLIVER_PIXELS = 2.0
_SMALL_ROW_PIXELS = 2.0
#: A prime, so that the audited pixels do not line up in columns.
_AUDIT_STRIDE = 61
#: Share of suspects that may prove wrong before the report as a whole is distrusted.
_TRUSTED_SHARE = 0.01


@dataclass(frozen=True)
class Statistics:
    """How far a renderer's visibility was from exact, and what settling it took.

    Attributes:
        pixels: Number of pixels.
        suspects: Pixels cast exactly.
        reasons: Suspects by reason; a pixel can have several.
        changed: Pixels whose (row, face) was wrong: the raw disagreement.
        changed_rows: Pixels whose row was wrong, hit or not included.
        escalated: Whether the report proved untrustworthy and all pixels were cast.
    """

    pixels: int
    suspects: int
    reasons: dict[str, int]
    changed: int
    changed_rows: int
    escalated: bool


@dataclass(frozen=True)
class Settled:
    """Exact visibility of a picture.

    Attributes:
        row: int32 [n], NO_ROW where nothing is hit.
        face: int32 [n], 0 where nothing is hit.
        t: Ray parameter (planar depth for a pinhole camera), float64 [n], +inf without a hit.
        statistics: What it took.
        geometry: What ``row`` and ``face`` refer to.
    """

    row: NDArray[np.int32]
    face: NDArray[np.int32]
    t: NDArray[np.float64]
    statistics: Statistics
    geometry: Geometry


@njit(cache=True, error_model="numpy")
def _footprint(directions, width, height, x, y):  # type: ignore[no-untyped-def]
    """Distance between the rays of neighboring pixels at ray parameter 1."""
    k = y * width + x
    size = 0.0
    if width > 1:
        other = k + 1 if x + 1 < width else k - 1
        size = math.sqrt(
            (directions[other, 0] - directions[k, 0]) ** 2
            + (directions[other, 1] - directions[k, 1]) ** 2
            + (directions[other, 2] - directions[k, 2]) ** 2
        )
    if height > 1:
        other = k + width if y + 1 < height else k - width
        size = max(
            size,
            math.sqrt(
                (directions[other, 0] - directions[k, 0]) ** 2
                + (directions[other, 1] - directions[k, 1]) ** 2
                + (directions[other, 2] - directions[k, 2]) ** 2
            ),
        )
    return size


@njit(cache=True, error_model="numpy")
def _largest(v):  # type: ignore[no-untyped-def]
    return max(abs(v[0]), max(abs(v[1]), abs(v[2])))


@njit(cache=True, error_model="numpy", nogil=True)
def _test_own(first, last, g, origins, directions, width, height, row, face, t, doubt):  # type: ignore[no-untyped-def]
    """Test each pixel's reported face; broken reports become NO_ROW, doubts are noted."""
    for y in range(first, last):
        for x in range(width):
            k = y * width + x
            r = row[k]
            t[k] = math.inf
            doubt[k] = 0
            if r == NO_ROW:
                face[k] = 0
                continue
            if r < 0 or r >= g.row_face.shape[0] or face[k] < 0 or face[k] >= g.row_faces[r]:
                row[k] = NO_ROW
                face[k] = 0
                doubt[k] = MISSED
                continue
            origin = origins[k]
            direction = directions[k]
            frame = ray_frame(origin, direction)
            matrix = row_matrix(g.to_world, r, frame[0], frame[1], frame[2])
            hit, margin, size = hit_details(
                g.points, g.faces[g.row_face[r] + face[k]], matrix, frame
            )
            if hit == math.inf:
                doubt[k] = MISSED
                continue
            t[k] = hit
            pixel = hit * _footprint(directions, width, height, x, y)
            magnitude = 2.0 * (_largest(origin) + hit * _largest(direction))
            if not margin > max(_HAIR_PIXELS * pixel, _HAIR_FLOAT32 * magnitude):
                doubt[k] |= HAIR
            if not size > _SLIVER_PIXELS * pixel:
                doubt[k] |= SLIVER
            if g.row_twin[r] or g.face_twin[g.row_face[r] + face[k]]:
                doubt[k] |= TWIN


@njit(cache=True, error_model="numpy")
def _continues(origins, directions, normal, k, j, t, pixel):  # type: ignore[no-untyped-def]
    """Whether the surface hit by ray j is where the plane through the hit of ray k leads."""
    top = 0.0
    bottom = 0.0
    for i in range(3):
        top += normal[i] * (origins[k, i] + t[k] * directions[k, i] - origins[j, i])
        bottom += normal[i] * directions[j, i]
    predicted = top / bottom
    # Half the plane's own slope, for the curvature of a tessellated surface.
    return abs(t[j] - predicted) <= 2.0 * pixel + 0.5 * abs(predicted - t[k])


@njit(cache=True, error_model="numpy", nogil=True)
def _test_neighbors(  # type: ignore[no-untyped-def]
    first, last, g, origins, directions, width, height, row, face, t, doubt, suspect
):
    """Compare each undoubted pixel with its 3x3 window."""
    for y in range(first, last):
        for x in range(width):
            k = y * width + x
            suspect[k] = doubt[k]
            if doubt[k] != 0:
                continue
            r = row[k]
            odd = False
            for j in range(max(y - 1, 0) * width, min(y + 2, height) * width, width):
                for i in range(j + max(x - 1, 0), j + min(x + 2, width)):
                    if row[i] != r:
                        odd = True
            if odd:
                suspect[k] = DISCONTINUITY
                continue
            if r == NO_ROW:
                continue
            normal = world_normal(g, r, face[k])
            pixel = t[k] * _footprint(directions, width, height, x, y)
            frame = ray_frame(origins[k], directions[k])
            matrix = row_matrix(g.to_world, r, frame[0], frame[1], frame[2])
            for j in range(max(y - 1, 0) * width, min(y + 2, height) * width, width):
                for i in range(j + max(x - 1, 0), j + min(x + 2, width)):
                    if face[i] != face[k] and not odd:
                        other = g.faces[g.row_face[r] + face[i]]
                        odd = hit_parameter(g.points, other, matrix, frame) <= t[k] or (
                            t[i] < math.inf
                            and not _continues(origins, directions, normal, k, i, t, pixel)
                        )
            if odd:
                suspect[k] = DISCONTINUITY


@njit(cache=True, error_model="numpy", nogil=True)
def _mark_small_rows(spheres, intrinsics, pose, width, height, t, suspect):  # type: ignore[no-untyped-def]
    """Mark the pixels that rows with a picture of under two pixels' radius may touch.

    Pixels whose known hit lies before all of the row are left alone: the true hit is no later.
    """
    fx = intrinsics[0, 0]
    fy = intrinsics[1, 1]
    focal = max(abs(fx), abs(fy)) + abs(intrinsics[0, 1])
    for row in range(spheres.shape[0]):
        radius = spheres[row, 3]
        if radius < 0.0:
            continue
        p0 = spheres[row, 0] - pose[0, 3]
        p1 = spheres[row, 1] - pose[1, 3]
        p2 = spheres[row, 2] - pose[2, 3]
        z = pose[0, 2] * p0 + pose[1, 2] * p1 + pose[2, 2] * p2
        near = z - radius
        # A row closer to the camera's plane than its own size has no small picture.
        if near <= radius:
            continue
        x = (pose[0, 0] * p0 + pose[1, 0] * p1 + pose[2, 0] * p2) / z
        y = (pose[0, 1] * p0 + pose[1, 1] * p1 + pose[2, 1] * p2) / z
        # |X'/Z' - X/Z| <= r (1 + |X/Z|) / (Z - r) for any point of the sphere.
        reach = focal * radius * (1.0 + max(abs(x), abs(y))) / near
        if not radius * focal / z < _SMALL_ROW_PIXELS:
            continue
        u = fx * x + intrinsics[0, 1] * y + intrinsics[0, 2]
        v = fy * y + intrinsics[1, 2]
        if not (-reach - 1 < u < width + reach + 1 and -reach - 1 < v < height + reach + 1):
            continue
        for j in range(max(math.floor(v - reach - 1.0), 0), min(int(v + reach + 2.0), height)):
            for i in range(max(math.floor(u - reach - 1.0), 0), min(int(u + reach + 2.0), width)):
                if near <= t[j * width + i]:
                    suspect[j * width + i] |= SMALL_ROW


def settle(
    caster: ExactCaster,
    rays: Rays,
    visibility: Visibility | None = None,
    camera: Camera | None = None,
    core: range | None = None,
) -> Settled:
    """Make a renderer's visibility exact.

    Args:
        caster: The exact caster of the scene that ``visibility`` refers to.
        rays: The rays of the picture, row-major.
        visibility: What a renderer reported; None: every ray is cast.
        camera: The camera the rays come from; None (a table of rays of another kind): they need
            have no eye, so every ray is cast.
        core: Rows of ``rays`` that are settled; None: all. The others, a larger picture's rows
            beside them, are what the 3x3 windows look at and no more.

    Returns:
        The exact visibility (of the core), and how far the renderer was from it.

    Raises:
        BackendError: Arrays of ``visibility`` that do not fit the rays.
    """
    n = len(rays.origins)
    height, width = rays.shape
    if n != height * width:
        raise BackendError(f"{n} rays do not fill a picture of {width} x {height}")
    g = caster.geometry
    suspect = np.zeros(n, np.uint8)
    inside = slice(0, n) if core is None else slice(core.start * width, core.stop * width)
    size = inside.stop - inside.start
    known = np.arange(inside.start, inside.stop)
    if rays.known is not None:
        known = known[rays.known[inside]]
    if visibility is None:
        row, face, t = caster.cast(rays, known)
        if len(known) < size:
            row, face, t = (
                _spread(found, size, known - inside.start, nothing)
                for found, nothing in ((row, NO_ROW), (face, 0), (t, np.inf))
            )
        nothing = Statistics(size, len(known), dict.fromkeys(_REASONS, 0), 0, 0, False)
        return Settled(row, face, t, nothing, g)
    if visibility.row.shape != (n,) or visibility.face.shape != (n,):
        raise BackendError(
            f"visibility has {visibility.row.shape} rows and {visibility.face.shape} faces; "
            f"expected ({n},) of each, one per ray"
        )
    if rays.known is not None:
        there = np.where(rays.known, visibility.row, np.int32(NO_ROW)).astype(np.int32)
        visibility = Visibility(there, visibility.face)
    row = visibility.row.astype(np.int32)
    face = visibility.face.astype(np.int32)
    t = np.empty(n)
    doubt = np.empty(n, np.uint8)
    over_threads(
        _test_own, height, g, rays.origins, rays.directions, width, height, row, face, t, doubt
    )
    over_threads(
        _test_neighbors,
        height,
        g,
        rays.origins,
        rays.directions,
        width,
        height,
        row,
        face,
        t,
        doubt,
        suspect,
    )
    if camera is None:
        suspect |= AUDIT
    elif camera.lens is not None or is_rolling(camera):
        mark_small_rows(g.row_spheres, rays, t, _SMALL_ROW_PIXELS, SMALL_ROW, suspect)
    else:
        _mark_small_rows(
            g.row_spheres,
            np.ascontiguousarray(camera.intrinsics, np.float64),
            np.ascontiguousarray(camera.camera_to_world, np.float64),
            width,
            height,
            t,
            suspect,
        )
    if rays.known is not None:
        # They show nothing, and are no mark against the renderer.
        suspect[~rays.known] = 0
    suspect[: inside.start] = suspect[inside.stop :] = 0
    accepted = known[suspect[known] == 0]
    audited = accepted[::_AUDIT_STRIDE]
    suspect[audited] = AUDIT
    cast = np.flatnonzero(suspect)
    _cast_suspects(caster, rays, cast, row, face, t)
    other_row, changed = _differences(visibility, row, face, inside)
    # Of twins either one is a fair answer, so theirs are no mark against the renderer.
    mistaken = np.count_nonzero(changed & (suspect & TWIN == 0))
    escalated = bool(changed[audited].any() or mistaken > _TRUSTED_SHARE * len(cast))
    if escalated:
        _cast_suspects(caster, rays, accepted, row, face, t)
        suspect[accepted] = AUDIT
        other_row, changed = _differences(visibility, row, face, inside)
    statistics = Statistics(
        pixels=size,
        suspects=int(np.count_nonzero(suspect)),
        reasons={k: int(np.count_nonzero(suspect & bit)) for k, bit in _REASONS.items()},
        changed=int(np.count_nonzero(changed)),
        changed_rows=int(np.count_nonzero(other_row)),
        escalated=escalated,
    )
    return Settled(row[inside], face[inside], t[inside], statistics, g)


def _spread(found: NDArray, n: int, known: NDArray[np.int64], nothing: float) -> NDArray:
    """What was found of the pixels that have a ray, for all."""
    out = np.full(n, nothing, found.dtype)
    out[known] = found
    return out


def _differences(
    visibility: Visibility, row: NDArray[np.int32], face: NDArray[np.int32], inside: slice
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Where, of some pixels, a report names another row, and where another row or face."""
    other_row = row != visibility.row
    other_row[: inside.start] = other_row[inside.stop :] = False
    return other_row, other_row | ((face != visibility.face) & (row != NO_ROW))


def _cast_suspects(
    caster: ExactCaster,
    rays: Rays,
    index: NDArray[np.int64],
    row: NDArray[np.int32],
    face: NDArray[np.int32],
    t: NDArray[np.float64],
) -> None:
    """Cast some rays, from the exact hits they may already have, in place."""
    known = t[index] < np.inf
    some_row = np.where(known, row[index], np.int32(NO_ROW)).astype(np.int32)
    some_face = np.where(known, face[index], np.int32(0)).astype(np.int32)
    some_t = t[index]
    caster.improve(rays, index, some_row, some_face, some_t)
    row[index] = some_row
    face[index] = some_face
    t[index] = some_t
