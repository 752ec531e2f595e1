"""Layers of maps as GeoTIFF, put together tile by tile: memory does not grow with the map."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import OutputError
from scenec.schemas.extras import install
from scenec.schemas.georeference import Georeference
from scenec.schemas.site_map import LAYERS, MapGrid

if TYPE_CHECKING:
    import rasterio

#: Cells along a side of a GeoTIFF's own tiles; those of maps are made of them.
_BLOCK = 256
#: Bytes that GDAL keeps of them.
_CACHE = 64 << 20
_TYPES = {"traversability": "uint8", "instance": "uint32"}


@contextmanager
def rasters() -> Iterator[Any]:
    """Gives rasterio, which warns of nothing and reads and writes nothing beside a file.

    Raises:
        OutputError: It is not installed.
    """
    try:
        import rasterio
        from rasterio.errors import NotGeoreferencedWarning, RasterioError
    except ModuleNotFoundError as error:
        raise OutputError(f"maps are GeoTIFF: {install('geotiff')}") from error
    alone = {"GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR", "GDAL_PAM_ENABLED": "NO"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            with rasterio.Env(**alone, GDAL_CACHEMAX=_CACHE):
                yield rasterio
        except RasterioError as error:
            raise OutputError(f"a map cannot be written: {error}") from error


def write_layers(
    folder: Path,
    grid: MapGrid,
    layers: Sequence[str],
    place: Georeference | None,
    tile: Callable[[tuple[int, int]], Path],
    side: int,
) -> dict[str, NDArray[Any]]:
    """Writes ``<layer>.tif`` of each layer, from tiles as ``MapTile`` leaves them.

    Args:
        folder: Is there; a killed process may leave half of a file in it.
        grid: All cells.
        layers: By name.
        place: Where the stage lies; None: nobody knows.
        tile: The file of a tile.
        side: Most cells along a side of what is returned.

    Returns:
        Layers by name with every n-th cell alone.

    Raises:
        OutputError: A file cannot be written, or a tile's is none.
    """
    every = max(1, -(-max(grid.height, grid.width) // side))
    rows, columns = (
        np.minimum(np.arange(max(1, count // every)) * every + every // 2, count - 1)
        for count in (grid.height, grid.width)
    )
    small: dict[str, NDArray[Any]] = {
        name: np.empty((len(rows), len(columns)), _kind(name)) for name in layers
    }
    with rasters() as rasterio, ExitStack() as stack:
        files = {
            name: stack.enter_context(_created(rasterio, folder / f"{name}.tif", grid, name, place))
            for name in layers
        }
        for first in grid.tiles:
            height, width = grid.extent(first)
            window = rasterio.windows.Window(first[1], first[0], width, height)
            path = tile(first)
            down, across = (
                slice(*np.searchsorted(picked, (start, start + count)))
                for picked, start, count in zip(
                    (rows, columns), first, (height, width), strict=True
                )
            )
            try:
                # One layer at a time: a tile's file is read as it is asked.
                with np.load(path, allow_pickle=False) as arrays:
                    for name, file in files.items():
                        values = arrays[name]
                        file.write(values, 1, window=window)
                        picked = np.ix_(rows[down] - first[0], columns[across] - first[1])
                        small[name][down, across] = values[picked]
            except (OSError, ValueError, KeyError) as error:
                raise OutputError(f"{path}: is no tile of a map: {error}") from error
    return small


def _kind(name: str) -> str:
    return "uint32" if name.startswith("label_") else _TYPES.get(name, "float32")


def _created(
    rasterio: Any, path: Path, grid: MapGrid, name: str, place: Georeference | None
) -> rasterio.io.DatasetWriter:
    kind = _kind(name)
    transform = rasterio.Affine(grid.cell_m, 0.0, grid.west, 0.0, -grid.cell_m, grid.north)
    crs = None
    if place is not None:
        crs, affine = place.plane()
        transform = rasterio.Affine(*affine) @ transform
    file = rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=grid.width,
        height=grid.height,
        count=1,
        dtype=kind,
        nodata=np.nan if kind == "float32" else 0,
        transform=transform,
        crs=crs,
        tiled=True,
        blockxsize=_BLOCK,
        blockysize=_BLOCK,
        compress="deflate",
        # 2 % more bytes than GDAL's 6, in 60 % of the time.
        zlevel=2,
        predictor=3 if kind == "float32" else 2,
        bigtiff="IF_SAFER",
    )
    unit, what = LAYERS[name.split("_")[0]]
    file.set_band_description(1, f"{name}: {what}")
    file.set_band_unit(1, unit)
    return file
