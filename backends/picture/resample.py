"""Pictures through a lens from pinhole views, for renderers that know pinholes alone.

One view where all rays lie within ``WIDEST`` of the axis, else those faces of a cube around the eye
that any ray meets; each only as large as its rays need, and so fine that ``FINENESS`` of its pixels
go along a side of the picture's, everywhere (of pixels more than twice as long as wide, which
panoramas have at their poles: along half of the longer side). A pixel of the picture is the mean of
its own area (box filter, as contracts say), at ``SUBPIXELS``^2 places, of what is bilinear between
the views' pixels: radiance and coverage alike, ids never. That blurs: to the filter's variance of
1/12 square pixels it adds 1/(4 FINENESS^2) at most; edges stay where they are (without
interpolation they would move by up to 0.1 pixel), and so does mean brightness.

Both halves go the same way, so they stay independent and ((A - B)/2)^2 stays an unbiased estimate
of the variance of each pixel; neighbors share samples, so their errors are no longer independent,
which only averages over regions show (they are as noisy as before, not less).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.lens import Projection, RayTable, local_rays, ray_table
from scenec.backends.contract import Backend, Radiance
from scenec.backends.noise_seeds import view_seed
from scenec.backends.picture.tiles import drawer
from scenec.backends.stage.scene import Camera
from scenec.schemas.errors import CameraRefusedError
from scenec.schemas.kernels import kernel
from scenec.schemas.records import LensRadiance
from scenec.schemas.threads import over_threads

#: Pixels of the views along a side of the picture's.
FINENESS = 2.0
#: Places along a side of a pixel at which views are looked up.
SUBPIXELS = 4
#: Farthest rays from the axis that a single view holds, degrees.
WIDEST = 60.0
#: A view's longest side, pixels.
LARGEST = 8192
#: Pixels of the picture at which the views' scale is measured, along a side.
_SAMPLES = 64

#: Camera axes to those of the faces of a cube, z forward: ahead, right, left, down, up, behind.
FACES = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
    ],
    np.float64,
)


#: Number of the plane ahead among windows, where it holds all that is seen.
_AHEAD = len(FACES)


@dataclass(frozen=True)
class Views:
    """Pinhole views that hold a picture.

    Attributes:
        cameras: Those that are rendered.
        faces: Which of ``FACES`` each is.
        table: The picture's rays.
        fineness: Pixels of the views along a side of the picture's, the least; ``FINENESS``, unless
            ``LARGEST`` bounds it.
    """

    cameras: tuple[Camera, ...]
    faces: tuple[int, ...]
    table: RayTable
    fineness: float

    def record(self) -> LensRadiance:
        """Returns what sidecars say of them."""
        return LensRadiance(
            way="resampled",
            views=len(self.cameras),
            view_pixels=sum(view.width * view.height for view in self.cameras),
            pixels_per_pixel_side=self.fineness,
            interpolation_px=self.table.error_px,
        )


def plan_views(camera: Camera) -> Views:
    """The views of a camera with a lens."""
    table = ray_table(camera)
    low, high, cosine = _windows(Projection.of(camera))
    used = np.flatnonzero(np.isfinite(low).all(axis=1))
    single = _AHEAD in used and cosine >= np.cos(np.radians(WIDEST))
    finest = _finest(camera, single)
    cameras, faces, fineness = [], [], []
    for plane in [_AHEAD] if single else used[used < _AHEAD].tolist():
        face = plane % _AHEAD
        focal = FINENESS * finest[face]
        # A pixel more on each side: what rounding may add.
        span = float((high[plane] - low[plane]).max())
        if span * focal > LARGEST - 4:
            focal = (LARGEST - 4) / span
        fineness.append(float(focal / finest[face]))
        size = np.ceil((high[plane] - low[plane]) * focal).astype(int) + 2
        k = np.eye(3)
        k[0, 0] = k[1, 1] = focal
        k[:2, 2] = 1.0 - low[plane] * focal
        pose = np.array(camera.camera_to_world, np.float64)
        # Exact, whatever does it: a face's axes are ones and zeros.
        pose[:3, :3] = pose[:3, :3] @ FACES[face].T
        cameras.append(
            replace(
                camera, width=int(size[0]), height=int(size[1]), intrinsics=k, camera_to_world=pose,
                lens=None,
            )
        )  # fmt: skip
        faces.append(face)
    return Views(tuple(cameras), tuple(faces), table, min(fineness, default=FINENESS))


def draw(
    backend: Backend,
    camera: Camera,
    views: Views,
    sample: int,
    spp: int,
    seed: int,
    denoise: bool = False,
) -> Radiance:
    """A picture of a camera with a lens, of views that a backend renders.

    Args:
        backend: Loaded.
        camera: With a lens.
        views: From ``plan_views``.
        sample, spp, seed, denoise: As for ``Backend.radiance``. Of the samples a pixel of the
            views gets its share by area, rounded up.

    Raises:
        BackendError: The backend failed, or the lens shows nothing.
    """
    if not views.cameras:
        raise CameraRefusedError(f"camera {camera.name}: its lens has no ray in the picture")
    each = max(1, int(np.ceil(spp / views.fineness**2)))
    parts = []
    for i, view in enumerate(views.cameras):
        parts.append(drawer(backend, view, sample, denoise)(each, view_seed(seed, i)))
    clean = [_denoised(part) for part in parts]
    channels = 7 + 3 * len(clean[0])
    picture = np.zeros((camera.height, camera.width, channels), np.float32)
    index_of_face = np.full(len(FACES), -1, np.int64)
    index_of_face[list(views.faces)] = np.arange(len(views.faces))
    starts = np.cumsum([0, *(view.width * view.height for view in views.cameras)])
    stacked = np.empty((starts[-1], channels), np.float32)
    numbers = np.empty((len(parts), 5))
    for i, (view, part) in enumerate(zip(views.cameras, parts, strict=True)):
        own = slice(starts[i], starts[i + 1])
        stacked[own, :3] = part.halves[0].reshape(-1, 3)
        stacked[own, 3:6] = part.halves[1].reshape(-1, 3)
        stacked[own, 6] = part.coverage.ravel()
        for number, one in enumerate(clean[i]):
            stacked[own, 7 + 3 * number : 10 + 3 * number] = one.reshape(-1, 3)
        k = view.intrinsics
        numbers[i] = k[0, 0], k[0, 2], k[1, 2], view.width, view.height
    table = views.table
    over_threads(
        _gather, camera.height, table, SUBPIXELS,
        len(views.faces) == 1 and views.faces[0] == 0, FACES,
        _Rendered(index_of_face, numbers, starts, stacked), picture,
    )  # fmt: skip
    halves = np.stack([picture[..., :3], picture[..., 3:6]])
    shown = max(1, int(np.count_nonzero(table.known)))
    samples = sum(part.spp * view.width * view.height
                  for part, view in zip(parts, views.cameras, strict=True))  # fmt: skip
    smooth = [picture[..., first : first + 3] for first in range(7, channels, 3)]
    return Radiance(
        np.ascontiguousarray(halves),
        np.clip(picture[..., 6], 0.0, 1.0),
        max(1, round(samples / shown)),
        sum(part.dropped for part in parts),
        np.mean(smooth, axis=0, dtype=np.float32) if smooth else None,
        all(part.stochastic for part in parts),
        denoised_halves=np.stack(smooth) if len(smooth) == 2 else None,
    )


def _denoised(part: Radiance) -> list[NDArray[np.float32]]:
    """Its denoised halves, or only their mean where it has no more, or nothing."""
    if part.denoised_halves is not None:
        return list(part.denoised_halves)
    return [] if part.denoised is None else [part.denoised]


class _Rendered(NamedTuple):
    """Pinhole views, rendered.

    Attributes:
        index_of_face: View of each face, int64 [6].
        numbers: Focal length, principal point (x, y), width and height of each, float64 [v, 5].
        starts: Where each begins in ``pixels``, int64 [v + 1].
        pixels: Of all, line by line, float32 [n, channels].
    """

    index_of_face: NDArray[np.int64]
    numbers: NDArray[np.float64]
    starts: NDArray[np.int64]
    pixels: NDArray[np.float32]


@lru_cache(maxsize=4)
def _windows(projection: Projection) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Returns the window of each face's plane that pixels use, and the widest ray's cosine.

    Returns:
        (lowest and highest (x, y), [7, 2] each, not finite where nothing is taken; the last are
        of all places on the plane ahead).
    """
    table = ray_table(projection.camera)
    height = len(table.known)
    low = np.full((height, len(FACES) + 1, 2), np.inf)
    high, cosine = -low, np.ones(height)
    over_threads(_find_windows, height, table, SUBPIXELS, FACES, low, high, cosine)
    return low.min(axis=0), high.max(axis=0), float(cosine.min())


