"""Writes frames: EXR, picture and sidecar. How they are laid out: ``scenec.schemas.frames``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.render_scene import Camera, RenderScene
from scenec.schemas import picture
from scenec.schemas.errors import OutputError
from scenec.schemas.exr import write_exr
from scenec.schemas.files import sha256, write_json
from scenec.schemas.frames import CONVENTIONS, FRAME_VERSION, FrameKey
from scenec.schemas.instances import frame_table_path, write_frame_table


def write_frame(
    stem: Path,
    passes: Mapping[str, NDArray],
    key: FrameKey,
    scene: RenderScene,
    camera: Camera,
    sample: int,
    details: Mapping[str, Any],
    table: dict[str, NDArray] | None = None,
) -> None:
    """Write EXR, PNG (if there is ``rgb``), table and sidecar, each by atomic rename.

    Args:
        stem: See ``frame_stem``.
        passes: Arrays by name.
        key: What the frame was made with.
        scene: The stage it shows.
        camera: The camera it was seen by.
        sample: Time code.
        details: More for the sidecar: what ``Session.render`` returns.
        table: What it shows of instances (``schemas.instances``), if it has that pass.

    Raises:
        OutputError: A file cannot be written.
    """
    # An old sidecar must not vouch for a new picture if this is cut short.
    _unlink(stem.with_suffix(".json"))
    exr = stem.with_suffix(".exr")
    write_exr(exr, passes)
    if "rgb" not in passes:
        # A picture of an earlier frame does not belong to this one.
        _unlink(stem.with_suffix(".png"))
    else:
        picture.write_png(
            stem.with_suffix(".png"), picture.develop(passes["rgb"], camera.exposure_ev)
        )
    listed = frame_table_path(stem)
    if table is None:
        _unlink(listed)
    else:
        write_frame_table(listed, table)
    sidecar = {
        "version": FRAME_VERSION,
        "camera": camera.name,
        "camera_prim": camera.path,
        "sample": sample,
        "time_s": float(scene.times[sample]) if sample < len(scene.times) else None,
        "resolution": [camera.width, camera.height],
        "intrinsics": camera.intrinsics.tolist(),
        "camera_to_world": camera.camera_to_world.tolist(),
        "exposure_ev": camera.exposure_ev,
        "tone_curve": picture.DESCRIPTION,
        "passes": list(passes),
        "conventions": CONVENTIONS,
        "labels": {
            level: {str(i): name for i, name in sorted(scene.label_names.get(level, {}).items())}
            for level in scene.levels
        },
        "sky_labels": scene.sky_labels,
        "instances": scene.instance_paths,
        "backend": key.backend,
        "backend_version": key.backend_version,
        "spp": key.spp,
        "noise_seed": key.noise_seed,
        "stage_digest": key.stage_digest,
        "resume_key": key.digest(),
        "exr": {"bytes": exr.stat().st_size, "sha256": sha256(exr)},
        "png": "rgb" in passes,
        "instance_table": None
        if table is None
        else {"bytes": listed.stat().st_size, "sha256": sha256(listed)},
        **details,
    }
    write_json(stem.with_suffix(".json"), plain(sidecar))


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
