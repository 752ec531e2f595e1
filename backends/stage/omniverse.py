"""Reads calibrated lenses of Omniverse's cameras, and says by how much ours differ.

Two generations of attributes are read: ``cameraProjectionType`` with ``ftheta*`` and ``openCV*``,
and the schemas ``OmniLensDistortion*API`` (``omni:lensdistortion:*``), whose fallbacks hold where
nothing is authored. They drive the projection in place of focal length and apertures.

``pinholeOpenCV``, ``opencvPinhole``
    OpenCV's pinhole: ``brown_conrady``, exactly. Thin prism terms are left out if they move no
    pixel by more than ``TOLERANCE_PX``, else the camera is refused.
``fisheyeOpenCV``, ``opencvFisheye``
    OpenCV's fisheye: ``kannala_brandt``, exactly.
``fisheyePolynomial``, ``ftheta``
    The ray at r pixels from the optical center is at k0 + k1 r + ... + k5 r^5 radians from the axis
    (omni.syntheticdata, ``helpers.ftheta_distortion``). A ``kannala_brandt`` goes through five of
    its points; if it is off by more than ``TOLERANCE_PX`` anywhere, the camera is refused.

Centers of pixels are at (0.5, 0.5), so that the middle of a picture is half its size, as in
omni.syntheticdata. Pictures of another size than the calibrated one are scaled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from scenec.backends.stage import values
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.lens import BROWN_CONRADY, KANNALA_BRANDT, Lens, directions, to_plane

#: How far a lens of ours may be from theirs anywhere in a picture, pixels.
TOLERANCE_PX = 0.5
_PREFIX = "omni:lensdistortion:"
_PROJECTION = "cameraProjectionType"
#: Names of ``cameraProjectionType`` and of schemas, by the model that they stand for.
_MODELS = {
    "fisheyePolynomial": "ftheta",
    "pinholeOpenCV": "opencvPinhole",
    "fisheyeOpenCV": "opencvFisheye",
    "fisheyeKannalaBrandtK3": "kannalaBrandtK3",
    "fisheyeRadTanThinPrism": "radTanThinPrism",
    "OmniLensDistortionFthetaAPI": "ftheta",
    "OmniLensDistortionOpenCvPinholeAPI": "opencvPinhole",
    "OmniLensDistortionOpenCvFisheyeAPI": "opencvFisheye",
    "OmniLensDistortionKannalaBrandtK3API": "kannalaBrandtK3",
    "OmniLensDistortionRadTanThinPrismAPI": "radTanThinPrism",
    "OmniLensDistortionLutAPI": "lut",
    "OmniLensDistortionOmniDirectionalStereoAPI": "omniDirectionalStereo",
}
#: Models that no lens here is, and what would be needed.
_REFUSED = {
    "fisheyeOrthographic": "a lens with radii of sin(t)",
    "fisheyeEquidistant": "its pixels per radian, as fisheyePolynomial has them",
    "fisheyeEquisolid": "a lens with radii of 2 sin(t / 2)",
    "fisheyeSpherical": "its angles per pixel",
    "kannalaBrandtK3": "the unit of its coefficients; opencvFisheye has the same terms",
    "radTanThinPrism": "a fisheye lens with tangential and thin prism terms",
    "generalizedProjection": "a lens of tabulated rays",
    "lut": "a lens of tabulated rays",
    "omniDirectionalStereo": "rays from more than one eye",
}
#: By key: attribute, which of its numbers, and the number where nothing is authored (None: a
#: fault).
type _Table = dict[str, tuple[str, int, float | None]]
_POLYNOMIAL = {f"k{i}": (f"fthetaPoly{c}", 0, 0.0) for i, c in enumerate("ABCDEF")}
_OLDER: _Table = {
    "width": ("fthetaWidth", 0, None),
    "height": ("fthetaHeight", 0, None),
    "cx": ("fthetaCx", 0, None),
    "cy": ("fthetaCy", 0, None),
    "fov": ("fthetaMaxFov", 0, 360.0),
}
_OLDER_OPENCV: _Table = _OLDER | {
    "fx": ("openCVFx", 0, None),
    "fy": ("openCVFy", 0, None),
    **{f"k{i}": (f"fthetaPoly{c}", 0, 0.0) for i, c in enumerate("ABCDEF", start=1)},
    **{f"p{i}": (f"p{i - 1}", 0, 0.0) for i in (1, 2)},
    **{f"s{i}": (f"s{i - 1}", 0, 0.0) for i in (1, 2, 3, 4)},
}
_NEWER_OPENCV: _Table = {
    "width": ("imageSize", 0, 2048.0),
    "height": ("imageSize", 1, 1024.0),
    "cx": ("cx", 0, 1024.0),
    "cy": ("cy", 0, 512.0),
    "fx": ("fx", 0, 900.0),
    "fy": ("fy", 0, 800.0),
    **{f"{c}{i}": (f"{c}{i}", 0, 0.0) for c, n in (("k", 6), ("p", 2), ("s", 4))
       for i in range(1, n + 1)},
}  # fmt: skip
_TABLES: dict[tuple[bool, str], _Table] = {
    (True, "ftheta"): _OLDER | _POLYNOMIAL | {"k1": ("fthetaPolyB", 0, None)},
    (True, "opencvPinhole"): _OLDER_OPENCV,
    (True, "opencvFisheye"): _OLDER_OPENCV,
    (False, "ftheta"): {
        "width": ("nominalWidth", 0, 1936.0),
        "height": ("nominalHeight", 0, 1216.0),
        "cx": ("opticalCenter", 0, 970.9424),
        "cy": ("opticalCenter", 1, 600.3748),
        "fov": ("maxFov", 0, 200.0),
        **{f"k{i}": (f"k{i}", 0, 0.00245 if i == 1 else 0.0) for i in range(6)},
    },
    (False, "opencvPinhole"): _NEWER_OPENCV,
    (False, "opencvFisheye"): _NEWER_OPENCV | {"k1": ("k1", 0, 0.00245)},
}
#: Shares of the largest radius squared at which a fitted lens agrees (near Chebyshev's choice).
_NODES = (0.0244717, 0.2061074, 0.5, 0.7938926, 0.9755283)
#: Radii at which a fitted lens is compared, of each pixel.
_PER_PIXEL = 4
#: A corner farther from the optical center than so many pixels is no calibration's.
_FARTHEST_PX = 1 << 17


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a camera's attributes say of its projection.

    Attributes:
        intrinsics: K of the whole picture, float64 [3, 3].
        lens: The lens; None: a pinhole.
        error_px: By how much its rays are off at most, pixels, against the model it stands for.
        notes: What is approximated, or not shown.
    """

    intrinsics: NDArray[np.float64]
    lens: Lens | None
    error_px: float = 0.0
    notes: tuple[str, ...] = ()


