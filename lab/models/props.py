"""Objects with a purpose: a calibration board and a small lander."""

from __future__ import annotations

import io
import math

import numpy as np
from PIL import Image

from scenec.lab.models.glb import Look, Model, Part
from scenec.lab.models.solids import Assembly
from scenec.lab.models.surfaces import UP, Surface, across, azimuth, unit

#: The board: squares of 100 mm, ten by seven, with a white margin of 100 mm.
SQUARE_M, COLUMNS, ROWS, MARGIN_M = 0.1, 10, 7, 0.1
BOARD_M = (COLUMNS * SQUARE_M + 2 * MARGIN_M, ROWS * SQUARE_M + 2 * MARGIN_M)
#: Height of the board's lower edge, and how far its pattern stands in front of the origin.
LIFT_M, FRONT_M = 0.45, 0.012
_PIXELS = 80

_LANDER = {
    "foil": Look((0.75, 0.50, 0.16), 0.38, 1.0),
    "white_paint": Look((0.74, 0.74, 0.72), 0.55),
    "strut": Look((0.52, 0.53, 0.55), 0.35, 1.0),
    "dark_metal": Look((0.045, 0.045, 0.05), 0.55),
    "solar_cell": Look((0.012, 0.018, 0.060), 0.25),
    "pad": Look((0.30, 0.30, 0.31), 0.60, 1.0),
}


def calibration_board() -> Model:
    """A checkerboard of 9 by 6 inner corners, upright on two legs with struts behind."""
    width, height = BOARD_M
    x, low, high, y = 0.5 * width, LIFT_M, LIFT_M + height, -FRONT_M
    corners = np.array([[-x, y, low], [x, y, low], [x, y, high], [-x, y, high]])
    pattern = Part(
        corners,
        np.array([[0, 1, 2], [0, 2, 3]]),
        np.tile([0.0, -1.0, 0.0], (4, 1)),
        "checkerboard",
        np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]),
    )
    panel, legs = Surface(), Surface()
    panel.box((-x, y + 0.001, low), (x, FRONT_M, high))
    for s in (-1.0, 1.0):
        at = s * 0.40
        legs.box((at - 0.02, FRONT_M, 0.0), (at + 0.02, FRONT_M + 0.04, high - 0.05))
        top, foot = np.array([at, FRONT_M + 0.05, 0.95]), np.array([at, 0.55, 0.0])
        # The strut's lower end dips to the ground, no deeper.
        ahead = unit(top - foot)
        legs.tube(np.array([foot + ahead * 0.02, top]), [0.016, 0.016], 8, closed=True)
        legs.box((at - 0.04, 0.50, 0.0), (at + 0.04, 0.60, 0.008))
        legs.box((at - 0.04, FRONT_M - 0.05, 0.0), (at + 0.04, FRONT_M + 0.09, 0.008))
    legs.box((-0.40, FRONT_M + 0.04, 0.30), (0.40, FRONT_M + 0.06, 0.34))
    looks = {
        "checkerboard": Look((0.86, 0.86, 0.86), 0.80, picture=_checkerboard()),
        "board_back": Look((0.50, 0.50, 0.50), 0.70),
        "aluminum": Look((0.58, 0.59, 0.60), 0.40, 1.0),
    }
    parts = {"pattern": pattern, "board": panel.part("board_back"), "legs": legs.part("aluminum")}
    return Model(parts, looks)


def _checkerboard() -> bytes:
    """The pattern as a PNG, black squares not fully black; its upper left square is black."""
    picture = np.full((round(BOARD_M[1] / SQUARE_M), round(BOARD_M[0] / SQUARE_M)), 255, np.uint8)
    odd = (np.arange(ROWS)[:, None] + np.arange(COLUMNS)) % 2
    picture[1:-1, 1:-1] = np.where(odd == 1, 255, 48)
    out = io.BytesIO()
    large = np.kron(picture, np.ones((_PIXELS, _PIXELS), np.uint8))
    Image.fromarray(np.repeat(large[:, :, None], 3, axis=2)).save(out, "PNG", optimize=True)
    return out.getvalue()


