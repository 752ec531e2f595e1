"""Shapes weathered rocks: worn blocks of basalt or granite between joints and fractures."""

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
    bowl,
    bowls,
    rough,
    sampling,
    smooth_max,
    unit_vectors,
)
from scenec.schemas.kernels import kernel

_FRACTURES = 6
#: Inverse radii over which edges are rounded, of rocks of wear 0 and what wear 1 adds.
_NARROWEST, _WIDEST = 0.06, 0.5
#: Inverse radius beyond which corners have gone.
_FARTHEST = 0.82
_SPALLS = 7


class _WeatheredNumbers(NamedTuple):
    """A weathered rock.

    Attributes:
        normals, distances: Unit normals [p, 3] and distances [p] of joints and fractures.
        scars: Unit directions of spalls, radii and depths of the balls that they have left,
            float64 [s, 5]; as the kernel takes them the centers and radii of balls [s, 4].
        width: Inverse radii over which edges are rounded.
    """

    normals: NDArray[np.float64]
    distances: NDArray[np.float64]
    scars: NDArray[np.float64]
    width: float


@kernel
def _at(keys, rock, fine, x, y, z):  # type: ignore[no-untyped-def]
    # Some edges have lost more than others.
    patch = fbm3(keys[0], 1.6 * x, 1.6 * y, 1.6 * z, 2, 0.6)
    width = max(rock.width + min(2.0 * rock.width, 0.4) * patch, 0.25 * rock.width)
    top, h = 0.0, _FARTHEST
    for p in range(len(rock.distances)):
        normal = rock.normals[p]
        inverse = (normal[0] * x + normal[1] * y + normal[2] * z) / rock.distances[p]
        top = max(top, inverse)
        # One after the other: the sum of parabolas has no crease anywhere.
        h = smooth_max(h, inverse, width)
    # 0 on faces, 1 along edges.
    edge = min(3.0 * (h - top) / width, 1.0)
    tone = 0.12 * edge
    for s in range(len(rock.scars)):
        near = bowl(rock.scars[s], x, y, z, h)
        if near > 0.0:
            tone += 0.35 * min(max(near - h, 0.0) / 0.06, 1.0)
            h = smooth_max(h, near, 0.05)
    r = 1.0 / h
    px, py, pz = r * x, r * y, r * z
    bumps = 0.0
    if fine.waves > 0:
        bumps += 0.16 * fbm3(keys[2], 1.3 * px, 1.3 * py, 1.3 * pz, fine.waves, 0.5)
    if fine.grains > 0:
        grain = fbm3(keys[3], 5.0 * px, 5.0 * py, 5.0 * pz, fine.grains, 0.55)
        bumps += (0.05 + 0.04 * edge) * grain
    if fine.marks > 0 and patch > -0.05:
        # Pits, where the patches are.
        pit = perlin3(keys[4], 10.0 * px, 10.0 * py, 10.0 * pz) - 0.3
        if pit > 0.0:
            deep = pit * min((patch + 0.05) / 0.15, 1.0)
            bumps -= 0.25 * deep
            tone -= deep
    tone += 0.4 * fbm3(keys[1], 2.3 * px, 2.3 * py, 2.3 * pz, 3, 0.65)
    return r * rough(fine.bumpiness, bumps), tone


class WeatheredRock(Carved[_WeatheredNumbers]):
    """A convex block, its edges rounded unevenly, with spalls and patches of pits.

    The finest relief has waves of a twentieth of a radius, whatever the mesh: what is finer is for
    the surface. Faces have less of it than edges.
    """

    sample = sampling(_at)
    noises = ((1.3, 2), (5.0, 3), (10.0, 1))
    #: Its wear is what angularity leaves.
    USUAL = Usual(0.18, 0.4, 0.4)
    READS = "angularity"

    def creases(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the planes that meet at creases."""
        return self.drawn.normals, self.drawn.distances

    def for_mesh(self, fine: Fine) -> _WeatheredNumbers:
        """Returns the parameters for a mesh, with scars as balls."""
        rock = self.drawn
        return rock._replace(scars=bowls(rock.normals, rock.distances, rock.scars))

    @staticmethod
    def draw(path: str, streams: Streams, wear: float) -> _WeatheredNumbers:
        """Draws the parameters of a rock."""
        u = streams.uniforms(f"{path}/joints", 18).reshape(6, 3)
        v = streams.uniforms(f"{path}/planes", 3 * _FRACTURES).reshape(_FRACTURES, 3)
        joints = np.concatenate([np.eye(3), -np.eye(3)]) + 0.45 * unit_vectors(u[:, :2])
        joints /= np.sqrt((joints * joints).sum(axis=1))[:, None]
        s = streams.uniforms(f"{path}/spalls", 4 * _SPALLS).reshape(_SPALLS, 4)
        return _WeatheredNumbers(
            normals=np.concatenate([joints, unit_vectors(v[:, :2])]),
            distances=np.concatenate([0.62 + 0.3 * u[:, 2], 0.66 + 0.3 * v[:, 2]]),
            scars=np.concatenate(
                [unit_vectors(s[:, :2]), 0.4 + 0.9 * s[:, 2:3], 0.02 + 0.07 * s[:, 3:]], axis=1
            ),
            width=_NARROWEST + _WIDEST * wear,
        )
