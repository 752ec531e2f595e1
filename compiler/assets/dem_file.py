"""Reads measured height fields: NumPy arrays, rasters that GDAL reads, pictures."""

from __future__ import annotations

import io
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.raster import DRIVERS, read_raster, require_memory
from scenec.compiler.assets.raster_plane import RasterFrame
from scenec.compiler.assets.raster_window import RasterWindow
from scenec.schemas.codec import Facts
from scenec.schemas.errors import SceneError
from scenec.schemas.files import NUMPY_FAULTS
from scenec.schemas.maps import MOST_PIXELS, is_fine_color, require_size

#: What marks holes in files that do not declare it; floating files take what is beyond any number.
_VOIDS = frozenset(
    sign * value
    for value in (9999.0, 99999.0, 999999.0, 9999999.0, 32767.0, 32768.0, 65535.0, 2.0**31 - 1.0,
                  2.0**31, 2.0**32 - 1.0)
    for sign in (1.0, -1.0)
)  # fmt: skip
#: Samples that are no heights in any unit, and heights farther from any datum than on any body.
_NO_SAMPLE, _NO_HEIGHT_M = 1e15, 3e4
#: Zeros are far from all other samples if farther than so many times the range of these.
_FAR = 3.0
#: Share up to which zeros among samples that are all the same are no second level of them.
_FEW = 0.1
#: Farther than any surface is from its body's center.
_NO_BODY_M = 1e7
_NUMPY = (".npz", ".npy")
#: Heights that no surface has, in meters from its body's datum; of others, half of the radius.
_RELIEF_M = {"Mercury": 1e4, "Venus": 2e4, "Earth": 1.5e4, "Moon": 1.5e4, "Mars": 3e4}
PICTURES = (".png", ".jpg", ".jpeg", ".bmp")


@dataclass(frozen=True)
class Zeros:
    """Counts samples that are exactly 0 as they are stored, far from all others.

    Attributes:
        count: How many there are.
        share: Of all samples.
        low, high: Between which the others are, as they are stored.
    """

    count: int
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class DemFile:
    """A measured height field.

    Attributes:
        values: Heights in meters with the file's own scale and offset applied, 0 in holes; float64
            [ny, nx], in the file's order.
        holes: Where there are none, bool [ny, nx].
        frame: Where it lies, if the file says so.
        spot: The window's center in the frame's coordinates; None without a window.
        facts: Which band was read and what its numbers mean, for report.json.
        void: A value of the file that looks like a hole's mark which it does not declare, and the
            share of its samples that have it; None without one.
        zeros: Those that may mark holes, and are taken for heights; None without any.
        beyond: The height, in meters, that is farthest beyond what its body has, and the share of
            samples beyond; None without any.
    """

    values: NDArray[np.float64]
    holes: NDArray[np.bool_]
    frame: RasterFrame | None
    facts: Facts
    void: tuple[float, float] | None
    zeros: Zeros | None
    spot: tuple[float, float] | None = None
    beyond: tuple[float, float] | None = None