def lander() -> Model:
    """A small probe on four legs: foil-covered body, dish, two solar panels, mast, engine."""
    parts = Assembly(_LANDER)
    body, deck, legs, feet = parts.parts(body="foil", deck="white_paint", legs="strut", feet="pad")
    dish, mast, panel, engine = parts.parts(
        dish="white_paint", mast="strut", panel="solar_cell", engine="dark_metal"
    )
    body.spun(
        [(0.0, 0.52), (0.50, 0.52), (0.60, 0.60), (0.60, 0.94), (0.52, 1.02), (0.0, 1.02)],
        8, smooth=False,
    )  # fmt: skip
    deck.spun([(0.47, 1.02), (0.47, 1.05), (0.0, 1.05)], 8, smooth=False)
    deck.box((-0.30, -0.16, 1.05), (-0.06, 0.16, 1.20))
    for angle in (22.5, 112.5, 202.5, 292.5):
        tank = azimuth(angle) * 0.46 + UP * 0.50
        rings = [(0.13 * math.cos(e), 0.13 * math.sin(e)) for e in np.radians(range(-60, 90, 30))]
        deck.spun([(0.0, -0.13), *rings, (0.0, 0.13)], 12, UP, tank)
    for k in range(4):
        out = azimuth(67.5 + 90.0 * k)
        side = across(out)
        ankle = out * 1.22 + UP * 0.10
        legs.tube(np.array([out * 0.55 + UP * 0.90, ankle]), [0.034, 0.026], 10, closed=True)
        for s in (-1.0, 1.0):
            hip = out * 0.50 + side * s * 0.24 + UP * 0.56
            legs.tube(np.array([hip, out * 1.0 + UP * 0.30]), [0.018, 0.018], 8, closed=True)
        feet.spun(
            [(0.0, 0.0), (0.11, 0.0), (0.17, 0.035), (0.165, 0.05), (0.05, 0.06), (0.0, 0.13)],
            16, UP, out * 1.22, smooth=False,
        )  # fmt: skip
    aim = azimuth(205.0, 38.0)
    hub = np.array([-0.18, -0.30, 1.52])
    depth = [(0.40 * r, 0.16 * r * r) for r in (0.0, 0.25, 0.5, 0.75, 1.0)]
    rim = [(0.40 * r, 0.16 * r * r - 0.012) for r in (1.0, 0.75, 0.5, 0.25, 0.0)]
    for profile in (rim[::-1], [rim[0], depth[-1]], depth[::-1]):
        dish.spun(profile, 28, aim, hub)
    dish.tube(np.array([hub, hub + aim * 0.26]), [0.012, 0.012], 8, closed=True)
    dish.spun([(0.0, 0.22), (0.035, 0.24), (0.035, 0.27), (0.0, 0.29)], 10, aim, hub)
    mast.tube(np.array([[-0.18, -0.30, 1.04], hub - aim * 0.02]), [0.025, 0.02], 10, closed=True)
    mast.tube(np.array([[0.22, 0.24, 1.04], [0.22, 0.24, 1.72]]), [0.022, 0.018], 10, closed=True)
    mast.box((0.12, 0.19, 1.72), (0.32, 0.29, 1.82))
    for s in (-1.0, 1.0):
        eye = [(0.028, -0.005), (0.028, 0.03), (0.0, 0.024)]
        engine.spun(
            eye, 12, np.array([0.0, -1.0, 0.0]), (0.22 + 0.06 * s, 0.19, 1.77), smooth=False
        )
        # Panels stand off the body, tilted to the sun.
        tilt = math.radians(18.0)
        frame = np.array(
            [[1, 0, 0], [0, math.cos(tilt), math.sin(tilt)], [0, -math.sin(tilt), math.cos(tilt)]]
        )
        center = np.array([s * 1.13, 0.0, 0.98])
        for column in range(3):
            for row in range(4):
                low = np.array([-0.42 + 0.283 * column, -0.46 + 0.232 * row])
                panel.box((*low, 0.014), (low[0] + 0.274, low[1] + 0.222, 0.018), frame, center)
        deck.box((-0.44, -0.48, 0.0), (0.44, 0.48, 0.014), frame, center)
        legs.tube(
            np.array([[s * 0.56, 0.0, 0.92], center - UP * 0.01]), [0.022, 0.022], 8, closed=True
        )
    engine.spun([(0.20, 0.26), (0.16, 0.36), (0.09, 0.46), (0.08, 0.53)], 20)
    engine.spun([(0.075, 0.53), (0.085, 0.46), (0.15, 0.36), (0.185, 0.262), (0.20, 0.26)], 20)
    return parts.model(grown=True)
