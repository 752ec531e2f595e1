"""Shapes rounded rocks: cobbles of rivers, beaches, old ejecta."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.noise.perlin import fbm3, perlin3
from scenec.compiler.objects.families.shape import (
    Carved,
    Usual,
    block,
    rough,
    sampling,
    smooth_max,
    unit_vectors,
)
from scenec.schemas.kernels import kernel

_FLATS = 7


class _RoundedNumbers(NamedTuple):
    """A cobble.

    Attributes:
        normals, distances: Unit normals [p, 3] and distances [p] of its flats.
        frame: Rows: the superellipsoid's own axes, float64 [3, 3].
        wear: 0 keeps the flats and a boxy body, 1 is an ellipsoid.
    """

    normals: NDArray[np.float64]
    distances: NDArray[np.float64]
    frame: NDArray[np.float64]
    wear: float


@kernel
def _at(keys, rock, fine, x, y, z):  # type: ignore[no-untyped-def]
    power = 2.05 + 1.5 * (1.0 - rock.wear)
    width = 0.15 + 0.55 * rock.wear
    frame = rock.frame
    total = 0.0
    for i in range(3):
        along = abs(frame[i, 0] * x + frame[i, 1] * y + frame[i, 2] * z)
        if along > 1e-9:
            total += elementary.pow(along, power)
    body = elementary.pow(total, 1.0 / power)
    flat, _plane, _gap = block(rock.normals, rock.distances, x, y, z, width)
    r = 1.0 / smooth_max(body, flat, width)
    bumps = 0.0
    if fine.waves > 0:
        bumps += 0.6 * fbm3(keys[1], 0.9 * x, 0.9 * y, 0.9 * z, fine.waves, 0.3)
    if fine.grains > 0:
        bumps += 0.025 * fbm3(keys[2], 5.0 * x, 5.0 * y, 5.0 * z, fine.grains, 0.5)
    if fine.marks > 0:
        pit = perlin3(keys[3], 11.0 * x, 11.0 * y, 11.0 * z) - 0.25
        if pit > 0.0:
            bumps -= 0.12 * pit
    tone = 0.55 * fbm3(keys[4], 1.9 * x, 1.9 * y, 1.9 * z, 5, 0.75)
    return r * rough(fine.bumpiness, bumps), tone


class RoundedRock(Carved[_RoundedNumbers]):
    """A superellipsoid with a few worn flats; bumpiness makes it lopsided, and pits it."""

    sample = sampling(_at)
    noises = ((0.9, 2), (5.0, 3), (11.0, 1))
    USUAL = Usual(0.22, 0.45, 0.7)

    @staticmethod
    def draw(path: str, streams: Streams, wear: float) -> _RoundedNumbers:
        """Draws the parameters of a rock."""
        u = streams.uniforms(f"{path}/flats", 3 * _FLATS).reshape(_FLATS, 3)
        turn = elementary.PI * streams.uniforms(f"{path}/frame", 1)
        c, s = elementary.cos_array(turn)[0], elementary.sin_array(turn)[0]
        return _RoundedNumbers(
            normals=unit_vectors(u[:, :2]),
            distances=0.72 + 0.25 * u[:, 2],
            # Flat to the ground, like what water has laid down.
            frame=np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]),
            wear=wear,
        )
