"""Trees and hazels at several ages, as they grow (``growth``) and what they wear (``foliage``)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from scenec.lab.models import bark
from scenec.lab.models.foliage import Twigs, dress, foliage, leafy_twig, needle_spray, needle_tuft
from scenec.lab.models.glb import Look, Model, Part
from scenec.lab.models.growth import Grown, Skeleton, Space, colonize, crown, limbs, thicken, whorls
from scenec.lab.models.surfaces import UP, Chance, Floats, Surface, across, azimuth, unit

#: Colors of leaves are what they reflect (but for their gloss) and transmit together, as PROSPECT-D
#: (Feret et al. 2017, Remote Sensing of Environment 193) has it for 25 to 50 ug/cm2 of chlorophyll
#: under daylight; so are the shares that pass, 0.04 apart at most in red and green.
#: Needles are thick; those of a brush shade each other, and are darker.
LOOKS = {
    "oak_bark": Look((0.200, 0.160, 0.125), 0.90, picture=bark.furrowed("oak", 8, 5)),
    "oak_twig": Look((0.110, 0.085, 0.062), 0.90),
    "oak_leaf": Look((0.070, 0.155, 0.018), 0.58, through=0.58),
    "oak_leaf_bright": Look((0.128, 0.211, 0.025), 0.58, through=0.58),
    "birch_bark": Look((0.680, 0.640, 0.570), 0.75, picture=bark.birch()),
    "birch_twig": Look((0.075, 0.048, 0.036), 0.80),
    "birch_leaf": Look((0.120, 0.205, 0.025), 0.58, through=0.58),
    "birch_leaf_bright": Look((0.170, 0.260, 0.032), 0.58, through=0.58),
    "hazel_bark": Look((0.150, 0.110, 0.080), 0.80),
    "hazel_leaf": Look((0.100, 0.186, 0.022), 0.55, through=0.58),
    "hazel_leaf_bright": Look((0.145, 0.230, 0.028), 0.55, through=0.58),
    "spruce_bark": Look((0.125, 0.095, 0.075), 0.95, picture=bark.scaly("spruce")),
    "spruce_twig": Look((0.110, 0.082, 0.060), 0.95),
    "spruce_needle": Look((0.040, 0.077, 0.030), 0.65, through=0.22),
    "spruce_shoot": Look((0.070, 0.122, 0.043), 0.60, through=0.22),
    "pine_bark": Look((0.210, 0.165, 0.135), 0.95, picture=bark.furrowed("pine", 5, 4)),
    "pine_upper_bark": Look((0.400, 0.200, 0.095), 0.90, picture=bark.scaly("pine")),
    "pine_twig": Look((0.150, 0.105, 0.070), 0.90),
    "pine_needle": Look((0.084, 0.126, 0.062), 0.60, through=0.22),
    "pine_needle_bright": Look((0.118, 0.168, 0.076), 0.60, through=0.22),
}


def _sides(thickest: int) -> Callable[[float], int]:
    """How many sides a tube has, by its radius."""
    return lambda radius: (
        thickest if radius > 0.07 else 7 if radius > 0.03 else 4 if radius > 0.012 else 3
    )


def _wood(
    grown: Grown, barks: tuple[str, str], border: float, tile: tuple[float, float],
    thickest: int = 14, least: float = 0.006,
) -> dict[str, Part]:  # fmt: skip
    """Trunk and thick limbs with their picture, and branches."""
    trunk, branches = Surface(), Surface()
    uv = limbs(grown, trunk, branches, border, _sides(thickest), least, tile)
    return {"trunk": trunk.part(barks[0], uv), "branches": branches.part(barks[1])}


def _straight(
    chance: Chance, height: float, step: float, wander: float, lean: Floats | None = None
) -> Skeleton:
    """A trunk alone."""
    skeleton = Skeleton([np.zeros(3)], [-1])
    ahead = unit(UP + (np.zeros(3) if lean is None else lean))
    skeleton.shoot(chance, 0, ahead, height, step, wander, 0.06)
    return skeleton


def _axis(skeleton: Skeleton, low: float, high: float) -> Callable[[float], Floats]:
    """Where a trunk is off the vertical, by the crown's height from 0 to 1."""
    path = np.array(skeleton.points)

    def middle(t: float) -> Floats:
        z = low + t * (high - low)
        return np.array([*(np.interp(z, path[:, 2], path[:, i]) for i in range(2)), 0.0])

    return middle


