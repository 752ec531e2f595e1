"""Shapes breccia: broken pieces of rock in a finer matrix, which weathers back around them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.streams import Streams
from scenec.compiler.noise.perlin import fbm3, perlin3
from scenec.compiler.objects.families.shape import (
    Carved,
    Fine,
    Usual,
    ball_along,
    block,
    rough,
    sampling,
    unit_vectors,
)
from scenec.schemas.kernels import kernel

_PLANES = 13
_CLASTS = 150
_FACES = 7
_LARGEST = 0.36
_SMALLEST = 0.05


class _BrecciaNumbers(NamedTuple):
    """A block of breccia.

    Attributes:
        normals, distances: Unit normals [p, 3] and distances [p] of its planes.
        clasts: Unit directions, radii, depths of the middles below the surface in radii, how far
            each stands out of the matrix (0 to 1), and tones, float64 [c, 7].
        faces, reaches: Normals of each clast's faces, [c, f, 3], and their distances from its
            middle, [c, f] in its radii.
        width: Inverse radii over which the wear of an edge reaches.
    """

    normals: NDArray[np.float64]
    distances: NDArray[np.float64]
    clasts: NDArray[np.float64]
    faces: NDArray[np.float64]
    reaches: NDArray[np.float64]
    width: float


@kernel
def _at(keys, rock, fine, x, y, z):  # type: ignore[no-untyped-def]
    h, _plane, _gap = block(rock.normals, rock.distances, x, y, z, rock.width)
    whole = 1.0 / min(max(h, 0.8), 4.0)
    px, py, pz = whole * x, whole * y, whole * z
    bumps = 0.0
    if fine.waves > 0:
        bumps += 0.3 * fbm3(keys[1], 1.4 * px, 1.4 * py, 1.4 * pz, fine.waves, 0.5)
    whole *= rough(fine.bumpiness, bumps)
    # The matrix has gone from between the clasts, here more, there less.
    gone = 0.28 * (1.0 + 0.8 * perlin3(keys[2], 1.7 * x, 1.7 * y, 1.7 * z))
    grain = 0.0
    if fine.grains > 0:
        grain = fbm3(keys[3], 6.0 * px, 6.0 * py, 6.0 * pz, fine.grains, 0.6)
    matrix = whole * rough(fine.bumpiness, 0.1 * grain - 0.4 * gone)
    r, tone = matrix, -0.35 + 0.5 * grain
    for c in range(len(rock.clasts)):
        cx, cy, cz, size, deep, out, own = rock.clasts[c]
        away = whole - size * deep
        cx, cy, cz = away * cx, away * cy, away * cz
        along, square = ball_along(x, y, z, cx, cy, cz, size)
        if along <= 0.0 or square <= 0.0:
            continue
        # Where the ray enters and leaves the clast.
        enters, leaves = 0.0, 1e9
        for f in range(_FACES):
            nx, ny, nz = rock.faces[c, f]
            reach = nx * cx + ny * cy + nz * cz + size * rock.reaches[c, f]
            facing = nx * x + ny * y + nz * z
            if facing > 1e-9:
                leaves = min(leaves, reach / facing)
            elif facing < -1e-9:
                enters = max(enters, reach / facing)
        if leaves <= max(enters, matrix):
            continue
        top = min(leaves, matrix + (0.2 + 0.8 * out * out) * (whole * 1.01 - matrix))
        if top > r:
            r = top
            tone = own + 0.3 * grain
    tone += 0.3 * fbm3(keys[4], 2.3 * px, 2.3 * py, 2.3 * pz, 3, 0.6)
    return r, tone


class BrecciaRock(Carved[_BrecciaNumbers]):
    """A worn block of matrix with angular clasts, flush with what the block once was."""

    sample = sampling(_at)
    noises = ((1.4, 3), (6.0, 4))
    USUAL = Usual(0.22, 0.4, 0.4)

    def for_mesh(self, fine: Fine) -> _BrecciaNumbers:
        """Returns the parameters for a mesh, with the clasts that it can show."""
        rock = self.drawn
        shown = rock.clasts[:, 3] >= 1.6 * fine.spacing
        return rock._replace(
            clasts=rock.clasts[shown], faces=rock.faces[shown], reaches=rock.reaches[shown]
        )

    @staticmethod
    def draw(path: str, streams: Streams, wear: float) -> _BrecciaNumbers:
        """Draws the parameters of a rock."""
        u = streams.uniforms(f"{path}/planes", 3 * _PLANES).reshape(_PLANES, 3)
        v = streams.uniforms(f"{path}/clasts", 6 * _CLASTS).reshape(_CLASTS, 6)
        w = streams.uniforms(f"{path}/faces", 3 * _FACES * _CLASTS).reshape(-1, 3)
        # Numbers fall with the size: a few large ones have most of the surface.
        size = 1.0 / (1.0 / _SMALLEST + v[:, 2] * (1.0 / _LARGEST - 1.0 / _SMALLEST))
        # Most are paler than the matrix, some darker.
        tone = np.where(v[:, 5] < 0.7, 0.15 + 0.9 * v[:, 5], -2.6 * (v[:, 5] - 0.68))
        deep = 0.1 + 0.5 * v[:, 3]
        return _BrecciaNumbers(
            normals=unit_vectors(u[:, :2]),
            distances=0.66 + 0.34 * u[:, 2],
            clasts=np.concatenate(
                [unit_vectors(v[:, :2]), np.stack([size, deep, v[:, 4], tone], axis=1)], axis=1
            ),
            faces=unit_vectors(w[:, :2]).reshape(_CLASTS, _FACES, 3),
            reaches=(0.5 + 0.4 * w[:, 2]).reshape(_CLASTS, _FACES),
            width=0.05 + 0.55 * wear,
        )
