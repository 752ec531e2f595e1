"""Begins with a measured height field."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.dem_file import DemFile, read_dem
from scenec.compiler.assets.raster_plane import RasterFrame, RasterPlane, plane_of
from scenec.compiler.assets.raster_window import RasterWindow
from scenec.compiler.kinds import Finding, Form, Node, an, bounded, file, forms, key, list_of
from scenec.compiler.terrain.grid import Applied, Grid, bicubic
from scenec.compiler.terrain.mask import unmasked
from scenec.compiler.terrain.sources.fill_holes import fill_holes
from scenec.compiler.terrain.spectral_law import SpectralLaw, fit_spectral_law
from scenec.schemas.codec import JsonObject, decode, encode
from scenec.schemas.errors import SceneError
from scenec.schemas.georeference import Georeference
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

# Holes are filled from what lies within so many pixels of the terrain.
_FILL_MARGIN = 256
#: Part of a pixel by which the transform's other terms may move the far corner of an upright file.
_UPRIGHT = 0.01
#: Part of a pixel by which a terrain of the file's own size reaches over its border.
_ROUNDING = 1e-6
_OTHER = {"north": "south", "south": "north"}
_PIXEL = bounded(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000).but(
    description="Size along one axis."
)
_SIDE = bounded(forms.CONSTANT, above=0, at_most=10_000_000, unit="m").but(
    description="Size along one axis."
)
_HEIGHT = bounded(forms.LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000)


@dataclass(frozen=True)
class DemWindow:
    """A rectangle of a raster, by its center and its size; nothing else of it is read.

    Note: Where latitudes and longitudes follow from the file's coordinates by arithmetic alone
    (degrees, or an equidistant cylindrical projection of a sphere), it lies in the plane that
    touches the body at the center, x to the east and y to the north. Else it lies in the plane of
    the file's coordinates.
    """

    EXAMPLE: ClassVar = {"latitude_deg": -89.5, "longitude_deg": 222.7, "size_m": [2000, 2000]}

    size_m: tuple[float, float] = key(list_of(_SIDE, "Size along one axis.", count=2), unit="m")
    """Size along x and y."""
    latitude_deg: float | None = key(
        forms.CONSTANT, optional=True, at_least=-90, at_most=90, unit="°"
    )
    """Geodetic (planetographic) latitude of the center."""
    longitude_deg: float | None = key(
        forms.CONSTANT, optional=True, at_least=-360, at_most=360, unit="°"
    )
    """Longitude of the center, to the east."""
    x_m: float | None = key(forms.CONSTANT, optional=True, at_least=-1e12, at_most=1e12, unit="m")
    """The center's x in the file's projected system, in place of a longitude."""
    y_m: float | None = key(forms.CONSTANT, optional=True, at_least=-1e12, at_most=1e12, unit="m")
    """The center's y there, in place of a latitude."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a finding where a center is not given once and whole."""
        angles, lengths = (
            [name for name in names if name in node]
            for names in (("latitude_deg", "longitude_deg"), ("x_m", "y_m"))
        )
        if sorted((len(angles), len(lengths))) != [0, 2]:
            found = ", ".join((*angles, *lengths)) or "neither"
            yield node.fault(
                f"expected latitude_deg and longitude_deg, or x_m and y_m; found {found}"
            )

    def part(self, pixel_m: tuple[float, float] | None, spacing_m: float) -> RasterWindow:
        """Returns what is read where pixels get a size, for a terrain of a spacing."""
        at = self.latitude_deg, self.longitude_deg, self.x_m, self.y_m
        return RasterWindow(*at, self.size_m, pixel_m, spacing_m)


