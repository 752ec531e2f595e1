"""Vesicular rocks: basalt that bubbled, broken open and worn a little."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.streams import Streams
from scenec.compiler.noise.lattice import subkey
from scenec.compiler.noise.perlin import fbm3
from scenec.compiler.objects.families.shape import LEAST, block, octaves, unit_vectors
from scenec.schemas.kernels import kernel

_PLANES = 12
_BUBBLES = 260
_LARGEST = 0.17
_SMALLEST = 0.035


@dataclass(frozen=True)
class Vesicular:
    """A worn block from which balls are taken, their middles a little above the surface.

    Attributes:
        key: Noise key.
        plane_normals, plane_distances: Unit normals [p, 3] and distances [p] of its planes.
        bubbles: Unit directions, radii, and heights of the middles over the surface in parts of
            the radius, float64 [b, 5].
        wear: 0 is freshly broken, 1 has no edges left.
        bumpiness: Height of the roughness.
        axes, subdivisions: As of ``Shape``.
    """

    key: int
    plane_normals: NDArray[np.float64]
    plane_distances: NDArray[np.float64]
    bubbles: NDArray[np.float64]
    wear: float
    bumpiness: float
    axes: tuple[float, float, float]
    subdivisions: int
    fits_axes: bool = True

    def creases(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """None: its edges are worn."""
        return np.zeros((0, 3)), np.zeros(0)

    def surface(
        self, directions: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As of ``Shape``."""
        return _surface(
            np.uint64(self.key),
            directions,
            self.plane_normals,
            self.plane_distances,
            self.bubbles,
            0.05 + 0.55 * self.wear,
            self.bumpiness,
            spacing,
            octaves(1.5, spacing, 3),
            octaves(6.0, spacing, 4),
        )


def draw_vesicular(
    key: int,
    path: str,
    streams: Streams,
    wear: float,
    bumpiness: float,
    axes: tuple[float, float, float],
    subdivisions: int,
) -> Vesicular:
    """Draws one."""
    u = streams.uniforms(f"{path}/planes", 3 * _PLANES).reshape(_PLANES, 3)
    v = streams.uniforms(f"{path}/bubbles", 4 * _BUBBLES).reshape(_BUBBLES, 4)
    # Numbers fall with the size's square: as much of the surface to every size.
    steep = 1.0 / (_SMALLEST * _SMALLEST)
    flat = 1.0 / (_LARGEST * _LARGEST)
    size = 1.0 / np.sqrt(steep + v[:, 2] * (flat - steep))
    return Vesicular(
        key=key,
        plane_normals=unit_vectors(u[:, :2]),
        plane_distances=0.66 + 0.34 * u[:, 2],
        bubbles=np.concatenate(
            [unit_vectors(v[:, :2]), size[:, None], 0.15 + 0.55 * v[:, 3:]], axis=1
        ),
        wear=wear,
        bumpiness=bumpiness,
        axes=axes,
        subdivisions=subdivisions,
    )


@kernel
def _worn(  # type: ignore[no-untyped-def]
    key, normals, distances, x, y, z, width, bumpiness, waves, grains
):
    h, _plane, _gap = block(normals, distances, x, y, z, width)
    r = 1.0 / min(max(h, 0.8), 4.0)
    bumps = 0.0
    if waves > 0:
        bumps += 0.3 * fbm3(subkey(key, 1), 1.5 * x * r, 1.5 * y * r, 1.5 * z * r, waves, 0.5)
    if grains > 0:
        bumps += 0.09 * fbm3(subkey(key, 2), 6.0 * x * r, 6.0 * y * r, 6.0 * z * r, grains, 0.6)
    return r * max(1.0 + bumpiness * bumps, LEAST)


@kernel
def _surface(  # type: ignore[no-untyped-def]
    key, directions, normals, distances, bubbles, width, bumpiness, spacing, waves, grains
):
    radius = np.empty(len(directions))
    variation = np.empty(len(directions))
    color_key, zone_key = subkey(key, 3), subkey(key, 4)
    # Middles of the bubbles that this mesh can show.
    middles = np.empty((len(bubbles), 4))
    count = 0
    for b in range(len(bubbles)):
        x, y, z, size, up = bubbles[b]
        rich = fbm3(zone_key, 1.2 * x, 1.2 * y, 1.2 * z, 2, 0.5)
        # Bubbles crowd in some places and are rare in others.
        if size < 1.6 * spacing or rich < -0.15:
            continue
        # A bubble's rim must be in view from the center, or it would have a wall behind it.
        r = _worn(key, normals, distances, x, y, z, width, bumpiness, min(waves, 2), 0)
        away = r + size * max(up, 0.6 * size / r)
        middles[count] = x * away, y * away, z * away, size
        count += 1
    for n in range(len(directions)):
        x, y, z = directions[n]
        r = _worn(key, normals, distances, x, y, z, width, bumpiness, waves, grains)
        deepest = 0.0
        left = r
        for b in range(count):
            along = middles[b, 0] * x + middles[b, 1] * y + middles[b, 2] * z
            if along <= 0.0:
                continue
            away = (
                middles[b, 0] * middles[b, 0]
                + middles[b, 1] * middles[b, 1]
                + middles[b, 2] * middles[b, 2]
            )
            square = along * along - away + middles[b, 3] * middles[b, 3]
            if square > 0.0:
                near = along - np.sqrt(square)
                left = min(left, near)
                deepest = max(deepest, (r - near) / middles[b, 3])
        radius[n] = max(left, 0.5 * r)
        tone = 0.25 + 0.4 * fbm3(color_key, 2.3 * x, 2.3 * y, 2.3 * z, 4, 0.65)
        tone -= 0.9 * min(max(deepest, 0.0) * 1.5, 1.0)
        variation[n] = min(max(tone, -1.0), 1.0)
    return radius, variation
