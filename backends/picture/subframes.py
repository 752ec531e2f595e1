"""Depth of field and motion blur as means of pinhole pictures, for all renderers alike.

A picture through an aperture while a shutter is open is an integral over points of the aperture
and over time. Here it is the mean of sub-frames (the accumulation buffer of Haeberli and Akeley
1990), each a camera without either: at its pose of one time, its eye moved by (x, y) on the
aperture and its principal point by (fx x + s y, fy y) / d, so that what lies at the distance d of
the plane in focus stays where it is in the picture.

Where all rows are exposed at once, the exposure is cut into equal parts, and a sub-frame is
somewhere in each, in parts before and after the middle alike: unbiased, and on average at the
middle. Where rows are exposed at their own times, a sub-frame at the time t is the picture of those
rows alone whose exposure holds t: a camera cropped to them. Times are equidistant, an integer
fraction of the exposure apart, so every row has equally many, wherever they begin; and they begin
anywhere, so the mean of each row is unbiased, but rows are early or late together
(``Blur.timing_px``). Points on the aperture are a spiral (Vogel 1979), or an R2 sequence
(Roberts 2018) beside times, turned and shifted at random: unbiased, too. Both halves of a picture
have their own numbers, so that ((A - B)/2)^2 stays an unbiased estimate of each pixel's variance,
that of times and points included.

What is approximated: few sub-frames show blur as that many sharp copies; how far these are apart
is stated in pixels (``Blur.spacing_px``). Rows whose exposure is so short that sub-frames of it
alone would be too many (an instant above all) are exposed for longer: by
``blur.QUANTUM_PX`` of motion at most, unless ``blur.MOST`` asks for more, which is stated, too.
Only cameras move: objects and lights stand as at the sample. How far things move and how wide they
are blurred is measured by ``blur``, which misses nothing that is seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.camera.shutter import poses_at
from scenec.backends.camera.tiles import bands, crop
from scenec.backends.contract import Backend, Radiance
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.noise_seeds import sub_frame_number, sub_frame_seed
from scenec.backends.picture.blur import MOST, Blur
from scenec.backends.picture.compose import background
from scenec.backends.picture.sky import combine
from scenec.backends.picture.tiles import drawer
from scenec.backends.stage.scene import Camera, Focus, RenderScene
from scenec.schemas.records import BlurRecord

if TYPE_CHECKING:
    from scenec.backends.picture.airlight import Air

#: Fractional parts of a sequence that fills the unit square evenly, and of a spiral's turns.
_R2 = (0.7548776662466927, 0.5698402909980532)
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, eq=False)
class SubFrame:
    """One of the pictures whose mean is a picture.

    Attributes:
        camera: Its rows of the picture as a camera of their own.
        first: The first of these rows.
        index: Of the sub-frame; its number in time.
    """

    camera: Camera
    first: int
    index: int


@dataclass(frozen=True)
class Share:
    """Divides samples among sub-frames.

    Attributes:
        count: Sub-frames of each row, in each half.
        each: Samples a pixel of each.
    """

    count: int
    each: int


def share_out(blur: Blur, spp: int, stochastic: bool, most: int = MOST) -> Share:
    """Returns the number of sub-frames for so many samples, and the samples of each.

    A path tracer's sub-frame has two samples a pixel at least, for halves of its own; a
    rasterizer's has a square number of them. None has more than ``most`` of a row.
    """
    room = max(1, min(most, int(MOST / blur.bands)))
    if not stochastic:
        count = max(1, min(blur.wanted, spp, room))
        return Share(count, max(1, math.isqrt(spp // count)) ** 2)
    count = max(1, min(blur.wanted, spp // 4, room))
    return Share(count, 2 * math.ceil(spp / (4 * count)))


def sub_frames(blur: Blur, count: int, seed: int, half: int) -> Iterator[SubFrame]:
    """Sub-frames of a half, in order of time.

    Args:
        blur: From ``blur.measure``.
        count: Of each row.
        seed: Of the picture's numbers.
        half: Which half.
    """
    camera = replace(blur.camera, shutter=None, focus=None)
    start, radius, turn = (
        sub_frame_number(seed, half, what) for what in ("time", "radius", "turn")
    )
    rows = np.arange(camera.height)
    times: NDArray[np.float64]
    if blur.shutter is None:
        first, times = np.zeros(camera.height, np.int64), np.zeros(count)
    elif blur.shutter.readout_s <= 0.0:
        first = np.zeros(camera.height, np.int64)
        times = blur.shutter.exposure_s * (_strata(count, start) - 0.5)
    else:
        step = blur.shutter.exposure_s / count
        middles = blur.shutter.middles(rows.astype(np.float64) + 0.5, camera.height)
        opens = middles - 0.5 * blur.shutter.exposure_s
        first = np.ceil(opens / step - start).astype(np.int64)
        number = np.arange(int(first.min()), int(first.max()) + count, dtype=np.float64)
        times = (number + start) * step
        first -= first.min()
    poses = _poses(blur, times)
    for index in range(len(times)):
        own = rows[(first <= index) & (index < first + count)]
        if len(own) == 0:
            continue
        view = replace(camera, camera_to_world=poses[index])
        if blur.focus is not None:
            if blur.shutter is None:
                r, angle = (index + radius) / count, turn + index * _GOLDEN
            else:
                r, angle = (radius + index * _R2[0]) % 1.0, turn + index * _R2[1]
            r = blur.focus.aperture_radius_m * math.sqrt(r)
            angle *= 2.0 * math.pi
            view = moved_eye(view, blur.focus, r * math.cos(angle), r * math.sin(angle))
        shown = range(int(own[0]), int(own[-1]) + 1)
        yield SubFrame(crop(view, shown), shown.start, index)


def _strata(count: int, start: float) -> NDArray[np.float64]:
    """A number anywhere in each of so many parts of [0, 1); of parts alike on both sides, mirrored.

    Their mean is 1/2, but for the middle one of an odd count: what moves evenly is where it is in
    the middle of the exposure.
    """
    part = np.arange(count)
    place = (start + part * _GOLDEN) % 1.0
    upper = part >= (count + 1) // 2
    place[upper] = 1.0 - place[::-1][upper]
    return np.asarray((part + place) / count)


def _poses(blur: Blur, times: NDArray[np.float64]) -> NDArray[np.float64]:
    opened = blur.camera.shutter
    if blur.shutter is None or opened is None:
        return np.broadcast_to(blur.camera.camera_to_world, (len(times), 4, 4))
    # Exposures that were widened may end later than the camera's way is known.
    return poses_at(opened, np.clip(times, opened.times[0], opened.times[-1]))


def moved_eye(camera: Camera, focus: Focus, x: float, y: float) -> Camera:
    """The pinhole at a point of an aperture, meters right and down of its middle."""
    pose, k = camera.camera_to_world.copy(), camera.intrinsics.copy()
    pose[:3, 3] += x * pose[:3, 0] + y * pose[:3, 1]
    k[0, 2] += (k[0, 0] * x + k[0, 1] * y) / focus.distance_m
    k[1, 2] += k[1, 1] * y / focus.distance_m
    return replace(camera, camera_to_world=pose, intrinsics=k)


def _moved(camera: Camera, right: float, down: float) -> Camera:
    """The camera with its picture moved by so many pixels."""
    k = camera.intrinsics.copy()
    k[0, 2] += right
    k[1, 2] += down
    return replace(camera, intrinsics=k)


class Drawing:
    """Draws the pictures of one frame of a camera with a shutter or an aperture.

    Args:
        blur: From ``blur.measure``.
        backend: Loaded.
        scene: For what is behind surfaces, and haze.
        sample: Time code.
        caster: Posed as at the sample, for haze.

    Attributes:
        record: What sidecars say of the pictures drawn so far.
    """

    def __init__(
        self, blur: Blur, backend: Backend, scene: RenderScene, sample: int, caster: ExactCaster
    ) -> None:
        self._blur, self._backend, self._scene = blur, backend, scene
        self._sample, self._caster = sample, caster
        self._sky = combine(scene.lighting[sample].domes)
        self._air: Air | None = None
        if scene.haze and scene.haze[sample] is not None:
            # Imported here, and below: few scenes have any.
            from scenec.backends.picture.haze import air_at

            self._air = air_at(scene, sample)
        self._stochastic = backend.stochastic
        self.record = _record(blur, 2 if self._stochastic else 1)

    def draw(self, spp: int, seed: int, most: int = MOST) -> Radiance:
        """A picture, complete with what is behind surfaces.

        Args:
            spp: Samples per pixel.
            seed: Of the noise, 32 bits.
            most: Sub-frames of a row in each half, at most.

        Raises:
            BackendError: The renderer failed.
        """
        blur, halves_made = self._blur, 2 if self._stochastic else 1
        share = share_out(blur, spp, self._stochastic, most)
        camera = blur.camera
        shape = (2, camera.height, camera.width, 3)
        halves, sky = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        coverage = np.zeros(shape[1:3], np.float32)
        pictures = samples = dropped = 0
        noisy = self._stochastic
        for half in range(halves_made):
            for one in sub_frames(blur, share.count, seed, half):
                # Haze is looked at in one place of the pixels. The same one moves a rasterizer's
                # samples, which have theirs on a lattice, within its cells.
                cell = 1.0 if self._stochastic else 1.0 / math.sqrt(share.each)
                u, v = (sub_frame_number(seed, half, f"{n}/{one.index}") - 0.5 for n in ("u", "v"))
                there = _moved(one.camera, cell * u, cell * v)
                view = one.camera if self._stochastic else there
                drawn = self._still(view, share.each, sub_frame_seed(seed, half, one.index))
                light, behind = self._complete(one.camera, there, drawn)
                own = slice(one.first, one.first + view.height)
                halves[half, own] += light
                sky[half, own] += behind
                coverage[own] += drawn.coverage
                pictures += 1
                samples += drawn.spp * view.height
                dropped += drawn.dropped
                noisy &= drawn.stochastic
        if not self._stochastic:
            # It has no noise that could be told from what it leaves out.
            halves[1], sky[1] = halves[0], sky[0]
        for sums in (halves, sky):
            sums /= share.count
        self._count(share, halves_made, pictures)
        return Radiance(
            halves,
            np.clip(coverage / (halves_made * share.count), 0.0, 1.0),
            max(1, round(samples / camera.height)),
            dropped,
            None,
            noisy,
            sky,
        )

    def _still(self, camera: Camera, spp: int, seed: int) -> Radiance:
        """A picture of a camera without shutter and aperture."""
        if camera.lens is None or self._backend.follows_lenses:
            return drawer(self._backend, camera, self._sample)(spp, seed)
        # Imported here: few cameras have a lens.
        from scenec.backends.picture import resample

        views = resample.plan_views(camera)
        if not views.cameras:
            # A few rows, all of them outside of the image circle.
            nothing = np.zeros((2, camera.height, camera.width, 3), np.float32)
            return Radiance(nothing, nothing[0, ..., 0], spp, stochastic=self._stochastic)
        return resample.draw(self._backend, camera, views, self._sample, spp, seed)

    def _complete(
        self, camera: Camera, there: Camera, drawn: Radiance
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean light of surfaces as it arrives, and of what is behind, float64 [h, w, 3] each."""
        light = 0.5 * (drawn.halves[0].astype(np.float64) + drawn.halves[1])
        covered = drawn.coverage.astype(np.float64)
        through = 1.0 - covered
        open_sky, sky = through > 0.0, self._sky
        parts = [
            background(self._scene, camera, self._sample, open_sky[r.start : r.stop], r, sky)
            for r in bands(camera)
        ]
        behind = parts[0] if len(parts) == 1 else np.concatenate(parts)
        if self._air is not None:
            from scenec.backends.picture.haze import veil

            rays = camera_rays(there)
            made = veil(
                self._air, there, self._caster, rays, self._caster.cast(rays)[2], drawn.coverage,
                edges=False,
            )  # fmt: skip
            light, behind = made.over(light, covered), made.over_sky(behind)
        return light, through[..., None] * behind

    def _count(self, share: Share, halves: int, pictures: int) -> None:
        before, timing = self.record, self.record.timing_px
        # Rounds know nothing of each other: their copies may lie anywhere between.
        spacing = self._blur.spacing_px(share.count)
        if before.spacing_px is None or spacing < before.spacing_px:
            timing = self._blur.timing_px(share.count)
        else:
            spacing = before.spacing_px
        self.record = replace(
            before,
            sub_frames=before.sub_frames + pictures,
            sub_frames_per_row=before.sub_frames_per_row + halves * share.count,
            spacing_px=spacing,
            timing_px=timing,
            samples_per_sub_frame=share.each,
        )


def _record(blur: Blur, halves: int) -> BlurRecord:
    asked, drawn = blur.camera.shutter, blur.shutter
    return BlurRecord(
        exposure_s=None if asked is None else asked.shutter.exposure_s,
        readout_s=None if asked is None else asked.shutter.readout_s,
        exposure_drawn_s=None if drawn is None else drawn.exposure_s,
        exposure_widened_px=blur.widened_px,
        motion_px=blur.motion_px,
        aperture_radius_m=None if blur.focus is None else blur.focus.aperture_radius_m,
        focus_distance_m=None if blur.focus is None else blur.focus.distance_m,
        circle_of_confusion_px=blur.disk_px,
        nearest_m=blur.nearest_m if math.isfinite(blur.nearest_m) else None,
        gap_px=blur.gap_px,
        sub_frames_wanted_per_row=halves * blur.wanted,
    )
