"""Automatic exposure: one value for a camera and a batch, or for each sample, from the stage alone.

A camera without an exposure is shown as a photographer's camera would show it. The meter
(``scenec.backends.picture.metering``) estimates what it sees of surfaces, and the mean luminance of
that is shown as the gray card of 18 % is, unless the brightest hundredth would burn out:

    ev = min(log2(0.18 / mean), log2(1 / percentile 99))

What is above that percentile counts as if it were at it, so that no highlight decides. Against the
light a sky would burn out, so a camera meets it half way, in stops, as multi-segment meters do:
where more than a twentieth of all that is seen, surfaces and sky, would be shown above 1,

    ev -= min(3, log2(percentile 95 of all * 2**ev) / 2)

The sun's disc never counts, and the sky's level only where a camera sees nothing else.

The value is a function of the stage: not of the backend, of the frames that are asked for, of
their order or noise. It is one over the samples of a batch, so that a sequence does not flicker
and the same ground has the same color in all its frames, which feature trackers take for granted;
``scenec:exposure:per`` on a camera asks for one a sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.backends.exact.caster import ExactCaster
from scenec.backends.picture.exposure_store import ExposureStore
from scenec.backends.picture.haze import Hazy
from scenec.backends.picture.metering import Metering, look
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas import imaging as formulas
from scenec.schemas.exposures import Exposure
from scenec.schemas.records import ExposureRecord

#: Display-linear value that the mean luminance is shown as.
GRAY = 0.18
#: Percentile above which luminance is a highlight, and the value it is shown as at most.
PERCENTILE = 99.0
WHITE = 1.0
#: Percentile above which all that a camera sees is glare. Of the stops between an exposure for
#: surfaces and one that holds what is below it, surfaces yield a share, and so many at most: a
#: gray card is code 118, and code 41 three stops down.
GLARE_PERCENTILE = 95.0
YIELD, MOST_YIELD_EV = 0.5, 3.0
#: Samples of a batch that are metered, evenly spread over those that the camera is triggered at.
SAMPLES = 32
#: Rays in all, and the fewest of one sample.
_RAYS, _LEAST_RAYS = 12288, 384
#: Values are multiples of 2**(1/64), as those of cfgs' meters are.
_STEPS = 64.0
#: Beyond this 2**ev overflows.
_MOST_EV = 512.0


class Meter:
    """Finds exposures of a stage's cameras, each once.

    Args:
        scene: The stage.
    """

    def __init__(self, scene: RenderScene) -> None:
        self._scene = scene
        self._found: dict[tuple[str, int | None], Exposure] = {}
        self._hazy: Hazy | None = None

    def exposed(
        self,
        camera: Camera,
        sample: int,
        caster: Callable[[], ExactCaster],
        store: ExposureStore | None = None,
    ) -> tuple[Camera, ExposureRecord]:
        """A camera with its exposure, and what sidecars say of where that comes from.

        Args:
            camera: The camera at the sample.
            sample: Time code.
            caster: Gives the stage's, if it is needed; it is left posed as at any sample.
            store: Where exposures are found and kept; None: nowhere but here.
        """
        # A sensor with a time and a speed, or one that meters each picture, has its own.
        if camera.imaging is not None and camera.imaging.rule != "metered":
            rule = "picture" if camera.imaging.rule == "auto" else "given"
            return camera, ExposureRecord(rule=rule)
        if camera.exposure_per is None:
            return _at(camera, camera.exposure_ev), ExposureRecord(rule="given")
        alone = sample if camera.exposure_per == "sample" else None
        place = camera.path, alone
        if place not in self._found:

            def meter() -> Exposure:
                return self._meter(camera.path, alone, caster())

            self._found[place] = meter() if store is None else store.find_or_meter(*place, meter)
        found = self._found[place]
        record = ExposureRecord(
            rule="auto",
            per=camera.exposure_per,
            metered_samples=found.samples,
            luminance=found.level,
            luminance_p99=found.highlight,
            luminance_p95_with_sky=found.glare,
            of=found.of,
        )
        return _at(camera, found.ev), record

    def _meter(self, path: str, sample: int | None, caster: ExactCaster) -> Exposure:
        views = [
            (camera, i)
            for i, cameras in enumerate(self._scene.cameras)
            for camera in cameras
            if camera.path == path and (camera.fires(i) if sample is None else i == sample)
        ]
        count = min(SAMPLES, len(views))
        chosen = [views[k * len(views) // count] for k in range(count)]
        rays = max(_LEAST_RAYS, _RAYS // count)
        if self._hazy is None and any(self._scene.haze):
            self._hazy = Hazy(self._scene, caster)
        seen = [look(self._scene, caster, camera, i, rays, self._hazy) for camera, i in chosen]
        surfaces, sky = (
            np.concatenate([getattr(one, what) for one in seen]) for what in ("surfaces", "sky")
        )
        return expose(Metering(surfaces, sky), count)


def expose(metered: Metering, samples: int) -> Exposure:
    """The exposure for what was seen.

    Args:
        metered: At least one ray's luminance.
        samples: How many it comes from.
    """
    of = "surfaces" if len(metered.surfaces) else "sky"
    mean, high = level(metered.surfaces if len(metered.surfaces) else metered.sky)
    if mean <= 0.0:
        return Exposure(0.0, 0.0, 0.0, 0.0, "nothing", samples)
    ev = min(np.log2(GRAY / mean), np.log2(WHITE / high))
    everything = np.concatenate([metered.surfaces, metered.sky])
    glare = float(np.percentile(everything, GLARE_PERCENTILE, method="lower"))
    if glare > 0.0:
        over = ev - np.log2(WHITE / glare)
        ev -= np.clip(YIELD * over, 0.0, MOST_YIELD_EV)
    ev = float(np.clip(np.round(_STEPS * ev) / _STEPS, -_MOST_EV, _MOST_EV))
    return Exposure(ev, mean, high, glare, of, samples)


def level(luminance: NDArray[np.float64]) -> tuple[float, float]:
    """The mean, for which the percentile is the most that counts, and the percentile.

    Where less than 1 % is lit at all, both are the brightest's.
    """
    if not len(luminance):
        return 0.0, 0.0
    high = float(np.percentile(luminance, PERCENTILE, method="lower"))
    if high <= 0.0:
        high = float(luminance.max())
        return high, high
    return float(np.minimum(luminance, high).mean()), high


def _at(camera: Camera, ev: float) -> Camera:
    """A camera that shows radiance * 2**ev; its sensor has the time and speed that come nearest."""
    imaging = camera.imaging
    if imaging is not None:
        time_s, iso = formulas.time_and_iso(
            2.0**ev,
            imaging.f_number,
            2.0**imaging.headroom,
            imaging.time_range_s,
            imaging.iso_range,
        )
        imaging = replace(imaging, rule="fixed", time_s=time_s, iso=iso)
    return replace(camera, exposure_ev=ev, imaging=imaging)
