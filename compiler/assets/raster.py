"""Reads heights from rasters by GDAL: which band and part, in what unit, where on a body."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.raster_plane import RasterFrame, frame_of, plane_of, spot_at
from scenec.compiler.assets.raster_window import Box, RasterWindow, box_of
from scenec.schemas import memory
from scenec.schemas.codec import Facts
from scenec.schemas.errors import SceneError
from scenec.schemas.notice import tell

#: Farther than any coordinate on a planet, and small enough that sums of products are numbers.
_FARTHEST = 1e15
#: GDAL's drivers by a file's suffix; no others are tried.
DRIVERS = {
    ".tif": ("GTiff",), ".tiff": ("GTiff",), ".vrt": ("VRT",), ".asc": ("AAIGrid",),
    ".hgt": ("SRTMHGT",), ".nc": ("netCDF",), ".xml": ("PDS4",), ".cub": ("ISIS3",),
    ".lbl": ("PDS", "ISIS3"), ".img": ("PDS", "HFA"), ".jp2": ("JP2OpenJPEG",),
}  # fmt: skip
#: Those that are one file.
ALONE = (".tif", ".tiff", ".hgt", ".nc", ".jp2")
#: GDAL keeps so much of what it has read.
_CACHE_MB = 64
_SURVEY_FOOT = 1200.0 / 3937.0
#: Meters per unit, by the names that files give; in lower case, with blanks for ``_`` and ``-``.
_UNITS = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("km", "kilometre", "kilometres", "kilometer", "kilometers"), 1e3),
    **dict.fromkeys(("dm", "decimetre", "decimetres", "decimeter", "decimeters"), 0.1),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), 0.01),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), 1e-3),
    **dict.fromkeys(("ft", "foot", "feet", "international foot", "international feet"), 0.3048),
    **dict.fromkeys(
        ("us ft", "ftus", "usft", "ft us", "us foot", "foot us", "us survey foot", "survey foot",
         "us survey feet"),
        _SURVEY_FOOT,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Raster:
    """Holds one band of a raster, or a part of it.

    Attributes:
        samples: As they are stored, [ny, nx].
        missing: Where the file says that there is no data, bool [ny, nx].
        band: Which one, from 1.
        scale, offset: Heights are samples * scale + offset, in the band's unit.
        unit_m: Meters per unit of these.
        frame: Where the samples lie, if the file says so.
        spot: The window's center, in the frame's coordinates; None without a window.
        part: What was read of the file, for report.json.
    """

    samples: NDArray[Any]
    missing: NDArray[np.bool_]
    band: int
    scale: float
    offset: float
    unit_m: float
    frame: RasterFrame | None
    spot: tuple[float, float] | None = None
    part: Facts | None = None


def read_raster(
    file: Path,
    band: int | None = None,
    unit_m: float | None = None,
    array: str | None = None,
    window: RasterWindow | None = None,
) -> Raster:
    """Reads one band, or what a window needs of it.

    Args:
        file: The file.
        band: Which one, from 1; None takes the only one that is not alpha.
        unit_m: Meters per unit of its heights; None takes what the file says, else 1.
        array: Variable of a NetCDF file that holds several.
        window: The part; None reads all.

    Raises:
        SceneError: It cannot be read, is larger than memory, holds several bands of which none is
            chosen, is of a unit that is not known, or does not reach the window.
    """
    with _opened(file, array) as source:
        frame = _frame(file, source)
        number = _band(file, source, band)
        unit = unit_m if unit_m is not None else _unit_m(file, source, number, frame)
        stored = source.dtypes[number - 1]
        if stored.startswith("complex"):
            raise SceneError(f"{file.name}: holds {stored} numbers, expected heights")
        scale, offset = float(source.scales[number - 1]), float(source.offsets[number - 1])
        if window is None:
            mend = (
                "say which part is needed with window, or cut it out (gdal_translate -srcwin), or "
                "make it coarser (gdal_translate -outsize)"
            )
            require_memory(file, source.shape, np.dtype(stored), mend)
            samples, missing = source.read(number), source.read_masks(number) == 0
            return Raster(samples, missing, number, scale, offset, unit, frame)
        rows, columns = source.shape
        if frame is None:
            frame = RasterFrame("", None, (1.0, 0.0, 0.0, 0.0, -1.0, float(rows)))
        spot = _spot(file, frame, columns, window)
        box = _box(file, frame, (rows, columns), spot, window)
        factor = max((f for f in source.overviews(number) if f <= box.coarser), default=1)
        level = source.overviews(number).index(factor) if factor > 1 else None
    with _opened(file, array, level) as source:
        if level is not None:
            frame = _frame(file, source)
            assert frame is not None
            box = _box(file, frame, source.shape, spot, window)
        part = {
            "pixels": [box.columns, box.rows],
            "of": [columns, rows],
            "overview": factor,
        }
        size = box.columns * box.rows * np.dtype(stored).itemsize / 2**20
        tell(
            f"{file.name}: reads {box.columns:,} x {box.rows:,} of {columns:,} x {rows:,} pixels"
            f"{f' from its overview of 1 : {factor}' if factor > 1 else ''} ({size:.1f} MiB)"
        )
        require_memory(file, (box.rows, box.columns), np.dtype(stored), "make the window smaller")
        samples = box.read(lambda part: source.read(number, window=part), source.shape)
        missing = box.read(lambda part: source.read_masks(number, window=part) == 0, source.shape)
        frame = frame.cut(box.column, box.row)
        return Raster(samples, missing, number, scale, offset, unit, frame, spot, part)


def files_of(file: Path, array: str | None = None) -> list[Path]:
    """Lists the files that a raster is made of: labels, pictures, what a VRT names; sorted.

    Raises:
        SceneError: It cannot be read, or some are not there or not on this machine.
    """
    with _opened(file, array) as source:
        found = {file} | {Path(name) for name in source.files}
    found = {path for path in found if not str(path).startswith("netcdf:")}
    for path in sorted(found):
        if not path.is_file():
            raise SceneError(f"{file.name}: is made of {path.name}, which is not there")
    return [file, *sorted(found - {file})]


@contextmanager
def _opened(file: Path, array: str | None, level: int | None = None) -> Iterator[Any]:
    """The open file, or one of its overviews."""
    try:
        import rasterio
        from rasterio.errors import NotGeoreferencedWarning, RasterioError
    except ModuleNotFoundError as error:
        raise SceneError(
            f"{file.name}: reading GeoTIFF and other rasters needs the extra 'geotiff': "
            "pip install 'scenec[geotiff]'"
        ) from error
    suffix = file.suffix.lower()
    name = f"netcdf:{file}:{array}" if suffix == ".nc" and array else file
    options = {} if level is None else {"overview_level": level}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            # Nothing but the file itself counts: masks and statistics beside it are no inputs.
            alone = {"GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR", "GDAL_PAM_ENABLED": "NO"}
            with rasterio.Env(**alone, GDAL_CACHEMAX=_CACHE_MB):
                *others, last = DRIVERS[suffix]
                for driver in others:
                    with suppress(RasterioError):
                        rasterio.open(name, driver=driver).close()
                        last = driver
                        break
                with rasterio.open(name, driver=last, **options) as source:
                    yield source
    except (RasterioError, OSError) as error:
        kind = "GeoTIFF" if suffix in (".tif", ".tiff") else f"{suffix} raster"
        raise SceneError(f"{file.name}: not a readable {kind}: {error}") from error


def _spot(
    file: Path, frame: RasterFrame, columns: int, window: RasterWindow
) -> tuple[float, float]:
    """The window's center in the frame's coordinates."""
    if window.latitude_deg is not None and window.longitude_deg is not None:
        return spot_at(file.name, frame, columns, window.latitude_deg, window.longitude_deg)
    if frame.geographic:
        raise SceneError(
            f"{file.name}: its coordinates are degrees: give the window's latitude_deg and "
            "longitude_deg in place of x_m and y_m"
        )
    assert window.x_m is not None
    assert window.y_m is not None
    axis = frame.axis_m or 1.0
    return window.x_m / axis, window.y_m / axis


def _box(
    file: Path,
    frame: RasterFrame,
    shape: tuple[int, int],
    spot: tuple[float, float],
    window: RasterWindow,
) -> Box:
    """What a window reads of a file."""
    plane = plane_of(frame, shape[1], spot, window.pixel_m, True)
    if plane is None:
        raise SceneError(f"{file.name}: does not say its pixels' size: give pixel_m")
    box = box_of(plane, shape, window)
    if box is None:
        a, b = frame.at(0.0, 0.0), frame.at(shape[1], shape[0])
        raise SceneError(
            f"{file.name}: the window lies outside of it: its center is at "
            f"({spot[0]:.10g}, {spot[1]:.10g}) in the file's coordinates, and the file reaches "
            f"from ({a[0]:.10g}, {a[1]:.10g}) to ({b[0]:.10g}, {b[1]:.10g})"
        )
    return box


def require_memory(file: Path, shape: tuple[int, ...], kind: np.dtype, mend: str) -> None:
    """Refuses a field of heights before it is read.

    Raises:
        SceneError: Its samples, their holes and their heights are more than what memory is free.
    """
    count = 1
    for side in shape:
        count *= int(side)
    # With what is missing, the holes, and heights as doubles.
    needed, free = count * (kind.itemsize + 10), memory.available()
    if needed > free:
        size = " x ".join(f"{side:,}" for side in reversed(shape))
        raise SceneError(
            f"{file.name}: {size} samples of {kind} take {needed / memory.GB:,.1f} GB of memory "
            f"to read, and {free / memory.GB:,.1f} GB are free: {mend}"
        )


def _band(file: Path, source: Any, band: int | None) -> int:
    if band is not None:
        if band > source.count:
            raise SceneError(f"{file.name}: no band {band}: it holds {source.count}")
        return band
    if len(source.subdatasets) > 1:
        raise SceneError(
            f"{file.name}: holds {len(source.subdatasets)} rasters, expected one: "
            + _subdatasets(source)
        )
    kinds = [kind.name for kind in source.colorinterp]
    own = [i + 1 for i, kind in enumerate(kinds) if kind != "alpha"]
    if len(own) != 1:
        titles = [text or kind for text, kind in zip(source.descriptions, kinds, strict=True)]
        raise SceneError(
            f"{file.name}: holds {source.count} bands ({', '.join(titles[:8])}): say which one "
            'holds heights, counted from 1, with "band"'
        )
    if kinds[own[0] - 1] == "palette":
        raise SceneError(
            f"{file.name}: its values are numbers of colors in a palette: say "
            f'"band": {own[0]} if they are heights all the same'
        )
    return own[0]


def _unit_m(file: Path, source: Any, band: int, frame: RasterFrame | None) -> float:
    """Returns meters per unit of a band's heights: its own or, as in GDAL, the vertical axis's."""
    name = source.units[band - 1]
    if name:
        words = " ".join(name.lower().replace("_", " ").replace("-", " ").split())
        if words not in _UNITS:
            raise SceneError(
                f"{file.name}: its heights are in {name[:60]!r}, which is no length known here "
                '(m, km, cm, mm, ft, us-ft …): say how many meters it is with "unit_m"'
            )
        return _UNITS[words]
    if frame is not None and frame.axis_m not in (None, 1.0):
        raise SceneError(
            f"{file.name}: its axes are in units of {frame.axis_m:g} m, and it does not say "
            f'what its heights are in: say "unit_m": {frame.axis_m!r}, or "unit_m": 1 for '
            "meters"
        )
    return 1.0


def _subdatasets(source: Any) -> str:
    """How to take one of several rasters."""
    if source.driver != "netCDF":
        return "take one out of it (gdal_translate GTIFF_DIR:1:FILE OUT)"
    names = [name.rpartition(":")[2] for name in source.subdatasets]
    return f'say which with "array": it holds {", ".join(names[:8])}'


def _frame(file: Path, source: Any) -> RasterFrame | None:
    t = source.transform
    if source.gcps[0]:
        raise SceneError(
            f"{file.name}: its place is given by ground control points: expected a transform; "
            "warp it (gdalwarp FILE OUT)"
        )
    if t.is_identity and not source.crs:
        return None
    terms = (t.a, t.b, t.c, t.d, t.e, t.f)
    if not np.abs(terms).max() <= _FARTHEST:
        raise SceneError(
            f"{file.name}: its transform holds numbers that are not finite or beyond {_FARTHEST:g}"
        )
    if t.a * t.e == t.b * t.d:
        raise SceneError(f"{file.name}: its transform makes pixels without an area")
    return frame_of(source.crs, terms)
