"""Rasters as they come: each format, and windows on bodies, against values by hand and PROJ."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenec.compiler.assets.dem_file import read_dem
from scenec.compiler.assets.raster import files_of
from scenec.compiler.cfg.load import load
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.sources.dem import Dem, DemWindow
from scenec.schemas.errors import CfgError, SceneError
from scenec.schemas.georeference import Georeference
from scenec.testing.small import small_cfg, write_cfg

rasterio = pytest.importorskip("rasterio")
shutil = pytest.importorskip("rasterio.shutil")
warp = pytest.importorskip("rasterio.warp")

MOON = "IAU_2015:30100"
#: 12 x 16 pixels of 0.1 degrees from 50 N, 10 E, that rise by 1 m a column and 16 m a row.
RAMP = 100.0 + np.arange(192.0).reshape(12, 16)
PLACE = rasterio.Affine(0.1, 0, 10, 0, -0.1, 50)
DEGREE_M = 1_737_400.0 * np.pi / 180.0

PDS3 = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = 64
FILE_RECORDS = {records}
^IMAGE = {image}
OBJECT = IMAGE
  LINES = 12
  LINE_SAMPLES = 16
  SAMPLE_TYPE = PC_REAL
  SAMPLE_BITS = 32
  SCALING_FACTOR = 0.5
  OFFSET = 1000.0
END_OBJECT = IMAGE
OBJECT = IMAGE_MAP_PROJECTION
  MAP_PROJECTION_TYPE = "SIMPLE CYLINDRICAL"
  A_AXIS_RADIUS = 1737.4 <KM>
  B_AXIS_RADIUS = 1737.4 <KM>
  C_AXIS_RADIUS = 1737.4 <KM>
  TARGET_NAME = MOON
  COORDINATE_SYSTEM_NAME = PLANETOCENTRIC
  POSITIVE_LONGITUDE_DIRECTION = EAST
  CENTER_LATITUDE = 0.0 <DEG>
  CENTER_LONGITUDE = 0.0 <DEG>
  MAP_SCALE = 3.03233504241495 <KM/PIXEL>
  MAP_RESOLUTION = 10.0 <PIX/DEG>
  LINE_PROJECTION_OFFSET = 499.5
  SAMPLE_PROJECTION_OFFSET = -100.5
END_OBJECT = IMAGE_MAP_PROJECTION
END
"""


def write(path: Path, samples: np.ndarray, crs: str | None, place: Any, **options: Any) -> Path:
    """A GeoTIFF of one band."""
    high, wide = samples.shape
    with rasterio.open(
        path, "w", driver="GTiff", height=high, width=wide, count=1, dtype=samples.dtype, crs=crs,
        transform=place, **options,
    ) as file:  # fmt: skip
        file.write(samples, 1)
    return path


def copied(driver: str, name: str, **options: str):
    """Who writes RAMP by a driver of GDAL's."""

    def make(folder: Path) -> Path:
        source = write(folder / "source.tif", RAMP.astype(np.float32), MOON, PLACE)
        shutil.copy(source, folder / name, driver=driver, **options)
        return folder / name

    return make


def whole_numbers(folder: Path) -> Path:
    source = write(folder / "source.tif", RAMP.astype(np.int16), MOON, PLACE)
    shutil.copy(source, folder / "a.jp2", driver="JP2OpenJPEG", REVERSIBLE="YES", QUALITY="100")
    return folder / "a.jp2"


def detached(folder: Path) -> Path:
    """By hand, after the PDS3 Standards Reference: GDAL writes none."""
    label = PDS3.format(records=12, image='"A.IMG"')
    (folder / "a.lbl").write_bytes(label.replace("\n", "\r\n").encode())
    (folder / "A.IMG").write_bytes(((RAMP - 1000.0) * 2.0).astype("<f4").tobytes())
    return folder / "a.lbl"


def attached(folder: Path) -> Path:
    """By hand: the label fills 32 records."""
    label = PDS3.format(records=44, image=33).replace("\n", "\r\n").encode()
    pixels = ((RAMP - 1000.0) * 2.0).astype("<f4").tobytes()
    (folder / "a.img").write_bytes(label.ljust(2048) + pixels)
    return folder / "a.img"


