"""Annotation from exact first hits: depth, labels, ids, normals, positions, in float64."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.backends.exact.caster import Hits
from scenec.backends.exact.intersect import world_normal
from scenec.backends.stage.scene import RenderScene, SkyLabelMap
from scenec.schemas.amodal import AMODAL
from scenec.schemas.correspondence import CORRESPONDENCES
from scenec.schemas.depth_camera import MEASURED
from scenec.schemas.errors import BackendError
from scenec.schemas.threads import over_threads

#: ``face`` where a ray meets nothing.
NO_FACE = 0xFFFFFFFF


@njit(cache=True, error_model="numpy", nogil=True)
def _gather(first, last, start, row, face, values, missing, out):  # type: ignore[no-untyped-def]
    """A value per face, or ``missing`` where nothing is hit."""
    for k in range(first, last):
        out[k] = missing if row[k] < 0 else values[start[row[k]] + face[k]]


@njit(cache=True, error_model="numpy", nogil=True)
def _normals(first, last, g, directions, row, face, out):  # type: ignore[no-untyped-def]
    """Geometric unit normals that face the ray, 0 where nothing is hit."""
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


@njit(cache=True, error_model="numpy", nogil=True)
def _positions(first, last, origins, directions, t, out):  # type: ignore[no-untyped-def]
    """Hit points, NaN where nothing is hit."""
    for k in range(first, last):
        for i in range(3):
            out[k, i] = origins[k, i] + t[k] * directions[k, i] if t[k] < math.inf else math.nan


@njit(cache=True, error_model="numpy", nogil=True)
def _ranges(first, last, directions, t, out):  # type: ignore[no-untyped-def]
    """Distances along the ray, +inf where nothing is hit."""
    for k in range(first, last):
        d = directions[k]
        out[k] = t[k] * math.sqrt((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2])


def _depths(depth: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Planar depths of hits, +inf where nothing is hit."""
    out = np.full(len(t), np.inf)
    hit = np.flatnonzero(t < np.inf)
    out[hit] = t[hit] * depth[hit]
    return out


def _label_sky(
    label_map: SkyLabelMap | None,
    row: NDArray[np.int32],
    rays: Rays,
    out: NDArray[np.uint32],
) -> None:
    """Labels of rays that meet nothing, by the sky's label map, in place."""
    if label_map is not None:
        # Imported here: few scenes have one.
        from scenec.backends.stage.sky_labels import label_of_sky

        missed = np.flatnonzero(row < 0)
        out[missed] = label_of_sky(label_map, rays.directions, missed)


def pass_names(scene: RenderScene, passes: Sequence[str]) -> list[str]:
    """The annotation passes a list of passes stands for.

    Args:
        scene: The scene, for its label levels.
        passes: Names as in DESIGN's frame contract; ``label`` stands for all levels, ``rgb`` is no
            annotation and is skipped.

    Returns:
        Names out of ``depth``, ``range``, ``label.<level>``, ``instance``, ``normal``,
        ``position``, ``face``, ``amodal``, which brings ``instance`` with it, and those that
        compare with another view (``schemas.correspondence``), each once.

    Raises:
        BackendError: A name that is none of these.
    """
    labels = [f"label.{level}" for level in scene.levels]
    known = ["depth", "range", *labels, "instance", "normal", "position", "face", AMODAL]
    known += [*CORRESPONDENCES, MEASURED]
    names: dict[str, None] = {}
    for name in passes:
        if name == "label":
            names.update(dict.fromkeys(labels))
        elif name in known:
            if name == AMODAL:
                names["instance"] = None
            names[name] = None
        elif name != "rgb":
            raise BackendError(f'no pass "{name}"; expected one of: label, {", ".join(known)}')
    return list(names)


def annotate(
    scene: RenderScene, hits: Hits, rays: Rays, passes: Sequence[str], sample: int = 0
) -> dict[str, NDArray]:
    """All annotation that follows from first hits.

    Args:
        scene: The scene.
        hits: Of the rays.
        rays: The rays; ``depth`` is their parameter, which is planar depth for a pinhole camera, or
            what ``Rays.depth`` makes of it: 0 beside the camera, below behind it.
        passes: What to compute, see ``pass_names``.
        sample: Time code, for label maps of the sky.

    Returns:
        Per pass but ``amodal`` and those that compare with another view (h, w of the rays' shape):
        ``depth`` and ``range`` float64 [h, w], +inf without a hit; ``label.<level>`` uint32 [h, w],
        the sky's label without a hit (by its label map, where it has one); ``instance`` uint32
        [h, w], 0 is none; ``normal`` float64 [h, w, 3], geometric, in the world frame, facing the
        ray, 0 without a hit; ``position`` float64 [h, w, 3], world, NaN without a hit; ``face``
        uint32 [h, w], the authored face, NO_FACE without a hit.

    Raises:
        BackendError: A pass that is not known.
    """
    g, row, face, t = hits.geometry, hits.row, hits.face, hits.t
    n = len(t)
    out: dict[str, NDArray] = {}
    for name in pass_names(scene, passes):
        if name in (AMODAL, MEASURED) or name in CORRESPONDENCES:
            # Made by modules of their own in ``scenec.backends``.
            continue
        if name == "depth":
            out[name] = t.copy() if rays.depth is None else _depths(rays.depth, t)
        elif name == "range":
            out[name] = np.empty(n)
            over_threads(_ranges, t.shape[0], rays.directions, t, out[name])
        elif name == "instance":
            ids = np.append(scene.rows.instance_id, np.uint32(0))
            out[name] = ids[row].astype(np.uint32)
        elif name == "normal":
            out[name] = np.empty((n, 3))
            over_threads(_normals, row.shape[0], g, rays.directions, row, face, out[name])
        elif name == "position":
            out[name] = np.empty((n, 3))
            over_threads(_positions, t.shape[0], rays.origins, rays.directions, t, out[name])
        else:
            missing = NO_FACE
            tables = [np.empty(0, np.uint32)]
            if name == "face":
                for mesh in scene.meshes:
                    authored = mesh.authored_face
                    tables.append(
                        np.arange(len(mesh.faces), dtype=np.uint32)
                        if authored is None
                        else authored.astype(np.uint32)
                    )
            else:
                level = name.removeprefix("label.")
                missing = scene.sky_labels.get(level, 0)
                tables += [
                    mesh.labels.get(level, np.zeros(len(mesh.faces), np.uint32))
                    for mesh in scene.meshes
                ]
            out[name] = np.empty(n, np.uint32)
            over_threads(
                _gather,
                row.shape[0],
                g.row_face,
                row,
                face,
                np.concatenate(tables).astype(np.uint32, copy=False),
                np.uint32(missing),
                out[name],
            )
            if name != "face" and scene.sky_label_maps:
                _label_sky(scene.sky_label_maps[sample].get(level), row, rays, out[name])
            if name != "face" and rays.known is not None:
                out[name][~rays.known] = 0
    return {name: values.reshape(*rays.shape, *values.shape[1:]) for name, values in out.items()}
