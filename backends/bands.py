"""Large pictures part by part, so that memory grows with what is kept of a pixel and no more.

Annotation goes by bands of whole rows. Rays are those of the picture's own camera
(``rays.camera_rays``), each the same to the bit as in one piece. Renderers that draw cameras, not
rays, are given a ``crop``: the band, with the principal point moved. Windows of 3x3 pixels see one
row beyond their band (``settle``'s ``core``). Radiance goes by tiles with noise of their own. Of a
picture that is no larger than one band nothing of this is done.

Whole pictures are still held for: the sums of sub-frames; rays where haze, measured depth, flow,
disparity or the table of instances through a lens need them; denoising, which knows no borders;
rounds to a target.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.compose import Picture, noisy_pixels, paint, through
from scenec.backends.compose import compose as compose_whole
from scenec.backends.contract import Backend, Radiance, Rays, Visibility
from scenec.backends.exact.annotate import annotate
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.exact.settle import Settled, Statistics, settle
from scenec.backends.haze import Veil
from scenec.backends.noise import estimate_parts
from scenec.backends.rays import camera_rays
from scenec.backends.render_scene import Camera, RenderScene
from scenec.backends.shutter import is_rolling

#: Pixels of a band, and of a tile.
PIXELS = 1 << 22
#: Columns of a tile: four samples each are what OpenGL can be trusted to draw side by side.
WIDEST = 4096
#: Rows of either: what Cycles draws in one piece.
TALLEST = 8192


def bands(camera: Camera) -> list[range]:
    """Rows of a picture that are annotated at once; of bands about as many each."""
    # With a row beside it on either side a band is still no taller than that.
    count = -(-camera.height // min(max(1, PIXELS // camera.width), TALLEST - 2))
    rows = -(-camera.height // count)
    return [
        range(first, min(first + rows, camera.height)) for first in range(0, camera.height, rows)
    ]


def crop(camera: Camera, rows: range, columns: range | None = None) -> Camera:
    """A camera that shows a part of another one's picture.

    Its principal point is rounded to float64: rays are as close as that, not the same bits.
    """
    columns = range(camera.width) if columns is None else columns
    if len(rows) == camera.height and len(columns) == camera.width:
        return camera
    k = np.array(camera.intrinsics, np.float64)
    k[0, 2] -= columns.start
    k[1, 2] -= rows.start
    return replace(camera, width=len(columns), height=len(rows), intrinsics=k)


class Annotating:
    """Exact visibility and annotation of a picture, band by band.

    For each band of ``bands``, in order: get ``rays`` of it, ask a renderer for what ``camera`` and
    they show, ``add`` that. Then ``finish``. Whether the renderer is to be trusted is asked of all
    bands together: if it failed in one, the others are cast ray by ray, too.

    Args:
        scene: The scene.
        caster: Posed as at the sample.
        camera: Whose picture it is.
        passes: What to annotate, see ``annotate``.
        sample: Time code.
    """

    def __init__(
        self,
        scene: RenderScene,
        caster: ExactCaster,
        camera: Camera,
        passes: Sequence[str],
        sample: int,
    ) -> None:
        self._scene, self._caster, self._whole = scene, caster, camera
        self._passes, self._sample = passes, sample
        self.bands = bands(camera)
        self._statistics: list[Statistics] = []
        self._settled: Settled | None = None
        self._arrays: dict[str, NDArray] = {}
        self._all_rays: Rays | None = None

    def around(self, rows: range) -> range:
        """A band with the rows beside it that windows of 3x3 pixels look at."""
        return range(max(rows.start - 1, 0), min(rows.stop + 1, self._whole.height))

    def rays(self, rows: range) -> Rays:
        """Rays of a band and the rows beside it."""
        rays = camera_rays(self._whole, self.around(rows))
        if len(self.bands) == 1:
            self._all_rays = rays
        return rays

    def camera(self, rows: range) -> Camera:
        """The camera of a band and the rows beside it."""
        return crop(self._whole, self.around(rows))

    def part(self, visibility: Visibility, rows: range) -> Visibility:
        """What of a whole picture's visibility belongs to a band and the rows beside it."""
        part = _pixels(self.around(rows), self._whole.width)
        return Visibility(visibility.row[part], visibility.face[part])

    @cached_property
    def all_rays(self) -> Rays:
        """Rays of the whole picture."""
        return camera_rays(self._whole) if self._all_rays is None else self._all_rays

    def add(self, rows: range, rays: Rays, visibility: Visibility | None) -> None:
        """Settle a band.

        Args:
            rows: Of ``bands``.
            rays: From ``rays``.
            visibility: What a renderer saw along them; None: they are cast.

        Raises:
            BackendError: Visibility that does not fit the rays.
        """
        first = self.around(rows).start
        core = range(rows.start - first, rows.stop - first)
        settled = settle(self._caster, rays, visibility, self.camera(rows), core)
        self._statistics.append(settled.statistics)
        self._keep(rows, settled, _rows_of(rays, core))

    def finish(self) -> tuple[Settled, dict[str, NDArray]]:
        """The whole picture: exact visibility, and arrays as ``annotate`` returns them.

        Returns:
            Both; ``Settled.statistics`` are those of all bands together.
        """
        settled = self._settled
        assert settled is not None
        if any(one.escalated for one in self._statistics):
            for index, rows in enumerate(self.bands):
                if not self._statistics[index].escalated:
                    self._statistics[index] = self._cast_again(settled, rows, index)
        return replace(settled, statistics=_together(self._statistics)), self._arrays

    def _cast_again(self, settled: Settled, rows: range, index: int) -> Statistics:
        part = _pixels(rows, self._whole.width)
        before = settled.row[part].copy(), settled.face[part].copy()
        rays = camera_rays(self._whole, rows)
        found = settle(self._caster, rays)
        self._keep(rows, found, rays)
        old = self._statistics[index]
        other_row = found.row != before[0]
        other = other_row | (found.face != before[1])
        return replace(
            old,
            suspects=old.pixels,
            reasons=old.reasons | {"audit": old.reasons["audit"] + old.pixels - old.suspects},
            changed=old.changed + int(np.count_nonzero(other)),
            changed_rows=old.changed_rows + int(np.count_nonzero(other_row)),
            escalated=True,
        )

    def _keep(self, rows: range, settled: Settled, rays: Rays) -> None:
        arrays = annotate(self._scene, settled, rays, self._passes, self._sample)
        if len(self.bands) == 1:
            self._settled, self._arrays = settled, arrays
            return
        height, width = self._whole.height, self._whole.width
        if self._settled is None:
            n = height * width
            self._settled = replace(
                settled, row=np.empty(n, np.int32), face=np.empty(n, np.int32), t=np.empty(n)
            )
            self._arrays = {
                name: np.empty((height, *values.shape[1:]), values.dtype)
                for name, values in arrays.items()
            }
        part = _pixels(rows, width)
        self._settled.row[part] = settled.row
        self._settled.face[part] = settled.face
        self._settled.t[part] = settled.t
        for name, values in arrays.items():
            self._arrays[name][rows.start : rows.stop] = values


