"""Vehicles: a car, a tractor, a rover. Each faces -y; its left side is +x."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from scenec.lab.models.glb import Look, Model
from scenec.lab.models.solids import Assembly, Piece, arc, creased, loft, soft_hull, soft_polygon
from scenec.lab.models.surfaces import UP, Floats, azimuth, turned, unit

LOOKS = {
    "paint_blue": Look((0.030, 0.085, 0.235), 0.22),
    "paint_red": Look((0.360, 0.022, 0.014), 0.35),
    "paint_white": Look((0.740, 0.740, 0.720), 0.45),
    "plastic_black": Look((0.022, 0.022, 0.023), 0.55),
    "glass": Look((0.012, 0.014, 0.016), 0.06),
    "lamp_clear": Look((0.620, 0.630, 0.640), 0.12),
    "lamp_red": Look((0.330, 0.008, 0.008), 0.15),
    "lamp_amber": Look((0.600, 0.180, 0.010), 0.15),
    "rubber": Look((0.036, 0.036, 0.037), 0.85),
    "alloy": Look((0.560, 0.570, 0.580), 0.32, 1.0),
    "steel_dark": Look((0.060, 0.060, 0.063), 0.60),
    "rim_ochre": Look((0.560, 0.330, 0.060), 0.45),
    "plate": Look((0.720, 0.720, 0.700), 0.50),
    "aluminum": Look((0.580, 0.590, 0.600), 0.40, 1.0),
    "gold_foil": Look((0.750, 0.500, 0.160), 0.38, 1.0),
    "lens": Look((0.010, 0.010, 0.014), 0.08),
}

_LEFT = np.array([1.0, 0.0, 0.0])


def _wheel(
    tire: Piece, rim: Piece, center: Sequence[float], radius: float, width: float,
    share: float, spokes: int,
) -> None:  # fmt: skip
    """A wheel about a crosswise axis; its outer face is on the side where it stands."""
    at = np.asarray(center, np.float64)
    axis = _LEFT if at[0] > 0.0 else -_LEFT
    r, h, inner = radius, 0.5 * width, share * radius
    soft = 0.16 * width
    tread = [(r, -h + 1.6 * soft), (r, h - 1.6 * soft)]
    shoulder = [
        (r - 0.35 * soft, h - 0.5 * soft),
        (r - 1.4 * soft, h),
        (inner + 0.01, h - 0.3 * soft),
    ]
    ring = [*tread, *shoulder, (inner - 0.012, h - soft)]
    profile = [*ring, *((a, -b) for a, b in ring[:1:-1])]
    tire.turned(profile, 40, axis, at)
    lip = [
        (inner, h - 0.02), (inner - 0.018, h - 0.012), (inner - 0.03, h - 0.035),
        (inner - 0.03, -h + 0.03),
    ]  # fmt: skip
    rim.turned([*lip, (inner, -h + 0.03)], 40, axis, at, crease=30)
    hub = [(0.2 * inner, h - 0.03), (0.24 * inner, h - 0.05), (0.24 * inner, -0.3 * h)]
    rim.turned([(0, h - 0.03), *hub, (0, -0.3 * h)], 20, axis, at)
    if not spokes:
        dish = [
            (0, 0.2 * h), (0.35 * inner, 0.2 * h), (0.62 * inner, 0.55 * h),
            (0.8 * inner, 0.5 * h), (inner - 0.02, 0.1 * h), (inner - 0.02, 0.0), (0, 0.0),
        ]  # fmt: skip
        rim.turned(dish, 40, axis, at, crease=45)
        for k in range(8):
            bolt = at + 0.3 * inner * turned(UP, axis, 45.0 * k) + axis * 0.2 * h
            rim.rod(bolt, bolt + axis * 0.02, 0.014, 6)
    for k in range(spokes):
        out = turned(UP, axis, 360.0 * k / spokes)
        side = np.cross(axis, out)
        sections = []
        for reach, wide, front, deep in (
            (0.16, 0.13, -0.040, 0.05),
            (0.55, 0.085, -0.034, 0.04),
            (0.95, 0.12, -0.024, 0.035),
        ):
            middle = at + out * reach * inner + axis * (h + front)
            half = side * wide * inner
            back = middle - axis * deep
            sections.append([middle - half, middle + half, back + 0.8 * half, back - 0.8 * half])
        rim.loft(sections, crease=25)


#: Curves of the car over its length, rear to front: at (x), heights of the middle of the top, of
#: the belt line and of the lower edge, half widths at the belt line and at the roof's edge.
_CAR = np.array(
    [
        (-2.150, 0.700, 0.640, 0.480, 0.640, 0.560), (-2.125, 0.880, 0.800, 0.360, 0.760, 0.660),
        (-2.060, 0.985, 0.900, 0.290, 0.825, 0.715), (-1.960, 1.035, 0.945, 0.250, 0.855, 0.730),
        (-1.750, 1.190, 0.965, 0.225, 0.873, 0.665), (-1.520, 1.365, 0.965, 0.220, 0.882, 0.590),
        (-1.250, 1.435, 0.958, 0.220, 0.886, 0.580), (-0.700, 1.475, 0.942, 0.220, 0.888, 0.588),
        (-0.200, 1.482, 0.928, 0.220, 0.888, 0.592), (0.200, 1.458, 0.918, 0.220, 0.888, 0.586),
        (0.420, 1.405, 0.912, 0.220, 0.888, 0.582), (0.760, 1.220, 0.902, 0.220, 0.887, 0.652),
        (1.120, 1.000, 0.890, 0.220, 0.886, 0.745), (1.300, 0.965, 0.878, 0.220, 0.884, 0.765),
        (1.650, 0.915, 0.835, 0.220, 0.872, 0.752), (1.900, 0.850, 0.770, 0.222, 0.832, 0.700),
        (2.040, 0.775, 0.695, 0.240, 0.765, 0.625), (2.115, 0.690, 0.625, 0.300, 0.660, 0.520),
        (2.150, 0.590, 0.550, 0.400, 0.520, 0.400),
    ]
)  # fmt: skip
_AXLES, _ARCH_M, _TIRE_M = (1.320, -1.290), 0.372, 0.318


def _car_section(x: float) -> Floats:
    """Half of a cross-section, from the lower edge to the roof's middle: (across, up) [13, 2]."""
    top, belt, low, wide, roof = (float(np.interp(x, _CAR[:, 0], c)) for c in _CAR[:, 1:].T)
    for axle in _AXLES:
        reach = _ARCH_M**2 - (x - axle) ** 2
        if reach > 0.0:
            low = max(low, _TIRE_M + math.sqrt(reach))
    bulge = [0.0, 0.008, 0.012, 0.004]
    rows = [(wide - 0.045, low), (wide - 0.012, low + 0.02 * min(1.0, (belt - low) / 0.3))]
    start = rows[1][1]
    rows += [(wide + bulge[k], start + t * (belt - start)) for k, t in enumerate((0.25, 0.5, 0.78))]
    rows += [(wide - 0.006, belt)]
    crown = 0.10 * min(1.0, 2.0 * (top - belt)) * roof
    edge = top - crown
    shelf = (wide - 0.03, belt + 0.25 * min(0.08, edge - belt))
    span = np.array([roof, edge]) - np.array(shelf)
    rows += [shelf, *(tuple(np.array(shelf) + t * span) for t in (0.07, 0.91, 1.0))]
    rows += [(0.93 * roof, edge + 0.30 * crown), (0.60 * roof, edge + 0.78 * crown), (0.0, top)]
    return np.array(rows)


