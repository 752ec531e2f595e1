"""Branching after Weber and Penn, "Creation and Rendering of Realistic Trees" (SIGGRAPH 1995).

Of their model this keeps stems that curve and taper, children by level with lengths from the
crown's shape, radii by the power of relative lengths, and attraction upward; without clones,
pruning and wind. Lengths are meters, angles degrees.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from scenec.lab.models.surfaces import UP, Chance, Floats, Surface, across, cross, turned, unit


@dataclass(frozen=True)
class Level:
    """Stems of one level; a value and its spread where there are two.

    Attributes:
        length: Relative to the parent's (the trunk: to the height).
        segments, sides: Of the mesh: 0 is no mesh, 1 a flat strip.
        curve: Turn from base to tip; positive is downward.
        wander: Random turns of the whole stem.
        children: Of one stem of full length.
        down: Angle between a child and its parent.
        down_low: Added for children at the parent's base, fading toward its tip.
        rotate: Angle about the parent from one child to the next.
        bare: Part of the stem, from its base, without children.
        attraction: Turn upward per segment, relative; negative hangs.
        taper: Radius at the tip, relative to that at the base.
    """

    length: tuple[float, float]
    segments: int
    sides: int
    curve: tuple[float, float] = (0.0, 0.0)
    wander: float = 0.0
    children: int = 0
    down: tuple[float, float] = (50.0, 10.0)
    down_low: float = 0.0
    rotate: tuple[float, float] = (137.5, 15.0)
    bare: float = 0.1
    attraction: float = 0.0
    taper: float = 0.0


@dataclass(frozen=True)
class Habit:
    """A woody plant's way to grow.

    Attributes:
        height: Length of the trunk, before it bends.
        radius: Of the trunk at its base.
        shape: How long a child of the trunk is, by its height between the lowest (0) and the top.
        levels: From the trunk up.
        ratio_power: Of relative length, for a child's radius.
        flare: Of the trunk's base: relative radius added at the ground.
    """

    height: float
    radius: float
    shape: tuple[float, ...]
    levels: tuple[Level, ...]
    ratio_power: float = 1.2
    flare: float = 0.6


@dataclass(frozen=True)
class Stem:
    """A stem as grown: points and radii along it."""

    level: int
    path: Floats
    radii: Floats
    length: float

    def at(self, t: float) -> tuple[Floats, Floats, float]:
        """Point, direction and radius at a fraction of its length."""
        x = min(max(t, 0.0), 1.0) * (len(self.path) - 1)
        i = min(int(x), len(self.path) - 2)
        f = x - i
        point = self.path[i] * (1.0 - f) + self.path[i + 1] * f
        radius = self.radii[i] * (1.0 - f) + self.radii[i + 1] * f
        return point, unit(self.path[i + 1] - self.path[i]), float(radius)


def grown(habit: Habit, chance: Chance, base: Floats, ahead: Floats) -> list[Stem]:
    """All stems of a plant, parents before their children."""
    trunk = habit.levels[0]
    length = habit.height * chance.about(*trunk.length)
    stems = [_stem(0, habit, chance, base, ahead, length, habit.radius)]
    for parent in stems:
        if parent.level + 1 < len(habit.levels):
            stems += _children(parent, habit, chance)
    return stems


def _stem(
    index: int, habit: Habit, chance: Chance, base: Floats, ahead: Floats, length: float,
    radius: float,
) -> Stem:  # fmt: skip
    level = habit.levels[index]
    path, n = [base], level.segments
    curve = chance.about(*level.curve) / n
    for _ in range(n):
        ahead = turned(ahead, across(ahead, UP), -curve)
        if level.wander:
            ahead = turned(ahead, across(ahead, chance.direction()), chance.about(0, level.wander))
        if level.attraction:
            level_out = math.sqrt(max(0.0, 1.0 - float(ahead[2]) ** 2))
            ahead = unit(ahead + level.attraction * level_out / n * UP)
        path.append(path[-1] + ahead * length / n)
    along = np.linspace(0.0, 1.0, n + 1)
    radii = radius * (1.0 - (1.0 - level.taper) * along**0.9)
    if index == 0:
        radii *= 1.0 + habit.flare * np.exp(-along * length / (3.0 * radius))
    return Stem(index, np.array(path), radii, length)


def _children(parent: Stem, habit: Habit, chance: Chance) -> Iterator[Stem]:
    own, level = habit.levels[parent.level], habit.levels[parent.level + 1]
    count = own.children
    if parent.level:
        typical = habit.height * math.prod(
            habit.levels[i].length[0] for i in range(parent.level + 1)
        )
        count = round(own.children * min(1.3, 0.2 + 0.8 * parent.length / typical))
    angle = chance.between(0.0, 360.0)
    for k in range(count):
        share = (k + chance.between(0.2, 0.8)) / count
        t = own.bare + (1.0 - own.bare) * share
        base, along, radius = parent.at(t)
        angle += chance.about(*own.rotate)
        side = turned(across(along, UP), along, angle)
        down = chance.about(*own.down) + own.down_low * (1.0 - share)
        ahead = turned(along, cross(along, side), down)
        if parent.level == 0:
            ratio = float(np.interp(share, np.linspace(0.0, 1.0, len(habit.shape)), habit.shape))
        else:
            ratio = 1.0 - 0.6 * t
        length = parent.length * chance.about(*level.length) * ratio
        thick = parent.radii[min(1, len(parent.radii) - 1) if parent.level == 0 else 0]
        thick *= (length / parent.length) ** habit.ratio_power
        thick = max(min(0.9 * radius, float(thick)), 0.0012)
        yield _stem(parent.level + 1, habit, chance, base, ahead, length, thick)


def meshed(stems: list[Stem], habit: Habit, surfaces: dict[int, Surface]) -> None:
    """Adds the stems to the surface of their level."""
    for stem in stems:
        sides = habit.levels[stem.level].sides
        if sides == 1:
            side = across(stem.path[-1] - stem.path[0])
            surfaces[stem.level].blade(stem.path, 2.0 * stem.radii[:-1], side)
        elif sides:
            surfaces[stem.level].tube(stem.path, stem.radii, sides)
