"""Says which cameras' pictures are black or burnt out, or show the ground of the sky's picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from scenec.schemas import picture
from scenec.schemas.records import (
    ExposureRecord,
    FrameRecord,
    LightRecord,
    PictureRecord,
    SkyPixels,
)

#: Share of a camera's pixels of sky that may look down: the sea's horizon dips by 0.03 degrees a
#: meter's root of height, and land ends somewhere.
SKY_BELOW = 0.01
_HOW = {
    "black": f"below code {picture.BLACK} in every channel",
    "burnt out": f"at code {picture.BURNT} or above in every channel",
}


class FrameBrightness(NamedTuple):
    """What ``told`` needs of a frame's record, which may be long."""

    sample: int
    exposure_ev: float
    exposure: ExposureRecord
    picture: PictureRecord | None
    sky: SkyPixels | None


def brief(record: FrameRecord) -> FrameBrightness:
    """Returns what there is to say of brightness and sky."""
    exposure = record.exposure or ExposureRecord()
    return FrameBrightness(record.sample, record.exposure_ev, exposure, record.picture, record.sky)


def told_of_sky(frames: Sequence[FrameBrightness]) -> str | None:
    """Warns in a line of sky visible below the horizon; None if there is next to none.

    Args:
        frames: Of one camera; those without a ``sky`` do not count.
    """
    found = [one.sky for one in frames if one.sky is not None]
    pixels, below = sum(one.pixels for one in found), sum(one.below_horizon for one in found)
    if below <= SKY_BELOW * pixels:
        return None
    whose = "its frame" if len(found) == 1 else f"its {len(found)} frames"
    return (
        f"{100.0 * below / pixels:.0f} % of the sky in {whose} lies below the horizon, where the "
        "ground ends and the sky's picture goes on: it has the sky's label; give the terrain a "
        "horizon, or light.sky labels_below"
    )


def told(frames: Sequence[FrameBrightness]) -> str | None:
    """A line about the pictures of one camera and backend in one batch; None if all is well.

    Args:
        frames: Those without a ``picture`` do not count.
    """
    found = [(one, one.picture) for one in frames if one.picture is not None]
    tallies = [tally for _, tally in found]
    fault = picture.fault(tallies)
    lit = next(((one, of.light) for one, of in found if of.light is not None), None)
    if fault is None or lit is None:
        return None
    frame, light = lit
    surfaces = sum(one.surfaces for one in tallies)
    share = sum(one.black if fault == "black" else one.burnt for one in tallies) / surfaces
    mean = sum(one.surfaces * one.mean_luminance for one in tallies) / surfaces
    whose = "its frame" if len(found) == 1 else f"its {len(found)} frames"
    return (
        f"{fault}: {100.0 * share:.1f} % of the surfaces in {whose} are {_HOW[fault]}; mean "
        f"luminance {mean:.3g} W/(m^2 sr), exposure {frame.exposure_ev:+.4g} EV "
        f"({frame.exposure.rule or 'given'}) at sample {frame.sample}; "
        f"{_light(light)}; {_mend(fault, frame.exposure, light)}"
    )


def _light(light: LightRecord) -> str:
    parts = []
    for sun in light.suns:
        part = f"{sun.prim} gives {sun.irradiance:.3g} W/m^2"
        if not sun.normalized:
            part += (
                " (inputs:normalize is off, so its intensity is the radiance of a disc of "
                f"{sun.angle_deg:.3g} degrees, E = L pi sin(angle / 2)^2: switch normalize on "
                "if it is meant as irradiance)"
            )
        parts.append(part)
    if light.sky_radiance > 0.0:
        parts.append(f"the sky's mean radiance is {light.sky_radiance:.3g} W/(m^2 sr)")
    lamps = [value for value in light.lamps_w_sr if value > 0.0]
    if lamps:
        parts.append(f"the brightest of {len(lamps)} lamps gives {max(lamps):.3g} W/sr")
    return ", ".join(parts) if parts else "there is no light in the stage that is read"


def _mend(fault: str, exposure: ExposureRecord, light: LightRecord) -> str:
    strengths = [sun.irradiance for sun in light.suns]
    if max(*strengths, light.sky_radiance, *light.lamps_w_sr, 0.0) <= 0.0:
        return "add a light"
    if exposure.rule == "auto":
        if exposure.of == "nothing":
            return "none of that reaches what the camera sees: move or turn the camera or the light"
        if exposure.per == "batch":
            return "it has one exposure for all samples: ask for one per sample"
    more = "more" if fault == "black" else "less"
    return f"expose {more}, or leave the exposure out: it is found then"