#: What is not body: its part, rows from below, between which places along it.
_CAR_PARTS: tuple[tuple[str, tuple[int, ...], float, float], ...] = (
    ("trim", (-1, 0), -9.0, 9.0), ("headlamps", (4,), 1.76, 2.08),
    ("tail_lamps", (3, 4), -2.13, -1.99), ("trim", (1, 2), 2.06, 9.0),
    ("trim", (1, 2, 3, 4), 0.945, 0.953), ("trim", (1, 2, 3, 4), -0.300, -0.292),
    ("trim", (1, 2, 3, 4), -0.905, -0.897), ("trim", (6,), -1.46, 0.90),
    ("windows", (7,), -1.44, -0.34), ("windows", (7,), -0.25, 0.88), ("trim", (7,), -0.34, -0.25),
    ("windows", (10, 11), 0.44, 1.06), ("windows", (10, 11), -1.93, -1.56),
    ("trim", (10, 11), 1.06, 1.12),
)  # fmt: skip


def _car_part(x: float, row: int) -> str:
    """Which part a face of the car's skin belongs to: by place along it and row, from below."""
    for name, rows, low, high in _CAR_PARTS:
        if row in rows and low < x < high:
            return name
    return "body"


def car() -> Model:
    """A compact car of five doors."""
    edges = [
        0.945, 0.953, -0.300, -0.292, -0.905, -0.897, 1.76, 2.08, -2.135, -1.99, 2.06, -1.46, 0.90,
    ]  # fmt: skip
    edges += [-1.44, -0.34, -0.25, 0.88, 0.44, 1.06, -1.93, -1.56]
    for axle in _AXLES:
        for angle in np.linspace(0.0, 180.0, 15):
            edges.append(axle + _ARCH_M * math.cos(math.radians(angle)))
        edges += [axle - _ARCH_M + 0.004, axle + _ARCH_M - 0.004]
    stations = np.unique(np.round([*_CAR[:, 0], *edges, *np.arange(-2.0, 2.0, 0.16)], 3))
    keep = np.append(True, np.diff(stations) > 0.0035)
    stations = stations[keep]
    sections = []
    for x in stations:
        half = _car_section(float(x))
        left = np.column_stack([half[:, 0], np.full(len(half), -x), half[:, 1]])
        right = left[-2::-1] * np.array([-1.0, 1.0, 1.0])
        under = np.array([[0.0, -x, half[0, 1]]])
        sections.append(np.concatenate([left, right, under]))
    skin = np.array(sections)
    solid = loft(skin)
    around = skin.shape[1]
    parts = Assembly(LOOKS)
    materials = {
        "body": "paint_blue", "windows": "glass", "trim": "plastic_black",
        "headlamps": "lamp_clear", "tail_lamps": "lamp_red",
    }  # fmt: skip
    owner = []
    for middle in (0.5 * (stations[:-1] + stations[1:])).tolist():
        for j in range(around):
            row = j if j < 12 else 23 - j if j < 24 else -1
            owner += [_car_part(middle, row)] * 2
    owner += ["trim"] * (2 * around)
    points, faces, normals = creased(solid.points, solid.faces, 33.0)
    names = np.array(owner)
    for name, material in materials.items():
        chosen = faces[names == name]
        used, rows = np.unique(chosen, return_inverse=True)
        parts.part(name, material).add(points[used], rows.reshape(-1, 3), normals[used])
    tires, rims = parts.part("tires", "rubber"), parts.part("rims", "alloy")
    trim, body = parts.part("trim", "plastic_black"), parts.part("body", "paint_blue")
    for axle in _AXLES:
        for s in (-1.0, 1.0):
            center = (s * 0.785, -axle, _TIRE_M)
            _wheel(tires, rims, center, _TIRE_M, 0.205, 0.68, 7)
            disc = [(0, -0.03), (0.15, -0.03), (0.15, -0.01), (0, -0.01)]
            trim.turned(disc, 24, s * _LEFT, center)
        trim.rod((-0.7, -axle, _TIRE_M), (0.7, -axle, _TIRE_M), 0.05)
    for s in (-1.0, 1.0):
        # Door mirrors on the front ends of the windows, and handles.
        body.rounded_box(
            (-0.085, -0.055, -0.06), (0.085, 0.055, 0.065), 0.035, at=(s * 0.985, -0.80, 1.0)
        )
        trim.rounded_box(
            (-0.08, 0.050, -0.05), (0.08, 0.060, 0.05), 0.004, at=(s * 0.985, -0.80, 1.0)
        )
        trim.rod((s * 0.86, -0.80, 0.95), (s * 0.95, -0.80, 0.985), 0.022, 8)
        for x in (-0.06, -0.74):
            trim.rounded_box(
                (-0.018, -0.085, -0.014), (0.018, 0.085, 0.014), 0.008, at=(s * 0.893, -x, 0.80)
            )
        wiper = [(s * 0.10 - 0.06, -1.10, 1.018), (s * 0.24 - 0.24, -0.78, 1.242)]
        trim.rod(wiper[0], wiper[1], 0.010, 6)
    plates = parts.part("plates", "plate")
    plates.rounded_box((-0.26, -2.170, 0.42), (0.26, -2.140, 0.53), 0.006)
    plates.rounded_box((-0.26, 2.128, 0.66), (0.26, 2.162, 0.77), 0.006)
    return parts.model()


