"""Trees that grow: space colonization, monopodial growth by years, radii by the pipe model.

Crowns that light shapes grow after Runions, Lane and Prusinkiewicz, "Modeling Trees with a Space
Colonization Algorithm" (Eurographics Workshop on Natural Phenomena 2007): points of free space pull
the nearest shoots toward them, and are used up where a shoot arrives. Conifers whose leader stays
the leader add one whorl a year (Massart's model of Hallé and Oldeman). Limbs are as thick as what
they carry: r^n is the sum over what leaves a node of r^n (da Vinci: n = 2; Murray: 3).
Lengths are meters, angles degrees.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from scenec.lab.models.surfaces import (
    UP,
    Chance,
    Floats,
    Integers,
    Surface,
    across,
    azimuth,
    rings_along,
    turned,
    unit,
)

#: Nodes stand on this lattice: what the last bit of a sine is decides nothing.
_DECIMALS = 6
#: Branches of a whorl; and of the way from the top in how long a branch is: 1 is a cone.
_WHORL, _TAPER = 5, 0.8


@dataclass
class Skeleton:
    """Nodes of a plant, parents before children; the first is its foot.

    Attributes:
        points: Places, [3] each.
        parents: Index of each one's parent; -1 of a foot.
    """

    points: list[Floats]
    parents: list[int]

    def add(self, point: Floats, parent: int) -> int:
        """Appends a node; returns its index."""
        self.points.append(np.round(point, _DECIMALS))
        self.parents.append(parent)
        return len(self.points) - 1

    def shoot(
        self, chance: Chance, start: int, ahead: Floats, length: float, step: float,
        wander: float = 4.0, lift: float = 0.0,
    ) -> int:  # fmt: skip
        """Grows one shoot from a node; returns its last.

        Args:
            wander: Random turn a step.
            lift: Turn upward a step, as a part of the direction; negative sags.
        """
        count = max(1, round(length / step))
        for _ in range(count):
            ahead = turned(ahead, across(ahead, chance.direction()), chance.about(0.0, wander))
            ahead = unit(ahead + lift * UP)
            start = self.add(self.points[start] + ahead * length / count, start)
        return start


class Space(NamedTuple):
    """How space is colonized.

    Attributes:
        step: Length of an internode.
        reach: From how far a point of free space pulls.
        kill: How near a shoot uses it up.
        lift: Added to each direction, upward: tropism; negative hangs.
        keep: Part of the shoot's own direction in the next one's.
    """

    step: float
    reach: float
    kill: float
    lift: float = 0.0
    keep: float = 0.4


def colonize(skeleton: Skeleton, free: Floats, how: Space, first: int = 0) -> None:
    """Grows shoots into free space until none of it is in reach.

    Args:
        free: Its points, float64 [n, 3].
        first: Nodes before this one do not branch.
    """
    points = np.round(free, _DECIMALS)
    nearest = np.full(len(points), -1)
    distance = np.full(len(points), np.inf)
    fresh = list(range(first, len(skeleton.points)))
    children: dict[int, list[Floats]] = {}
    for _ in range(400):
        if not fresh or not len(points):
            return
        away, which = cKDTree(np.array([skeleton.points[i] for i in fresh])).query(points)
        nearer = away < distance
        nearest[nearer] = np.array(fresh)[which[nearer]]
        distance = np.minimum(distance, away)
        left = distance > how.kill
        points, nearest, distance = points[left], nearest[left], distance[left]
        pulled = distance < how.reach
        owners, group = np.unique(nearest[pulled], return_inverse=True)
        places = np.array(skeleton.points)[owners]
        toward = unit(points[pulled] - places[group])
        sums = np.zeros((len(owners), 3))
        np.add.at(sums, group, toward)
        fresh = []
        for owner, total in zip(owners.tolist(), unit(sums), strict=True):
            parent = skeleton.parents[owner]
            own = UP if parent < 0 else unit(skeleton.points[owner] - skeleton.points[parent])
            ahead = unit(total + how.keep * own + how.lift * UP)
            known = children.setdefault(owner, [])
            # A second shoot along the first would only stand in it.
            if len(known) > 2 or any(float(ahead @ other) > 0.9 for other in known):
                continue
            known.append(ahead)
            fresh.append(skeleton.add(skeleton.points[owner] + how.step * ahead, owner))


def crown(
    chance: Chance, count: int, low: float, high: float, profile: Sequence[float], radius: float,
    lobes: float = 0.25, hollow: float = 0.4, middle: Callable[[float], Floats] | None = None,
) -> Floats:  # fmt: skip
    """Points of free space in a crown, float64 [count, 3].

    Args:
        low, high: Heights of its ends.
        profile: Radius over ``radius`` at even heights from low to high.
        lobes: How uneven its outline is, as a part of the radius.
        hollow: Points nearer than this part of the radius are half as many: it is dark there.
        middle: Axis at a height from 0 to 1; None: the vertical.
    """
    waves = [(chance.between(0, 6.3), chance.between(2.0, 7.0), n) for n in (2, 3, 5)]
    rows: list[Floats] = []
    steps = np.linspace(0.0, 1.0, len(profile))
    most = max(profile)
    while len(rows) < count:
        t = chance.between(0.0, 1.0)
        wide = float(np.interp(t, steps, profile))
        r, angle = math.sqrt(chance.between(0.0, 1.0)), chance.between(0.0, 2.0 * math.pi)
        thin = chance.between(0.0, 1.0)
        if thin * most * most > wide * wide or (r < hollow and thin > 0.5):
            continue
        outline = 1.0 + lobes * sum(math.sin(n * angle + a + b * t) for a, b, n in waves) / 1.7
        reach = r * wide * radius * outline
        at = np.array([reach * math.cos(angle), reach * math.sin(angle), low + t * (high - low)])
        rows.append(at if middle is None else at + middle(t))
    return np.array(rows)


class Grown(NamedTuple):
    """A skeleton with radii.

    Attributes:
        points: float64 [n, 3].
        parents: int64 [n].
        radii: float64 [n].
        carried: Tips beyond each node, int64 [n].
        child: The thickest child of each, -1 at tips, int64 [n].
    """

    points: Floats
    parents: Integers
    radii: Floats
    carried: Integers
    child: Integers

    def ahead(self, node: int) -> Floats:
        """Direction in which a node was grown."""
        parent = int(self.parents[node])
        return UP if parent < 0 else unit(self.points[node] - self.points[parent])


def thicken(skeleton: Skeleton, tip: float, foot: float, flare: float = 0.5) -> Grown:
    """Radii by the pipe model, with the exponent that makes the foot as thick as asked.

    Args:
        tip, foot: Radii at tips and at the ground.
        flare: Radius that roots add at the ground, as a part.
    """
    points, parents = np.array(skeleton.points), np.array(skeleton.parents)
    carried = np.zeros(len(points), np.int64)
    is_parent = np.zeros(len(points), bool)
    is_parent[parents[parents >= 0]] = True
    carried[~is_parent] = 1
    for node in range(len(points) - 1, 0, -1):
        if parents[node] >= 0:
            carried[parents[node]] += carried[node]
    feet = np.flatnonzero(parents < 0)
    share = math.log(foot / tip) / math.log(max(2.0, float(carried[feet].max())))
    radii = tip * carried.astype(np.float64) ** share
    child = np.full(len(points), -1)
    for node in range(len(points) - 1, 0, -1):
        parent = parents[node]
        if parent >= 0 and (child[parent] < 0 or carried[node] >= carried[child[parent]]):
            child[parent] = node
    radii *= 1.0 + flare * np.exp(-points[:, 2] / (2.5 * foot)) * (radii > 0.4 * foot)
    return Grown(points, parents, radii, carried, child)


def stems(grown: Grown) -> list[Integers]:
    """Nodes of each stem from its parent's node to its tip: the thickest child goes on."""
    starts = [(node, int(grown.parents[node])) for node in range(len(grown.points))]
    found = []
    for node, parent in starts:
        if parent >= 0 and grown.child[parent] == node:
            continue
        row = [] if parent < 0 else [parent]
        at = node
        while at >= 0:
            row.append(at)
            at = int(grown.child[at])
        found.append(np.array(row))
    return found


