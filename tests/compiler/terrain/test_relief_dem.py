"""DEMs: GeoTIFF and pictures, holes, places on a planet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
from PIL import Image

from scenec.compiler.assets.dem_file import read_dem
from scenec.compiler.cfg.load import load
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.program import run
from scenec.compiler.terrain.sources.dem import Dem
from scenec.compiler.terrain.sources.fill_holes import fill_holes
from scenec.schemas.errors import CfgError, SceneError
from scenec.testing.small import small_cfg, write_cfg

rasterio = pytest.importorskip("rasterio")

DEM = Dem(file=Path(), pixel_m=(1.0, 1.0), edge="clamp")
GRID = Grid.with_spacing((20.0, 16.0), 0.5)


def apply(operator: Dem, grid: Grid = GRID) -> np.ndarray:
    return operator.apply(grid, np.zeros(grid.shape))[0]


def write_geotiff(
    path: Path,
    samples: np.ndarray,
    *,
    crs: str | None = "EPSG:32617",
    origin: tuple[float, float] = (500.0, 700.0),
    pixel: float = 1.0,
    scale: float = 1.0,
    offset: float = 0.0,
    **options,
) -> Path:
    transform = rasterio.transform.from_origin(*origin, pixel, pixel)
    with rasterio.open(
        path, "w", driver="GTiff", width=samples.shape[1], height=samples.shape[0], count=1,
        dtype=samples.dtype, crs=crs, transform=transform, **options,
    ) as file:  # fmt: skip
        file.write(samples, 1)
        file.scales, file.offsets = (scale,), (offset,)
    return path


def field(seed: int = 0, shape: tuple[int, int] = (40, 50)) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    rng = np.random.default_rng(seed)
    return 20 * np.sin(0.2 * x + seed) * np.cos(0.15 * y) + rng.normal(size=shape)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "int32", "float32", "float64"])
def test_a_geotiff_s_scale_offset_and_nodata_hold_for_every_kind_of_number(tmp_path, dtype):
    samples = (field() + 40).astype(dtype)
    samples[0, 0] = 99
    path = write_geotiff(tmp_path / "a.tif", samples, scale=0.25, offset=-3.0, nodata=99)
    dem = read_dem(path)
    assert np.array_equal(dem.holes, samples == 99)
    assert np.allclose(dem.values[~dem.holes], samples[~dem.holes] * 0.25 - 3.0, rtol=0, atol=1e-12)


def test_the_pixel_of_a_geotiff_in_meters_is_the_default(tmp_path):
    for origin in ((3.0, 5.0), (1e7, 1e7)):
        path = write_geotiff(tmp_path / "a.tif", field(), pixel=0.7, origin=origin)
        given = apply(replace(DEM, file=path, pixel_m=(0.7, 0.7)))
        assert np.array_equal(apply(replace(DEM, file=path, pixel_m=None)), given)
    degrees = write_geotiff(tmp_path / "b.tif", field(), crs="EPSG:4326", pixel=1e-3)
    with pytest.raises(SceneError, match="give pixel_m"):
        apply(replace(DEM, file=degrees, pixel_m=None))
    assert apply(replace(DEM, file=degrees)).shape == GRID.shape


@pytest.mark.parametrize(("bits", "kind"), [(8, "png"), (16, "png"), (8, "bmp"), (8, "jpg")])
def test_a_gray_picture_holds_heights_between_those_of_black_and_white(tmp_path, bits, kind):
    samples = np.clip(0.5 + field() / 60.0, 0.0, 1.0)
    top = 2**bits - 1
    pixels = np.round(samples * top).astype(f"uint{bits}")
    Image.fromarray(pixels).save(
        tmp_path / f"a.{kind}", **({"quality": 100} if kind == "jpg" else {})
    )
    dem = read_dem(tmp_path / f"a.{kind}", height_range_m=(-5.0, 15.0))
    lossy = 3.0 / top if kind == "jpg" else 0.0
    assert np.allclose(dem.values, -5.0 + 20.0 * pixels / top, rtol=0, atol=1e-12 + 20 * lossy)
    assert not dem.holes.any()
    if bits == 16:
        assert len(np.unique(dem.values)) > 500


def test_gray_is_gray_however_a_picture_stores_it(tmp_path):
    pixels = np.arange(48, dtype=np.uint8).reshape(6, 8)
    gray = Image.fromarray(pixels)
    for i, mode in enumerate(("L", "LA", "RGB", "RGBA")):
        gray.convert(mode).save(tmp_path / f"{i}.png")
        values = read_dem(tmp_path / f"{i}.png", height_range_m=(0.0, 255.0)).values
        assert np.array_equal(values, pixels)
    holes = read_dem(tmp_path / "0.png", nodata=7.0, height_range_m=(0.0, 255.0)).holes
    assert holes.sum() == 1
    colors = np.zeros((6, 8, 3), np.uint8)
    colors[..., 1] = pixels
    Image.fromarray(colors).save(tmp_path / "c.png")
    with pytest.raises(SceneError, match="gray"):
        read_dem(tmp_path / "c.png", height_range_m=(0.0, 1.0))
    with pytest.raises(SceneError, match="height_range_m"):
        read_dem(tmp_path / "0.png")
    np.save(tmp_path / "a.npy", pixels)
    with pytest.raises(SceneError, match="height_scale"):
        read_dem(tmp_path / "a.npy", height_range_m=(0.0, 1.0))
    (tmp_path / "b.png").write_bytes(b"no picture")
    with pytest.raises(SceneError, match=r"b\.png"):
        read_dem(tmp_path / "b.png", height_range_m=(0.0, 1.0))


# Holes.


def disk(shape: tuple[int, int], radius: float) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(y - shape[0] / 2.2, x - shape[1] / 2) < radius


def solved(values: np.ndarray, holes: np.ndarray) -> np.ndarray:
    """The exact solution of the same equations, by a direct solver."""
    ny, nx = holes.shape
    index = np.full(holes.shape, -1)
    index[holes] = np.arange(holes.sum())
    matrix, right = scipy.sparse.lil_matrix((holes.sum(),) * 2), np.zeros(holes.sum())
    for j, i in np.argwhere(holes):
        for b, a in ((j - 1, i), (j + 1, i), (j, i - 1), (j, i + 1)):
            if 0 <= b < ny and 0 <= a < nx:
                matrix[index[j, i], index[j, i]] += 1.0
                if holes[b, a]:
                    matrix[index[j, i], index[b, a]] -= 1.0
                else:
                    right[index[j, i]] += values[b, a]
    out = values.copy()
    out[holes] = scipy.sparse.linalg.spsolve(matrix.tocsr(), right)
    return out


def test_a_filled_hole_in_a_plane_is_the_plane():
    y, x = np.mgrid[:90, :120].astype(float)
    plane = 3.0 * x - 2.0 * y + 7.0
    holes = disk(plane.shape, 30.0) | (np.random.default_rng(0).random(plane.shape) < 0.2)
    holes[[0, -1]] = holes[:, [0, -1]] = False
    filled, error = fill_holes(np.where(holes, 0.0, plane), holes)
    assert np.array_equal(filled[~holes], plane[~holes])
    assert np.abs(filled - plane).max() < 1e-8
    assert error < 1e-5


@pytest.mark.parametrize("holes", ["half", "disk", "most"])
def test_a_filled_hole_errs_about_as_is_said(holes):
    y, x = np.mgrid[:150, :160].astype(float)
    hills = 30.0 * np.sin(x / 20.0) + 20.0 * np.cos(y / 13.0)
    most = np.random.default_rng(2).random(hills.shape) < 0.9999
    mask = {"half": x > 80.0, "disk": disk(hills.shape, 60.0), "most": most}[holes]
    filled, error = fill_holes(np.where(mask, 0.0, hills), mask)
    truth = solved(hills, mask)
    assert np.abs(filled - truth).max() <= max(2.0 * error, 1e-7)
    assert error < 0.01 * np.ptp(hills)


def test_a_filled_hole_solves_laplace_s_equation():
    values, holes = field(1, (24, 30)), disk((24, 30), 7.0)
    holes[0, 3:6] = True
    filled, _ = fill_holes(values, holes)
    assert np.allclose(filled, solved(values, holes), rtol=0, atol=1e-8)
    # Between the heights at the rim, since solutions have no extrema inside.
    assert (
        values[~holes].min() <= filled[holes].min() <= filled[holes].max() <= values[~holes].max()
    )


@pytest.mark.parametrize("keep", [1, 5])
def test_almost_all_can_be_missing(keep):
    holes = np.ones((37, 53), bool)
    holes.ravel()[np.random.default_rng(0).choice(holes.size, keep, replace=False)] = False
    filled, _ = fill_holes(np.where(holes, 0.0, 8.0), holes)
    assert np.allclose(filled, 8.0)


def test_holes_under_the_terrain_are_filled_if_asked_and_counted(tmp_path):
    samples = field()
    samples[18:22, 20:30] = np.nan
    np.save(tmp_path / "a.npy", samples)
    broken = replace(DEM, file=tmp_path / "a.npy")
    with pytest.raises(SceneError, match=r'40 samples .* "holes": "fill"'):
        apply(broken)
    out, report = replace(broken, holes="fill").apply(GRID, np.zeros(GRID.shape))
    assert np.isfinite(out).all()
    assert report["holes_filled"] == 40
    whole = tmp_path / "whole.npy"
    np.save(whole, fill_holes(np.nan_to_num(samples), np.isnan(samples))[0])
    assert np.allclose(out, apply(replace(DEM, file=whole)), rtol=0, atol=0.01)
    # Elsewhere holes do not matter.
    aside = replace(broken, center=(0.5, 0.9))
    assert (
        "holes_filled" not in aside.apply(Grid.with_spacing((9.0, 2.0), 1.0), np.zeros((3, 10)))[1]
    )
    np.save(tmp_path / "a.npy", np.full((40, 50), np.nan))
    with pytest.raises(SceneError, match="no data"):
        apply(replace(broken, holes="fill"))


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (2, 2)])
def test_thin_dems_with_holes_are_taken(tmp_path, shape):
    samples = np.arange(float(np.prod(shape))).reshape(shape)
    if samples.size > 2:
        samples.ravel()[1] = np.nan
    np.save(tmp_path / "a.npy", samples)
    out = apply(replace(DEM, file=tmp_path / "a.npy", holes="fill"))
    assert np.isfinite(out).all()


# In a cfg.


def cfg_with(folder: Path, **keys) -> Path:
    cfg = small_cfg()
    cfg["terrain"]["relief"][0] = {"type": "dem", **keys}
    return write_cfg(folder, cfg)


@pytest.mark.parametrize(
    ("keys", "pointer", "words"),
    [
        ({"file": "a.png", "pixel_m": 1}, "/file", "height_range_m"),
        ({"file": "a.npy", "pixel_m": 1, "height_range_m": [0, 1]}, "/file", "height_scale"),
        ({"file": "a.npy", "pixel_m": 1, "holes": "fil"}, "/holes", 'did you mean "fill"?'),
    ],
)
def test_what_a_dem_lacks_is_said_where_it_is_missing(tmp_path, keys, pointer, words):
    np.save(tmp_path / "a.npy", field())
    Image.fromarray(np.zeros((40, 50), np.uint8)).save(tmp_path / "a.png")
    with pytest.raises(CfgError) as caught:
        load(cfg_with(tmp_path, **keys))
    (fault,) = caught.value.faults
    assert fault.pointer == f"/terrain/relief/0{pointer}"
    assert words in fault.message


# What files can hold.


@pytest.mark.parametrize("place", [np.nan, np.inf, 1e300])
def test_a_transform_that_is_no_place_is_refused(tmp_path, place):
    path = write_geotiff(tmp_path / "a.tif", field(), origin=(place, 0.0))
    with pytest.raises(SceneError, match=r"a\.tif: its transform"):
        read_dem(path)


@pytest.mark.parametrize("numbers", [(np.nan, 0.0), (np.inf, 0.0), (1.0, -np.inf)])
def test_a_scale_or_offset_that_is_no_number_is_refused(tmp_path, numbers):
    path = write_geotiff(tmp_path / "a.tif", field(), scale=numbers[0], offset=numbers[1])
    with pytest.raises(SceneError, match="not finite"):
        read_dem(path)


@pytest.mark.filterwarnings("error")
def test_what_a_scale_makes_overflow_is_a_hole(tmp_path):
    samples = np.array([[1.0, 1e10], [-1e10, 2.0]])
    dem = read_dem(write_geotiff(tmp_path / "a.tif", samples, scale=1e300))
    assert np.array_equal(dem.holes, [[False, True], [True, False]])
    assert np.array_equal(dem.values, [[1e300, 0.0], [0.0, 2e300]])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", ["npy", "npz", "tif", "png"])
def test_a_damaged_file_is_read_or_refused_with_one_line(tmp_path, kind):
    rng = np.random.default_rng(3)
    path = tmp_path / f"a.{kind}"
    if kind == "npy":
        np.save(path, field())
    elif kind == "npz":
        np.savez_compressed(path, a=field())
    elif kind == "tif":
        write_geotiff(path, field().astype(np.float32), compress="deflate")
    else:
        Image.fromarray((100 * (field() + 60)).astype(np.uint16)).save(path)
    whole = path.read_bytes()
    refused = 0
    for n in range(120):
        data = bytearray(whole)
        # The header is where most of the ways to be wrong are.
        end = len(data) if n % 2 else 128
        for at in rng.integers(0, end, 3):
            data[at] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(data[: rng.integers(1, len(data))]) if n % 3 == 0 else bytes(data))
        try:
            read_dem(path, height_range_m=(0.0, 1.0) if kind == "png" else None)
        except SceneError as error:
            refused += 1
            text = str(error)
            assert text.startswith(f"a.{kind}: ")
            assert "\n" not in text
            assert " at 0x" not in text
    assert refused > 30


@pytest.mark.parametrize("dtype", [bool, complex, "U3", "M8[s]", object])
def test_samples_that_are_no_numbers_are_refused(tmp_path, dtype):
    samples = np.ones((3, 4), np.int64).astype(dtype)
    np.save(tmp_path / "a.npy", samples, allow_pickle=True)
    with pytest.raises(SceneError, match=r"a\.npy"):
        read_dem(tmp_path / "a.npy")


@pytest.mark.parametrize("shape", [(0, 4), (4, 0), (), (4,), (1, 3, 4)])
def test_samples_that_are_no_field_are_refused(tmp_path, shape):
    np.save(tmp_path / "a.npy", np.ones(shape))
    with pytest.raises(SceneError, match="two-dimensional"):
        read_dem(tmp_path / "a.npy")


@pytest.mark.filterwarnings("error")
def test_heights_that_no_renderer_can_hold_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.where(field() > 0.0, 1e19, 0.0))
    operators = (replace(DEM, file=tmp_path / "a.npy"),)
    with pytest.raises(SceneError, match=r"heights reach 1\.\d+e\+19 m"):
        run(operators, GRID)