def tractor() -> Model:
    """A farm tractor with a closed cab."""
    parts = Assembly(LOOKS)
    paint, trim = parts.part("body", "paint_red"), parts.part("frame", "steel_dark")
    tires, rims = parts.part("tires", "rubber"), parts.part("rims", "rim_ochre")
    # Axles: rear at y = 1.05, front at y = -1.25.
    for y, radius, width, out, share in (
        (1.05, 0.80, 0.46, 0.76, 0.54),
        (-1.25, 0.52, 0.32, 0.72, 0.56),
    ):
        for s in (-1.0, 1.0):
            center = np.array([s * out, y, radius])
            _wheel(tires, rims, center, radius - 0.035, width, share, 0)
            _lugs(tires, center, radius, width, 20 if radius > 0.6 else 16)
        trim.rod((-out, y, radius), (out, y, radius), 0.10 if y > 0 else 0.07, 16)
    # Hood: sections from the cab to the nose.
    hood = [
        (-0.15, 0.36, 0.88, 1.52, 0.12), (-0.90, 0.355, 0.88, 1.49, 0.12),
        (-1.55, 0.34, 0.88, 1.43, 0.13), (-1.85, 0.32, 0.88, 1.36, 0.14),
        (-1.93, 0.29, 0.91, 1.28, 0.13), (-1.96, 0.24, 0.96, 1.20, 0.10),
    ]  # fmt: skip
    paint.loft(soft_hull(hood, 6))
    grille = parts.part("grille", "plastic_black")
    grille.rounded_box((-0.20, -1.985, 0.93), (0.20, -1.94, 1.20), 0.02)
    for s in (-1.0, 1.0):
        grille.rounded_box((s * 0.355 - 0.012, -1.60, 0.98), (s * 0.355 + 0.012, -0.55, 1.26), 0.01)
    lamps = parts.part("lamps", "lamp_clear")
    for s in (-1.0, 1.0):
        lamps.rounded_box((s * 0.15 - 0.07, -1.985, 1.21), (s * 0.15 + 0.07, -1.93, 1.28), 0.015)
    # Engine and gearbox below, front axle's block, ballast.
    trim.rounded_box((-0.26, -1.60, 0.52), (0.26, 0.9, 0.92), 0.05)
    trim.rounded_box((-0.20, -1.45, 0.42), (0.20, -1.05, 0.62), 0.04)
    for k in range(6):
        x = -0.30 + 0.12 * k
        trim.rounded_box((x - 0.052, -2.25, 0.62), (x + 0.052, -1.95, 0.93), 0.03)
    # Fenders over the rear wheels.
    for s in (-1.0, 1.0):
        outer = arc((1.05, 0.80), 0.93, 12, 150, 16)
        inner = arc((1.05, 0.80), 0.88, 150, 12, 16)
        low, high = sorted((s * 0.52, s * 1.02))
        paint.prism([*outer, *inner], low, high, "yzx", crease=30)
    # Cab: floor, four pillars that lean in, panes, roof.
    trim.rounded_box((-0.62, -0.15, 0.86), (0.62, 1.30, 1.02), 0.03)
    paint.rounded_box((-0.60, 0.95, 1.0), (0.60, 1.42, 1.34), 0.06)
    low_ring = np.array([(-0.66, -0.12), (0.66, -0.12), (0.70, 1.36), (-0.70, 1.36)])
    top_ring = np.array([(-0.58, 0.02), (0.58, 0.02), (0.60, 1.30), (-0.60, 1.30)])
    for (ax, ay), (bx, by) in zip(low_ring, top_ring, strict=True):
        trim.bent([(ax, ay, 1.0), (bx, by, 2.42)], 0.045, 8)
    rings = ((low_ring, 1.02), (top_ring, 2.40))
    glass = [np.column_stack([ring * 0.985, np.full(4, z)]) for ring, z in rings]
    parts.part("windows", "glass").loft(glass, crease=10)
    for (ax, ay), (bx, by) in zip(low_ring, np.roll(low_ring, -1, axis=0), strict=True):
        trim.rod((ax, ay, 1.02), (bx, by, 1.02), 0.035, 8)
    for s in (-1.0, 1.0):
        trim.bent([(s * 0.685, 0.62, 1.02), (s * 0.60, 0.66, 2.40)], 0.03, 8)
    sections = []
    for z, grow in ((2.40, -0.02), (2.44, 0.05), (2.52, 0.06), (2.58, 0.02), (2.61, -0.10)):
        half = 0.62 + grow
        low, high = -0.10 - grow, 1.36 + grow
        ring = soft_polygon([(-half, low), (half, low), (half, high), (-half, high)], 0.16, 5)
        sections.append(np.column_stack([ring, np.full(len(ring), z)]))
    parts.part("roof", "paint_white").loft(sections, crease=50)
    for s in (-1.0, 1.0):
        lamps.rounded_box((s * 0.46 - 0.08, -0.185, 2.44), (s * 0.46 + 0.08, -0.13, 2.52), 0.012)
        parts.part("tail_lamps", "lamp_red").rounded_box(
            (s * 0.86 - 0.07, 1.84, 1.10), (s * 0.86 + 0.07, 1.88, 1.18), 0.01
        )
        # Steps and mirrors.
        for z in (0.44, 0.68):
            trim.rounded_box((s * 0.62 - 0.14, 0.02, z), (s * 0.62 + 0.14, 0.22, z + 0.03), 0.01)
        trim.rounded_box((s * 0.74 - 0.012, 0.03, 0.40), (s * 0.74 + 0.012, 0.07, 1.0), 0.008)
        trim.bent([(s * 0.62, -0.05, 1.95), (s * 0.95, -0.16, 2.0)], 0.014, 6)
        trim.rounded_box((s * 0.98 - 0.09, -0.20, 1.83), (s * 0.98 + 0.09, -0.15, 2.12), 0.02)
    pipe = [(0.40, -0.42, 1.20), (0.44, -0.42, 1.30), (0.44, -0.42, 2.30), (0.46, -0.36, 2.42)]
    trim.bent(pipe, [0.05, 0.05, 0.05, 0.045], 14)
    trim.turned([(0, 0.0), (0.085, 0.02), (0.085, 0.55), (0, 0.58)], 16, UP, (0.44, -0.42, 1.42))
    # Linkage.
    for s in (-1.0, 1.0):
        arm = [(s * 0.28, 1.35, 0.70), (s * 0.40, 1.95, 0.52), (s * 0.42, 2.12, 0.50)]
        trim.bent(arm, [0.035, 0.03, 0.045], 8)
    trim.rod((0, 1.30, 0.95), (0, 1.95, 0.85), 0.03, 8)
    return parts.model()


