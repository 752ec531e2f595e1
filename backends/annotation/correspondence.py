"""Matches a frame to another view: flow, scene flow, disparity, and what is hidden.

Everything follows from exact visibility and poses, in float64. The point X that a pixel's center
shows belongs to a row; at the other sample the row stands elsewhere, and X with it:
X' = M' M^-1 X. What deforms has X at the same place of the same triangle. The other camera
projects X' to (u', v', Z'). Flow is (u', v') minus the pixel's center. Whether the other picture
shows X' is asked of the exact caster, with the ray from that camera through X': it does if nothing
is hit before it. A sky pixel stands for a direction: a point infinitely far away, which moves by
the camera's rotation alone.

The ray back to X' meets the surface X' lies on as well, at a parameter that rounding moves by a few
parts in 1e15 over the cosine of the angle of incidence. What is hit nearer than ``SAME`` of the
distance before X' therefore counts as the surface itself.

With a rolling shutter each row has a frame of its own: X is seen in that of its pixel's row, X' in
that of the row that sees it in the other picture (``shutter.places_of``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import Picture, built_in
from scenec.backends.camera.shutter import in_rows, is_rolling, places_of
from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster, Hits
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas.correspondence import HIDDEN, NOTHING, OUTSIDE, VISIBLE
from scenec.schemas.errors import CameraRefusedError
from scenec.schemas.lens import pixels_at

#: Share of the distance within which a hit is the surface that was asked for.
SAME = 1e-6


@dataclass(frozen=True)
class PointSight:
    """Holds where a camera shows points, and whether it does.

    Attributes:
        pixel: Column and row, float64 [n, 2]; NaN where its lens has no place for the point (a
            pinhole: it is behind), or where it is gone.
        local: The points in the camera's frame as it is then, float64 [n, 3].
        code: What became of them (``schemas.correspondence``), uint32 [n].
        undecided: Which count as visible though the first surface on the ray is not their own
            face: another one within ``SAME`` of the distance before them, or none up to there, as
            rounding has it on edges; bool [n].
    """

    pixel: NDArray[np.float64]
    local: NDArray[np.float64]
    code: NDArray[np.uint32]
    undecided: NDArray[np.bool_]


@dataclass(frozen=True)
class Match:
    """Holds where a frame's points lie in another view.

    Attributes:
        pixel: Column and row in the other picture, float64 [n, 2]; NaN where that camera's lens
            has no place for it (a pinhole: it is behind), or where it is gone.
        here, there: The points in both cameras' frames (x right, y down, z forward), meters,
            float64 [n, 3]; NaN without a hit, or where it is gone.
        code: What became of them (``schemas.correspondence``), uint32 [n].
    """

    pixel: NDArray[np.float64]
    here: NDArray[np.float64]
    there: NDArray[np.float64]
    code: NDArray[np.uint32]


def match(
    scene: RenderScene,
    caster: ExactCaster,
    hits: Hits,
    rays: Rays,
    here: tuple[Camera, int],
    there: tuple[Camera, int],
) -> Match:
    """Finds what one view shows in another one.

    Args:
        scene: The scene.
        caster: Posed at the sample of ``here``, and left so.
        hits, rays: First hits of ``here``, and its rays.
        here, there: The two views: camera and sample.

    Returns:
        One entry a ray.
    """
    (camera, sample), (other, sample_there) = here, there
    hit = hits.row >= 0
    points = rays.origins + np.where(hit, hits.t, 0.0)[:, None] * rays.directions
    moved, row, gone = _moved(scene, points, (hits.row, hits.face), sample, sample_there)
    # Pixels beyond a lens's circle show nothing that could be elsewhere.
    if rays.known is not None:
        gone |= ~rays.known
    target = np.where(hit[:, None], moved, rays.directions)
    caster.pose(sample_there)
    sight = sight_of(caster, other, target, (row, hits.face), gone)
    caster.pose(sample)
    nowhere = ~hit | gone
    local = in_rows(camera, points) if is_rolling(camera) else _to_camera(camera, points)
    local[nowhere] = np.nan
    after = sight.local.copy()
    after[nowhere] = np.nan
    return Match(sight.pixel, local, after, sight.code)


def sight_of(
    caster: ExactCaster,
    camera: Camera,
    points: NDArray[np.float64],
    faces: tuple[NDArray[np.int32], NDArray[np.int32]],
    gone: NDArray[np.bool_],
) -> PointSight:
    """Finds where a camera shows points, and what stands before them.

    Args:
        caster: Posed at the camera's sample.
        camera: As it is at that sample.
        points: World, float64 [n, 3]; of the sky, directions.
        faces: Rows and faces that they lie on, int32 [n] each; a row below 0 is the sky.
        gone: Which are not there at that sample, bool [n].
    """
    hit = faces[0] >= 0
    if is_rolling(camera):
        # Of the sky, a direction.
        places = places_of(camera, points, ~hit)
        local, pixel, origins = places.local, places.pixel, places.eye
    else:
        origins = np.broadcast_to(camera.camera_to_world[:3, 3], points.shape)
    # The sky's pixels are directions: as if from the other camera, one unit away.
    target = np.where(hit[:, None], points, origins + points)
    if not is_rolling(camera):
        local = _to_camera(camera, target)
        pixel = pixels_at(camera.lens, camera.intrinsics, local)
    pixel[gone] = np.nan
    with np.errstate(invalid="ignore"):
        inside = (pixel[:, 0] >= 0.0) & (pixel[:, 0] <= camera.width)
        inside &= (pixel[:, 1] >= 0.0) & (pixel[:, 1] <= camera.height)
    code = np.full(len(points), OUTSIDE, np.uint32)
    code[gone] = NOTHING
    index = np.flatnonzero(inside)
    code[index] = VISIBLE
    row, face, t = caster.cast(_rays_to(origins[index], target[index]))
    own = (row == faces[0][index]) & (face == faces[1][index])
    # The ray's parameter at the point is 1; at the sky it is endless.
    nearer = (t < np.where(hit[index], 1.0 - SAME, np.inf)) & ~(own & hit[index])
    code[index[nearer]] = HIDDEN
    undecided = np.zeros(len(points), bool)
    undecided[index] = hit[index] & ~nearer & ~own
    return PointSight(pixel, local, code, undecided)


def _next(picture: Picture) -> Match:
    return _of_trigger(picture, 1)


def _before(picture: Picture) -> Match:
    return _of_trigger(picture, -1)


def _of_trigger(picture: Picture, step: int) -> Match:
    """At the next time that the camera is triggered, or the one before."""
    camera = picture.camera
    sample = picture.sample + step * camera.trigger[0]
    other = _same_camera(picture.scene, camera, sample)
    if other is None:
        return _nothing(len(picture.hits.row))
    return match_picture(picture, other, sample)


def _stereo(picture: Picture) -> Match:
    """In the partner's picture."""
    other = _partner(picture.scene, picture.camera, picture.sample)
    return match_picture(picture, other, picture.sample)