def read_dem(
    file: Path,
    array: str | None = None,
    nodata: float | None = None,
    height_range_m: tuple[float, float] | None = None,
    band: int | None = None,
    unit_m: float | None = None,
    window: RasterWindow | None = None,
) -> DemFile:
    """Reads a DEM.

    Args:
        file: ``.npz``, ``.npy``, a raster of ``raster.DRIVERS``, or a gray picture of 8 or 16 bits.
        array: Member of an ``.npz`` or a NetCDF file; None takes the only two-dimensional one.
        nodata: Value in the file that marks holes, besides NaN and what the file itself declares.
        height_range_m: Heights of black and of white, for pictures.
        band: Band of a raster, from 1; None takes its only one.
        unit_m: Meters per unit of the file's heights; None takes what a raster says, else 1.
        window: Part of a raster; None reads all.

    Raises:
        SceneError: The file is not a two-dimensional field of numbers, or is larger than memory; a
            picture's range is missing; or see ``raster.read_raster``.
    """
    suffix = file.suffix.lower()
    missing = None
    scale, offset, unit = 1.0, 0.0, 1.0 if unit_m is None else unit_m
    frame = spot = None
    facts: dict[str, Any] = {}
    if suffix not in DRIVERS:
        for key, value in (("band", band), ("window", window)):
            if value is not None:
                raise SceneError(f"{file.name}: {key} is for GeoTIFF and other rasters")
    if suffix in PICTURES and unit_m is not None:
        raise SceneError(f"{file.name}: unit_m is for numbers; use height_range_m")
    if suffix in _NUMPY:
        samples = _read_numpy(file, array)
    elif suffix in DRIVERS:
        raster = read_raster(file, band, unit_m, array, window)
        samples, missing, frame, spot = raster.samples, raster.missing, raster.frame, raster.spot
        scale, offset, unit = raster.scale, raster.offset, raster.unit_m
        facts = {"band": raster.band, "scale": scale, "offset": offset, "unit_m": unit}
        if raster.part is not None:
            facts["read"] = raster.part
    elif suffix in PICTURES:
        if height_range_m is None:
            raise SceneError(
                f"{file.name}: a picture holds no heights: give height_range_m, those of black and "
                "white"
            )
        samples, missing = _read_picture(file)
        low, high = height_range_m
        scale, offset = (high - low) / float(np.iinfo(samples.dtype).max), low
    else:
        raise SceneError(
            f"{file.name}: a DEM is a .npz or .npy file, a raster ({', '.join(DRIVERS)}) or a "
            f"picture ({', '.join(PICTURES)}), not {suffix or 'this'}"
        )
    if height_range_m is not None and suffix not in PICTURES:
        raise SceneError(f"{file.name}: height_range_m is for pictures; use height_scale")
    if samples.ndim != 2 or samples.shape[0] < 1 or samples.shape[1] < 1:
        raise SceneError(f"{file.name}: expected a two-dimensional array, got {samples.shape}")
    if samples.dtype.kind not in "iuf":
        raise SceneError(f"{file.name}: expected numbers, got {samples.dtype}")
    # Signaling NaN, and what is beyond float64: neither is a height.
    with np.errstate(over="ignore", invalid="ignore"):
        values = samples.astype(np.float64)
        if nodata is not None and samples.dtype.kind == "f":
            # As the file can hold it: no float32 is -9999.9.
            nodata = float(np.array(nodata).astype(samples.dtype))
    holes = ~np.isfinite(values)
    if missing is not None:
        holes |= missing
    if nodata is not None:
        holes |= values == nodata
    if not np.isfinite([scale, offset]).all():
        raise SceneError(f"{file.name}: its scale {scale:g} or offset {offset:g} is not finite")
    void = None
    if suffix not in PICTURES:
        void = _void(values, holes, lambda sample: (sample * scale + offset) * unit)
    zeros = _zeros(values, holes, samples.dtype.kind)
    if zeros is not None:
        facts["zeros_far_from_others"] = zeros.count
    if (scale, offset, unit) != (1.0, 0.0, 1.0):
        with np.errstate(over="ignore", invalid="ignore"):
            values = values * scale + offset
            values *= unit
        # What overflows is no height.
        holes |= ~np.isfinite(values)
    values[holes] = 0.0
    beyond = None if frame is None else _beyond(values, holes, frame)
    return DemFile(values, holes, frame, facts, void, zeros, spot, beyond)


def _beyond(
    values: NDArray[np.float64], holes: NDArray[np.bool_], frame: RasterFrame
) -> tuple[float, float] | None:
    """Returns the height that is farthest beyond its body's relief, and the share of these."""
    if frame.radii_m is None or not frame.body or holes.all():
        return None
    most = _RELIEF_M.get(frame.body, 0.5 * frame.radii_m[0])
    # Some give distances from the body's center instead, and bodies are flattened.
    flattening = frame.radii_m[0] - frame.radii_m[1]
    for datum, spare in ((0.0, 0.0), (frame.radii_m[0], flattening)):
        low, high = (end - datum for end in _ends(values, ~holes))
        if -most - spare <= low and high <= most:
            return None
    low, high = _ends(values, ~holes)
    outside = int(np.count_nonzero(~holes & (np.abs(values) > most)))
    return (low if -low > high else high), outside / values.size


def _void(
    values: NDArray[np.float64], holes: NDArray[np.bool_], height_m: Callable[[float], float]
) -> tuple[float, float] | None:
    """Returns the file's extreme value that is neither hole nor height, and its share."""
    for extreme, none in ((np.min, np.inf), (np.max, -np.inf)):
        end = float(extreme(values, where=~holes, initial=none))
        height = abs(height_m(end))
        if not (end in _VOIDS or abs(end) >= _NO_SAMPLE or height >= _NO_BODY_M):
            continue
        marked = (values == end) & ~holes
        share = float(np.count_nonzero(marked)) / values.size
        others = values[~(holes | marked)]
        if not np.isfinite(end):
            continue
        if abs(end) >= _NO_SAMPLE or (end in _VOIDS and height >= _NO_HEIGHT_M):
            return end, share
        # A true height has others near it; a mark has none.
        if not others.size or np.abs(others - end).min() > np.ptp(others):
            return end, share
    return None


