"""Reads heights from GeoTIFF files: which band, in what unit, where on a planet."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas import memory
from scenec.schemas.errors import SceneError

#: Farther than any coordinate on a planet, and small enough that sums of products are numbers.
_FARTHEST = 1e15
#: Part of a pixel by which the transform's other terms may move the file's far corner.
_UPRIGHT = 0.01
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
class GeoReference:
    """Describes where on a planet a DEM lies; recorded only, no heights are computed with it.

    Attributes:
        crs: Coordinate reference system: an authority's code, or WKT; "" where the file has none.
        axis_m: Meters per unit of its axes; None where they are angles or not known.
        transform: (a, b, c, d, e, f): pixel (column, row) corners lie at (a column + b row + c,
            d column + e row + f); b and d are 0 but for rounding.
    """

    crs: str
    axis_m: float | None
    transform: tuple[float, float, float, float, float, float]

    def at(self, column: float, row: float) -> tuple[float, float]:
        """Returns coordinates of a place in the file, in pixels from its first corner."""
        a, b, c, d, e, f = self.transform
        return a * column + b * row + c, d * column + e * row + f

    def first_row(self) -> str:
        """Returns which end of the file is its northern one, by the transform: north or south."""
        return "south" if self.transform[4] > 0.0 else "north"

    def pixel_m(self) -> tuple[float, float] | None:
        """Returns the size of a pixel in meters; None where axes are no lengths."""
        a, _, _, _, e, _ = self.transform
        if self.axis_m is None or a == 0.0 or e == 0.0:
            return None
        return abs(a) * self.axis_m, abs(e) * self.axis_m


@dataclass(frozen=True)
class GeoTiff:
    """Holds one band of a GeoTIFF.

    Attributes:
        samples: As they are stored, [ny, nx].
        missing: Where the file says that there is no data, bool [ny, nx].
        band: Which one, from 1.
        scale, offset: Heights are samples * scale + offset, in the band's unit.
        unit_m: Meters per unit of these.
        reference: Where it lies, if the file says so.
    """

    samples: NDArray[Any]
    missing: NDArray[np.bool_]
    band: int
    scale: float
    offset: float
    unit_m: float
    reference: GeoReference | None


def read_geotiff(file: Path, band: int | None = None, unit_m: float | None = None) -> GeoTiff:
    """Reads one band.

    Args:
        file: The file.
        band: Which one, from 1; None takes the only one that is not alpha.
        unit_m: Meters per unit of its heights; None takes what the file says, else 1.

    Raises:
        SceneError: It cannot be read, is larger than memory, holds several bands of which none is
            chosen, is of a unit that is not known, or is turned against its axes.
    """
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
                reference = _reference(file, source)
                number = _band(file, source, band)
                unit = unit_m if unit_m is not None else _unit_m(file, source, number, reference)
                stored = source.dtypes[number - 1]
                if stored.startswith("complex"):
                    raise SceneError(f"{file.name}: holds {stored} numbers, expected heights")
                require_memory(
                    file,
                    source.shape,
                    np.dtype(stored),
                    "cut out the part that is needed (gdal_translate -srcwin), or make it coarser "
                    "(gdal_translate -outsize)",
                )
                return GeoTiff(
                    source.read(number),
                    source.read_masks(number) == 0,
                    number,
                    float(source.scales[number - 1]),
                    float(source.offsets[number - 1]),
                    unit,
                    reference,
                )
    except (RasterioError, OSError) as error:
        raise SceneError(f"{file.name}: not a readable GeoTIFF: {error}") from error


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
            f"{file.name}: holds {len(source.subdatasets)} rasters, expected one: take one out of "
            "it (gdal_translate GTIFF_DIR:1:FILE OUT)"
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


def _unit_m(file: Path, source: Any, band: int, reference: GeoReference | None) -> float:
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
    if reference is not None and reference.axis_m not in (None, 1.0):
        raise SceneError(
            f"{file.name}: its axes are in units of {reference.axis_m:g} m, and it does not say "
            f'what its heights are in: say "unit_m": {reference.axis_m!r}, or "unit_m": 1 for '
            "meters"
        )
    return 1.0


def _reference(file: Path, source: Any) -> GeoReference | None:
    t = source.transform
    if source.gcps[0]:
        raise SceneError(
            f"{file.name}: its place is given by ground control points: expected a transform; "
            "warp it (gdalwarp FILE OUT)"
        )
    if t.is_identity and not source.crs:
        return None
    if not np.abs([t.a, t.b, t.c, t.d, t.e, t.f]).max() <= _FARTHEST:
        raise SceneError(
            f"{file.name}: its transform holds numbers that are not finite or beyond {_FARTHEST:g}"
        )
    rows, columns = source.shape
    if abs(t.b) * rows > _UPRIGHT * abs(t.a) or abs(t.d) * columns > _UPRIGHT * abs(t.e):
        angle = 180.0 / elementary.PI * float(elementary.atan2(t.d, t.a))
        parts = []
        square = abs(t.a * t.b + t.d * t.e) <= 1e-6 * abs(t.a * t.e - t.b * t.d)
        if not square:
            parts.append("shears it")
        if square or abs(t.d) * columns > _UPRIGHT * abs(t.e):
            text = f"turns it by {angle:.6g} degrees (counterclockwise, its rows against the east)"
            parts.append(text)
        raise SceneError(
            f"{file.name}: its georeference {' and '.join(parts)}: expected rows that run east and "
            "columns that run north or south; warp it upright (gdalwarp -r cubic FILE OUT)"
        )
    axis_m = None
    if source.crs and source.crs.is_projected:
        name, factor = source.crs.linear_units_factor
        axis_m = float(factor) if name and 0.0 < factor < np.inf else None
    return GeoReference(
        source.crs.to_string() if source.crs else "", axis_m, (t.a, t.b, t.c, t.d, t.e, t.f)
    )