def limbs(
    grown: Grown, thick: Surface, thin: Surface, border: float, sides: Callable[[float], int],
    least: float, tile: tuple[float, float] = (0.5, 1.0),
) -> Floats:  # fmt: skip
    """Adds all wood: stems thicker than ``border`` to one surface, the rest to another.

    Args:
        border: Radius.
        sides: Of a tube, by its radius at the base.
        least: Stems thinner than this at the base are flat strips.
        tile: Meters of the bark's picture around and along.

    Returns:
        Texture coordinates of the thick surface's points, float64 [n, 2].
    """
    uv: list[Floats] = []
    for row in stems(grown):
        path, radii = grown.points[row].copy(), grown.radii[row].copy()
        if len(path) < 2:
            continue
        if grown.parents[row[0]] >= 0 or row[0] != 0:
            radii[0] = min(radii[0], 1.25 * radii[1])
        path, radii = _smooth(path, radii)
        base = float(radii[0])
        if base < least:
            thin.blade(path, 2.0 * radii[:-1], across(path[-1] - path[0]))
            continue
        cut = int((radii >= border).sum())
        if 1 < cut < len(path):
            uv.append(_tube(thick, path[: cut + 1], radii[: cut + 1], sides(base), tile))
            path, radii = path[cut:], radii[cut:]
            if len(path) < 2:
                continue
            base = float(radii[0])
        ends = [*radii[:-1], 0.0]
        if cut >= len(row):
            uv.append(_tube(thick, path, np.array(ends), sides(base), tile))
        else:
            thin.tube(path, ends, max(3, sides(base)))
    return np.concatenate(uv) if uv else np.zeros((0, 2))


