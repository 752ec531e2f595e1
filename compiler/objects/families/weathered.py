"""Shapes weathered rocks: faceted, worn blocks out of a sphere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.noise.perlin import fbm3
from scenec.compiler.objects.families.shape import Shape, rough, sampling
from scenec.schemas.kernels import kernel


@dataclass(frozen=True)
class Weathered(Shape):
    """A convex block bounded by planes (a soft minimum over them), times 1 + bumpiness * noise.

    Attributes:
        plane_normals: Unit normals of the block's planes, float64 [p, 3].
        plane_distances: Their distances from the center, float64 [p].
        angularity: 0 is rounded, 1 sharp-edged.
    """

    plane_normals: NDArray[np.float64]
    plane_distances: NDArray[np.float64]
    angularity: float
    fits_axes: ClassVar[bool] = False

    def surface(
        self, directions: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As of ``Shape``; coarser meshes share the finest one's vertices."""
        # Exponent of the soft minimum: 4 gives a pebble, 40 a freshly broken block.
        sharpness = 4.0 + 36.0 * self.angularity * self.angularity
        rock = _Block(self.plane_normals, self.plane_distances, sharpness, self.bumpiness)
        radius, variation = _surface(np.uint64(self.key), directions, rock, 0)
        return radius, variation


class _Block(NamedTuple):
    """What the kernel takes of one: see ``Weathered``."""

    normals: NDArray[np.float64]
    distances: NDArray[np.float64]
    sharpness: float
    bumpiness: float


@kernel
def _at(keys, rock, _fine, x, y, z):  # type: ignore[no-untyped-def]
    normals, total = rock.normals, 0.0
    for p in range(len(rock.distances)):
        facing = (normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z) / rock.distances[p]
        if facing > 0.0:
            total += elementary.pow(facing, rock.sharpness)
    r = elementary.pow(total, -1.0 / rock.sharpness) if total > 0.0 else 1.0
    bumps = fbm3(keys[1], 1.7 * x, 1.7 * y, 1.7 * z, 5, 0.52)
    tone = fbm3(keys[2], 2.3 * x, 2.3 * y, 2.3 * z, 4, 0.65)
    return min(r, 1.25) * rough(rock.bumpiness, bumps), tone


_surface = sampling(_at)
