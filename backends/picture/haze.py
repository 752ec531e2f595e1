"""Haze between camera and surfaces: the same for all renderers, from exact distances.

Light L of a surface at distance d arrives as L * T + A: T = exp(-tau), tau the extinction along the
ray (Beer and Lambert), and A the airlight, what haze on the way scatters toward the camera; both
follow from the distance as ``airlight`` defines them. A sky's picture holds its own atmosphere, so
haze lies over surfaces, and over what such a picture shows below the horizon: that stands for
ground, taken to be as low as the lowest point of the scene. What is left out: light on its way to
surfaces is not weakened, and surfaces cast no shadows into haze.

T and A are those of the pixel's center. Where T changes within the 3x3 window, or a surface ends
before the sky, they are means over several rays, of those that meet something. A renderer's pixel
is one number, so all of its light is weakened alike there: the error is the covariance of L and T
in the pixel, and 0 where either is constant (measured in ``tests/backends/test_haze.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import subpixel_directions
from scenec.backends.contract import Rays
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.picture.airlight import Air, air_of, arrive, sources
from scenec.backends.picture.sky import Sky
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: What a backend's ``losses`` say of a stage with haze.
LOSS = (
    "haze: light is weakened on its way from surfaces to the camera only, not on its way to "
    "surfaces; surfaces of several distances in one pixel are weakened alike"
)
#: Rays in a pixel where its transmittance changes: a lattice, no two in one column or row, so that
#: an upright or level edge is off by a 16th of a pixel at most.
SUBRAYS = 8
_LATTICE = 3
#: Second difference of transmittance from which on that is so: an 8-bit step.
_STEP = 1.0 / 256.0
#: Rays that are cast at once.
_PART = 1 << 20


@dataclass(frozen=True)
class Veil:
    """What haze does to the pixels of one picture.

    Attributes:
        transmittance: Part of a surface's light that arrives, float64 [h, w, 3].
        airlight: Radiance that haze adds before surfaces, float64 [h, w, 3].
        behind: As ``transmittance``, of what a picture of the sky shows there: 1 but near the
            horizon and below.
        airlight_behind: As ``airlight``, likewise.
        subsampled: Pixels in which several rays were cast.
    """

    transmittance: NDArray[np.float64]
    airlight: NDArray[np.float64]
    behind: NDArray[np.float64]
    airlight_behind: NDArray[np.float64]
    subsampled: int

    def over(
        self, light: NDArray[np.float64], coverage: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Light of surfaces seen through it.

        Args:
            light: Premultiplied by coverage, [..., h, w, 3].
            coverage: Fraction of each pixel that surfaces cover, [h, w].
        """
        return light * self.transmittance + coverage[..., None] * self.airlight

    def over_sky(self, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
        """The sky's picture seen through it, [h, w, 3]."""
        return radiance * self.behind + self.airlight_behind


def air_at(scene: RenderScene, sample: int, sky: Sky | None) -> Air | None:
    """The haze of a sample; None without any.

    Args:
        scene: Its haze, its suns, its lowest point.
        sample: Time code.
        sky: The sample's domes, combined.
    """
    haze = scene.haze[sample] if scene.haze else None
    if haze is None:
        return None
    floor = float(scene.bounds[0, 2]) if haze.floor_m is None else haze.floor_m
    return air_of(haze, scene.lighting[sample].suns, sky, floor)


def veil(
    air: Air,
    camera: Camera,
    caster: ExactCaster,
    rays: Rays,
    t: NDArray[np.float64],
    coverage: NDArray[np.float32],
    edges: bool = True,
) -> Veil:
    """What haze does to a picture.

    Args:
        air: From ``air_at``.
        camera: The camera.
        caster: The exact caster, posed as at the sample.
        rays: One a pixel, through its center.
        t: Their exact hits, float64 [h * w]; +inf without one.
        coverage: What surfaces cover of each pixel, as the renderer has it, [h, w].
        edges: Whether several rays are cast where transmittance changes within a pixel.
    """
    source = sources(air, rays.directions)
    covered, missed = coverage.ravel() > 0.0, ~np.isfinite(t)
    # Where no ray at all meets what a renderer's did: as what is seen farthest beside it.
    ends = np.where(missed, _farthest(t, rays.shape), t)
    passed, added = arrive(air, rays.origins, rays.directions[:, None], ends[:, None], source)
    if edges:
        open_edge = covered & (missed | (coverage.ravel() < 1.0))
        index = np.flatnonzero(open_edge | _changes(passed, ~missed, rays.shape))
        _refine(air, camera, caster, rays, source, index, passed, added)
    else:
        index = np.zeros(0, np.int64)
    behind, glow = _behind(air, rays, source)
    if rays.known is not None:
        # Outside of the image circle it is black.
        passed[~rays.known] = behind[~rays.known] = 1.0
        added[~rays.known] = glow[~rays.known] = 0.0
    passed, added, behind, glow = (
        part.reshape(*rays.shape, 3) for part in (passed, added, behind, glow)
    )
    return Veil(passed, added, behind, glow, len(index))


def _behind(
    air: Air,
    rays: Rays,
    source: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What arrives of a sky's picture, and the airlight before it, float64 [n, 3].

    Below the horizon it is ground at the height of the floor. Around the horizon the picture mixes
    both within a texel: what is less than half of one below counts as that far below, and over a
    texel above it the ground's share fades.
    """
    d = rays.directions
    sine = d[:, 2] / np.sqrt((d * d).sum(axis=1))
    half = air.half_texel_rad
    share = np.clip(1.0 - sine / (2.0 * half), 0.0, 1.0)
    below = np.flatnonzero(share > 0.0)
    down = np.zeros((len(below), 1, 3))
    # Along the ray but for its bearing, which no depth depends on; a unit of it is a meter down.
    slope = np.maximum(-sine[below], half)
    down[:, 0, 0] = np.sqrt(np.maximum(1.0 - slope * slope, 0.0)) / slope
    down[:, 0, 2] = -1.0
    above = np.maximum(rays.origins[below, 2] - air.floor_m, 0.0)[:, None]
    part = (source[0][below], source[1][below])
    passed, added = arrive(air, rays.origins[below], down, above, part)
    of_ground = share[below, None]
    behind, glow = np.ones((len(sine), 3)), np.zeros((len(sine), 3))
    behind[below] = 1.0 - of_ground * (1.0 - passed)
    glow[below] = of_ground * added
    return behind, glow


def _farthest(t: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """The farthest hit in the 3x3 windows, float64 [n]; +inf without any."""
    most = np.pad(np.where(np.isfinite(t), t, -np.inf).reshape(shape), 1, constant_values=-np.inf)
    most = np.maximum(np.maximum(most[:-2], most[1:-1]), most[2:])
    most = np.maximum(np.maximum(most[:, :-2], most[:, 1:-1]), most[:, 2:])
    return np.where(np.isfinite(most), most, np.inf).ravel()


def _changes(
    passed: NDArray[np.float64], hit: NDArray[np.bool_], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """Hits beside which transmittance jumps or bends, bool [n].

    That is its second difference along a row, a column or a diagonal. What lies on a slope is at
    the pixel's center as on the pixel's mean, and is no change.
    """
    changes = np.zeros(hit.shape, np.bool_)
    over_threads(_bends, shape[0], passed.reshape(*shape, 3), hit.reshape(shape), changes)
    return changes


@kernel
def _bends(first, last, passed, hit, changes):  # type: ignore[no-untyped-def]
    height, width = hit.shape
    for v in range(first, last):
        for u in range(width):
            if not hit[v, u]:
                continue
            for way in range(4):
                dv, du = (0, 1, 1, 1)[way], (1, 0, 1, -1)[way]
                for c in range(3):
                    bend = 0.0
                    for sign in (-1, 1):
                        y, x = v + sign * dv, u + sign * du
                        # Beyond the border and in the sky it counts as it is here.
                        if 0 <= y < height and 0 <= x < width and hit[y, x]:
                            bend += passed[y, x, c] - passed[v, u, c]
                    if abs(bend) > _STEP:
                        changes[v * width + u] = True


def _refine(
    air: Air,
    camera: Camera,
    caster: ExactCaster,
    rays: Rays,
    source: tuple[NDArray[np.float64], NDArray[np.float64]],
    index: NDArray[np.int64],
    passed: NDArray[np.float64],
    added: NDArray[np.float64],
) -> None:
    """Give some pixels the means of their rays that meet something, in place."""
    number = np.arange(SUBRAYS)
    du = (number + 0.5) / SUBRAYS - 0.5
    dv = (number * _LATTICE % SUBRAYS + 0.5) / SUBRAYS - 0.5
    for start in range(0, len(index), _PART // SUBRAYS):
        part = index[start : start + _PART // SUBRAYS]
        around = subpixel_directions(camera, part, du, dv)
        shape = (len(part), SUBRAYS)
        origins = rays.origins[part]
        table = Rays(np.repeat(origins, SUBRAYS, axis=0), around.reshape(-1, 3), shape)
        t = caster.cast(table)[2].reshape(shape)
        some = np.isfinite(t).any(axis=1)
        of_part = (source[0][part], source[1][part])
        mean_passed, mean_added = arrive(air, origins, around, t, of_part)
        passed[part[some]], added[part[some]] = mean_passed[some], mean_added[some]