@kernel
def _find_windows(first, last, lattice, side, faces, low, high, cosine):  # type: ignore[no-untyped-def]
    """The same of lines of pixels, float64 [h, 7, 2] each, and [h]."""
    table, per_pixel, known, _ = lattice
    for y in range(first, last):
        d = np.empty(3)
        for x in range(known.shape[1]):
            if not known[y, x]:
                continue
            for place in range(side * side):
                v, u = place // side, place % side
                _between(table, per_pixel, x + (u + 0.5) / side, y + (v + 0.5) / side, d)
                length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
                cosine[y] = min(cosine[y], d[2] / length)
                for plane in (_face_of(d), _AHEAD):
                    f = 0 if plane == _AHEAD else plane
                    z = faces[f, 2, 0] * d[0] + faces[f, 2, 1] * d[1] + faces[f, 2, 2] * d[2]
                    if z <= 0.0:
                        continue
                    for c in range(2):
                        axis = faces[f, c]
                        at = (axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2]) / z
                        low[y, plane, c] = min(low[y, plane, c], at)
                        high[y, plane, c] = max(high[y, plane, c], at)


@kernel
def _face_of(d):  # type: ignore[no-untyped-def]
    """The face of the cube that a ray meets."""
    x, y, z = abs(d[0]), abs(d[1]), abs(d[2])
    if z >= x and z >= y:
        return 0 if d[2] >= 0.0 else 5
    if x >= y:
        return 1 if d[0] >= 0.0 else 2
    return 3 if d[1] >= 0.0 else 4