def _oak(
    name: str, height: float, radius: float, foot: float, free: int, trunk: float, every: float,
    size: float = 1.0,
) -> Model:  # fmt: skip
    chance = Chance(name)
    step = 0.017 * height + 0.03
    skeleton = _straight(chance, trunk, step, 7.0)
    first = len(skeleton.points) - 1 - max(1, round(0.35 * trunk / step))
    low = 0.55 * trunk
    space = crown(
        chance, free, low, height, (0.55, 0.88, 1.0, 1.0, 0.92, 0.72, 0.34), radius, lobes=0.3,
        hollow=0.55,
    )  # fmt: skip
    colonize(skeleton, space, Space(step, 0.45 * height, 2.0 * step, 0.03, 0.55), first)
    grown = thicken(skeleton, 0.0042, foot, 0.6)
    twigs = Twigs(5)
    dress(
        grown, chance, twigs, thin=0.02 * size, every=every,
        size=(0.8 * size, 1.25 * size), spread=55, light=0.35,
    )  # fmt: skip
    shapes = [
        leafy_twig(chance, length=0.24, count=11, leaf=(0.085, 0.130), width=0.60, first=0.2)
        for _ in range(5)
    ]
    dark, bright = ("leaves", "oak_leaf"), ("bright_leaves", "oak_leaf_bright")
    return Model(
        _wood(grown, ("oak_bark", "oak_twig"), 0.035, (0.5, 1.0)),
        LOOKS,
        foliage(twigs, shapes, "oak_twig", [dark, dark, dark, bright, bright]),
    )


def oak() -> Model:
    """An oak of some forty years that stands free, 9 m: crooked strong limbs, a wide crown."""
    return _oak("oak", 9.2, 3.4, 0.19, 1600, 2.4, 0.08)


def oak_young() -> Model:
    """A young oak of 5 m, upright and still open."""
    return _oak("oak_young 2", 5.0, 1.5, 0.065, 620, 1.5, 0.075)


def oak_old() -> Model:
    """An old oak, 13 m high and as wide, on a short thick trunk."""
    return _oak("oak_old", 13.0, 5.2, 0.40, 2300, 2.9, 0.135, 1.35)


def _birch(
    name: str, height: float, radius: float, foot: float, free: int, bare: float, every: float,
    size: float = 1.0,
) -> Model:  # fmt: skip
    chance = Chance(name)
    step = 0.014 * height + 0.03
    skeleton = _straight(chance, 0.93 * height, step, 3.0, 0.05 * chance.direction())
    low = bare * height
    first = int(low / step)
    space = crown(
        chance, free, low, height, (0.35, 0.75, 1.0, 0.95, 0.8, 0.55, 0.2), radius, lobes=0.25,
        hollow=0.35, middle=_axis(skeleton, low, height),
    )  # fmt: skip
    colonize(skeleton, space, Space(step, 0.3 * height, 2.1 * step, 0.32, 0.45), first)
    _hang(skeleton, chance, step)
    grown = thicken(skeleton, 0.0026, foot, 0.4)
    twigs = Twigs(5)
    dress(
        grown, chance, twigs, thin=0.011 * size, every=every,
        size=(0.8 * size, 1.25 * size), spread=40, light=-0.45,
    )  # fmt: skip
    shapes = [
        leafy_twig(
            chance, length=0.32, count=12, leaf=(0.050, 0.078), width=0.78, spread=55, hang=0.75,
            first=0.1, stalk=0.025,
        )
        for _ in range(5)
    ]  # fmt: skip
    dark, bright = ("leaves", "birch_leaf"), ("bright_leaves", "birch_leaf_bright")
    return Model(
        _wood(grown, ("birch_bark", "birch_twig"), 0.022, (0.4, 0.9), 12, 0.004),
        LOOKS,
        foliage(twigs, shapes, "birch_twig", [dark, dark, bright, dark, bright]),
    )


def _hang(skeleton: Skeleton, chance: Chance, step: float) -> None:
    """Long thin shoots that hang from a birch's tips."""
    parents = set(skeleton.parents)
    for tip in [i for i in range(len(skeleton.points)) if i not in parents]:
        point = skeleton.points[tip]
        room = float(point[2]) - 1.2
        if room < 0.4 or chance.between(0.0, 1.0) < 0.4:
            continue
        out = unit(np.array([point[0], point[1], 0.0]) + 0.3 * chance.direction())
        length = min(room, chance.between(0.35, 1.0))
        skeleton.shoot(chance, tip, unit(out + 0.2 * UP), length, step, 6.0, -0.55)


def birch() -> Model:
    """A silver birch of 11 m: white trunk, ascending limbs, twigs that hang."""
    return _birch("birch", 11.0, 2.0, 0.095, 700, 0.22, 0.075)


def birch_young() -> Model:
    """A young silver birch of 5 m, slender."""
    return _birch("birch_young", 5.2, 0.9, 0.036, 300, 0.14, 0.065)