@dataclass(frozen=True)
class Dem:
    """A measured height field, laid over the terrain at a scale of one's choice.

    A base.

    Note: Interpolation is bicubic (Catmull-Rom): it passes through the samples and is C1. Where the
    file says where on a planet it lies, that is reported, and heights do not depend on it by one
    bit.
    """

    EXAMPLE: ClassVar = {
        "type": "dem",
        "file": "package:matplotlib/mpl-data/sample_data/jacksboro_fault_dem.npz",
        "array": "elevation",
        "pixel_m": [0.25, 0.31],
        "height_scale": 0.006,
    }
    TITLE: ClassVar = "Relief: DEM"

    file: Path = key(file("dem"))
    """A .npz or .npy file, a raster (GeoTIFF, PDS3, PDS4, ISIS, VRT and others), or a gray picture
    of 8 or 16 bits, relative to the cfg, or "package:NAME/path"."""
    array: str | None = key(forms.WORDS, optional=True)
    """Member of an .npz, variable of a NetCDF file; left out, the only two-dimensional one."""
    pixel_m: float | tuple[float, float] | None = key(
        Form(
            {
                "type": ["number", "object", "array"],
                "if": {"type": "array"},
                "then": {"minItems": 2, "maxItems": 2, "items": _PIXEL.keywords},
                "else": {**_PIXEL.keywords, "description": "Size along both axes."},
            }
        ),
        optional=True,
        unit="m",
    )
    """Size that a pixel gets, one number or [x, y]. Left out, that of the raster; degrees are laid
    on the plane that touches the body."""
    height_scale: float = key(
        forms.PER_BATCH, default=1, at_least=-1_000_000_000, at_most=1_000_000_000
    )
    """Factor on the file's heights."""
    height_offset_m: float | None = key(
        Form(
            {
                "type": ["number", "object", "null"],
                "if": {"type": ["number", "object"]},
                "then": _HEIGHT.but(description="Added to the scaled heights.").keywords,
            }
        ),
        default=0,
        unit="m",
    )
    """Added to the scaled heights; null puts their mean at 0."""
    first_row: Literal["north", "south"] = key(forms.CHOICE, default="north")
    """Whether the file's first row is the northern or the southern one, where it does not say."""
    center: tuple[float, float] = key(
        list_of(forms.FRACTION_PER_BATCH, "Fraction along one axis.", least=2, most=2),
        default=[0.5, 0.5],
    )
    """Point of the DEM at the terrain's center, as fractions of its width (from the west) and
    height (from the south)."""
    nodata: float | None = key(Form({"type": ["number", "null"]}), optional=True)
    """Value that marks holes, besides NaN and what the file declares. What looks like an undeclared
    mark (-32768, -9999 …, far from all heights) is refused without it, a far 0 warned of; null:
    they are heights."""
    band: int | None = key(forms.COUNT, optional=True, at_least=1, at_most=65_535)
    """Band that holds the heights, from 1. Left out, the only one besides alpha."""
    unit_m: float | None = key(forms.CONSTANT, optional=True, above=0, at_most=1_000_000, unit="m")
    """Meters per unit of height, after the file's own scale and offset. Left out, what a raster
    says (m, km, ft, us-ft …), else 1."""
    window: DemWindow | None = key(an("dem_window", drawn=True), sparse=True)
    """Part of a raster that is read in place of all of it; center is then a place in it."""
    edge: Literal["error", "clamp"] = key(forms.CHOICE, default="error")
    """Where the terrain exceeds the DEM: an error, or the border's heights go on."""
    holes: Literal["error", "fill"] = key(forms.CHOICE, default="error")
    """Where there is no data under the terrain: an error, or a membrane over the hole (Laplace's
    equation)."""
    height_range_m: tuple[float, float] | None = key(
        list_of(_HEIGHT, "Height.", least=2, most=2), optional=True, unit="m"
    )
    """For pictures: heights of black and of white."""

    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights plus the DEM's.

        Raises:
            SceneError: The file cannot be read, has holes under the terrain that are not to be
                filled, is too small, or lies the other way round; or nothing says how large its
                pixels are.
        """
        base, report = self._scaled(grid)
        offset = -float(base.mean()) if self.height_offset_m is None else self.height_offset_m
        law: SpectralLaw | None = report.pop("spectrum")
        used = {"height_offset_m": offset, "pixels_used": report.pop("pixels_used")}
        spectrum = {} if law is None else law.facts()
        return height + (base + offset), {**used, **report, **spectrum}

    def spectral_law(self, grid: Grid) -> SpectralLaw | None:
        """Fits the spectrum of its scaled heights under a terrain; see ``fit_spectral_law``.

        Raises:
            SceneError: As ``apply``.
        """
        law: SpectralLaw | None = self._scaled(grid)[1]["spectrum"]
        return law

    def georeference(self, grid: Grid) -> Georeference | None:
        """Returns where on a body a terrain lies; None where the file does not say.

        Raises:
            SceneError: As ``apply``.
        """
        return recorded_place(self._scaled(grid)[1])

    def _scaled(self, grid: Grid) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Scaled heights, and the report with their spectrum."""
        pixel = self.pixel_m if self.pixel_m is None else _pair(self.pixel_m)
        window = None if self.window is None else self.window.part(pixel, min(grid.spacing_m))
        dem = read_dem(
            self.file, self.array, self.nodata, self.height_range_m, self.band, self.unit_m, window
        )
        frame = dem.frame
        if frame is not None and frame.first_row() == "north" == _OTHER[self.first_row]:
            raise SceneError(
                f"{self.file.name}: its georeference puts the first row in the north: say "
                '"first_row": "north"'
            )
        if frame is not None and (dem.spot or not self._is_upright(frame, dem.values.shape)):
            base, report = self._laid(grid, dem, frame, pixel)
        else:
            base, report = self._upright(grid, dem, pixel)
        base *= self.height_scale
        return base, {**dem.facts, **report}

    def _is_upright(self, frame: RasterFrame, shape: tuple[int, ...]) -> bool:
        """Whether rows run east, in the order that is said, and pixels have a size along them."""
        a, b, _, d, e, _ = frame.transform
        upright = abs(b) * shape[0] <= _UPRIGHT * abs(a) and abs(d) * shape[1] <= _UPRIGHT * abs(e)
        sized = not frame.geographic or self.pixel_m is not None
        return upright and sized and a > 0.0 and frame.first_row() == self.first_row

    def _upright(self, grid: Grid, dem: DemFile, pixel: tuple[float, float] | None) -> Applied:
        """Heights of a file whose rows run east: axis by axis."""
        samples, holes = dem.values, dem.holes
        size = pixel or (dem.frame.pixel_m() if dem.frame else None)
        if size is None:
            raise SceneError(f"{self.file.name}: does not say its pixels' size: give pixel_m")
        if self.first_row == "north":
            samples, holes = samples[::-1], holes[::-1]
        ny, nx = samples.shape
        # Pixel-is-area: the DEM spans nx pixels, sample i stands at the center of its pixel.
        u = grid.x() / size[0] + self.center[0] * nx - 0.5
        v = grid.y() / size[1] + self.center[1] * ny - 0.5
        if self.edge == "error":
            for axis, at, n, wide, width, center in (
                ("wide", u, nx, grid.size_m[0], size[0], self.center[0]),
                ("high", v, ny, grid.size_m[1], size[1], self.center[1]),
            ):
                if at[0] < -0.5 or at[-1] > n - 0.5:
                    # Pixels between the terrain's center and the nearer border.
                    room = n * min(center, 1.0 - center)
                    larger = f"make pixel_m at least {_up(0.5 * wide / room)} or " if room else ""
                    raise SceneError(
                        f"{self.file.name}: the terrain ({wide:g} m {axis}) reaches over the DEM's "
                        f"border ({n} pixels of {width:g} m = {n * width:g} m, center at "
                        f'{center:g}); {larger}move center, or say "edge": "clamp"'
                    )
        rows, columns = _under(v, ny, 0), _under(u, nx, 0)
        wide_part = _under(v, ny, _FILL_MARGIN), _under(u, nx, _FILL_MARGIN)
        samples, filled = self._filled(samples, holes, int(holes[rows, columns].sum()), wide_part)
        base = np.empty(grid.shape)
        over_threads(_bicubic_part, v.size, np.ascontiguousarray(samples), u, v, base)
        law = fit_spectral_law(self.height_scale * samples[rows, columns], size)
        report: dict[str, Any] = {
            "pixels_used": _used(u, v, samples.shape),
            "spectrum": law,
            **filled,
        }
        if dem.frame is not None and dem.frame.crs:
            column, row = self._middle(dem.frame, dem.values.shape)
            report["georeference"] = self._place(
                grid, plane_of(dem.frame, nx, dem.frame.at(column, row), pixel, False), dem.frame,
                dem.frame.at(column, row),
            )  # fmt: skip
        return base, report

    def _laid(
        self, grid: Grid, dem: DemFile, frame: RasterFrame, pixel: tuple[float, float] | None
    ) -> Applied:
        """Heights of a file that is turned or in degrees, or of a window: point by point."""
        ny, nx = dem.values.shape
        spot = dem.spot or frame.at(*self._middle(frame, (ny, nx)))
        plane = plane_of(frame, nx, spot, pixel, dem.spot is not None)
        if plane is None:
            raise SceneError(f"{self.file.name}: does not say its pixels' size: give pixel_m")
        x, y = grid.x(), grid.y()
        if self.window is not None:
            size = self.window.size_m
            away = [(c - 0.5) * side for c, side in zip(self.center, size, strict=True)]
            if any(away):
                # The plane touches the body below the terrain's center.
                column, row = plane.pixels(*(np.array([part]) for part in away))
                plane = replace(plane, spot=frame.at(float(column[0]), float(row[0])))
            over = (np.abs(at + part).max() for at, part in zip((x, y), away, strict=True))
            # A hair of slack, as of a grid's spacing.
            inside = all(r <= 0.5 * side * (1 + 1e-12) for r, side in zip(over, size, strict=True))
            if self.edge == "error" and not inside:
                raise SceneError(
                    f"{self.file.name}: the terrain ({grid.size_m[0]:g} x {grid.size_m[1]:g} m) "
                    f"reaches over the window ({size[0]:g} x {size[1]:g} m): make size_m larger, "
                    'or say "edge": "clamp"'
                )
        u, v = np.empty(grid.shape), np.empty(grid.shape)
        for j in range(y.size):
            column, row = plane.pixels(x, np.full(x.size, y[j]))
            u[j], v[j] = column - 0.5, row - 0.5
        if not (np.isfinite(u).all() and np.isfinite(v).all()):
            raise SceneError(f"{self.file.name}: the terrain reaches beyond the body's limb")
        if self.edge == "error":
            over = max(-u.min(), u.max() - nx + 1.0, -v.min(), v.max() - ny + 1.0) - 0.5
            if over > _ROUNDING:
                raise SceneError(
                    f"{self.file.name}: the terrain ({grid.size_m[0]:g} x {grid.size_m[1]:g} m) "
                    f"reaches over the DEM's border, by {over:.3g} of its pixels: move it with "
                    'center or window, or say "edge": "clamp"'
                )
        span = (
            _under(np.array([v.min(), v.max()]), ny, _FILL_MARGIN),
            _under(np.array([u.min(), u.max()]), nx, _FILL_MARGIN),
        )
        count = _holes_under(dem.holes, u, v) if dem.holes.any() else 0
        samples, filled = self._filled(dem.values, dem.holes, count, span)
        base = np.empty(grid.shape)
        over_threads(_bicubic_at, y.size, np.ascontiguousarray(samples), u, v, base)
        used = [int(min(at.max(), n - 1) - max(at.min(), 0.0)) + 1 for at, n in ((u, nx), (v, ny))]
        part = tuple(_under(np.array([at.min(), at.max()]), n, 0) for at, n in ((v, ny), (u, nx)))
        size_m = plane.pixel_m((0.5 * grid.size_m[0], 0.5 * grid.size_m[1]))
        law = size_m and fit_spectral_law(self.height_scale * samples[part], size_m)
        report: dict[str, Any] = {"pixels_used": used, "spectrum": law, **filled}
        if frame.crs:
            report["georeference"] = self._place(grid, plane, frame, plane.spot)
        return base, report

    def _middle(self, frame: RasterFrame, shape: tuple[int, ...]) -> tuple[float, float]:
        """The terrain's center in a whole file: column, row."""
        a, _, _, _, e, _ = frame.transform
        across, up = self.center
        if a < 0.0:
            across = 1.0 - across
        south = e > 0.0 or (a != 0.0 and self.first_row == "south")
        return across * shape[1], (up if south else 1.0 - up) * shape[0]

    def _place(
        self, grid: Grid, plane: RasterPlane | None, frame: RasterFrame, at: tuple[float, float]
    ) -> dict[str, Any]:
        """For the report: the reference system, the terrain's center in it, and on the body."""
        place = plane.georeference(0.5 * max(grid.size_m)) if plane else None
        return {
            "crs": frame.crs,
            "center": list(at),
            **({} if place is None else {"on_body": asdict(place)}),
        }

    def _filled(
        self, samples: NDArray, holes: NDArray, count: int, wide: tuple[slice, slice]
    ) -> Applied:
        """Samples without holes under the terrain, and how many were filled."""
        if count == 0:
            return samples, {}
        if self.holes == "error":
            raise SceneError(
                f"{self.file.name}: {count} samples under the terrain have no data (NaN or nodata);"
                ' say "holes": "fill", or move the terrain with center'
            )
        if holes[wide].all():
            raise SceneError(f"{self.file.name}: there is no data under or near the terrain")
        filled = samples.copy()
        filled[wide], error = fill_holes(
            np.ascontiguousarray(samples[wide]), np.ascontiguousarray(holes[wide])
        )
        return filled, {
            "holes_filled": count,
            "holes_error_m": error * abs(self.height_scale),
        }


