"""Frames on disk: OUT/batch_0000/frames/<backend>/<camera>/000000.{exr,png,json} and more.

The EXR holds the passes (``scenec.schemas.exr``), the PNG is a picture of ``rgb``
(``scenec.schemas.picture``), the JSON sidecar says what they are; it is written last: a frame
without one does not exist. ``000000.instances.csv`` is a table of the instances that it shows
(``scenec.schemas.instances``), ``000000.amodal.npz`` holds their amodal masks
(``scenec.schemas.amodal``).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from numpy.typing import NDArray

from scenec.schemas.amodal import amodal_path
from scenec.schemas.codec import Unset
from scenec.schemas.errors import FrameError
from scenec.schemas.exr import read_exr
from scenec.schemas.files import frame_stem_of, sha256
from scenec.schemas.instances import frame_table_path
from scenec.schemas.manifest import FRAMES
from scenec.schemas.passes import AMODAL, BUILT_IN, origins
from scenec.schemas.records import FileDigest, FrameRecord, ImagingRecord, RoundsRecord
from scenec.schemas.sidecars import read_sidecar
from scenec.schemas.versions import version_of

#: Version of the sidecar's shape.
FRAME_VERSION = "1.7"

#: What the plane is that ``intrinsics`` take to pixels, where a sidecar has a ``lens``.
LENS_CONVENTION = {
    "brown_conrady": "OpenCV's rational model, k1, k2, p1, p2, k3, k4, k5, k6: K takes (X/Z, Y/Z), "
    "distorted, to pixels; depth is along the optical axis",
    "kannala_brandt": "OpenCV's fisheye, k1, k2, k3, k4: K takes t (1 + k1 t^2 + k2 t^4 + k3 t^6 + "
    "k4 t^8), t the angle to the axis, towards (X, Y), to pixels; pixels beyond max_angle_deg show "
    "nothing: label 0, depth +inf, rgb 0; depth is along the optical axis, 0 or less beside and "
    "behind the camera, where range tells distances",
    "equirectangular": "K takes (atan2(X, Z), atan2(Y, hypot(X, Z))), radians, to pixels; depth is "
    "along the optical axis, 0 or less beside and behind the camera, where range tells distances",
}

#: What a sidecar's ``shutter`` says, where it has one.
SHUTTER_CONVENTION = (
    "time counts from the sample's (time_s), at which the middle of the picture is in the middle "
    "of its exposure: at height v of h rows (row r's center is r + 0.5) that middle is "
    "readout_s (v / h - 1/2) later, or earlier with the direction up, and exposure_s is centered "
    "there; camera_to_world at the times_s, positions linear and turns slerped between them; "
    "first_row and last_row: the camera in the middle of their exposure, as the sidecar's "
    "camera_to_world is of the picture's middle. Annotation is that of the middle of each row's "
    "exposure, in the frame of the camera as it is then (flow: of the row that sees the point "
    "while it is exposed); poses of instances are in the frame of the sample. What moves but the "
    "camera stands as at the sample"
)

#: Pictures beside a sensor's picture, on request: the one without noise, and the raw numbers, 16
#: bits behind the mosaic. A sidecar vouches for them under ``imaging``.
BESIDE = ("clean", "raw")

#: What a sidecar's numbers and passes mean; passes of other packages add theirs.
CONVENTIONS = {
    "pixel": "column 0, row 0 is the top-left pixel; its center is at (0.5, 0.5)",
    "intrinsics": "K, row-major: u = fx*X/Z + s*Y/Z + cx, v = fy*Y/Z + cy, pixels",
    "camera_to_world": "4x4, row-major, column vectors; camera axes x right, y down, z forward "
    "(OpenCV); world in meters, Z up, right-handed",
    **{one.name: one.convention for one in BUILT_IN.values()},
    "partner": "name of the camera that disparity goes to; null where it is not rendered",
    "trigger": "samples from one frame of the camera to the next, and its first one",
    "sun": "the brightest distant light of the sample: elevation above the horizon and compass "
    "bearing of the light itself, clockwise from +Y (north) to +X, degrees; irradiance on a "
    "surface facing it, linear Rec.709, W/m^2; null without one",
    "visibility_m": "meters over which haze leaves 2 % of contrast, by its extinction of luminance"
    " at z = 0; not there without haze",
    "height_above_surface_m": "from the camera straight down to the first surface, meters; null "
    "where there is none",
    "sky": "pixels that show no surface; how many of them look below the horizontal plane and have "
    "a label of the sky all the same",
}


@dataclass(frozen=True)
class Frame:
    """A frame read back.

    Attributes:
        path: Of the sidecar.
        passes: Pass name -> array, as in ``exr.read_exr``.
        sidecar: What its sidecar holds.
    """

    path: Path
    passes: dict[str, NDArray]
    sidecar: FrameRecord


@dataclass(frozen=True)
class FrameKey:
    """Holds all that decides a frame's content, apart from its place.

    Two things are left out on purpose. *Which backend annotated*: annotation is defined, not
    rendered, and so the same to the bit; the sidecar says which one it was (``annotation``), and
    ``scenec check`` holds it against the definition. *The device*: where the picture depends on it,
    ``backend_version`` says so (Mitsuba's variant, for one).

    Attributes:
        stage_digest: ``RenderScene.digest``.
        passes: Names asked for, in order.
        spp: Samples per pixel; 0 without ``rgb``.
        noise_seed: Seed of the renderer's noise.
        backend: Name.
        backend_version: ``Backend.version()``.
        denoise: Whether ``rgb`` is denoised.
        error: Relative rms error that ``rgb`` is rendered to; ``spp`` is then the most. None for no
            such target.
        seconds: Seconds that its light may take, likewise.
        half: Whether ``rgb`` is written as half floats.
    """

    stage_digest: str
    passes: tuple[str, ...]
    spp: int
    noise_seed: int
    backend: str
    backend_version: str
    denoise: bool = False
    error: float | None = None
    seconds: float | None = None
    half: bool = False

    def digest(self) -> str:
        """The resume key: sha256, hex."""
        values = {"frame": FRAME_VERSION, "scenec": version_of(), **asdict(self)}
        values["passes"] = sorted(self.passes)
        others = origins(self.passes)
        if others:
            values["packages"] = others
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def frame_stem(folder: Path, backend: str, camera: str, sample: int, kind: str = FRAMES) -> Path:
    """Path of a frame without its suffix, below the batch's folder ``kind``."""
    return folder / kind / backend / camera / f"{sample:06d}"


def extra_path(stem: Path, kind: str) -> Path:
    """Path of a picture beside the picture, one of ``BESIDE``."""
    return stem.with_name(f"{stem.name}.{kind}.png")


def quality(spp: int, error: float | None, seconds: float | None) -> str:
    """Describes in words how well ``rgb`` is rendered, by the goals of ``FrameKey``."""
    most = f"{spp} samples per pixel"
    if error is None and seconds is None:
        return most
    goals = [] if error is None else [f"to {100 * error:.3g} % error"]
    goals += [] if seconds is None else [f"for {seconds:g} s"]
    return f"{' or '.join(goals)}, at most {most}"


def is_done(stem: Path, key: FrameKey) -> bool:
    """Tells whether the frame exists, complete by its sizes, and made with this key.

    One that holds more passes than are asked for, and is otherwise as asked, counts.
    """
    try:
        record = read_sidecar(stem.with_suffix(".json"))
        wider = key if "rgb" in key.passes else _with_rgb_of(record, key)
        beside = record.imaging or ImagingRecord()
        return (
            set(key.passes) <= _held(record)
            and record.resume_key == replace(wider, passes=tuple(_held(record))).digest()
            and _is_there(stem.with_suffix(".exr"), record.exr)
            and (not record.png or stem.with_suffix(".png").is_file())
            and _is_there(frame_table_path(stem), record.instance_table)
            and _is_there(amodal_path(stem), record.amodal)
            and _is_there(extra_path(stem, "clean"), beside.clean)
            and _is_there(extra_path(stem, "raw"), beside.raw)
        )
    except (OSError, FrameError):
        return False


def would_lose(stem: Path, key: FrameKey) -> str | None:
    """Lists in words what a frame of the same stage has that one of this key would not.

    Returns:
        None where nothing that was asked for then goes: there is no such frame, it is of another
        stage or damaged, or it differs by versions alone.
    """
    try:
        record = read_sidecar(stem.with_suffix(".json"))
        if record.stage_digest != key.stage_digest or not stem.with_suffix(".exr").is_file():
            return None
    except (OSError, FrameError):
        return None
    lost = sorted(_held(record) - set(key.passes))
    parts = [f"holding {', '.join(lost)}, not asked for"] if lost else []
    was = _with_rgb_of(record, key)
    if "rgb" in key.passes and "rgb" in _held(record):
        then, asked = (quality(of.spp, of.error, of.seconds) for of in (was, key))
        parts += [f"rendered otherwise ({then}; asked for: {asked})"] if then != asked else []
        if was.noise_seed != key.noise_seed:
            parts.append(f"of noise seed {was.noise_seed}, not {key.noise_seed}")
        if was.denoise != key.denoise:
            parts.append("denoised" if was.denoise else "not denoised")
        if was.half != key.half:
            parts.append("with rgb as half floats" if was.half else "with rgb as floats")
    return ", ".join(parts) or None


def _held(record: FrameRecord) -> set[str]:
    """Returns the passes of a frame."""
    return {*record.passes, *([AMODAL] if record.amodal is not None else [])}


def _with_rgb_of(record: FrameRecord, key: FrameKey) -> FrameKey:
    """Returns a key of a frame whose ``rgb`` was made as that of a record."""
    rounds = record.rounds or RoundsRecord()
    return replace(
        key,
        spp=record.spp or 0,
        noise_seed=record.noise_seed or 0,
        denoise=record.denoised is not None,
        error=rounds.target_relative_rms,
        seconds=rounds.target_seconds,
        half=record.half is not None,
    )


def _is_there(path: Path, entry: FileDigest | Unset | None) -> bool:
    """Tells whether a file is as large as its sidecar says, or not said to be there."""
    return not entry or path.stat().st_size == entry.bytes


def read_frame(
    path: Path, passes: Sequence[str] | None = None, unused: Sequence[str] = ()
) -> Frame:
    """Read a frame and check it against its sidecar.

    Args:
        path: Any of the frame's files, or its stem.
        passes: Names that must be there (``amodal``: in the sidecar; ``schemas.amodal`` reads it);
            None takes what is there.
        unused: Names of passes that are not decoded; the checksum is of the whole file still.

    Raises:
        FrameError: Something is missing, truncated, changed since, or not a frame.
    """
    stem = frame_stem_of(Path(path))
    json_path, exr_path = stem.with_suffix(".json"), stem.with_suffix(".exr")
    record = read_sidecar(json_path)
    if not exr_path.is_file():
        raise FrameError(f"{exr_path}: missing, though its sidecar is there; render it again")
    if sha256(exr_path) != record.exr.sha256:
        raise FrameError(
            f"{exr_path}: truncated, damaged or changed since it was written (its checksum is not "
            "the sidecar's); render it again"
        )
    # The checksum says that what the sidecar names is there, decoded or not.
    undecoded = [name for name in unused if name in record.passes]
    if len(undecoded) == len(record.passes):
        # A file of no parts is none.
        undecoded, unused = [], ()
    arrays = read_exr(exr_path, unused)
    there = [*arrays, *undecoded, *([AMODAL] if record.amodal is not None else [])]
    missing = [name for name in passes or () if name not in there]
    if missing:
        raise FrameError(
            f"{exr_path}: has no {', '.join(missing)} (it holds {', '.join(there)}); render with "
            f"--passes {','.join([*there, *missing])}"
        )
    return Frame(json_path, arrays, record)
