"""Tabulates instances: pose, size, and the pixels of a frame that show each.

The columns, and what they mean: ``scenec.schemas.instances``, which also reads the tables.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.outlines import Outliner
from scenec.backends.annotation.poses import Poses, decomposed
from scenec.backends.contract import Rays
from scenec.backends.exact.bvh import Geometry
from scenec.backends.stage.scene import Camera, Mesh, RenderScene
from scenec.schemas.affine import box_around, composed, inverses_or_identity, moved_boxes
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
from scenec.schemas.quaternions import quaternions

_IDENTITY = np.eye(4)[:3]
#: By how much of itself an instance that only turns may seem to change its size: rounding.
_SAME_SIZE = 2e-6


@dataclass(frozen=True)
class FrameInstances:
    """Holds a frame's table of instances and its amodal masks.

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
        self._inverse = inverses_or_identity(scene.parts)
        self._lead_part = self._part[starts]
        loose = (self._part < 0) & (self._rows != self._lead[slots])
        self._loose = np.flatnonzero(loose)
        self._local: tuple[int, NDArray[np.float64]] | None = None
        every, first = np.arange(len(starts)), self._first_samples()
        poses = self.poses(every, first)
        self._scale, self._box = poses.scale, moved_boxes(poses.linear, self._local_boxes(0))
        #: Instances whose scale or box is another at some sample, bool [n].
        self._resized = self._find_resized()
        for sample in np.unique(first[self._resized]).tolist():
            which = np.flatnonzero(self._resized & (first == sample))
            self._box[which] = moved_boxes(poses.linear[which], self._local_boxes(sample)[which])
        self._labels = self._find_labels()
        bases = np.array(list(scene.instance_paths.values()) or [0], np.int64)
        self._classes = tuple(scene.instance_paths) or ("",)
        of_class = np.searchsorted(bases, self.ids.astype(np.int64), side="left") - 1
        self._class: NDArray[np.int32] = np.maximum(of_class, 0).astype(np.int32)
        self._local_id = (self.ids.astype(np.int64) - bases[self._class]).astype(np.uint32)

    def poses(self, which: NDArray[np.int64], sample: int | NDArray[np.int64]) -> Poses:
        """Returns the poses of some instances.

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
        matrix[inner] = composed(matrix[inner], self._inverse[part[inner]])
        return decomposed(matrix)

    def table(self) -> InstanceTable:
        """All of them, for ``schemas.instances.write_table``."""
        scene = self._scene
        every = np.arange(len(self.ids))
        poses = self.poses(every, 0)
        motion = scene.rows.motion
        moves = self._resized.copy()
        if motion is not None:
            moves[motion.among(self._lead)[0]] = True
        moving = np.flatnonzero(moves)
        paths = [self.poses(moving, s) for s in range(scene.samples)] if len(moving) else []
        shape = (scene.samples if len(moving) else 0, len(moving))
        sizes: dict[str, NDArray[np.float32]] = {}
        if self._resized.any():
            found = [self._sizes(moving, s) for s in range(scene.samples)]
            sizes["moving_scale"] = np.array([scale for scale, _ in found], np.float32)
            sizes["moving_box"] = np.array([box for _, box in found], np.float32)
        return InstanceTable(
            scene.digest,
            self._classes,
            scene.levels,
            self.ids,
            self._class,
            self._local_id,
            self._labels,
            poses.position,
            quaternions(poses.rotation).astype(np.float32),
            self._scale.astype(np.float32),
            self._box.astype(np.float32),
            moving,
            np.array([p.position for p in paths]).reshape(*shape, 3),
            np.array([quaternions(p.rotation) for p in paths], np.float32).reshape(*shape, 4),
            np.array([(p.linear != 0.0).any(axis=(1, 2)) for p in paths], bool).reshape(shape),
            **sizes,
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
    ) -> FrameInstances:
        """Measures the instances that a frame shows.

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
        extra: dict[str, Any] = {} if rays is None else {"rays": rays}
        found = self._outliner.outline(geometry, camera, row, which, pixels[:, 1:], masks, **extra)
        amodal = (found.areas, found.full, found.bounded.astype(np.int64))
        table = {
            "id": self.ids[which],
            "class": np.array(self._classes, np.str_)[self._class[which]],
            "local_id": self._local_id[which],
            **self._label_names(which),
            **dict(zip(PIXEL_COLUMNS, whole.T, strict=True)),
            **dict(zip(DEPTH_COLUMNS, depths.T, strict=True)),
            **dict(zip(AMODAL_COLUMNS, amodal, strict=True)),
            **self._places(which, camera, sample),
        }
        if found.counts is None or found.starts is None:
            return FrameInstances(table)
        size = (camera.height, camera.width)
        return FrameInstances(table, Amodal(size, self.ids[which], found.counts, found.starts))

    def _places(
        self, which: NDArray[np.int64], camera: Camera, sample: int
    ) -> dict[str, NDArray[np.float64]]:
        """Poses and boxes."""
        poses = self.poses(which, sample)
        turn, eye = camera.camera_to_world[:3, :3], camera.camera_to_world[:3, 3]
        # Rows of the camera's axes: its inverse is its transpose.
        from_camera = ((poses.position - eye)[:, :, None] * turn).sum(axis=1)
        turned = (turn[None, :, :, None] * poses.rotation[:, :, None, :]).sum(axis=1)
        box = self._sizes(which, sample)[1]
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

    def _first_samples(self) -> NDArray[np.int64]:
        """The first sample at which each instance is there."""
        first = np.zeros(len(self.ids), np.int64)
        motion = self._scene.rows.motion
        if motion is not None:
            there = (motion.to_world[..., :3] != 0.0).any(axis=(2, 3))
            moves, at = motion.among(self._lead)
            first[moves] = np.argmax(there, axis=0)[at]
        return first

    def _find_resized(self) -> NDArray[np.bool_]:
        resized = np.zeros(len(self.ids), bool)
        resized[self.slot_of_row[self._rows[self._loose]]] = True
        motion = self._scene.rows.motion
        if motion is None:
            return resized
        moves, at = motion.among(self._lead)
        least = np.full((len(moves), 3, 3), np.inf)
        most = -least
        hands = np.zeros((2, len(moves)), bool)
        for to_world in motion.to_world:
            linear = to_world[at, :, :3]
            # Lengths and angles of its columns: the same however it is turned.
            gram = (linear[:, :, :, None] * linear[:, :, None, :]).sum(axis=1)
            shown = (linear != 0.0).any(axis=(1, 2))
            mirrored = np.linalg.det(linear) < 0.0
            hands |= shown & np.stack([mirrored, ~mirrored])
            np.minimum(least, gram, out=least, where=shown[:, None, None])
            np.maximum(most, gram, out=most, where=shown[:, None, None])
        with np.errstate(invalid="ignore"):
            # One that is never shown is infinite less infinite.
            change = (most - least).max(axis=(1, 2), initial=0.0)
            limit = _SAME_SIZE * np.abs(most).max(axis=(1, 2), initial=0.0)
        resized[moves] |= (change > limit) | hands.all(axis=0)
        return resized

    def _sizes(
        self, which: NDArray[np.int64], sample: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns scales [n, 3] and boxes [n, 2, 3] at a sample; hidden ones as first visible."""
        scale, box = self._scale[which], self._box[which]
        at = np.flatnonzero(self._resized[which])
        if len(at):
            poses = self.poses(which[at], sample)
            shown = (poses.linear != 0.0).any(axis=(1, 2))
            at = at[shown]
            scale[at] = poses.scale[shown]
            box[at] = moved_boxes(poses.linear[shown], self._local_boxes(sample)[which[at]])
        return scale, box

    def _local_boxes(self, sample: int) -> NDArray[np.float64]:
        """Returns boxes around each instance's meshes in its own frame and units, [n, 2, 3]."""
        sample = sample if len(self._loose) else 0
        if self._local is None or self._local[0] != sample:
            self._local = (sample, self._find_boxes(sample))
        return self._local[1]

    def _find_boxes(self, sample: int) -> NDArray[np.float64]:
        scene = self._scene
        count = len(scene.parts)
        key = scene.rows.mesh[self._rows].astype(np.int64) * count + np.maximum(self._part, 0)
        kinds, kind = np.unique(key, return_inverse=True)
        low, high = np.empty((len(kinds), 3)), np.empty((len(kinds), 3))
        for i, (mesh, part) in enumerate(zip(kinds // count, kinds % count, strict=True)):
            low[i], high[i] = _mesh_box(scene.meshes[mesh], scene.parts[part])
        row_low, row_high = low[kind], high[kind]
        if len(self._loose):
            self._add_loose(sample, row_low, row_high)
        if not len(self._first):
            return np.zeros((0, 2, 3))
        corners = (
            np.minimum.reduceat(row_low, self._first, axis=0),
            np.maximum.reduceat(row_high, self._first, axis=0),
        )
        return np.stack(corners, axis=1)

    def _add_loose(self, sample: int, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        """Adds boxes of rows that move within their instance at a sample; empty if hidden."""
        scene = self._scene
        to_world, rows = scene.rows_at(sample).to_world, self._rows[self._loose]
        slots = self.slot_of_row[rows]
        inverse = self._inverse[np.maximum(self._lead_part[slots], 0)]
        frames = composed(to_world[self._lead[slots]], inverse)
        places = composed(inverses_or_identity(frames), to_world[rows])
        for at, row, place in zip(self._loose.tolist(), rows.tolist(), places, strict=True):
            if to_world[row, :, :3].any():
                low[at], high[at] = _mesh_box(scene.meshes[scene.rows.mesh[row]], place)
            else:
                low[at], high[at] = np.inf, -np.inf

    def _find_labels(self) -> NDArray[np.uint32]:
        """Per level, the label that all faces of an instance share, else 0: uint32 [n, levels]."""
        scene = self._scene
        found = np.zeros((len(self.ids), len(scene.levels)), np.uint32)
        if not len(self._first):
            return found
        for index, level in enumerate(scene.levels):
            # What has no faces says nothing.
            ranges = np.tile(np.array([2**32 - 1, 0], np.uint32), (len(scene.meshes), 1))
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
    low, high = box_around(points)
    return low, high


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
