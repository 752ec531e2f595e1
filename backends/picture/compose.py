"""From a backend's surface light to the picture: sky and suns drawn once, by shared code.

No renderer shows the sky or a sun's disc, so none differs in them and none counts them twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import angle_between, camera_rays, subpixel_directions
from scenec.backends.camera.tiles import bands
from scenec.backends.contract import Radiance
from scenec.backends.picture.noise import (
    estimate,
    estimate_denoised,
    estimate_parts,
    sky_differs,
)
from scenec.backends.picture.sky import MIN_SUN_DIAMETER_RAD, Sky, combine, lookup
from scenec.backends.stage.scene import Camera, RenderScene, Sun
from scenec.backends.surface.gobo import passed
from scenec.schemas.records import ErrorEstimate

if TYPE_CHECKING:
    from scenec.backends.picture.haze import Veil

#: Sub-pixels per side at the rim of a sun's disc.
DISC_SUBPIXELS = 16


@dataclass(frozen=True)
class Picture:
    """Radiance with everything in it, and how far it is from converged.

    Attributes:
        rgb: Linear Rec.709 radiance, float32 [h, w, 3].
        noise: Its error, over all pixels that surfaces cover, from the two halves
            (``noise.estimate``). Of a denoised picture it is the error before denoising.
        denoised: Of a denoised picture its error (``noise.estimate_denoised``), or that it is
            unknown; None of any other.
    """

    rgb: NDArray[np.float32]
    noise: ErrorEstimate
    denoised: ErrorEstimate | None = None


def compose(
    radiance: Radiance,
    scene: RenderScene,
    camera: Camera,
    sample: int,
    veil: Veil | None = None,
) -> Picture:
    """Mean of the halves (denoised, if it was), plus (1 - coverage) * (sky + suns' discs).

    With haze, both halves are seen through it, so noise and its estimates shrink with what arrives
    of the surfaces' light, and are relative to the picture with airlight.

    Where radiance brings what is behind (``Radiance.background``) it is the mean of both together.
    Large pictures are composed by bands of rows: the same picture; its noise but for the order of
    sums.

    Args:
        radiance: What the renderer has.
        scene, camera, sample: For the sky behind it.
        veil: Haze before it, if there is any.
    """
    parts = bands(camera)
    after = None
    if radiance.denoised is not None:
        after = denoised_noise(_of_rows(radiance, veil, rows) for rows in parts)
    if len(parts) == 1:
        rgb = paint(radiance, scene, camera, sample, veil)
        halves, noisy = through(radiance, veil), noisy_pixels(radiance)
        return Picture(rgb, estimate(halves, noisy, radiance.stochastic), after)
    rgb = np.empty((camera.height, camera.width, 3), np.float32)
    for rows in parts:
        own, veiled = _of_rows(radiance, veil, rows)
        rgb[rows.start : rows.stop] = paint(own, scene, camera, sample, veiled, rows)

    def each() -> Iterator[tuple[NDArray[np.float64], NDArray[np.bool_]]]:
        for rows in parts:
            own, veiled = _of_rows(radiance, veil, rows)
            yield through(own, veiled), noisy_pixels(own)

    return Picture(rgb, estimate_parts(each, radiance.stochastic), after)


def denoised_noise(parts: Iterable[tuple[Radiance, Veil | None]]) -> ErrorEstimate:
    """Error of a denoised picture, by parts; unknown unless its halves were denoised apart."""

    def each() -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]]:
        for radiance, veil in parts:
            if radiance.denoised_halves is None:
                return
            clean = replace(radiance, halves=radiance.denoised_halves)
            yield through(clean, veil), through(radiance, veil), noisy_pixels(radiance)

    return estimate_denoised(each())


def _of_rows(radiance: Radiance, veil: Veil | None, rows: range) -> tuple[Radiance, Veil | None]:
    """What some rows have of either."""
    part = slice(rows.start, rows.stop)
    own = replace(
        radiance,
        halves=radiance.halves[:, part],
        coverage=radiance.coverage[part],
        denoised=None if radiance.denoised is None else radiance.denoised[part],
        denoised_halves=(
            None if radiance.denoised_halves is None else radiance.denoised_halves[:, part]
        ),
        background=None if radiance.background is None else radiance.background[:, part],
    )
    if veil is None:
        return own, None
    return own, replace(
        veil,
        transmittance=veil.transmittance[part],
        airlight=veil.airlight[part],
        behind=veil.behind[part],
        airlight_behind=veil.airlight_behind[part],
    )


def noisy_pixels(radiance: Radiance) -> NDArray[np.bool_]:
    """Pixels that estimates of noise are of, bool [h, w]: those with surfaces.

    With a background of its own also those where that differs between the halves.
    """
    covered = radiance.coverage > 0.0
    if radiance.background is not None:
        covered = covered | sky_differs(radiance.background)
    return covered


def through(radiance: Radiance, veil: Veil | None) -> NDArray[np.float64]:
    """The halves as haze lets them through, float64 [2, h, w, 3]; with a background of their own.

    What surfaces hide of the sky differs between the halves as their light does.
    """
    halves = radiance.halves.astype(np.float64)
    if radiance.background is not None:
        return halves + radiance.background
    if veil is None:
        return halves
    return veil.over(halves, radiance.coverage.astype(np.float64))


def paint(
    radiance: Radiance,
    scene: RenderScene,
    camera: Camera,
    sample: int,
    veil: Veil | None = None,
    rows: range | None = None,
) -> NDArray[np.float32]:
    """The picture of ``compose``, float32 [h, w, 3].

    Args:
        radiance, scene, camera, sample, veil: As for ``compose``.
        rows: Of the camera's picture, that ``radiance`` and ``veil`` are of; None: all.
    """
    if radiance.background is not None:
        halves = through(radiance, None)
        return np.asarray(0.5 * (halves[0] + halves[1]), np.float32)
    open_sky = 1.0 - radiance.coverage.astype(np.float64)
    if radiance.denoised is None:
        halves = through(radiance, veil)
        light = 0.5 * (halves[0] + halves[1])
    else:
        light = radiance.denoised.astype(np.float64)
        if veil is not None:
            light = veil.over(light, radiance.coverage.astype(np.float64))
    behind = background(scene, camera, sample, open_sky > 0.0, rows)
    if veil is not None:
        behind = veil.over_sky(behind)
    return np.asarray(light + open_sky[..., None] * behind, np.float32)


def background(
    scene: RenderScene,
    camera: Camera,
    sample: int,
    wanted: NDArray[np.bool_],
    rows: range | None = None,
    sky: Sky | None = None,
) -> NDArray[np.float64]:
    """Radiance of sky and suns behind the wanted pixels, float64 [h, w, 3]; 0 elsewhere.

    The sky is looked up at pixel centers; a sun's disc is uniform, E / (pi * sin(diameter/2)**2),
    and is averaged over the pixel. ``rows``: of the picture, that ``wanted`` is of; None: all.
    ``sky``: of the sample's domes, where it is combined already.
    """
    rows = range(camera.height) if rows is None else rows
    out = np.zeros((len(rows) * camera.width, 3))
    index = np.flatnonzero(wanted.ravel())
    lighting = scene.lighting[sample]
    if len(index) == 0 or not (lighting.domes or lighting.suns):
        return out.reshape(len(rows), camera.width, 3)
    rays = camera_rays(camera, rows)
    if rays.known is not None:
        # Outside of the image circle it is black.
        index = index[rays.known[index]]
    directions = rays.directions[index]
    sky = combine(lighting.domes) if sky is None else sky
    if sky is not None:
        out[index] = lookup(sky, directions)
    for sun in lighting.suns:
        pixels = index + rows.start * camera.width
        near, fraction = disc_fraction(sun, camera, directions, pixels)
        half = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
        disc = np.asarray(sun.irradiance) / (np.pi * np.sin(half) ** 2)
        disc *= passed(sun, camera.camera_to_world[None, :3, 3])
        out[index[near]] += fraction[:, None] * disc
    return out.reshape(len(rows), camera.width, 3)


def disc_fraction(
    sun: Sun, camera: Camera, directions: NDArray[np.float64], index: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which of some pixels a sun's disc may touch, and what fraction of each it fills.

    Args:
        sun, camera: Which.
        directions: Rays through the pixels' centers, float64 [n, 3].
        index: Which pixels they are, row-major, int64 [n].

    Returns:
        (which of them, int64 [k]; fractions, float64 [k]).
    """
    half = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
    away = angle_between(directions, sun.to_light)
    # Where a lens magnifies least a pixel may be larger than at the axis: its corners say.
    k = camera.intrinsics
    wide = 0.75 / min(k[0, 0], k[1, 1]) * (1.0 + abs(k[0, 1] / k[1, 1]))
    near = np.flatnonzero(away <= half + max(0.1, 8.0 * wide))
    if len(near):
        corners = subpixel_directions(camera, index[near], *_within_pixel(np.array([-0.5, 0.5])))
        spread = np.stack([angle_between(corners[:, i], directions[near]) for i in range(4)]).max(
            axis=0
        )
        near = near[away[near] <= half + 1.5 * spread]
    places = _within_pixel((np.arange(DISC_SUBPIXELS) + 0.5) / DISC_SUBPIXELS - 0.5)
    fractions = np.empty(len(near))
    for start in range(0, len(near), 1024):
        rays = subpixel_directions(camera, index[near[start : start + 1024]], *places)
        fractions[start : start + 1024] = (angle_between(rays, sun.to_light) <= half).mean(axis=1)
    return near, fractions


def _within_pixel(steps: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Columns and rows of a square lattice from a pixel's center, float64 [n^2] each."""
    dv, du = np.meshgrid(steps, steps, indexing="ij")
    return du.ravel(), dv.ravel()
