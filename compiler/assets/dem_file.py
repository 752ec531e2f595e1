"""Reads measured height fields: NumPy arrays, GeoTIFF, pictures."""

from __future__ import annotations

import io
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import SceneError
from scenec.schemas.files import NUMPY_FAULTS

#: Farther than any coordinate on a planet, and small enough that sums of products are numbers.
_FARTHEST = 1e15
_NUMPY = (".npz", ".npy")
_GEOTIFF = (".tif", ".tiff")
PICTURES = (".png", ".jpg", ".jpeg", ".bmp")


@dataclass(frozen=True)
class GeoReference:
    """Where on a planet a DEM lies. Recorded, and never part of any arithmetic on heights.

    Attributes:
        crs: Coordinate reference system: an authority's code, or WKT.
        metric: Whether its axes are in meters.
        transform: (a, b, c, d, e, f): pixel (column, row) corners lie at (a column + b row + c,
            d column + e row + f).
    """

    crs: str
    metric: bool
    transform: tuple[float, float, float, float, float, float]

    def at(self, column: float, row: float) -> tuple[float, float]:
        """Coordinates of a place in the file, in pixels from its first corner."""
        a, b, c, d, e, f = self.transform
        return a * column + b * row + c, d * column + e * row + f

    def first_row(self) -> str:
        """Which end of the file is its northern one, by the transform: north or south."""
        return "south" if self.transform[4] > 0.0 else "north"

    def pixel_m(self) -> tuple[float, float] | None:
        """Size of a pixel in meters; None where axes are no meters or turned."""
        a, b, _, d, e, _ = self.transform
        if not self.metric or b != 0.0 or d != 0.0 or a == 0.0 or e == 0.0:
            return None
        return abs(a), abs(e)


@dataclass(frozen=True)
class DemFile:
    """A measured height field.

    Attributes:
        values: Heights with the file's own scale and offset applied, 0 in holes; float64 [ny, nx],
            in the file's order.
        holes: Where there are none, bool [ny, nx].
        reference: Where it lies, if the file says so.
    """

    values: NDArray[np.float64]
    holes: NDArray[np.bool_]
    reference: GeoReference | None


def read_dem(
    file: Path,
    array: str | None = None,
    nodata: float | None = None,
    height_range_m: tuple[float, float] | None = None,
) -> DemFile:
    """Reads a DEM.

    Args:
        file: ``.npz``, ``.npy``, GeoTIFF, or a gray picture of 8 or 16 bits.
        array: Member of an ``.npz``; None takes the only two-dimensional one.
        nodata: Value in the file that marks holes, besides NaN and what the file itself declares.
        height_range_m: Heights of black and of white, for pictures.

    Raises:
        SceneError: The file is not a two-dimensional field of numbers, or a picture's range is
            missing.
    """
    suffix = file.suffix.lower()
    missing = None
    scale, offset = 1.0, 0.0
    reference = None
    if suffix in _NUMPY:
        samples = _read_numpy(file, array)
    elif suffix in _GEOTIFF:
        samples, missing, scale, offset, reference = _read_geotiff(file)
    elif suffix in PICTURES:
        if height_range_m is None:
            raise SceneError(
                f"{file.name}: a picture holds no heights: give height_range_m, those of black and "
                "white"
            )
        samples = _read_picture(file)
        low, high = height_range_m
        scale, offset = (high - low) / float(np.iinfo(samples.dtype).max), low
    else:
        raise SceneError(
            f"{file.name}: a DEM is a .npz, .npy, .tif or .tiff file or a picture "
            f"({', '.join(PICTURES)}), not {suffix or 'this'}"
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
    holes = ~np.isfinite(values)
    if missing is not None:
        holes |= missing
    if nodata is not None:
        holes |= values == nodata
    if (scale, offset) != (1.0, 0.0):
        if not np.isfinite([scale, offset]).all():
            raise SceneError(f"{file.name}: its scale {scale:g} or offset {offset:g} is not finite")
        with np.errstate(over="ignore", invalid="ignore"):
            values = values * scale + offset
        # What overflows is no height.
        holes |= ~np.isfinite(values)
    values[holes] = 0.0
    return DemFile(values, holes, reference)


def _read_numpy(file: Path, array: str | None) -> NDArray[Any]:
    try:
        loaded = np.load(io.BytesIO(file.read_bytes()), allow_pickle=False)
    except NUMPY_FAULTS as error:
        raise SceneError(f"{file.name}: not a NumPy file: {_reason(error)}") from error
    if isinstance(loaded, np.ndarray):
        return loaded
    try:
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


def _reason(error: Exception) -> str:
    """What NumPy holds against a file, where that is a sentence for users."""
    text = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return "it says that it is larger than memory"
    said = isinstance(error, (ValueError, OSError, EOFError, BadZipFile, zlib.error))
    # NumPy parses a header as Python, and shows the parser's objects.
    return text if said and text and " at 0x" not in text else "its header or data are broken"


def _read_geotiff(
    file: Path,
) -> tuple[NDArray[Any], NDArray[np.bool_], float, float, GeoReference | None]:
    """Samples, holes, scale, offset, place."""
    try:
        import rasterio
        from rasterio.errors import NotGeoreferencedWarning, RasterioError
    except ModuleNotFoundError as error:
        raise SceneError(
            f"{file.name}: reading GeoTIFF needs the extra 'geotiff': pip install 'scenec[geotiff]'"
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            # Nothing but the file itself counts: masks and statistics beside it are no inputs.
            alone = {"GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR", "GDAL_PAM_ENABLED": "NO"}
            with rasterio.Env(**alone), rasterio.open(file) as source:
                samples = source.read(1)
                missing = source.read_masks(1) == 0
                scale, offset = float(source.scales[0]), float(source.offsets[0])
                reference = None
                if source.crs:
                    unit, to_m = (
                        source.crs.linear_units_factor if source.crs.is_projected else ("", 0.0)
                    )
                    t = source.transform
                    if not np.abs([t.a, t.b, t.c, t.d, t.e, t.f]).max() <= _FARTHEST:
                        raise SceneError(
                            f"{file.name}: its transform holds numbers that are not finite or "
                            f"beyond {_FARTHEST:g}"
                        )
                    reference = GeoReference(
                        source.crs.to_string(),
                        bool(unit) and to_m == 1.0,
                        (t.a, t.b, t.c, t.d, t.e, t.f),
                    )
    except (RasterioError, OSError) as error:
        raise SceneError(f"{file.name}: not a readable GeoTIFF: {error}") from error
    return samples, missing, scale, offset, reference


def _read_picture(file: Path) -> NDArray[Any]:
    """Gray values, uint8 or uint16 [ny, nx]."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # Large is no fault; what is too large is an error of Pillow's own.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(file) as image:
                return _gray(file, image)
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise SceneError(f"{file.name}: not a readable picture: {error}") from error


def _gray(file: Path, image: Any) -> NDArray[Any]:
    if image.mode.startswith("I;16"):
        return np.asarray(image).astype(np.uint16)
    if image.mode == "I":
        # How Pillow opens some 16-bit pictures.
        wide = np.asarray(image)
        if wide.min() >= 0 and wide.max() <= 0xFFFF:
            return wide.astype(np.uint16)
    if image.mode in ("1", "L", "LA"):
        return np.asarray(image.convert("L"))
    if image.mode in ("P", "RGB", "RGBA"):
        colors = np.asarray(image.convert("RGB"))
        if (colors == colors[..., :1]).all():
            return np.ascontiguousarray(colors[..., 0])
    raise SceneError(f"{file.name}: expected a gray picture of 8 or 16 bits, got {image.mode}")