#: Who writes it, and the files it is made of.
FORMATS = {
    "GeoTIFF": (copied("GTiff", "a.tif", TILED="YES", COMPRESS="DEFLATE"), "a.tif"),
    "COG": (copied("COG", "a.tiff"), "a.tiff"),
    "PDS3, attached": (attached, "a.img"),
    "PDS3, detached": (detached, "a.lbl A.IMG"),
    "PDS4": (copied("PDS4", "a.xml"), "a.xml a.img"),
    "ISIS, attached": (copied("ISIS3", "a.cub"), "a.cub"),
    "ISIS, detached": (
        copied("ISIS3", "a.lbl", DATA_LOCATION="EXTERNAL"), "a.lbl a.History.IsisCube a.cub",
    ),
    "VRT": (copied("VRT", "a.vrt"), "a.vrt source.tif"),
    "ASC": (copied("AAIGrid", "a.asc"), "a.asc a.prj"),
    "ERDAS": (copied("HFA", "a.img"), "a.img"),
    "NetCDF": (copied("netCDF", "a.nc"), "a.nc"),
    "JPEG 2000": (whole_numbers, "a.jp2"),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMATS)
def test_a_format_gives_its_heights_and_its_place(tmp_path, name):
    make, parts = FORMATS[name]
    path = make(tmp_path)
    dem = read_dem(path)
    assert np.array_equal(dem.values, RAMP)
    assert not dem.holes.any()
    assert (dem.frame.body, dem.frame.radii_m) == ("Moon", (1_737_400.0, 1_737_400.0))
    assert [file.name for file in files_of(path)] == parts.split()
    # In the middle of a pixel, and a degree of latitude is 1/360 of the way around.
    window = DemWindow((20_000.0, 20_000.0), latitude_deg=49.45, longitude_deg=10.75)
    grid = Grid.with_spacing((0.2 * DEGREE_M, 0.2 * DEGREE_M), 0.1 * DEGREE_M)
    height, report = Dem(file=path, window=window).apply(grid, np.zeros(grid.shape))
    assert height[1, 1] == pytest.approx(RAMP[5, 7], abs=1e-6)
    assert height[2, 1] - height[0, 1] == pytest.approx(-32.0, abs=0.01)
    place = Georeference(**report["georeference"]["on_body"])
    assert (place.latitude_deg, place.longitude_deg) == pytest.approx((49.45, 10.75), abs=1e-9)
    assert place.error_m == 0.0


def test_hgt_and_variables_of_netcdf(tmp_path):
    from scipy.io import netcdf_file

    # GDAL writes HGT of whole degrees alone; samples stand on them.
    side = np.add.outer(np.arange(1201), np.arange(1201)).astype(np.int16)
    place = rasterio.Affine(1 / 1200, 0, 10 - 1 / 2400, 0, -1 / 1200, 51 + 1 / 2400)
    source = write(tmp_path / "s.tif", side, "EPSG:4326", place)
    shutil.copy(source, tmp_path / "N50E010.hgt", driver="SRTMHGT")
    window = DemWindow((400.0, 400.0), latitude_deg=50.5, longitude_deg=10.25)
    grid = Grid.with_spacing((100.0, 100.0), 50.0)
    height, _ = Dem(file=tmp_path / "N50E010.hgt", window=window).apply(grid, np.zeros(grid.shape))
    assert height[1, 1] == pytest.approx(600 + 300, abs=1e-6)
    with netcdf_file(tmp_path / "a.nc", "w") as file:
        for axis, values, unit in (
            ("lat", 49.95 - 0.1 * np.arange(12), "degrees_north"),
            ("lon", 10.05 + 0.1 * np.arange(16), "degrees_east"),
        ):
            file.createDimension(axis, values.size)
            variable = file.createVariable(axis, "f8", (axis,))
            variable[:], variable.units = values, unit
        for name, factor in (("z", 1.0), ("twice", 2.0)):
            variable = file.createVariable(name, "f4", ("lat", "lon"))
            variable[:], variable.units = factor * RAMP, "m"
    with pytest.raises(SceneError, match='say which with "array": it holds z, twice'):
        read_dem(tmp_path / "a.nc")
    assert np.array_equal(read_dem(tmp_path / "a.nc", array="twice").values, 2.0 * RAMP)


