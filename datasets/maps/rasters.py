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
) -> None:
    """Writes ``<layer>.tif`` of each layer, from tiles as ``MapTile`` leaves them.

    Args:
        folder: Is there; a killed process may leave half of a file in it.
        grid: All cells.
        layers: By name.
        place: Where the stage lies; None: nobody knows.
        tile: The file of a tile.

    Raises:
        OutputError: A file cannot be written, or a tile's is none.
    """
    with rasters() as rasterio, ExitStack() as stack:
        files = {
            name: stack.enter_context(_created(rasterio, folder / f"{name}.tif", grid, name, place))
            for name in layers
        }
        for first in grid.tiles:
            height, width = grid.extent(first)
            window = rasterio.windows.Window(first[1], first[0], width, height)
            path = tile(first)
            try:
                # One layer at a time: a tile's file is read as it is asked.
                with np.load(path, allow_pickle=False) as arrays:
                    for name, file in files.items():
                        file.write(arrays[name], 1, window=window)
            except (OSError, ValueError, KeyError) as error:
                raise OutputError(f"{path}: is no tile of a map: {error}") from error


def _created(
    rasterio: Any, path: Path, grid: MapGrid, name: str, place: Georeference | None
) -> rasterio.io.DatasetWriter:
    kind = "uint32" if name.startswith("label_") else _TYPES.get(name, "float32")
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
        predictor=3 if kind == "float32" else 2,
        bigtiff="IF_SAFER",
    )
    unit, what = LAYERS[name.split("_")[0]]
    file.set_band_description(1, f"{name}: {what}")
    file.set_band_unit(1, unit)
    return file


def read_small(path: Path, side: int) -> NDArray[Any]:
    """A layer with every n-th cell alone, so that neither side is longer than some pixels."""
    with rasters() as rasterio, rasterio.open(path) as file:
        shrunk = max(1, -(-max(file.shape) // side))
        shape = tuple(max(1, count // shrunk) for count in file.shape)
        found: NDArray[Any] = file.read(1, out_shape=shape)
        return found
