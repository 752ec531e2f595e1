"""Pictures of heights as relief of the ground."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from scenec.backends.stage.scene import Cells as ShownCells
from scenec.backends.stage.scene import Maps
from scenec.backends.surface.pictures import Point, values_at
from scenec.compiler.build import build_to
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.materials.displacement import Displacement, displacement_of, octaves_of
from scenec.compiler.materials.finer import finer_normals
from scenec.compiler.materials.grounds import Gravel
from scenec.compiler.materials.heights import gray, surface_relief
from scenec.compiler.materials.plan import MapSources, MaterialPlan
from scenec.compiler.materials.values import normal_picture, normals, unit
from scenec.compiler.mesh.build import build_surface
from scenec.compiler.scene.material import Material, MaterialMaps, TilingCells
from scenec.schemas.errors import CfgError
from scenec.schemas.exr import write_rgb
from scenec.testing.small import small_cfg, write_cfg


def plan(maps: MaterialMaps, **made) -> MaterialPlan:
    return MaterialPlan(Material((1.0, 1.0, 1.0), 0.5, 0.0, 0.0, maps=maps), **made)


def picture(folder: Path, codes: np.ndarray, size_m: float, high_m: float, **more) -> Displacement:
    file = folder / "heights.png"
    Image.fromarray(codes).save(file)
    sources = MapSources(heights=file, heights_m=high_m)
    made = displacement_of(plan(MaterialMaps(size_m, {}, "opengl", **more), sources=sources))
    assert made is not None
    return made


def middles(shape: tuple[int, int], size_m: float) -> tuple[np.ndarray, np.ndarray]:
    """World x and y of texels' centers: row 0 is the north."""
    x = (np.arange(shape[1]) + 0.5) / shape[1] * size_m
    y = (1.0 - (np.arange(shape[0]) + 0.5) / shape[0]) * size_m
    grid = np.meshgrid(x, y)
    return grid[0].ravel(), grid[1].ravel()


@pytest.mark.parametrize("shape", [(8, 8), (6, 14), (1, 5)])
@pytest.mark.parametrize("bits", [8, 16])
def test_heights_at_texels_are_the_picture_s_about_their_mean(tmp_path, shape, bits):
    largest = 2**bits - 1
    codes = np.random.default_rng(bits).integers(0, largest, shape)
    made = picture(tmp_path, codes.astype(np.uint8 if bits == 8 else np.uint16), 3.0, 0.2)
    expected = 0.2 * (codes / largest - (codes / largest).mean())
    x, y = middles(shape, 3.0)
    np.testing.assert_allclose(made.at(x, y), expected.ravel(), atol=1e-7)
    # It repeats, on both sides of the origin.
    np.testing.assert_allclose(made.at(x - 6.0, y + 3.0), expected.ravel(), atol=1e-7)


def test_heights_between_texels_follow_a_wave_with_its_slope(tmp_path):
    at = (np.arange(64) + 0.5) / 64
    codes = np.round(32767.5 * (1.0 + np.cos(2.0 * np.pi * 2.0 * at)))
    made = picture(tmp_path, np.tile(codes, (4, 1)).astype(np.uint16), 1.0, 0.1)
    x = np.linspace(-1.0, 1.0, 4001)
    y = np.full(len(x), 0.3)
    height = made.at(x, y)
    exact = 0.05 * np.cos(2.0 * np.pi * 2.0 * x)
    # Catmull-Rom's error is that of its slopes: (2 pi k / n)**3 / 36 or so of the amplitude.
    np.testing.assert_allclose(height, exact, atol=0.05 * 5e-4)
    slope = np.diff(height) / np.diff(x)
    assert np.abs(np.diff(slope)).max() < 0.02


def test_cells_lay_heights_where_renderers_lay_the_picture(tmp_path):
    codes = np.random.default_rng(3).integers(90, 160, (16, 16)).astype(np.uint8)
    made = picture(tmp_path, codes, 2.0, 1.0, cells=TilingCells(1.5, 12345))
    maps = Maps(2.0, height=tmp_path / "heights.png", cells=ShownCells(1.5, 12345))
    rng = np.random.default_rng(4)
    xy = rng.uniform(-80, 80, (4000, 2))
    expected = (
        values_at(maps, ("height",), Point(np.stack([*xy.T, 0.0 * xy[:, 0]])))["height"]
        - (codes / 255.0).mean()
    )
    found = made.at(np.ascontiguousarray(xy[:, 0]), np.ascontiguousarray(xy[:, 1]))
    # One is cubic between texels, the other one linear: the same picture, turned alike.
    assert np.corrcoef(found, expected)[0, 1] > 0.97
    smooth = np.full((16, 16), 128, np.uint8)
    smooth[:, 8:] = 130
    flat = picture(tmp_path, smooth, 2.0, 1.0, cells=TilingCells(1.5, 7))
    assert np.abs(flat.at(xy[:, 0].copy(), xy[:, 1].copy())).max() < 0.02


