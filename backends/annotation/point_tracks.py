"""Points on surfaces, followed through the pictures of a camera.

A point is what a ray through a place in a picture meets first. It is kept in the frame of the row
that it lies on, and is as exact as that row's matrices: float64. Projection and visibility are
those of the passes ``flow`` and ``occlusion`` (``correspondence.sight_of``).

Which pixels are taken is a matter of random numbers counted by pixel and sample: those with the
lowest ones, of each stratum in turn. So more points are the same ones and some beside.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import View
from scenec.backends.annotation.correspondence import anchored, placed, sight_of
from scenec.backends.annotation.passes import instance, label, position
from scenec.backends.camera.rays import rays_at
from scenec.backends.camera.tiles import bands
from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.imaging.chance import philox, unit
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas.correspondence import NOTHING
from scenec.schemas.kernels import kernel
from scenec.schemas.point_tracks import TrackOptions, TrackPoints, TrackSights
from scenec.schemas.threads import over_threads

_HALF = np.uint64(32)
#: What a counter of random numbers is of.
_PIXEL, _STRATUM = np.uint64(0), np.uint64(1)


@kernel
def _random(first, last, numbers, key, sample, what, places, order):  # type: ignore[no-untyped-def]
    """Of pixels, or strata: where in the pixel, [n, 2] in (0, 1), and in which order, [n]."""
    for k in range(first, last):
        w = philox(key, numbers[k], sample, what, np.uint64(0))
        places[k, 0], places[k, 1] = unit(w[0]), unit(w[1])
        order[k] = (w[2] << _HALF) | w[3]


def _draw(
    numbers: NDArray[np.integer], sample: int, asked: TrackOptions, camera: Camera, what: np.uint64
) -> tuple[NDArray[np.float64], NDArray[np.uint64]]:
    places, order = np.empty((len(numbers), 2)), np.empty(len(numbers), np.uint64)
    key = np.uint64(asked.key(camera.name))
    of = numbers.astype(np.uint64)
    over_threads(_random, len(of), of, key, np.uint64(sample), what, places, order)
    if asked.places == "centers":
        places[:] = 0.5
    return places, order


def choose_points(
    scene: RenderScene,
    caster: ExactCaster,
    camera: Camera,
    sample: int,
    count: int,
    asked: TrackOptions,
) -> TrackPoints:
    """Chooses points in a picture; fewer than asked for where that shows so few.

    Args:
        scene: The stage.
        caster: Of the stage; is posed at the sample.
        camera: Whose picture it is, as at the sample.
        sample: Time code.
        count: How many.
        asked: How.
    """
    caster.pose(sample)
    pixels = _pixels(scene, caster, camera, sample, count, asked)
    rays, pixel, _ = _rays(camera, pixels, sample, asked)
    view = View(scene, sample, caster.hits(rays), lambda: rays)
    hits = view.hits
    return TrackPoints(
        sample=np.full(len(pixels), sample, np.int64),
        pixel=pixel,
        row=hits.row,
        face=hits.face,
        anchor=anchored(scene, position(view), hits.row, sample),
        instance=instance(view),
        labels={level: label(view, level) for level in scene.levels},
    )


def follow_points(
    scene: RenderScene, caster: ExactCaster, camera: Camera, sample: int, points: TrackPoints
) -> TrackSights:
    """Finds points in a picture.

    Args:
        scene: The stage.
        caster: Of the stage; is posed at the sample.
        camera: Whose picture it is, as at the sample.
        sample: Time code.
        points: Of the stage.
    """
    caster.pose(sample)
    places, row, gone = placed(scene, points.anchor, (points.row, points.face), sample)
    sight = sight_of(caster, camera, places, (row, points.face), gone)
    nowhere = sight.code == NOTHING
    pixel, depth = sight.pixel.copy(), sight.local[:, 2].copy()
    places = places.copy()
    places[nowhere], depth[nowhere] = np.nan, np.nan
    return TrackSights(pixel, places, depth, sight.code.astype(np.uint8), sight.undecided)


def _rays(
    camera: Camera, pixels: NDArray[np.int64], sample: int, asked: TrackOptions
) -> tuple[Rays, NDArray[np.float64], NDArray[np.uint64]]:
    """Rays through a place in each of some pixels, the places, and the order of the pixels."""
    places, order = _draw(pixels, sample, asked, camera, _PIXEL)
    pixel = np.stack([pixels % camera.width, pixels // camera.width], axis=1) + places
    return rays_at(camera, pixel[:, 0], pixel[:, 1]), pixel, order


def _pixels(
    scene: RenderScene,
    caster: ExactCaster,
    camera: Camera,
    sample: int,
    count: int,
    asked: TrackOptions,
) -> NDArray[np.int64]:
    """The pixels that points are chosen in: of each stratum in turn, those of the lowest order."""
    if not count:
        return np.empty(0, np.int64)
    found: list[tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.uint64]]] = []
    for rows in bands(camera):
        every = np.arange(rows.start * camera.width, rows.stop * camera.width)
        rays, _, order = _rays(camera, every, sample, asked)
        rays = replace(rays, shape=(len(rows), camera.width))
        view = View(scene, sample, caster.hits(rays), partial(_same, rays))
        hit = view.hits.row >= 0
        found.append((every[hit], _strata(view, asked)[hit], order[hit]))
    pixels, strata, order = (np.concatenate(parts) for parts in zip(*found, strict=True))
    names, stratum = np.unique(strata, return_inverse=True)
    by = np.lexsort((order, stratum))
    starts = np.searchsorted(stratum[by], np.arange(len(names)))
    rank = np.empty(len(pixels), np.int64)
    rank[by] = np.arange(len(pixels)) - starts[stratum[by]]
    turn = _draw(names, sample, asked, camera, _STRATUM)[1]
    taken = np.flatnonzero(rank < count)
    return pixels[taken[np.lexsort((turn[stratum[taken]], rank[taken]))[:count]]]


def _same(rays: Rays) -> Rays:
    return rays


def _strata(view: View, asked: TrackOptions) -> NDArray[np.uint32]:
    if asked.strata == "none":
        return np.zeros(len(view.hits.row), np.uint32)
    if asked.strata == "instance":
        return instance(view)
    return label(view, asked.strata.removeprefix("label."))
