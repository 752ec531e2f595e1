"""A juniper whose twigs end in tufts of needles."""

from __future__ import annotations

import numpy as np

from scenec.lab.models.glb import Look, Model
from scenec.lab.models.solids import Assembly
from scenec.lab.models.stems import Habit, Level, grown, meshed
from scenec.lab.models.surfaces import (
    UP,
    Chance,
    Floats,
    Surface,
    across,
    azimuth,
    cross,
    turned,
    unit,
)

LOOKS = {
    "juniper_bark": Look((0.140, 0.090, 0.065), 0.90),
    "juniper_needle": Look((0.067, 0.118, 0.073), 0.60, through=0.22),
}


def juniper() -> Model:
    """A common juniper: a dense column of upright stems."""
    chance, parts = Chance("juniper"), Assembly(LOOKS)
    wood, needles = parts.parts(wood="juniper_bark", needles="juniper_needle")
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
    return parts.model(grown=True)


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
