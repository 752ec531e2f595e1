"""A lidar's scan: rays of the shared exact caster, and what a real lidar gets wrong.

Each beam meets the nearest surface along its direction, in float64; label, instance and incidence
are those of the face it meets. Noise comes after: ranges get a normal error of the standard
deviation sqrt(a^2 + (b r)^2), answers are lost by chance or because they are too weak, and with
angular noise the ray that is cast is turned away from the direction that is told. Numbers are
counted by ray, return, sample and key (``imaging.chance``): no other ray, and no order, changes
them. What a beam that has a width meets, and what comes back of it, is ``lidar_returns``' matter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import View
from scenec.backends.annotation.lidar_returns import find_returns
from scenec.backends.annotation.passes import instance, label, normal
from scenec.backends.exact import ExactCaster
from scenec.backends.imaging.chance import philox, quantile, unit
from scenec.backends.stage.scene import Lidar, RenderScene
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

_LOW, _HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
_TURNED, _ANSWERED = np.uint64(0), np.uint64(1)


class _Errors(NamedTuple):
    """Holds the errors of a lidar: ``Lidar``'s numbers, as kernels want them.

    Attributes:
        angle: Deviation of angles, radians.
        steady, ratio: Of ranges: meters, and a share of the range.
        lost: Share of answers that are lost.
        near, far: Ranges that are told, meters.
        returns: Of each ray.
        gain: Energies over that of the threshold; 0: all are detected.
        flicker: Standard deviation of the energy, of the threshold's.
        key, sample: Of the random numbers, uint64.
    """

    angle: float
    steady: float
    ratio: float
    lost: float
    near: float
    far: float
    returns: int
    gain: float
    flicker: float
    key: np.uint64
    sample: np.uint64


@kernel
def _directions(first, last, elevations, azimuths, errors, turn, out):  # type: ignore[no-untyped-def]
    """World directions of the rays that are cast, float64 [b * a, 3]; angles are in radians."""
    for k in range(first, last):
        up, left = elevations[k], azimuths[k]
        if errors.angle > 0.0:
            w = philox(errors.key, np.uint64(k), errors.sample, _TURNED, np.uint64(0))
            up += errors.angle * quantile(unit(w[0]))
            left += errors.angle * quantile(unit(w[1]))
        flat = math.cos(up)
        x, y, z = flat * math.cos(left), flat * math.sin(left), math.sin(up)
        for i in range(3):
            out[k, i] = turn[i, 0] * x + turn[i, 1] * y + turn[i, 2] * z


@kernel
def _answers(first, last, t, energy, errors, out):  # type: ignore[no-untyped-def]
    """Ranges with noise, float64 [n]; +inf where there is no answer."""
    for k in range(first, last):
        out[k] = math.inf
        if not errors.near <= t[k] <= errors.far:
            continue
        ray, number = np.uint64(k // errors.returns), np.uint64(k % errors.returns)
        w = philox(errors.key, ray, errors.sample, _ANSWERED, number)
        if errors.gain > 0.0:
            felt = errors.gain * energy[k]
            if not (felt > 0.0 and felt + errors.flicker * quantile(unit(w[2])) >= 1.0):
                continue
        if unit(w[0]) >= errors.lost:
            steady, ratio = errors.steady, errors.ratio
            deviation = math.sqrt(steady * steady + ratio * ratio * t[k] * t[k])
            out[k] = max(t[k] + deviation * quantile(unit(w[1])), 0.0)


def scan(scene: RenderScene, caster: ExactCaster, lidar: Lidar, sample: int) -> dict[str, NDArray]:
    """One scan.

    Args:
        scene: The scene.
        caster: Of the scene; is posed at the sample.
        lidar: At this sample.
        sample: Time code.

    Returns:
        Arrays by name, as ``schemas.scans`` has them.
    """
    elevations, azimuths = np.radians(lidar.elevations_deg), np.radians(lidar.azimuths_deg)
    if elevations.ndim == 1:
        elevations, azimuths = elevations[:, None], azimuths[None, :]
    grid = len(elevations), azimuths.shape[1]
    of_rays = [np.broadcast_to(angles, grid).ravel() for angles in (elevations, azimuths)]
    directions = np.empty((grid[0] * grid[1], 3))
    errors = _errors(lidar, sample)
    turn = np.ascontiguousarray(lidar.to_world[:3, :3])
    over_threads(_directions, len(directions), *of_rays, errors, turn, directions)
    caster.pose(sample)
    found = find_returns(scene, caster, lidar, directions, grid, sample)
    told = np.repeat(_beam_directions(elevations, azimuths), errors.returns, axis=0)
    shape = grid if errors.returns == 1 else (*grid, errors.returns)
    t = found.range
    answer = np.empty(len(t))
    over_threads(_answers, len(t), t, found.energy, errors, answer)
    there = np.isfinite(answer)
    view = View(scene, sample, found.hits, lambda: found.rays)
    made = {f"label.{level}": label(view, level) for level in scene.levels}
    made["instance"] = instance(view)
    cosine = np.abs((normal(view) * found.rays.directions).sum(axis=1))
    ids = {name: np.where(there, values, 0) for name, values in made.items()}
    out: dict[str, NDArray] = {
        "points": (told * np.where(there, answer, np.nan)[:, None]).astype(np.float32),
        "range": answer.astype(np.float32),
        "range_true": np.where(there, t, np.inf),
        "incidence": np.where(there, cosine, 0.0).astype(np.float32),
        **{name: values.astype(np.uint32) for name, values in ids.items()},
    }
    if lidar.intensity is not None:
        out["intensity"] = np.where(there, found.intensity(lidar.intensity), 0.0).astype(np.float32)
    out = {name: values.reshape(*shape, *values.shape[1:]) for name, values in out.items()}
    return out | {"elevation_deg": lidar.elevations_deg, "azimuth_deg": lidar.azimuths_deg}


def _errors(lidar: Lidar, sample: int) -> _Errors:
    gain = flicker = 0.0
    if (of := lidar.detection) is not None:
        flicker = of.noise
        at_range = 1.0 + flicker * float(quantile(of.probability))
        gain = at_range * of.range_m * of.range_m / of.reflectance
    return _Errors(
        math.radians(lidar.angle_noise_deg),
        lidar.range_noise_m,
        lidar.range_noise_ratio,
        lidar.dropout,
        *lidar.range_m,
        1 if lidar.footprint is None else lidar.footprint.returns,
        gain,
        flicker,
        np.uint64(lidar.key),
        np.uint64(sample),
    )


def _beam_directions(up: NDArray[np.float64], left: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions that the lidar tells, in its frame, [b * a, 3], of [b, 1 or a] and [1 or b, a]."""
    flat = np.cos(up)
    told = [flat * np.cos(left), flat * np.sin(left), np.sin(up) + 0.0 * left]
    return np.stack(told, axis=-1).reshape(-1, 3)
