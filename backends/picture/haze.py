"""Haze before surfaces and sky, and the light within it: the same for all renderers.

Light L of a surface, or of the sky, arrives as L * T + A: T = exp(-t), t the optical depth along
the ray (Beer and Lambert), and A the airlight, what haze on the way scatters toward the camera;
both follow from exact distances as ``airlight`` defines them. What a sky's picture shows below the
horizon is ground at the height of the floor, under the light that comes down to it.

Renderers light surfaces with what comes through haze: suns weakened as on their way to
one height, and a sky as it is seen from there, weakened and with its airlight (``Hazy.lit``). So
shadows soften by as much as the layer scatters. That height is the median of what cameras see; what
is approximated is that light is that of this height everywhere. What is left out: surfaces cast no
shadows into haze, and the light of lamps is not weakened.

T and A are those of the pixel's center. Where T changes within the 3x3 window they are means over
the pixel of what is linear between centers, and where it changes most means over several rays, of
those that meet something. A renderer's pixel is one number, so all of its light is weakened alike
there: the error is the covariance of L and T in the pixel, and 0 where either is constant (measured
in ``tests/backends/picture/test_haze.py``). What meets none of the nine centers, as a wire
between two rows of pixels does, is weakened as what is behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays, subpixel_directions
from scenec.backends.camera.tiles import coarse
from scenec.backends.contract import Rays
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.picture.airlight import (
    FAR_M,
    Air,
    air_of,
    ambient,
    arrive,
    depth_above,
    sine_of,
)
from scenec.backends.picture.sky import Sky, combine, lookup, texel_directions
from scenec.backends.stage.scene import UPRIGHT, Camera, Dome, Lighting, RenderScene
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: What a backend's ``losses`` say of a stage with haze.
LOSS = (
    "haze: light on surfaces is that of one height, the median of what cameras see; lamps are not "
    "weakened on their way to surfaces; surfaces of several distances in one pixel are weakened "
    "alike"
)
#: The same of one whose suns shine through pictures as well.
GOBO_LOSS = "haze: shadows of clouds are not seen in it, their mean is"
#: Rays in a pixel where its transmittance changes most: a lattice, no two in one column or row.
SUBRAYS = 4
_LATTICE = (1, 3, 0, 2)
#: Such rays for each pixel of a picture, at most.
_SHARE = 0.125
#: Second difference of transmittance from which on it changes: an 8-bit step.
_STEP = 1.0 / 256.0
#: Rays that are cast, or go through haze, at once.
_PART = 1 << 20
#: Rows of the lattice on which haze before a sky is computed for light: 0.7 degrees.
_ROWS = 256
#: Samples of a batch, and rays of each camera at them, that tell which heights cameras see.
_SAMPLES, _RAYS = 32, 108


@dataclass(frozen=True)
class Veil:
    """What haze does to the pixels of one picture.

    Attributes:
        transmittance: Part of a surface's light that arrives, float64 [h, w, 3].
        airlight: Radiance that haze adds before surfaces, float64 [h, w, 3].
        behind: As ``transmittance``, of what is behind surfaces; 1 where they hide it.
        airlight_behind: As ``airlight``, likewise.
        subsampled: Pixels in which several rays were cast.
        changing: Pixels where transmittance changes within, as their neighbors tell.
    """

    transmittance: NDArray[np.float64]
    airlight: NDArray[np.float64]
    behind: NDArray[np.float64]
    airlight_behind: NDArray[np.float64]
    subsampled: int
    changing: int = 0

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
        """The sky's picture and suns' discs seen through it, [h, w, 3]."""
        return radiance * self.behind + self.airlight_behind


def air_at(scene: RenderScene, sample: int) -> Air | None:
    """The haze of a sample; None without any."""
    haze = scene.haze[sample] if scene.haze else None
    if haze is None:
        return None
    floor = float(scene.bounds[0, 2]) if haze.floor_m is None else haze.floor_m
    lighting = scene.lighting[sample]
    return air_of(haze, lighting.suns, combine(lighting.domes), floor)


class Hazy:
    """The haze of a stage, and its light within it.

    Args:
        scene: A stage with haze.
        caster: Its caster; left posed as at the first sample.

    Attributes:
        height_m: World height that surfaces are lit as at.
    """

    def __init__(self, scene: RenderScene, caster: ExactCaster) -> None:
        self._scene = scene
        self._last: tuple[int, Air | None] = (-1, None)
        caster.pose(0)
        self.height_m = _seen_height(scene, caster)

    def air(self, sample: int) -> Air | None:
        """The haze of a sample; None without any. Kept until another one's is."""
        if self._last[0] != sample:
            self._last = sample, air_at(self._scene, sample)
        return self._last[1]

    def lit(self) -> RenderScene:
        """The stage, its surfaces lit as within haze; pictures of skies are made when needed."""
        lighting = tuple(self.lighting(i) for i in range(self._scene.samples))
        return replace(self._scene, lighting=lighting)

    def lighting(self, sample: int) -> Lighting:
        """Light as it arrives at the height, at a sample."""
        outside = self._scene.lighting[sample]
        haze = self._scene.haze[sample]
        if haze is None:
            return outside
        depth = depth_above(haze, self.height_m)
        suns = tuple(
            replace(sun, irradiance=sun.irradiance * np.exp(-depth / sine_of(sun)))
            for sun in outside.suns
        )
        to_world = UPRIGHT
        if any(dome.texture is not None for dome in outside.domes):
            # The frame that domes are combined in.
            only = outside.domes if len(outside.domes) == 1 else (combine(outside.domes),)
            assert only[0] is not None
            to_world = only[0].to_world
        dome = Dome(lambda: self._sky_within(sample), np.ones(3), to_world)
        return replace(outside, suns=suns, domes=(dome,))

    def _sky_within(self, sample: int) -> NDArray[np.float32]:
        """The sky as it is seen from the height, float32 [h, w, 3]."""
        air = self.air(sample)
        assert air is not None
        sky = combine(self._scene.lighting[sample].domes)
        frame = UPRIGHT if sky is None or sky.constant else sky.to_world
        to = (texel_directions(_ROWS, 2 * _ROWS) @ frame.T).reshape(-1, 3)
        eyes = np.broadcast_to(np.array([0.0, 0.0, self.height_m]), to.shape)
        passed, glow = (
            part.reshape(_ROWS, 2 * _ROWS, 3).astype(np.float32) for part in _behind(air, eyes, to)
        )
        if sky is None:
            return np.asarray(glow)
        if sky.constant:
            return np.asarray(sky.picture * passed + glow, np.float32)
        own = texel_directions(*sky.picture.shape[:2]).reshape(-1, 3)
        between = [lookup(Sky(part, np.eye(3)), own) for part in (passed, glow)]
        between = [part.reshape(sky.picture.shape) for part in between]
        return np.asarray(sky.picture * between[0] + between[1], np.float32)