def _lugs(surface: Piece, center: Floats, radius: float, width: float, count: int) -> None:
    """Bars of a farm tire, two rows that point backward below and meet as a chevron."""
    axis = np.array([1.0, 0.0, 0.0])
    for k in range(count):
        for s in (-1.0, 1.0):
            angle = 360.0 * (k + 0.25 * (s + 1.0)) / count
            out = turned(UP, axis, angle)
            ahead = np.cross(axis, out)
            # The bar runs outward and round the wheel.
            along = unit(s * axis + 0.75 * ahead)
            across_ = np.cross(out, along)
            frame = np.array([along, across_, out])
            middle = center + s * 0.235 * width * axis + 0.235 * width * 0.75 * ahead
            length = 0.31 * width * 1.25
            # Lower at its outer end, as the tread is.
            tread = radius - 0.05
            tip = tread - float(np.sqrt(max(0.0, tread**2 - (0.5 * width) ** 2)))
            sections = []
            for t, drop in ((-1.0, 0.0), (1.0, 0.25 * tip + 0.010)):
                high, low, half = radius - drop, radius - 0.075 - drop, 0.024
                corners = ((-1.5 * half, low), (1.5 * half, low), (half, high), (-half, high))
                sections.append(np.array([[t * length, *corner] for corner in corners]) @ frame)
            # The frame's third axis passes through the wheel's middle, not through the bar's.
            shift = middle - center
            surface.loft(sections + center + shift, crease=20)


