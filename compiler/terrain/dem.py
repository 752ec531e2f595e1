"""A measured height field as base."""

from __future__ import annotations

import io
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from zipfile import BadZipFile

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Grid
from scenec.schemas.errors import SceneError

#: What NumPy raises for files that are none of its own, or broken ones.
_BROKEN = (OSError, ValueError, EOFError, BadZipFile, zlib.error, NotImplementedError, MemoryError)


@dataclass(frozen=True)
class Dem:
    """A DEM laid over the terrain, at a scale of one's choice, interpolated smoothly.

    Interpolation is bicubic (Catmull-Rom): it passes through the samples and is C1.

    Attributes:
        file: ``.npz``, ``.npy`` or GeoTIFF.
        array: Member of an ``.npz``; None takes the only two-dimensional one.
        pixel_m: Size that a pixel gets, in x and y, meters.
        height_scale: Factor on the file's heights.
        height_offset_m: Added after scaling, meters; None puts the mean at 0.
        first_row: Whether the file's first row is the northern or the southern one.
        center: Fraction of the DEM's width and height that lies at the terrain's center.
        nodata: Value that marks holes, besides NaN and what the file itself declares.
        edge: What happens where the terrain is larger than the DEM.
    """

    file: Path
    array: str | None
    pixel_m: tuple[float, float]
    height_scale: float
    height_offset_m: float | None
    first_row: Literal["north", "south"]
    center: tuple[float, float]
    nodata: float | None
    edge: Literal["error", "clamp"]

    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Heights plus the DEM's.

        Raises:
            SceneError: The file cannot be read, has holes under the terrain, or is too small.
        """
        samples, holes = read_dem(self.file, self.array)
        if self.nodata is not None:
            holes |= samples == self.nodata
        if self.first_row == "north":
            samples, holes = samples[::-1], holes[::-1]
        ny, nx = samples.shape
        # Pixel-is-area: the DEM spans nx pixels, sample i stands at the center of its pixel.
        u = grid.x() / self.pixel_m[0] + self.center[0] * nx - 0.5
        v = grid.y() / self.pixel_m[1] + self.center[1] * ny - 0.5
        if self.edge == "error":
            for axis, at, n, size, pixel in (
                ("wide", u, nx, grid.size_m[0], self.pixel_m[0]),
                ("high", v, ny, grid.size_m[1], self.pixel_m[1]),
            ):
                if at[0] < -0.5 or at[-1] > n - 0.5:
                    raise SceneError(
                        f"{self.file.name}: the terrain ({size:g} m {axis}) reaches over the DEM's "
                        f"border ({n} pixels of {pixel:g} m = {n * pixel:g} m); make pixel_m at "
                        f'least {size / n:g} or move center, or say "edge": "clamp"'
                    )
        _refuse_holes(self.file, holes, u, v)
        base = _bicubic(np.ascontiguousarray(samples), u, v) * self.height_scale
        offset = -float(base.mean()) if self.height_offset_m is None else self.height_offset_m
        return height + (base + offset), {
            "height_offset_m": offset,
            "pixels_used": _used(u, v, samples.shape),
        }


def read_dem(file: Path, array: str | None) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Heights (scale and offset of the file applied) and where there are none.

    Returns:
        float64 [ny, nx] in file order, with 0 in holes; bool [ny, nx].

    Raises:
        SceneError: The file is not a two-dimensional field of numbers.
    """
    suffix = file.suffix.lower()
    if suffix in (".npz", ".npy"):
        samples = _read_numpy(file, array)
        missing = None
    elif suffix in (".tif", ".tiff"):
        samples, missing = _read_geotiff(file)
    else:
        raise SceneError(
            f"{file.name}: a DEM is a .npz, .npy, .tif or .tiff file, not {suffix or 'this'}"
        )
    if samples.ndim != 2 or samples.shape[0] < 1 or samples.shape[1] < 1:
        raise SceneError(f"{file.name}: expected a two-dimensional array, got {samples.shape}")
    if samples.dtype.kind not in "iuf":
        raise SceneError(f"{file.name}: expected numbers, got {samples.dtype}")
    values = samples.astype(np.float64)
    holes = ~np.isfinite(values)
    if missing is not None:
        holes |= missing
    values[holes] = 0.0
    return values, holes


