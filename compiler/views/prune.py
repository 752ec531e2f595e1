"""Pruning: what no camera of the batch can see the effect of is left out; what stays is untouched.

Instances go as a whole (their ids stay reserved), tiles of the terrain likewise, then models and
materials that nothing is any more. What stays keeps its arrays bit by bit, and its order. Something
stays if

1. it is seen: at any sample its ball meets a view's volume (``frustum``) and is not behind the
   ground (``occlusion``); both are conservative, so every pixel's first hit stays, and annotation
   with it;
2. with color, its shadow, swept away from the lights, meets what is seen; or
3. with color, it is near enough and large enough as seen from what is seen (``illumination``), or
   shines itself.

With color the terrain stays whole: ground out of view is what most of the light that comes from
below comes from. Where a mirror may show anything, or a sky's picture casts shadows, all stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.scene.ground import Ground, MeshTile
from scenec.compiler.scene.objects import Placed, Scatter
from scenec.compiler.scene.scene import Scene
from scenec.compiler.views.frustum import COLOR, Views, chosen, views_of_all
from scenec.compiler.views.illumination import (
    MIN_VIEW_FACTOR,
    shadows_visible_blocks,
    view_factors,
    visible_blocks,
)
from scenec.compiler.views.needed import Keep, Needs, without_unused
from scenec.compiler.views.occlusion import BlockRelief, relief_of_tiles, with_horizon
from scenec.compiler.views.visible import BEHIND, OUTSIDE, SHOWN, visible
from scenec.schemas.codec import Facts
from scenec.schemas.left_out import ORDER, ClassRecord, Reason, Record, entry

#: Name of this pass in reports.
PASS = "prune"  # noqa: S105 (no password)
#: Radii are taken this much larger, relatively, and by this part of the largest coordinate.
_SLACK, _ROUNDING = 1e-5, 1e-7

_CODE = {reason: ORDER.index(reason) for reason in Reason}
_WHY = {
    Reason.OUT_OF_VIEW: "outside of every picture",
    Reason.BEHIND_GROUND: "behind the ground wherever a picture would hold it",
}
#: What holds a row for each instance.
_ARRAYS = {
    Placed: ("prototype", "to_world", "ids"),
    Scatter: ("prototype", "positions", "orientations", "scales", "variation", "ids"),
}
_OF_SHOWN = {OUTSIDE: Reason.OUT_OF_VIEW, BEHIND: Reason.BEHIND_GROUND, SHOWN: Reason.SEEN}


@dataclass(frozen=True)
class Pruned:
    """A Scene without what shows nowhere.

    Attributes:
        scene: What is left; ``bounds`` are those of all.
        record: Why each instance is where it is; None where nothing is missing.
    """

    scene: Scene
    left_out: list[Facts] = field(default_factory=list)
    record: Record | None = None
    facts: Facts = field(default_factory=dict)


@dataclass
class _Balls:
    """A class's instances as balls, at all samples at which they differ.

    Attributes:
        middles, radii: float64 [n * s, 3] and [n * s].
        reason: Of each instance, so far, uint8 [n].
    """

    middles: NDArray[np.float64]
    radii: NDArray[np.float64]
    reason: NDArray[np.uint8]

    @property
    def _samples(self) -> int:
        return max(len(self.radii) // max(len(self.reason), 1), 1)

    @property
    def open(self) -> NDArray[np.bool_]:
        """Instances that have no reason to stay so far."""
        kept = np.array([reason.kept for reason in ORDER])
        return ~kept[self.reason]

    def of(self, which: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        balls = np.repeat(which, self._samples)
        return self.middles[balls], self.radii[balls]

    def keep(self, which: NDArray[np.bool_], of_balls: NDArray[np.bool_], why: Reason) -> None:
        """Keeps those of some instances of which any ball is chosen."""
        stays = of_balls.reshape(-1, self._samples).any(axis=1)
        self.reason[np.flatnonzero(which)[stays]] = _CODE[why]


@memoized("prune")
def prune(
    scene: Scene,
    needs: Needs,
    keep: Keep = Keep.SEEN,
    *,
    hills: bool = True,
    everywhere: bool = False,
) -> Pruned:
    """Leaves out what no camera can see the effect of.

    Args:
        keep: Anything but ``SEEN`` leaves all as it is.
        hills: Whether the terrain is a height field, so that it hides what is behind it.
        everywhere: Whether with color anything may show, wherever it stands: there is a mirror, or
            a picture of the sky has its sun in it.
    """
    views = views_of_all(scene.rigs)
    tiles = scene.ground.tiles
    if keep is not Keep.SEEN or not len(views.eye) or not tiles:
        whole = [np.full(one.count, _CODE[Reason.ALL], np.uint8) for one in scene.objects]
        return Pruned(scene, [], _record(scene.objects, whole, {}))
    relief = relief_of_tiles(_ground_of(scene), scene.bounds, len(views.eye))
    if not hills:
        relief.is_solid[:] = False
    views = with_horizon(views, relief)
    classes = [_visible_balls(one, views, scene.bounds) for one in scene.objects]
    facts: dict[str, Any] = {}
    removed: dict[str, Reason] = {}
    showing = chosen(views, views.kind & COLOR > 0)
    if needs.color and len(showing.eye):
        facts["light"] = {"min_view_factor": MIN_VIEW_FACTOR, "everywhere": everywhere}
        _mark_lit(scene, classes, showing, relief, everywhere)
    else:
        removed = _unseen_tiles(tiles, views)
    left_out: list[Facts] = []
    objects = tuple(
        _without(one, balls, needs.color, left_out)
        for one, balls in zip(scene.objects, classes, strict=True)
    )
    ground = _without_tiles(scene.ground, removed, left_out)
    used = without_unused(scene.materials, ground, objects, needs)
    left_out += [{**one, "pass": PASS} for one in used.left_out]
    reasons = [balls.reason for balls in classes]
    facts["tiles"] = {"kept": len(ground.tiles), "of": len(tiles)}
    facts["objects"] = {
        one.name: {
            str(why): n for why, n in ClassRecord(one.drawn, one.ids, found).counts().items()
        }
        for one, found in zip(scene.objects, reasons, strict=True)
    }
    return Pruned(
        replace(scene, ground=used.ground, objects=used.objects, materials=used.materials),
        left_out,
        _record(scene.objects, reasons, removed),
        facts,
    )


def _ground_of(scene: Scene) -> tuple[MeshTile, ...]:
    """All that is ground where objects are: a horizon, too, where they lie beyond the border."""
    tiles = scene.ground.tiles
    if scene.ground.horizon is None:
        return tiles
    ends = [t.translate + pick(t.points, axis=0) for t in tiles for pick in (np.min, np.max)]
    within = np.min(ends, axis=0), np.max(ends, axis=0)
    for one in scene.objects:
        middles = one.balls()[0]
        if ((middles < within[0]) | (middles > within[1]))[:, :2].any():
            return scene.ground.meshes
    return tiles


def _visible_balls(one: Scatter | Placed, views: Views, bounds: NDArray[np.float64]) -> _Balls:
    """A class as balls, and which of them are seen."""
    middles, radii = one.balls()
    radii = radii * (1.0 + _SLACK) + _ROUNDING * float(np.abs(bounds).max())
    middles = np.ascontiguousarray(middles)
    shown = visible(views, middles, radii)
    if isinstance(one, Placed) and one.count:
        shown = shown.reshape(one.count, -1).max(axis=1)
    reason = np.empty(one.count, np.uint8)
    for found, why in _OF_SHOWN.items():
        reason[shown == found] = _CODE[why]
    return _Balls(middles, radii, reason)


def _mark_lit(
    scene: Scene, classes: Sequence[_Balls], showing: Views, relief: BlockRelief, everywhere: bool
) -> None:
    """Marks what stays for its shadow or for the light that it takes or sends."""
    shown = [balls.of(balls.reason == _CODE[Reason.SEEN]) for balls in classes]
    none = np.zeros((0, 3)), np.zeros(0)
    middles, radii = (np.concatenate(part) for part in zip(none, *shown, strict=True))
    beyond = scene.ground.horizon is not None
    seen = visible_blocks(relief, scene.bounds, showing, middles, radii, beyond)
    for one, balls in zip(scene.objects, classes, strict=True):
        if everywhere or _shines(one, scene):
            balls.reason[balls.open] = _CODE[Reason.LIGHT]
        left = balls.open
        balls.keep(left, shadows_visible_blocks(seen, scene, *balls.of(left)), Reason.SHADOW)
        left = balls.open
        balls.keep(left, view_factors(seen, *balls.of(left)) >= MIN_VIEW_FACTOR, Reason.LIGHT)


def _shines(one: Scatter | Placed, scene: Scene) -> bool:
    found = (scene.materials.get(name) for name in one.materials)
    return any(material is not None and max(material.emission) > 0.0 for material in found)


def _unseen_tiles(tiles: Sequence[MeshTile], views: Views) -> dict[str, Reason]:
    """Tiles of which no view may see a triangle; one stays in any case."""
    found = {}
    for tile in tiles:
        corners = tile.points[tile.faces].astype(np.float64) + tile.translate
        middles = corners.mean(axis=1)
        away = corners - middles[:, None, :]
        radii = np.sqrt((away * away).sum(axis=2).max(axis=1)) * (1.0 + _SLACK)
        shown = int(visible(views, middles, radii).max())
        if shown != SHOWN:
            found[tile.name] = _OF_SHOWN[shown]
    if len(found) == len(tiles):
        # A stage without ground is none that viewers know what to do with.
        del found[tiles[0].name]
    return found


def _without(
    one: Scatter | Placed, balls: _Balls, color: bool, left_out: list[Facts]
) -> Scatter | Placed:
    """A class without the instances that go; entries about them."""
    kept = ~balls.open
    if kept.all():
        return one
    arrays = {name: getattr(one, name) for name in _ARRAYS[type(one)]}
    bytes_of_one = sum(array[:1].nbytes for array in arrays.values())
    triangles = np.array([len(mesh.faces) for mesh in one.prototypes], np.int64)[one.prototype]
    for reason, why in _WHY.items():
        removed = balls.reason == _CODE[reason]
        if removed.any():
            left_out.append(
                entry(
                    PASS,
                    f"objects/{one.name}: {int(removed.sum()):,} of {one.count:,}",
                    f"{why}, and no picture shows its effect" if color else why,
                    instances=int(removed.sum()),
                    triangles=int(triangles[removed].sum()),
                    size=int(removed.sum()) * bytes_of_one,
                )
            )
    return replace(one, **{name: array[kept] for name, array in arrays.items()})


def _without_tiles(ground: Ground, removed: dict[str, Reason], left_out: list[Facts]) -> Ground:
    for reason, why in _WHY.items():
        tiles = [tile for tile in ground.tiles if removed.get(tile.name) is reason]
        if tiles:
            arrays = [a for t in tiles for a in (t.points, t.faces, t.layer, t.normals, t.weights)]
            left_out.append(
                entry(
                    PASS,
                    f"terrain: {len(tiles)} of {len(ground.tiles)} tiles",
                    why,
                    triangles=sum(len(tile.faces) for tile in tiles),
                    size=sum(array.nbytes for array in arrays),
                )
            )
    return replace(ground, tiles=tuple(tile for tile in ground.tiles if tile.name not in removed))


def _record(
    objects: Sequence[Scatter | Placed],
    reasons: Sequence[NDArray[np.uint8]],
    tiles: dict[str, Reason],
) -> Record | None:
    """The record of a batch; None where no number and no tile is missing."""
    classes = {
        one.name: ClassRecord(one.drawn, one.ids, reason)
        for one, reason in zip(objects, reasons, strict=True)
    }
    whole = all(reason.kept for one in classes.values() for reason in one.counts())
    if whole and not tiles:
        return None
    return Record(classes, tiles)
