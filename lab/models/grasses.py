"""Grass tufts and herbs: blades, stalks, heads and petals, each a few triangles."""

from __future__ import annotations

import math

import numpy as np

from scenec.lab.models.glb import Look, Model
from scenec.lab.models.solids import Assembly
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

#: Leaves and blades by PROSPECT-D, as those of ``trees``; dead ones by it without their water.
LOOKS = {
    "grass_blade": Look((0.105, 0.215, 0.030), 0.55, through=0.60),
    "grass_pale": Look((0.165, 0.265, 0.050), 0.55, through=0.60),
    "straw": Look((0.420, 0.320, 0.140), 0.65, through=0.30),
    "seed_head": Look((0.300, 0.210, 0.110), 0.75),
    "herb_leaf": Look((0.075, 0.165, 0.025), 0.50, through=0.58),
    "clover_leaf": Look((0.080, 0.190, 0.030), 0.55, through=0.58),
    "stalk": Look((0.095, 0.155, 0.045), 0.55),
    "daisy_petal": Look((0.880, 0.870, 0.830), 0.60, through=0.40),
    "daisy_disc": Look((0.720, 0.420, 0.025), 0.75),
    "clover_floret": Look((0.640, 0.560, 0.520), 0.70),
    "poppy_petal": Look((0.720, 0.028, 0.014), 0.50, through=0.45),
    "poppy_heart": Look((0.018, 0.016, 0.018), 0.70),
    "poppy_leaf": Look((0.100, 0.185, 0.060), 0.60, through=0.55),
    "bleached": Look((0.500, 0.415, 0.260), 0.75, through=0.35),
    "fine_blade": Look((0.095, 0.180, 0.045), 0.55, through=0.60),
    "panicle": Look((0.230, 0.150, 0.120), 0.75),
    "fern_frond": Look((0.090, 0.180, 0.025), 0.55, through=0.58),
    "fern_stalk": Look((0.120, 0.110, 0.045), 0.60),
    "litter_brown": Look((0.245, 0.147, 0.076), 0.75, through=0.40),
    "litter_pale": Look((0.395, 0.270, 0.145), 0.75, through=0.40),
}


def _arc(base: Floats, ahead: Floats, length: float, bend: float, segments: int) -> Floats:
    """A path that turns downward by ``bend`` degrees, more and more toward its tip."""
    path = [base]
    for i in range(segments):
        share = (2 * i + 1) / (segments * segments)
        level = across(ahead, UP)
        ahead = turned(ahead, level, -bend * share)
        path.append(path[-1] + ahead * length / segments)
    return np.array(path)


def _along(path: Floats, t: float) -> tuple[Floats, Floats]:
    """A point of a path whose pieces are of one length, at a share of it, and the way on there."""
    x = t * (len(path) - 1)
    j = min(int(x), len(path) - 2)
    step = path[j + 1] - path[j]
    return path[j] + step * (x - j), unit(step)


def _tuft(
    chance: Chance, surfaces: list[Surface], count: int, height: tuple[float, float], *,
    radius: float, lean: tuple[float, float], bend: tuple[float, float], width: float,
    segments: int = 3,
) -> None:  # fmt: skip
    """Blades that rise from a disc, the outer ones leaning out; dealt among surfaces."""
    for k in range(count):
        base = chance.on_disc(radius)
        share = math.hypot(base[0], base[1]) / radius
        angle = math.degrees(math.atan2(base[1], base[0])) + chance.about(0.0, 120.0)
        out = lean[0] + (lean[1] - lean[0]) * share + chance.about(0.0, 6.0)
        ahead = azimuth(angle, 90.0 - out)
        length = chance.between(*height) * (1.0 - 0.15 * share)
        path = _arc(base, ahead, length, chance.between(*bend), segments)
        wide = width * chance.about(1.0, 0.25)
        profile = (0.75, 1.0, 0.72) if segments == 3 else (0.7, 1.0, 0.85, 0.5)
        # Blades are twisted: few show their face or their edge alone.
        side = turned(across(ahead), ahead, chance.about(0.0, 50.0))
        surfaces[k % len(surfaces)].blade(path, [wide * p for p in profile], unit(side))


