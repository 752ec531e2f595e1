"""Begins with a measured height field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.dem_file import DemFile, read_dem
from scenec.compiler.assets.geotiff import GeoReference
from scenec.compiler.kinds import Form, bounded, file, forms, key, list_of
from scenec.compiler.terrain.grid import Applied, Grid, bicubic
from scenec.compiler.terrain.mask import unmasked
from scenec.compiler.terrain.sources.fill_holes import fill_holes
from scenec.compiler.terrain.spectral_law import SpectralLaw, fit_spectral_law
from scenec.schemas.errors import SceneError
from scenec.schemas.georeference import Georeference
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

# Holes are filled from what lies within so many pixels of the terrain.
_FILL_MARGIN = 256
_PIXEL = bounded(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000).but(
    description="Size along one axis."
)
_HEIGHT = bounded(forms.LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000)


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
    """A .npz or .npy file, a GeoTIFF that lies upright in its coordinates, or a gray picture of 8
    or 16 bits: relative to the cfg, or "package:NAME/path" in an installed Python package, where *
    stands for any part of a name."""
    array: str | None = key(forms.WORDS, optional=True)
    """Member of an .npz file; left out, its only two-dimensional one."""
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
    """Size that a pixel gets: one number, or [x, y]. Left out, that of a GeoTIFF whose coordinates
    are lengths."""
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
    """Whether the file's first row is its northern or its southern one."""
    center: tuple[float, float] = key(
        list_of(forms.FRACTION_PER_BATCH, "Fraction along one axis.", least=2, most=2),
        default=[0.5, 0.5],
    )
    """Which point of the DEM lies at the terrain's center, as fractions of its width (from the
    west) and height (from the south)."""
    nodata: float | None = key(Form({"type": ["number", "null"]}), optional=True)
    """Value in the file that marks holes, besides NaN and what the file itself declares. Values
    that look like an undeclared mark (-32768, -9999 …, far from all other heights) are refused
    without it, and 0 far from all other samples is warned of; null says that they are heights."""
    band: int | None = key(forms.COUNT, optional=True, at_least=1, at_most=65_535)
    """Band of a GeoTIFF that holds the heights, counted from 1. Left out, its only one, not
    counting alpha."""
    unit_m: float | None = key(forms.CONSTANT, optional=True, above=0, at_most=1_000_000, unit="m")
    """Meters per unit of the file's heights. Left out, what a GeoTIFF says (m, km, ft, us-ft …, of
    its band or its vertical axis), else 1. Its own scale and offset are applied before."""
    edge: Literal["error", "clamp"] = key(forms.CHOICE, default="error")
    """What happens where the terrain is larger than the DEM: an error, or the border's heights go
    on."""
    holes: Literal["error", "fill"] = key(forms.CHOICE, default="error")
    """What happens where there is no data under the terrain: an error, or a membrane stretched over
    the hole (Laplace's equation)."""
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
        dem, samples, holes, pixel = self._opened()
        ny, nx = samples.shape
        u, v = self._columns_and_rows(grid, samples.shape, pixel)
        samples, report = self._filled(samples, holes, u, v)
        base = np.empty(grid.shape)
        over_threads(_bicubic_part, v.size, np.ascontiguousarray(samples), u, v, base)
        base *= self.height_scale
        offset = -float(base.mean()) if self.height_offset_m is None else self.height_offset_m
        law = self._law(samples, u, v, pixel)
        report = {**dem.facts, **report, **(law.facts() if law else {})}
        if dem.reference is not None and dem.reference.crs:
            row = (1.0 - self.center[1]) * ny if self.first_row == "north" else self.center[1] * ny
            report["georeference"] = _place(dem.reference, self.center[0] * nx, row)
        return height + (base + offset), {
            "height_offset_m": offset,
            "pixels_used": _used(u, v, samples.shape),
            **report,
        }

    def georeference(self, size_m: tuple[float, float]) -> Georeference | None:
        """Returns where on a body a terrain on it lies; None where its file does not say.

        Raises:
            SceneError: The file cannot be read.
        """
        return None

    def spectral_law(
        self, size_m: tuple[float, float], slope: float | None = None
    ) -> SpectralLaw | None:
        """Fits the spectrum of its scaled heights under a terrain; see ``fit_spectral_law``.

        Raises:
            SceneError: As ``apply``.
        """
        _, samples, holes, pixel = self._opened()
        u, v = self._columns_and_rows(Grid(size_m, (2, 2)), samples.shape, pixel)
        return self._law(self._filled(samples, holes, u, v)[0], u, v, pixel, slope)

    def _law(
        self,
        samples: NDArray[np.float64],
        u: NDArray,
        v: NDArray,
        pixel: tuple[float, float],
        slope: float | None = None,
    ) -> SpectralLaw | None:
        under = _under(v, samples.shape[0], 0), _under(u, samples.shape[1], 0)
        return fit_spectral_law(self.height_scale * samples[under], pixel, slope)

    def _opened(
        self,
    ) -> tuple[DemFile, NDArray[np.float64], NDArray[np.bool_], tuple[float, float]]:
        """Returns the file, its samples and holes from south to north, and the size of a pixel."""
        dem = read_dem(
            self.file, self.array, self.nodata, self.height_range_m, self.band, self.unit_m
        )
        samples, holes = dem.values, dem.holes
        pixel = self.pixel_m or (dem.reference.pixel_m() if dem.reference else None)
        if pixel is None:
            raise SceneError(f"{self.file.name}: does not say its pixels' size: give pixel_m")
        if not isinstance(pixel, tuple):
            pixel = pixel, pixel
        if dem.reference and dem.reference.first_row() != self.first_row:
            raise SceneError(
                f"{self.file.name}: its georeference puts the first row in the "
                f'{dem.reference.first_row()}: say "first_row": "{dem.reference.first_row()}"'
            )
        if dem.reference and dem.reference.transform[0] < 0.0:
            raise SceneError(
                f"{self.file.name}: its georeference puts the first column in the east: mirror the "
                "file (gdalwarp does)"
            )
        if self.first_row == "north":
            samples, holes = samples[::-1], holes[::-1]
        return dem, samples, holes, pixel

    def _columns_and_rows(
        self, grid: Grid, shape: tuple[int, ...], pixel: tuple[float, float]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns where a grid's samples lie among the file's, float64 [nx], [ny]."""
        ny, nx = shape
        # Pixel-is-area: the DEM spans nx pixels, sample i stands at the center of its pixel.
        u = grid.x() / pixel[0] + self.center[0] * nx - 0.5
        v = grid.y() / pixel[1] + self.center[1] * ny - 0.5
        if self.edge == "error":
            for axis, at, n, size, width, center in (
                ("wide", u, nx, grid.size_m[0], pixel[0], self.center[0]),
                ("high", v, ny, grid.size_m[1], pixel[1], self.center[1]),
            ):
                if at[0] < -0.5 or at[-1] > n - 0.5:
                    # Pixels between the terrain's center and the nearer border.
                    room = n * min(center, 1.0 - center)
                    larger = f"make pixel_m at least {_up(0.5 * size / room)} or " if room else ""
                    raise SceneError(
                        f"{self.file.name}: the terrain ({size:g} m {axis}) reaches over the DEM's "
                        f"border ({n} pixels of {width:g} m = {n * width:g} m, center at "
                        f'{center:g}); {larger}move center, or say "edge": "clamp"'
                    )
        return u, v

    def _filled(self, samples: NDArray, holes: NDArray, u: NDArray, v: NDArray) -> Applied:
        """Samples without holes under the terrain, and how many were filled."""
        rows, columns = _under(v, holes.shape[0], 0), _under(u, holes.shape[1], 0)
        count = int(holes[rows, columns].sum())
        if count == 0:
            return samples, {}
        if self.holes == "error":
            raise SceneError(
                f"{self.file.name}: {count} samples under the terrain have no data (NaN or nodata);"
                ' say "holes": "fill", or move the terrain with center'
            )
        wide = (
            _under(v, holes.shape[0], _FILL_MARGIN),
            _under(u, holes.shape[1], _FILL_MARGIN),
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


def georeference_of(relief: Sequence[Any], size_m: tuple[float, float]) -> Georeference | None:
    """Returns where on a body a terrain lies, by its first DEM that says so; None without one."""
    dems = (dem for dem in map(unmasked, relief) if isinstance(dem, Dem))
    return next(filter(None, (dem.georeference(size_m) for dem in dems)), None)


def _up(value: float) -> str:
    """Formats a value in six digits, rounded up."""
    text = f"{value:.6g}"
    return text if float(text) >= value else f"{value * (1.0 + 1e-5):.6g}"


def _place(reference: GeoReference, column: float, row: float) -> dict[str, Any]:
    """For the report: the reference system, and the terrain's center in it."""
    return {"crs": reference.crs, "center": list(reference.at(column, row))}


def _under(at: NDArray, n: int, margin: int) -> slice:
    """Samples that interpolation reads along one axis, and some more."""
    low = max(int(np.floor(at[0])) - 1 - margin, 0)
    return slice(min(low, n - 1), max(min(int(np.floor(at[-1])) + 3 + margin, n), 1))


def _used(u: NDArray, v: NDArray, shape: tuple[int, int]) -> list[int]:
    def span(at: NDArray, n: int) -> int:
        return int(min(at[-1], n - 1) - max(at[0], 0.0)) + 1

    return [span(u, shape[1]), span(v, shape[0])]


@kernel
def _bicubic_part(
    first: int, last: int, samples: NDArray, u: NDArray, v: NDArray, out: NDArray
) -> None:
    ny, nx = samples.shape
    for j in range(first, last):
        y = min(max(v[j], 0.0), ny - 1.0)
        row = int(y)
        ty = y - row
        for i in range(u.size):
            x = min(max(u[i], 0.0), nx - 1.0)
            column = int(x)
            tx = x - column
            rows = max(row - 1, 0), row, min(row + 1, ny - 1), min(row + 2, ny - 1)
            columns = max(column - 1, 0), column, min(column + 1, nx - 1), min(column + 2, nx - 1)
            out[j, i] = bicubic(samples, rows, columns, tx, ty)