def model_of(prim: Usd.Prim) -> tuple[str, str]:
    """Returns a camera's model and what names it, an attribute or a schema; both empty without one.

    Names that are not known are none; where scenec's own lens or K is authored, all are.
    """
    if any(prim.HasAttribute(name) for name in (names.ATTR_LENS_MODEL, names.ATTR_INTRINSICS)):
        return "", ""
    for name in (f"{_PREFIX}model", _PROJECTION):
        value = values.value_of(prim.GetAttribute(name), Usd.TimeCode.EarliestTime())
        model = _MODELS.get(str(value), str(value))
        if (True, model) in _TABLES or model in _REFUSED:
            return model, f"{name} = {value}"
    found = [name for name in applied_schemas(prim) if name in _MODELS]
    return (_MODELS[found[0]], found[0]) if found else ("", "")


def applied_schemas(prim: Usd.Prim) -> list[str]:
    """Lists a prim's applied schemas, those that USD has no definition of, too."""
    listed = prim.GetMetadata("apiSchemas")
    return [] if listed is None else list(map(str, listed.GetAddedOrExplicitItems()))


def read_calibration(
    prim: Usd.Prim, size: tuple[int, int], time: Usd.TimeCode
) -> Calibration | None:
    """Reads a camera's calibrated lens; None where it has none.

    Args:
        prim: The camera.
        size: Width and height of its whole picture, pixels.
        time: When.

    Raises:
        StageError: No lens here is like it, or a number is missing or cannot be.
    """
    model, said = model_of(prim)
    if not model:
        return None
    if model in _REFUSED:
        raise _refusal(prim, said, f"it takes {_REFUSED[model]}")
    older = said.startswith(_PROJECTION)
    prefix = "" if older else f"{_PREFIX}{model}:"
    numbers: dict[str, float] = {}
    for key, (name, index, fallback) in _TABLES[older, model].items():
        found = _numbers(prim.GetAttribute(prefix + name), time)
        if found is None and fallback is None:
            raise StageError(f"{prim.GetPath()}: {said}: {name} is not authored, expected a number")
        numbers[key] = found[index] if found is not None else fallback or 0.0
    # No document of NVIDIA's gives a largest field of view of 0 a meaning; a pinhole has none.
    for key in ("width", "height", "fx", "fy", *(() if model == "opencvPinhole" else ("fov",))):
        if not numbers.get(key, 1.0) > 0.0:
            name = _TABLES[older, model][key][0]
            raise StageError(
                f"{prim.GetPath()}.{prefix}{name}: is {numbers[key]:g}, expected a number above 0"
            )
    across, up = size[0] / numbers["width"], size[1] / numbers["height"]
    k = np.eye(3)
    k[0, 0], k[1, 1] = across * numbers.get("fx", 1.0), up * numbers.get("fy", 1.0)
    k[0, 2], k[1, 2] = across * numbers["cx"], up * numbers["cy"]
    made = _ftheta if model == "ftheta" else _pinhole if model == "opencvPinhole" else _fisheye
    found_lens = made(numbers, k, size)
    if isinstance(found_lens, str):
        raise _refusal(prim, said, found_lens)
    return found_lens


