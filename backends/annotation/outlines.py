"""Amodal silhouettes: what a frame's instances would show if nothing stood before them.

A pixel is in the silhouette of an instance if the ray through its center meets it when everything
else is taken away: the definition of annotation with one instance in the scene, exact likewise
(``scenec.backends.exact.silhouette``). Columns and masks made of it: ``scenec.schemas.instances``
and ``scenec.schemas.amodal``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.camera.shutter import is_rolling
from scenec.backends.contract import Rays
from scenec.backends.exact import outline_rays
from scenec.backends.exact.bvh import Geometry
from scenec.backends.exact.masks import LANES, Masks, mark_visible, runs
from scenec.backends.exact.silhouette import RAY_COST, Members, Pinhole, frame_rows, outline_all
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas.threads import over_threads

#: Pixels of windows that are held at once, unless one window alone has more.
_AT_ONCE = 1 << 25


@dataclass(frozen=True)
class Silhouettes:
    """Silhouettes of some instances, in the order in which they were asked for.

    Attributes:
        areas: Pixels within the picture, int64 [n].
        full: Pixels within the picture continued by its own size on each side, int64 [n].
        bounded: Whether all of the instance lies before the camera and within the continued
            picture, so that nothing is missing from ``full``, bool [n].
        counts: Run lengths of the masks within the picture (``scenec.schemas.rle``), one after the
            other, uint32; None unless asked for.
        starts: Where each begins, with one more at the end, int64 [n + 1]; likewise.
    """

    areas: NDArray[np.int64]
    full: NDArray[np.int64]
    bounded: NDArray[np.bool_]
    counts: NDArray[np.uint32] | None = None
    starts: NDArray[np.int64] | None = None


class Outliner:
    """Outlines the instances of a scene, one by one; built once per batch.

    Args:
        scene: The scene.
        rows: Rows of all instances, one instance after the other, int64 [r].
        firsts: Where each instance's begin, int64 [n].
        slot_of_row: Instance of each of the scene's rows, -1 for none, int32.
    """

    def __init__(
        self,
        scene: RenderScene,
        rows: NDArray[np.int64],
        firsts: NDArray[np.int64],
        slot_of_row: NDArray[np.int32],
    ) -> None:
        self._rows = rows
        self._firsts = np.append(firsts, len(rows)).astype(np.int64)
        self._slot_of_row = slot_of_row
        mesh = scene.rows.mesh[rows].astype(np.int64)
        self._boxes = np.array([m.box for m in scene.meshes]).reshape(-1, 2, 3)[mesh]
        ends = np.cumsum([0, *(len(one.points) for one in scene.meshes)])
        self._bases = np.stack([ends[mesh], ends[mesh + 1]], axis=1)

    def outline(
        self,
        geometry: Geometry,
        camera: Camera,
        row: NDArray[np.int32],
        which: NDArray[np.int64],
        extents: NDArray[np.int64],
        masks: bool = False,
        ray_cost: int = RAY_COST,
        rays: Rays | None = None,
    ) -> Silhouettes:
        """Outline the instances that a picture shows.

        A picture through a lens, or with a rolling shutter, is not continued beyond its border:
        ``full`` is ``areas`` there.

        Args:
            geometry: Of the scene, posed as at the picture's sample.
            camera: The camera.
            row: Row that each pixel shows, -1 for none, int32 [h * w].
            which: Instances, ascending, int64 [n].
            extents: First column, first row, last column and last row of each, int64 [n, 4].
            masks: Whether to make masks, too.
            ray_cost: What a ray costs in triangles (``exact.silhouette``); changes time alone.
            rays: The picture's; made where they are missing and needed.
        """
        firsts, entries = self._entries(which)
        rows = self._rows[entries]
        parts = np.zeros((len(rows), 4), np.int64)
        whole = np.zeros(len(rows), bool)
        members = Members(rows, parts, self._bases[entries], firsts)
        view: Pinhole | outline_rays.View
        if camera.lens is not None or is_rolling(camera):
            view = outline_rays.View.of(geometry, rays or camera_rays(camera))
            outline_rays.frame_rows(view, rows, parts)
        else:
            view, boxes = Pinhole.of(camera), self._boxes[entries]
            over_threads(frame_rows, len(rows), geometry, members, boxes, view, whole)
        windows = _union(parts, firsts[:-1], extents)
        pixels = (windows[:, 1] - windows[:, 0]) * (windows[:, 3] - windows[:, 2])
        bounded = np.logical_and.reduceat(whole, firsts[:-1]) if len(which) else whole
        areas = np.zeros((len(which), 2), np.int64)
        seen = np.full(len(self._firsts) - 1, -1, np.int64)
        seen[which] = np.arange(len(which))
        sizes = np.zeros(len(which), np.int64)
        counts: list[NDArray[np.uint32]] = []
        for first, end in _groups(pixels):
            starts = np.full(len(which), -1, np.int64)
            starts[first:end] = np.cumsum(pixels[first:end]) - pixels[first:end]
            marks = np.zeros(int(pixels[first:end].sum()), np.uint8)
            masks_now = Masks(windows, starts, marks, areas)
            slots = self._slot_of_row, seen
            over_threads(mark_visible, camera.height, row, *slots, camera.width, masks_now)
            # The largest first: no thread is left with one at the end.
            order = first + np.argsort(-pixels[first:end], kind="stable")
            work = min(LANES, len(order)), geometry, members, order, masks_now, view
            if isinstance(view, Pinhole):
                over_threads(outline_all, *work, ray_cost)
            else:
                over_threads(outline_rays.outline_all, *work, bounded)
            if masks:
                counts.append(_runs(order, masks_now, (camera.height, camera.width), sizes))
        return Silhouettes(
            areas[:, 0],
            areas[:, 1],
            bounded,
            np.concatenate(counts or [np.empty(0, np.uint32)]) if masks else None,
            np.concatenate([[0], np.cumsum(sizes)]) if masks else None,
        )

    def _entries(self, which: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Returns each instance's first row, with one more at the end, and all these rows."""
        counts = self._firsts[which + 1] - self._firsts[which]
        firsts = np.concatenate([[0], np.cumsum(counts)])
        entries = np.arange(firsts[-1]) + np.repeat(self._firsts[which] - firsts[:-1], counts)
        return firsts, entries


