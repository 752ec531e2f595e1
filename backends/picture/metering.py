"""Meters a scene's light: estimates radiance by a few paths of the exact caster.

An exposure must not depend on who draws the picture, on which frames are drawn, or on their noise;
so it does not look at pictures. A camera's rays are cast, one anywhere in each cell of a coarse
grid, so that what is thinner than a cell counts by its area, wherever it lies. From each hit goes a
path of diffuse reflections: at each of its points the light of suns, lamps and sky is gathered
through shadow rays (next event estimation). The numbers that choose directions have one fixed key.
A thing that takes the share p of all pictures that are metered is missed with a chance of
exp(-12288 p): what takes a thousandth, 5 times in a million.

The surfaces are those of ``surface.points``: glossy lobes scatter like diffuse ones, since a
highlight is what a meter should not heed. Left out is the size of suns and lamps, too. What that
costs against the pictures of renderers is measured in ``docs/sensors.md``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import rays_at
from scenec.backends.camera.tiles import coarse
from scenec.backends.contract import BOUNCES, Rays
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.noise_seeds import metering_paths, metering_places
from scenec.backends.picture.airlight import ambient, arrive
from scenec.backends.picture.haze import Hazy
from scenec.backends.picture.sky import Sky, combine, lookup, texel_directions
from scenec.backends.stage.scene import (
    Camera,
    Lamp,
    RenderScene,
)
from scenec.backends.surface import lamps
from scenec.backends.surface.algebra import FLOAT64
from scenec.backends.surface.gobo import passed
from scenec.backends.surface.points import SurfacePoints, surface_points
from scenec.schemas.picture import luminance

#: Directions to the sky at the first hit; one at later ones.
_SKY_RAYS = 8
#: Rows of the lat-long picture that directions to the sky are drawn from, 1.4 degrees each.
_SKY_ROWS = 128


@dataclass(frozen=True)
class Metering:
    """Holds luminance along a camera's rays, [W/(m^2 sr)], without the suns' discs.

    Attributes:
        surfaces: Of rays that hit one, float64 [n].
        sky: Of the others, float64 [m].
    """

    surfaces: NDArray[np.float64]
    sky: NDArray[np.float64]


def look(
    scene: RenderScene,
    caster: ExactCaster,
    camera: Camera,
    sample: int,
    rays: int,
    hazy: Hazy | None = None,
) -> Metering:
    """Estimate what a camera sees at a sample.

    Args:
        scene: The stage.
        caster: Its caster; left posed as at the sample.
        camera: The camera at the sample.
        sample: Time code.
        rays: About how many rays of the camera are cast.
        hazy: Its haze, if it has any.
    """
    caster.pose(sample)
    paths = _Paths(scene, caster, sample, hazy)
    table = _spread(camera, rays, sample)
    known = np.ones(len(table.origins), np.bool_) if table.known is None else table.known
    table = Rays(table.origins[known], table.directions[known], (int(known.sum()), 1))
    surfaces, hit = paths.radiance(table)
    sky = np.zeros((int((~hit).sum()), 3))
    if paths.sky is not None:
        sky = lookup(paths.sky, table.directions[~hit]).astype(np.float64)
    return Metering(luminance(surfaces), luminance(sky))


def _spread(camera: Camera, rays: int, sample: int) -> Rays:
    """Draws about so many rays, one anywhere in each cell of a grid, others at each sample."""
    cells = coarse(camera, rays)
    jitter = metering_places(sample).random((2, cells.height, cells.width))
    u = (np.arange(cells.width) + jitter[0]) * (camera.width / cells.width)
    v = (np.arange(cells.height)[:, None] + jitter[1]) * (camera.height / cells.height)
    return rays_at(camera, u.ravel(), v.ravel())


class _Paths:
    """A scene at one sample, as paths meet it."""

    def __init__(
        self, scene: RenderScene, caster: ExactCaster, sample: int, hazy: Hazy | None
    ) -> None:
        lighting = scene.lighting[sample] if hazy is None else hazy.lighting(sample)
        self.sky = combine(lighting.domes)
        self._caster = caster
        self._suns = lighting.suns
        self._lamps = lighting.lamps
        self._dome = None if self.sky is None else _Dome(self.sky)
        self._air = None if hazy is None else hazy.air(sample)
        self._points = partial(surface_points, scene, scene.rows_at(sample))
        self._random = metering_paths(sample)

    def radiance(self, rays: Rays) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Radiance along rays that hit something, float64 [n, 3], and which ones do."""
        row, face, t = self._caster.cast(rays)
        hit = np.isfinite(t)
        origins, directions, t = rays.origins[hit], rays.directions[hit], t[hit]
        points = self._points(origins, directions, (row[hit], face[hit], t))
        light = points.emission + self._direct(points, _SKY_RAYS)
        alive, weight = np.arange(len(t)), np.ones((len(t), 3))
        for _ in range(BOUNCES):
            # By the cosine, which cancels: pi times the BRDF is what is left.
            ways, chance = self._bounces(points)
            cosine = np.maximum(np.abs((points.normal * ways).sum(axis=1)), 1e-12)[:, None]
            weight = weight * (np.pi / cosine) * points.shown(ways) / chance
            rays = points.rays(ways)
            row, face, far = self._caster.cast(rays)
            on = np.isfinite(far) & (weight > 0.0).any(axis=1)
            if not on.any():
                break
            alive, weight = alive[on], weight[on]
            starts = rays.origins[on]
            points = self._points(starts, ways[on], (row[on], face[on], far[on]))
            light[alive] += weight * (points.emission + self._direct(points, 1))
        if self._air is not None:
            glow = ambient(self._air, directions)
            passed, shown = arrive(self._air, origins, directions[:, None], t[:, None], glow)
            light = light * passed + shown
        return light, hit

    def _direct(self, points: SurfacePoints, sky_rays: int) -> NDArray[np.float64]:
        """Sums the light reflected of suns, lamps and sky, float64 [k, 3]."""
        out = np.zeros(points.at.shape)
        for sun in self._suns:
            ways = np.broadcast_to(sun.to_light, points.at.shape)
            light = sun.irradiance * passed(sun, points.at)[:, None]
            out += self._unshaded(points, points.shown(ways) * light, ways, np.inf)
        if self._lamps:
            out += self._lamplight(points)
        if self._dome is not None and self._dome.total > 0.0:
            for k in range(sky_rays):
                # One of each part of the sky, from its top down.
                u = (k + self._random.random(len(out))) / sky_rays
                ways, light = self._dome.draw(u)
                lit = points.shown(ways) * light
                out += self._unshaded(points, lit, ways, np.inf) / sky_rays
        return out

    def _lamplight(self, points: SurfacePoints) -> NDArray[np.float64]:
        """One of the lamps, drawn by what each would give if nothing stood before it."""
        each = np.stack([_irradiance(lamp, points.at) for lamp in self._lamps], axis=1)
        strength = luminance(each)
        sums = np.cumsum(strength, axis=1)
        total = sums[:, -1]
        drawn = self._random.random(len(total)) * total
        which = np.minimum((sums <= drawn[:, None]).sum(axis=1), len(self._lamps) - 1)
        k = np.arange(len(total))
        chance = np.where(strength[k, which] > 0.0, strength[k, which], 1.0)
        ways = np.stack([lamp.position for lamp in self._lamps])[which] - points.at
        length = np.sqrt((ways * ways).sum(axis=1))[:, None]
        units = ways / np.where(length > 0.0, length, 1.0)
        light = each[k, which] * (total / chance)[:, None]
        return self._unshaded(points, points.shown(units) * light, ways, 1.0)

    def _unshaded(
        self, points: SurfacePoints, lit: NDArray[np.float64], ways: NDArray[np.float64], end: float
    ) -> NDArray[np.float64]:
        """Light where nothing stands between a point and ``end`` ways from it; 0 elsewhere."""
        index = np.flatnonzero((lit > 0.0).any(axis=1))
        out = np.zeros(lit.shape)
        t = self._caster.cast(points.rays(ways), index)[2]
        free = index[t >= end]
        out[free] = lit[free]
        return out

    def _bounces(self, points: SurfacePoints) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Samples directions by the cosine (Malley), [k, 3], and their side's probability, [k, 1].

        Of sheets, each side about as often as it shows more light.
        """
        normals = points.normal
        u = self._random.random((len(normals), 2))
        turn, radius = 2.0 * np.pi * u[:, :1], np.sqrt(u[:, 1:])
        # An axis across the normal: of the world's the one that is farthest from it.
        least = np.argmin(np.abs(normals), axis=1)
        across = np.cross(normals, np.eye(3)[least])
        across /= np.sqrt((across * across).sum(axis=1))[:, None]
        flat = np.cos(turn) * across + np.sin(turn) * np.cross(normals, across)
        ways = np.asarray(radius * flat + np.sqrt(1.0 - u[:, 1:]) * normals)
        chance = np.ones((len(ways), 1))
        if points.through.any():
            passed, kept = (luminance(part)[:, None] for part in (points.through, points.diffuse))
            whole = passed + kept
            # Never all of them: other laws than Lambert's are not in ``diffuse``.
            share = np.minimum(passed / np.where(whole > 0.0, whole, 1.0), 0.5)
            behind = self._random.random(chance.shape) < share
            up = (ways * normals).sum(axis=1, keepdims=True)
            ways = np.where(behind, ways - 2.0 * up * normals, ways)
            chance = np.where(behind, share, 1.0 - share)
        return ways, chance


def _irradiance(lamp: Lamp, at: NDArray[np.float64]) -> NDArray[np.float64]:
    """On surfaces that face a lamp, as if it were a point, float64 [k, 3]."""
    offset = at - lamp.position
    squared = (offset * offset).sum(axis=1)
    outside = squared > lamp.radius_m * lamp.radius_m
    squared = np.where(outside, squared, 1.0)
    away = (offset / np.sqrt(squared)[:, None]).T
    share = lamps.falloff(FLOAT64, away, lamp.axis[:, None], lamps.cone(lamp))
    return np.asarray(np.where(outside, share / squared, 0.0)[:, None] * lamp.intensity)


class _Dome:
    """A sky to draw directions from, by the luminance that comes from there.

    Attributes:
        total: Luminance over all directions, times their solid angle.
    """

    def __init__(self, sky: Sky) -> None:
        picture = sky.picture.astype(np.float64)
        if sky.constant:
            picture = np.broadcast_to(picture, (_SKY_ROWS // 4, _SKY_ROWS // 2, 3))
        # Means over blocks of texels; what does not fill a block at the right or below is left.
        side = max(1, picture.shape[0] // _SKY_ROWS)
        height, width = (size // side for size in picture.shape[:2])
        blocks = picture[: height * side, : width * side].reshape(height, side, width, side, 3)
        picture = blocks.mean(axis=(1, 3))
        rows = -np.diff(np.cos(np.arange(height + 1) * (np.pi / height)))
        level = luminance(picture)
        self._sums = np.cumsum((level * rows[:, None]).ravel())
        self.total = float(self._sums[-1]) * 2.0 * np.pi / width
        colors = picture / np.where(level > 0.0, level, 1.0)[..., None]
        self._colors = colors.reshape(-1, 3)
        self._directions = (texel_directions(height, width) @ sky.to_world.T).reshape(-1, 3)

    def draw(self, u: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Unit vectors [k, 3] and radiance over their density [k, 3], from numbers in [0, 1)."""
        which = np.searchsorted(self._sums, u * self._sums[-1], side="right")
        which = np.minimum(which, len(self._sums) - 1)
        return self._directions[which], self.total * self._colors[which]
