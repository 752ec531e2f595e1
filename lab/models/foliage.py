"""Clothes grown trees: twigs with leaves or needles, and where copies of them stand."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from scenec.lab.models.glb import Copies, Places
from scenec.lab.models.growth import Grown
from scenec.lab.models.surfaces import UP, Chance, Floats, Surface, across, cross, turned, unit
from scenec.schemas.quaternions import quaternion


class Twigs:
    """Where twigs stand: places of one of several shapes."""

    def __init__(self, shapes: int):
        self.shapes = shapes
        self._rows: list[list[Floats]] = [[] for _ in range(shapes)]

    def add(self, shape: int, base: Floats, ahead: Floats, upward: Floats, size: float) -> None:
        """Puts a twig's own +x along ``ahead``, its +z as near to ``upward`` as that lets."""
        side = cross(upward, ahead)
        side = across(ahead) if float(side @ side) < 1e-8 else unit(side)
        frame = np.stack([ahead, side, cross(ahead, side)], axis=1)
        self._rows[shape].append(np.concatenate([base, quaternion(frame), [size]]))

    def places(self, shape: int) -> Places:
        """Of one shape."""
        rows = np.array(self._rows[shape]).reshape(-1, 8)
        return Places(rows[:, :3], rows[:, 3:7], rows[:, 7])

    def __len__(self) -> int:
        return sum(map(len, self._rows))


def dress(
    grown: Grown, chance: Chance, twigs: Twigs, *, thin: float, every: float,
    size: tuple[float, float], spread: float, light: float, lowest: float = 0.25,
) -> None:  # fmt: skip
    """Puts twigs of all shapes on tips and along thin shoots, in a spiral.

    Args:
        thin: Radius of the thickest shoot that carries any.
        every: Meters from one to the next along a shoot.
        size: Smallest and largest scale.
        spread: Angle to the shoot.
        light: How far twigs turn upward; below 0 they hang.
        lowest: Height below which there are none.
    """
    angle = chance.between(0.0, 360.0)
    since = 0.0
    for node in range(1, len(grown.points)):
        tip = grown.child[node] < 0
        if grown.radii[node] > thin or grown.points[node][2] < lowest:
            continue
        ahead = grown.ahead(node)
        parent = grown.points[int(grown.parents[node])]
        since += float(np.sqrt(((grown.points[node] - parent) ** 2).sum()))
        while since >= every or tip:
            angle += chance.about(137.5, 25.0)
            out = turned(across(ahead, UP), ahead, angle)
            lean = 0.0 if tip else math.tan(math.radians(spread))
            toward = unit(ahead + lean * out + light * UP)
            toward = unit(toward + 0.25 * chance.direction())
            t = 1.0 if tip else chance.between(0.0, 1.0)
            base = parent + t * (grown.points[node] - parent)
            shape = min(int(chance.between(0.0, twigs.shapes)), twigs.shapes - 1)
            upward = unit(UP + 0.5 * chance.direction())
            twigs.add(shape, base, toward, upward, chance.between(*size))
            since = 0.0 if tip else since - every
            tip = False


def leafy_twig(
    chance: Chance, *, length: float, count: int, leaf: tuple[float, float], width: float,
    spread: float = 60.0, hang: float = 0.2, first: float = 0.15, rounded: bool = False,
    stalk: float = 0.02,
) -> tuple[Surface, Surface]:  # fmt: skip
    """A twig along +x and its leaves, which look upward: wood, leaves.

    Args:
        leaf: Shortest and longest leaf.
        width: Of a leaf over its length.
        hang: How far leaves hang.
        first: Where along the twig the first one stands.
        stalk: Of a leaf, from the twig.
    """
    wood, leaves = Surface(), Surface()
    path = [np.zeros(3)]
    ahead = np.array([1.0, 0.0, 0.0])
    for _ in range(2):
        ahead = unit(ahead + 0.22 * chance.direction())
        path.append(path[-1] + ahead * length / 2)
    line = np.array(path)
    wood.blade(line, [0.005, 0.0035], across(ahead))
    angle = chance.between(0.0, 360.0)
    for k in range(count):
        t = first + (1.0 - first) * (k + 0.5) / count
        x = min(t * 2.0, 1.999)
        base = line[int(x)] + (line[int(x) + 1] - line[int(x)]) * (x - int(x))
        angle += chance.about(137.5, 30.0)
        out = turned(across(ahead), ahead, angle)
        toward = unit(ahead + math.tan(math.radians(spread)) * out * (k < count - 1))
        toward = unit(toward + 0.35 * UP - hang * UP + 0.2 * chance.direction())
        size = chance.between(*leaf)
        look = unit(UP + 0.75 * chance.direction())
        upward = look - toward * float(look @ toward)
        if float(upward @ upward) < 1e-3:
            upward = across(toward)
        # Normals lean off the blade, as a curled blade's do.
        leaves.leaf(
            base + stalk * out, toward, unit(upward), size, width * size,
            0.3 * chance.direction(), fold=chance.between(0.1, 0.4), rounded=rounded,
        )  # fmt: skip
    return wood, leaves


