"""Writes frames: EXR, picture and sidecar. How they are laid out: ``scenec.schemas.frames``."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.annotate import Annotation
from scenec.backends.annotation.instances import Seen
from scenec.backends.annotation.registry import find_pass
from scenec.backends.camera.shutter import row_poses
from scenec.backends.imaging.taken import TONE_CURVE, Taken
from scenec.backends.picture.sky import combine, mean_radiance
from scenec.backends.stage.scene import Camera, Lighting, RenderScene
from scenec.schemas import picture
from scenec.schemas.amodal import amodal_path, read_amodal, write_amodal
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.exr import write_exr
from scenec.schemas.files import sha256, write_json
from scenec.schemas.frames import (
    BESIDE,
    CONVENTIONS,
    FRAME_VERSION,
    LENS_CONVENTION,
    SHUTTER_CONVENTION,
    FrameKey,
    beside_path,
    read_frame,
)
from scenec.schemas.instances import frame_table_path, read_frame_table, write_frame_table
from scenec.schemas.lens import KANNALA_BRANDT, Lens
from scenec.schemas.passes import AMODAL, origins
from scenec.schemas.picture import luminance
from scenec.schemas.versions import version_of


def write_frame(
    stem: Path,
    passes: Mapping[str, NDArray],
    key: FrameKey,
    scene: RenderScene,
    camera: Camera,
    sample: int,
    details: Mapping[str, Any],
    seen: Seen | None = None,
    taken: Taken | None = None,
    surfaces: NDArray[np.bool_] | None = None,
) -> dict[str, Any]:
    """Writes EXR, PNG (if there is ``rgb``), table, masks and sidecar, each by atomic rename.

    Args:
        stem: See ``frame_stem``.
        passes: Arrays by name.
        key: What the frame was made with.
        scene: The stage it shows.
        camera: The camera it was seen by.
        sample: Time code.
        details: More for the sidecar: what ``Session.render`` returns.
        seen: What it shows of instances (``schemas.instances``, ``schemas.amodal``), if it has that
            pass.
        taken: What the camera's sensor made of ``rgb``, where it has imaging.
        surfaces: Where ``rgb`` shows surfaces, [h, w]; None: not known.

    Returns:
        The sidecar.

    Raises:
        OutputError: A file cannot be written.
    """
    # An old sidecar must not vouch for a new picture if this is cut short.
    _unlink(stem.with_suffix(".json"))
    exr = stem.with_suffix(".exr")
    others = {name: find_pass(name) for name in origins(passes)}
    write_exr(exr, passes, others)
    shown = None
    if taken is not None:
        shown = taken.picture
    elif "rgb" in passes:
        shown = picture.develop(passes["rgb"], camera.exposure_ev)
    if camera.effects and shown is not None:
        # Imported here: few cameras have any.
        from scenec.backends.imaging.effects import apply

        shown = apply(shown, camera.effects, sample)
    _put(stem.with_suffix(".png"), shown, picture.write_png)
    beside = {
        kind: _put(beside_path(stem, kind), getattr(taken, kind, None), picture.write_png)
        for kind in BESIDE
    }
    listed, amodal = (None, None) if seen is None else (seen.table, seen.amodal)
    table = _put(frame_table_path(stem), listed, write_frame_table)
    masks = _put(amodal_path(stem), amodal, write_amodal)
    sidecar: dict[str, Any] = {
        "version": FRAME_VERSION,
        "camera": camera.name,
        "camera_prim": camera.path,
        **({} if camera.partner is None else {"partner": partner_name(scene, camera)}),
        "sample": sample,
        "time_s": time_of(scene, sample),
        "resolution": [camera.width, camera.height],
        "intrinsics": camera.intrinsics.tolist(),
        **({} if camera.lens is None else {"lens": lens_facts(camera.lens)}),
        "camera_to_world": camera.camera_to_world.tolist(),
        **({} if camera.shutter is None else {"shutter": shutter_facts(camera)}),
        "exposure_ev": camera.exposure_ev if taken is None else taken.exposure_ev,
        "trigger": list(camera.trigger),
        "tone_curve": picture.DESCRIPTION if taken is None else TONE_CURVE,
        "passes": list(passes),
        "conventions": CONVENTIONS | {name: one.convention for name, one in others.items()},
        "labels": label_facts(scene),
        "sky_labels": scene.sky_labels,
        "sun": sun_facts(scene.lighting[sample]),
        "instances": scene.instance_paths,
        "backend": key.backend,
        "backend_version": key.backend_version,
        "spp": key.spp,
        "noise_seed": key.noise_seed,
        "stage_digest": key.stage_digest,
        "resume_key": key.digest(),
        "exr": _vouch(exr),
        "png": "rgb" in passes,
        "picture": picture_facts(passes, shown, surfaces, scene.lighting[sample]),
        "instance_table": table,
        "amodal": masks,
        **({} if taken is None else {"imaging": taken.facts | beside}),
        **({"effects": [json.loads(one) for one in camera.effects]} if camera.effects else {}),
        **details,
    }
    sidecar = plain(sidecar)
    write_json(stem.with_suffix(".json"), sidecar)
    return sidecar


def annotated(stem: Path, digest: str, passes: Sequence[str]) -> Annotation | None:
    """Annotation of this very picture that some backend's frame holds; None if none does.

    Args:
        stem: Where the frame will be.
        digest: Of the stage.
        passes: All but ``rgb`` that are needed.
    """
    for path in sorted(stem.parents[2].glob(f"*/{stem.parent.name}/{stem.name}.json")):
        try:
            sidecar = json.loads(path.read_bytes())
            if (
                sidecar["stage_digest"] != digest
                or not annotation_facts(passes).items() <= sidecar["annotation"].items()
                or not set(passes) - {AMODAL} <= set(sidecar["passes"])
                or (AMODAL in passes and sidecar["amodal"] is None)
            ):
                continue
            frame = read_frame(path, passes, [n for n in sidecar["passes"] if n not in passes])
            seen = None
            if "instance" in passes:
                masks = read_amodal(path) if AMODAL in passes else None
                seen = Seen(read_frame_table(path), masks)
            sky = sidecar["sky"]["pixels"], sidecar["sky"]["below_horizon"]
            return Annotation(frame.passes, seen, sidecar["height_above_surface_m"], sky)
        except (FrameError, OSError, ValueError, KeyError, TypeError):
            # Damaged, or of another version: it is cast again.
            continue
    return None


def annotation_facts(passes: Sequence[str]) -> dict[str, str]:
    """What made the annotation, for sidecars; passes of other packages by name."""
    return {"scenec": version_of(), **origins(passes)}


def label_facts(scene: RenderScene) -> dict[str, dict[str, str]]:
    """Ids and names of each level as sidecars state them."""
    return {
        level: {str(i): name for i, name in sorted(scene.label_names.get(level, {}).items())}
        for level in scene.levels
    }


def time_of(scene: RenderScene, sample: int) -> float | None:
    """Seconds of a sample; None where the stage does not say."""
    return float(scene.times[sample]) if sample < len(scene.times) else None


def partner_name(scene: RenderScene, camera: Camera) -> str | None:
    """Name of the camera that disparity goes to; None if the stage has no such camera."""
    every = (other for cameras in scene.cameras for other in cameras)
    return next((other.name for other in every if other.path == camera.partner), None)


def lens_facts(lens: Lens) -> dict[str, Any]:
    """A lens as sidecars state it; ``schemas.lens.from_sidecar`` reads it back."""
    facts: dict[str, Any] = {
        "model": lens.model,
        "coefficients": lens.coefficients,
        "convention": LENS_CONVENTION[lens.model],
    }
    if lens.model == KANNALA_BRANDT:
        facts["max_angle_deg"] = math.degrees(lens.max_angle)
    return facts


def shutter_facts(camera: Camera) -> dict[str, Any]:
    """A camera's shutter as sidecars state it."""
    held = camera.shutter
    assert held is not None
    ends = row_poses(camera)[[0, -1]]
    return {
        "exposure_s": held.shutter.exposure_s,
        "readout_s": held.shutter.readout_s,
        "direction": "up" if held.shutter.upward else "down",
        "first_row": ends[0],
        "last_row": ends[1],
        "times_s": held.times,
        "camera_to_world": held.camera_to_world,
        "convention": SHUTTER_CONVENTION,
    }