def grass_short() -> Model:
    """A low, dense tuft as of fescue."""
    chance, parts = Chance("grass_short"), Assembly(LOOKS)
    green, dry = parts.parts(blades="grass_blade", dry_blades="straw")
    _tuft(chance, [green], 50, (0.07, 0.20), radius=0.14, lean=(4, 32), bend=(10, 75), width=0.0042)
    _tuft(chance, [dry], 7, (0.06, 0.13), radius=0.13, lean=(25, 60), bend=(30, 90), width=0.0036)
    return parts.model(grown=True)


def grass_tall() -> Model:
    """A tuft to the knee whose blades arch over, as of cocksfoot."""
    chance, parts = Chance("grass_tall"), Assembly(LOOKS)
    green, dry = parts.parts(blades="grass_pale", dry_blades="straw")
    _tuft(
        chance, [green], 36, (0.22, 0.58), radius=0.12, lean=(3, 26), bend=(25, 110),
        width=0.0068, segments=4,
    )  # fmt: skip
    _tuft(
        chance, [dry], 6, (0.15, 0.36), radius=0.12, lean=(25, 55), bend=(40, 120), width=0.005,
        segments=4,
    )  # fmt: skip
    return parts.model(grown=True)


def grass_seeding() -> Model:
    """A tuft in seed: culms to the hip with loose panicles over a low skirt of blades."""
    chance, parts = Chance("grass_seeding"), Assembly(LOOKS)
    green, culms, heads = parts.parts(blades="grass_blade", culms="straw", seed_heads="seed_head")
    _tuft(chance, [green], 18, (0.15, 0.42), radius=0.10, lean=(4, 30), bend=(20, 95), width=0.0055)
    for k in range(4):
        base = chance.on_disc(0.08)
        ahead = azimuth(90.0 * k + chance.about(0.0, 30.0), chance.between(76.0, 87.0))
        length = chance.between(0.62, 0.88)
        path = _arc(base, ahead, length, chance.between(10.0, 32.0), 4)
        culms.blade(path, [0.0032, 0.0028, 0.0024, 0.0018], across(ahead))
        for i in range(21):
            t = 0.76 + 0.24 * (i + 1) / 21
            point, along = _along(path, t)
            out = turned(across(along), along, 137.5 * i)
            reach = 0.040 * math.sin(math.pi * min(1.0, 1.08 - (t - 0.76) / 0.24) ** 0.8) + 0.004
            spray = unit(along + 0.55 * out)
            heads.leaf(
                point + reach * 0.35 * out, spray, out, chance.between(0.022, 0.032), 0.0075,
                fold=0.0,
            )  # fmt: skip
    return parts.model(grown=True)


def grass_dry() -> Model:
    """A tuft of last year: bleached blades that lean, break and lie, a few green ones between."""
    chance, parts = Chance("grass_dry"), Assembly(LOOKS)
    dead, green = parts.parts(dry_blades="bleached", blades="grass_blade")
    _tuft(
        chance, [dead], 34, (0.14, 0.46), radius=0.13, lean=(12, 46), bend=(25, 100), width=0.005,
        segments=4,
    )  # fmt: skip
    _tuft(chance, [green], 6, (0.12, 0.30), radius=0.1, lean=(3, 24), bend=(15, 70), width=0.0045)
    return parts.model(grown=True)


