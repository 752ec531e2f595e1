"""Frames on disk: OUT/batch_0000/frames/<backend>/<camera>/000000.{exr,png,json}.

The EXR holds the passes (``scenec.backends.exr``), the PNG is a picture of ``rgb``
(``scenec.backends.picture``), the JSON sidecar says what they are. The sidecar is written last: a
frame without one does not exist.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends import picture
from scenec.backends.exr import read_exr, write_exr
from scenec.backends.render_scene import Camera, RenderScene
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import sha256, write_json

#: Version of the sidecar's shape.
FRAME_VERSION = "1.0"

CONVENTIONS = {
    "pixel": "column 0, row 0 is the top-left pixel; its center is at (0.5, 0.5)",
    "intrinsics": "K, row-major: u = fx*X/Z + s*Y/Z + cx, v = fy*Y/Z + cy, pixels",
    "camera_to_world": "4x4, row-major, column vectors; camera axes x right, y down, z forward "
    "(OpenCV); world in metres, Z up, right-handed",
    "rgb": "linear Rec.709 radiance, mean over the pixel's area (box filter)",
    "depth": "metres along the optical axis, at the pixel's center; +inf without a hit",
    "range": "metres along the ray, at the pixel's center; +inf without a hit",
    "label": "id at the pixel's center; 0 is no label",
    "instance": "id at the pixel's center; 0 is no instance",
    "face": "index of the authored face; 4294967295 without a hit",
    "normal": "geometric, world frame, facing the camera; 0 without a hit",
    "position": "world frame, metres; NaN without a hit",
}


@dataclass(frozen=True)
class Frame:
    """A frame read back.

    Attributes:
        path: Of the sidecar.
        passes: Pass name -> array, as in ``exr.read_exr``.
        sidecar: The sidecar as JSON values.
    """

    path: Path
    passes: dict[str, NDArray]
    sidecar: dict[str, Any]


@dataclass(frozen=True)
class FrameKey:
    """What decides a frame's content, beside its place.

    Attributes:
        stage_digest: ``RenderScene.digest``.
        passes: Names asked for, in order.
        spp: Samples per pixel; 0 without ``rgb``.
        noise_seed: Seed of the renderer's noise.
        backend: Name.
        backend_version: ``Backend.version()``.
    """

    stage_digest: str
    passes: tuple[str, ...]
    spp: int
    noise_seed: int
    backend: str
    backend_version: str

    def digest(self) -> str:
        """The resume key: sha256, hex."""
        values = {"frame": FRAME_VERSION, "scenec": version("scenec"), **asdict(self)}
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def frame_stem(folder: Path, backend: str, camera: str, sample: int) -> Path:
    """Path of a frame without its suffix."""
    return folder / "frames" / backend / camera / f"{sample:06d}"


def is_done(stem: Path, key: FrameKey) -> bool:
    """Whether the frame is there, whole as far as its sizes tell, and made with this key."""
    try:
        sidecar = json.loads(stem.with_suffix(".json").read_bytes())
        done: bool = (
            sidecar["resume_key"] == key.digest()
            and stem.with_suffix(".exr").stat().st_size == sidecar["exr"]["bytes"]
            and (not sidecar["png"] or stem.with_suffix(".png").is_file())
        )
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return done


def write_frame(
    stem: Path,
    passes: Mapping[str, NDArray],
    key: FrameKey,
    scene: RenderScene,
    camera: Camera,
    sample: int,
    details: Mapping[str, Any],
) -> None:
    """Write EXR, PNG (if there is ``rgb``) and sidecar, each by atomic rename.

    Args:
        stem: See ``frame_stem``.
        passes: Arrays by name.
        key: What the frame was made with.
        scene: The stage it shows.
        camera: The camera it was seen by.
        sample: Time code.
        details: More for the sidecar: ``seconds``, ``estimated_error``, ``resolver`` ...

    Raises:
        OutputError: A file cannot be written.
    """
    # An old sidecar must not vouch for a new picture if this is cut short.
    _unlink(stem.with_suffix(".json"))
    exr = stem.with_suffix(".exr")
    write_exr(exr, passes)
    if "rgb" in passes:
        picture.write_png(
            stem.with_suffix(".png"), picture.develop(passes["rgb"], camera.exposure_ev)
        )
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
        **details,
    }
    write_json(stem.with_suffix(".json"), plain(sidecar))


def read_frame(path: Path, passes: Sequence[str] | None = None) -> Frame:
    """Read a frame and check it against its sidecar.

    Args:
        path: Any of the frame's files, or its stem.
        passes: Names that must be there; None takes what is there.

    Raises:
        FrameError: Something is missing, truncated, changed since, or not a frame.
    """
    path = Path(path)
    stem = path.with_suffix("") if path.suffix in (".exr", ".json", ".png") else path
    json_path, exr_path = stem.with_suffix(".json"), stem.with_suffix(".exr")
    try:
        sidecar = json.loads(json_path.read_bytes())
    except FileNotFoundError as error:
        raise FrameError(f"{json_path}: no such frame (the sidecar is missing)") from error
    except (OSError, ValueError) as error:
        raise FrameError(f"{json_path}: not a sidecar: {error}") from error
    if not isinstance(sidecar, dict) or not isinstance(sidecar.get("exr"), dict):
        raise FrameError(f"{json_path}: not a sidecar of scenec")
    if not exr_path.is_file():
        raise FrameError(f"{exr_path}: missing, though its sidecar is there; render it again")
    if sha256(exr_path) != sidecar["exr"].get("sha256"):
        raise FrameError(
            f"{exr_path}: truncated, damaged or changed since it was written (its checksum is not "
            "the sidecar's); render it again"
        )
    arrays = read_exr(exr_path)
    missing = [name for name in passes or () if name not in arrays]
    if missing:
        raise FrameError(
            f"{exr_path}: has no {', '.join(missing)} (it holds {', '.join(arrays)}); render with "
            f"--passes {','.join([*arrays, *missing])}"
        )
    return Frame(json_path, arrays, sidecar)


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
