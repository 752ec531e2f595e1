"""A dog rose, and dead wood."""

from __future__ import annotations

import math

import numpy as np

from scenec.lab.models.glb import Look, Model
from scenec.lab.models.solids import Assembly, loft
from scenec.lab.models.stems import Habit, Level, grown, meshed
from scenec.lab.models.surfaces import (
    UP,
    Chance,
    Floats,
    Surface,
    across,
    azimuth,
    band,
    turned,
    unit,
)

LOOKS = {
    "rose_bark": Look((0.090, 0.100, 0.045), 0.70),
    "rose_leaf": Look((0.072, 0.158, 0.025), 0.45, through=0.55),
    "rose_petal": Look((0.820, 0.440, 0.480), 0.60, through=0.40),
    "dead_bark": Look((0.140, 0.110, 0.085), 0.95),
    "dead_wood": Look((0.360, 0.290, 0.205), 0.90),
    "bleached_wood": Look((0.330, 0.310, 0.280), 0.90),
}


def rose() -> Model:
    """A dog rose in flower: arching canes, pinnate leaves, pale pink flowers."""
    chance, parts = Chance("rose"), Assembly(LOOKS)
    canes, leaves, petals = parts.parts(canes="rose_bark", leaves="rose_leaf", flowers="rose_petal")
    for k in range(15):
        habit = Habit(
            height=chance.between(0.8, 1.6),
            radius=0.008,
            shape=(0.7, 1.0, 0.8, 0.5),
            flare=0.1,
            levels=(
                Level((1.0, 0.0), 7, 3, curve=(105, 30), wander=6.0, children=7, bare=0.2),
                Level((0.22, 0.06), 2, 1, curve=(20, 20), down=(55, 15), attraction=0.9),
            ),
        )
        base = azimuth(24.0 * k + chance.about(0, 10)) * chance.between(0.03, 0.16)
        stems = grown(habit, chance, base, unit(unit(base) * chance.between(0.05, 0.42) + UP))
        for stem in stems:
            stem.path[1:, 2] = np.maximum(stem.path[1:, 2], 0.02)
        meshed(stems, habit, {0: canes, 1: canes})
        for stem in stems:
            count = max(3, round(stem.length * 9.3))
            for j in range(count):
                point, along, _ = stem.at(0.2 + 0.8 * (j + 0.8) / count)
                around = turned(across(along), along, 137.5 * j + chance.about(0, 20))
                if point[2] > 0.12:
                    _pinnate(leaves, chance, point, unit(along + 1.1 * around + 0.35 * UP))
            if stem.level == 1 and chance.between(0.0, 1.0) < 0.36:
                _rose_flower(petals, chance, *stem.at(1.0)[:2])
    return parts.model(grown=True)


def _pinnate(surface: Surface, chance: Chance, base: Floats, ahead: Floats) -> None:
    """A leaf of five leaflets."""
    size = chance.between(0.048, 0.064)
    side = across(ahead)
    upward = unit(np.cross(side, ahead) + 0.3 * chance.direction())
    outward = unit(base - np.array([0.0, 0.0, 0.4]))
    for place, s in ((0.7, -1.0), (0.75, 1.0), (1.35, -1.0), (1.4, 1.0), (1.7, 0.0)):
        lobe = unit(ahead + 1.2 * s * side)
        start = base + ahead * size * place - UP * size * 0.10 * place * place
        surface.leaf(start, lobe, upward, size, 0.62 * size, outward)


def _rose_flower(surface: Surface, chance: Chance, base: Floats, ahead: Floats) -> None:
    axis = unit(ahead + UP + 0.4 * chance.direction())
    start = across(axis)
    for j in range(5):
        out = turned(start, axis, 72.0 * j)
        surface.leaf(base, unit(out + 0.35 * axis), axis, 0.034, 0.038, fold=0.1, widest=0.72)


