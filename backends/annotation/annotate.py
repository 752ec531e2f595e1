"""Annotation of whole pictures: first hits, and the passes that are made of them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import Pass, Picture, View
from scenec.backends.annotation.instances import FrameInstances, Instances
from scenec.backends.annotation.registry import select
from scenec.backends.camera.rays import camera_rays, ray_down
from scenec.backends.camera.tiles import bands
from scenec.backends.exact.caster import ExactCaster, Hits
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas.passes import AMODAL


@dataclass(frozen=True)
class Annotation:
    """All of a frame but ``rgb``.

    Attributes:
        arrays: Passes by name, [h, w] or [h, w, channels].
        seen: What it shows of instances (``schemas.instances``, ``schemas.amodal``), if it has that
            pass.
        height_m: From the camera straight down to the first surface; None where there is none.
        sky: Pixels that show no surface, and how many of those look below the horizontal plane
            and have a label of the sky all the same; None: not known.
        hits: First hits; None where they were not cast for this.
        seconds: That casting and the passes of the whole picture took, by name.
    """

    arrays: dict[str, NDArray[Any]]
    seen: FrameInstances | None
    height_m: float | None
    sky: tuple[int, int] | None = None
    hits: Hits | None = None
    seconds: dict[str, float] = field(default_factory=dict)


def annotate(
    scene: RenderScene,
    caster: ExactCaster,
    camera: Camera,
    passes: Sequence[str],
    sample: int,
    instances: Instances | None = None,
) -> Annotation:
    """Annotate a picture, every pixel cast, large ones band by band.

    Args:
        scene: The scene.
        caster: Of the scene; is posed at the sample.
        camera: Whose picture it is.
        passes: What to annotate, see ``registry.select``.
        sample: Time code.
        instances: Of the scene; made where they are needed, unless given.

    Raises:
        BackendError: A pass that is not known, or failed.
        CameraRefusedError: The camera has not what a pass needs.
    """
    caster.pose(sample)
    wanted = select(scene, passes)
    seconds: dict[str, float] = {}

    def timed[T](step: str, make: Callable[[], T]) -> T:
        start = time.perf_counter()
        made = make()
        seconds[step] = seconds.get(step, 0.0) + time.perf_counter() - start
        return made

    picture, sky = timed(
        "annotate", lambda: _cast(scene, caster, camera, sample, wanted, instances)
    )
    # Before the masks, which are made with it.
    seen = timed("instances", lambda: picture.seen) if "instance" in wanted else None
    arrays: dict[str, NDArray[Any]] = {}
    for name, one in wanted.items():
        made = timed(name if one.whole else "annotate", partial(picture.once, one.compute))
        if one.channels:
            arrays[name] = made.reshape(camera.height, camera.width, *made.shape[1:])
    height = float(caster.cast(ray_down(camera))[2][0])
    return Annotation(
        arrays, seen, height if math.isfinite(height) else None, sky, picture.hits, seconds
    )


def _cast(
    scene: RenderScene,
    caster: ExactCaster,
    camera: Camera,
    sample: int,
    wanted: Mapping[str, Pass],
    instances: Instances | None,
) -> tuple[Picture, tuple[int, int]]:
    """Casts a picture and counts its sky; with several tiles, computes passes of each."""
    more = camera, caster, AMODAL in wanted, instances
    parts = bands(camera)
    if len(parts) == 1:
        rays = camera_rays(camera)
        whole = Picture(scene, sample, caster.hits(rays), lambda: rays, *more)
        return whole, _sky(whole)
    n = camera.height * camera.width
    hits = Hits(np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n), caster.geometry)
    picture = Picture(scene, sample, hits, lambda: camera_rays(camera), *more)
    pixels_of_sky, below = 0, 0
    for rows in parts:
        pixels = slice(rows.start * camera.width, rows.stop * camera.width)
        band = _band(picture, rows)
        own = _sky(band)
        pixels_of_sky, below = pixels_of_sky + own[0], below + own[1]
        for name in ("row", "face", "t"):
            getattr(hits, name)[pixels] = getattr(band.hits, name)
        for one in wanted.values():
            if not one.whole:
                picture.put(one.compute, pixels, band.once(one.compute))
    return picture, (pixels_of_sky, below)


def _sky(view: View) -> tuple[int, int]:
    """Counts pixels of sky, and those of them below the horizon (``Annotation.sky``)."""
    scene, rays = view.scene, view.rays
    missed = view.hits.row < 0
    if rays.known is not None:
        missed &= rays.known
    maps = scene.sky_label_maps[view.sample] if scene.sky_label_maps else {}
    named = scene.sky_labels_below.keys() | maps.keys()
    if not any(number for level, number in scene.sky_labels.items() if level not in named):
        return int(missed.sum()), 0
    return int(missed.sum()), int((missed & (rays.directions[:, 2] < 0.0)).sum())


def _band(picture: Picture, rows: range) -> View:
    rays = camera_rays(picture.camera, rows)
    return View(picture.scene, picture.sample, picture.caster.hits(rays), lambda: rays)