def _refusal(prim: Usd.Prim, said: str, why: str) -> StageError:
    return StageError(
        f"{prim.GetPath()}: {said}: no lens here is like it: {why}. Without it a pinhole of the "
        "camera's focal length and apertures is drawn"
    )


def _numbers(attribute: Usd.Attribute, time: Usd.TimeCode) -> tuple[float, ...] | None:
    value = values.value_of(attribute, time)
    if value is None:
        return None
    if hasattr(value, "__len__") and not isinstance(value, str):
        return values.vector(attribute, 2, time)
    return (values.number(attribute, 0.0, time),)


def _pinhole(
    numbers: dict[str, float], k: NDArray[np.float64], size: tuple[int, int]
) -> Calibration | str:
    order = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    coefficients = tuple(numbers[key] for key in order)
    lens = Lens(BROWN_CONRADY, coefficients) if any(coefficients) else None
    s1, s2, s3, s4 = (numbers[f"s{i}"] for i in (1, 2, 3, 4))
    columns = np.arange(size[0], dtype=np.float64) + 0.5
    worst, lost = 0.0, 0
    for row in range(size[1]) if any((s1, s2, s3, s4)) else (0, size[1] - 1):
        x, y = to_plane(k, columns, np.full(size[0], row + 0.5, np.float64))
        rays, known = directions(lens, x, y)
        lost += int((~known).sum())
        square = (rays[known, :2] * rays[known, :2]).sum(axis=1)
        moved = (
            k[0, 0] * square * (s1 + s2 * square),
            k[1, 1] * square * (s3 + s4 * square),
        )
        worst = max(worst, float(np.hypot(*moved).max(initial=0.0)))
    if worst > TOLERANCE_PX:
        return f"it takes thin prism terms, which move pixels by up to {worst:.3g}"
    notes = []
    if worst > 0.0:
        notes.append(f"thin prism terms are left out: pixels are off by up to {worst:.2g}")
    if lost:
        notes.append("the lens is not one-to-one in all of the picture: what is beyond is black")
    return Calibration(k, lens, worst, tuple(notes))