def log() -> Model:
    """A dead branch on the ground: bent, knotty, with broken side branches and pale ends."""
    chance = Chance("log")
    bark, ends = Surface(), Surface()
    sides, rings, length = 18, 30, 2.4
    waves = [(chance.between(0.2, 1.0), chance.between(0, 6.3), n) for n in (1, 2, 5, 8)]
    grid = np.zeros((rings, sides, 3))
    for i in range(rings):
        t = i / (rings - 1)
        middle = np.array(
            [
                (t - 0.5) * length,
                0.10 * math.sin(2.6 * t + 0.4) + 0.025 * math.sin(9.0 * t),
                0.02 * math.sin(5.0 * t),
            ]
        )
        radius = 0.105 - 0.042 * t + 0.018 * math.exp(-(((t - 0.62) / 0.05) ** 2))
        for j in range(sides):
            a = 2.0 * math.pi * j / sides
            ridge = sum(w * math.sin(n * a + p + 1.2 * t * n) for w, p, n in waves) * 0.05
            rough = 1.0 + ridge + chance.about(0.0, 0.07)
            grid[i, j] = middle + radius * rough * np.array([0.0, math.cos(a), math.sin(a)])
    # Broken ends are not cut at right angles.
    grid[0, :, 0] += 0.05 * np.cos(2.0 * math.pi * np.arange(sides) / sides)
    grid[-1, :, 0] += [chance.about(0.0, 0.035) for _ in range(sides)]
    bark.add(grid.reshape(-1, 3), band(rings, sides), None)
    for i, out in ((0, -1.0), (rings - 1, 1.0)):
        heart = grid[i].mean(axis=0) + np.array([-0.015 * out, 0.0, 0.0])
        fan = [(0, 1 + j, 1 + (j + 1) % sides) for j in range(sides)]
        if out < 0.0:
            fan = [(a, c, b) for a, b, c in fan]
        ends.add(np.concatenate([heart[None], grid[i]]), fan, None)
    for t, angle, reach, radius in (
        (0.62, 70, 0.34, 0.034), (0.40, 140, 0.16, 0.026), (0.78, 20, 0.22, 0.022),
        (0.22, 105, 0.12, 0.030), (0.88, 160, 0.30, 0.016),
    ):  # fmt: skip
        i = round(t * (rings - 1))
        outward = np.array([0.0, math.cos(math.radians(angle)), math.sin(math.radians(angle))])
        base = grid[i].mean(axis=0) + 0.03 * outward
        ahead = unit(outward + np.array([1.3, 0.0, 0.0]))
        path = [base]
        for _ in range(4):
            path.append(path[-1] + ahead * (reach + 0.05) / 4)
            ahead = unit(ahead + 0.3 * chance.direction())
        radii = radius * np.array([1.5, 0.95, 0.75, 0.6, 0.42])
        bark.tube(np.array(path), radii, 7)
        ends.spun([(float(radii[-1]), 0.0), (0.0, float(radii[-1]))], 7, ahead, path[-1])
    low = float(grid[:, :, 2].min())
    parts = {}
    for name, surface, material in (
        ("bark", bark, "dead_bark"), ("broken_ends", ends, "dead_wood"),
    ):  # fmt: skip
        part = surface.part(material)
        part.points[:, 2] -= low
        parts[name] = part
    return Model(parts, LOOKS)


def snag() -> Model:
    """A dead tree: bleached trunk, snapped off, with bare crooked limbs."""
    habit = Habit(
        height=6.4,
        radius=0.20,
        shape=(0.8, 1.0, 0.9, 0.7),
        ratio_power=1.15,
        levels=(
            Level((1.0, 0.0), 22, 16, wander=4.0, children=14, bare=0.28, taper=0.42),
            Level(
                (0.30, 0.12), 7, 7, curve=(-20, 30), wander=26.0, children=5, down=(62, 14),
                bare=0.25, attraction=0.2,
            ),
            Level((0.45, 0.15), 4, 5, wander=26.0, children=3, down=(55, 15), bare=0.3),
            Level((0.5, 0.15), 3, 4, wander=22.0, down=(50, 15)),
        ),
    )  # fmt: skip
    chance, parts = Chance("snag"), Assembly(LOOKS)
    stems = grown(habit, chance, np.zeros(3), unit(np.array([0.05, 0.03, 1.0])))
    wood, breaks = parts.parts(wood="bleached_wood", breaks="dead_wood")
    path, radii = stems[0].path, stems[0].radii
    sides = 24
    angles = 2.0 * math.pi * np.arange(sides) / sides
    waves = [(chance.between(0.2, 1.0), chance.between(0, 6.3), n) for n in (3, 5, 8, 11)]
    sections = []
    for k, (at, radius) in enumerate(zip(path, radii, strict=True)):
        # Spiral grain; roots buttress the foot.
        ridge = sum(w * np.sin(n * angles + p + 0.22 * k) for w, p, n in waves) * 0.045
        foot = 0.55 * math.exp(-3.0 * k) * np.maximum(0.0, np.sin(4 * angles + waves[0][1]))
        ring = radius * (1.0 + ridge + foot)
        circle = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(sides)])
        sections.append(at + circle * ring[:, None])
    # Splinters of the break are of unequal height.
    sections[-1][:, 2] += [chance.between(-0.05, 0.5) ** 2 * 1.6 for _ in range(sides)]
    trunk = loft(np.array(sections))
    cap = len(trunk.points) - 1
    trunk.points[cap, 2] = path[-1, 2] - 0.12
    hollow = (trunk.faces == cap).any(axis=1)
    wood.solid(trunk._replace(faces=trunk.faces[~hollow]), crease=50)
    breaks.solid(trunk._replace(faces=trunk.faces[hollow]), crease=30)
    meshed(stems[1:], habit, {1: wood, 2: wood, 3: wood})
    return parts.model(grown=True)