def grass_fine() -> Model:
    """A fine-leaved tuft in flower, as of bent: hair-thin culms under open purplish panicles."""
    chance, parts = Chance("grass_fine"), Assembly(LOOKS)
    green, culms, heads = parts.parts(blades="fine_blade", culms="straw", seed_heads="panicle")
    _tuft(chance, [green], 22, (0.10, 0.32), radius=0.09, lean=(3, 34), bend=(15, 80), width=0.0028)
    for k in range(6):
        ahead = azimuth(60.0 * k + chance.about(0.0, 25.0), chance.between(68.0, 86.0))
        length = chance.between(0.38, 0.62)
        path = _arc(chance.on_disc(0.06), ahead, length, chance.between(8.0, 30.0), 3)
        culms.blade(path, [0.0022, 0.0018, 0.0014], across(ahead))
        for i in range(9):
            t = 0.72 + 0.28 * (i + 1) / 9
            point, along = _along(path, t)
            out = turned(across(along), along, 137.5 * i)
            heads.leaf(
                point, unit(along + 0.9 * out), out, chance.between(0.02, 0.045) * (1.6 - t),
                0.006, fold=0.0,
            )  # fmt: skip
    return parts.model(grown=True)


def fern() -> Model:
    """A male fern: a funnel of arching fronds, each of many pinnae."""
    chance, parts = Chance("fern"), Assembly(LOOKS)
    pinnae, stalks = parts.parts(fronds="fern_frond", stalks="fern_stalk")
    for k in range(9):
        ahead = azimuth(40.0 * k + chance.about(0.0, 14.0), chance.between(52.0, 74.0))
        length = chance.between(0.5, 0.85)
        path = _arc(chance.on_disc(0.04), ahead, length, chance.between(45.0, 95.0), 6)
        side = across(ahead)
        stalks.blade(path, [0.007, 0.006, 0.005, 0.004, 0.003, 0.002], side)
        count = 14
        for i in range(count):
            t = 0.16 + 0.84 * (i + 0.5) / count
            point, along = _along(path, t)
            reach = 0.2 * length * math.sin(math.pi * min(1.0, 0.18 + 0.82 * t)) ** 0.8 + 0.01
            for s in (-1.0, 1.0):
                out = unit(0.45 * along + s * side - 0.18 * UP + 0.08 * chance.direction())
                pinnae.leaf(
                    point, out, cross(side, along), reach * chance.about(1.0, 0.1), 0.24 * reach,
                    fold=0.1, widest=0.25,
                )  # fmt: skip
    return parts.model(grown=True)


def litter() -> Model:
    """Fallen leaves and some dead twigs on half a square meter of ground."""
    chance, parts = Chance("litter"), Assembly(LOOKS)
    brown, pale, twigs = parts.parts(
        leaves="litter_brown", pale_leaves="litter_pale", twigs="fern_stalk"
    )
    for k in range(90):
        base = chance.on_disc(0.42) + UP * chance.between(0.004, 0.03)
        ahead = azimuth(chance.between(0.0, 360.0), chance.about(0.0, 22.0))
        upward = unit(UP + 0.45 * chance.direction())
        size = chance.between(0.05, 0.11)
        (brown if k % 3 else pale).leaf(
            base, ahead, upward, size, chance.between(0.5, 0.75) * size,
            fold=chance.about(0.1, 0.45),
        )  # fmt: skip
    for _ in range(7):
        base = chance.on_disc(0.4) + 0.008 * UP
        path = _arc(base, azimuth(chance.between(0, 360), 3.0), chance.between(0.1, 0.35), 6.0, 3)
        twigs.tube(path, [0.004, 0.0035, 0.003, 0.0], 3)
    return parts.model(grown=True)


