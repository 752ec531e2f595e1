"""Expands prims into rows: single meshes, point instancers, and instancers within instancers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.backends.stage import values
from scenec.backends.stage.expanded import Expanded, interleaved, placed
from scenec.backends.stage.frame import composed
from scenec.backends.stage.implicit import is_shape
from scenec.backends.stage.labels import prim_labels
from scenec.backends.stage.meshes import MeshTable
from scenec.backends.stage.placing import instance_mask, instance_matrices
from scenec.backends.stage.surfaces import read_variation
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

_IDENTITY = np.eye(4)[:3]
#: A local id above this would leave no room for others.
_LARGEST_LOCAL_ID = 2**31
#: What is said of an instancer whose ids are not used.
_OTHER_IDS = (
    "ids that are not from 1 to 2147483647, one for each instance and each once, are not followed, "
    "instances are numbered by their places"
)
#: ``Expanded.part`` of rows that do not keep their place within their instance.
_NO_PART = -1


@dataclass(frozen=True)
class _Class:
    """A class of single objects: its prim, and what is added to local ids (None: ids are off)."""

    path: str
    base: int | None


@dataclass(frozen=True)
class _Place:
    """Holds the state that a prim inherits from its ancestors.

    Attributes:
        matrix: Of the frame it stands in, float64 [3, 4], or [samples, 3, 4] where that moves.
        relative: The same from the frame of the instance around it; None where that is not known.
        labels: Labels of the instancer around it.
        instance_id: Id of the instance that it is part of; None outside of instances.
        of_class: The class of single objects that it is below of.
        shown: At which samples, bool [samples]; None: at all.
    """

    matrix: NDArray[np.float64]
    relative: NDArray[np.float64] | None
    labels: dict[str, int]
    instance_id: int | None = None
    of_class: _Class | None = None
    shown: NDArray[np.bool_] | None = None


class Expander:
    """Walks a stage; remembers meshes and which ids are taken.

    Args:
        meshes: Filled with the meshes that are met.
        times: Of the samples. Topology, points and ids are those of the first.
        labeled: Numbers from 1, by path, of prims that are instances unless they say so themselves.
    """

    def __init__(
        self,
        meshes: MeshTable,
        times: Sequence[Usd.TimeCode],
        labeled: Mapping[str, int],
    ):
        self._meshes = meshes
        self._times = list(times)
        self._labeled = labeled
        self._next_id = 0
        #: Paths of shapes and instancers outside of prototypes, and the rows of each, in order.
        self.origins: list[tuple[str, int]] = []
        #: Instancers being expanded, the outermost first.
        self._open: list[str] = []
        #: Base and largest frame id of each class, by path.
        self._ranges: dict[str, list[int]] = {}
        #: Classes that state no base.
        self._chosen: set[str] = set()
        self._parts: dict[bytes, int] = {}
        self._part(_IDENTITY)

    @property
    def bases(self) -> dict[str, int]:
        """First frame id (less one) of each class or object, by path, ascending."""
        # Of equal bases the last is the one that has ids.
        ordered = sorted(self._ranges.items(), key=lambda item: item[1])
        return {path: base for path, (base, _) in ordered}

    @property
    def parts(self) -> NDArray[np.float64]:
        """Places of meshes within their instances, float64 [p, 3, 4], for ``Expanded.part``."""
        return np.array([np.frombuffer(key).reshape(3, 4) for key in self._parts])

    def expand(self, root: Usd.Prim) -> Expanded:
        """Rows of everything that is visible at or below a prim at some sample."""
        parts: list[Expanded] = []
        self._walk(root, _Place(_IDENTITY, _IDENTITY, {}), parts)
        rows = Expanded.joined(parts)
        self._require_distinct()
        if not self._labeled:
            return rows
        # Only now all authored ids are known.
        base = self._next_id
        for path, number in self._labeled.items():
            self._take(path, base + number - 1, 1)
        ids = np.where(rows.instance_id < 0, base - rows.instance_id, rows.instance_id)
        return replace(rows, instance_id=ids)

    def _require_distinct(self) -> None:
        """Ends where a class whose ids were chosen has some of a class that states its own."""
        for path in self._chosen:
            base, last = self._ranges[path]
            for other, (first, end) in self._ranges.items():
                if other != path and max(base, first) < min(last, end):
                    raise StageError(
                        f"{path}: has no {names.ATTR_INSTANCE_ID_BASE}, and {other} states one; "
                        f"their ids from {max(base, first) + 1} to {min(last, end)} are the same: "
                        "author it on both"
                    )

    def _walk(self, prim: Usd.Prim, place: _Place, parts: list[Expanded]) -> None:
        shown = self._is_rendered(prim)
        if not (shown if place.shown is None else shown & place.shown).any():
            return
        if not shown.all():
            place = _shown(place, shown)
        self._meshes.unread.prim(prim, in_prototype=bool(self._open))
        place = self._with_id(prim, self._moved(prim, place))
        if prim.IsA(UsdGeom.PointInstancer):
            path = str(prim.GetPath())
            if path in self._open:
                raise StageError(f"{path}: is a part of its own prototypes")
            self._open.append(path)
            if (place.instance_id or 0) < 0:
                # Not said to be one thing: its instances are some.
                place = replace(place, instance_id=None)
            parts.append(self._expand_instancer(UsdGeom.PointInstancer(prim), place))
            self._open.pop()
            self._note(prim, parts[-1])
            return
        if is_shape(prim):
            poses = self._meshes.add(prim, place.labels)
            part = 0 if place.instance_id is None else self._part(place.relative)
            rows = []
            if len(poses) > 1 and place.instance_id is not None:
                # Says where the instance is at all samples; its poses come and go.
                rows.append(self._shape([self._meshes.frame()], place, part))
                part = _NO_PART
            for pose in poses:
                at = place if pose.shown is None else _shown(place, pose.shown)
                rows.append(self._shape(pose.meshes, at, part))
            parts.append(Expanded.joined(rows))
            self._note(prim, parts[-1])
        for child in prim.GetFilteredChildren(Usd.TraverseInstanceProxies()):
            self._walk(child, place, parts)

    def _shape(self, meshes: list[int], place: _Place, part: int) -> Expanded:
        count = len(meshes)
        matrix = self._hide_at_samples(place.matrix[..., None, :, :], place.shown)
        return Expanded.of(
            np.array(meshes, np.int32),
            np.repeat(matrix, count, axis=-3),
            np.full(count, place.instance_id or 0, np.int64),
            np.zeros(count, np.float32),
            np.full(count, part, np.int32),
        )

    def _note(self, prim: Usd.Prim, rows: Expanded) -> None:
        if not self._open:
            self.origins.append((str(prim.GetPath()), len(rows.mesh)))

    def _is_rendered(self, prim: Usd.Prim) -> NDArray[np.bool_]:
        """Whether a prim (and what is below it) is rendered: visible, purpose default or render.

        Bool [samples], or [1] where that never changes.
        """
        imageable = UsdGeom.Imageable(prim)
        if not imageable:
            return np.ones(1, bool)
        # USD takes a purpose that is no token for none.
        values.word(imageable.GetPurposeAttr(), "")
        if imageable.ComputePurpose() not in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render):
            return np.zeros(1, bool)
        return values.visible(prim, self._times)

    def _hide_at_samples(
        self, poses: NDArray[np.float64], visible: NDArray[np.bool_] | None
    ) -> NDArray[np.float64]:
        """Matrices [..., r, 3, 4], scaled to a point at samples where they are hidden.

        Args:
            poses: With the samples in front, or without.
            visible: bool [samples] or [samples, r]; None: always.
        """
        if visible is None:
            return poses
        poses = np.array(np.broadcast_to(poses, (len(self._times), *poses.shape[-3:])))
        visible = np.broadcast_to(visible.reshape(len(visible), -1), poses.shape[:2])
        poses[~visible, :, :3] = 0.0
        return poses

    def _moved(self, prim: Usd.Prim, place: _Place) -> _Place:
        """The frame that a prim makes for what is in it."""
        xformable = UsdGeom.Xformable(prim)
        if not xformable:
            return place
        local = values.matrices(prim, self._times)
        if xformable.GetResetXformStack():
            return replace(place, matrix=local, relative=None)
        relative = place.relative
        if place.instance_id is not None and relative is not None:
            relative = composed(relative, local)
        return replace(place, matrix=composed(place.matrix, local), relative=relative)

    def _with_id(self, prim: Usd.Prim, place: _Place) -> _Place:
        """The place with what the prim says about ids: a class of single objects, or one."""
        if prim.IsPseudoRoot() or (place.instance_id is not None and place.instance_id >= 0):
            return place
        path = str(prim.GetPath())
        own, local = (
            _number(prim, name) for name in (names.ATTR_INSTANCE_ID, names.ATTR_LOCAL_INSTANCE_ID)
        )
        if own is not None:
            if own != 0:
                self._take(path, own - 1, 1)
            return replace(place, instance_id=own, relative=_IDENTITY)
        if local is not None:
            of_class = place.of_class
            if of_class is None:
                # No base: the first number that is free, one for all objects beside each other.
                parent = str(prim.GetParent().GetPath())
                of_class = _Class(parent, self._ranges.get(parent, [self._next_id])[0])
                self._chosen.add(parent)
            if not 1 <= local < _LARGEST_LOCAL_ID:
                raise StageError(
                    f"{path}: {names.ATTR_LOCAL_INSTANCE_ID} is {local}, expected 1 or more"
                )
            if of_class.base is None:
                return replace(place, instance_id=0, relative=_IDENTITY)
            self._take(of_class.path, of_class.base, local)
            return replace(place, instance_id=of_class.base + local, relative=_IDENTITY)
        if path in self._labeled:
            return replace(place, instance_id=-self._labeled[path], relative=_IDENTITY)
        if not prim.IsA(UsdGeom.PointInstancer):
            base, enabled = _number(prim, names.ATTR_INSTANCE_ID_BASE), _ids_enabled(prim)
            if base is not None:
                self._take(path, base, 0)
            if base is not None or not enabled:
                return replace(place, of_class=_Class(path, base if enabled else None))
        return place

    def _expand_instancer(self, instancer: UsdGeom.PointInstancer, place: _Place) -> Expanded:
        prim = instancer.GetPrim()
        prototype, local = instance_matrices(instancer, self._times)
        count = len(prototype)
        if place.instance_id is None:
            ids = self._frame_ids(instancer, count)
        else:
            # Inside another instance: all of it is part of that one.
            ids = np.full(count, place.instance_id, np.int64)
        variation = read_variation(prim, count)
        if variation is None:
            variation = np.zeros(count, np.float32)
        labels = {**place.labels, **prim_labels(prim, self._meshes.labels)}
        mask = instance_mask(instancer, self._times, count)
        shown = mask.any(axis=0)
        world = placed(place.matrix[..., None, :, :], local)
        if not mask[:, shown].all():
            hidden = mask if place.shown is None else mask & place.shown[:, None]
            world = self._hide_at_samples(world, hidden)
        else:
            world = self._hide_at_samples(world, place.shown)
        contents = self._contents(prim, prototype[shown], labels)
        sizes = np.array([len(content.mesh) for content in contents], np.int64)
        # Rows in the order of the instances, whatever prototype they have.
        chosen = np.flatnonzero(shown)
        last = np.cumsum(sizes[prototype[chosen]])
        total = int(last[-1]) if len(last) else 0
        first = last - sizes[prototype[chosen]]
        parts: list[tuple[NDArray[np.int64], Expanded]] = []
        for index, content in enumerate(contents):
            if not len(content.mesh):
                continue
            mine = np.flatnonzero(prototype[chosen] == index)
            rows = len(content.mesh)
            at = (first[mine, None] + np.arange(rows)).ravel()
            who = chosen[mine]
            poses = placed(world[..., who, :, :], content.poses)
            if place.instance_id is None:
                part = np.tile(content.part, len(mine))
            else:
                part = self._parts_of(place.relative, local[..., who, :, :], content.poses)
            parts.append(
                (
                    at,
                    Expanded.of(
                        np.tile(content.mesh, len(mine)),
                        poses,
                        np.repeat(ids[who], rows),
                        np.repeat(variation[who], rows) + np.tile(content.variation, len(mine)),
                        part,
                    ),
                )
            )
        return interleaved(total, parts)

    def _contents(
        self, prim: Usd.Prim, used: NDArray[np.int32], labels: dict[str, int]
    ) -> list[Expanded]:
        """Expands each prototype in the frame of its instances; unused ones are empty."""
        contents = []
        counts = np.bincount(used)
        for index, target in enumerate(values.targets(prim, "prototypes")):
            parts: list[Expanded] = []
            if index < len(counts) and counts[index]:
                root = prim.GetStage().GetPrimAtPath(target)
                if not root:
                    raise StageError(f"{prim.GetPath()}: prototype {target} does not exist")
                # Id 0 here only says "inside of an instance".
                outside = self._meshes.copies
                self._meshes.copies *= int(counts[index])
                self._walk(root, _Place(_IDENTITY, _IDENTITY, labels, instance_id=0), parts)
                self._meshes.copies = outside
            contents.append(Expanded.joined(parts))
        return contents

    def _part(self, relative: NDArray[np.float64] | None) -> int:
        """Number of a place within an instance."""
        if relative is None or relative.ndim > 2:
            return _NO_PART
        # Adding 0 makes -0 and 0 the same bytes.
        return self._parts.setdefault((relative + 0.0).tobytes(), len(self._parts))

    def _parts_of(
        self,
        relative: NDArray[np.float64] | None,
        local: NDArray[np.float64],
        content: NDArray[np.float64],
    ) -> NDArray[np.int32]:
        """Numbers of the places of an instancer's rows within the instance around it."""
        rows = local.shape[-3] * content.shape[-3]
        if relative is None or max(relative.ndim - 1, local.ndim, content.ndim) > 3:
            return np.full(rows, _NO_PART, np.int32)
        places = placed(composed(relative, local), content)
        return np.fromiter((self._part(p) for p in places), np.int32, rows)

    def _frame_ids(self, instancer: UsdGeom.PointInstancer, count: int) -> NDArray[np.int64]:
        prim = instancer.GetPrim()
        path = str(prim.GetPath())
        base = _number(prim, names.ATTR_INSTANCE_ID_BASE)
        if base is None:
            base = self._next_id
            self._chosen.add(path)
        local = values.array(instancer.GetIdsAttr(), np.int64, self._times[0])
        usable = len(local) == count and (
            count == 0
            or (
                local.min() >= 1
                and local.max() < _LARGEST_LOCAL_ID
                and ((np.diff(local) > 0).all() or len(np.unique(local)) == count)
            )
        )
        if not usable:
            if len(local):
                self._meshes.unread.add(_OTHER_IDS, prim)
            # Foreign ids may be missing, too: the place in the array then counts.
            local = np.arange(1, count + 1, dtype=np.int64)
        self._take(path, base, int(local.max(initial=0)))
        if not _ids_enabled(prim):
            return np.zeros(count, np.int64)
        return (base + local).astype(np.int64)

    def _take(self, path: str, base: int, local: int) -> None:
        """Notes that a class has this base and local ids up to this one.

        Raises:
            StageError: Frame ids do not fit into 32 bits.
        """
        if base < 0 or base + local >= 2**32:
            raise StageError(f"{path}: instance ids do not fit into 32 bits")
        self._next_id = max(self._next_id, base + local)
        known = self._ranges.setdefault(path, [base, base])
        known[1] = max(known[1], base + local)


def _shown(place: _Place, shown: NDArray[np.bool_]) -> _Place:
    """The place, where it is shown at these samples only."""
    return replace(place, shown=shown if place.shown is None else shown & place.shown)


def _number(prim: Usd.Prim, name: str) -> int | None:
    attribute = prim.GetAttribute(name)
    if not attribute or not attribute.HasValue():
        return None
    return values.whole(attribute, 0, Usd.TimeCode.EarliestTime())


def _ids_enabled(prim: Usd.Prim) -> bool:
    return values.flag(prim.GetAttribute(names.ATTR_INSTANCE_IDS_ENABLED), True)
