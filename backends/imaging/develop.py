"""From numbers to a picture: white balance, demosaicing, color matrix, tone curve, 8 bits.

The tone curve is that of all pictures (``scenec.schemas.picture``), stretched so that the brightest
value becomes white.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.imaging.sensor import COLORS
from scenec.schemas.kernels import kernel
from scenec.schemas.picture import SHOULDER
from scenec.schemas.threads import over_threads

#: Bits of a float32 below those that name its step: 128 steps between powers of two. The tone
#: curve rises by less than 112 codes a factor of e, so no step has two edges between codes.
_STEP_BITS = 16

#: Weights of what a pixel and others of its color add to the mean of the nearest pixels of another
#: color. That is green of a red or blue pixel (itself; four two away); red or blue of a green pixel
#: beside two (itself; four diagonal, green; two away along them; two away across); red of blue and
#: blue of red (itself; four two away). Malvar, He and Cutler 2004 (ICASSP 3:485), figure 2.
_CORRECTIONS = {
    "malvar": (1 / 2, -1 / 8, 5 / 8, -1 / 8, -1 / 8, 1 / 16, 3 / 4, -3 / 16),
    "bilinear": (0.0,) * 8,
}
#: Pixels beyond each border that demosaicing looks at.
_BORDER = 2


@dataclass(frozen=True)
class Look:
    """Holds the factors and curves that turn numbers above black into displayed values.

    Attributes:
        balance: White balance: factors on red, green and blue numbers, float64 [3].
        most: Balanced numbers are clipped here, so that what is full is white.
        to_rec709: From those to values as shown, float64 [3, 3].
        white: Value that becomes white.
    """

    balance: NDArray[np.float64]
    most: float
    to_rec709: NDArray[np.float64]
    white: float


def develop(
    raw: NDArray[np.uint16], mosaic: str, method: str, black: int, look: Look
) -> NDArray[np.uint8]:
    """The 8-bit picture of a sensor's numbers.

    White balance comes first: the neighbors of one color that correct another's have to be on the
    same scale. Beyond its borders a picture goes on mirrored at its last pixels, which keeps the
    order of colors.

    Args:
        raw: [h, w, 1] behind a mosaic, at least 2 by 2; [h, w, 3] without.
        mosaic: A key of ``COLORS``, or "none".
        method: "malvar" or "bilinear"; not looked at without a mosaic.
        black: Number of no light.
        look: How they shall look.
    """
    if raw.shape[2] == 3:
        return develop_light(raw.astype(np.float32) - np.float32(black), look)
    out = np.empty((*raw.shape[:2], 3), np.uint8)
    red, green, blue = look.balance.tolist()
    padded = _balanced(raw[:, :, 0], mosaic, black, (red, green, blue))
    colors, corrections = _tables(mosaic, method)
    over_threads(_from_mosaic, len(out), padded, colors, corrections, _Display.of(look), out)
    return out


def develop_light(light: NDArray[np.float32], look: Look) -> NDArray[np.uint8]:
    """The same of numbers above black, whole or not, of all colors: float32 [h, w, 3]."""
    out = np.empty(light.shape, np.uint8)
    balance = look.balance.astype(np.float32)
    over_threads(_from_colors, len(light), light, balance, _Display.of(look), out)
    return out


class _Display(NamedTuple):
    """``Look``, once colors are balanced.

    Attributes:
        most: Where they are clipped, float32.
        matrix: From those to shares of what becomes white, float32 [3, 3].
        edges, starts: ``codes``.
    """

    most: np.float32
    matrix: NDArray[np.float32]
    edges: NDArray[np.float32]
    starts: NDArray[np.uint8]

    @classmethod
    def of(cls, look: Look) -> _Display:
        matrix = (look.to_rec709 / look.white).astype(np.float32)
        return cls(np.float32(look.most), matrix, *codes(look.white))


@lru_cache(maxsize=16)
def codes(white: float) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """The tone curve as a table.

    Args:
        white: Value that becomes white.

    Returns:
        Edges between the 256 codes, as shares of ``white``, float32 [256], the last one inf; and
        the code at the beginning of each step from the first edge's to that of 1 (``_step``).
    """
    # In decimals, whose exp and ln have the same digits everywhere.
    shoulder = Decimal(str(SHOULDER))
    rest, brightest = 1 - shoulder, Decimal(white)

    def toned(x: Decimal) -> Decimal:
        return x if x <= shoulder else 1 - rest * (-(x - shoulder) / rest).exp()

    edges = np.full(256, np.inf, np.float32)
    for code in range(255):
        encoded = (Decimal(code) + Decimal("0.5")) / 255
        if encoded <= Decimal("12.92") * Decimal("0.0031308"):
            linear = encoded / Decimal("12.92")
        else:
            linear = ((encoded + Decimal("0.055")) / Decimal("1.055")) ** Decimal("2.4")
        linear *= toned(brightest)
        if linear > shoulder:
            linear = shoulder - rest * ((1 - linear) / rest).ln()
        edges[code] = float(linear / brightest)
    ends = np.array([edges[0], 1.0], np.float32).view(np.int32) >> _STEP_BITS
    steps = (np.arange(ends[0], ends[1] + 1, dtype=np.int32) << _STEP_BITS).view(np.float32)
    starts = np.searchsorted(edges, steps, side="right").astype(np.uint8)
    # What is below the first step counts as in it.
    starts[0] = 0
    return edges, starts


def _tables(mosaic: str, method: str) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    colors = np.array(COLORS[mosaic], np.int64)
    return colors, np.array(_CORRECTIONS[method], np.float32)


def _balanced(
    raw: NDArray[np.uint16], mosaic: str, black: int, balance: tuple[float, float, float]
) -> NDArray[np.float32]:
    """Numbers above black, balanced, with two mirrored rows and columns on each side."""
    h, w = raw.shape
    factors = np.array(balance)[np.array(COLORS[mosaic])].astype(np.float32)
    out = np.empty((h + 2 * _BORDER, w + 2 * _BORDER), np.float32)
    over_threads(_balance, len(out), raw, np.float32(black), factors, out)
    return out


@kernel
def _mirror(i: int, n: int) -> int:
    """An index beyond an edge, mirrored at the last pixel: -1 is 1."""
    i = abs(i) % (2 * n - 2)
    return i if i < n else 2 * n - 2 - i


@kernel
def _balance(first, last, raw, black, factors, out):  # type: ignore[no-untyped-def]
    h, w = raw.shape
    for line in range(first, last):
        y = _mirror(line - 2, h)
        row = out[line]
        for i in range(2):
            factor = factors[y & 1, i]
            for x in range(i, w, 2):
                row[x + 2] = factor * (np.float32(raw[y, x]) - black)
        for x in range(-2, 0):
            row[x + 2] = row[_mirror(x, w) + 2]
            row[w + 1 - x] = row[_mirror(w - 1 - x, w) + 2]


@kernel
def _row_colors(m, y, i, colors, k, out):  # type: ignore[no-untyped-def]
    """All colors of every second pixel of a row, from column i; ``m`` has the borders."""
    w = m.shape[1] - 4
    own = colors[y & 1, i]
    uu, u, c, d, dd = m[y], m[y + 1], m[y + 2], m[y + 3], m[y + 4]
    half, quarter = np.float32(0.5), np.float32(0.25)
    if own == 1:
        along, across = colors[y & 1, 1 - i], colors[1 - (y & 1), i]
        for x in range(i, w, 2):
            itself = c[x + 2]
            diagonal = (u[x + 1] + u[x + 3]) + (d[x + 1] + d[x + 3])
            row, column = c[x] + c[x + 4], uu[x + 2] + dd[x + 2]
            same = k[2] * itself + k[3] * diagonal
            out[x, 1] = itself
            out[x, along] = half * (c[x + 1] + c[x + 3]) + same + k[4] * row + k[5] * column
            out[x, across] = half * (u[x + 2] + d[x + 2]) + same + k[4] * column + k[5] * row
    else:
        for x in range(i, w, 2):
            itself = c[x + 2]
            far = (c[x] + c[x + 4]) + (uu[x + 2] + dd[x + 2])
            cross = (c[x + 1] + c[x + 3]) + (u[x + 2] + d[x + 2])
            diagonal = (u[x + 1] + u[x + 3]) + (d[x + 1] + d[x + 3])
            out[x, own] = itself
            out[x, 1] = quarter * cross + k[0] * itself + k[1] * far
            out[x, 2 - own] = quarter * diagonal + k[6] * itself + k[7] * far


@kernel
def _show(row, display, out):  # type: ignore[no-untyped-def]
    """Codes, uint8 [w, 3], of a line of colors, float32 [w, 3], which are lost."""
    most, matrix, edges, starts = display.most, display.matrix, display.edges, display.starts
    for x in range(row.shape[0]):
        r, g, b = min(row[x, 0], most), min(row[x, 1], most), min(row[x, 2], most)
        for c in range(3):
            value = matrix[c, 0] * r + matrix[c, 1] * g + matrix[c, 2] * b
            row[x, c] = min(max(value, np.float32(0.0)), np.float32(1.0))
    bits, first = row.view(np.int32), edges.view(np.int32)[0] >> _STEP_BITS
    for x in range(row.shape[0]):
        for c in range(3):
            code = np.int64(starts[max((bits[x, c] >> _STEP_BITS) - first, 0)])
            out[x, c] = code + 1 if edges[code] <= row[x, c] else code


@kernel
def _from_mosaic(first, last, padded, colors, corrections, display, out):  # type: ignore[no-untyped-def]
    for line in range(first, last):
        row = np.empty((out.shape[1], 3), np.float32)
        for i in range(2):
            _row_colors(padded, line, i, colors, corrections, row)
        _show(row, display, out[line])


@kernel
def _from_colors(first, last, light, balance, display, out):  # type: ignore[no-untyped-def]
    for line in range(first, last):
        row = np.empty((light.shape[1], 3), np.float32)
        for x in range(light.shape[1]):
            for c in range(3):
                row[x, c] = balance[c] * light[line, x, c]
        _show(row, display, out[line])