def _fisheye(
    numbers: dict[str, float], k: NDArray[np.float64], size: tuple[int, int]
) -> Calibration | str:
    coefficients = tuple(numbers[f"k{i}"] for i in (1, 2, 3, 4))
    return Calibration(k, Lens(KANNALA_BRANDT, coefficients, _half(numbers.get("fov", 360.0))))


def _half(fov_deg: float) -> float:
    return math.radians(0.5 * fov_deg) if fov_deg < 360.0 else math.pi


def _ftheta(
    numbers: dict[str, float], k: NDArray[np.float64], size: tuple[int, int]
) -> Calibration | str:
    across, up = k[0, 0], k[1, 1]
    # From the optical center to the farthest corner, in pixels of the calibrated picture.
    far = math.hypot(max(k[0, 2], size[0] - k[0, 2]) / across, max(k[1, 2], size[1] - k[1, 2]) / up)
    if not far <= _FARTHEST_PX:
        return (
            f"a corner of the picture is {far:.3g} pixels from the optical center, at most "
            f"{_FARTHEST_PX} are taken"
        )
    end = _half(numbers["fov"])
    radii = np.linspace(0.0, far, int(_PER_PIXEL * far) + 2)
    angles = np.zeros_like(radii)
    for i in reversed(range(6)):
        angles = angles * radii + numbers[f"k{i}"]
    beyond = np.flatnonzero(angles > end)
    if len(beyond):
        radii, angles = radii[: beyond[0]], angles[: beyond[0]]
    if len(radii) < 2 or not (np.diff(angles) > 0.0).all():
        return "its angles do not grow with the distance from the optical center"
    nodes = [int(math.sqrt(share) * (len(radii) - 1)) or 1 for share in _NODES]
    squares, ratios = [], []
    for node in nodes:
        if angles[node] <= 0.0:
            return "its angles are not above 0"
        squares.append(float(angles[node] * angles[node]))
        ratios.append(float(radii[node] / angles[node]))
    c = _polynomial(squares, ratios)
    lens = Lens(KANNALA_BRANDT, tuple(one / c[0] for one in c[1:]), end)
    found = np.zeros_like(angles)
    for factor in reversed(c):
        found = found * angles * angles + factor
    error = float(np.abs(found * angles - radii).max() * max(across, up))
    if not error <= TOLERANCE_PX:
        return (
            f"a kannala_brandt through its points is off by up to {error:.3g} pixels, at most "
            f"{TOLERANCE_PX} are taken"
        )
    k[0, 0], k[1, 1] = across * c[0], up * c[0]
    note = f"an f-theta lens is drawn as a kannala_brandt, off by up to {error:.2g} pixels"
    return Calibration(k, lens, error, (note,))


def _polynomial(x: list[float], y: list[float]) -> list[float]:
    """Coefficients, from the constant one up, of the polynomial through points (Newton's form)."""
    divided, differences = list(y), [y[0]]
    for order in range(1, len(x)):
        divided = [(b - a) / (x[i + order] - x[i]) for i, (a, b) in enumerate(pairwise(divided))]
        differences.append(divided[0])
    out = [0.0] * len(x)
    for i in reversed(range(len(x))):
        # out * (t - x[i]) + the difference of order i.
        shifted = [0.0, *out[:-1]]
        out = [a - x[i] * b for a, b in zip(shifted, out, strict=True)]
        out[0] += differences[i]
    return out