def test_a_part_that_is_missing_or_elsewhere_is_named(tmp_path):
    path = copied("VRT", "a.vrt")(tmp_path)
    (tmp_path / "source.tif").unlink()
    with pytest.raises(SceneError, match=r"a\.vrt: is made of source\.tif, which is not there"):
        files_of(path)
    path.write_text(path.read_text().replace("source.tif", "/vsicurl/http://localhost:9/a.tif"))
    with pytest.raises(SceneError, match="which is not there"):
        files_of(path)


# Windows, against PROJ.

MARS = "+proj=longlat +a=3396190 +b=3376200 +no_defs"
MARS_AREOCENTRIC = "IAU_2015:49902"
#: Reference system, transform (to 200 x 200 pixels), center, size of the window.
LIES = {
    "degrees, Earth": ("EPSG:4326", (1e-3, 0, 10, 0, -1e-3, 50), (49.9, 10.1), 5e3),
    "degrees, Moon": (MOON, (1e-3, 0, 10, 0, -1e-3, 50), (49.9, 10.1), 2e3),
    "over the date line": ("EPSG:4326", (1e-3, 0, 179.9, 0, -1e-3, 50), (49.9, -179.99), 5e3),
    "longitudes from 0 to 360": (MOON, (1e-3, 0, 222.6, 0, -1e-3, -44.9), (-45.0, -137.3), 2e3),
    "south up": (MOON, (1e-3, 0, 10, 0, 1e-3, 50), (50.1, 10.1), 2e3),
    "columns west": (MOON, (-1e-3, 0, 10, 0, -1e-3, 50), (49.9, 9.9), 2e3),
    "turned": (MOON, (8e-4, 6e-4, 10, 6e-4, -8e-4, 50), (50.0, 10.14), 1e3),
    "no squares": (MOON, (2e-3, 0, 10, 0, -5e-4, 50), (49.95, 10.2), 1e3),
    "planetographic, Mars": (MARS, (1e-3, 0, 77, 0, -1e-3, 18.5), (18.4, 77.1), 5e3),
    "planetocentric, Mars": (MARS_AREOCENTRIC, (1e-3, 0, 77, 0, -1e-3, 18.5), (18.6, 77.1), 2e3),
    "longitudes to the west": (
        "IAU_2015:49901", (1e-3, 0, 283, 0, -1e-3, 18.5), (18.4, 76.9), 2e3,
    ),
    "equidistant cylindrical": (
        "+proj=eqc +lat_ts=15 +lon_0=70 +x_0=100 +y_0=5 +R=3396190",
        (50, 0, 4e5, 0, -50, 1.1e6), (18.5, 77.05), 3e3,
    ),
    "polar stereographic": (
        "IAU_2015:30135", (20, 0, -2000, 0, -20, 15000), (-89.57, 0.0), 2e3,
    ),
    "UTM": ("EPSG:32633", (1, 0, 5e5, 0, -1, 5.4e6), (48.7520, 15.00136), 60.0),
    "US survey feet": ("EPSG:2263", (3, 0, 985500, 0, -3, 200000), (40.7148, -73.9943), 60.0),
}  # fmt: skip


