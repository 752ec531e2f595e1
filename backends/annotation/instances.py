"""What there is to say of each instance: pose, size, and what a frame shows of it.

The columns, and what they mean: ``scenec.schemas.instances``, which also reads the tables.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.outlines import Outliner
from scenec.backends.contract import Rays
from scenec.backends.exact.bvh import Geometry, inverses
from scenec.backends.stage.scene import Camera, Mesh, RenderScene
from scenec.schemas.amodal import Amodal
from scenec.schemas.instances import (
    AMODAL_COLUMNS,
    BOX_COLUMNS,
    DEPTH_COLUMNS,
    PIXEL_COLUMNS,
    POSE_COLUMNS,
    InstanceTable,
)
from scenec.schemas.kernels import kernel

_IDENTITY = np.eye(4)[:3]


@dataclass(frozen=True)
class Poses:
    """Where instances are.

    Attributes:
        position: float64 [n, 3].
        rotation: float64 [n, 3, 3], proper.
        scale: float64 [n, 3].
        linear: From the object's own units to its axes in meters, rotation^T M, float64 [n, 3, 3].
    """

    position: NDArray[np.float64]
    rotation: NDArray[np.float64]
    scale: NDArray[np.float64]
    linear: NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """What a frame shows of instances.

    Attributes:
        table: Columns, for ``schemas.instances.write_frame_table``.
        amodal: Masks, for ``schemas.amodal.write_amodal``; None unless asked for.
    """

    table: dict[str, NDArray[Any]]
    amodal: Amodal | None = None


class Instances:
    """All instances of a scene that have an id; built once per batch.

    Attributes:
        ids: Frame ids, ascending, uint32 [n].
        slot_of_row: Index into ``ids`` of each row of the scene, -1 where it has none, int32 [r].
    """

    def __init__(self, scene: RenderScene) -> None:
        self._scene = scene
        rows = scene.rows
        have = np.flatnonzero(rows.instance_id)
        part = np.zeros(len(have), np.int32) if rows.part is None else rows.part[have]
        # Of an instance's rows the first that keeps its place in it says where it is.
        key = rows.instance_id[have].astype(np.int64) * 2 + (part < 0)
        order = np.arange(len(key)) if (np.diff(key) >= 0).all() else np.argsort(key, kind="stable")
        self._rows, self._part = have[order], part[order]
        ids = rows.instance_id[self._rows]
        starts = np.flatnonzero(np.diff(ids.astype(np.int64), prepend=-1))
        self.ids: NDArray[np.uint32] = ids[starts]
        self._first = starts
        slots = np.repeat(np.arange(len(starts), dtype=np.int32), np.diff(starts, append=len(ids)))
        self.slot_of_row = np.full(len(rows.mesh), -1, np.int32)
        self.slot_of_row[self._rows] = slots
        self._lead = self._rows[starts]
        self._inverse = _inverses(scene.parts)
        self._lead_part = self._part[starts]
        local_low, local_high = self._local_boxes()
        poses = self.poses(np.arange(len(starts)), self._shown_first())
        center = (poses.linear * (0.5 * (local_low + local_high))[:, None, :]).sum(axis=2)
        half = (np.abs(poses.linear) * (0.5 * (local_high - local_low))[:, None, :]).sum(axis=2)
        self._scale = poses.scale
        self._box = np.stack([center - half, center + half], axis=1)
        self._labels = self._find_labels()
        bases = np.array(list(scene.instance_paths.values()) or [0], np.int64)
        self._classes = tuple(scene.instance_paths) or ("",)
        of_class = np.searchsorted(bases, self.ids.astype(np.int64), side="left") - 1
        self._class: NDArray[np.int32] = np.maximum(of_class, 0).astype(np.int32)
        self._local = (self.ids.astype(np.int64) - bases[self._class]).astype(np.uint32)

    def poses(self, which: NDArray[np.int64], sample: int | NDArray[np.int64]) -> Poses:
        """Where some instances are.

        Args:
            which: Indices into ``ids``.
            sample: Time code, or one for each.
        """
        scene, lead = self._scene, self._lead[which]
        matrix = scene.rows.to_world[lead]
        motion = scene.rows.motion
        if motion is not None:
            moves, at = motion.among(lead)
            matrix[moves] = motion.to_world[np.broadcast_to(sample, lead.shape)[moves], at]
        part = self._lead_part[which]
        inner = np.flatnonzero(part > 0)
        matrix[inner] = _composed(matrix[inner], self._inverse[part[inner]])
        return _decomposed(matrix)

    def table(self) -> InstanceTable:
        """All of them, for ``schemas.instances.write_table``."""
        scene = self._scene
        every = np.arange(len(self.ids))
        poses = self.poses(every, 0)
        motion = scene.rows.motion
        moving = np.zeros(0, np.int64) if motion is None else motion.among(self._lead)[0]
        paths = [self.poses(moving, s) for s in range(scene.samples)] if len(moving) else []
        shape = (scene.samples if len(moving) else 0, len(moving))
        return InstanceTable(
            scene.digest,
            self._classes,
            scene.levels,
            self.ids,
            self._class,
            self._local,
            self._labels,
            poses.position,
            quaternions(poses.rotation).astype(np.float32),
            self._scale.astype(np.float32),
            self._box.astype(np.float32),
            moving,
            np.array([p.position for p in paths]).reshape(*shape, 3),
            np.array([quaternions(p.rotation) for p in paths], np.float32).reshape(*shape, 4),
            np.array([(p.linear != 0.0).any(axis=(1, 2)) for p in paths], bool).reshape(shape),
        )

    @cached_property
    def _outliner(self) -> Outliner:
        return Outliner(self._scene, self._rows, self._first, self.slot_of_row)

    def seen(
        self,
        row: NDArray[np.int32],
        t: NDArray[np.float64],
        camera: Camera,
        sample: int,
        geometry: Geometry,
        masks: bool = False,
        rays: Rays | None = None,
    ) -> Seen:
        """What a frame shows of instances.

        Args:
            row: Row that each pixel shows, -1 for none, int32 [h * w].
            t: Ray parameter of what it shows (a pinhole's is planar depth), float64 [h * w].
            camera: Whose frame it is.
            sample: Time code.
            geometry: Of the scene, posed as at that sample.
            masks: Whether to make amodal masks, too.
            rays: The picture's, where the camera has a lens or a rolling shutter: planar depth and
                masks go by them.
        """
        if rays is not None and rays.depth is not None:
            t = np.where(t < np.inf, t * rays.depth, np.inf)
        count = len(self.ids)
        pixels = np.zeros((count, 5), np.int64)
        depths = np.zeros((count, 3))
        _measure(row, t, self.slot_of_row, camera.width, pixels, depths)
        which = np.flatnonzero(pixels[:, 0])
        pixels, depths = pixels[which], depths[which]
        border = (pixels[:, 1:3] == 0).any(axis=1)
        border |= (pixels[:, 3] == camera.width - 1) | (pixels[:, 4] == camera.height - 1)
        whole = np.concatenate([pixels, border[:, None]], axis=1)
        depths[:, 1] /= np.maximum(pixels[:, 0], 1)
        # What is known already of a picture that is no pinhole's.
        known: dict[str, Any] = {} if rays is None else {"rays": rays}
        found = self._outliner.outline(geometry, camera, row, which, pixels[:, 1:], masks, **known)
        amodal = (found.areas, found.full, found.bounded.astype(np.int64))
        table = {
            "id": self.ids[which],
            "class": np.array(self._classes, np.str_)[self._class[which]],
            "local_id": self._local[which],
            **self._label_names(which),
            **dict(zip(PIXEL_COLUMNS, whole.T, strict=True)),
            **dict(zip(DEPTH_COLUMNS, depths.T, strict=True)),
            **dict(zip(AMODAL_COLUMNS, amodal, strict=True)),
            **self._places(which, camera, sample),
        }
        if found.counts is None or found.starts is None:
            return Seen(table)
        size = (camera.height, camera.width)
        return Seen(table, Amodal(size, self.ids[which], found.counts, found.starts))

    def _places(
        self, which: NDArray[np.int64], camera: Camera, sample: int
    ) -> dict[str, NDArray[np.float64]]:
        """Poses and boxes."""
        poses = self.poses(which, sample)
        turn, eye = camera.camera_to_world[:3, :3], camera.camera_to_world[:3, 3]
        # Rows of the camera's axes: its inverse is its transpose.
        from_camera = ((poses.position - eye)[:, :, None] * turn).sum(axis=1)
        turned = (turn[None, :, :, None] * poses.rotation[:, :, None, :]).sum(axis=1)
        box = self._box[which]
        numbers = [
            from_camera, quaternions(turned), poses.position, quaternions(poses.rotation),
            box[:, 1] - box[:, 0], 0.5 * (box[:, 0] + box[:, 1]),
        ]  # fmt: skip
        columns = np.concatenate(numbers, axis=1).T
        return dict(zip((*POSE_COLUMNS, *BOX_COLUMNS), columns, strict=True))

    def _label_names(self, which: NDArray[np.int64]) -> dict[str, NDArray[np.str_]]:
        found = {}
        for index, level in enumerate(self._scene.levels):
            known = self._scene.label_names.get(level, {})
            ids, inverse = np.unique(self._labels[which, index], return_inverse=True)
            text = np.array([known.get(i, "") for i in ids.tolist()], np.str_)
            found[f"label.{level}"] = text[inverse] if len(ids) else np.zeros(0, np.str_)
        return found

    def _shown_first(self) -> NDArray[np.int64]:
        """The first sample at which each instance is there."""
        first = np.zeros(len(self.ids), np.int64)
        motion = self._scene.rows.motion
        if motion is not None:
            there = (motion.to_world[..., :3] != 0.0).any(axis=(2, 3))
            moves, at = motion.among(self._lead)
            first[moves] = np.argmax(there, axis=0)[at]
        return first

    def _local_boxes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Boxes around the meshes of each instance in its own frame and units, [n, 3] each."""
        scene = self._scene
        count = len(scene.parts)
        key = scene.rows.mesh[self._rows].astype(np.int64) * count + np.maximum(self._part, 0)
        kinds, kind = np.unique(key, return_inverse=True)
        low, high = np.empty((len(kinds), 3)), np.empty((len(kinds), 3))
        for i, (mesh, part) in enumerate(zip(kinds // count, kinds % count, strict=True)):
            low[i], high[i] = _mesh_box(scene.meshes[mesh], scene.parts[part])
        row_low, row_high = low[kind], high[kind]
        if (self._part < 0).any():
            self._add_loose(row_low, row_high)
        if not len(self._first):
            return np.zeros((0, 3)), np.zeros((0, 3))
        return (
            np.minimum.reduceat(row_low, self._first, axis=0),
            np.maximum.reduceat(row_high, self._first, axis=0),
        )

    def _add_loose(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        """Boxes of rows that do not keep their place: as at the first sample."""
        scene, lead = self._scene, self._lead[self.slot_of_row[self._rows]]
        for at in np.flatnonzero((self._part < 0) & (self._rows != lead)).tolist():
            frame = scene.rows.to_world[lead[at]][None]
            place = _composed(_inverses(frame), scene.rows.to_world[self._rows[at]][None])[0]
            low[at], high[at] = _mesh_box(scene.meshes[scene.rows.mesh[self._rows[at]]], place)

    def _find_labels(self) -> NDArray[np.uint32]:
        """Per level, the label that all faces of an instance share, else 0: uint32 [n, levels]."""
        scene = self._scene
        found = np.zeros((len(self.ids), len(scene.levels)), np.uint32)
        if not len(self._first):
            return found
        for index, level in enumerate(scene.levels):
            ranges = np.zeros((len(scene.meshes), 2), np.uint32)
            for i, mesh in enumerate(scene.meshes):
                values = mesh.labels.get(level)
                if values is not None and len(values):
                    ranges[i] = values.min(), values.max()
            of_row = ranges[scene.rows.mesh[self._rows]]
            least = np.minimum.reduceat(of_row[:, 0], self._first)
            most = np.maximum.reduceat(of_row[:, 1], self._first)
            found[:, index] = np.where(least == most, least, 0)
        return found


def _mesh_box(
    mesh: Mesh, place: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Box around a mesh in a frame that it has a place in; without faces, one that adds nothing."""
    if not len(mesh.faces):
        return np.full(3, np.inf), np.full(3, -np.inf)
    if np.array_equal(place, _IDENTITY):
        return mesh.box[0], mesh.box[1]
    points = (mesh.used_points[:, None, :] * place[:, :3]).sum(axis=2) + place[:, 3]
    return points.min(axis=0), points.max(axis=0)


def _composed(parent: NDArray[np.float64], child: NDArray[np.float64]) -> NDArray[np.float64]:
    """Parent * child of affine matrices [n, 3, 4]."""
    out = (parent[:, :, :3, None] * child[:, None, :, :]).sum(axis=2)
    out[:, :, 3] += parent[:, :, 3]
    return out


def _inverses(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverses of affine matrices [n, 3, 4]; the identity for those that have none."""
    out = np.empty_like(matrices)
    with np.errstate(all="ignore"):
        out[:, :, :3], determinant = inverses(matrices[:, :, :3])
        out[:, :, 3] = -(out[:, :, :3] * matrices[:, None, :, 3]).sum(axis=2)
    out[~np.isfinite(determinant) | (determinant == 0.0)] = _IDENTITY
    return out


def _decomposed(matrix: NDArray[np.float64]) -> Poses:
    """Rotation (by Gram and Schmidt, x first) and what is left of affine matrices [n, 3, 4].

    Of a mirrored one x is turned round; one that is flat along an axis gets any axis there.
    """
    count = len(matrix)
    poses = Poses(
        matrix[:, :, 3].copy(),
        np.empty((count, 3, 3)),
        np.empty((count, 3)),
        np.empty((count, 3, 3)),
    )
    _decompose(matrix, poses.rotation, poses.scale, poses.linear, np.empty((4, 3)))
    return poses


@kernel
def _normalized(v):  # type: ignore[no-untyped-def]
    """Make a vector as long as 1; False, and the vector as it was, where there is none."""
    # Scaled first: squares of small numbers may underflow.
    largest = max(abs(v[0]), max(abs(v[1]), abs(v[2])))
    if not largest > 0.0:
        return False
    for i in range(3):
        v[i] /= largest
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    for i in range(3):
        v[i] /= length
    return True


@kernel
def _cross(a, b, out):  # type: ignore[no-untyped-def]
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def _set_across(v, axis, out):  # type: ignore[no-untyped-def]
    """Some unit vector across another, which is not 0; ``axis`` is scratch."""
    least = 0
    for i in range(1, 3):
        if abs(v[i]) < abs(v[least]):
            least = i
    for i in range(3):
        axis[i] = 1.0 if i == least else 0.0
    _cross(v, axis, out)
    _normalized(out)


@kernel
def _decompose(matrix, rotation, scale, rest, vectors):  # type: ignore[no-untyped-def]
    """As ``_decomposed``; ``vectors`` is scratch, float64 [4, 3]."""
    x, y, z, axis = vectors[0], vectors[1], vectors[2], vectors[3]
    for k in range(matrix.shape[0]):
        m = matrix[k]
        for i in range(3):
            x[i], y[i], z[i] = m[i, 0], m[i, 1], m[i, 2]
            scale[k, i] = math.sqrt(m[0, i] * m[0, i] + m[1, i] * m[1, i] + m[2, i] * m[2, i])
        determinant = (
            (x[1] * y[2] - x[2] * y[1]) * z[0]
            + (x[2] * y[0] - x[0] * y[2]) * z[1]
            + (x[0] * y[1] - x[1] * y[0]) * z[2]
        )
        if determinant < 0.0:
            scale[k, 0] = -scale[k, 0]
            for i in range(3):
                x[i] = -x[i]
        flat = not _normalized(x)
        if flat:
            # Across what there is; the world's axis where there is nothing.
            if _normalized(y):
                if _normalized(z):
                    _cross(y, z, x)
                    flat = not _normalized(x)
                if flat:
                    _set_across(y, axis, x)
            elif _normalized(z):
                _set_across(z, axis, x)
            else:
                x[0], x[1], x[2] = 1.0, 0.0, 0.0
        for again in range(2):
            # Once more: of columns that are nearly along each other little is left.
            along = y[0] * x[0] + y[1] * x[1] + y[2] * x[2]
            for i in range(3):
                y[i] -= along * x[i]
            if not _normalized(y):
                if _normalized(z) and again == 0:
                    _cross(z, x, y)
                if not _normalized(y):
                    _set_across(x, axis, y)
        _cross(x, y, z)
        for i in range(3):
            rotation[k, i, 0], rotation[k, i, 1], rotation[k, i, 2] = x[i], y[i], z[i]
        for i in range(3):
            for j in range(3):
                total = 0.0
                for n in range(3):
                    total += rotation[k, n, i] * m[n, j]
                rest[k, i, j] = total


def quaternions(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (x, y, z, w), w >= 0, of rotation matrices [n, 3, 3]: float64 [n, 4].

    Shepperd, "Quaternion from rotation matrix", 1978: the largest component first.
    """
    out = np.empty((len(rotation), 4))
    _set_quaternions(np.ascontiguousarray(rotation), out)
    return out


@kernel
def _set_quaternions(rotation, out):  # type: ignore[no-untyped-def]
    for k in range(rotation.shape[0]):
        m, q = rotation[k], out[k]
        trace = m[0, 0] + m[1, 1] + m[2, 2]
        best = 3
        most = trace
        for i in range(3):
            if m[i, i] > most:
                best, most = i, m[i, i]
        if best == 3:
            q[0], q[1], q[2] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
            q[3] = 1.0 + trace
        else:
            i, j, n = best, (best + 1) % 3, (best + 2) % 3
            q[i] = 1.0 + 2.0 * m[i, i] - trace
            q[j] = m[i, j] + m[j, i]
            q[n] = m[i, n] + m[n, i]
            q[3] = m[n, j] - m[j, n]
        length = math.sqrt(((q[0] * q[0] + q[1] * q[1]) + q[2] * q[2]) + q[3] * q[3])
        if q[3] < 0.0:
            length = -length
        for i in range(4):
            # + 0: no -0 in tables.
            q[i] = q[i] / length + 0.0


@kernel
def _measure(row, t, slot_of_row, width, pixels, depths):  # type: ignore[no-untyped-def]
    """Per instance: pixels, first column and row, last column and row; least depth, sum, most."""
    for k in range(row.shape[0]):
        if row[k] < 0:
            continue
        slot = slot_of_row[row[k]]
        if slot < 0:
            continue
        y = k // width
        x = k - y * width
        if pixels[slot, 0] == 0:
            pixels[slot, 1] = x
            pixels[slot, 2] = y
            depths[slot, 0] = t[k]
        pixels[slot, 0] += 1
        pixels[slot, 1] = min(pixels[slot, 1], x)
        pixels[slot, 3] = max(pixels[slot, 3], x)
        pixels[slot, 4] = y
        depths[slot, 0] = min(depths[slot, 0], t[k])
        depths[slot, 1] += t[k]
        depths[slot, 2] = max(depths[slot, 2], t[k])
