"""What is relied on in sidecars of frames, wherever they come from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scenec.schemas.errors import FrameError
from scenec.schemas.files import read_json
from scenec.schemas.shape import Each, is_number, natural, require_shape

#: What a reader may rely on in every sidecar.
REQUIRED_KEYS = ("camera", "sample", "resolution", "intrinsics", "camera_to_world", "passes",
                 "labels", "backend", "exposure_ev", "stage_digest")  # fmt: skip


def read_sidecar(path: Path) -> dict[str, Any]:
    """A frame's sidecar.

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
    require_shape(sidecar, _SHAPE, FrameError, f"{path}: is no sidecar of scenec")
    return sidecar


def _above_0(value: Any) -> str | None:
    return None if type(value) is int and 0 < value < 1 << 20 else "a whole number above 0"


def _table(value: Any) -> str | None:
    """Ids and names of a level of labels."""
    fine = isinstance(value, dict) and all(
        key.isascii() and key.isdigit() and len(key) < 20 and isinstance(name, str)
        for key, name in value.items()
    )
    return None if fine else "ids and their names"


def _lens(value: Any) -> str | None:
    # Imported here: with it comes numba, and few sidecars have a lens.
    from scenec.schemas.lens import COEFFICIENTS

    if not isinstance(value, dict) or value.get("model") not in list(COEFFICIENTS):
        return f"a lens of model {' or '.join(COEFFICIENTS)}"
    numbers = value.get("coefficients")
    if not isinstance(numbers, list) or len(numbers) != len(COEFFICIENTS[value["model"]]):
        return f"a lens with {len(COEFFICIENTS[value['model']])} coefficients"
    fine = all(is_number(number) for number in [*numbers, value.get("max_angle_deg", 0.0)])
    return None if fine else "a lens whose values are finite numbers"


_MATRIX = [[float] * 4] * 4
_FILE = {"sha256": str, "bytes?": natural}
_ERROR = {f"{key}?": (None, float)
          for key in ("relative_rms", "relative_rms_bound_95", "relative_mse")}  # fmt: skip
_SUN = {"prim": str, "irradiance": float, "normalized": bool, "angle_deg": float}
_LIGHT = {"suns": [_SUN], "sky_radiance": float, "lamps_w_sr": [float]}
_PICTURE = {"surfaces": natural, "black": natural, "burnt": natural, "mean_luminance": float,
            "light?": _LIGHT}  # fmt: skip
_COUNTS = dict.fromkeys(("pixels", "suspects", "changed", "changed_rows"), natural)
_SHAPE = {
    "camera": str,
    "camera_prim?": (None, str),
    "partner?": (None, str),
    "sample": natural,
    "time_s?": (None, float),
    "resolution": [_above_0, _above_0],
    "intrinsics": [[float] * 3] * 3,
    "lens?": (None, _lens),
    "camera_to_world": _MATRIX,
    "shutter?": (
        None,
        {"exposure_s": float, "readout_s": float, "direction": str, "first_row": _MATRIX,
         "last_row": _MATRIX, "times_s": [float], "camera_to_world": [_MATRIX]},
    ),
    "exposure_ev": float,
    "exposure?": (None, {"rule?": str, "per?": str, "of?": str}),
    "picture?": (None, _PICTURE),
    "trigger?": (None, [_above_0, natural]),
    "passes": [str],
    "labels": Each(_table),
    "sky_labels?": (None, Each(natural)),
    "sun?": (None, {"elevation_deg": float, "azimuth_deg": float, "irradiance": [float] * 3}),
    "height_above_surface_m?": (None, float),
    "sky?": (None, {"pixels": natural, "below_horizon": natural}),
    "backend": str,
    "backend_version?": (None, str),
    "stage_digest": str,
    "resume_key?": str,
    "exr": _FILE,
    "png?": bool,
    "instance_table?": (None, _FILE),
    "amodal?": (None, _FILE),
    "imaging?": (
        None,
        {"parameters?": (None, dict), "clean?": (None, _FILE), "raw?": (None, _FILE)},
    ),
    "annotation?": (None, {"backend?": (None, str)}),
    "resolver?": (None, _COUNTS),
    "estimated_error?": (None, _ERROR),
    "samples_per_pixel?": (None, natural),
    "seconds?": (None, Each(float)),
}  # fmt: skip
