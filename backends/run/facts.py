"""Describes frames for their sidecars: what is known of one before its files are written."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.instances import FrameInstances
from scenec.backends.camera.shutter import row_poses
from scenec.backends.picture.sky import combine, mean_radiance
from scenec.backends.stage.scene import Camera, Lighting, RenderScene
from scenec.schemas import picture
from scenec.schemas.codec import UNSET
from scenec.schemas.frames import FRAME_VERSION, LENS_CONVENTION, SHUTTER_CONVENTION
from scenec.schemas.lens import KANNALA_BRANDT, Lens
from scenec.schemas.passes import origins
from scenec.schemas.picture import luminance, visibility_m
from scenec.schemas.records import (
    NOT_WRITTEN,
    FrameRecord,
    LensRecord,
    LightRecord,
    PictureRecord,
    RendererFacts,
    ShutterRecord,
    SunLight,
    SunRecord,
)
from scenec.schemas.versions import version_of


@dataclass(frozen=True)
class FrameResult:
    """A rendered frame.

    Attributes:
        arrays: By pass; none for ``amodal``.
        record: What there is to say of it, but for its files and what it was asked for with.
        seen: What it shows of instances; None without that pass.
        surfaces: Where ``rgb`` shows surfaces, [h, w]; None without it.
    """

    arrays: dict[str, NDArray]
    record: FrameRecord
    seen: FrameInstances | None = None
    surfaces: NDArray[np.bool_] | None = None


def describe_frame(
    scene: RenderScene, camera: Camera, sample: int, renderer: RendererFacts
) -> FrameRecord:
    """Returns what the stage says of a frame; no file is vouched for yet."""
    partner = None if camera.partner is None else partner_name(scene, camera)
    haze = scene.haze[sample] if scene.haze else None
    return FrameRecord(
        version=FRAME_VERSION,
        camera=camera.name,
        camera_prim=camera.path,
        partner=UNSET if camera.partner is None else partner,
        sample=sample,
        time_s=time_of(scene, sample),
        resolution=(camera.width, camera.height),
        intrinsics=rows(camera.intrinsics),
        lens=None if camera.lens is None else lens_record(camera.lens),
        camera_to_world=rows(camera.camera_to_world),
        shutter=None if camera.shutter is None else shutter_record(camera),
        exposure_ev=camera.exposure_ev,
        trigger=camera.trigger,
        passes=(),
        labels=label_names(scene),
        sky_labels=scene.sky_labels,
        sun=sun_record(scene.lighting[sample]),
        visibility_m=None if haze is None else visibility_m(haze.extinction),
        instances=scene.instance_paths,
        backend=renderer.backend,
        backend_version=renderer.version,
        stage_digest=scene.digest,
        exr=NOT_WRITTEN,
        device=renderer.device,
        losses=tuple(scene.losses),
    )


def annotation_versions(passes: Sequence[str]) -> dict[str, str]:
    """Returns what makes annotation, for sidecars; passes of other packages by name."""
    return {"scenec": version_of(), **origins(passes)}


def label_names(scene: RenderScene) -> dict[str, dict[str, str]]:
    """Returns ids and names of each level as sidecars state them."""
    return {
        level: {str(i): name for i, name in sorted(scene.label_names.get(level, {}).items())}
        for level in scene.levels
    }


def time_of(scene: RenderScene, sample: int) -> float | None:
    """Returns the seconds of a sample; None where the stage does not say."""
    return float(scene.times[sample]) if sample < len(scene.times) else None


def partner_name(scene: RenderScene, camera: Camera) -> str | None:
    """Names the camera that disparity goes to; None if the stage has no such camera."""
    every = (other for cameras in scene.cameras for other in cameras)
    return next((other.name for other in every if other.path == camera.partner), None)


def lens_record(lens: Lens) -> LensRecord:
    """Describes a lens; ``schemas.sidecars.lens_of`` reads it back."""
    angle = math.degrees(lens.max_angle) if lens.model == KANNALA_BRANDT else UNSET
    return LensRecord(
        model=lens.model,
        coefficients=lens.coefficients,
        convention=LENS_CONVENTION[lens.model],
        max_angle_deg=angle,
    )


def shutter_record(camera: Camera) -> ShutterRecord:
    """Describes a camera's shutter."""
    held = camera.shutter
    assert held is not None
    ends = row_poses(camera)[[0, -1]]
    return ShutterRecord(
        exposure_s=held.shutter.exposure_s,
        readout_s=held.shutter.readout_s,
        direction="up" if held.shutter.upward else "down",
        first_row=rows(ends[0]),
        last_row=rows(ends[1]),
        times_s=tuple(np.asarray(held.times).tolist()),
        camera_to_world=tuple(rows(pose) for pose in np.asarray(held.camera_to_world)),
        convention=SHUTTER_CONVENTION,
    )


def sun_record(lighting: Lighting) -> SunRecord | None:
    """Describes the brightest sun (``CONVENTIONS["sun"]``); None without one."""
    if not lighting.suns:
        return None
    # Rec.709 luminance; of equal ones the first.
    sun = max(lighting.suns, key=lambda s: float(luminance(s.irradiance)))
    x, y, z = sun.to_light.tolist()
    return SunRecord(
        elevation_deg=math.degrees(math.atan2(z, math.hypot(x, y))),
        azimuth_deg=math.degrees(math.atan2(x, y)) % 360.0,
        irradiance=tuple(sun.irradiance.tolist()),
        time=sun.time,
    )


def picture_record(
    rgb: NDArray, pixels: NDArray[np.uint8], surfaces: NDArray[np.bool_], lighting: Lighting
) -> PictureRecord:
    """Says how bright a picture shows surfaces; if black or burnt out, with the light there is."""
    found = picture.tally(pixels, rgb, surfaces)
    return found if picture.fault([found]) is None else replace(found, light=light_record(lighting))


def light_record(lighting: Lighting) -> LightRecord:
    """Lists the light at a sample, by luminance."""
    sky = combine(lighting.domes)
    return LightRecord(
        suns=tuple(
            SunLight(
                prim=sun.path,
                irradiance=float(luminance(sun.irradiance)),
                angle_deg=math.degrees(sun.diameter_rad),
                normalized=sun.normalized,
            )
            for sun in lighting.suns
        ),
        sky_radiance=0.0 if sky is None else float(luminance(mean_radiance(sky))),
        lamps_w_sr=tuple(float(luminance(lamp.intensity)) for lamp in lighting.lamps),
    )


def rows(matrix: NDArray) -> Any:
    """Returns a matrix as records hold it."""
    return tuple(tuple(row) for row in matrix.tolist())