def sun_facts(lighting: Lighting) -> dict[str, Any] | None:
    """The brightest sun as sidecars state it (``CONVENTIONS["sun"]``); None without one."""
    if not lighting.suns:
        return None
    # Rec.709 luminance; of equal ones the first.
    sun = max(lighting.suns, key=lambda s: float(luminance(s.irradiance)))
    x, y, z = sun.to_light.tolist()
    return {
        "elevation_deg": math.degrees(math.atan2(z, math.hypot(x, y))),
        "azimuth_deg": math.degrees(math.atan2(x, y)) % 360.0,
        "irradiance": sun.irradiance.tolist(),
    }


def picture_facts(
    passes: Mapping[str, NDArray],
    shown: NDArray[np.uint8] | None,
    surfaces: NDArray[np.bool_] | None,
    lighting: Lighting,
) -> dict[str, Any] | None:
    """How bright a picture shows surfaces, as sidecars state it; None where there is none.

    Where it is black or burnt out, with the light that there is.
    """
    if shown is None or surfaces is None:
        return None
    found = picture.tally(shown, passes["rgb"], surfaces)
    if picture.fault([found]) is None:
        return found
    return found | {"light": light_facts(lighting)}


def light_facts(lighting: Lighting) -> dict[str, Any]:
    """What light there is at a sample, by luminance."""
    suns = [
        {
            "prim": sun.path,
            "irradiance": float(luminance(sun.irradiance)),
            "angle_deg": math.degrees(sun.diameter_rad),
            "normalized": sun.normalized,
        }
        for sun in lighting.suns
    ]
    sky = combine(lighting.domes)
    return {
        "suns": suns,
        "sky_radiance": 0.0 if sky is None else float(luminance(mean_radiance(sky))),
        "lamps_w_sr": [float(luminance(lamp.intensity)) for lamp in lighting.lamps],
    }


def _put[T](path: Path, value: T | None, write: Callable[[Path, T], None]) -> dict[str, Any] | None:
    """Write a file beside a frame, and vouch for it; what is not of this frame is removed."""
    if value is None:
        _unlink(path)
        return None
    write(path, value)
    return _vouch(path)


def _vouch(path: Path) -> dict[str, Any]:
    """What tells whether a file is still the one that was written."""
    return {"bytes": path.stat().st_size, "sha256": sha256(path)}


def plain(value: Any) -> Any:
    """The same in plain Python types, as JSON has them: arrays as lists, paths as text."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, Path):
        return value.as_posix()
    return value


def _unlink(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot replace: {error.strerror}") from error
