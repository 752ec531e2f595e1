"""Targets for calibration: a board of AprilTags, a gray and a mirror sphere."""

from __future__ import annotations

import numpy as np

from scenec.lab.models.glb import Look, Model
from scenec.lab.models.solids import Assembly
from scenec.lab.models.surfaces import UP, Floats, azimuth

LOOKS = {
    "tag_black": Look((0.040, 0.040, 0.040), 0.80, specular=0.0),
    "tag_white": Look((0.860, 0.860, 0.860), 0.80, specular=0.0),
    "board_back": Look((0.500, 0.500, 0.500), 0.70),
    "aluminum": Look((0.580, 0.590, 0.600), 0.40, 1.0),
    "gray_18": Look((0.180, 0.180, 0.180), 1.00, specular=0.0),
    "mirror": Look((0.910, 0.920, 0.920), 0.02, 1.0),
    "plastic_black": Look((0.022, 0.022, 0.023), 0.55),
}

#: Codes of the tags 0 to 5 of the family tag36h11, and where its 36 bits stand, the highest first,
#: in cells from the border's upper left one (Olson, "AprilTag: A robust and flexible visual
#: fiducial system", ICRA 2011; the numbers are those of AprilTag 3, tag36h11.c).
TAG36H11 = (0xD7E00984B, 0xDDA664CA7, 0xDC4A1C821, 0xE17B470E9, 0xEF91D01B1, 0xF429CDD73)
_QUARTER = ((1, 1), (2, 1), (3, 1), (4, 1), (5, 1), (2, 2), (3, 2), (4, 2), (3, 3))
#: A cell, an eighth of a tag's black square; tags across and down.
CELL_M, COLUMNS, ROWS = 0.03, 3, 2
#: Height of the board's lower edge, and how far its pattern stands in front of the origin.
LIFT_M, FRONT_M = 0.45, 0.012


def tag(number: int) -> Floats:
    """The 8 by 8 cells of a tag as it is seen, the upper row first: 1 is white, 0 black."""
    cells = np.zeros((8, 8))
    x, y = (np.array(axis) for axis in zip(*_QUARTER, strict=True))
    for quarter in range(4):
        for i in range(9):
            cells[y[i], x[i]] = (TAG36H11[number] >> (35 - 9 * quarter - i)) & 1
        # Each quarter of the bits is the one before turned by 90 degrees, clockwise.
        x, y = 7 - y, x
    return cells


def apriltag_board() -> Model:
    """Six AprilTags of 240 mm (tag36h11, 0 to 5) on an upright board, cells as geometry."""
    parts = Assembly(LOOKS)
    # A tag has eight cells; three white ones stand between tags and around them.
    across, down = COLUMNS * 11 + 3, ROWS * 11 + 3
    cells = np.ones((down, across))
    for number in range(COLUMNS * ROWS):
        row, column = divmod(number, COLUMNS)
        cells[3 + 11 * row : 11 + 11 * row, 3 + 11 * column : 11 + 11 * column] = tag(number)
    width, height = across * CELL_M, down * CELL_M
    top = LIFT_M + height
    for name, material, value in (("black", "tag_black", 0.0), ("white", "tag_white", 1.0)):
        rows, columns = np.nonzero(cells == value)
        x = -0.5 * width + CELL_M * columns
        z = top - CELL_M * (rows + 1)
        corners = np.array([(0.0, 0.0), (CELL_M, 0.0), (CELL_M, CELL_M), (0.0, CELL_M)])
        points = np.zeros((len(rows), 4, 3))
        points[:, :, 0] = x[:, None] + corners[:, 0]
        points[:, :, 1] = -FRONT_M
        points[:, :, 2] = z[:, None] + corners[:, 1]
        first = 4 * np.arange(len(rows))[:, None, None]
        faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
        parts.part(name, material).add(
            points.reshape(-1, 3), faces, np.tile([0.0, -1.0, 0.0], (4 * len(rows), 1))
        )
    x = 0.5 * width
    parts.part("board", "board_back").rounded_box(
        (-x - 0.003, -FRONT_M + 0.001, LIFT_M - 0.003), (x + 0.003, FRONT_M, top + 0.003), 0.002
    )
    legs = parts.part("legs", "aluminum")
    for s in (-1.0, 1.0):
        at = s * 0.38
        legs.rounded_box((at - 0.02, FRONT_M, 0.0), (at + 0.02, FRONT_M + 0.04, top - 0.05), 0.003)
        legs.rod((at, 0.50, 0.015), (at, FRONT_M + 0.05, 0.90), 0.014, 12)
        legs.rounded_box((at - 0.04, 0.45, 0.0), (at + 0.04, 0.55, 0.012), 0.003)
        legs.rounded_box((at - 0.04, -0.06, 0.0), (at + 0.04, 0.11, 0.012), 0.003)
    legs.rounded_box((-0.38, FRONT_M + 0.04, 0.30), (0.38, FRONT_M + 0.06, 0.34), 0.003)
    return parts.model()


def _sphere(name: str, material: str) -> Model:
    """A sphere of 0.30 m whose middle is 1.20 m above the ground, on a tripod."""
    parts = Assembly(LOOKS)
    steps = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 33)
    profile = np.column_stack([0.15 * np.cos(steps), 0.15 * np.sin(steps)])
    profile[[0, -1], 0] = 0.0
    parts.part(name, material).turned(profile, 64, UP, (0, 0, 1.2), crease=80)
    stand = parts.part("stand", "plastic_black")
    stand.turned(
        [(0, 0.30), (0.016, 0.30), (0.016, 0.92), (0.012, 0.94), (0.012, 1.06), (0, 1.06)], 16
    )
    stand.turned([(0, 0.60), (0.03, 0.60), (0.034, 0.66), (0, 0.66)], 16)
    for angle in (90.0, 210.0, 330.0):
        out = azimuth(angle)
        stand.bent(
            [UP * 0.62 + out * 0.02, UP * 0.30 + out * 0.18, UP * 0.014 + out * 0.36], 0.011, 10
        )
        stand.turned([(0, 0), (0.022, 0.0), (0.018, 0.02), (0, 0.025)], 12, UP, out * 0.36)
    return parts.model()


def sphere_gray() -> Model:
    """A sphere of 0.30 m that reflects 18 % of the light, diffusely, on a tripod."""
    return _sphere("sphere", "gray_18")


def sphere_mirror() -> Model:
    """A mirror sphere of 0.30 m on a tripod."""
    return _sphere("sphere", "mirror")
