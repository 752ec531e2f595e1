"""Pruning: what no camera of the batch can see the effect of is left out; what stays is untouched.

Instances go as a whole (their ids stay reserved), tiles of the terrain likewise, then models and
materials that nothing is any more. What stays keeps its arrays bit by bit, and its order. Something
stays if, at any sample, for any sensor,

1. a view may see it: its ball meets the view's cone and is not behind the ground (``outlook``,
   ``horizon``: both err one way, so every pixel's first hit stays, and annotation with it);
2. with color, its shadow may fall on what a view with color sees (``shadows.shadows_seen``), a lamp
   may shine on it, or it shines itself;
3. with color, the light that it takes or sends is more than is left of a tolerance for all that is
   left out together (``faint``).

With color the terrain stays whole: ground out of view is what most of the light that comes from
below comes from, and tiles are too large for a bound of the third kind to let any go.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.scene.scene import Ground, Placed, Scatter, Scene, Tile
from scenec.compiler.views.faint import TOLERANCE, Chosen, choose
from scenec.compiler.views.horizon import Horizon, Relief, horizon_of, relief_of
from scenec.compiler.views.keep import Keep
from scenec.compiler.views.lighting import factors_of, lit_by_lamps, sweep_of
from scenec.compiler.views.needed import Needs, without_unused
from scenec.compiler.views.outlook import outlook
from scenec.compiler.views.places import fine_cells, places_seen
from scenec.compiler.views.shadows import shadows_seen
from scenec.compiler.views.visible import (
    BEHIND,
    OUTSIDE,
    SHOWN,
    Eyes,
    Groups,
    grouped,
    seen_by,
    stand_below,
)
from scenec.schemas.left_out import ORDER, ClassRecord, Reason, Record, entry

#: Name of this pass in reports.
PASS = "prune"
#: Groups of balls along the longer side of the scene.
_GROUPS = 128
#: Radii are taken this much larger, relatively, and by this part of the largest coordinate.
_SLACK, _ROUNDING = 1e-5, 1e-7

_CODE = {reason: ORDER.index(reason) for reason in Reason}


@dataclass(frozen=True)
class Pruned:
    """A Scene without what shows nowhere.

    Attributes:
        scene: What is left; ``bounds`` are those of all.
        left_out: Entries for report.json.
        record: Why each instance is where it is; None where nothing is missing.
        facts: For report.json.
    """

    scene: Scene
    left_out: list[dict[str, Any]] = field(default_factory=list)
    record: Record | None = None
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass
class _Balls:
    """A class's instances as balls, at the samples at which they differ.

    Attributes:
        middles, radii: float64 [s, n, 3] and [s, n].
        groups: Of each sample.
        reason: So far, uint8 [n].
    """

    middles: NDArray[np.float64]
    radii: NDArray[np.float64]
    groups: list[Groups]
    reason: NDArray[np.uint8]

    def samples(self) -> list[int]:
        """What to ask for each of the poses: the sample, or -1 for all."""
        return [-1] if len(self.middles) == 1 else list(range(len(self.middles)))

    @property
    def open(self) -> NDArray[np.bool_]:
        """What has no reason to stay so far."""
        kept = np.array([reason.kept for reason in ORDER])
        return ~kept[self.reason]


def prune(scene: Scene, needs: Needs, keep: Keep = Keep.SEEN, *, hills: bool = True) -> Pruned:
    """Leaves out what no camera can see the effect of.

    Args:
        scene: What was built; only read.
        needs: What the outputs show.
        keep: Anything but ``SEEN`` leaves all as it is.
        hills: Whether the terrain is a height field, so that it hides what is behind it.
    """
    views = outlook(scene.rigs)
    if keep is not Keep.SEEN or not len(views.eye) or not scene.ground.tiles:
        whole = [np.full(one.count, _CODE[Reason.ALL], np.uint8) for one in scene.objects]
        return Pruned(scene, [], _record(scene.objects, whole, {}))
    relief = relief_of(scene.ground)
    if not hills:
        relief.low[:] = -np.inf
    horizon = Horizon(np.zeros((len(views.eye), 0, 0), np.float32), np.zeros(2))
    if hills:
        horizon = horizon_of(relief, scene.ground, views)
    eyes = Eyes(views, horizon)
    width = float((scene.bounds[1, :2] - scene.bounds[0, :2]).max()) / _GROUPS
    classes = [_balls_of(one, scene.bounds, width) for one in scene.objects]
    for balls in classes:
        _mark_seen(balls, eyes)
    facts: dict[str, Any] = {}
    light: Chosen | None = None
    tiles: dict[str, Reason] = {}
    if needs.color and views.color.any():
        light = _mark_light(scene, classes, eyes, relief, width, facts)
    else:
        tiles = _unseen_tiles(scene.ground.tiles, eyes)
    reasons = [balls.reason for balls in classes]
    left_out: list[dict[str, Any]] = []
    objects = tuple(
        _without(one, balls, needs.color, left_out)
        for one, balls in zip(scene.objects, classes, strict=True)
    )
    ground = _without_tiles(scene.ground, tiles, left_out)
    used = without_unused(scene.materials, ground, objects, needs)
    left_out += [{**one, "pass": PASS} for one in used.left_out]
    if light is not None:
        facts["light"] |= {"tolerance": TOLERANCE, "reached": light.reached}
    facts["tiles"] = {"kept": len(ground.tiles), "of": len(scene.ground.tiles)}
    facts["objects"] = {
        one.name: {
            str(why): n for why, n in ClassRecord(one.drawn, one.ids, found).counts().items()
        }
        for one, found in zip(scene.objects, reasons, strict=True)
    }
    return Pruned(
        replace(scene, ground=used.ground, objects=used.objects, materials=used.materials),
        left_out,
        _record(scene.objects, reasons, tiles, light),
        facts,
    )


def _balls_of(one: Scatter | Placed, bounds: NDArray[np.float64], width: float) -> _Balls:
    middles, radii = one.balls()
    steps = one.to_world.shape[1] if isinstance(one, Placed) and one.count else 1
    middles = np.ascontiguousarray(middles.reshape(-1, steps, 3).transpose(1, 0, 2))
    radii = np.ascontiguousarray(radii.reshape(-1, steps).T)
    radii = radii * (1.0 + _SLACK) + _ROUNDING * float(np.abs(bounds).max())
    groups = [grouped(at, reach, width) for at, reach in zip(middles, radii, strict=True)]
    return _Balls(middles, radii, groups, np.zeros(one.count, np.uint8))


def _mark_seen(balls: _Balls, eyes: Eyes) -> None:
    every = np.ones(len(eyes.views.eye), np.bool_)
    shown = np.full(len(balls.reason), OUTSIDE, np.int8)
    for k, sample in enumerate(balls.samples()):
        found = seen_by(eyes, balls.middles[k], balls.radii[k], balls.groups[k], every, sample)
        shown = np.maximum(shown, found)
    balls.reason[shown == OUTSIDE] = _CODE[Reason.OUT_OF_VIEW]
    balls.reason[shown == BEHIND] = _CODE[Reason.BEHIND_GROUND]
    # Sidecars tell how high above the first surface below it a camera is.
    plan = np.unique(eyes.views.eye[:, :2], axis=0)
    for middles, radii in zip(balls.middles, balls.radii, strict=True):
        shown[stand_below(plan, middles, radii)] = SHOWN
    balls.reason[shown == SHOWN] = _CODE[Reason.SEEN]


def _mark_light(
    scene: Scene,
    classes: Sequence[_Balls],
    eyes: Eyes,
    relief: Relief,
    width: float,
    facts: dict[str, Any],
) -> Chosen:
    """Marks what stays for its shadow or for the light that it takes or sends."""
    grid = fine_cells(relief, scene.bounds)
    seen = [balls.reason == _CODE[Reason.SEEN] for balls in classes]
    places = places_seen(
        grid,
        _seen_ground(grid, eyes, width),
        np.concatenate([b.middles[:, s].reshape(-1, 3) for b, s in zip(classes, seen, strict=True)]
                       or [np.zeros((0, 3))]),
        np.concatenate([b.radii[:, s].ravel() for b, s in zip(classes, seen, strict=True)]
                       or [np.zeros(0)]),
    )  # fmt: skip
    sweep = sweep_of(scene, relief, halo=True)
    for one, balls in zip(scene.objects, classes, strict=True):
        if _shines(one, scene):
            balls.reason[balls.open] = _CODE[Reason.LIGHT]
        for k, sample in enumerate(balls.samples()):
            at = balls.middles[k], balls.radii[k]
            lit = shadows_seen(eyes, places, sweep, *at, ~balls.open, sample)
            lit |= lit_by_lamps(scene, *at, sample)
            balls.reason[lit & balls.open] = _CODE[Reason.SHADOW]
    factors = factors_of(scene)
    facts["light"] = {"around": factors.around, "shadow": factors.shadow}
    left = [balls.open for balls in classes]
    poses = [len(balls.middles) for balls in classes]
    chosen = choose(
        places,
        sweep_of(scene, relief, halo=False),
        factors,
        np.concatenate([b.middles[:, s].reshape(-1, 3) for b, s in zip(classes, left, strict=True)]
                       or [np.zeros((0, 3))]),
        np.concatenate([b.radii[:, s].ravel() for b, s in zip(classes, left, strict=True)]
                       or [np.zeros(0)]),
    )  # fmt: skip
    start = 0
    for balls, mine, steps in zip(classes, left, poses, strict=True):
        count = int(mine.sum())
        stays = chosen.keep[start : start + count * steps].reshape(steps, count).any(axis=0)
        start += count * steps
        balls.reason[np.flatnonzero(mine)[stays]] = _CODE[Reason.LIGHT]
    return chosen


def _shines(one: Scatter | Placed, scene: Scene) -> bool:
    own = {part.material for mesh in one.prototypes for part in mesh.parts}
    named = (scene.materials.get(name) for name in (one.material, *own) if name is not None)
    return any(material is not None and max(material.emission) > 0.0 for material in named)


def _seen_ground(grid: Relief, eyes: Eyes, width: float) -> NDArray[np.bool_]:
    """Fine cells whose ground a view with color may see."""
    # Of a terrain that hides nothing nothing is known to be low; where there is none, nor high.
    there = (grid.low <= grid.high) & (grid.high > -np.inf)
    j, i = np.nonzero(there)
    low, high = np.maximum(grid.low[there], grid.high[there] - 1e6), grid.high[there]
    middles = np.stack(
        [
            grid.frame[0] + (i + 0.5) * grid.frame[2],
            grid.frame[1] + (j + 0.5) * grid.frame[3],
            0.5 * (low + high),
        ],
        axis=1,
    )
    half = 0.5 * (high - low)
    radii = np.sqrt(half * half + 0.5 * grid.frame[2] * grid.frame[3])
    found = seen_by(eyes, middles, radii, grouped(middles, radii, width), eyes.views.color)
    out = np.zeros(grid.low.shape, np.bool_)
    out[there] = found == SHOWN
    return out


def _unseen_tiles(tiles: Sequence[Tile], eyes: Eyes) -> dict[str, Reason]:
    """Tiles of which no view may see a triangle; one stays in any case."""
    every = np.ones(len(eyes.views.eye), np.bool_)
    found = {}
    for tile in tiles:
        corners = tile.points[tile.faces].astype(np.float64) + tile.translate
        middles = corners.mean(axis=1)
        away = corners - middles[:, None, :]
        radii = np.sqrt((away * away).sum(axis=2).max(axis=1)) * (1.0 + _SLACK)
        span = float((corners[..., :2].max(axis=(0, 1)) - corners[..., :2].min(axis=(0, 1))).max())
        shown = int(
            seen_by(eyes, middles, radii, grouped(middles, radii, span / 16.0), every).max()
        )
        low, high = corners[..., :2].min(axis=(0, 1)), corners[..., :2].max(axis=(0, 1))
        # What is straight below a camera tells how high it is.
        under = ((eyes.views.eye[:, :2] >= low) & (eyes.views.eye[:, :2] <= high)).all(axis=1)
        if shown != SHOWN and not under.any():
            found[tile.name] = Reason.BEHIND_GROUND if shown == BEHIND else Reason.OUT_OF_VIEW
    if len(found) == len(tiles):
        # A stage without ground is none that viewers know what to do with.
        del found[tiles[0].name]
    return found


def _without(
    one: Scatter | Placed, balls: _Balls, color: bool, left_out: list[dict[str, Any]]
) -> Scatter | Placed:
    """A class without the instances that go; entries about them."""
    kept = ~balls.open
    if kept.all():
        return one
    triangles = np.array([len(mesh.faces) for mesh in one.prototypes], np.int64)[one.prototype]
    effect = ", and no picture shows its effect" if color else ""
    for reason, why in (
        (Reason.OUT_OF_VIEW, f"outside of every picture{effect}"),
        (Reason.BEHIND_GROUND, f"behind the ground wherever a picture would hold it{effect}"),
    ):
        gone = balls.reason == _CODE[reason]
        if gone.any():
            left_out.append(
                entry(
                    PASS,
                    f"objects/{one.name}: {int(gone.sum()):,} of {one.count:,}",
                    why,
                    instances=int(gone.sum()),
                    triangles=int(triangles[gone].sum()),
                    size=int(gone.sum()) * _bytes_of_one(one),
                )
            )
    if isinstance(one, Placed):
        return replace(
            one, prototype=one.prototype[kept], to_world=one.to_world[kept], ids=one.ids[kept]
        )
    return replace(
        one,
        prototype=one.prototype[kept],
        positions=one.positions[kept],
        orientations=one.orientations[kept],
        scales=one.scales[kept],
        variation=one.variation[kept],
        ids=one.ids[kept],
    )


def _bytes_of_one(one: Scatter | Placed) -> int:
    """What an instance takes, in memory."""
    if isinstance(one, Placed):
        return int(one.to_world[:1].nbytes + one.ids.itemsize + one.prototype.itemsize)
    arrays = (one.prototype, one.positions, one.orientations, one.scales, one.variation, one.ids)
    return int(sum(array[:1].nbytes for array in arrays))


def _without_tiles(
    ground: Ground, gone: dict[str, Reason], left_out: list[dict[str, Any]]
) -> Ground:
    for reason, why in (
        (Reason.OUT_OF_VIEW, "outside of every picture"),
        (Reason.BEHIND_GROUND, "behind other ground wherever a picture would hold it"),
    ):
        tiles = [tile for tile in ground.tiles if gone.get(tile.name) is reason]
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
    return replace(ground, tiles=tuple(tile for tile in ground.tiles if tile.name not in gone))


def _record(
    objects: Sequence[Scatter | Placed],
    reasons: Sequence[NDArray[np.uint8]],
    tiles: dict[str, Reason],
    light: Chosen | None = None,
) -> Record | None:
    """The record of a batch; None where no number and no tile is missing."""
    classes = {
        one.name: ClassRecord(one.drawn, one.ids, reason)
        for one, reason in zip(objects, reasons, strict=True)
    }
    whole = all(reason.kept for one in classes.values() for reason in one.counts())
    if whole and not tiles:
        return None
    return Record(
        classes,
        tiles,
        None if light is None else TOLERANCE,
        None if light is None else light.reached,
    )
