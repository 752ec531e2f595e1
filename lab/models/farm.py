"""What stands about a farm: fences, a shed, a bench, a bale, a wall of field stones."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from scenec.compiler.geometry.icosphere import icosphere
from scenec.lab.models.glb import Look, Model
from scenec.lab.models.solids import Assembly, Piece, Solid, arc, loft, outward, turned_shape
from scenec.lab.models.surfaces import UP, Chance, Floats, turned, unit

LOOKS = {
    "weathered_wood": Look((0.245, 0.205, 0.160), 0.85),
    "gray_wood": Look((0.270, 0.250, 0.225), 0.88),
    "oiled_wood": Look((0.300, 0.160, 0.070), 0.60),
    "cut_wood": Look((0.420, 0.320, 0.200), 0.85),
    "paint_falu": Look((0.235, 0.038, 0.022), 0.80),
    "paint_white": Look((0.700, 0.700, 0.670), 0.60),
    "galvanized": Look((0.430, 0.440, 0.450), 0.48, 1.0),
    "iron": Look((0.030, 0.030, 0.032), 0.55),
    "roof_steel": Look((0.130, 0.130, 0.135), 0.50),
    "glass": Look((0.012, 0.014, 0.016), 0.06),
    "dark": Look((0.020, 0.018, 0.016), 0.90),
    "straw": Look((0.480, 0.360, 0.140), 0.90),
    "straw_shade": Look((0.330, 0.240, 0.095), 0.95),
    "straw_pale": Look((0.600, 0.480, 0.220), 0.85),
    "field_stone": Look((0.250, 0.235, 0.210), 0.92),
    "lichen_stone": Look((0.330, 0.325, 0.270), 0.95),
    "dark_stone": Look((0.170, 0.165, 0.160), 0.92),
}


def _board(
    surface: Piece,
    chance: Chance,
    low: Sequence[float],
    high: Sequence[float],
    bevel: float = 0.004,
) -> None:
    """A board that is a little off its measures and its place, as sawn and nailed wood is."""
    size = np.asarray(high) - np.asarray(low)
    middle = 0.5 * (np.asarray(high) + np.asarray(low))
    long = int(np.argmax(size))
    half = 0.5 * size - np.where(np.arange(3) == long, chance.between(0.0, 0.004), 0.0)
    axis = np.eye(3)[(long + 1 + int(size[(long + 1) % 3] > size[(long + 2) % 3])) % 3]
    degrees = chance.about(0.0, 0.25)
    frame = np.array([turned(row, axis, degrees) for row in np.eye(3)])
    surface.rounded_box(-half, half, bevel, middle + 0.0015 * chance.direction(), frame)


def _post_shape(chance: Chance, height: float, radius: float, at: Floats) -> Solid:
    """A round post, not quite straight, its top cut to a blunt point."""
    rings = [0.0, 0.25, 0.6, 1.0, height - 0.05, height - 0.012, height]
    waves = [(chance.about(0.0, 0.035), chance.between(0, 6.3), n) for n in (2, 3, 5)]
    angles = 2.0 * math.pi * np.arange(18) / 18
    sections = []
    for z in rings:
        rough = 1.0 + sum(w * np.sin(n * angles + p + 0.6 * z) for w, p, n in waves)
        taper = 1.0 - 0.06 * z / height
        size = radius * taper * (1.0 if z < height - 0.04 else 0.86 if z < height else 0.55)
        lean = 0.012 * np.array([math.sin(1.1 * z + waves[0][1]), math.cos(0.9 * z), 0.0]) * z
        circle = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(18)])
        sections.append(at + lean + circle * (size * rough)[:, None] + UP * z)
    return loft(np.array(sections))


def fence_post() -> Model:
    """A round wooden fence post with three staples for wire."""
    chance, parts = Chance("fence_post"), Assembly(LOOKS)
    parts.part("post", "gray_wood").solid(_post_shape(chance, 1.40, 0.055, np.zeros(3)), crease=30)
    for z in (0.35, 0.75, 1.2):
        path = [(-0.012, -0.045, z), (-0.012, -0.066, z), (0.012, -0.066, z), (0.012, -0.045, z)]
        parts.part("staples", "galvanized").bent(path, 0.002, 6)
    return parts.model()


def fence_panel() -> Model:
    """A picket fence of 1.8 m with one post: copies 1.8 m apart along x make a fence."""
    chance, parts = Chance("fence_panel"), Assembly(LOOKS)
    wood = parts.part("pickets", "weathered_wood")
    rails = parts.part("rails", "gray_wood")
    for z in (0.24, 0.80):
        _board(rails, chance, (-0.90, -0.019, z - 0.045), (0.90, 0.019, z + 0.045))
    count = 14
    for k in range(count):
        x = -0.9 + 1.8 * (k + 0.75) / count
        top = 1.05 + chance.about(0.0, 0.006)
        outline = [
            (x - 0.042, 0.05), (x + 0.042, 0.05), (x + 0.042, top - 0.06), (x, top),
            (x - 0.042, top - 0.06),
        ]  # fmt: skip
        lean = chance.about(0.0, 0.006)
        shape = [(a + lean * (b - 0.5), b) for a, b in outline]
        wood.prism(shape, -0.041, -0.019, "xzy", 0.003, crease=30)
        for z in (0.24, 0.80):
            nail = (x + lean, -0.040, z + chance.about(0, 0.01))
            parts.part("nails", "galvanized").rod(nail, (nail[0], -0.043, nail[2]), 0.004, 6)
    post = parts.part("posts", "gray_wood")
    post.rounded_box((-0.945, -0.045, 0.0), (-0.855, 0.045, 1.12), 0.008)
    post.loft(
        [
            [(-0.9 + s * a, t * a, z) for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            for a, z in ((0.055, 1.115), (0.055, 1.135), (0.004, 1.175))
        ]
    )
    return parts.model()


def gate() -> Model:
    """A field gate of galvanized tubes, 3 m between its two wooden posts, closed."""
    chance, parts = Chance("gate"), Assembly(LOOKS)
    tubes, iron = parts.part("gate", "galvanized"), parts.part("hinges", "iron")
    for s in (-1.0, 1.0):
        parts.part("posts", "gray_wood").solid(
            _post_shape(chance, 1.5, 0.10, np.array([s * 1.62, 0.0, 0.0])), crease=30
        )
    x, low, high, r = 1.42, 0.22, 1.22, 0.024
    corner = 0.08
    ring: list[tuple[float, float, float]] = []
    for cx, cz, start in (
        (-x + corner, high - corner, 180), (x - corner, high - corner, 90),
        (x - corner, low + corner, 0), (-x + corner, low + corner, -90),
    ):  # fmt: skip
        ring += [(x, 0.0, z) for x, z in arc((cx, cz), corner, start, start - 90, 7)]
    closed = [((ring[0][0] + ring[-1][0]) / 2, 0.0, (ring[0][2] + ring[-1][2]) / 2)]
    tubes.bent([*closed, *ring, *closed], r, 12)
    for z in (0.40, 0.58, 0.78, 1.0):
        tubes.rod((-x, 0, z), (x, 0, z), 0.019, 12)
    tubes.rod((0, 0.0, low), (0, 0.0, high), 0.019, 12)
    for s in (-1.0, 1.0):
        tubes.rod((s * x, 0.035, low + 0.03), (0.0, 0.035, high - 0.03), 0.015, 10)
    for z in (0.36, 1.10):
        iron.rod((-x - 0.03, 0, z - 0.06), (-x - 0.03, 0, z + 0.06), 0.02, 12)
        iron.rod((-x - 0.03, 0, z), (-1.62, 0, z), 0.012, 10)
    iron.rounded_box((x - 0.02, -0.02, 0.90), (1.56, 0.02, 0.94), 0.006)
    iron.rounded_box((x + 0.03, -0.035, 0.86), (x + 0.06, 0.035, 0.99), 0.006)
    return parts.model()


def shed() -> Model:
    """A garden shed: boarded walls, a ledged door to -y, a window, a roof of corrugated steel."""
    chance, parts = Chance("shed"), Assembly(LOOKS)
    walls, white = parts.part("walls", "paint_falu"), parts.part("trim", "paint_white")
    half_x, half_y, eaves, ridge = 1.25, 0.95, 1.95, 2.50
    slope = (ridge - eaves) / half_x
    inside, x, y = parts.part("inside", "dark"), half_x - 0.03, half_y - 0.03
    inside.rounded_box((-x, -y, 0.05), (x, y, eaves), 0.01)
    attic = [(-half_x + 0.05, eaves - 0.02), (half_x - 0.05, eaves - 0.02), (0, ridge - 0.06)]
    inside.prism(attic, -y, y, "xzy")
    base = parts.part("base", "field_stone")
    for x in (-1.15, 0.0, 1.15):
        for y in (-0.85, 0.85):
            base.rounded_box((x - 0.14, y - 0.14, 0.0), (x + 0.14, y + 0.14, 0.13), 0.015)
    walls.rounded_box((-half_x, -half_y, 0.08), (half_x, half_y, 0.16), 0.008)
    door = (-0.85, -0.02)
    window = (0.35, 0.95, 1.05, 1.65)
    step = 2.0 * half_x / 18
    for s in (-1.0, 1.0):
        for k in range(18):
            a, b = -half_x + step * k + 0.0015, -half_x + step * (k + 1) - 0.0015
            high = [eaves + slope * (half_x - abs(x)) - 0.02 for x in (b, a)]
            spans = [(0.12, None)]
            middle = 0.5 * (a + b)
            if s < 0 and door[0] < middle < door[1]:
                spans = [(1.86, None)]
            elif s < 0 and window[0] < middle < window[1]:
                spans = [(0.12, window[2]), (window[3], None)]
            for low, top in spans:
                ends = high if top is None else (top, top)
                corners = [(a, low), (b, low), (b, ends[0]), (a, ends[1])]
                y0, y1 = sorted((s * half_y, s * (half_y + 0.02 + chance.about(0, 0.002))))
                walls.prism(corners, y0, y1, "xzy", 0.003, crease=30)
    step = 2.0 * half_y / 14
    for s in (-1.0, 1.0):
        for k in range(14):
            a, b = -half_y + step * k + 0.0015, -half_y + step * (k + 1) - 0.0015
            x0, x1 = sorted((s * half_x, s * (half_x + 0.02 + chance.about(0, 0.002))))
            _board(walls, chance, (x0, a, 0.12), (x1, b, eaves - 0.02), 0.003)
        for t in (-1.0, 1.0):
            corner = ((s * half_x, s * 0.012), (t * half_y, t * 0.012))
            low, high = ([at + r + out for at, out in corner] for r in (-0.055, 0.055))
            white.rounded_box((*low, 0.10), (*high, eaves), 0.006)
    front = -half_y
    boards = parts.part("door", "weathered_wood")
    for k in range(6):
        a = door[0] + 0.02 + (door[1] - door[0] - 0.04) * k / 6
        _board(boards, chance, (a, front - 0.022, 0.16), (a + 0.128, front, 1.84))
    for z in (0.42, 1.0, 1.58):
        low = (door[0] + 0.05, front - 0.045, z - 0.06)
        _board(boards, chance, low, (door[1] - 0.05, front - 0.022, z + 0.06))
    iron = parts.part("hinges", "iron")
    for z in (0.42, 1.58):
        low = (door[0] - 0.03, front - 0.052, z - 0.018)
        iron.rounded_box(low, (door[0] + 0.42, front - 0.044, z + 0.018), 0.003)
    handle = ((0.044, 0.93), (0.09, 0.95), (0.09, 1.07), (0.044, 1.09))
    iron.bent([(door[1] - 0.1, front - out, z) for out, z in handle], 0.01, 8)
    for x0, x1, z0, z1 in (
        (door[0] - 0.07, door[0], 0.12, 1.93),
        (door[1], door[1] + 0.07, 0.12, 1.93),
        (door[0], door[1], 1.86, 1.93),
    ):
        white.rounded_box((x0, front - 0.036, z0), (x1, front, z1), 0.005)
    a, b, low, top = window
    for x0, x1, z0, z1 in (
        (a - 0.05, a + 0.02, low - 0.05, top + 0.05), (b - 0.02, b + 0.05, low - 0.05, top + 0.05),
        (a, b, low - 0.07, low + 0.02), (a, b, top - 0.02, top + 0.05),
        ((a + b) / 2 - 0.014, (a + b) / 2 + 0.014, low, top),
        (a, b, (low + top) / 2 - 0.014, (low + top) / 2 + 0.014),
    ):  # fmt: skip
        white.rounded_box((x0, front - 0.036, z0), (x1, front + 0.01, z1), 0.004)
    parts.part("windows", "glass").rounded_box(
        (a, front - 0.008, low), (b, front + 0.004, top), 0.001
    )
    # Corrugated sheets with thickness, over each half.
    roof = parts.part("roof", "roof_steel")
    over, waves, per = 0.14, 26, 8
    y = np.linspace(-half_y - 0.16, half_y + 0.16, waves * per + 1)
    lift = 0.011 * np.sin(2.0 * math.pi * np.arange(len(y)) / per)
    for s in (-1.0, 1.0):
        rows, count = [], len(y)
        for x, z in ((s * (half_x + over), eaves - slope * over + 0.035), (0.0, ridge + 0.035)):
            sheet = np.column_stack([np.full(count, x), y, z + lift])
            rows.append(np.concatenate([sheet, sheet[::-1] - [0.0, 0.0, 0.006]]))
        caps = [
            t
            for j in range(count - 1)
            for t in ((j, j + 1, 2 * count - 2 - j), (j, 2 * count - 2 - j, 2 * count - 1 - j))
        ]
        roof.loft(rows, caps=caps, crease=60)
        for t in (-1.0, 1.0):
            at_y = t * (half_y + 0.13)
            x, z = s * (half_x + over), eaves - slope * over
            outline = [(x, z - 0.09), (x, z + 0.018), (0.0, ridge + 0.018), (0.0, ridge - 0.09)]
            y0, y1 = sorted((at_y, at_y + t * 0.022))
            white.prism(outline, y0, y1, "xzy")
    z = ridge - 0.16 * slope
    upper, lower = z + 0.055, z + 0.045
    ring = [(0.16, upper), (0.0, ridge + 0.062), (-0.16, upper), (-0.16, lower)]
    ring += [(0.0, ridge + 0.05), (0.16, lower)]
    roof.prism(ring, -half_y - 0.17, half_y + 0.17, "xzy")
    return parts.model()


def bench() -> Model:
    """A park bench, 1.6 m: slats of oiled wood on two frames of flat iron."""
    chance, parts = Chance("bench"), Assembly(LOOKS)
    slats, iron = parts.part("slats", "oiled_wood"), parts.part("frames", "iron")
    for k in range(5):
        y = -0.21 + 0.092 * k
        at = (0.0, 0.0, 0.445 - 0.006 * k + chance.about(0, 0.001))
        slats.rounded_box((-0.80, y - 0.039, -0.016), (0.80, y + 0.039, 0.016), 0.006, at)
    tilt = math.radians(14.0)
    back = np.array(
        [[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]]
    )
    for k in range(4):
        at = np.array([0.0, 0.225, 0.50]) + back[2] * (0.045 + 0.096 * k)
        slats.rounded_box((-0.80, -0.016, -0.040), (0.80, 0.016, 0.040), 0.006, at, back)
    for s in (-1.0, 1.0):
        x = s * 0.62
        leg = ((-0.27, 0.02), (-0.235, 0.20), (-0.235, 0.41), (-0.20, 0.425), (0.17, 0.403))
        _flat_bar(iron, [(x, *at) for at in (*leg, (0.235, 0.44), (0.36, 0.90))], 0.045, 0.014)
        _flat_bar(iron, [(x, 0.31, 0.02), (x, 0.20, 0.24), (x, 0.17, 0.40)], 0.045, 0.014)
        arm = ((-0.235, 0.40), (-0.24, 0.64), (-0.15, 0.665), (0.20, 0.645), (0.29, 0.64))
        _flat_bar(iron, [(x, *at) for at in arm], 0.045, 0.012)
        for y in (-0.27, 0.31):
            iron.rounded_box((x - 0.035, y - 0.045, 0.0), (x + 0.035, y + 0.045, 0.022), 0.005)
    iron.rod((-0.62, 0.18, 0.30), (0.62, 0.18, 0.30), 0.010, 10)
    return parts.model()


def _flat_bar(surface: Piece, path: Sequence[Sequence[float]], wide: float, thick: float) -> None:
    """A bar in a plane x = const, ``wide`` along x, bent along a path."""
    points = np.asarray(path, np.float64)
    smooth = [points[0]]
    for i in range(1, len(points) - 1):
        back, on = points[i - 1] - points[i], points[i + 1] - points[i]
        reach = min(
            0.035, 0.4 * float(np.sqrt((back**2).sum())), 0.4 * float(np.sqrt((on**2).sum()))
        )
        start, end = points[i] + unit(back) * reach, points[i] + unit(on) * reach
        smooth += [
            (1 - t) ** 2 * start + 2 * t * (1 - t) * points[i] + t * t * end
            for t in (0.0, 0.33, 0.67, 1.0)
        ]
    line = np.array([*smooth, points[-1]])
    ahead = unit(np.gradient(line, axis=0))
    normal = np.cross(ahead, np.array([1.0, 0.0, 0.0]))
    side = np.array([0.5 * wide, 0.0, 0.0])
    off = 0.5 * thick * normal
    corners = [line - side - off, line + side - off, line + side + off, line - side + off]
    surface.loft(np.stack(corners, axis=1), crease=45)


def hay_bale() -> Model:
    """A round bale of straw, 1.5 m high and 1.2 m wide, lying with its axis along x."""
    chance, parts = Chance("hay_bale"), Assembly(LOOKS)
    radius, half = 0.75, 0.60
    sides, rings = 72, 18
    profile: list[tuple[float, float]] = [(0.0, -half + 0.02)]
    profile += [(r, -half + 0.01 * math.sin(40 * r)) for r in np.linspace(0.08, radius - 0.10, 8)]
    profile += [(radius - 0.045, -half + 0.02), (radius - 0.012, -half + 0.06)]
    profile += [(radius, x) for x in np.linspace(-half + 0.11, half - 0.11, rings)]
    profile += [(r, -x) for r, x in profile[10:0:-1]]
    profile.append((0.0, half - 0.02))
    body = turned_shape(profile, sides, np.array([1.0, 0.0, 0.0]), (0.0, 0.0, radius))
    points = body.points.copy()
    for n, point in enumerate(points):
        r = math.hypot(point[1], point[2] - radius)
        rough = chance.about(0.0, 0.012)
        scale = 1.0 + (rough / r if r > 0.3 else 0.0)
        points[n, 1:] = (point[1:] - [0.0, radius]) * scale + [0.0, radius]
        points[n, 0] += chance.about(0.0, 0.008)
    # It has settled: flat where it lies.
    points[:, 2] = np.maximum(points[:, 2], 0.03 - 0.2 * np.minimum(0.0, points[:, 2] - 0.03))
    parts.part("bale", "straw").solid(outward(points, body.faces), crease=70)
    stalks = {name: parts.part(name, name) for name in ("straw_pale", "straw_shade")}
    axis = np.array([1.0, 0.0, 0.0])
    for k in range(2200):
        surface = stalks["straw_shade" if k % 5 < 2 else "straw_pale"]
        on_end = k % 3 == 0
        angle = chance.between(0.0, 360.0)
        out = turned(UP, axis, angle)
        around = np.cross(axis, out)
        if on_end:
            s = 1.0 if chance.between(0, 1) < 0.5 else -1.0
            r = radius * math.sqrt(chance.between(0.01, 0.92))
            base = np.array([s * (half + 0.002), 0.0, radius]) + out * r
            normal, ahead = s * axis, unit(around + 0.25 * out * chance.about(0, 1))
        else:
            base = np.array([chance.about(0.0, half - 0.04), 0.0, radius]) + out * (radius + 0.004)
            normal, ahead = out, unit(around + 0.35 * axis * chance.about(0, 1))
        if base[2] < 0.06:
            continue
        ahead = unit(ahead + normal * chance.between(0.0, 0.22))
        side = np.cross(normal, ahead) * chance.between(0.0035, 0.007)
        tip = base + ahead * chance.between(0.08, 0.26)
        normals = np.tile(unit(normal + 0.3 * chance.direction()), (3, 1))
        surface.add(np.array([base - side, base + side, tip]), [(0, 1, 2)], normals)
    return parts.model()


def boulder_wall() -> Model:
    """Three meters of a dry-stone wall with upright coping stones; copies 3 m apart go on."""
    chance, parts = Chance("boulder_wall"), Assembly(LOOKS)
    surfaces = parts.parts(
        stones="field_stone", lichen_stones="lichen_stone", dark_stones="dark_stone"
    )
    length, z = 3.0, 0.0
    parts.part("filling", "dark").rounded_box((-1.48, -0.16, 0.0), (1.48, 0.16, 0.82), 0.02)
    for height, depth, size in (
        (0.28, 0.58, 0.56), (0.24, 0.54, 0.46), (0.21, 0.48, 0.42), (0.19, 0.43, 0.38),
    ):  # fmt: skip
        for s in (-1.0, 1.0):
            x = -0.5 * length
            while x < 0.5 * length - 0.08:
                wide = min(size * chance.between(0.65, 1.4), 0.5 * length - x)
                if 0.5 * length - x - wide < 0.12:
                    wide = 0.5 * length - x
                tall = height * chance.between(0.92, 1.06)
                deep = 0.27 * depth + chance.about(0.0, 0.02)
                block = np.array([0.54 * wide, deep, 0.545 * tall])
                at = np.array([x + 0.5 * wide, s * 0.25 * depth, z + 0.5 * tall])
                chosen = surfaces[(0, 0, 0, 1, 2, 0)[int(chance.between(0, 5.99))]]
                chosen.solid(_field_stone(chance, block, at, 5.0), crease=52)
                x += wide
        z += height
    x = -0.5 * length
    while x < 0.5 * length - 0.04:
        wide = min(chance.between(0.10, 0.19), 0.5 * length - x)
        block = np.array([0.52 * wide, 0.21, chance.between(0.12, 0.15)])
        chosen = surfaces[int(chance.between(0, 2.99))]
        at = np.array([x + 0.5 * wide, chance.about(0, 0.015), z + 0.12])
        chosen.solid(_field_stone(chance, block, at, 9.0), crease=52)
        x += wide
    return parts.model()


_BALL = icosphere(2)


def _field_stone(chance: Chance, half: Floats, at: Floats, tilt: float) -> Solid:
    """A rounded block between a few planes: half its size along its axes, and its middle."""
    directions, faces = _BALL
    blocky = (np.abs(directions) ** 5.5).sum(axis=1) ** (-1.0 / 5.5)
    points = directions * blocky[:, None]
    for _ in range(11):
        normal = chance.direction()
        reach = chance.between(0.84, 1.2)
        over = np.maximum(0.0, points @ normal - reach)
        points = points - 0.92 * over[:, None] * normal
    for _ in range(5):
        wave = chance.direction() * chance.between(2.0, 5.0)
        points = points * (1.0 + 0.022 * np.sin(points @ wave + chance.between(0, 6.3)))[:, None]
    turn = np.eye(3)
    for axis in np.eye(3):
        degrees = chance.about(0.0, tilt)
        turn = np.array([turned(row, axis, degrees) for row in turn])
    return Solid(points * half, faces.astype(np.int64)).moved(at, turn)
