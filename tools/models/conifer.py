"""A spruce: whorls of branches whose twigs are combs of needle tufts."""

from __future__ import annotations

import numpy as np
from glb import Look, Model
from surfaces import UP, Chance, Floats, Surface, across, azimuth, cross, turned, unit

LOOKS = {
    "spruce_bark": Look((0.125, 0.080, 0.058), 0.90),
    "spruce_needle": Look((0.040, 0.090, 0.032), 0.60),
    "spruce_shoot": Look((0.072, 0.130, 0.040), 0.60),
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