def needle_spray(
    chance: Chance, *, length: float, side: float, pairs: int, wide: float, droop: float,
    step: float = 0.05,
) -> tuple[Surface, Surface]:  # fmt: skip
    """A spray of needled shoots in a plane, along +x: wood, needles.

    Args:
        length: Of its axis.
        side: Of the longest shoot to a side.
        pairs: Of such.
        wide: How far needles stand off a shoot.
        droop: How far side shoots hang.
        step: Length of a brush's segment.
    """
    wood, needles = Surface(), Surface()
    ahead = np.array([1.0, 0.0, 0.0])
    wood.blade(np.array([0 * ahead, 0.5 * length * ahead, 0.9 * length * ahead]), [0.006, 0.004],
               np.array([0.0, 1.0, 0.0]))  # fmt: skip
    _brush(chance, needles, np.zeros(3), ahead, length, wide, step)
    for k in range(pairs):
        t = 0.12 + 0.72 * k / max(1, pairs - 1)
        for s in (-1.0, 1.0):
            size = side * (1.0 - 0.55 * t) * chance.between(0.75, 1.15)
            out = unit(np.array([0.85, s, -droop]) + 0.15 * chance.direction())
            at = ahead * length * (t + chance.about(0.0, 0.04))
            _brush(chance, needles, at, out, size, wide, step, 2)
    return wood, needles


def _brush(
    chance: Chance, surface: Surface, base: Floats, ahead: Floats, length: float, wide: float,
    step: float, teeth: int = 3,
) -> None:  # fmt: skip
    """A shoot with needles on all sides: tufts of two or three teeth that point ahead."""
    count = max(2, round(length / step))
    side = across(ahead)
    upward = cross(side, ahead)
    pitch = length / count
    points, normals, faces = [], [], []
    for k in range(count):
        at = base + ahead * pitch * k
        reach = wide * (1.0 - 0.35 * k / count) * chance.between(0.8, 1.2)
        roll = chance.between(-60.0, 60.0) if teeth == 3 else chance.between(-35.0, 35.0)
        for tooth_number in range(teeth):
            out = turned(side, ahead, 360.0 * tooth_number / teeth + roll)
            first = len(points)
            tooth = at + 1.6 * pitch * ahead + reach * out
            points += [at - 0.2 * pitch * ahead, at + 0.9 * pitch * ahead, tooth]
            normals += [0.5 * out + 0.8 * upward] * 3
            faces.append((first, first + 1, first + 2))
    surface.add(np.array(points), faces, np.array(normals))


def needle_tuft(
    chance: Chance, *, length: float, count: int, needle: float, wide: float = 0.007
) -> tuple[Surface, Surface]:
    """The end of a pine's shoot along +x, with needles all around: wood, needles."""
    wood, needles = Surface(), Surface()
    ahead = np.array([1.0, 0.0, 0.0])
    wood.blade(np.array([0 * ahead, 0.5 * length * ahead, 0.95 * length * ahead]), [0.009, 0.006],
               np.array([0.0, 1.0, 0.0]))  # fmt: skip
    points, normals, faces = [], [], []
    for k in range(count):
        out = turned(across(ahead), ahead, 137.5 * k + chance.about(0.0, 25.0))
        t = (k + 0.5) / count
        base = ahead * length * (0.25 + 0.75 * t)
        toward = unit(ahead * chance.between(0.5, 1.1) * (0.4 + 1.2 * t) + out)
        across_it = unit(cross(toward, out + 0.4 * chance.direction()))
        size = needle * chance.between(0.8, 1.15)
        first = len(points)
        points += [base - wide * across_it, base + wide * across_it, base + size * toward]
        normals += [0.5 * out + 0.6 * UP] * 3
        faces.append((first, first + 1, first + 2))
    needles.add(np.array(points), faces, np.array(normals))
    return wood, needles


def foliage(
    twigs: Twigs, shapes: Sequence[tuple[Surface, Surface]], wood: str,
    leaves: Sequence[tuple[str, str]],
) -> tuple[Copies, ...]:  # fmt: skip
    """All twigs, then all leaves, where the twigs stand.

    Args:
        shapes: Wood and leaves of each shape.
        wood: Material of the twigs.
        leaves: Name and material of each shape's leaves.
    """
    places = [twigs.places(shape) for shape in range(len(shapes))]
    used = [i for i, of in enumerate(places) if len(of.positions)]
    stems = [Copies("twigs", shapes[i][0].part(wood), places[i]) for i in used]
    return (
        *stems,
        *(Copies(leaves[i][0], shapes[i][1].part(leaves[i][1]), places[i]) for i in used),
    )
