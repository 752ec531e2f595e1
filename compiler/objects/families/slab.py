"""Shapes slabs: plates of layered bedrock, prismatic in plan, their sides stepped."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.noise.perlin import fbm3, perlin3
from scenec.compiler.objects.families.shape import Carved, Fine, Usual, block, rough, sampling
from scenec.schemas.kernels import kernel

_MOST_SIDES = 8
_LAYERS = 6
#: Before it is stretched, a slab's half height, for a half width of 1.
_HALF_HEIGHT = 0.62
_WIDEST = 0.35


class _SlabNumbers(NamedTuple):
    """A slab.

    Attributes:
        normals, distances: Top, bottom, then the sides: unit normals [p, 3], distances [p].
        in_layer: Room for the planes' distances in one layer; those of top and bottom stay.
        bedding: Heights of the boundaries between layers, rising, float64 [l - 1].
        steps: How far each side of each layer stands back, float64 [l, p].
        tones: Albedo variation of each layer, float64 [l].
        width: Inverse radii over which the wear of an edge reaches.
    """

    normals: NDArray[np.float64]
    distances: NDArray[np.float64]
    in_layer: NDArray[np.float64]
    bedding: NDArray[np.float64]
    steps: NDArray[np.float64]
    tones: NDArray[np.float64]
    width: float


@kernel
def _at(keys, rock, fine, x, y, z):  # type: ignore[no-untyped-def]
    h, plane, _gap = block(rock.normals, rock.distances, x, y, z, 0.0)
    r = 1.0 / h
    # Layers are a little wavy, and their ends crumble.
    height = z * r + 0.035 * perlin3(keys[2], 1.5 * x * r, 1.5 * y * r, 0.0)
    layer = 0
    for k in range(len(rock.bedding)):
        if height > rock.bedding[k]:
            layer = k + 1
    back = 1.0 + 0.7 * perlin3(keys[2], 3.1 * x * r, 3.1 * y * r, 7.0 + layer)
    for p in range(2, len(rock.distances)):
        rock.in_layer[p] = rock.distances[p] * (1.0 - rock.steps[layer, p] * back)
    width = rock.width * (1.0 + 0.8 * perlin3(keys[1], 2.3 * x, 2.3 * y, 2.3 * z))
    h, plane, gap = block(rock.normals, rock.in_layer, x, y, z, width)
    r = 1.0 / h
    px, py, pz = r * x, r * y, r * z
    bumps = 0.0
    if plane < 2:
        # Bedding planes are nearly even: shallow, angular leftovers of the next layer.
        if fine.waves > 0:
            leaf = fbm3(keys[3], 1.4 * px, 1.4 * py, 3.0 * plane, fine.waves, 0.5)
            edge = min(max((leaf - 0.08) / max(0.06, 1.5 * fine.spacing), 0.0), 1.0)
            bumps -= 0.22 * edge * min(gap / 0.1, 1.0)
    elif fine.waves > 0:
        bumps += 0.1 * fbm3(keys[3], 1.4 * px, 1.4 * py, 1.4 * pz, fine.waves, 0.5)
    if fine.grains > 0:
        bumps += 0.05 * fbm3(keys[4], 4.5 * px, 4.5 * py, 4.5 * pz, fine.grains, 0.55)
    tones = rock.tones
    tone = tones[layer] if plane >= 2 else 0.5 * tones[0 if plane == 1 else len(tones) - 1]
    tone += 0.45 * fbm3(keys[5], 1.9 * px, 1.9 * py, 6.0 * pz, 4, 0.65)
    return r * rough(fine.bumpiness, bumps), tone


class SlabRock(Carved[_SlabNumbers]):
    """A prism between two bedding planes; each side stands back by another step in each layer."""

    sample = sampling(_at)
    noises = ((1.4, 3), (4.5, 4))
    USUAL = Usual(0.25, 0.8, 0.15)
    LIES = True

    def creases(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the planes that meet at creases."""
        return self.drawn.normals, self.drawn.distances

    def for_mesh(self, fine: Fine) -> _SlabNumbers:
        """Returns the parameters for a mesh, with a work array of their own."""
        return self.drawn._replace(in_layer=self.drawn.distances.copy())

    @staticmethod
    def draw(path: str, streams: Streams, wear: float) -> _SlabNumbers:
        """Draws the parameters of a rock."""
        count, first = streams.uniforms(f"{path}/sides", 2)
        sides = 5 + int(count * (_MOST_SIDES - 4))
        u = streams.uniforms(f"{path}/outline", 3 * _MOST_SIDES).reshape(_MOST_SIDES, 3)[:sides]
        turn = first + (np.arange(sides) + 0.75 * (u[:, 0] - 0.5)) / sides
        bearing = 2.0 * elementary.PI * turn
        normals = np.stack(
            [elementary.cos_array(bearing), elementary.sin_array(bearing), 0.5 * (u[:, 1] - 0.5)],
            axis=1,
        )
        ends = 0.08 * (streams.uniforms(f"{path}/ends", 4) - 0.5)
        normals = np.concatenate([[[ends[0], ends[1], 1.0], [ends[2], ends[3], -1.0]], normals])
        normals /= np.sqrt((normals * normals).sum(axis=1))[:, None]
        w = streams.uniforms(f"{path}/layers", _LAYERS)
        thick = np.cumsum(0.35 + w)
        stands = streams.uniforms(f"{path}/steps", _LAYERS * (_MOST_SIDES + 2))
        stands = stands.reshape(_LAYERS, -1)[:, : sides + 2]
        return _SlabNumbers(
            normals=normals,
            distances=np.concatenate([[_HALF_HEIGHT] * 2, 0.78 + 0.22 * u[:, 2]]),
            in_layer=np.zeros(0),
            bedding=_HALF_HEIGHT * (2.0 * thick[:-1] / thick[-1] - 1.0),
            # Most layers break nearly flush, a few far back.
            steps=0.22 * stands * stands * stands,
            tones=1.2 * streams.uniforms(f"{path}/tones", _LAYERS) - 0.6,
            width=wear * _WIDEST,
        )