@pytest.mark.parametrize("name", LIES)
def test_a_window_holds_the_heights_of_its_places(tmp_path, name):
    """Heights are linear in column and row, which bicubic interpolation keeps."""
    crs, terms, center, size = LIES[name]
    j, i = np.mgrid[:200, :200] + 0.5
    path = write(tmp_path / "a.tif", 2.0 * i - 0.7 * j, crs, rasterio.Affine(*terms))
    window = DemWindow((size, size), latitude_deg=center[0], longitude_deg=center[1])
    grid = Grid.with_spacing((0.8 * size, 0.7 * size), size / 20.0)
    dem = Dem(file=path, window=window, unit_m=1.0)
    height, report = dem.apply(grid, np.zeros(grid.shape))
    place = Georeference(**report["georeference"]["on_body"])
    assert place.latitude_deg == pytest.approx(center[0], abs=1e-7)
    assert np.cos(np.radians(place.longitude_deg - center[1])) == pytest.approx(1.0, abs=1e-15)
    x, y = (part.ravel() for part in np.meshgrid(grid.x(), grid.y()))
    projection, (a, b, c, d, e, f) = place.plane()
    # PROJ gives places with western longitudes as (latitude, longitude).
    west = crs == "IAU_2015:49901"
    there = np.array(
        warp.transform(
            projection, MARS if west else crs,
            (a * x + b * y + c).tolist(), (d * x + e * y + f).tolist(),
        )
    )  # fmt: skip
    column, row = ~rasterio.Affine(*terms) @ (there * [[-1.0], [1.0]] if west else there)
    column = np.where(column < 0.0, column + 360_000.0, column) % 360_000.0
    off = np.abs(height.ravel() - (2.0 * column - 0.7 * row))
    assert off.max() < 1e-4
    assert report["read"]["pixels"][0] < 200 or name in ("no squares", "polar stereographic")
    # Where latitude and longitude come from the record alone.
    latitude, longitude = place.latitude_longitude(x, y)
    back = warp.transform(MARS if west else crs, f"+proj=longlat +a={place.semi_major_m} "
                          f"+b={place.semi_minor_m}", *map(list, there))  # fmt: skip
    turn = (np.array(back[0]) - longitude + 180.0) % 360.0 - 180.0
    east = np.radians(turn) * np.cos(np.radians(latitude)) * place.semi_major_m
    north = np.radians(np.array(back[1]) - latitude) * place.semi_major_m
    assert np.hypot(east, north).max() <= 1.5 * place.error_m + 1e-4


def test_a_window_is_the_file_cut_to_it(tmp_path):
    heights = np.random.default_rng(1).normal(size=(200, 300)).cumsum(axis=0)
    place = rasterio.Affine(2, 0, 5e5, 0, -2, 5.4e6)
    whole = write(tmp_path / "whole.tif", heights, "EPSG:32633", place)
    cut = write(
        tmp_path / "cut.tif", heights[40:140, 60:160], "EPSG:32633",
        place @ rasterio.Affine.translation(60, 40),
    )  # fmt: skip
    grid = Grid.with_spacing((150.0, 100.0), 1.0)
    expected, there = Dem(file=cut).apply(grid, np.zeros(grid.shape))
    window = DemWindow((200.0, 200.0), x_m=5e5 + 220.0, y_m=5.4e6 - 180.0)
    height, report = Dem(file=whole, window=window).apply(grid, np.zeros(grid.shape))
    assert np.abs(height - expected).max() < 1e-9
    assert report["georeference"] == there["georeference"]
    assert report["read"] == {"pixels": [106, 106], "of": [300, 200], "overview": 1}
    # Another place in the window; and one that does not fit.
    moved, _ = Dem(file=whole, window=window, center=(0.55, 0.4)).apply(grid, np.zeros(grid.shape))
    expected, _ = Dem(file=cut, center=(0.55, 0.4)).apply(grid, np.zeros(grid.shape))
    assert np.abs(moved - expected).max() < 1e-9
    with pytest.raises(SceneError, match=r"reaches over the window \(200 x 200 m\)"):
        Dem(file=whole, window=window, center=(0.9, 0.5)).apply(grid, np.zeros(grid.shape))