def test_octaves_add_up_to_the_variance_and_stand_at_their_wavelengths():
    rng = np.random.default_rng(0)
    plane = rng.normal(0.0, 0.01, (64, 64)).astype(np.float32)
    plane -= plane.mean()
    found = octaves_of(plane, 4.0)
    np.testing.assert_allclose(found.wavelength_m, 4.0 / 64 * 2.0 ** np.arange(1, 7))
    rms = 0.3 * np.sqrt((found.amplitude_m**2).sum())
    assert rms == pytest.approx(plane.std(), rel=1e-5)
    # White noise has three quarters of its variance between texels that are neighbors.
    assert (0.3 * found.amplitude_m[0]) ** 2 == pytest.approx(0.75 * plane.var(), rel=0.05)
    x = np.arange(64) + 0.5
    # Of a phase whose share in boxes is that of all phases on average.
    wave = np.tile(np.cos(2.0 * np.pi * x / 16.0 + np.pi / 4), (64, 1)).astype(np.float32)
    octaves = octaves_of(wave, 64.0)
    # Of a wave of 16 texels boxes of 4 and 8 take most: 1, sinc**2(1 / 4), 0 are left of it.
    square = (0.3 * octaves.amplitude_m) ** 2 / wave.var()
    np.testing.assert_allclose(
        square[2:4], [np.sinc(0.25) ** 2 - np.sinc(0.5) ** 2, np.sinc(0.5) ** 2], rtol=0.05
    )


def test_normals_beside_a_mesh_lose_waves_that_are_higher_than_its_tolerance():
    x = (np.arange(128) + 0.5) / 128
    # Of heights 0.3 / (4 pi) m and 0.1 / (64 pi) m: 24 and 0.5 mm.
    long, short = 0.3 * np.cos(2 * np.pi * 2 * x), 0.1 * np.cos(2 * np.pi * 32 * x)
    slope = np.tile(long + short, (128, 1))
    vectors = unit(np.stack([slope, 0 * slope, np.ones_like(slope)], axis=-1))
    waves = np.exp(-2j * np.pi * np.outer([2, 32], x))

    def left(pixels_per_m: float, finest_m: float = 1e-4) -> list[float]:
        made, facts = finer_normals(normal_picture(vectors), 1.0, pixels_per_m, 0.5, finest_m)
        kept = normals(made)
        assert facts["slope_rms"] == pytest.approx(np.sqrt((0.09 + 0.01) / 2), rel=0.02)
        along = (kept[..., 0] / kept[..., 2])[0]
        assert facts["slope_rms_kept"] == pytest.approx(along.std(), abs=0.003)
        return (2 * np.abs(waves @ along) / 128).tolist()

    # Half a pixel is 1.25 mm, 0.05 mm, and 1 m; octaves overlap, and some of the long one stays.
    assert left(400.0) == pytest.approx([0.0, 0.1], abs=0.045)
    assert left(10000.0) == pytest.approx([0.0, 0.0], abs=0.01)
    assert left(0.5) == pytest.approx([0.3, 0.1], abs=0.01)
    # Legs of 32 mm make no waves of 31.
    assert left(10000.0, 0.032) == pytest.approx([0.0, 0.1], abs=0.045)


def test_normals_stay_where_relief_is_low_and_go_where_it_is_high():
    rng = np.random.default_rng(2)
    slope = rng.normal(0.0, 0.1, (128, 128, 2)).astype(np.float32)
    slope[:, 64:] *= 0.02
    vectors = unit(np.concatenate([slope, np.ones((128, 128, 1), np.float32)], axis=-1))
    # Neighbors' slopes of 0.1 are heights of 0.1 * 2 / 128 / (2 pi) m = 0.25 mm or so.
    made, _ = finer_normals(normal_picture(vectors), 1.0, 4000.0, 0.5, 1e-4)
    kept = normals(made)[..., :2]
    assert kept[8:-8, 8:56].std() < 0.25 * slope[:, :64].std()
    assert kept[8:-8, 72:120].std() > 0.8 * slope[:, 64:].std()


def test_procedural_relief_has_the_root_mean_square_asked_for():
    made = Gravel(key=3, grain_m=0.05, relief_m=0.004, resolution=64, displacement=True)
    plane = surface_relief(made, 1.5)
    assert plane.std() == pytest.approx(0.004, rel=1e-4)
    assert abs(plane.mean()) < 1e-8
    flat = Gravel(key=3, grain_m=0.05, relief_m=0.004, resolution=64)
    assert displacement_of(plan(MaterialMaps(1.5, {}, "opengl"), procedural=flat)) is None