def see(look: Callable[[Rays, Camera], Visibility | None], camera: Camera) -> Visibility | None:
    """A renderer's visibility of a whole picture, band by band.

    Args:
        look: What it sees along rays of a band and its camera; None: it cannot follow them.
        camera: Whose picture it is.
    """
    row = np.empty(camera.width * camera.height, np.int32)
    face = np.empty_like(row)
    for rows in bands(camera):
        seen = look(camera_rays(camera, rows), crop(camera, rows))
        if seen is None:
            return None
        part = _pixels(rows, camera.width)
        row[part], face[part] = seen.row, seen.face
    return Visibility(row, face)


def visible(backend: Backend, rays: Rays, sample: int, camera: Camera) -> Visibility | None:
    """What a backend sees; only of pinholes, one pose for all rows, it is told the camera."""
    plain = camera.lens is None and not is_rolling(camera)
    return backend.visibility(rays, sample, camera if plain else None)


def read_visibility(file: Path) -> Visibility:
    """What ``Session.see_to`` left in a file."""
    with np.load(file) as arrays:
        return Visibility(arrays["row"], arrays["face"])


def by_columns(look: Callable[[Camera], Visibility], camera: Camera, widest: int) -> Visibility:
    """Visibility of a picture that may be wider than a renderer draws, side by side.

    Args:
        look: What the renderer sees with a camera.
        camera: A pinhole.
        widest: Columns that the renderer draws at once.
    """
    if camera.width <= widest:
        return look(camera)
    row = np.empty((camera.height, camera.width), np.int32)
    face = np.empty_like(row)
    for left in range(0, camera.width, widest):
        columns = range(left, min(left + widest, camera.width))
        seen = look(crop(camera, range(camera.height), columns))
        row[:, columns.start : columns.stop] = seen.row.reshape(camera.height, -1)
        face[:, columns.start : columns.stop] = seen.face.reshape(camera.height, -1)
    return Visibility(row.ravel(), face.ravel())