def moon(latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    """Heights by the place in space, to which poles and date lines are nothing."""
    x = np.cos(np.radians(latitude)) * np.cos(np.radians(longitude))
    y = np.cos(np.radians(latitude)) * np.sin(np.radians(longitude))
    return 1000.0 * (x + 2.0 * y + 0.5 * np.sin(np.radians(latitude)))


@pytest.mark.parametrize("first", [-180.0, 0.0])
@pytest.mark.parametrize(
    ("latitude", "longitude"), [(90, 0), (-90, 77), (-89.97, 30), (5, 180), (5, 0), (40, -100)]
)
def test_a_global_file_has_no_seam_and_no_poles(tmp_path, first, latitude, longitude):
    place = rasterio.Affine(0.25, 0, first, 0, -0.25, 90)
    j, i = np.mgrid[:720, :1440] + 0.5
    path = write(tmp_path / "a.tif", moon(90 - 0.25 * j, first + 0.25 * i), MOON, place)
    window = DemWindow((3e4, 3e4), latitude_deg=latitude, longitude_deg=longitude)
    grid = Grid.with_spacing((2e4, 2e4), 1e3)
    height, report = Dem(file=path, window=window).apply(grid, np.zeros(grid.shape))
    x, y = (part.ravel() for part in np.meshgrid(grid.x(), grid.y()))
    place = Georeference(**report["georeference"]["on_body"])
    assert place.latitude_deg == pytest.approx(latitude, abs=1e-12)
    assert np.cos(np.radians(place.longitude_deg - longitude)) == pytest.approx(1.0, abs=1e-15)
    there = warp.transform(place.plane()[0], "+proj=longlat +R=1737400", x.tolist(), y.tolist())
    truth = moon(np.array(there[1]), np.array(there[0]))
    # 8 km pixels of a hill that is a body wide; near poles rows are rings.
    assert np.abs(height.ravel() - truth).max() < 2e-3


@pytest.mark.parametrize(
    ("samples", "place", "size"),
    [
        (np.full((1, 1), 7.0), rasterio.Affine(1, 0, 0, 0, -1, 1), 1.0),
        (np.full((3, 3), 7.0), rasterio.Affine(1, 0, 0, 0, -1, 3), 1e-3),
        (np.full((4, 2), 7.0), rasterio.Affine(180, 0, -180, 0, -45, 90), 10.0),
    ],
    ids=["one pixel", "a thousandth of one", "two columns around"],
)
def test_windows_of_hardly_anything(tmp_path, samples, place, size):
    angles = place.a > 100
    path = write(tmp_path / "a.tif", samples, MOON if angles else "EPSG:32633", place)
    at = {"latitude_deg": -89.9, "longitude_deg": 3} if angles else {"x_m": 0.5, "y_m": 0.5}
    window = DemWindow((size, size), **at)
    grid = Grid.with_spacing((size, size), size)
    height, _ = Dem(file=path, window=window).apply(grid, np.zeros(grid.shape))
    assert (height == 7.0).all()


@pytest.mark.parametrize(
    ("crs", "at", "words"),
    [
        (MOON, {"x_m": 10.0, "y_m": 49.0}, "give the window's latitude_deg and longitude_deg"),
        (MOON, {"latitude_deg": 20.0, "longitude_deg": 10.0}, "the window lies outside of it"),
        (None, {"latitude_deg": 20.0, "longitude_deg": 10.0}, "give the window's x_m and y_m"),
        (None, {"x_m": 10.0, "y_m": 49.0}, "does not say its pixels' size"),
        ("EPSG:32633", {"x_m": 1e9, "y_m": 0.0}, "the window lies outside of it"),
        ("EPSG:32633", {"latitude_deg": 95.0, "longitude_deg": 10.0}, "a.tif: "),
    ],
)
def test_a_window_that_is_nowhere_is_refused(tmp_path, crs, at, words):
    path = write(tmp_path / "a.tif", RAMP, crs, PLACE)
    grid = Grid.with_spacing((10.0, 10.0), 1.0)
    with pytest.raises(SceneError) as caught:
        Dem(file=path, window=DemWindow((100.0, 100.0), **at)).apply(grid, np.zeros(grid.shape))
    assert words in str(caught.value)


# What is read, and what is refused.


def sparse(path: Path, side: int, window: Any, **options: Any) -> Path:
    """A file of zeros that take no room, with numbers in a window."""
    with rasterio.open(
        path, "w", driver="GTiff", height=side, width=side, count=1, dtype="float32",
        crs="EPSG:32633", transform=rasterio.Affine(1, 0, 4e5, 0, -1, 5.4e6), sparse_ok=True,
        compress="deflate", BIGTIFF="YES", **options,
    ) as file:  # fmt: skip
        j, i = np.mgrid[:1024, :1024]
        file.write((100 + i % 64 + j % 32).astype(np.float32), 1, window=window)
    return path


PEAK = """
import resource, sys
import numpy as np
from pathlib import Path
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.sources.dem import Dem, DemWindow
grid = Grid.with_spacing((800.0, 800.0), 1.0)
window = DemWindow((1000.0, 1000.0), x_m=4e5 + float(sys.argv[2]), y_m=5.4e6 - float(sys.argv[2]))
height, _ = Dem(file=Path(sys.argv[1]), window=window).apply(grid, np.zeros(grid.shape))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, height.sum().hex())
"""


@pytest.mark.parametrize("tiled", [{"tiled": True, "blockxsize": 512, "blockysize": 512}, {}])
def test_a_window_of_60_000_pixels_squared_takes_the_memory_of_its_own_file(tmp_path, tiled):
    at = rasterio.windows.Window(30_000 - 512, 30_000 - 512, 1024, 1024)
    huge = sparse(tmp_path / "huge.tif", 60_000, at, **tiled)
    small = sparse(tmp_path / "small.tif", 1024, rasterio.windows.Window(0, 0, 1024, 1024))
    peaks, sums, said = [], [], []
    for path, center in ((huge, 30_000), (small, 512)):
        done = subprocess.run(
            [sys.executable, "-c", PEAK, path, str(center)],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        peak, total = done.stdout.split()
        peaks.append(float(peak))
        sums.append(total)
        said.append(done.stderr)
    assert sums[0] == sums[1]
    assert peaks[0] <= peaks[1] + 200.0
    assert "huge.tif: reads 1,006 x 1,006 of 60,000 x 60,000 pixels (3.9 MiB)" in said[0]


@pytest.mark.parametrize(("spacing", "overview"), [(1.0, 1), (3.9, 2), (4.0, 4), (50.0, 8)])
def test_overviews_are_read_where_the_terrain_is_no_finer(tmp_path, spacing, overview):
    j, i = np.mgrid[:256, :256] + 0.5
    path = write(
        tmp_path / "a.tif", 2.0 * i - j, "EPSG:32633", rasterio.Affine(1, 0, 5e5, 0, -1, 5.4e6),
        tiled=True, blockxsize=64, blockysize=64,
    )  # fmt: skip
    with rasterio.open(path, "r+") as file:
        file.build_overviews([2, 4, 8], rasterio.enums.Resampling.average)
    window = DemWindow((200.0, 200.0), x_m=5e5 + 128.0, y_m=5.4e6 - 128.0)
    grid = Grid.with_spacing((160.0, 160.0), spacing)
    height, report = Dem(file=path, window=window).apply(grid, np.zeros(grid.shape))
    assert report["read"]["overview"] == overview
    assert report["read"]["pixels"][0] == -(-200 // overview) + 6 + (200 // overview % 2)
    # Means of a plane are the plane.
    x, y = np.meshgrid(grid.x(), grid.y())
    assert np.abs(height - (2.0 * (x + 128.0) - (128.0 - y))).max() < 1e-9


def faults(folder: Path, **keys: Any) -> list[str]:
    """What a cfg is refused for, whose terrain is such a DEM."""
    cfg = small_cfg()
    cfg["terrain"]["relief"][0] = {"type": "dem", "file": "a.tif", "edge": "clamp", **keys}
    try:
        load(write_cfg(folder, cfg))
    except CfgError as error:
        return [f"{fault.pointer}: {fault.message}" for fault in error.faults]
    return []


AT = {"latitude_deg": 49.4, "longitude_deg": 10.8, "size_m": [100, 100]}


@pytest.mark.parametrize(
    ("crs", "highest", "body"),
    [(MOON, 1.6e4, "Moon"), ("EPSG:4326", -1.6e4, "Earth"), (MARS, 3.1e4, "Mars")],
)
def test_heights_that_a_body_does_not_have_are_a_fault_with_value_and_share(
    tmp_path, crs, highest, body
):
    # A slope up to there: no mark, and no height.
    write(tmp_path / "a.tif", np.linspace(0.0, highest, 192).reshape(12, 16), crs, PLACE)
    (fault,) = faults(tmp_path)
    assert f"({body}) does not have, as far as {highest:g} m" in fault
    share = np.mean(np.abs(np.linspace(0, highest, 192)) > (3e4 if body == "Mars" else 1.5e4))
    assert f"{100 * share:.2g} % of the samples of a.tif" in fault
    assert fault.startswith("/terrain/relief/0/file") or fault.startswith("/terrain/relief/0: ")
    assert faults(tmp_path, nodata=None) == []
    assert faults(tmp_path, unit_m=0.5) == []


def test_distances_from_the_body_s_center_are_heights(tmp_path):
    write(tmp_path / "a.tif", RAMP + 1_737_400.0, MOON, PLACE)
    assert faults(tmp_path, height_offset_m=None) == []


@pytest.mark.parametrize(
    ("window", "words"),
    [
        ({**AT, "x_m": 3}, "found latitude_deg, longitude_deg, x_m"),
        ({"size_m": [1, 1]}, "found neither"),
        ({"latitude_deg": 3, "size_m": [1, 1]}, "found latitude_deg"),
        ({**AT, "latitude_deg": -91}, "at least -90"),
        ({**AT, "size_m": [0, 1]}, "expected more than 0 m"),
        ({**AT, "longitude_deg": 12.9}, "the window lies outside of it"),
        ({**AT, "latitude": 3}, "latitude_deg"),
    ],
)
def test_a_window_that_is_none_is_a_fault_at_its_place(tmp_path, window, words):
    write(tmp_path / "a.tif", RAMP, MOON, PLACE)
    assert faults(tmp_path, window=AT) == []
    (fault,) = faults(tmp_path, window=window)
    assert fault.startswith("/terrain/relief/0")
    assert words in fault


def test_a_hole_beside_a_turned_terrain_is_no_hole_under_it(tmp_path):
    turned = rasterio.Affine.translation(5e5, 5.4e6) @ rasterio.Affine.rotation(45)
    place = turned @ rasterio.Affine.scale(1, -1)
    heights = np.tile(np.arange(40.0), (40, 1))
    # Within the box of rows and columns around the terrain, and out of its reach.
    heights[12, 12] = np.nan
    path = write(tmp_path / "a.tif", heights, "EPSG:32633", place)
    grid = Grid.with_spacing((12.0, 12.0), 1.0)
    height, report = Dem(file=path).apply(grid, np.zeros(grid.shape))
    assert "holes_filled" not in report
    assert np.isfinite(height).all()
    heights[20, 20] = np.nan
    write(path, heights, "EPSG:32633", place)
    with pytest.raises(SceneError, match="1 samples under the terrain have no data"):
        Dem(file=path).apply(grid, np.zeros(grid.shape))
    filled, report = Dem(file=path, holes="fill").apply(grid, np.zeros(grid.shape))
    assert report["holes_filled"] == 1
    # A hole in a plane becomes the plane.
    assert np.abs(filled - height).max() < 1e-9


def test_the_files_of_a_label_are_inputs(tmp_path):
    detached(tmp_path)
    cfg = small_cfg()
    window = {"latitude_deg": 49.4, "longitude_deg": 10.8, "size_m": [100, 100]}
    cfg["terrain"]["relief"][0] = {
        "type": "dem", "file": "a.lbl", "edge": "clamp", "window": window,
    }  # fmt: skip
    path = write_cfg(tmp_path, cfg)
    before = load(path).digest
    pixels = (tmp_path / "A.IMG").read_bytes()
    (tmp_path / "A.IMG").write_bytes(pixels[4:] + pixels[:4])
    assert load(path).digest != before