def rover() -> Model:
    """A planetary rover: six wheels on a rocker-bogie suspension, mast, arm, power source."""
    parts = Assembly(LOOKS)
    white, metal = parts.part("body", "paint_white"), parts.part("suspension", "aluminum")
    dark, wheels = parts.part("instruments", "steel_dark"), parts.part("wheels", "aluminum")
    white.rounded_box((-0.60, -0.75, 0.66), (0.60, 0.75, 1.04), 0.035)
    white.rounded_box((-0.66, -0.82, 1.04), (0.66, 0.82, 1.075), 0.012)
    parts.part("belly", "gold_foil").rounded_box((-0.52, -0.66, 0.60), (0.52, 0.66, 0.67), 0.02)
    for x, y, w, d, h in (
        (-0.35, 0.45, 0.22, 0.16, 0.12), (0.30, 0.30, 0.18, 0.26, 0.09),
        (0.38, -0.45, 0.12, 0.12, 0.16), (-0.1, 0.0, 0.14, 0.10, 0.05),
    ):  # fmt: skip
        white.rounded_box((x - w, y - d, 1.07), (x + w, y + d, 1.075 + h), 0.02)
    r = 0.255
    places = [(s, y) for s in (-1.0, 1.0) for y in (-1.08, 0.02, 1.06)]
    for s, y in places:
        center = np.array([s * 1.12, y, r])
        axis = s * _LEFT
        rim = [
            (r - 0.012, -0.19), (r - 0.004, -0.12), (r, 0.0), (r - 0.004, 0.12), (r - 0.012, 0.19),
        ]  # fmt: skip
        inside = [(a - 0.012, b) for a, b in rim[::-1]]
        wheels.turned([*rim, *inside], 48, axis, center, crease=50)
        for k in range(24):
            out = turned(UP, axis, 15.0 * k)
            frame = np.array([axis, np.cross(out, axis), out])
            wheels.box((-0.185, -0.006, r - 0.014), (0.185, 0.006, r + 0.008), frame, center)
        for k in range(6):
            out = turned(UP, axis, 60.0 * k)
            knee = center + axis * 0.06 + out * 0.13
            path = [center + axis * 0.03, knee, center - axis * 0.02 + out * (r - 0.01)]
            wheels.bent(path, [0.016, 0.013, 0.012], 6)
        dark.turned(
            [(0, -0.19), (0.07, -0.19), (0.085, -0.02), (0.06, 0.06), (0, 0.07)], 20, axis, center
        )
        # Steering actuators above the outer wheels.
        inner = np.array([s * 0.90, y, r])
        metal.rod(center, inner, 0.035)
        knee = np.array([s * 0.90, y, 0.62 if abs(y) > 0.5 else r])
        if abs(y) > 0.5:
            metal.rod(inner, knee, 0.035)
            dark.rod(knee - UP * 0.06, knee + UP * 0.06, 0.06, 16)
    for s in (-1.0, 1.0):
        pivot, bogie = np.array([s * 0.78, -0.18, 0.86]), np.array([s * 0.90, 0.54, 0.58])
        metal.bent([pivot, (s * 0.88, -0.62, 0.80), (s * 0.90, -1.08, 0.66)], 0.042)
        metal.bent([pivot, (s * 0.88, 0.20, 0.74), bogie], 0.042)
        metal.bent([bogie, (s * 0.90, 0.30, 0.46), (s * 0.90, 0.02, r)], 0.036)
        metal.bent([bogie, (s * 0.90, 0.80, 0.62), (s * 0.90, 1.06, 0.66)], 0.036)
        dark.rod((s * 0.58, -0.18, 0.86), (s * 0.86, -0.18, 0.86), 0.085, 20)
        dark.rod(bogie - s * 0.06 * _LEFT, bogie + s * 0.06 * _LEFT, 0.06, 16)
    # Mast with its head, at the front right; the eyes look ahead.
    mast = np.array([-0.42, -0.55, 1.05])
    column = [(0.09, 0), (0.085, 0.14), (0.055, 0.18), (0.05, 0.84), (0.075, 0.86), (0.075, 0.95)]
    white.turned([(0, 0), *column, (0, 0.95)], 20, UP, mast)
    head = mast + np.array([0, 0, 1.06])
    white.rounded_box((-0.21, -0.10, -0.10), (0.21, 0.12, 0.13), 0.025, head)
    lens, ahead = parts.part("lenses", "lens"), np.array([0, -1.0, 0])
    for x, z, size in (
        (-0.15, -0.03, 0.022), (0.15, -0.03, 0.022), (-0.07, -0.03, 0.030), (0.07, -0.03, 0.030),
        (0.0, 0.06, 0.055),
    ):  # fmt: skip
        barrel = [(0, 0), (size * 1.3, 0), (size * 1.3, 0.035), (size, 0.04), (0, 0.03)]
        dark.turned(barrel, 20, ahead, head + np.array([x, -0.095, z]))
        eye = [(0, 0), (size * 0.9, 0), (size * 0.6, 0.008), (0, 0.011)]
        lens.turned(eye, 16, ahead, head + np.array([x, -0.131, z]))
    # Antennas.
    disc = [(0, 0), (0.03, 0), (0.03, 0.30), (0.12, 0.32), (0.12, 0.36), (0, 0.36)]
    white.turned(disc, 24, UP, (0.42, 0.42, 1.07))
    aim = azimuth(250.0, 40.0)
    dark.rod((0.46, -0.10, 1.07), (0.46, -0.10, 1.26), 0.025)
    hexagon = [(0, 0.0), (0.17, 0.0), (0.17, 0.025), (0, 0.025)]
    white.turned(hexagon, 6, aim, (0.46, -0.10, 1.30))
    # Power source at the rear, with fins.
    tail = unit(np.array([0.0, 0.86, 0.5]))
    foot = np.array([0.0, 0.70, 0.90])
    dark.turned([(0, 0), (0.15, 0.0), (0.15, 0.58), (0.12, 0.62), (0, 0.62)], 24, tail, foot)
    for k in range(8):
        out = turned(np.cross(tail, _LEFT), tail, 45.0 * k)
        frame = np.array([np.cross(out, tail), out, tail])
        dark.rounded_box((-0.006, 0.14, 0.06), (0.006, 0.29, 0.56), 0.003, foot, frame)
    # Arm, folded before the body, with its turret.
    metal.rod((0.38, -0.78, 0.86), (0.38, -0.96, 0.86), 0.075, 18)
    elbow, wrist = np.array([-0.42, -1.02, 0.92]), np.array([0.30, -1.16, 0.72])
    metal.bent([(0.38, -0.92, 0.86), elbow], 0.05, 14)
    metal.bent([elbow, wrist], 0.042, 14)
    dark.rod(elbow - UP * 0.09, elbow + UP * 0.09, 0.075, 18)
    dark.rod(wrist - UP * 0.14, wrist + UP * 0.12, 0.11, 20)
    for k in range(4):
        out = azimuth(200.0 + 80.0 * k)
        dark.rod(wrist, wrist + out * 0.20, 0.05, 14)
    # Hazard cameras.
    for s in (-1.0, 1.0):
        dark.rounded_box((s * 0.16 - 0.04, -0.80, 0.78), (s * 0.16 + 0.04, -0.74, 0.86), 0.01)
        glass = [(0, 0), (0.02, 0), (0.012, 0.006), (0, 0.008)]
        lens.turned(glass, 12, ahead, (s * 0.16, -0.80, 0.82))
    return parts.model()
