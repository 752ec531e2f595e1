"""Says which cameras' pictures are black or burnt out, and what light there was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scenec.schemas import picture

_HOW = {
    "black": f"below code {picture.BLACK} in every channel",
    "burnt out": f"at code {picture.BURNT} or above in every channel",
}


def brief(sidecar: Mapping[str, Any]) -> dict[str, Any]:
    """What ``told`` needs of a sidecar; one may be long."""
    return {key: sidecar.get(key) for key in ("sample", "exposure_ev", "exposure", "picture")}


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
        f"{_light(lit['picture']['light'])}; {_mend(fault, exposure)}"
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


def _mend(fault: str, exposure: Mapping[str, Any]) -> str:
    if exposure.get("rule") == "auto":
        if exposure.get("of") == "nothing":
            return "add a light"
        if exposure.get("per") == "batch":
            return "it has one exposure for all samples: ask for one per sample"
    more = "more" if fault == "black" else "less"
    return f"expose {more}, or leave the exposure out: it is found then"
