"""What files of heights say of themselves: units, bands, voids, directions, sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scenec.cli.main import main
from scenec.compiler.assets.dem_file import read_dem
from scenec.compiler.cfg.load import load
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.sources.dem import Dem
from scenec.schemas import memory
from scenec.schemas.errors import CfgError, SceneError
from scenec.testing.small import small_cfg, write_cfg

rasterio = pytest.importorskip("rasterio")

GRID = Grid.with_spacing((8.0, 6.0), 1.0)
UTM = "EPSG:32633"
#: 12 x 16, about 110 m, a plane that rises by 1 m a column and 10 m a row.
METERS = 50.0 + np.arange(16.0) + 10.0 * np.arange(12.0)[:, None]


def write(
    path: Path,
    bands: np.ndarray,
    *,
    crs: str | None = UTM,
    transform: Any = None,
    unit: str | None = None,
    scale: float = 1.0,
    offset: float = 0.0,
    kinds: str = "",
    **options: Any,
) -> Path:
    """A GeoTIFF of one band [h, w] or several [k, h, w], its pixels of 1 unit unless turned."""
    bands = bands if bands.ndim == 3 else bands[None]
    count, high, wide = bands.shape
    with rasterio.open(
        path, "w", driver="GTiff", height=high, width=wide, count=count, dtype=bands.dtype,
        crs=crs, transform=transform or rasterio.Affine(1, 0, 500, 0, -1, 900), **options,
    ) as file:  # fmt: skip
        file.write(bands)
        if unit is not None:
            file.units = (unit,) * count
        file.scales, file.offsets = (scale,) * count, (offset,) * count
        if kinds:
            file.colorinterp = [rasterio.enums.ColorInterp[kind] for kind in kinds.split()]
    return path


def refusal(folder: Path, **keys: Any) -> str:
    """What a cfg is refused for, whose terrain is that DEM."""
    cfg = small_cfg()
    cfg["terrain"]["relief"][0] = {"type": "dem", "edge": "clamp", **keys}
    with pytest.raises(CfgError) as caught:
        load(write_cfg(folder, cfg))
    (fault,) = caught.value.faults
    assert "\n" not in fault.message
    return fault.message


@pytest.mark.parametrize(
    ("unit", "meters"),
    [
        ("m", 1.0),
        ("Metre", 1.0),
        ("km", 1000.0),
        ("ft", 0.3048),
        ("foot", 0.3048),
        ("us-ft", 1200 / 3937),
        ("US survey foot", 1200 / 3937),
        ("cm", 0.01),
    ],
)
def test_heights_are_read_in_the_unit_of_their_band(tmp_path, unit, meters):
    dem = read_dem(write(tmp_path / "a.tif", METERS / meters, unit=unit))
    assert np.allclose(dem.values, METERS, rtol=1e-12)
    assert dem.facts["unit_m"] == pytest.approx(meters, rel=1e-15)


@pytest.mark.parametrize(
    ("crs", "meters"),
    [
        ("EPSG:32633+5703", 1.0),
        ("EPSG:32633+8228", 0.3048),
        ("EPSG:32633+6360", 1200 / 3937),
        ("EPSG:6318+6360", 1200 / 3937),
    ],
)
def test_heights_are_read_in_the_unit_of_the_vertical_axis(tmp_path, crs, meters):
    dem = read_dem(write(tmp_path / "a.tif", METERS / meters, crs=crs))
    assert np.allclose(dem.values, METERS, rtol=1e-12)


def test_a_unit_that_is_not_known_is_refused_or_given(tmp_path):
    path = write(tmp_path / "a.tif", METERS / 1.8288, unit="fathom")
    assert "'fathom'" in refusal(tmp_path, file="a.tif")
    assert np.allclose(read_dem(path, unit_m=1.8288).values, METERS, rtol=1e-12)
    np.save(tmp_path / "a.npy", METERS / 1.8288)
    assert np.allclose(read_dem(tmp_path / "a.npy", unit_m=1.8288).values, METERS, rtol=1e-12)


def test_heights_of_no_unit_over_axes_in_feet_are_not_guessed(tmp_path):
    path = write(tmp_path / "a.tif", METERS, crs="EPSG:2225")
    assert '"unit_m": 0.3048006' in refusal(tmp_path, file="a.tif")
    dem = read_dem(path, unit_m=0.3048)
    assert np.allclose(dem.values, METERS * 0.3048, rtol=1e-12)
    foot = pytest.approx(1200 / 3937, rel=1e-12)
    assert dem.frame.pixel_m() == (foot, foot)


def test_scale_offset_unit_and_band_are_applied_in_this_order_and_reported(tmp_path):
    samples = np.round((METERS / 0.3048 - 100.0) * 8.0).astype(np.int16)
    path = write(tmp_path / "a.tif", samples, unit="ft", scale=0.125, offset=100.0)
    operator = Dem(file=path)
    height, report = operator.apply(GRID, np.zeros(GRID.shape))
    # Sample (4.5, 7.5) of the file lies at the middle; a row is a meter southward.
    middle = 50.0 + 7.5 + 10.0 * 5.5
    assert height[3, 4] == pytest.approx(middle, abs=0.04)
    assert height[4, 4] - height[3, 4] == pytest.approx(-10.0, abs=0.08)
    told = {key: report[key] for key in ("band", "scale", "offset", "unit_m")}
    assert told == {"band": 1, "scale": 0.125, "offset": 100.0, "unit_m": 0.3048}


# Voids.


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("int16", -32768),
        ("int16", -32767),
        ("int16", 32767),
        ("uint16", 65535),
        ("int32", -(2**31)),
        ("int32", -9999),
        ("float32", -9999.0),
        ("float32", -99999.0),
        ("float32", -3.4028234663852886e38),
        ("float32", 1e20),
        ("float64", -1.7976931348623157e308),
    ],
)
@pytest.mark.parametrize("form", ["tif", "npy", "npz"])
def test_a_void_that_the_file_does_not_declare_is_a_fault(tmp_path, kind, value, form):
    samples = METERS.astype(kind)
    samples[5, 7:10] = value
    path = tmp_path / f"a.{form}"
    if form == "tif":
        write(path, samples)
    elif form == "npy":
        np.save(path, samples)
    else:
        np.savez(path, heights=samples)
    text = refusal(tmp_path, file=path.name, pixel_m=1)
    # 3 of 192 samples.
    shown = f"{float(np.array(value, kind)):.17g}"
    assert f"1.6 % of the samples of a.{form} are {shown}" in text
    assert f'"nodata": {shown}' in text
    dem = read_dem(path, nodata=float(shown))
    assert dem.void is None
    assert np.array_equal(dem.holes, samples == np.array(value, kind))
    cfg = small_cfg()
    cfg["terrain"]["relief"][0] = {
        "type": "dem", "edge": "clamp", "file": path.name, "pixel_m": 1, "nodata": None,
    }  # fmt: skip
    assert load(write_cfg(tmp_path, cfg)).cfg["terrain"]["relief"][0]["nodata"] is None


@pytest.mark.parametrize(
    "samples",
    [
        # The floor of an ocean, a coast, a step of two heights, declared voids alone.
        np.linspace(-11_000.0, 500.0, 192).round().reshape(12, 16),
        np.where(METERS > 100.0, -9999.0, np.linspace(-9990, -9000, 192).reshape(12, 16)),
        np.where(METERS > 100.0, 0.0, 2000.0),
        np.where(METERS > 100.0, np.nan, METERS),
        1_737_400.0 + METERS,
    ],
    ids=["ocean", "deep", "step", "declared", "radii"],
)
def test_heights_that_others_are_near_are_no_voids(tmp_path, samples):
    np.save(tmp_path / "a.npy", samples)
    assert read_dem(tmp_path / "a.npy").void is None


def with_zeros(samples: np.ndarray, count: int = 1) -> np.ndarray:
    """These, with 0 in the first ones of a row in the middle."""
    out = samples.copy()
    out[5, 7 : 7 + count] = 0
    return out


#: 192 whole heights of 105 to 115 m.
HILL = (105 + np.arange(192) % 11).reshape(12, 16).astype(np.int16)


@pytest.mark.parametrize("form", ["tif", "npy", "png"])
def test_zeros_far_from_all_heights_are_warned_of_and_taken(tmp_path, form):
    samples, path = with_zeros(HILL, 3), tmp_path / f"a.{form}"
    keys: dict[str, Any] = {"file": path.name, "pixel_m": 1}
    if form == "tif":
        write(path, samples)
    elif form == "npy":
        np.save(path, samples)
    else:
        Image.fromarray(samples.astype(np.uint8)).save(path)
        keys["height_range_m"] = [0, 255]

    def warnings(**more: Any) -> list[str]:
        cfg = small_cfg()
        cfg["terrain"]["relief"][0] = {"type": "dem", "edge": "clamp", **keys, **more}
        return [fault.message for fault in load(write_cfg(tmp_path, cfg)).warnings]

    (text,) = warnings()
    assert text.startswith(f"a.{form}: 3 samples (1.6 %) of 0")
    assert "between 105 and 115" in text
    assert '"nodata": 0' in text
    assert '"nodata": null' in text
    assert warnings(nodata=0, holes="fill") == warnings(nodata=None) == []
    (other,) = warnings(nodata=7)
    assert "make them 7 in the file" in other

    span = (0.0, 255.0) if form == "png" else None
    assert read_dem(path, height_range_m=span).facts["zeros_far_from_others"] == 3
    assert "zeros_far_from_others" not in read_dem(path, nodata=0.0, height_range_m=span).facts


def test_zeros_that_may_mark_holes_are_said_on_the_screen_and_counted_in_the_report(
    tmp_path, capsys
):
    np.save(tmp_path / "a.npy", with_zeros(HILL))
    cfg = small_cfg()
    cfg["samples"] = 1
    cfg["terrain"]["relief"] = [{"type": "dem", "edge": "clamp", "file": "a.npy", "pixel_m": 1}]
    cfg["objects"]["rocks"]["count"] = 1
    cfg["rigs"]["rover"]["allow_below"] = True
    out = tmp_path / "out"
    assert main(["compile", str(write_cfg(tmp_path, cfg)), "-o", str(out), "--no-cache"]) == 0
    assert "a.npy: 1 sample (0.52 %) of 0" in capsys.readouterr().err
    (report,) = out.glob("**/report.json")
    assert '"zeros_far_from_others": 1' in report.read_text("utf-8")


@pytest.mark.parametrize(
    "samples",
    [
        -HILL,
        HILL.astype(np.float32) + 0.25,
        # Most of it, around a turned map; all others alike.
        np.where(np.arange(192).reshape(12, 16) < 150, 0, HILL),
        np.full((12, 16), 110, np.int16),
        np.full((12, 16), 110.5),
        np.where(HILL == 107, np.nan, HILL),
    ],
    ids=["below", "floats", "most", "constant", "constant floats", "holes"],
)
def test_which_zeros_are_far_from_all_others(tmp_path, samples):
    zeros = with_zeros(samples)
    np.save(tmp_path / "a.npy", zeros)
    found = read_dem(tmp_path / "a.npy").zeros
    assert found.count == np.count_nonzero(zeros == 0)
    assert found.share == found.count / 192
    others = zeros[(zeros != 0) & ~np.isnan(zeros)]
    assert (found.low, found.high) == (others.min(), others.max())


@pytest.mark.parametrize(
    "samples",
    [
        HILL - 110,
        HILL - 106,
        HILL - 104,
        np.where(HILL > 108, HILL, 0) // 105,
        HILL * 0.01 - 1.1,
        np.where(HILL > 108, 0, 110),
        HILL * 0,
        np.full((12, 16), np.nan),
        HILL * 20 - 2000,
    ],
    ids=["coast", "bay", "island", "steps", "flats", "two levels", "zeros", "holes", "slope"],
)
def test_zeros_of_a_terrain_around_them_are_heights(tmp_path, samples):
    for zeros in (samples, with_zeros(samples)):
        np.save(tmp_path / "a.npy", zeros)
        found = read_dem(tmp_path / "a.npy")
        assert found.zeros is None
        assert found.facts == {}


def test_a_mark_of_holes_is_compared_as_the_file_can_hold_it(tmp_path):
    samples = METERS.astype(np.float32)
    samples[3, 4] = -9999.9
    holes = read_dem(write(tmp_path / "a.tif", samples), nodata=-9999.9).holes
    assert np.argwhere(holes).tolist() == [[3, 4]]


def test_transparent_pixels_of_a_picture_are_holes(tmp_path):
    pixels = np.zeros((6, 8, 2), np.uint8)
    pixels[..., 0], pixels[..., 1] = np.arange(48).reshape(6, 8), 255
    pixels[2, 5, 1] = 0
    Image.fromarray(pixels, "LA").save(tmp_path / "a.png")
    dem = read_dem(tmp_path / "a.png", height_range_m=(0.0, 255.0))
    assert np.argwhere(dem.holes).tolist() == [[2, 5]]
    assert np.array_equal(dem.values[:2], pixels[:2, :, 0])


# Bands and kinds of numbers.


def test_which_of_several_bands_is_read_is_chosen_and_never_guessed(tmp_path):
    colors = np.stack([METERS, METERS + 1.0, METERS + 2.0]).astype(np.uint8)
    path = write(tmp_path / "a.tif", colors, kinds="red green blue", photometric="RGB")
    text = refusal(tmp_path, file="a.tif")
    assert "3 bands (red, green, blue)" in text
    assert '"band"' in text
    for band in (1, 2, 3):
        dem = read_dem(path, band=band)
        assert np.array_equal(dem.values, METERS + band - 1.0)
        assert dem.facts["band"] == band
    assert "no band 4: it holds 3" in refusal(tmp_path, file="a.tif", band=4)
    np.save(tmp_path / "a.npy", METERS)
    assert "band is for GeoTIFF" in refusal(tmp_path, file="a.npy", pixel_m=1, band=1)


def test_a_band_of_alpha_marks_holes_and_is_no_second_one(tmp_path):
    alpha = np.full(METERS.shape, 255.0)
    alpha[1, 2] = 0.0
    both = np.stack([METERS, alpha]).astype(np.uint8)
    dem = read_dem(write(tmp_path / "a.tif", both, ALPHA="YES"))
    assert dem.facts["band"] == 1
    assert np.argwhere(dem.holes).tolist() == [[1, 2]]


def test_numbers_of_colors_complex_ones_and_several_rasters_are_refused(tmp_path):
    palette = write(tmp_path / "p.tif", METERS.astype(np.uint8))
    with rasterio.open(palette, "r+") as file:
        file.write_colormap(1, {i: (i, 0, 0, 255) for i in range(256)})
    assert "palette" in refusal(tmp_path, file="p.tif")
    assert np.array_equal(read_dem(palette, band=1).values, METERS)
    write(tmp_path / "c.tif", METERS.astype(np.complex64))
    assert "complex64" in refusal(tmp_path, file="c.tif")
    pages = [Image.fromarray(METERS.astype(np.uint8)) for _ in range(3)]
    pages[0].save(tmp_path / "m.tif", save_all=True, append_images=pages[1:])
    assert "holds 3 rasters" in refusal(tmp_path, file="m.tif", pixel_m=1)


def test_colors_of_16_bits_are_not_read_as_8(tmp_path):
    import cv2

    gray = (METERS * 300.0).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "rgb.png"), np.repeat(gray[..., None], 3, axis=2))
    cv2.imwrite(str(tmp_path / "gray.png"), gray)
    text = refusal(tmp_path, file="rgb.png", pixel_m=1, height_range_m=[0, 1])
    assert "16 bits a channel" in text
    dem = read_dem(tmp_path / "gray.png", height_range_m=(0.0, 65535.0))
    assert np.allclose(dem.values, gray, rtol=1e-15)


# Where it lies.


WIDE = 50.0 + np.arange(24.0) + 10.0 * np.arange(24.0)[:, None]


def plane_through(path: Path, **keys: Any) -> tuple[np.ndarray, np.ndarray]:
    """Heights of a file, and those of METERS at the grid's points by the file's transform alone.

    WIDE is a plane, which bicubic interpolation keeps: heights are 50 + column + 10 row.
    """
    height, report = Dem(file=path, **keys).apply(GRID, np.zeros(GRID.shape))
    with rasterio.open(path) as file:
        east, north = file.transform @ (12.0, 12.0)
        x, y = np.meshgrid(GRID.x(), GRID.y())
        column, row = ~file.transform @ (x + east, y + north)
        assert report.get("georeference", {"center": [east, north]})["center"] == [east, north]
    return height, 50.0 + (column - 0.5) + 10.0 * (row - 0.5)


@pytest.mark.parametrize("crs", [UTM, None])
@pytest.mark.parametrize(
    "turned",
    [
        *(rasterio.Affine.rotation(angle) @ rasterio.Affine.scale(1, -1)
          for angle in (30.0, -90.0, 180.0, 0.05)),
        rasterio.Affine(1, 0.3, 0, 0, -1, 0),
        rasterio.Affine(1, 0, 0, 0.2, -1, 0),
        rasterio.Affine(1, 0, 0, 0, 1, 0),
        rasterio.Affine(-1, 0, 0, 0, -1, 0),
    ],
    ids=["30", "-90", "180", "0.05", "sheared", "sheared up", "rows north", "columns west"],
)  # fmt: skip
def test_a_raster_lies_as_its_transform_says(tmp_path, crs, turned):
    transform = rasterio.Affine.translation(500, 900) @ turned
    path = write(tmp_path / "a.tif", WIDE, crs=crs, transform=transform)
    # Without a reference system nothing says how large its pixels are.
    sides = np.hypot(turned.a, turned.d), np.hypot(turned.b, turned.e)
    keys = {} if crs else {"pixel_m": tuple(map(float, sides))}
    if crs is None and turned == rasterio.Affine(1, 0.3, 0, 0, -1, 0):
        assert '"pixel_m" is missing' in refusal(tmp_path, file="a.tif")
    got, expected = plane_through(path, **keys)
    assert np.abs(got - expected).max() < 1e-6


def test_a_turned_hill_is_resampled_as_well_as_one_that_is_not(tmp_path):
    """A Gaussian of 2 pixels, the same from all sides: what bicubic interpolation errs."""
    errors = []
    for angle in (0.0, 30.0):
        turned = rasterio.Affine.rotation(angle) @ rasterio.Affine.scale(1, -1)
        place = rasterio.Affine.translation(500, 900) @ turned
        j, i = np.mgrid[:60, :60] + 0.5
        hill = np.exp(-((i - 30.0) ** 2 + (j - 30.0) ** 2) / 8.0)
        path = write(tmp_path / "a.tif", hill, transform=place)
        grid = Grid.with_spacing((8.0, 6.0), 0.21)
        height, _ = Dem(file=path).apply(grid, np.zeros(grid.shape))
        x, y = np.meshgrid(grid.x(), grid.y())
        errors.append(float(np.abs(height - np.exp(-(x**2 + y**2) / 8.0)).max()))
    assert errors[0] < 0.02
    assert errors[1] < 1.1 * errors[0]


def test_a_transform_without_an_area_and_a_first_row_that_is_not_there_are_refused(tmp_path):
    write(tmp_path / "a.tif", METERS, transform=rasterio.Affine(1, 1, 500, 1, 1, 900))
    assert "pixels without an area" in refusal(tmp_path, file="a.tif")
    path = write(tmp_path / "b.tif", METERS)
    with pytest.raises(SceneError, match='"first_row": "north"'):
        Dem(file=path, first_row="south").apply(GRID, np.zeros(GRID.shape))


def test_pixels_that_are_no_squares_keep_their_two_sizes(tmp_path):
    path = write(tmp_path / "a.tif", METERS, transform=rasterio.Affine(2, 0, 500, 0, -0.5, 900))
    operator = Dem(file=path)
    height, _ = operator.apply(Grid.with_spacing((8.0, 4.0), 1.0), np.zeros((5, 9)))
    assert np.allclose(np.diff(height, axis=1), 0.5)
    assert np.allclose(np.diff(height, axis=0), -20.0)


def test_points_on_the_ground_in_place_of_a_transform_are_refused(tmp_path):
    points = [
        rasterio.control.GroundControlPoint(row, column, 500.0 + row, 900.0 + column)
        for row, column in ((0, 0), (0, 16), (12, 0), (12, 16))
    ]
    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", height=12, width=16, count=1, dtype="float32",
        gcps=points, crs=UTM,
    ) as file:  # fmt: skip
        file.write(METERS.astype(np.float32), 1)
    assert "ground control points" in refusal(tmp_path, file="a.tif", pixel_m=1)


# Larger than memory.


def test_a_file_that_is_larger_than_memory_says_its_true_size(tmp_path):
    side = 400_000
    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", height=side, width=side, count=1,
        dtype="float32", crs=UTM, transform=rasterio.Affine(1, 0, 0, 0, -1, 0.5), tiled=True,
        blockxsize=4096, blockysize=4096, sparse_ok=True, compress="deflate", BIGTIFF="YES",
    ):  # fmt: skip
        pass
    with (tmp_path / "a.npy").open("wb") as stream:
        header = {"descr": "<f4", "fortran_order": False, "shape": (side, side)}
        np.lib.format.write_array_header_1_0(stream, header)
    assert memory.available() < 14 * side * side
    for name in ("a.tif", "a.npy"):
        text = refusal(tmp_path, file=name, pixel_m=1)
        assert "400,000 x 400,000 samples of float32 take 2,240.0 GB" in text
        assert "broken" not in text


def test_what_a_file_says_of_its_numbers_is_said_on_the_screen(tmp_path, capsys):
    samples = np.round((METERS / 0.3048 - 100.0) * 8.0).astype(np.int16)
    write(tmp_path / "a.tif", samples, unit="ft", scale=0.125, offset=100.0)
    cfg = small_cfg()
    cfg["samples"] = 1
    cfg["terrain"]["relief"] = [{"type": "dem", "edge": "clamp", "file": "a.tif"}]
    cfg["objects"]["rocks"]["count"] = 1
    out = tmp_path / "out"
    assert main(["compile", str(write_cfg(tmp_path, cfg)), "-o", str(out), "--no-cache"]) == 0
    line = "/terrain/relief/0 (dem): heights are (sample * 0.125 + 100) * 0.3048 m of band 1"
    assert line in capsys.readouterr().err