def _smooth(path: Floats, radii: Floats) -> tuple[Floats, Floats]:
    """A stem without its lattice's corners, and without nodes that hardly bend it."""
    if len(path) > 3:
        soft = path.copy()
        soft[1:-1] = 0.25 * path[:-2] + 0.5 * path[1:-1] + 0.25 * path[2:]
        path = soft
    keep = [0]
    for i in range(1, len(path) - 1):
        a, b = path[keep[-1]], path[i + 1]
        along = b - a
        t = float((path[i] - a) @ along) / max(float(along @ along), 1e-12)
        bend = float(np.sqrt(((path[i] - a - t * along) ** 2).sum()))
        slim = abs(radii[i] - radii[keep[-1]])
        if bend > 0.004 + 0.35 * radii[i] or slim > 0.2 * radii[keep[-1]] or i - keep[-1] > 7:
            keep.append(i)
    keep.append(len(path) - 1)
    return path[keep], radii[keep]


def _tube(
    surface: Surface, path: Floats, radii: Floats, sides: int, tile: tuple[float, float]
) -> Floats:
    """A tube with a seam, for a picture around it; returns its texture coordinates."""
    lengths = np.append(0.0, np.cumsum(np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1))))
    turns = max(1.0, round(2.0 * math.pi * float(radii[0]) / tile[0]))
    points, normals, uv, faces = [], [], [], []
    for i, (center, open_) in enumerate(zip(path, rings_along(path, sides), strict=True)):
        # The seam is one place.
        ring = np.concatenate([open_, open_[:1]])
        points.append(center + max(float(radii[i]), 0.0008) * ring)
        normals.append(ring)
        along = np.full(sides + 1, lengths[i] / tile[1])
        uv.append(np.stack([turns * np.arange(sides + 1) / sides, along], axis=1))
        if i:
            a = (i - 1) * (sides + 1) + np.arange(sides)[:, None]
            b = a + sides + 1
            faces += [np.hstack([a, a + 1, b + 1]), np.hstack([a, b + 1, b])]
    surface.add(np.concatenate(points), np.concatenate(faces), np.concatenate(normals))
    return np.concatenate(uv)


def whorls(
    chance: Chance, skeleton: Skeleton, height: float, years: int, *, reach: float, first: float,
    rise: tuple[float, float], step: float, sag: float,
) -> list[tuple[int, int]]:  # fmt: skip
    """A leader that adds a shoot, and a whorl of branches at its foot, each year.

    A branch grows on for as many years as it has, less and less, until shade takes the lowest.

    Args:
        reach: Of the longest branch.
        first: Height of the lowest living whorl.
        rise: Elevation of branches at the bottom and the top.
        step: Between nodes.
        sag: Turn downward of the oldest, a step; their tips lift again.

    Returns:
        First and last node of each branch.
    """
    top = 0
    found: list[tuple[int, int]] = []
    # Shoots of the middle years are the longest.
    shares = np.array([1.0 - 0.45 * abs(2.0 * (y + 0.5) / years - 0.9) for y in range(years)])
    lengths = height * shares / shares.sum()
    spin = 0.0
    for year, length in enumerate(lengths.tolist()):
        steps = max(2, round(length / step))
        bases = [top]
        for _ in range(steps):
            lean = unit(UP + 0.03 * chance.direction())
            top = skeleton.add(skeleton.points[top] + lean * length / steps, top)
            bases.append(top)
        spin += chance.about(137.5, 20.0)
        share = float(skeleton.points[top][2]) / height
        for k in range(2 * _WHORL - 1):
            between = k >= _WHORL
            base = bases[-1] if not between else bases[len(bases) // 2]
            z = float(skeleton.points[base][2])
            if z < first or year >= years - 1:
                continue
            long = reach * max(0.0, 1.0 - z / height) ** _TAPER + 0.15
            # Shade shortens the lowest.
            long *= 0.8 + 0.2 * min(1.0, (z - first) / (0.15 * height))
            long *= chance.between(0.72, 1.08) * (0.45 if between else 1.0)
            angle = spin + 360.0 * k / _WHORL + chance.about(0.0, 16.0)
            up = rise[0] + (rise[1] - rise[0]) * share**1.3 + chance.about(0.0, 6.0)
            ahead = azimuth(angle, up)
            at, start = base, len(skeleton.points)
            parts = max(2, round(long / step))
            for i in range(parts):
                turn = -sag * (1.0 - share) if i < 0.55 * parts else 1.5 * sag * (1.0 - share)
                ahead = unit(ahead + turn * UP + 0.06 * chance.direction())
                point = skeleton.points[at] + ahead * long / parts
                point[2] = max(float(point[2]), 0.18)
                at = skeleton.add(point, at)
            found.append((start, at))
    return found