def _seen_height(scene: RenderScene, caster: ExactCaster) -> float:
    """Median height of what cameras see; of the scene's middle where they see nothing."""
    heights = []
    count = min(_SAMPLES, scene.samples)
    for k in range(count):
        for camera in scene.cameras[k * scene.samples // count]:
            rays = camera_rays(coarse(camera, _RAYS))
            t = caster.cast(rays)[2]
            hit = np.isfinite(t)
            heights.append(rays.origins[hit, 2] + t[hit] * rays.directions[hit, 2])
    seen = np.concatenate(heights) if heights else np.zeros(0)
    return float(np.median(seen)) if len(seen) else float(scene.bounds[:, 2].mean())


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
        edges: Whether what changes within a pixel is averaged.
    """
    passed, added = _through(air, rays.origins, rays.directions[:, None], t[:, None])
    hit, covered = np.isfinite(t).reshape(rays.shape), coverage > 0.0
    passed, added, changes = _between_centers(passed, added, hit, covered, edges)
    index = np.zeros(0, np.int64)
    changing = 0
    if edges:
        index = np.flatnonzero(changes.ravel() > _STEP)
        changing = len(index)
        most = int(_SHARE * len(t)) // SUBRAYS
        if len(index) > most:
            order = np.argsort(-changes.ravel()[index], kind="stable")
            index = np.sort(index[order[:most]])
        _refine(air, camera, caster, rays, index, passed, added)
    behind, before = np.ones_like(passed), np.zeros_like(added)
    open_sky = np.flatnonzero(coverage.ravel() < 1.0)
    behind[open_sky], before[open_sky] = _behind(
        air, rays.origins[open_sky], rays.directions[open_sky]
    )
    if rays.known is not None:
        # Outside of the image circle it is black.
        passed[~rays.known] = behind[~rays.known] = 1.0
        added[~rays.known] = before[~rays.known] = 0.0
    passed, added, behind, before = (
        part.reshape(*rays.shape, 3) for part in (passed, added, behind, before)
    )
    return Veil(passed, added, behind, before, len(index), changing)


def _through(
    air: Air,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    t: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """As ``arrive``, with the light around each bundle's first ray, which takes much memory."""
    out = np.empty((2, len(t), 3))
    for start in range(0, len(t), _PART):
        part = slice(start, start + _PART)
        glow = ambient(air, directions[part, 0])
        out[:, part] = arrive(air, origins[part], directions[part], t[part], glow)
    return out[0], out[1]


def _behind(
    air: Air,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What arrives of a sky's picture, and the airlight before it, float64 [n, 3].

    Below the horizon it is ground at the height of the floor.
    """
    down = directions[:, 2] < 0.0
    t = np.full(len(directions), FAR_M)
    t[down] = np.maximum(origins[down, 2] - air.floor_m, 0.0) / -directions[down, 2]
    passed, added = _through(air, origins, directions[:, None], np.minimum(t, FAR_M)[:, None])
    passed[down] *= air.dimming
    return passed, added


def _between_centers(
    passed: NDArray[np.float64],
    added: NDArray[np.float64],
    hit: NDArray[np.bool_],
    covered: NDArray[np.bool_],
    edges: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Means over pixels of what is linear between centers, and how much it changes there.

    Args:
        passed, added: At centers, float64 [n, 3].
        hit: Which of them meet something, bool [h, w].
        covered: Where a renderer did.
        edges: Whether pixels whose centers hit get means, too, where transmittance changes.

    Returns:
        float64 [n, 3] each; and the largest second difference of transmittance along a row, a
        column or a diagonal, float64 [h, w]. What lies on a slope is at the pixel's center as on
        the pixel's mean, and is no change.
    """
    out = np.empty((2, *hit.shape, 3))
    changes = np.zeros(hit.shape)
    values = np.stack([passed, added]).reshape(out.shape)
    over_threads(_window, hit.shape[0], values, hit, covered, edges, out, changes)
    return out[0].reshape(-1, 3), out[1].reshape(-1, 3), changes


@kernel
def _window(first, last, values, hit, covered, edges, out, changes):  # type: ignore[no-untyped-def]
    height, width = hit.shape
    for v in range(first, last):
        for u in range(width):
            for c in range(3):
                out[0, v, u, c] = values[0, v, u, c]
                out[1, v, u, c] = values[1, v, u, c]
            if not (hit[v, u] or covered[v, u]):
                continue
            if hit[v, u]:
                if not edges:
                    continue
                most = 0.0
                for way in range(4):
                    dv, du = (0, 1, 1, 1)[way], (1, 0, 1, -1)[way]
                    for c in range(3):
                        bend = 0.0
                        for sign in (-1, 1):
                            y, x = v + sign * dv, u + sign * du
                            # Beyond the border and in the sky it counts as it is here.
                            if 0 <= y < height and 0 <= x < width and hit[y, x]:
                                bend += values[0, y, x, c] - values[0, v, u, c]
                        most = max(most, abs(bend))
                changes[v, u] = most
                if most <= _STEP:
                    continue
            total = 0.0
            lowest, highest = 1.0, 0.0
            for c in range(3):
                out[0, v, u, c] = 0.0
                out[1, v, u, c] = 0.0
            for dv in range(-1, 2):
                for du in range(-1, 2):
                    y, x = v + dv, u + du
                    if not (0 <= y < height and 0 <= x < width and hit[y, x]):
                        continue
                    # A line's mean over the middle of three: 1, 6 and 1 eighths.
                    weight = (6.0 if dv == 0 else 1.0) * (6.0 if du == 0 else 1.0)
                    total += weight
                    for c in range(3):
                        lowest = min(lowest, values[0, y, x, c])
                        highest = max(highest, values[0, y, x, c])
                        out[0, v, u, c] += weight * values[0, y, x, c]
                        out[1, v, u, c] += weight * values[1, y, x, c]
            for c in range(3):
                out[0, v, u, c] = out[0, v, u, c] / total if total > 0.0 else 1.0
                out[1, v, u, c] = out[1, v, u, c] / total if total > 0.0 else 0.0
            if not hit[v, u]:
                # A renderer alone has met something: of what is beside it, if anything is.
                changes[v, u] = highest - lowest if total > 0.0 else 2.0


def _refine(
    air: Air,
    camera: Camera,
    caster: ExactCaster,
    rays: Rays,
    index: NDArray[np.int64],
    passed: NDArray[np.float64],
    added: NDArray[np.float64],
) -> None:
    """Give some pixels the means of their rays that meet something, in place."""
    du = (np.arange(SUBRAYS) + 0.5) / SUBRAYS - 0.5
    dv = (np.array(_LATTICE) + 0.5) / SUBRAYS - 0.5
    for start in range(0, len(index), _PART // SUBRAYS):
        part = index[start : start + _PART // SUBRAYS]
        around = subpixel_directions(camera, part, du, dv)
        shape = (len(part), SUBRAYS)
        origins = rays.origins[part]
        table = Rays(np.repeat(origins, SUBRAYS, axis=0), around.reshape(-1, 3), shape)
        t = caster.cast(table)[2].reshape(shape)
        some = np.isfinite(t).any(axis=1)
        mean_passed, mean_added = _through(air, origins, around, t)
        passed[part[some]], added[part[some]] = mean_passed[some], mean_added[some]
