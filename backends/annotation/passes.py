"""Passes that the first hits themselves say: one value a ray, and the masks of what is seen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import Picture, View, built_in
from scenec.backends.exact.intersect import world_normal
from scenec.backends.stage.scene import Mesh
from scenec.schemas.amodal import Amodal
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: ``face`` where a ray meets nothing.
NO_FACE = 0xFFFFFFFF


def depth(view: View) -> NDArray[np.float64]:
    """Planar depth, float64 [n]: 0 beside the camera, below behind it, +inf without a hit."""
    t, planar = view.hits.t, view.rays.depth
    if planar is None:
        return t.copy()
    out = np.full(len(t), np.inf)
    hit = np.flatnonzero(t < np.inf)
    out[hit] = t[hit] * planar[hit]
    return out


def distance(view: View) -> NDArray[np.float64]:
    """Distances along the ray, meters, float64 [n], +inf without a hit."""
    t = view.hits.t
    out = np.empty(len(t))
    over_threads(_ranges, len(t), view.rays.directions, t, out)
    return out


def position(view: View) -> NDArray[np.float64]:
    """Hit points in the world's frame, meters, float64 [n, 3], NaN without a hit."""
    rays, t = view.rays, view.hits.t
    out = np.empty((len(t), 3))
    over_threads(_positions, len(t), rays.origins, rays.directions, t, out)
    return out


def normal(view: View) -> NDArray[np.float64]:
    """Unit normals of faces in the world, facing the ray, float64 [n, 3], 0 without a hit."""
    hits = view.hits
    out = np.empty((len(hits.t), 3))
    over_threads(_normals, len(out), hits.geometry, view.rays.directions, hits.row, hits.face, out)
    return out


def face(view: View) -> NDArray[np.uint32]:
    """Indices of authored faces, uint32 [n], NO_FACE without a hit."""
    return view.of_faces(_authored, NO_FACE)


def instance(view: View) -> NDArray[np.uint32]:
    """Ids of instances, uint32 [n]; 0 is none."""
    # The last one is that of no row, which is -1.
    ids = np.append(view.scene.rows.instance_id, np.uint32(0))
    return ids[view.hits.row].astype(np.uint32)


def label(view: View, level: str) -> NDArray[np.uint32]:
    """Ids of labels on a level, uint32 [n]; the sky's without a hit; 0 is none."""
    scene = view.scene
    out = view.of_faces(
        lambda mesh: mesh.labels.get(level, np.zeros(len(mesh.faces), np.uint32)),
        scene.sky_labels.get(level, 0),
    )
    sky = scene.sky_label_maps[view.sample].get(level) if scene.sky_label_maps else None
    if sky is None and level in scene.sky_labels_below:
        down = view.rays.directions[:, 2] < 0.0
        out[(view.hits.row < 0) & down] = scene.sky_labels_below[level]
    if sky is not None:
        # Imported here: few scenes have a map of labels.
        from scenec.backends.stage.sky_labels import label_of_sky

        missed = np.flatnonzero(view.hits.row < 0)
        out[missed] = label_of_sky(sky, view.rays.directions, missed)
    if view.rays.known is not None:
        out[~view.rays.known] = 0
    return out


def amodal(picture: Picture) -> Amodal | None:
    """Masks of what instances that are seen would show if nothing stood before them."""
    return picture.seen.amodal


def _authored(mesh: Mesh) -> NDArray[np.uint32]:
    if mesh.authored_face is None:
        return np.arange(len(mesh.faces), dtype=np.uint32)
    return mesh.authored_face.astype(np.uint32)


@kernel
def _ranges(first, last, directions, t, out):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        d = directions[k]
        out[k] = t[k] * math.sqrt((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2])


@kernel
def _positions(first, last, origins, directions, t, out):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        for i in range(3):
            out[k, i] = origins[k, i] + t[k] * directions[k, i] if t[k] < math.inf else math.nan


@kernel
def _normals(first, last, g, directions, row, face, out):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        out[k, 0] = 0.0
        out[k, 1] = 0.0
        out[k, 2] = 0.0
        if row[k] < 0:
            continue
        x, y, z = world_normal(g, row[k], face[k])
        # Scaled first: the square of a normal of a tiny triangle may underflow.
        scale = max(abs(x), max(abs(y), abs(z)))
        x /= scale
        y /= scale
        z /= scale
        length = math.sqrt(x * x + y * y + z * z)
        if (x * directions[k, 0] + y * directions[k, 1]) + z * directions[k, 2] > 0.0:
            length = -length
        out[k, 0] = x / length
        out[k, 1] = y / length
        out[k, 2] = z / length


DEPTH = built_in("depth", depth)
RANGE = built_in("range", distance)
POSITION = built_in("position", position)
NORMAL = built_in("normal", normal)
FACE = built_in("face", face)
INSTANCE = built_in("instance", instance)
LABEL = built_in("label", label)
#: Ids name its masks.
AMODAL = built_in("amodal", amodal, whole=True, needs=("instance",))
