"""Reads sidecars of frames, wherever they come from."""

from __future__ import annotations

import math
from pathlib import Path

from scenec.schemas.codec import UNSET, decode
from scenec.schemas.errors import FrameError
from scenec.schemas.files import read_json
from scenec.schemas.lens import Lens
from scenec.schemas.records import FrameRecord, LensRecord

#: What a reader may rely on in every sidecar.
REQUIRED_KEYS = ("camera", "sample", "resolution", "intrinsics", "camera_to_world", "passes",
                 "labels", "backend", "exposure_ev", "stage_digest")  # fmt: skip


def read_sidecar(path: Path) -> FrameRecord:
    """Reads a frame's sidecar.

    Raises:
        FrameError: It is missing or damaged, or says what no sidecar does; with the JSON pointer.
    """
    try:
        sidecar = read_json(path, FrameError, "sidecar of scenec")
    except FileNotFoundError as error:
        raise FrameError(f"{path}: no such frame (the sidecar is missing)") from error
    if not isinstance(sidecar, dict) or not isinstance(sidecar.get("exr"), dict):
        raise FrameError(f"{path}: is no sidecar of scenec")
    lacking = [key for key in REQUIRED_KEYS if key not in sidecar]
    if lacking:
        raise FrameError(f"{path}: a sidecar without {', '.join(lacking)}; render it again")
    return decode(sidecar, FrameRecord, FrameError, f"{path}: is no sidecar of scenec")


def lens_of(record: LensRecord | None) -> Lens | None:
    """Returns the lens that a frame's record states; None: a pinhole."""
    if record is None:
        return None
    angle = 180.0 if record.max_angle_deg is UNSET else record.max_angle_deg
    coefficients = tuple(float(c) for c in record.coefficients)
    return Lens(record.model, coefficients, min(math.radians(angle), math.pi))