def match_picture(picture: Picture, other: Camera, sample: int) -> Match:
    """Matches a picture to another camera's; see ``match``."""
    here, there = (picture.camera, picture.sample), (other, sample)
    return match(picture.scene, picture.caster, picture.hits, picture.rays, here, there)


def _nothing(n: int) -> Match:
    empty = np.full((n, 3), np.nan)
    return Match(empty[:, :2], empty, empty, np.full(n, NOTHING, np.uint32))


def _centers(picture: Picture) -> NDArray[np.float64]:
    """Pixel centers, float64 [h * w, 2]."""
    camera = picture.camera
    v, u = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _same_camera(scene: RenderScene, camera: Camera, sample: int) -> Camera | None:
    if not camera.trigger[1] <= sample < len(scene.cameras):
        return None
    return next((c for c in scene.cameras[sample] if c.name == camera.name), None)


def _partner(scene: RenderScene, camera: Camera, sample: int) -> Camera:
    found = [c for c in scene.cameras[sample] if c.path == camera.partner]
    if not found:
        raise CameraRefusedError(
            f"{camera.path}: disparity needs a partner; the stage names "
            + (f"{camera.partner}, which is not rendered" if camera.partner else "none")
        )
    return found[0]


def _moved(
    scene: RenderScene,
    points: NDArray[np.float64],
    faces: tuple[NDArray[np.int32], NDArray[np.int32]],
    sample: int,
    other: int,
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.bool_]]:
    """Moves points with the rows and faces that they lie on to another sample, as ``placed``."""
    if sample == other:
        return points, faces[0], np.zeros(len(points), bool)
    return placed(scene, anchored(scene, points, faces[0], sample), faces, other)


def anchored(
    scene: RenderScene, points: NDArray[np.float64], row: NDArray[np.int32], sample: int
) -> NDArray[np.float64]:
    """Converts points of the world to the frames of their rows, where those move; others stay.

    Args:
        scene: The scene.
        points: World at the sample, float64 [n, 3].
        row: Rows that they lie on, int32 [n]; below 0: none.
        sample: Time code.
    """
    motion = scene.rows.motion
    if motion is None:
        return points
    moves, place = motion.among(row)
    points = points.copy()
    for k in np.unique(place).tolist():
        some, now = moves[place == k], motion.to_world[sample, k]
        points[some] = _turned(points[some] - now[:, 3], np.linalg.inv(now[:, :3]))
    return points