def birch_old() -> Model:
    """An old silver birch of 16 m, its lower trunk bare."""
    return _birch("birch_old", 16.0, 2.9, 0.17, 950, 0.34, 0.10, 1.25)


def _hazel(name: str, height: float, spread: float, count: int, free: int, every: float) -> Model:
    chance = Chance(name)
    skeleton = Skeleton([], [])
    step = 0.09
    for k in range(count):
        base = azimuth(360.0 * k / count + chance.about(0, 15)) * chance.between(0.04, 0.2)
        foot = skeleton.add(base, -1)
        ahead = unit(unit(base) * chance.between(0.1, 0.6) + UP)
        skeleton.shoot(chance, foot, ahead, height * chance.between(0.3, 0.55), step, 5.0, 0.02)
    space = crown(chance, free, 0.3, height, (0.55, 0.85, 1.0, 1.0, 0.85, 0.45), spread, lobes=0.25)
    colonize(skeleton, space, Space(step, 1.2, 0.17, 0.12, 0.5))
    grown = thicken(skeleton, 0.0028, 0.02, 0.2)
    twigs = Twigs(4)
    dress(
        grown, chance, twigs, thin=0.008, every=every, size=(0.8, 1.2), spread=60,
        light=0.2, lowest=0.15,
    )  # fmt: skip
    shapes = [
        leafy_twig(
            chance, length=0.2, count=6, leaf=(0.075, 0.115), width=0.82, hang=0.4, rounded=True
        )
        for _ in range(4)
    ]
    wood = Surface()
    limbs(grown, wood, wood, math.inf, _sides(6), 0.005)
    dark, bright = ("leaves", "hazel_leaf"), ("bright_leaves", "hazel_leaf_bright")
    return Model(
        {"wood": wood.part("hazel_bark")},
        LOOKS,
        foliage(twigs, shapes, "hazel_bark", [dark, dark, dark, bright]),
    )


def hazel() -> Model:
    """A hazel of 3.2 m: many stems from one stool, round soft leaves."""
    return _hazel("hazel", 3.2, 1.55, 12, 520, 0.17)


def hazel_young() -> Model:
    """A young hazel of 1.7 m, a few stems."""
    return _hazel("hazel_young", 1.7, 0.8, 6, 210, 0.15)


def _spruce(
    name: str, height: float, reach: float, foot: float, years: int, first: float, every: float
) -> Model:
    chance = Chance(name)
    skeleton = Skeleton([np.zeros(3)], [-1])
    step = 0.22
    branches = whorls(
        chance, skeleton, height, years, reach=reach, first=first, rise=(-12.0, 42.0), step=step,
        sag=0.085,
    )  # fmt: skip
    twigs = Twigs(6)
    for start, end in branches:
        path = np.array(skeleton.points)[[skeleton.parents[start], *range(start, end + 1)]]
        _sprays(chance, twigs, path, every)
    top = max(skeleton.points, key=lambda point: float(point[2]))
    for k in range(4):
        twigs.add(4, top - 0.12 * k * UP, azimuth(137.5 * k, 48.0), UP, 0.3 + 0.12 * k)
    twigs.add(4, top - 0.25 * UP, UP, azimuth(0.0), 0.9)
    grown = thicken(skeleton, 0.0055, foot, 0.4)
    shapes = [
        needle_spray(
            chance, length=0.46, side=0.30, pairs=4, wide=0.048, droop=chance.between(0.1, 0.6),
            step=0.11,
        )
        for _ in range(4)
    ] + [
        needle_spray(
            chance, length=0.34, side=0.18, pairs=3, wide=0.040, droop=0.1, step=0.09
        )
        for _ in range(2)
    ]  # fmt: skip
    dark, bright = ("needles", "spruce_needle"), ("shoots", "spruce_shoot")
    return Model(
        _wood(grown, ("spruce_bark", "spruce_twig"), 0.03, (0.4, 0.8), 12),
        LOOKS,
        foliage(twigs, shapes, "spruce_twig", [dark, dark, dark, dark, bright, bright]),
    )


def _sprays(chance: Chance, twigs: Twigs, path: Floats, every: float) -> None:
    """Sprays along a branch: to both sides and hanging, the young ones at its end."""
    lengths = np.append(0.0, np.cumsum(np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1))))
    total = float(lengths[-1])
    # Needles live some seven years: what is nearer to the trunk of a long branch is bare.
    at = min(0.06 + 0.10 * total, 0.35)
    side = 1.0
    while at < total:
        i = min(int(np.searchsorted(lengths, at)) - 1, len(path) - 2)
        along = unit(path[i + 1] - path[i])
        point = path[i] + along * (at - float(lengths[i]))
        t = at / total
        out = unit(
            along * 0.75 + side * across(along) - chance.between(0.05, 0.55) * (1 - 0.7 * t) * UP
        )
        size = min(1.15, 0.35 + 0.55 * (total - at) ** 0.7) * chance.between(0.8, 1.2)
        young = t > 0.8
        shape = int(chance.between(4.0, 6.0)) if young else int(chance.between(0.0, 4.0))
        low = (0.14 - float(point[2])) / max(size * 0.45, 1e-6)
        out = unit(np.array([out[0], out[1], max(float(out[2]), low)]))
        twigs.add(shape, point, out, unit(UP + 0.25 * chance.direction()), size)
        side = -side
        at += every * chance.between(0.8, 1.2)
    tip = unit(path[-1] - path[-2])
    twigs.add(4, path[-2], tip, UP, chance.between(0.85, 1.15))