def clover() -> Model:
    """White clover: leaves of three leaflets on stalks of their own, and globes of florets."""
    chance, parts = Chance("clover"), Assembly(LOOKS)
    leaves, stalks, florets = parts.parts(
        leaves="clover_leaf", stalks="stalk", flowers="clover_floret"
    )
    for _ in range(26):
        base = chance.on_disc(0.10)
        ahead = azimuth(chance.between(0.0, 360.0), chance.between(55.0, 88.0))
        path = _arc(base, ahead, chance.between(0.05, 0.13), chance.between(5.0, 40.0), 2)
        stalks.blade(path, [0.0022, 0.0016], across(ahead))
        tilt = unit(UP + 0.5 * (path[-1] - path[-2]) / 0.05 + 0.25 * chance.direction())
        start = turned(across(tilt), tilt, chance.between(0.0, 360.0))
        size = chance.between(0.014, 0.024)
        for j in range(3):
            out = turned(start, tilt, 120.0 * j)
            rise = unit(out + chance.between(0.0, 0.35) * tilt)
            _clover_leaflet(leaves, path[-1], rise, tilt, size)
    for k in range(4):
        base = chance.on_disc(0.07)
        ahead = azimuth(90.0 * k + chance.about(0, 30), chance.between(78.0, 88.0))
        path = _arc(base, ahead, chance.between(0.12, 0.17), 10.0, 2)
        stalks.blade(path, [0.0026, 0.0022], across(ahead))
        florets.spun(
            [(0.0, -0.004), (0.0085, -0.001), (0.0105, 0.005), (0.0075, 0.0115), (0.0, 0.014)],
            7, unit(path[-1] - path[-2]), path[-1],
        )  # fmt: skip
    return parts.model(grown=True)


def _clover_leaflet(
    surface: Surface, base: Floats, ahead: Floats, upward: Floats, size: float
) -> None:
    """Heart-shaped, widest near its notched end."""
    side = across(ahead, upward)
    outline = [(0.0, 0.0), (0.55, 0.42), (0.95, 0.36), (0.88, 0.0), (0.95, -0.36), (0.55, -0.42)]
    points = [base + size * (a * ahead + s * side + 0.25 * abs(s) * upward) for a, s in outline]
    surface.add(np.array(points), [(0, 1, 3), (1, 2, 3), (0, 3, 5), (3, 4, 5)], None)


def daisy() -> Model:
    """Oxeye daisy: heads of white rays around a yellow disc on leafy stalks."""
    chance, parts = Chance("daisy"), Assembly(LOOKS)
    rays, discs, stalks, leaves = parts.parts(
        rays="daisy_petal", discs="daisy_disc", stalks="stalk", leaves="herb_leaf"
    )
    for k in range(5):
        base = chance.on_disc(0.04)
        ahead = azimuth(72.0 * k + chance.about(0.0, 30.0), chance.between(70.0, 86.0))
        length = chance.between(0.30, 0.52)
        path = _arc(base, ahead, length, chance.between(-12.0, 22.0), 3)
        stalks.tube(path, [0.0016, 0.0014, 0.0012, 0.0012], 3)
        axis = unit(path[-1] - path[-2] + 0.3 * chance.direction())
        top, radius = path[-1], chance.between(0.0075, 0.0095)
        profile = [(radius, -0.001), (radius * 0.8, 0.0030), (0.0, 0.0045)]
        discs.spun(profile, 8, axis, top)
        start = across(axis)
        count = 17
        for j in range(count):
            out = turned(start, axis, 360.0 * j / count + chance.about(0.0, 4.0))
            droop = unit(out + chance.between(-0.25, 0.08) * axis)
            rays.leaf(
                top + 0.7 * radius * out, droop, axis, chance.between(0.019, 0.023), 0.0078,
                fold=-0.15, widest=0.62,
            )  # fmt: skip
        for j in range(4):
            point = path[0] + (path[-1] - path[0]) * (0.15 + 0.17 * j)
            out = azimuth(137.5 * j + 50.0 * k, 40.0)
            leaves.leaf(point, out, UP, 0.045 - 0.006 * j, 0.009, fold=0.2)
    for k in range(12):
        angle = 137.5 * k
        ahead = azimuth(angle, chance.between(15.0, 60.0))
        path = _arc(chance.on_disc(0.02), ahead, chance.between(0.07, 0.12), 55.0, 4)
        leaves.lamina(path, [0.006, 0.017, 0.020], across(ahead))
    return parts.model(grown=True)