@kernel
def _between(table, per_pixel, x, y, out):  # type: ignore[no-untyped-def]
    """The ray through a point of the picture, pixels."""
    u, v = x * per_pixel, y * per_pixel
    i = min(int(u), table.shape[1] - 2)
    j = min(int(v), table.shape[0] - 2)
    a, b = u - i, v - j
    for c in range(3):
        top = (1.0 - a) * table[j, i, c] + a * table[j, i + 1, c]
        bottom = (1.0 - a) * table[j + 1, i, c] + a * table[j + 1, i + 1, c]
        out[c] = (1.0 - b) * top + b * bottom


@kernel
def _gather(first, last, lattice, side, single, faces, views, out):  # type: ignore[no-untyped-def]
    """Means of some lines of pixels, each over side * side places.

    Args:
        first, last: Which lines.
        lattice: ``RayTable``.
        side: Places along a pixel's side.
        single: Whether the first face's view is all there is.
        faces: ``FACES``, float64 [6, 3, 3].
        views: ``_Rendered``.
        out: Receives the means, float32 [h, w, channels].
    """
    table, per_pixel, known, _ = lattice
    width, channels = out.shape[1], out.shape[2]
    pixels, share = views.pixels, 1.0 / (side * side)
    for y in range(first, last):
        d = np.empty(3)
        total = np.empty(channels)
        for x in range(width):
            if not known[y, x]:
                continue
            total[:] = 0.0
            for j in range(side):
                for i in range(side):
                    _between(table, per_pixel, x + (i + 0.5) / side, y + (j + 0.5) / side, d)
                    f = 0 if single else _face_of(d)
                    z = faces[f, 2, 0] * d[0] + faces[f, 2, 1] * d[1] + faces[f, 2, 2] * d[2]
                    a = faces[f, 0, 0] * d[0] + faces[f, 0, 1] * d[1] + faces[f, 0, 2] * d[2]
                    b = faces[f, 1, 0] * d[0] + faces[f, 1, 1] * d[1] + faces[f, 1, 2] * d[2]
                    n = views.index_of_face[f]
                    focal, cx, cy, columns, rows = views.numbers[n]
                    # Between the centers of pixels; views have one more on each side.
                    u = min(max(focal * a / z + cx - 0.5, 0.0), columns - 1.000001)
                    v = min(max(focal * b / z + cy - 0.5, 0.0), rows - 1.000001)
                    left, top = int(u), int(v)
                    p, q = u - left, v - top
                    at = views.starts[n] + top * int(columns) + left
                    below = at + int(columns)
                    for c in range(channels):
                        upper = (1.0 - p) * pixels[at, c] + p * pixels[at + 1, c]
                        lower = (1.0 - p) * pixels[below, c] + p * pixels[below + 1, c]
                        total[c] += (1.0 - q) * upper + q * lower
            for c in range(channels):
                out[y, x, c] = total[c] * share


def _finest(camera: Camera, single: bool) -> NDArray[np.float64]:
    """Focal lengths, pixels, at which each face's pixels are as small as the picture's, [6].

    The sides of a pixel of the picture on a face's plane are the singular values of the plane's
    derivative by pixels, here of differences.
    """
    step = 1e-3
    sides = [np.linspace(0.0, side, _SAMPLES) for side in (camera.width, camera.height)]
    at, known = local_rays(camera, sides[0], sides[1])
    right, there = local_rays(camera, sides[0] + step, sides[1])
    down, also = local_rays(camera, sides[0], sides[1] + step)
    known &= there & also
    out = np.zeros(len(FACES))
    for face in range(1 if single else len(FACES)):
        planes = []
        for rays in (at, right, down):
            turned = (rays[..., None, :] * FACES[face]).sum(axis=-1)
            inside = turned[..., 2] > 0.0
            with np.errstate(divide="ignore", invalid="ignore"):
                plane = turned[..., :2] / turned[..., 2:]
            # What lies on the face, and a little more.
            near = inside if single else inside & (np.abs(plane) <= 1.1).all(axis=-1)
            planes.append((plane, near))
        good = known & planes[0][1] & planes[1][1] & planes[2][1]
        if not good.any():
            out[face] = np.inf
            continue
        a, b = ((planes[i][0] - planes[0][0])[good] / step for i in (1, 2))
        square = (a * a).sum(axis=1) + (b * b).sum(axis=1)
        area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        largest = 0.5 * (square + np.sqrt(np.maximum(square * square - 4.0 * area * area, 0.0)))
        longer = np.sqrt(largest)
        size = np.maximum(area / np.maximum(longer, 1e-300), 0.5 * longer)
        out[face] = 1.0 / max(float(size.min()), 1e-12)
    if not np.isfinite(out).all():
        known_faces = out[np.isfinite(out) & (out > 0.0)]
        out[~np.isfinite(out)] = known_faces.max() if len(known_faces) else float(camera.width)
    return out
