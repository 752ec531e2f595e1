"""Shapes vesicular rocks: basalt that bubbled, broken open and worn a little."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.streams import Streams
from scenec.compiler.noise.lattice import subkeys
from scenec.compiler.noise.perlin import fbm3
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

_PLANES = 12
_BUBBLES = 260
_LARGEST = 0.17
_SMALLEST = 0.035


class _VesicularNumbers(NamedTuple):
    """A vesicular rock.

    Attributes:
        normals, distances: Unit normals [p, 3] and distances [p] of its planes.
        bubbles: Unit directions, radii, and heights of the middles over the surface in parts of
            the radius, float64 [b, 5]; as the kernel takes them the middles and radii [b, 4] of
            those that the mesh can show.
        width: Inverse radii over which the wear of an edge reaches.
    """

    normals: NDArray[np.float64]
    distances: NDArray[np.float64]
    bubbles: NDArray[np.float64]
    width: float


@kernel
def _radius(keys, rock, fine, x, y, z):  # type: ignore[no-untyped-def]
    """Returns the radius of the worn block, before balls are taken from it."""
    h, _plane, _gap = block(rock.normals, rock.distances, x, y, z, rock.width)
    r = 1.0 / min(max(h, 0.8), 4.0)
    bumps = 0.0
    if fine.waves > 0:
        bumps += 0.3 * fbm3(keys[1], 1.5 * x * r, 1.5 * y * r, 1.5 * z * r, fine.waves, 0.5)
    if fine.grains > 0:
        bumps += 0.09 * fbm3(keys[2], 6.0 * x * r, 6.0 * y * r, 6.0 * z * r, fine.grains, 0.6)
    return r * rough(fine.bumpiness, bumps)


@kernel
def _balls(key, rock, fine):  # type: ignore[no-untyped-def]
    """Middles and radii of the bubbles that a mesh of this spacing can show, float64 [b, 4]."""
    keys = subkeys(key, 6)
    balls = np.empty((len(rock.bubbles), 4))
    count = 0
    for b in range(len(rock.bubbles)):
        x, y, z, size, up = rock.bubbles[b]
        rich = fbm3(keys[4], 1.2 * x, 1.2 * y, 1.2 * z, 2, 0.5)
        # Bubbles crowd in some places and are rare in others.
        if size < 1.6 * fine.spacing or rich < -0.15:
            continue
        # A bubble's rim must be in view from the center, or it would have a wall behind it.
        r = _radius(keys, rock, fine, x, y, z)
        away = r + size * max(up, 0.6 * size / r)
        balls[count] = x * away, y * away, z * away, size
        count += 1
    return balls[:count]


@kernel
def _at(keys, rock, fine, x, y, z):  # type: ignore[no-untyped-def]
    r = _radius(keys, rock, fine, x, y, z)
    deepest = 0.0
    left = r
    for b in range(len(rock.bubbles)):
        cx, cy, cz, size = rock.bubbles[b]
        along, square = ball_along(x, y, z, cx, cy, cz, size)
        if along > 0.0 and square > 0.0:
            near = along - np.sqrt(square)
            left = min(left, near)
            deepest = max(deepest, (r - near) / size)
    tone = 0.25 + 0.4 * fbm3(keys[3], 2.3 * x, 2.3 * y, 2.3 * z, 4, 0.65)
    tone -= 0.9 * min(max(deepest, 0.0) * 1.5, 1.0)
    return max(left, 0.5 * r), tone


class VesicularRock(Carved[_VesicularNumbers]):
    """A worn block from which balls are taken, their middles a little above the surface."""

    sample = sampling(_at)
    noises = ((1.5, 3), (6.0, 4))
    USUAL = Usual(0.2, 0.35, 0.4)

    def for_mesh(self, fine: Fine) -> _VesicularNumbers:
        """Returns the parameters for a mesh, with bubbles where coarse relief alone leaves them."""
        fine = fine._replace(waves=min(fine.waves, 2), grains=0)
        return self.drawn._replace(bubbles=_balls(np.uint64(self.key), self.drawn, fine))

    @staticmethod
    def draw(path: str, streams: Streams, wear: float) -> _VesicularNumbers:
        """Draws the parameters of a rock."""
        u = streams.uniforms(f"{path}/planes", 3 * _PLANES).reshape(_PLANES, 3)
        v = streams.uniforms(f"{path}/bubbles", 4 * _BUBBLES).reshape(_BUBBLES, 4)
        # Numbers fall with the size's square: as much of the surface to every size.
        steep = 1.0 / (_SMALLEST * _SMALLEST)
        flat = 1.0 / (_LARGEST * _LARGEST)
        size = 1.0 / np.sqrt(steep + v[:, 2] * (flat - steep))
        return _VesicularNumbers(
            normals=unit_vectors(u[:, :2]),
            distances=0.66 + 0.34 * u[:, 2],
            bubbles=np.concatenate(
                [unit_vectors(v[:, :2]), size[:, None], 0.15 + 0.55 * v[:, 3:]], axis=1
            ),
            width=0.05 + 0.55 * wear,
        )