def _read_numpy(file: Path, array: str | None) -> NDArray[Any]:
    try:
        loaded = np.load(io.BytesIO(file.read_bytes()), allow_pickle=False)
    except _BROKEN as error:
        raise SceneError(f"{file.name}: not a NumPy file: {error}") from error
    if isinstance(loaded, np.ndarray):
        return loaded
    try:
        members = {name: loaded[name] for name in loaded.files}
    except _BROKEN as error:
        raise SceneError(f"{file.name}: a broken NumPy file: {error}") from error
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


def _read_geotiff(file: Path) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    try:
        import rasterio
        from rasterio.errors import RasterioError
    except ModuleNotFoundError as error:
        raise SceneError(
            f"{file.name}: reading GeoTIFF needs the extra 'geotiff': pip install 'scenec[geotiff]'"
        ) from error
    try:
        with rasterio.open(file) as source:
            samples = source.read(1)
            missing = source.read_masks(1) == 0
            scaled = samples.astype(np.float64) * source.scales[0] + source.offsets[0]
    except (RasterioError, OSError) as error:
        raise SceneError(f"{file.name}: not a readable GeoTIFF: {error}") from error
    return scaled, missing


def _refuse_holes(file: Path, holes: NDArray[np.bool_], u: NDArray, v: NDArray) -> None:
    ny, nx = holes.shape
    low_x, high_x = int(max(np.floor(u[0]) - 1, 0)), int(min(np.floor(u[-1]) + 3, nx))
    low_y, high_y = int(max(np.floor(v[0]) - 1, 0)), int(min(np.floor(v[-1]) + 3, ny))
    count = int(holes[low_y:high_y, low_x:high_x].sum())
    if count:
        raise SceneError(
            f"{file.name}: {count} samples under the terrain have no data (NaN or nodata); "
            "fill them, or move the terrain with center"
        )


def _used(u: NDArray, v: NDArray, shape: tuple[int, int]) -> list[int]:
    def span(at: NDArray, n: int) -> int:
        return int(min(at[-1], n - 1) - max(at[0], 0.0)) + 1

    return [span(u, shape[1]), span(v, shape[0])]


@njit(cache=True, error_model="numpy", inline="always")
def _catmull_rom(p0: float, p1: float, p2: float, p3: float, t: float) -> float:
    return p1 + 0.5 * t * (
        p2 - p0 + t * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + t * (3.0 * (p1 - p2) + p3 - p0))
    )


@njit(cache=True, error_model="numpy", parallel=True)
def _bicubic(samples: NDArray, u: NDArray, v: NDArray) -> NDArray:
    ny, nx = samples.shape
    out = np.empty((v.size, u.size))
    for j in prange(v.size):
        y = min(max(v[j], 0.0), ny - 1.0)
        row = int(y)
        ty = y - row
        for i in range(u.size):
            x = min(max(u[i], 0.0), nx - 1.0)
            column = int(x)
            tx = x - column
            c0 = max(column - 1, 0)
            c1 = column
            c2 = min(column + 1, nx - 1)
            c3 = min(column + 2, nx - 1)
            r0 = max(row - 1, 0)
            r2 = min(row + 1, ny - 1)
            r3 = min(row + 2, ny - 1)
            a = _catmull_rom(samples[r0, c0], samples[r0, c1], samples[r0, c2], samples[r0, c3], tx)
            b = _catmull_rom(
                samples[row, c0], samples[row, c1], samples[row, c2], samples[row, c3], tx
            )
            c = _catmull_rom(samples[r2, c0], samples[r2, c1], samples[r2, c2], samples[r2, c3], tx)
            d = _catmull_rom(samples[r3, c0], samples[r3, c1], samples[r3, c2], samples[r3, c3], tx)
            out[j, i] = _catmull_rom(a, b, c, d, ty)
    return out
