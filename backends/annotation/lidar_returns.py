"""What comes back of a lidar's beams: its energy, and the returns of beams that have a width.

A ray that meets a surface at the range r brings back pi f cos / r^2, where f is the surface's BRDF
back along the ray (``surface.points``: of Lambert's law reflectance / pi; gloss counts as if it
were dull), weighed over the colors.

A beam is Gaussian. It is sampled by rays of equal energy on a spiral of golden angles (Vogel,
Math. Biosciences 44 (1979) 179): ray k of n goes where the share (k + 1/2) / n of the power is
nearer to the beam's axis, and one alone along the axis. Sorted by range, rays make one return as
long as the next is not farther away than the lidar separates. A return's range is the mean of its
rays', weighed by what each brings back; its ids and incidence are those of its ray that is nearest
to the axis; its energy is the rays' sum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.exact.caster import Hits
from scenec.backends.stage.scene import Lidar, RenderScene
from scenec.backends.surface.points import surface_points
from scenec.schemas.kernels import kernel
from scenec.schemas.lidar import LidarFootprint, LidarIntensity
from scenec.schemas.threads import over_threads

#: Rays that are cast, and hits whose surfaces are looked up, at a time.
_RAYS, _HITS = 1 << 20, 1 << 16
_GOLDEN = math.pi * (3.0 - math.sqrt(5.0))
#: What is nearer counts as here: the law has no bound.
_NEAREST_M = 1e-6


@dataclass(frozen=True, eq=False)
class Returns:
    """Holds what comes back to a lidar, n returns.

    Attributes:
        hits: Of the ray of each that is nearest to its beam's axis.
        rays: These rays.
        range: Meters, +inf of none, float64 [n].
        energy: Of a white surface that faces the lidar at 1 m it is 1, float64 [n]; 1 where nobody
            asks.
    """

    hits: Hits
    rays: Rays
    range: NDArray[np.float64]
    energy: NDArray[np.float64]

    def intensity(self, told: LidarIntensity) -> NDArray[np.float64]:
        """Returns the intensities as a lidar tells them, [n], 0 where nothing comes back."""
        near = np.maximum(np.where(np.isfinite(self.range), self.range, 0.0), _NEAREST_M)
        return np.asarray(self.energy * (told.at_m * told.at_m if told.at_m > 0.0 else near * near))


class _Sampling(NamedTuple):
    """Holds a beam as kernels want it.

    Attributes:
        across: Tangents of each ray's angle to the axis, to two sides, float64 [s, 2].
        separation, far: Meters.
        returns: Most that are told.
    """

    across: NDArray[np.float64]
    separation: float
    far: float
    returns: int


class _Table(NamedTuple):
    """Holds returns of beams, [m * returns].

    Attributes:
        ray: Which of the rays is nearest to the axis, int64; -1: there is no such return.
        range, energy: float64.
    """

    ray: NDArray[np.int64]
    range: NDArray[np.float64]
    energy: NDArray[np.float64]


@kernel
def _spread(first, last, axes, across, out):  # type: ignore[no-untyped-def]
    """Unit directions of the rays of each beam, float64 [m * s, 3]."""
    count = across.shape[0]
    for i in range(first, last):
        x, y, z = axes[i, 0], axes[i, 1], axes[i, 2]
        # Two directions across (Duff et al. 2017, J. Computer Graphics Techniques 6).
        sign = math.copysign(1.0, z)
        a = -1.0 / (sign + z)
        b = x * y * a
        for k in range(count):
            u, v = across[k]
            scale = 1.0 / math.sqrt(1.0 + u * u + v * v)
            to = out[i * count + k]
            to[0] = scale * (x + u * (1.0 + sign * x * x * a) + v * b)
            to[1] = scale * (y + u * sign * b + v * (sign + y * y * a))
            to[2] = scale * (z - u * sign * x - v * y)


@kernel
def _group(first, last, t, energy, beam, out):  # type: ignore[no-untyped-def]
    """Makes returns of what the rays of each beam meet."""
    count, most = beam.across.shape[0], beam.returns
    starts, powers = np.empty(count + 1, np.int64), np.empty(count)
    for i in range(first, last):
        near = t[i * count : (i + 1) * count]
        order = np.argsort(near, kind="mergesort")
        groups = 0
        here = 0
        while here < count and near[order[here]] <= beam.far:
            if here == 0 or near[order[here]] - near[order[here - 1]] > beam.separation:
                starts[groups], powers[groups] = here, 0.0
                groups += 1
            powers[groups - 1] += energy[i * count + order[here]]
            here += 1
        starts[groups] = here
        # What is weaker than so many others is not told.
        told = 0
        for g in range(groups):
            stronger = 0
            for other in range(groups):
                if powers[other] > powers[g] or (powers[other] == powers[g] and other < g):
                    stronger += 1
            if stronger >= most:
                continue
            k = i * most + told
            told += 1
            total, weight, nearest = 0.0, 0.0, count
            for j in range(starts[g], starts[g + 1]):
                ray = order[j]
                # All of a black surface count alike.
                w = energy[i * count + ray] if powers[g] > 0.0 else 1.0
                total += w * near[ray]
                weight += w
                nearest = min(nearest, ray)
            out.ray[k] = i * count + nearest
            out.range[k] = total / weight
            out.energy[k] = powers[g]


def find_returns(
    scene: RenderScene,
    caster: ExactCaster,
    lidar: Lidar,
    directions: NDArray[np.float64],
    shape: tuple[int, int],
    sample: int,
) -> Returns:
    """Finds what comes back of a scan's beams.

    Args:
        scene: The scene.
        caster: Of the scene, posed at the sample.
        lidar: At this sample.
        directions: Of the axes of its beams, units in the world, float64 [m, 3].
        shape: Rows and columns that they make.
        sample: Time code.

    Returns:
        One of each axis, in their order; of beams with a width as many as are told at most, one
        after the other, nearest first.
    """
    if lidar.footprint is None:
        rays = _rays(lidar, directions, shape)
        hits = caster.hits(rays)
        return Returns(hits, rays, hits.t, _energy(scene, lidar, rays, hits, sample))
    beam = lidar.footprint
    step = max(_RAYS // beam.rays, 1)
    parts = [
        _of_beams(scene, caster, lidar, beam, directions[at : at + step], sample)
        for at in range(0, len(directions), step)
    ]
    row, face, t, to, far, energy = map(np.concatenate, zip(*parts, strict=True))
    return Returns(Hits(row, face, t, caster.geometry), _rays(lidar, to, (len(t), 1)), far, energy)


def _rays(lidar: Lidar, directions: NDArray[np.float64], shape: tuple[int, int]) -> Rays:
    origins = np.ascontiguousarray(np.broadcast_to(lidar.to_world[:3, 3], directions.shape))
    return Rays(origins, directions, shape)


def _of_beams(
    scene: RenderScene,
    caster: ExactCaster,
    lidar: Lidar,
    beam: LidarFootprint,
    axes: NDArray[np.float64],
    sample: int,
) -> tuple[NDArray[Any], ...]:
    """Returns row, face, parameter and direction of the rays that returns are of, range, energy."""
    across = _across(beam)
    count, many = len(across), len(axes) * beam.returns
    directions = np.empty((len(axes) * count, 3))
    over_threads(_spread, len(axes), axes, across, directions)
    rays = _rays(lidar, directions, (len(axes), count))
    hits = caster.hits(rays)
    energy = _energy(scene, lidar, rays, hits, sample) / count
    footprint = _Sampling(across, beam.separation_m, lidar.range_m[1], beam.returns)
    out = _Table(np.full(many, -1), np.full(many, np.inf), np.zeros(many))
    over_threads(_group, len(axes), hits.t, energy, footprint, out)
    there = out.ray >= 0
    row, face = np.where(there, hits.row[out.ray], -1), np.where(there, hits.face[out.ray], 0)
    t = np.where(there, hits.t[out.ray], np.inf)
    ids = row.astype(np.int32), face.astype(np.int32)
    return *ids, t, directions[out.ray], out.range, out.energy


def _across(beam: LidarFootprint) -> NDArray[np.float64]:
    """See ``_Sampling``."""
    if beam.rays == 1:
        return np.zeros((1, 2))
    k = np.arange(beam.rays)
    power = (k + 0.5) / beam.rays
    # Within the angle a of the axis is 1 - exp(-2 (a / w)^2) of the power, w half the divergence.
    angle = 0.5 * math.radians(beam.divergence_deg) * np.sqrt(-0.5 * np.log1p(-power))
    turn = _GOLDEN * k
    return np.ascontiguousarray((np.tan(angle) * [np.cos(turn), np.sin(turn)]).T)


def _energy(
    scene: RenderScene, lidar: Lidar, rays: Rays, hits: Hits, sample: int
) -> NDArray[np.float64]:
    """Energy of each ray, float64 [n]: 0 without a hit; 1 of all rays where nobody asks."""
    told = lidar.intensity
    if told is None and lidar.footprint is None and lidar.detection is None:
        return np.ones(len(hits.t))
    bands = np.array((told or LidarIntensity()).bands)
    rows, out = scene.rows_at(sample), np.zeros(len(hits.t))
    index = np.flatnonzero(hits.t <= lidar.range_m[1])
    for which in np.array_split(index, max(-(-len(index) // _HITS), 1)):
        at = hits.row[which], hits.face[which], hits.t[which]
        points = surface_points(scene, rows, rays.origins[which], rays.directions[which], at)
        back = np.pi * points.shown(points.to_viewer)
        near = np.maximum(hits.t[which], _NEAREST_M)
        out[which] = (back * bands).sum(axis=1) / (near * near)
    return out
