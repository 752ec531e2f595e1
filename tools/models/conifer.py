"""Conifers: a spruce in whorls, a pine and a juniper whose twigs end in tufts of needles."""

from __future__ import annotations

import numpy as np
from glb import Look, Model
from stems import Habit, Level, grown, meshed
from surfaces import UP, Chance, Floats, Surface, across, azimuth, cross, turned, unit

LOOKS = {
    "spruce_bark": Look((0.125, 0.080, 0.058), 0.90),
    "spruce_needle": Look((0.040, 0.090, 0.032), 0.60),
    "spruce_shoot": Look((0.072, 0.130, 0.040), 0.60),
    "pine_bark": Look((0.115, 0.085, 0.068), 0.92),
    "pine_upper_bark": Look((0.330, 0.150, 0.070), 0.85),
    "pine_needle": Look((0.062, 0.112, 0.052), 0.60),
    "juniper_bark": Look((0.140, 0.090, 0.065), 0.90),
    "juniper_needle": Look((0.060, 0.105, 0.065), 0.60),
}

HEIGHT_M = 7.8


def spruce() -> Model:
    """A Norway spruce that stands free, branches almost to the ground."""
    chance = Chance("spruce")
    trunk, branches, needles, shoots = Surface(), Surface(), Surface(), Surface()
    heights = np.linspace(0.0, HEIGHT_M, 15)
    path = np.stack([0.03 * np.sin(heights), 0.03 * np.cos(0.8 * heights) - 0.03, heights], axis=1)
    path[0, :2] = 0.0
    radii = 0.115 * (1.0 - heights / HEIGHT_M) ** 0.85
    radii[0] *= 1.35
    trunk.tube(path, radii, 8)
    height, whorl = 0.45, 0
    while height < HEIGHT_M - 0.5:
        share = height / HEIGHT_M
        reach = 1.75 * (1.0 - share) ** 0.85 + 0.14
        # Old branches low down have lost some length.
        reach *= 0.86 + 0.14 * min(1.0, share / 0.15)
        count = 5
        for k in range(count + 4):
            between = k >= count
            angle = (
                360.0 * (1.25 * (k - count) + 0.5 if between else k) / count
                + 137.5 * whorl
                + chance.about(0.0, 14.0)
            )
            at = height + 0.17 * between + chance.about(0.0, 0.07)
            # From hanging at the bottom to ascending at the top.
            rise = -14.0 + 62.0 * share**1.4 + chance.about(0.0, 7.0)
            _branch(
                chance, branches, needles, shoots, _on(path, at), azimuth(angle, rise),
                reach * chance.between(0.74, 1.08) * (0.5 if between else 1.0), share,
            )  # fmt: skip
        height += 0.37 - 0.10 * share
        whorl += 1
    for k in range(7):
        at = HEIGHT_M - 0.08 - 0.07 * k
        _twig(chance, shoots, _on(path, at), azimuth(137.5 * k, 55.0), 0.10 + 0.025 * k, 5)
    _twig(chance, shoots, _on(path, HEIGHT_M - 0.2), UP, 0.3, 8)
    return Model(
        {
            "trunk": trunk.part("spruce_bark"),
            "branches": branches.part("spruce_bark"),
            "needles": needles.part("spruce_needle"),
            "shoots": shoots.part("spruce_shoot"),
        },
        LOOKS,
    )


def _on(path: Floats, height: float) -> Floats:
    return np.array([np.interp(height, path[:, 2], path[:, axis]) for axis in range(3)])


def _branch(
    chance: Chance, branches: Surface, needles: Surface, shoots: Surface, base: Floats,
    ahead: Floats, length: float, share: float,
) -> None:  # fmt: skip
    """A limb that sags and lifts its tip; twigs to both sides and hanging below."""
    path, segments = [base], 5
    for i in range(segments):
        sag = 0.16 * (1.0 - share)
        ahead = unit(ahead + (-sag if i < 3 else 1.6 * sag + 0.05) * UP)
        path.append(path[-1] + ahead * length / segments)
    line = np.array(path)
    line[:, 2] = np.maximum(line[:, 2], 0.08)
    branches.tube(line, np.append(np.linspace(0.011 + 0.012 * length / 2, 0.005, segments), 0.0), 3)
    spacing = 0.275
    count = max(2, round(length / spacing))
    for k in range(count):
        t = 0.06 + 0.94 * (k + 0.8) / count
        x = t * segments
        i = min(int(x), segments - 1)
        point = line[i] + (line[i + 1] - line[i]) * min(1.0, x - i)
        along = unit(line[i + 1] - line[i])
        side = across(along)
        for s in (-1.0, 1.0):
            size = (0.16 + 0.34 * length / 1.8) * (1.12 - 0.72 * t) * chance.between(0.8, 1.2)
            out = unit(along * 0.9 + s * side - (0.42 - 0.3 * share) * chance.about(1, 0.5) * UP)
            _twig(chance, shoots if t > 0.8 else needles, point, out, size, 3 if size < 0.3 else 4)
    tip = unit(line[-1] - line[-2])
    _twig(chance, shoots, line[-2] + (line[-1] - line[-2]) * 0.3, tip, 0.24 + 0.04 * length, 4)


