"""Writes frames: EXR, picture and sidecar. How they are laid out: ``scenec.schemas.frames``."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from scenec.backends.annotation.registry import find_pass
from scenec.backends.imaging.result import TONE_CURVE, SensorResult
from scenec.backends.run.facts import FrameResult, picture_record
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas import picture
from scenec.schemas.amodal import amodal_path, write_amodal
from scenec.schemas.codec import encode
from scenec.schemas.errors import OutputError
from scenec.schemas.exr import as_half, write_exr
from scenec.schemas.files import sha256, write_json
from scenec.schemas.frames import CONVENTIONS, FrameKey, extra_path
from scenec.schemas.instances import frame_table_path, write_frame_table
from scenec.schemas.passes import origins
from scenec.schemas.records import FileDigest, FrameRecord


def write_frame(
    stem: Path,
    result: FrameResult,
    key: FrameKey,
    scene: RenderScene,
    camera: Camera,
    sensor: SensorResult | None = None,
) -> FrameRecord:
    """Writes EXR, PNG (if there is ``rgb``), table, masks and sidecar, each by atomic rename.

    Args:
        stem: See ``frame_stem``.
        result: The frame, as ``Session.render`` returns it.
        key: What the frame was made with.
        scene: The stage it shows.
        camera: The camera it was seen by.
        sensor: What the camera's sensor made of ``rgb``, where it has imaging.

    Returns:
        The sidecar's record.

    Raises:
        OutputError: A file cannot be written.
    """
    # An old sidecar must not vouch for a new picture if this is cut short.
    _unlink(stem.with_suffix(".json"))
    exr, passes, record = stem.with_suffix(".exr"), result.arrays, result.record
    others = {name: find_pass(name) for name in origins(passes)}
    half = None
    if key.half:
        stored, half = as_half(passes["rgb"])
        write_exr(exr, {**passes, "rgb": stored}, others)
    else:
        write_exr(exr, passes, others)
    shown = None
    if sensor is not None:
        shown = sensor.picture
    elif "rgb" in passes:
        shown = picture.develop(passes["rgb"], camera.exposure_ev)
    if camera.effects and shown is not None:
        # Imported here: few cameras have any.
        from scenec.backends.imaging.effects import apply

        shown = apply(shown, camera.effects, record.sample)
    write_photo = partial(picture.write_png, level=picture.RENDERED)
    _put(stem.with_suffix(".png"), shown, write_photo)
    clean = _put(extra_path(stem, "clean"), None if sensor is None else sensor.clean, write_photo)
    raw = _put(extra_path(stem, "raw"), None if sensor is None else sensor.raw, picture.write_png)
    seen = result.seen
    listed, amodal = (None, None) if seen is None else (seen.table, seen.amodal)
    brightness = None
    if shown is not None and result.surfaces is not None:
        lighting = scene.lighting[record.sample]
        brightness = picture_record(passes["rgb"], shown, result.surfaces, lighting)
    record = replace(
        record,
        exposure_ev=camera.exposure_ev if sensor is None else sensor.exposure_ev,
        tone_curve=picture.DESCRIPTION if sensor is None else TONE_CURVE,
        passes=tuple(passes),
        conventions=CONVENTIONS | {name: one.convention for name, one in others.items()},
        backend=key.backend,
        backend_version=key.backend_version,
        spp=key.spp,
        noise_seed=key.noise_seed,
        stage_digest=key.stage_digest,
        resume_key=key.digest(),
        exr=_vouch(exr),
        png="rgb" in passes,
        picture=brightness,
        half=half,
        instance_table=_put(frame_table_path(stem), listed, write_frame_table),
        amodal=_put(amodal_path(stem), amodal, write_amodal),
        imaging=None if sensor is None else replace(sensor.record, clean=clean, raw=raw),
        effects=tuple(json.loads(one) for one in camera.effects) or None,
    )
    write_json(stem.with_suffix(".json"), encode(record))
    return record


def _put[T](path: Path, value: T | None, write: Callable[[Path, T], None]) -> FileDigest | None:
    """Write a file beside a frame, and vouch for it; what is not of this frame is removed."""
    if value is None:
        _unlink(path)
        return None
    write(path, value)
    return _vouch(path)


def _vouch(path: Path) -> FileDigest:
    """Returns the size and digest by which a file is later verified."""
    return FileDigest(bytes=path.stat().st_size, sha256=sha256(path))


def _unlink(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot replace: {error.strerror}") from error