def recorded_place(report: JsonObject) -> Georeference | None:
    """Returns where on a body a terrain lies, by what a DEM reported; None where it does not."""
    place = report.get("georeference", {}).get("on_body")
    if place is None:
        return None
    return decode(encode(place), Georeference, SceneError, "georeference")


def georeference_of(relief: Sequence[Any], grid: Grid) -> Georeference | None:
    """Returns where on a body a terrain lies, by its first DEM that says so; None without one.

    Raises:
        SceneError: A DEM cannot be read.
    """
    dems = (dem for dem in map(unmasked, relief) if isinstance(dem, Dem))
    return next(filter(None, (dem.georeference(grid) for dem in dems)), None)


def _up(value: float) -> str:
    """Formats a value in six digits, rounded up."""
    text = f"{value:.6g}"
    return text if float(text) >= value else f"{value * (1.0 + 1e-5):.6g}"


def _pair(size: float | tuple[float, float]) -> tuple[float, float]:
    return size if isinstance(size, tuple) else (size, size)


def _under(at: NDArray, n: int, margin: int) -> slice:
    """Samples that interpolation reads along one axis, and some more."""
    low = max(int(np.floor(at[0])) - 1 - margin, 0)
    return slice(min(low, n - 1), max(min(int(np.floor(at[-1])) + 3 + margin, n), 1))


