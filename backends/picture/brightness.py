"""Says which cameras' pictures are black or burnt out, or show the ground of the sky's picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scenec.schemas import picture

#: Share of a camera's pixels of sky that may look down: the sea's horizon dips by 0.03 degrees a
#: meter's root of height, and land ends somewhere.
SKY_BELOW = 0.01
_HOW = {
    "black": f"below code {picture.BLACK} in every channel",
    "burnt out": f"at code {picture.BURNT} or above in every channel",
}


def brief(sidecar: Mapping[str, Any]) -> dict[str, Any]:
    """What ``told`` needs of a sidecar; one may be long."""
    keys = ("sample", "exposure_ev", "exposure", "picture", "sky")
    return {key: sidecar.get(key) for key in keys}


def told_of_sky(sidecars: Sequence[Mapping[str, Any]]) -> str | None:
    """Warns in a line of sky visible below the horizon; None if there is next to none.

    Args:
        sidecars: As of ``told``; those without a ``sky`` do not count.
    """
    found = [one["sky"] for one in sidecars if one.get("sky")]
    pixels, below = (sum(one[key] for one in found) for key in ("pixels", "below_horizon"))
    if below <= SKY_BELOW * pixels:
        return None
    frames = "its frame" if len(found) == 1 else f"its {len(found)} frames"
    return (
        f"{100.0 * below / pixels:.0f} % of the sky in {frames} lies below the horizon, where the "
        "ground ends and the sky's picture goes on: it has the sky's label; give the terrain a "
        "horizon, or light.sky labels_below"
    )


def told(sidecars: Sequence[Mapping[str, Any]]) -> str | None:
    """A line about the pictures of one camera and backend in one batch; None if all is well.

    Args:
        sidecars: Of its frames, or their ``brief``; those without a ``picture`` do not count.
    """
    found = [one for one in sidecars if one.get("picture")]
    tallies = [one["picture"] for one in found]
    fault = picture.fault(tallies)
    lit = next((one for one in found if "light" in one["picture"]), None)
    if fault is None or lit is None:
        return None
    surfaces = sum(one["surfaces"] for one in tallies)
    share = sum(one["black" if fault == "black" else "burnt"] for one in tallies) / surfaces
    mean = sum(one["surfaces"] * one["mean_luminance"] for one in tallies) / surfaces
    exposure = lit.get("exposure") or {}
    frames = "its frame" if len(found) == 1 else f"its {len(found)} frames"
    return (
        f"{fault}: {100.0 * share:.1f} % of the surfaces in {frames} are {_HOW[fault]}; mean "
        f"luminance {mean:.3g} W/(m^2 sr), exposure {lit['exposure_ev']:+.4g} EV "
        f"({exposure.get('rule', 'given')}) at sample {lit['sample']}; "
        f"{_light(lit['picture']['light'])}; "
        f"{_mend(fault, exposure, lit['picture']['light'])}"
    )


def _light(light: Mapping[str, Any]) -> str:
    parts = []
    for sun in light["suns"]:
        part = f"{sun['prim']} gives {sun['irradiance']:.3g} W/m^2"
        if not sun["normalized"]:
            part += (
                " (inputs:normalize is off, so its intensity is the radiance of a disc of "
                f"{sun['angle_deg']:.3g} degrees, E = L pi sin(angle / 2)^2: switch normalize on "
                "if it is meant as irradiance)"
            )
        parts.append(part)
    if light["sky_radiance"] > 0.0:
        parts.append(f"the sky's mean radiance is {light['sky_radiance']:.3g} W/(m^2 sr)")
    lamps = [value for value in light["lamps_w_sr"] if value > 0.0]
    if lamps:
        parts.append(f"the brightest of {len(lamps)} lamps gives {max(lamps):.3g} W/sr")
    return ", ".join(parts) if parts else "there is no light in the stage that is read"


def _mend(fault: str, exposure: Mapping[str, Any], light: Mapping[str, Any]) -> str:
    strengths = [sun["irradiance"] for sun in light["suns"]]
    if max(*strengths, light["sky_radiance"], *light["lamps_w_sr"], 0.0) <= 0.0:
        return "add a light"
    if exposure.get("rule") == "auto":
        if exposure.get("of") == "nothing":
            return "none of that reaches what the camera sees: move or turn the camera or the light"
        if exposure.get("per") == "batch":
            return "it has one exposure for all samples: ask for one per sample"
    more = "more" if fault == "black" else "less"
    return f"expose {more}, or leave the exposure out: it is found then"