def spruce() -> Model:
    """A Norway spruce of 11 m that stands free, branches to the ground."""
    return _spruce("spruce", 11.0, 2.4, 0.14, 34, 0.35, 0.126)


def spruce_young() -> Model:
    """A young Norway spruce of 4 m."""
    return _spruce("spruce_young", 4.0, 1.15, 0.05, 13, 0.28, 0.11)


def spruce_old() -> Model:
    """A Norway spruce of 18 m as in a stand, its lower trunk bare."""
    return _spruce("spruce_old", 18.0, 2.8, 0.21, 36, 4.2, 0.155)


def _pine(
    name: str, height: float, radius: float, foot: float, free: int, bare: float, turn: float,
    every: float, size: float = 1.0,
) -> Model:  # fmt: skip
    chance = Chance(name)
    step = 0.013 * height + 0.06
    skeleton = _straight(chance, 0.9 * height, step, 4.5, 0.05 * chance.direction())
    low = bare * height
    # Dead stubs stand below the crown.
    path = list(range(len(skeleton.points)))
    for _ in range(9):
        node = path[int(chance.between(0.45, 1.0) * low / step)]
        skeleton.shoot(
            chance, node, azimuth(chance.between(0, 360), chance.between(-20, 15)),
            chance.between(0.15, 0.7), step, 12.0,
        )  # fmt: skip
    stubs = len(skeleton.points)
    space = crown(
        chance, free, low, height, (0.5, 0.8, 1.0, 1.0, 0.95, 0.8, 0.45), radius, lobes=0.42,
        hollow=0.5, middle=_axis(skeleton, low, height),
    )  # fmt: skip
    colonize(skeleton, space, Space(step, 0.3 * height, 1.75 * step, 0.0, 0.5), int(low / step))
    grown = thicken(skeleton, 0.0062, foot, 0.45)
    twigs = Twigs(4)
    green = _without(grown, len(path), stubs)
    dress(
        green, chance, twigs, thin=0.026, every=every,
        size=(0.9 * size, 1.35 * size), spread=50, light=0.5, lowest=low,
    )  # fmt: skip
    shapes = [needle_tuft(chance, length=0.28, count=30, needle=0.12, wide=0.009) for _ in range(4)]
    wood = _wood(grown, ("pine_bark", "pine_twig"), 0.028, (0.5, 1.0), 14)
    trunk = wood["trunk"]
    high = trunk.points[trunk.faces][:, :, 2].mean(axis=1) > turn
    dark, bright = ("needles", "pine_needle"), ("bright_needles", "pine_needle_bright")
    return Model(
        {
            "trunk": _tight(trunk, ~high),
            "limbs": replace(_tight(trunk, high), material="pine_upper_bark"),
            "branches": wood["branches"],
        },
        LOOKS,
        foliage(twigs, shapes, "pine_twig", [dark, dark, bright, dark]),
    )


def _without(grown: Grown, first: int, last: int) -> Grown:
    """A plant whose nodes from ``first`` up to ``last`` are dead: too thick to carry twigs."""
    radii = grown.radii.copy()
    radii[first:last] = math.inf
    return grown._replace(radii=radii)


def _tight(part: Part, kept: np.ndarray) -> Part:
    """Some faces of a part, without the points that they do not use."""
    used, faces = np.unique(part.faces[kept], return_inverse=True)
    return replace(
        part, points=part.points[used], normals=part.normals[used],
        faces=faces.reshape(-1, 3).astype(np.int64),
        uv=None if part.uv is None else part.uv[used],
    )  # fmt: skip


def pine() -> Model:
    """A Scots pine of 12 m: bare trunk, orange bark above, an open uneven crown."""
    return _pine("pine", 12.0, 2.3, 0.15, 620, 0.45, 4.6, 0.12)


def pine_old() -> Model:
    """An old Scots pine of 17 m, flat-topped on a long bare trunk."""
    return _pine("pine_old", 17.0, 3.3, 0.24, 760, 0.58, 6.5, 0.12, 1.2)
