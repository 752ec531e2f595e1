"""Rounded rocks: cobbles of rivers, beaches, old ejecta."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.noise.lattice import subkey
from scenec.compiler.noise.perlin import fbm3, perlin3
from scenec.compiler.objects.families.shape import LEAST, block, octaves, smooth_max, unit_vectors
from scenec.schemas.kernels import kernel

_FLATS = 7


@dataclass(frozen=True)
class Rounded:
    """A superellipsoid with a few worn flats, lopsided, with fine pits.

    Attributes:
        key: Noise key.
        flat_normals, flat_distances: Unit normals [p, 3] and distances [p] of its flats.
        frame: Rows: the superellipsoid's own axes, float64 [3, 3].
        wear: 0 keeps the flats and a boxy body, 1 is an ellipsoid.
        bumpiness: How lopsided and pitted it is.
        axes, subdivisions: As of ``Shape``.
    """

    key: int
    flat_normals: NDArray[np.float64]
    flat_distances: NDArray[np.float64]
    frame: NDArray[np.float64]
    wear: float
    bumpiness: float
    axes: tuple[float, float, float]
    subdivisions: int
    fits_axes: bool = True

    def creases(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """None: it has no edges."""
        return np.zeros((0, 3)), np.zeros(0)

    def surface(
        self, directions: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As of ``Shape``."""
        return _surface(
            np.uint64(self.key),
            directions,
            self.flat_normals,
            self.flat_distances,
            self.frame,
            self.wear,
            self.bumpiness,
            octaves(0.9, spacing, 2),
            octaves(5.0, spacing, 3),
            octaves(11.0, spacing, 1),
        )


def draw_rounded(
    key: int,
    path: str,
    streams: Streams,
    wear: float,
    bumpiness: float,
    axes: tuple[float, float, float],
    subdivisions: int,
) -> Rounded:
    """Draws one."""
    u = streams.uniforms(f"{path}/flats", 3 * _FLATS).reshape(_FLATS, 3)
    turn = elementary.PI * streams.uniforms(f"{path}/frame", 1)
    c, s = elementary.cos_array(turn)[0], elementary.sin_array(turn)[0]
    return Rounded(
        key=key,
        flat_normals=unit_vectors(u[:, :2]),
        flat_distances=0.72 + 0.25 * u[:, 2],
        # Flat to the ground, like what water has laid down.
        frame=np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]),
        wear=wear,
        bumpiness=bumpiness,
        axes=axes,
        subdivisions=subdivisions,
    )


@kernel
def _surface(  # type: ignore[no-untyped-def]
    key, directions, normals, distances, frame, wear, bumpiness, waves, grains, pits
):
    radius = np.empty(len(directions))
    variation = np.empty(len(directions))
    wave_key, grain_key, pit_key, color_key = (
        subkey(key, 1),
        subkey(key, 2),
        subkey(key, 3),
        subkey(key, 4),
    )
    power = 2.05 + 1.5 * (1.0 - wear)
    width = 0.15 + 0.55 * wear
    for n in range(len(directions)):
        x, y, z = directions[n]
        total = 0.0
        for i in range(3):
            along = abs(frame[i, 0] * x + frame[i, 1] * y + frame[i, 2] * z)
            if along > 1e-9:
                total += elementary.pow(along, power)
        body = elementary.pow(total, 1.0 / power)
        flat, _plane, _gap = block(normals, distances, x, y, z, width)
        r = 1.0 / smooth_max(body, flat, width)
        bumps = 0.0
        if waves > 0:
            bumps += 0.6 * fbm3(wave_key, 0.9 * x, 0.9 * y, 0.9 * z, waves, 0.3)
        if grains > 0:
            bumps += 0.025 * fbm3(grain_key, 5.0 * x, 5.0 * y, 5.0 * z, grains, 0.5)
        if pits > 0:
            pit = perlin3(pit_key, 11.0 * x, 11.0 * y, 11.0 * z) - 0.25
            if pit > 0.0:
                bumps -= 0.12 * pit
        radius[n] = r * max(1.0 + bumpiness * bumps, LEAST)
        tone = 0.55 * fbm3(color_key, 1.9 * x, 1.9 * y, 1.9 * z, 5, 0.75)
        variation[n] = min(max(tone, -1.0), 1.0)
    return radius, variation