def _zeros(values: NDArray[np.float64], holes: NDArray[np.bool_], kind: str) -> Zeros | None:
    """Finds the file's samples of 0, if all others lie on one side of it and far away."""
    ends = _ends(values, ~holes)
    if 0.0 not in ends or not np.isfinite(ends).all():
        return None
    others = values != 0.0
    others &= ~holes
    low, high = _ends(values, others)
    if not low <= high:
        return None
    count = values.size - int(np.count_nonzero(holes)) - int(np.count_nonzero(others))
    share = count / values.size
    spread = high - low
    if spread == 0.0 and share > _FEW:
        return None
    # Whole numbers are rounded ones: 0 and 1 are neighbors.
    step = 1.0 if spread == 0.0 or kind in "iu" else 0.0
    if not min(abs(low), abs(high)) > _FAR * (spread + step):
        return None
    return Zeros(count, share, low, high)


def _ends(values: NDArray[np.float64], where: NDArray[np.bool_]) -> tuple[float, float]:
    """Returns the lowest and the highest of some samples; infinite without any."""
    low = float(np.min(values, where=where, initial=np.inf))
    return low, float(np.max(values, where=where, initial=-np.inf))


def _read_numpy(file: Path, array: str | None) -> NDArray[Any]:
    try:
        if file.suffix.lower() == ".npy":
            with file.open("rb") as stream:
                _require_room(file, stream)
        loaded = np.load(io.BytesIO(file.read_bytes()), allow_pickle=False)
    except NUMPY_FAULTS as error:
        raise SceneError(f"{file.name}: not a NumPy file: {_reason(error)}") from error
    if isinstance(loaded, np.ndarray):
        return loaded
    try:
        for name in loaded.zip.namelist():
            with loaded.zip.open(name) as stream:
                _require_room(file, stream)
        members = {name: loaded[name] for name in loaded.files}
    except NUMPY_FAULTS as error:
        raise SceneError(f"{file.name}: a broken NumPy file: {_reason(error)}") from error
    if array is not None:
        if array not in members:
            raise SceneError(
                f"{file.name}: no array {array!r}; it holds {', '.join(sorted(members))}"
            )
        return members[array]
    fields = [name for name, value in members.items() if value.ndim == 2]
    if len(fields) != 1:
        raise SceneError(
            f"{file.name}: say which array to use: it holds {', '.join(sorted(members)) or 'none'}"
        )
    return members[fields[0]]


def _require_room(file: Path, stream: IO[bytes]) -> None:
    """Refuses an array that is larger than memory, by its header."""
    layout = np.lib.format
    first = layout.read_magic(stream) == (1, 0)
    header = layout.read_array_header_1_0 if first else layout.read_array_header_2_0
    shape, _, kind = header(stream)
    require_memory(file, shape, kind, "store the part that is needed, or fewer samples")


def _reason(error: Exception) -> str:
    """Returns NumPy's message about a broken file, where it makes sense to users."""
    text = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return "it says that it is larger than memory"
    said = isinstance(error, (ValueError, OSError, EOFError, BadZipFile, zlib.error))
    # NumPy parses a header as Python, and shows the parser's objects.
    return text if said and text and " at 0x" not in text else "its header or data are broken"


def _read_picture(file: Path) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """Reads gray values, uint8 or uint16 [ny, nx], and where pixels are transparent."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # Large is no fault; what is too large is an error of Pillow's own.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(file) as image:
                require_size(image)
                return _gray(file, image)
    except Image.DecompressionBombError as error:
        raise SceneError(
            f"{file.name}: too large a picture: at most {MOST_PIXELS:,} pixels are taken: store "
            "heights as .npy or GeoTIFF"
        ) from error
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise SceneError(f"{file.name}: not a readable picture: {error}") from error


def _gray(file: Path, image: Any) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    if is_fine_color(image):
        raise SceneError(
            f"{file.name}: 16 bits a channel in color: store heights as plain gray, without alpha"
        )
    if image.mode.startswith("I;16"):
        return np.asarray(image).astype(np.uint16), None
    if image.mode == "I":
        # How Pillow opens some 16-bit pictures.
        wide = np.asarray(image)
        if wide.min() >= 0 and wide.max() <= 0xFFFF:
            return wide.astype(np.uint16), None
    if image.mode in ("1", "L", "LA", "P", "PA", "RGB", "RGBA"):
        missing = None
        if image.mode[-1] == "A" or "transparency" in image.info:
            missing = np.asarray(image.convert("RGBA"))[..., 3] == 0
        if image.mode in ("1", "L", "LA"):
            return np.asarray(image.convert("L")), missing
        colors = np.asarray(image.convert("RGB"))
        if (colors == colors[..., :1]).all():
            return np.ascontiguousarray(colors[..., 0]), missing
    raise SceneError(f"{file.name}: expected a gray picture of 8 or 16 bits, got {image.mode}")