def poppy() -> Model:
    """Common poppy: bowls of four crumpled petals, nodding buds, cut leaves."""
    chance, parts = Chance("poppy"), Assembly(LOOKS)
    petals, hearts, stalks, leaves = parts.parts(
        petals="poppy_petal", hearts="poppy_heart", stalks="stalk", leaves="poppy_leaf"
    )
    for k in range(4):
        ahead = azimuth(90.0 * k + chance.about(0.0, 30.0), chance.between(72.0, 86.0))
        path = _arc(chance.on_disc(0.03), ahead, chance.between(0.36, 0.58), chance.about(5, 15), 3)
        stalks.tube(path, [0.0019, 0.0016, 0.0013, 0.0012], 3)
        axis = unit(path[-1] - path[-2] + 0.35 * chance.direction())
        hearts.spun(
            [(0.004, -0.001), (0.006, 0.006), (0.0075, 0.010), (0.0, 0.012)], 7, axis, path[-1]
        )
        start = across(axis)
        for j in range(4):
            # The inner pair stands steeper than the outer.
            _poppy_petal(
                petals, chance, path[-1], axis, turned(start, axis, 90.0 * j), 0.2 + 0.25 * (j % 2)
            )
    for k in range(1):
        ahead = azimuth(180.0 * k + 30.0, 82.0)
        path = _arc(chance.on_disc(0.02), ahead, chance.between(0.28, 0.36), 15.0, 3)
        out = unit(across(ahead))
        nod = path[-1] + np.array([0.018 * out + 0.006 * UP, 0.026 * out - 0.012 * UP])
        path = np.concatenate([path, nod])
        stalks.tube(path, [0.0018, 0.0016, 0.0014, 0.0013, 0.0012, 0.0012], 3)
        leaves.spun(
            [(0.0, -0.002), (0.0055, 0.004), (0.006, 0.011), (0.0, 0.019)], 6, -UP, path[-1]
        )
    for k in range(7):
        high = k >= 5
        base = chance.on_disc(0.02) + UP * (chance.between(0.08, 0.22) if high else 0.0)
        ahead = azimuth(137.5 * k, chance.between(25.0, 60.0))
        length = chance.between(0.06, 0.09) if high else chance.between(0.10, 0.16)
        path = _arc(base, ahead, length, 60.0, 4)
        side = across(ahead)
        leaves.blade(path, [0.004, 0.006, 0.007, 0.005], side)
        for i in range(1, 4):
            for s in (-1.0, 1.0):
                along = unit(path[min(i + 1, 4)] - path[i - 1])
                lobe = unit(0.8 * along + s * side)
                point = path[i - 1] + (path[i] - path[i - 1]) * 0.6
                size = length * (0.34 - 0.05 * i + 0.04 * (i == 2))
                leaves.leaf(point, lobe, cross(side, along), size, 0.32 * size, fold=0.0)
    return parts.model(grown=True)


def _poppy_petal(
    surface: Surface, chance: Chance, base: Floats, axis: Floats, out: Floats, steep: float
) -> None:
    """A fan of three columns that opens from the base and curls at its rim."""
    side = cross(axis, out)
    size = chance.between(0.034, 0.042)
    points = [base]
    for reach, rise, spread in ((0.55, 0.55, 0.55), (1.0, 0.75, 0.85)):
        for j in range(5):
            s = (j - 2) / 2.0
            crumple = chance.about(0.0, 0.07)
            points.append(
                base
                + size * (reach * (1.0 - 0.22 * s * s) * out + spread * s * side)
                + size * (rise * (0.5 + steep) + 0.16 * s * s + crumple) * axis
            )
    faces = [(0, 1 + j, 2 + j) for j in range(4)]
    for j in range(4):
        a = 1 + j
        faces += [(a, a + 5, a + 6), (a, a + 6, a + 1)]
    surface.add(np.array(points), faces, None)
