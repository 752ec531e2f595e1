"""Shapes angular rocks: fractured along planes, their corners chipped."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.streams import Streams
from scenec.compiler.geometry.icosphere import icosphere
from scenec.compiler.noise.perlin import fbm3, perlin3
from scenec.compiler.objects.families.shape import (
    Carved,
    Fine,
    Usual,
    block,
    bowl,
    bowls,
    rough,
    sampling,
    unit_vectors,
)
from scenec.schemas.kernels import kernel

_CUTS = 5
_CHIPS = 9
_SCARS = 7
#: Inverse radii over which the wear of an edge reaches at wear 1.
_WIDEST = 0.5


class _AngularNumbers(NamedTuple):
    """An angular rock.

    Attributes:
        normals, distances: Unit normals [p, 3] and distances [p] of its planes: joints, fractures,
            and, as the kernel takes them, chips.
        chips: What picks the corners and tilts the chips, and their depths, float64 [c, 7].
        scars: Unit directions of the bowls, their radii and depths, float64 [s, 5]; as the kernel
            takes them the centers and radii of balls [s, 4].
        tones: Albedo variation of each plane, float64 [p + c].
        width: Inverse radii over which the wear of an edge reaches.
    """

    normals: NDArray[np.float64]
    distances: NDArray[np.float64]
    chips: NDArray[np.float64]
    scars: NDArray[np.float64]
    tones: NDArray[np.float64]
    width: float


@kernel
def _chip(  # type: ignore[no-untyped-def]
    directions, normals, distances, u
):
    """The plane that takes the sharpest corner on the side that u points to."""
    best = -1.0
    corner = 0
    x, y, z = 2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0, 2.0 * u[2] - 1.0
    for n in range(len(directions)):
        h, _plane, _gap = block(
            normals, distances, directions[n, 0], directions[n, 1], directions[n, 2], 0.0
        )
        side = x * directions[n, 0] + y * directions[n, 1] + z * directions[n, 2]
        if (1.0 + 0.6 * side) / h > best:
            best = (1.0 + 0.6 * side) / h
            corner = n
    at = directions[corner]
    h, _plane, _gap = block(normals, distances, at[0], at[1], at[2], 0.0)
    normal = at + 0.8 * (u[3:6] - 0.5)
    normal /= np.sqrt((normal * normal).sum())
    reach = (normal * at).sum() / h
    return normal, reach * (0.97 - 0.12 * u[6])


@kernel
def _at(keys, rock, fine, x, y, z):  # type: ignore[no-untyped-def]
    # Some edges are worn more than others.
    width = rock.width * (1.0 + 0.8 * perlin3(keys[1], 1.9 * x, 1.9 * y, 1.9 * z))
    h, plane, gap = block(rock.normals, rock.distances, x, y, z, width)
    tone = rock.tones[plane]
    if gap < 0.08:
        # Edges shed their crust first.
        tone += 0.3 * (1.0 - gap / 0.08)
    for s in range(len(rock.scars)):
        near = bowl(rock.scars[s], x, y, z, h)
        if near > h:
            tone += 0.3 * min((near - h) / 0.05, 1.0)
            h = near
    r = 1.0 / h
    px, py, pz = r * x, r * y, r * z
    bumps = 0.0
    if fine.waves > 0:
        bumps += 0.11 * fbm3(keys[2], 1.3 * px, 1.3 * py, 1.3 * pz, fine.waves, 0.5)
    if fine.grains > 0:
        bumps += 0.06 * fbm3(keys[3], 5.0 * px, 5.0 * py, 5.0 * pz, fine.grains, 0.55)
    tone += 0.45 * fbm3(keys[4], 2.3 * px, 2.3 * py, 2.3 * pz, 4, 0.65)
    return r * rough(fine.bumpiness, bumps), tone


class AngularRock(Carved[_AngularNumbers]):
    """A block between three pairs of joints and a few random fractures.

    Chips then take its sharpest corners one after the other, each by a plane across a corner, as
    collisions do (Domokos et al. 2014); shallow bowls are the scars of flakes.
    """

    sample = sampling(_at)
    noises = ((1.3, 2), (5.0, 4))
    USUAL = Usual(0.29, 0.5, 0.1)

    @cached_property
    def _chipped(self) -> _AngularNumbers:
        """With its chips, and scars as balls."""
        directions, _ = icosphere(3)
        normals, distances = self.drawn.normals, self.drawn.distances
        for chip in self.drawn.chips:
            normal, distance = _chip(directions, normals, distances, chip)
            normals = np.concatenate([normals, normal[None]])
            distances = np.append(distances, distance)
        scars = bowls(normals, distances, self.drawn.scars)
        return self.drawn._replace(normals=normals, distances=distances, scars=scars)

    def creases(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the planes that meet at creases."""
        return self._chipped.normals, self._chipped.distances

    def for_mesh(self, fine: Fine) -> _AngularNumbers:
        """Returns the parameters for a mesh: with its chips, and scars as balls."""
        return self._chipped

    @staticmethod
    def draw(path: str, streams: Streams, wear: float) -> _AngularNumbers:
        """Draws the parameters of a rock."""
        u = streams.uniforms(f"{path}/joints", 24).reshape(6, 4)
        tilt = unit_vectors(u[:, :2])
        joints = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
        joints = joints + 0.4 * tilt
        joints /= np.sqrt((joints * joints).sum(axis=1))[:, None]
        v = streams.uniforms(f"{path}/cuts", 3 * _CUTS).reshape(_CUTS, 3)
        w = streams.uniforms(f"{path}/chips", 7 * _CHIPS).reshape(_CHIPS, 7)
        s = streams.uniforms(f"{path}/scars", 4 * _SCARS).reshape(_SCARS, 4)
        scar = unit_vectors(s[:, :2])
        bowl = 0.5 + 0.9 * s[:, 2]
        tones = 2.0 * streams.uniforms(f"{path}/tones", 6 + _CUTS + _CHIPS) - 1.0
        # What broke last has not darkened yet.
        tones = np.concatenate([0.35 * tones[: 6 + _CUTS], 0.45 + 0.25 * tones[6 + _CUTS :]])
        return _AngularNumbers(
            normals=np.concatenate([joints, unit_vectors(v[:, :2])]),
            distances=np.concatenate([0.62 + 0.33 * u[:, 2], 0.68 + 0.3 * v[:, 2]]),
            chips=w,
            scars=np.concatenate([scar, bowl[:, None], 0.01 + 0.05 * s[:, 3:]], axis=1),
            tones=tones,
            width=wear * _WIDEST,
        )
