"""Shapes blocks of bedded rock: hard beds stand out, soft ones have weathered back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.noise.perlin import fbm3, perlin3
from scenec.compiler.objects.families.shape import Carved, Usual, block, rough, sampling
from scenec.schemas.kernels import kernel

_MOST_SIDES = 6
_BEDS = 9
_WIDEST = 0.45


class _BeddedNumbers(NamedTuple):
    """A bedded block.

    Attributes:
        normals, distances: Top, bottom, then the sides: unit normals [p, 3], distances [p].
        up: Unit normal of the bedding, float64 [3].
        bounds: Where one bed ends and the next begins along it, rising, float64 [b - 1].
        beds: Of each bed how far it stands back, its tone, how much its laminae show, and their
            slopes along x and y (cross-bedding), float64 [b, 5].
        width: Inverse radii over which the wear of an edge reaches.
    """

    normals: NDArray[np.float64]
    distances: NDArray[np.float64]
    up: NDArray[np.float64]
    bounds: NDArray[np.float64]
    beds: NDArray[np.float64]
    width: float


@kernel
def _at(keys, rock, fine, x, y, z):  # type: ignore[no-untyped-def]
    ends, _plane, _gap = block(rock.normals[:2], rock.distances[:2], x, y, z, 0.0)
    sides, _plane, _gap = block(rock.normals[2:], rock.distances[2:], x, y, z, 0.0)
    r = 1.0 / max(ends, sides)
    px, py, pz = r * x, r * y, r * z
    up, beds, bounds = rock.up, rock.beds, rock.bounds
    # Over which one bed passes into the next.
    ledge = max(0.04, 2.4 * fine.spacing)
    # Beds are a little wavy.
    height = up[0] * px + up[1] * py + up[2] * pz
    height += 0.03 * perlin3(keys[2], 1.4 * px, 1.4 * py, 1.4 * pz)
    bed, back, tone = 0, beds[0, 0], beds[0, 1]
    for k in range(len(bounds)):
        part = (height - bounds[k]) / ledge + 0.5
        if part <= 0.0:
            break
        part = min(part, 1.0)
        back += part * (beds[k + 1, 0] - beds[k, 0])
        tone += part * (beds[k + 1, 1] - beds[k, 1])
        if part > 0.5:
            bed = k + 1
    # Corners of some beds are rounder than those of others, and edges are chipped.
    width = rock.width * max(1.0 + 1.6 * fbm3(keys[1], 1.9 * x, 1.9 * y, 4.0 * z, 3, 0.75), 0.1)
    h, _plane, _gap = block(rock.normals, rock.distances, x, y, z, width)
    r = 1.0 / h
    # What faces along the bedding shows one bed only, and keeps its place.
    side = min(max((sides - ends) / 0.2, 0.0), 1.0)
    crumbled = max(
        1.0 + 1.1 * fbm3(keys[2], 2.6 * px, 2.6 * py, 2.6 * pz + 7.0 * bed, 3, 0.65), 0.0
    )
    bumps = 0.0
    if fine.waves > 0:
        bumps += (0.05 + 0.13 * side) * fbm3(keys[3], 1.3 * px, 1.3 * py, 1.3 * pz, fine.waves, 0.5)
    if fine.grains > 0:
        bumps += 0.05 * fbm3(keys[4], 5.0 * px, 5.0 * py, 5.0 * pz, fine.grains, 0.55)
    if fine.marks > 0:
        # Laminae of a bed are parallel to it, or cut across it where dunes and ripples went.
        across = height + beds[bed, 3] * px + beds[bed, 4] * py
        line = fbm3(keys[5], 0.5 * px, 0.5 * py, 9.0 * across + 13.0 * bed, fine.marks, 0.7)
        bumps += 0.13 * side * beds[bed, 2] * line
        tone += 0.5 * beds[bed, 2] * line
    tone += 0.35 * fbm3(keys[0], 1.9 * px, 1.9 * py, 1.9 * pz, 4, 0.65)
    return r * (1.0 - side * back * crumbled) * rough(fine.bumpiness, bumps), tone


class BeddedRock(Carved[_BeddedNumbers]):
    """A block between joints whose sides stand back bed by bed, with laminae in each bed."""

    sample = sampling(_at)
    noises = ((1.3, 3), (5.0, 4), (9.0, 2))
    USUAL = Usual(0.25, 0.45, 0.35)
    LIES = True

    def creases(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the planes that meet at creases."""
        return self.drawn.normals, self.drawn.distances

    @staticmethod
    def draw(path: str, streams: Streams, wear: float) -> _BeddedNumbers:
        """Draws the parameters of a rock."""
        count, first, dip, toward = streams.uniforms(f"{path}/joints", 4)
        sides = 4 + int(count * (_MOST_SIDES - 3))
        u = streams.uniforms(f"{path}/sides", 3 * _MOST_SIDES).reshape(_MOST_SIDES, 3)[:sides]
        bearing = 2.0 * elementary.PI * (first + (np.arange(sides) + 0.6 * (u[:, 0] - 0.5)) / sides)
        c, s = elementary.cos_array(bearing), elementary.sin_array(bearing)
        ends = 0.3 * (streams.uniforms(f"{path}/ends", 4) - 0.5)
        normals = np.concatenate([
            [[ends[0], ends[1], 1.0], [ends[2], ends[3], -1.0]],
            np.stack([c, s, 0.5 * (u[:, 1] - 0.4)], axis=1),
        ])  # fmt: skip
        normals /= np.sqrt((normals * normals).sum(axis=1))[:, None]
        # Most blocks lie on their bedding, more or less.
        angle = 2.0 * elementary.PI * toward
        lean = 0.35 * dip * dip
        up = np.array([lean * elementary.cos(angle), lean * elementary.sin(angle), 1.0])
        up /= np.sqrt((up * up).sum())
        w = streams.uniforms(f"{path}/beds", 6 * _BEDS).reshape(_BEDS, 6)
        # Many thin beds, a few thick ones; most differ little, some soft ones far.
        thick = np.cumsum(0.12 + 1.9 * w[:, 0] * w[:, 0] * w[:, 0])
        # Blocks end where hard beds do.
        soft = np.concatenate([[0.3 * w[0, 1]], w[1:-1, 1], [0.3 * w[-1, 1]]])
        cross = np.where(w[:, 3] < 0.4, 1.2, 0.0)
        return _BeddedNumbers(
            normals=normals,
            distances=np.concatenate([[0.66, 0.66], 0.76 + 0.24 * u[:, 2]]),
            up=up,
            bounds=0.72 * (2.0 * thick[:-1] / thick[-1] - 1.0),
            beds=np.stack(
                [
                    0.22 * soft * soft * soft,
                    1.1 * w[:, 2] - 0.55,
                    0.3 + 0.7 * soft,
                    cross * (w[:, 4] - 0.5),
                    cross * (w[:, 5] - 0.5),
                ],
                axis=1,
            ),
            width=wear * _WIDEST,
        )