def cast(
    scene: RenderScene,
    caster: ExactCaster,
    camera: Camera,
    passes: Sequence[str],
    sample: int,
) -> tuple[Settled, dict[str, NDArray]]:
    """A picture as annotation defines it, every pixel cast: see ``Annotating``."""
    annotating = Annotating(scene, caster, camera, passes, sample)
    for rows in annotating.bands:
        annotating.add(rows, annotating.rays(rows), None)
    return annotating.finish()


def radiance(
    backend: Backend, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
) -> Radiance:
    """As ``Backend.radiance``; a large picture by tiles, each with noise of its own.

    A denoised one is drawn in one go: tiles would show.

    Raises:
        BackendError: The renderer failed.
    """
    width, height = camera.width, camera.height
    small = width * height <= PIXELS and width <= WIDEST and height <= TALLEST
    if denoise or small:
        return backend.radiance(camera, sample, spp, seed, denoise)
    halves = np.empty((2, height, width, 3), np.float32)
    coverage = np.empty((height, width), np.float32)
    dropped, stochastic, drawn = 0, True, spp
    for number, (rows, columns) in enumerate(_tiles(camera)):
        # By an odd number near 2**32 over the golden ratio: none comes twice.
        noise = (seed + 0x9E3779B1 * number) & 0xFFFFFFFF
        part = backend.radiance(crop(camera, rows, columns), sample, spp, noise)
        place = slice(rows.start, rows.stop), slice(columns.start, columns.stop)
        halves[:, *place] = part.halves
        coverage[place] = part.coverage
        dropped += part.dropped
        stochastic &= part.stochastic
        drawn = part.spp
    return Radiance(halves, coverage, drawn, dropped, stochastic=stochastic)


def compose(
    radiance: Radiance, scene: RenderScene, camera: Camera, sample: int, veil: Veil | None = None
) -> Picture:
    """As ``compose.compose``: the same picture; its noise but for the order of sums."""
    parts = bands(camera)
    if len(parts) == 1:
        return compose_whole(radiance, scene, camera, sample, veil)
    rgb = np.empty((camera.height, camera.width, 3), np.float32)
    for rows in parts:
        own, veiled = _part(radiance, veil, rows)
        rgb[rows.start : rows.stop] = paint(own, scene, camera, sample, veiled, rows)

    def halves() -> Iterator[tuple[NDArray[np.float64], NDArray[np.bool_]]]:
        for rows in parts:
            own, veiled = _part(radiance, veil, rows)
            yield through(own, veiled), noisy_pixels(own)

    return Picture(rgb, estimate_parts(halves, radiance.stochastic))


def _part(radiance: Radiance, veil: Veil | None, rows: range) -> tuple[Radiance, Veil | None]:
    """What some rows have of either."""
    part = slice(rows.start, rows.stop)
    own = replace(
        radiance,
        halves=radiance.halves[:, part],
        coverage=radiance.coverage[part],
        denoised=None if radiance.denoised is None else radiance.denoised[part],
        background=None if radiance.background is None else radiance.background[:, part],
    )
    if veil is None:
        return own, None
    return own, replace(
        veil,
        transmittance=veil.transmittance[part],
        behind=veil.behind[part],
        airlight=veil.airlight[part],
    )


def _tiles(camera: Camera) -> Iterator[tuple[range, range]]:
    across = -(-camera.width // WIDEST)
    wide = -(-camera.width // across)
    high = min(max(1, PIXELS // wide), TALLEST)
    for top in range(0, camera.height, high):
        for left in range(0, camera.width, wide):
            yield (
                range(top, min(top + high, camera.height)),
                range(left, min(left + wide, camera.width)),
            )


def _pixels(rows: range, width: int) -> slice:
    return slice(rows.start * width, rows.stop * width)


def _rows_of(rays: Rays, rows: range) -> Rays:
    """Rays of some rows of a table."""
    if len(rows) == rays.shape[0]:
        return rays
    width = rays.shape[1]
    part = _pixels(rows, width)
    return replace(
        rays,
        origins=rays.origins[part],
        directions=rays.directions[part],
        shape=(len(rows), width),
        depth=None if rays.depth is None else rays.depth[part],
        known=None if rays.known is None else rays.known[part],
    )


def _together(parts: Sequence[Statistics]) -> Statistics:
    if len(parts) == 1:
        return parts[0]
    sums = {
        name: sum(getattr(one, name) for one in parts)
        for name in ("pixels", "suspects", "changed", "changed_rows")
    }
    reasons = {name: sum(one.reasons[name] for one in parts) for name in parts[0].reasons}
    return Statistics(**sums, reasons=reasons, escalated=any(one.escalated for one in parts))
