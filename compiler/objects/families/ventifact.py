"""Shapes ventifacts: stones that wind-blown sand has cut flat, face by face, until faces meet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.noise.perlin import fbm3
from scenec.compiler.objects.families.shape import (
    Carved,
    Shape,
    Turn,
    Usual,
    block,
    rough,
    sampling,
    smooth_max,
    unit_vectors,
)
from scenec.schemas.kernels import kernel

_PLANES = 11
_MOST_FACETS = 4
#: Inverse radii over which the wear of a keel reaches at wear 1.
_WIDEST = 0.5
#: How far from the wind a facet looks at most, in whole turns (30 degrees).
_ASTRAY = 1.0 / 12.0


class _VentifactNumbers(NamedTuple):
    """A ventifact.

    Attributes:
        facets, reaches: Unit normals [f, 3] and distances [f] of its facets.
        normals, distances: Of the planes of the stone before it was cut, [b, 3] and [b].
        frames: For each facet the directions along and across its flutes, float64 [f, 2, 3].
        steepness: Of each facet, 0 to 1: what is steep is pitted, what is flat is fluted.
        wear: 0 has sharp keels, 1 none left.
    """

    facets: NDArray[np.float64]
    reaches: NDArray[np.float64]
    normals: NDArray[np.float64]
    distances: NDArray[np.float64]
    frames: NDArray[np.float64]
    steepness: NDArray[np.float64]
    wear: float


@kernel
def _at(keys, rock, fine, x, y, z):  # type: ignore[no-untyped-def]
    # The body was round before the wind came; keels are worn here more, there less.
    body, _plane, _gap = block(rock.normals, rock.distances, x, y, z, 0.3 + 0.4 * rock.wear)
    chips = fbm3(keys[1], 2.3 * x, 2.3 * y, 2.3 * z, 3, 0.7)
    width = _WIDEST * rock.wear * max(1.0 + 1.4 * chips, 0.1)
    cut, facet, _gap = block(rock.facets, rock.reaches, x, y, z, width)
    h = max(smooth_max(body, cut, width), 0.7) if width > 0.0 else max(body, cut, 0.7)
    r = 1.0 / h
    px, py, pz = r * x, r * y, r * z
    # How far it is from what the wind has not reached, 1 on a facet.
    planed = min(max((cut - body) / 0.12, 0.0), 1.0) if facet >= 0 else 0.0
    bumps, tone = 0.0, 0.0
    if fine.waves > 0:
        low = fbm3(keys[2], 1.2 * px, 1.2 * py, 1.2 * pz, fine.waves, 0.5)
        bumps += (0.3 - 0.25 * planed) * low
    if fine.grains > 0:
        grain = fbm3(keys[3], 6.0 * px, 6.0 * py, 6.0 * pz, fine.grains, 0.6)
        bumps += (0.08 - 0.06 * planed) * grain
    if planed > 0.0 and fine.marks > 0:
        frame = rock.frames[facet]
        u = frame[0, 0] * px + frame[0, 1] * py + frame[0, 2] * pz
        v = frame[1, 0] * px + frame[1, 1] * py + frame[1, 2] * pz
        # Grooves fan out a little up the facet, and end there.
        wave = fbm3(keys[4], 1.4 * u, 8.0 * v / (1.0 + 0.5 * u), 3.0 * facet, fine.marks, 0.5)
        deep = max(0.1 - wave, 0.0) * min(max(0.9 - u, 0.0), 1.0)
        pit = max(fbm3(keys[5], 8.0 * px, 8.0 * py, 8.0 * pz, fine.marks, 0.6) - 0.16, 0.0)
        steep = rock.steepness[facet]
        taken = planed * ((1.0 - 0.6 * steep) * 0.14 * deep + (0.1 + 0.9 * steep) * 0.22 * pit)
        bumps -= taken
        tone -= 6.0 * taken
    tone += 0.4 * fbm3(keys[0], 2.3 * px, 2.3 * py, 2.3 * pz, 4, 0.65) + 0.12 * (planed - 0.5)
    return r * rough(fine.bumpiness, bumps), tone


class VentifactRock(Carved[_VentifactNumbers]):
    """A cobble with two to four facets cut into its upper half, which meet in keels.

    The facets rise at 25 to 65 degrees around the stone (Laity and Bridges 2009); along each run
    flutes, deepest near its foot, and pits where sand hits it steeply.
    """

    sample = sampling(_at)
    noises = ((1.2, 3), (6.0, 4), (8.0, 3))
    USUAL = Usual(0.28, 0.5, 0.12)
    LIES = True

    def creases(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the planes of facets and body, which meet at creases."""
        rock = self.drawn
        return (
            np.concatenate([rock.facets, rock.normals]),
            np.concatenate([rock.reaches, rock.distances]),
        )

    def bearings(self) -> NDArray[np.float64]:
        """Returns the bearings of facets, in whole turns from +x toward +y, float64 [f]."""
        # Across planes that are stretched, as normals go.
        x, y = self.drawn.facets[:, 0] / self.axes[0], self.drawn.facets[:, 1] / self.axes[1]
        angles = [elementary.atan2(*each) for each in zip(y.tolist(), x.tolist(), strict=True)]
        return np.array(angles) / (2.0 * elementary.PI)

    @staticmethod
    def draw(path: str, streams: Streams, wear: float) -> _VentifactNumbers:
        """Draws the parameters of a rock."""
        u = streams.uniforms(f"{path}/body", 3 * _PLANES).reshape(_PLANES, 3)
        count, first = streams.uniforms(f"{path}/wind", 2)
        # Most are dreikanter, with three edges.
        facets = 2 + int(count > 0.3) + int(count > 0.8)
        v = streams.uniforms(f"{path}/facets", 4 * _MOST_FACETS).reshape(_MOST_FACETS, 4)[:facets]
        turn = first + (np.arange(facets) + 0.6 * (v[:, 0] - 0.5)) / facets
        bearing = 2.0 * elementary.PI * turn
        tilt = elementary.PI / 180.0 * (25.0 + 40.0 * v[:, 1])
        c, s = elementary.cos_array(bearing), elementary.sin_array(bearing)
        low, high = elementary.sin_array(tilt), elementary.cos_array(tilt)
        normals = np.stack([low * c, low * s, high], axis=1)
        along = np.stack([-high * c, -high * s, low], axis=1)
        across = np.stack([-s, c, np.zeros(facets)], axis=1)
        return _VentifactNumbers(
            facets=normals,
            reaches=0.42 + 0.2 * v[:, 2],
            normals=unit_vectors(u[:, :2]),
            distances=0.72 + 0.28 * u[:, 2],
            frames=np.stack([along, across], axis=1),
            steepness=v[:, 1],
            wear=wear,
        )

    @classmethod
    def turn(cls, shapes: Sequence[Shape], context: Context) -> Turn:
        """Turns each ventifact so that one of its facets looks into the wind, more or less.

        All of a batch have one wind: that of the relief, if it has one, or one of their own.
        """
        # Imported here: cfgs are checked without.
        from scenec.compiler.terrain.mask import Masked

        operators = (o.operator if isinstance(o, Masked) else o for o in context.relief)
        winds = (getattr(operator, "wind_deg", None) for operator in operators)
        to_deg = next((wind for wind in winds if wind is not None), None)
        to = to_deg / 360.0 if to_deg is not None else context.streams.uniforms("wind", 1)[0]
        looks = [shape.bearings() for shape in shapes if isinstance(shape, cls)]
        counts = np.array([len(each) for each in looks])
        padded = np.array([np.resize(each, counts.max()) for each in looks])

        def turned(prototype: NDArray[np.int32], u: NDArray[np.float64]) -> NDArray[np.float64]:
            facet = (u[:, 1] * counts[prototype]).astype(np.int64)
            astray = _ASTRAY * (u[:, 0] + u[:, 2] - 1.0)
            turns: NDArray[np.float64] = to + 0.5 + astray - padded[prototype, facet]
            return turns - np.floor(turns)

        return turned
