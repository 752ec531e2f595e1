"""What stands about a road or a building site: signs, posts, a cone, a lamp, a drum, a pallet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from scenec.lab.models.glb import Look, Model
from scenec.lab.models.solids import Assembly, Piece, arc, ears, soft_hull, soft_polygon
from scenec.lab.models.surfaces import UP, Chance, Floats, unit

LOOKS = {
    "sign_red": Look((0.400, 0.012, 0.014), 0.45),
    "sign_white": Look((0.740, 0.740, 0.730), 0.45),
    "sign_black": Look((0.020, 0.020, 0.020), 0.50),
    "galvanized": Look((0.430, 0.440, 0.450), 0.48, 1.0),
    "aluminum_back": Look((0.360, 0.365, 0.370), 0.55),
    "post_white": Look((0.680, 0.680, 0.660), 0.50),
    "reflector": Look((0.600, 0.600, 0.590), 0.20),
    "cone_orange": Look((0.720, 0.110, 0.010), 0.55),
    "rubber": Look((0.036, 0.036, 0.037), 0.85),
    "drum_blue": Look((0.020, 0.070, 0.210), 0.40),
    "drum_rim": Look((0.055, 0.058, 0.065), 0.50),
    "pallet_wood": Look((0.400, 0.300, 0.180), 0.88),
    "lamp_gray": Look((0.240, 0.245, 0.250), 0.45),
    "lamp_glass": Look((0.620, 0.630, 0.620), 0.15),
    "concrete": Look((0.340, 0.335, 0.320), 0.92),
}

#: How far one layer of a sign's face lies before the one below it.
_FOIL_M = 0.0008


def _foil(
    surface: Piece, outline: Sequence[tuple[float, float]] | Floats, y: float, z: float
) -> None:
    """A flat outline, counter-clockwise as seen by who reads it, that faces -y at a height z."""
    flat = np.asarray(outline, np.float64)
    points = np.column_stack([flat[:, 0], np.full(len(flat), y), flat[:, 1] + z])
    surface.add(points, ears(flat), np.tile([0.0, -1.0, 0.0], (len(flat), 1)))


def _stroke(
    surface: Piece, line: Sequence[tuple[float, float]], wide: float, y: float, z: float
) -> None:
    """A line of a letter, mitered at its bends; closed where it ends at its start."""
    points = np.asarray(line, np.float64)
    closed = bool(np.allclose(points[0], points[-1]))
    if closed:
        points = points[:-1]
    ahead = unit(np.roll(points, -1, axis=0) - points)
    back = np.roll(ahead, 1, axis=0)
    if not closed:
        ahead[-1], back[0] = back[-1], ahead[0]
    normal = np.column_stack([-(ahead + back)[:, 1], (ahead + back)[:, 0]])
    miter = normal / (1.0 + (ahead * back).sum(axis=1, keepdims=True))
    left, right = points + 0.5 * wide * miter, points - 0.5 * wide * miter
    _band(surface, right, left, y, z, closed)


def _band(
    surface: Piece, outer: Floats, inner: Floats, y: float, z: float, closed: bool = True
) -> None:
    """The band between two lines of as many points."""
    count, flat = len(outer), np.concatenate([outer, inner])
    faces = []
    for i in range(count if closed else count - 1):
        j = (i + 1) % count
        faces += [(i, j, count + j), (i, count + j, count + i)]
    rows = np.column_stack([flat[:, 0], np.full(2 * count, y), flat[:, 1] + z])
    surface.add(rows, faces, np.tile([0.0, -1.0, 0.0], (2 * count, 1)))


def _oval(wide: float, high: float) -> list[tuple[float, float]]:
    """The line of a round letter."""
    r = 0.5 * wide
    return [*arc((r, high), r, 0, 180, 12), *arc((r, r), r, 180, 360, 12), (wide, high)]


#: Middle lines of letters in a box from (0, 0) to (width, 1), and its width.
_LETTERS: dict[str, tuple[list[list[tuple[float, float]]], float]] = {
    "S": ([[*arc((0.28, 0.76), 0.24, 20, 270, 12), *arc((0.28, 0.24), 0.28, 90, -160, 12)[1:]]],
          0.56),
    "T": ([[(0.0, 1.0), (0.56, 1.0)], [(0.28, 0.93), (0.28, -0.07)]], 0.56),
    "O": ([_oval(0.56, 0.72)], 0.56),
    "P": ([[(0.0, -0.07), (0.0, 1.0), (0.28, 1.0), *arc((0.28, 0.74), 0.26, 80, -80, 10),
            (0.28, 0.48), (0.07, 0.48)]], 0.54),
    # Its two bows meet in a point where the pen turns back: two lines.
    "3": ([arc((0.26, 0.76), 0.24, 150, -90, 12), arc((0.26, 0.25), 0.27, 90, -150, 12)], 0.54),
    "0": ([_oval(0.52, 0.74)], 0.52),
}  # fmt: skip


def _word(surface: Piece, text: str, height: float, y: float, z: float) -> None:
    """Letters of a height, their middle over x = 0."""
    gap, weight = 0.30, 0.17
    total = sum(_LETTERS[c][1] for c in text) + gap * (len(text) - 1)
    x = -0.5 * total
    scale = height / (1.0 + weight)
    for letter in text:
        lines, wide = _LETTERS[letter]
        for line in lines:
            points = [((x + a) * scale, (b - 0.5) * scale) for a, b in line]
            _stroke(surface, points, weight * scale, y, z)
        x += wide + gap


def _signpost(parts: Assembly, outline: Floats, height: float) -> float:
    """A plate of an outline about (0, height) on a steel tube; returns the y of its face."""
    plate = [(x, z + height) for x, z in outline]
    top = max(z for _, z in plate)
    back, pole, footing = parts.parts(plate="aluminum_back", pole="galvanized", footing="concrete")
    back.prism(plate, -0.0400, -0.0370, "xzy")
    tube = [(0, 0), (0.030, 0), (0.030, top - 0.02), (0.026, top), (0, top)]
    pole.turned(tube, 24, crease=50)
    for z in (height - 0.16, height + 0.16):
        clamp = [(0.0305, -0.02), (0.036, -0.02), (0.036, 0.02), (0.0305, 0.02)]
        pole.turned(clamp, 24, UP, (0, 0, z))
        pole.rounded_box((-0.10, -0.037, z - 0.015), (0.10, -0.031, z + 0.015), 0.002)
    footing.turned([(0, -0.02), (0.15, -0.02), (0.15, 0.015), (0.13, 0.03), (0, 0.03)], 24)
    return -0.0400


def _regular(sides: int, across_flats: float, corner: float, turn: float, steps: int = 5) -> Floats:
    radius = 0.5 * across_flats / math.cos(math.pi / sides)
    corners = [
        (radius * math.cos(a), radius * math.sin(a))
        for a in np.radians(turn + 360.0 * np.arange(sides) / sides)
    ]
    return soft_polygon(corners, corner, steps)


def sign_stop() -> Model:
    """A stop sign (Vienna Convention B2a), 0.75 m across, its middle 2.1 m up."""
    parts, height = Assembly(LOOKS), 2.1
    outer = _regular(8, 0.75, 0.02, 22.5)
    front = _signpost(parts, outer, height)
    edge, inner = _regular(8, 0.74, 0.02, 22.5), _regular(8, 0.69, 0.02, 22.5)
    white, red = parts.part("white", "sign_white"), parts.part("red", "sign_red")
    _band(white, edge, inner, front - _FOIL_M, height)
    _foil(red, inner, front - _FOIL_M, height)
    _word(white, "STOP", 0.25, front - 2 * _FOIL_M, height)
    return parts.model()


def sign_give_way() -> Model:
    """A give-way sign (Vienna Convention B1), 0.83 m wide, its middle 2.1 m up."""
    parts, height = Assembly(LOOKS), 2.1
    outer = _regular(3, 0.52, 0.045, -90.0)
    front = _signpost(parts, outer, height)
    edge, inner = _regular(3, 0.505, 0.040, -90.0), _regular(3, 0.34, 0.012, -90.0)
    red, white = parts.parts(red="sign_red", white="sign_white")
    _band(red, edge, inner, front - _FOIL_M, height)
    _foil(white, inner, front - _FOIL_M, height)
    return parts.model()


def sign_speed_limit() -> Model:
    """A speed limit of 30 (Vienna Convention C14), 0.6 m across, its middle 2.1 m up."""
    parts, height = Assembly(LOOKS), 2.1
    circle = np.array(arc((0.0, 0.0), 1.0, 0.0, 360.0, 65))[:-1]
    front = _signpost(parts, 0.300 * circle, height)
    red, white, digits = parts.parts(red="sign_red", white="sign_white", digits="sign_black")
    _band(red, 0.295 * circle, 0.215 * circle, front - _FOIL_M, height)
    _foil(white, 0.215 * circle, front - _FOIL_M, height)
    _word(digits, "30", 0.24, front - 2 * _FOIL_M, height)
    return parts.model()


def delineator() -> Model:
    """A delineator post of 1.05 m with its black band, the reflector to -y."""
    parts = Assembly(LOOKS)
    flat = np.array([(-0.06, -0.045), (0.06, -0.045), (0.045, 0.0), (0.0, 0.055), (-0.045, 0.0)])
    outline = soft_polygon(flat, 0.010, 4)
    post, band, lights = parts.parts(post="post_white", band="sign_black", reflectors="reflector")
    for piece, low, high, lean in (
        (post, 0.0, 0.70, 0.0), (band, 0.70, 0.93, 0.0), (post, 0.93, 1.03, 0.45),
    ):  # fmt: skip
        # Its top slopes to the road.
        top = np.column_stack([outline, high + lean * outline[:, 1]])
        piece.loft([np.column_stack([outline, np.full(len(outline), low)]), top], crease=40)
    lights.rounded_box((-0.022, -0.046 - 0.006, 0.735), (0.022, -0.046 + 0.002, 0.895), 0.003)
    return parts.model()


def traffic_cone() -> Model:
    """A traffic cone of 0.75 m with two reflecting bands."""
    parts = Assembly(LOOKS)
    parts.part("base", "rubber").rounded_box((-0.20, -0.20, 0.0), (0.20, 0.20, 0.035), 0.012)

    def radius(z: float) -> float:
        return 0.148 + (0.028 - 0.148) * (z - 0.035) / 0.705

    cuts = (0.035, 0.30, 0.40, 0.50, 0.64, 0.74)
    for n, (low, high) in enumerate(pairwise(cuts)):
        white = n % 2 == 1
        surface = parts.part("bands" if white else "cone", "reflector" if white else "cone_orange")
        grow = 0.0012 if white else 0.0
        profile = [(0.0, low), (radius(low) + grow, low), (radius(high) + grow, high), (0.0, high)]
        if n == 4:
            profile = [
                (0.0, low), (radius(low), low), (radius(high), high - 0.006),
                (radius(high) - 0.006, high), (0.014, high), (0.012, high - 0.05),
                (0.0, high - 0.05),
            ]  # fmt: skip
        if n == 0:
            profile = [
                (0.0, low), (0.162, low), (0.160, low + 0.014), (radius(low + 0.02), low + 0.022),
                (radius(high), high), (0.0, high),
            ]  # fmt: skip
        surface.turned(profile, 40, crease=45)
    return parts.model()


def oil_drum() -> Model:
    """A steel drum of 200 liters with two rolling hoops and bungs."""
    parts = Assembly(LOOKS)
    r, high = 0.286, 0.88
    profile = [
        (0.0, 0.018), (r - 0.012, 0.018), (r - 0.010, 0.0), (r + 0.004, 0.0), (r + 0.006, 0.012),
        (r, 0.020),
    ]  # fmt: skip
    for z in (0.30, 0.585):
        profile += [
            (r, z - 0.035), (r + 0.004, z - 0.02), (r + 0.010, z - 0.007), (r + 0.010, z + 0.007),
            (r + 0.004, z + 0.02), (r, z + 0.035),
        ]  # fmt: skip
    profile += [
        (r, high - 0.020), (r + 0.006, high - 0.012), (r + 0.004, high), (r - 0.010, high),
        (r - 0.012, high - 0.018), (0.0, high - 0.018),
    ]  # fmt: skip
    parts.part("drum", "drum_blue").turned(profile, 56, crease=50)
    for x, y, size in ((0.19, 0.0, 0.034), (-0.18, 0.08, 0.018)):
        bung = [(0, 0), (size, 0), (size, 0.008), (size * 0.8, 0.012), (0, 0.012)]
        parts.part("bungs", "drum_rim").turned(bung, 16, UP, (x, y, high - 0.018))
    return parts.model()


def pallet() -> Model:
    """A flat pallet of 1200 by 800 mm (EN 13698-1): nine blocks, nailed boards."""
    chance, parts = Chance("pallet"), Assembly(LOOKS)
    wood = parts.part("boards", "pallet_wood")

    def board(low: Sequence[float], high: Sequence[float]) -> None:
        wood.rounded_box(low, np.asarray(high) - chance.between(0.0, 0.003), 0.003)

    for y, half in ((-0.35, 0.05), (0.0, 0.0725), (0.35, 0.05)):
        board((-0.6, y - half, 0.0), (0.6, y + half, 0.022))
        for x, long in ((-0.5275, 0.0725), (0.0, 0.0725), (0.5275, 0.0725)):
            board((x - long, y - half, 0.022), (x + long, y + half, 0.100))
    for x in (-0.5275, 0.0, 0.5275):
        board((x - 0.0725, -0.4, 0.100), (x + 0.0725, 0.4, 0.122))
    for y, half in (
        (-0.3275, 0.0725), (-0.165, 0.05), (0.0, 0.0725), (0.165, 0.05), (0.3275, 0.0725),
    ):  # fmt: skip
        board((-0.6, y - half, 0.122), (0.6, y + half, 0.144))
    nails = parts.part("nails", "galvanized")
    for x in (-0.5275, 0.0, 0.5275):
        for y in (-0.3275, -0.165, 0.0, 0.165, 0.3275):
            for dx, dy in ((-0.035, -0.02), (0.035, 0.02)):
                nails.rod((x + dx, y + dy, 0.138), (x + dx, y + dy, 0.1446), 0.004, 6)
    return parts.model()


def street_lamp() -> Model:
    """A street lamp: a tapered steel pole of 6 m, its head over -y."""
    parts = Assembly(LOOKS)
    pole = parts.part("pole", "galvanized")
    pole.turned(
        [(0, 0.0), (0.075, 0.0), (0.075, 1.25), (0.068, 1.30), (0.034, 5.80), (0, 5.80)], 24
    )
    parts.part("footing", "concrete").turned(
        [(0, -0.02), (0.22, -0.02), (0.22, 0.02), (0.20, 0.04), (0, 0.04)], 28
    )
    pole.rounded_box((-0.035, -0.082, 0.62), (0.035, -0.05, 1.0), 0.006)
    bow = [
        (0.0, -0.45 * (1 - math.cos(a)), 5.75 + 0.30 * math.sin(a))
        for a in np.radians([0, 25, 50, 72, 88])
    ]
    pole.bent(
        [(0.0, 0.0, 5.70), *bow, (0.0, -0.62, 6.055)],
        [0.036, 0.034, 0.032, 0.030, 0.030, 0.030, 0.030],
        16,
    )
    head = [
        (-0.55, 0.05, 6.01, 6.09, 0.03), (-0.62, 0.11, 6.00, 6.11, 0.03),
        (-0.80, 0.15, 6.00, 6.11, 0.03), (-1.12, 0.14, 6.01, 6.09, 0.03),
        (-1.18, 0.10, 6.015, 6.07, 0.03),
    ]  # fmt: skip
    parts.part("head", "lamp_gray").loft(soft_hull(head, 4))
    parts.part("lamp", "lamp_glass").rounded_box((-0.10, -1.08, 5.992), (0.10, -0.70, 6.02), 0.006)
    return parts.model()