def placed(
    scene: RenderScene,
    points: NDArray[np.float64],
    faces: tuple[NDArray[np.int32], NDArray[np.int32]],
    sample: int,
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.bool_]]:
    """Converts ``anchored`` points to the world at a sample.

    Args:
        scene: The scene.
        points: In the frames of their rows, where those move, float64 [n, 3].
        faces: Rows and faces that they lie on, int32 [n] each.
        sample: Time code.

    Returns:
        The points; their rows then, another pose's of what deforms; and which are gone by then.
    """
    row, gone = faces[0], np.zeros(len(points), bool)
    motion = scene.rows.motion
    if motion is None:
        return points, row, gone
    points, row = _in_pose(scene, points, faces, sample)
    moves, place = motion.among(row)
    for k in np.unique(place).tolist():
        some, then = moves[place == k], motion.to_world[sample, k]
        if then[:, :3].any():
            points[some] = _turned(points[some], then[:, :3]) + then[:, 3]
        else:
            gone[some] = True
    return points, row, gone


def _in_pose(
    scene: RenderScene,
    points: NDArray[np.float64],
    faces: tuple[NDArray[np.int32], NDArray[np.int32]],
    sample: int,
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Points, and their rows, on the same places of the triangles of the poses of a sample."""
    motion, points, row = scene.rows.motion, points.copy(), faces[0]
    if motion is None or motion.stand_ins is None:
        return points, row
    moves, place = motion.among(row)
    then = row.copy()
    then[moves] = motion.stand_ins[sample, place]
    changed = np.flatnonzero(then != row)
    pairs, pair = np.unique(np.stack([row[changed], then[changed]]), axis=1, return_inverse=True)
    for k, (old, new) in enumerate(pairs.T.tolist()):
        some = changed[pair.ravel() == k]
        here, there = (_corners(scene, r, faces[1][some]) for r in (old, new))
        u, v = _barycentric(here, points[some])
        points[some] = there[0] + u * (there[1] - there[0]) + v * (there[2] - there[0])
    return points, then


def _corners(scene: RenderScene, row: int, face: NDArray[np.int32]) -> NDArray[np.float64]:
    """Corners of faces of a row in its frame, float64 [3, n, 3]."""
    mesh = scene.meshes[scene.rows.mesh[row]]
    corners: NDArray[np.float64] = mesh.points[mesh.faces[face].T].astype(np.float64)
    return corners


def _barycentric(
    corners: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shares of the second and third corner in points of triangles, float64 [n, 1] each."""
    a, b, c = corners
    sides = (b - a, c - a)
    (bb, bc), (_, cc) = (tuple((s * t).sum(axis=1) for t in sides) for s in sides)
    pb, pc = (((points - a) * side).sum(axis=1) for side in sides)
    area = bb * cc - bc * bc
    # No ray meets a face of no area.
    area[area <= 0.0] = np.inf
    return ((cc * pb - bc * pc) / area)[:, None], ((bb * pc - bc * pb) / area)[:, None]


def _turned(vectors: NDArray[np.float64], m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Each v as m v: sums written out, since BLAS' last bits depend on how many there are."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.stack([m[i, 0] * x + m[i, 1] * y + m[i, 2] * z for i in range(3)], axis=1)


def _to_camera(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """World points in a camera's frame."""
    pose = camera.camera_to_world
    offset = points - pose[:3, 3]
    # A pose's axes are orthonormal: the inverse is the transpose.
    return _turned(offset, pose[:3, :3].T)


def _rays_to(origins: NDArray[np.float64], points: NDArray[np.float64]) -> Rays:
    """Rays from places of cameras that reach points at parameter 1."""
    directions = np.ascontiguousarray(points - origins)
    return Rays(np.ascontiguousarray(origins), directions, (1, len(points)))


FLOW = built_in("flow", lambda p: p.once(_next).pixel - p.once(_centers), whole=True)
SCENE_FLOW = built_in("scene_flow", lambda p: p.once(_next).there - p.once(_next).here, whole=True)
OCCLUSION = built_in("occlusion", lambda p: p.once(_next).code, whole=True)
FLOW_BACKWARD = built_in(
    "flow_backward", lambda p: p.once(_before).pixel - p.once(_centers), whole=True
)
OCCLUSION_BACKWARD = built_in("occlusion_backward", lambda p: p.once(_before).code, whole=True)
DISPARITY = built_in(
    "disparity", lambda p: p.once(_centers)[:, 0] - p.once(_stereo).pixel[:, 0], whole=True
)
DISPARITY_OCCLUSION = built_in("disparity_occlusion", lambda p: p.once(_stereo).code, whole=True)