def _holes_under(holes: NDArray, u: NDArray, v: NDArray) -> int:
    """How many holes interpolation reads."""
    ny, nx = holes.shape
    read = np.zeros(holes.shape, bool)
    row, column = (np.clip(np.floor(at).astype(np.int64), 0, n - 1) for at, n in ((v, ny), (u, nx)))
    for j in range(-1, 3):
        for i in range(-1, 3):
            read[np.clip(row + j, 0, ny - 1), np.clip(column + i, 0, nx - 1)] = True
    return int(np.count_nonzero(read & holes))


def _used(u: NDArray, v: NDArray, shape: tuple[int, int]) -> list[int]:
    def span(at: NDArray, n: int) -> int:
        return int(min(at[-1], n - 1) - max(at[0], 0.0)) + 1

    return [span(u, shape[1]), span(v, shape[0])]


@kernel
def _bicubic_part(
    first: int, last: int, samples: NDArray, u: NDArray, v: NDArray, out: NDArray
) -> None:
    for j in range(first, last):
        for i in range(u.size):
            out[j, i] = _bicubic(samples, u[i], v[j])


@kernel
def _bicubic_at(
    first: int, last: int, samples: NDArray, u: NDArray, v: NDArray, out: NDArray
) -> None:
    for j in range(first, last):
        for i in range(u.shape[1]):
            out[j, i] = _bicubic(samples, u[j, i], v[j, i])


@inlined
def _bicubic(samples, u, v):  # type: ignore[no-untyped-def]
    """Height at a place in the file; outside of it, of its nearest border point."""
    ny, nx = samples.shape
    x, y = min(max(u, 0.0), nx - 1.0), min(max(v, 0.0), ny - 1.0)
    column, row = int(x), int(y)
    rows = max(row - 1, 0), row, min(row + 1, ny - 1), min(row + 2, ny - 1)
    columns = max(column - 1, 0), column, min(column + 1, nx - 1), min(column + 2, nx - 1)
    return bicubic(samples, rows, columns, x - column, y - row)