def test_the_ground_is_displaced_by_its_layers_weights(tmp_path):
    cfg = small_cfg()
    kind = {"type": "gravel", "displacement": True, "resolution": 64, "relief_m": 0.01}
    cfg["materials"]["gravel"]["maps"] = {"procedural": kind}
    plan = draw(load(write_cfg(tmp_path, cfg)), 1, 0)
    surface = build_to(build_surface, plan)["surface"]
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-9, 9, 60), np.linspace(-7, 7, 60)))
    lift = surface.lift_at(x, y)
    relief = plan.terrain.displacements[1].at(x, y)
    alphas = [merge.weight_of_side(merge.side(x, y)) for merge in surface.merges]
    share = alphas[0] * (1.0 - alphas[1])
    plain = np.abs(lift - share * relief)
    # What is left is the smooth surface between the grid's samples, the same everywhere.
    assert np.corrcoef(lift, share * relief)[0, 1] > 0.9
    assert plain.std() < 0.5 * (share * relief).std()
    assert surface.amplitude_m() > 0.01


_PROGRAM = """
import hashlib, sys
import numpy as np
from pathlib import Path
from scenec.compiler.scene.material import Material, MaterialMaps, TilingCells
from scenec.compiler.materials.displacement import displacement_of
from scenec.compiler.materials.plan import MapSources, MaterialPlan
from scenec.compiler.mesh.build import build_surface
from scenec.compiler.materials.grounds import MudCracks
digest = hashlib.sha256()
x = np.linspace(-30.0, 40.0, 20001)
for cells in (None, TilingCells(0.7, 99)):
    maps = MaterialMaps(1.3, {}, "opengl", cells=cells)
    material = Material((1.0, 1.0, 1.0), 0.5, 0.0, 0.0, maps=maps)
    for drawn in (
        MaterialPlan(material, sources=MapSources(heights=Path(sys.argv[1]), heights_m=0.1)),
        MaterialPlan(
            material, MudCracks(key=3, grain_m=0.1, resolution=64, displacement=True, gape=0.1)
        ),
    ):
        made = displacement_of(drawn)
        digest.update(made.at(x, x[::-1].copy()).tobytes())
        digest.update(made.spectrum().amplitude_m.tobytes())
print(digest.hexdigest())
"""


@pytest.mark.slow
def test_heights_are_the_same_bits_for_any_number_of_threads_and_without_fma(tmp_path):
    picture(
        tmp_path, np.random.default_rng(1).integers(0, 255, (33, 20)).astype(np.uint8), 1.0, 0.1
    )
    found = set()
    for change in (
        {"NUMBA_NUM_THREADS": "1"},
        {"NUMBA_NUM_THREADS": "2"},
        {"NUMBA_CPU_NAME": "generic", "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F"},
    ):
        run = subprocess.run(
            [sys.executable, "-c", _PROGRAM, str(tmp_path / "heights.png")],
            env={**os.environ, **change},
            capture_output=True,
            text=True,
            check=True,
        )
        found.add(run.stdout)
    assert len(found) == 1


def heights_refused(folder: Path, name: str) -> str:
    cfg = small_cfg()
    cfg["materials"]["sand"]["maps"] = {
        "size_m": 1, "displacement": name, "displacement_m": 0.1,
    }  # fmt: skip
    with pytest.raises(CfgError) as caught:
        load(write_cfg(folder, cfg))
    (fault,) = caught.value.faults
    assert fault.pointer == "/materials/sand/maps/displacement"
    return fault.message


def test_heights_beyond_black_and_white_are_refused_and_not_cut_off(tmp_path):
    heights = np.linspace(-0.05, 0.4, 64, dtype=np.float32).reshape(8, 8)
    write_rgb(tmp_path / "a.exr", np.repeat(heights[..., None], 3, axis=2))
    assert "from -0.05 to 0.4" in heights_refused(tmp_path, "a.exr")
    raised = heights + np.float32(0.05)
    write_rgb(tmp_path / "b.exr", np.repeat(raised[..., None], 3, axis=2))
    cfg = small_cfg()
    cfg["materials"]["sand"]["maps"] = {"size_m": 1, "displacement": "b.exr", "displacement_m": 1}
    load(write_cfg(tmp_path, cfg))
    assert np.allclose(gray(tmp_path / "b.exr"), raised)


@pytest.mark.parametrize("name", ["color.png", "color.tif", "gray.png"])
def test_heights_keep_their_16_bits_in_color_too(tmp_path, name):
    codes = np.arange(64, dtype=np.uint16).reshape(8, 8) * 1000
    cv2.imwrite(str(tmp_path / name), codes if "gray" in name else cv2.merge([codes] * 3))
    assert np.array_equal(gray(tmp_path / name), (codes / 65535.0).astype(np.float32))