def _twig(
    chance: Chance, surface: Surface, base: Floats, ahead: Floats, length: float, tufts: int
) -> None:
    """Tufts of three teeth on one axis, which point ahead: needles from every side."""
    # Low ones lie on the ground.
    lowest = (0.06 - float(base[2])) / length
    ahead = unit(np.array([ahead[0], ahead[1], max(float(ahead[2]), lowest)]))
    side = across(ahead)
    upward = cross(side, ahead)
    step = length / tufts
    for k in range(tufts):
        point = base + ahead * step * k
        wide = 0.082 * (1.0 - 0.45 * k / tufts) * chance.between(0.85, 1.15)
        roll = chance.between(-35.0, 35.0)
        points = [point - 0.25 * step * ahead, point + 1.05 * step * ahead]
        normals = [upward, upward]
        for third in (0.0, 120.0, 240.0):
            out = turned(side, ahead, third + roll)
            points.append(point + 1.4 * step * ahead + wide * out)
            normals.append(0.6 * out + 0.7 * upward)
        surface.add(np.array(points), [(0, 1, 2), (0, 1, 3), (0, 1, 4)], np.array(normals))


def pine() -> Model:
    """A Scots pine: bare trunk, orange bark above, an open flat crown of tufted limbs."""
    habit = Habit(
        height=9.2,
        radius=0.150,
        shape=(0.75, 1.0, 1.0, 0.95, 0.75, 0.45),
        ratio_power=1.35,
        levels=(
            Level((1.0, 0.0), 14, 12, wander=5.0, children=24, bare=0.44, taper=0.12),
            Level(
                (0.29, 0.05), 6, 5, curve=(-18, 16), wander=14.0, children=12, down=(66, 10),
                down_low=18, bare=0.28, attraction=0.25,
            ),
            Level(
                (0.42, 0.10), 2, 3, curve=(-10, 20), wander=14.0, children=3, down=(50, 12),
                bare=0.25, attraction=0.35,
            ),
            Level((0.45, 0.12), 1, 1, down=(42, 14), attraction=0.4),
        ),
    )  # fmt: skip
    chance = Chance("pine")
    stems = grown(habit, chance, np.zeros(3), unit(np.array([0.03, 0.02, 1.0])))
    trunk, upper, branches, needles = Surface(), Surface(), Surface(), Surface()
    path, radii = stems[0].path, stems[0].radii
    turn = int(np.searchsorted(path[:, 2], 4.3))
    trunk.tube(path[: turn + 1], radii[: turn + 1], 12)
    upper.tube(path[turn:], [*radii[turn:-1], 0.0], 12)
    meshed(stems[1:], habit, {1: upper, 2: branches, 3: branches})
    for stem in stems[1:]:
        if stem.level >= 2:
            tip, ahead, _ = stem.at(1.0)
            _tuft(chance, needles, tip, unit(ahead + 0.5 * UP), 0.27, 6)
        if stem.level == 2:
            middle, ahead, _ = stem.at(0.62)
            _tuft(chance, needles, middle, unit(ahead + 0.5 * UP), 0.25, 5)
        if stem.level == 1:
            tip, ahead, _ = stem.at(1.0)
            _tuft(chance, needles, tip, unit(ahead + 0.8 * UP), 0.27, 8)
    return Model(
        {
            "trunk": trunk.part("pine_bark"),
            "limbs": upper.part("pine_upper_bark"),
            "branches": branches.part("pine_bark"),
            "needles": needles.part("pine_needle"),
        },
        LOOKS,
    )


def juniper() -> Model:
    """A common juniper: a dense column of upright stems."""
    chance = Chance("juniper")
    wood, needles = Surface(), Surface()
    for k in range(11):
        habit = Habit(
            height=chance.between(1.3, 2.3) - 0.05 * k,
            radius=chance.between(0.014, 0.024),
            shape=(0.9, 1.0, 0.9, 0.5),
            ratio_power=1.1,
            flare=0.2,
            levels=(
                Level((1.0, 0.0), 7, 4, curve=(-6, 8), wander=5.0, children=20, bare=0.03),
                Level(
                    (0.24, 0.06), 1, 0, curve=(-20, 15), wander=8.0, children=3, down=(40, 12),
                    bare=0.2, attraction=0.6,
                ),
                Level((0.5, 0.1), 1, 0, down=(34, 12), attraction=0.5),
            ),
        )  # fmt: skip
        base = azimuth(98.0 * k + chance.about(0, 20)) * (0.02 + 0.020 * k)
        stems = grown(habit, chance, base, unit(unit(base) * chance.between(0.0, 0.10) + UP))
        meshed(stems, habit, {0: wood, 1: wood, 2: wood})
        for stem in stems[1:]:
            tip, ahead, _ = stem.at(1.0 if stem.level == 2 else 0.7)
            _tuft(chance, needles, tip, unit(ahead + 0.4 * UP), 0.17, 6)
    return Model(
        {"wood": wood.part("juniper_bark"), "needles": needles.part("juniper_needle")}, LOOKS
    )


def _tuft(
    chance: Chance, surface: Surface, base: Floats, ahead: Floats, length: float, count: int
) -> None:
    """Needles in a brush about the end of a twig: slender triangles that point ahead and out."""
    side = across(ahead)
    points, normals, faces = [], [], []
    for k in range(count):
        out = turned(side, ahead, 137.5 * k + chance.about(0.0, 25.0))
        start = base - ahead * length * 0.75 * (k / count)
        needle = unit(ahead * chance.between(0.35, 1.1) + out)
        wide = cross(needle, out) * 0.13 * length
        tip = start + needle * length * chance.between(0.75, 1.1)
        faces.append((3 * k, 3 * k + 1, 3 * k + 2))
        points += [start + wide, start - wide, tip]
        normals += [0.5 * out + 0.8 * UP] * 3
    surface.add(np.array(points), faces, np.array(normals))