def _union(
    parts: NDArray[np.int64], firsts: NDArray[np.int64], extents: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Windows around the parts of each instance, [n, 4]; they hold the pixels that show it, too."""
    if not len(firsts):
        return np.zeros((0, 4), np.int64)
    empty = (parts[:, 1] <= parts[:, 0]) | (parts[:, 3] <= parts[:, 2])
    windows = np.empty((len(firsts), 4), np.int64)
    for low in (0, 2):
        least = np.where(empty, np.iinfo(np.int64).max, parts[:, low])
        most = np.where(empty, np.iinfo(np.int64).min, parts[:, low + 1])
        at = low // 2
        windows[:, low] = np.minimum(np.minimum.reduceat(least, firsts), extents[:, at])
        windows[:, low + 1] = np.maximum(np.maximum.reduceat(most, firsts), extents[:, at + 2] + 1)
    return windows


def _groups(pixels: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Ranges of instances whose windows are held at once."""
    ends = np.cumsum(pixels)
    found = []
    first = 0
    while first < len(pixels):
        before = int(ends[first] - pixels[first])
        end = max(first + 1, int(np.searchsorted(ends, before + _AT_ONCE, side="right")))
        found.append((first, end))
        first = end
    return found


def _runs(
    order: NDArray[np.int64], masks: Masks, shape: tuple[int, int], sizes: NDArray[np.int64]
) -> NDArray[np.uint32]:
    """Run lengths of the masks of a group; their numbers go into ``sizes``."""
    first, end = int(order.min()), int(order.max()) + 1
    begins = np.zeros(len(sizes), np.int64)
    nothing = np.empty(0, np.uint32)
    lanes = min(LANES, len(order))
    over_threads(runs, lanes, order, masks, shape, sizes, begins, nothing)
    begins[first:end] = np.cumsum(sizes[first:end]) - sizes[first:end]
    counts = np.empty(int(sizes[first:end].sum()), np.uint32)
    over_threads(runs, lanes, order, masks, shape, sizes, begins, counts)
    return counts
