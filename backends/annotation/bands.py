"""Annotation of whole pictures, band by band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.annotate import annotate as annotate_rays
from scenec.backends.camera.rays import camera_rays
from scenec.backends.camera.tiles import bands
from scenec.backends.exact.caster import ExactCaster, Hits
from scenec.backends.stage.scene import Camera, RenderScene


def annotate(
    scene: RenderScene,
    caster: ExactCaster,
    camera: Camera,
    passes: Sequence[str],
    sample: int,
) -> tuple[Hits, dict[str, NDArray]]:
    """First hits and annotation of a picture, every pixel cast, band by band.

    Args:
        scene: The scene.
        caster: Posed as at the sample.
        camera: Whose picture it is.
        passes: What to annotate, see ``annotate.annotate``.
        sample: Time code.

    Returns:
        First hits of the whole picture, and arrays as ``annotate.annotate`` returns them.
    """
    parts = bands(camera)
    if len(parts) == 1:
        rays = camera_rays(camera)
        hits = caster.hits(rays)
        return hits, annotate_rays(scene, hits, rays, passes, sample)
    n = camera.height * camera.width
    whole = Hits(np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n), caster.geometry)
    arrays: dict[str, NDArray] = {}
    for rows in parts:
        rays = camera_rays(camera, rows)
        hits = caster.hits(rays)
        pixels = slice(rows.start * camera.width, rows.stop * camera.width)
        whole.row[pixels], whole.face[pixels], whole.t[pixels] = hits.row, hits.face, hits.t
        for name, values in annotate_rays(scene, hits, rays, passes, sample).items():
            if name not in arrays:
                arrays[name] = np.empty((camera.height, *values.shape[1:]), values.dtype)
            arrays[name][rows.start : rows.stop] = values
    return whole, arrays
