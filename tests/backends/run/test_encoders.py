"""What files hold of ``rgb``: the bits of it, or half floats within their bound."""

from __future__ import annotations

import dataclasses
import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.mitsuba.variant import load_mitsuba
from scenec.schemas.exr import as_half, read_exr, write_exr
from scenec.schemas.picture import RENDERED, write_png

H, W = 96, 400
RNG = np.random.default_rng(5)
NOISE = np.exp(RNG.normal(size=(H, W, 3))).astype(np.float32)
PLAIN = np.full((H, W, 3), 0.25, np.float32)


def by_mitsuba(path: Path) -> NDArray:
    """A frame's first part as Mitsuba's own copy of the library reads it."""
    return np.array(load_mitsuba("cpu").Bitmap(str(path)))


@pytest.mark.parametrize("rgb", [NOISE, PLAIN, NOISE.astype(np.float16)])
def test_another_reader_finds_the_same_bits(tmp_path: Path, rgb: NDArray):
    path = tmp_path / "f.exr"
    write_exr(path, {"rgb": rgb, "depth": NOISE[..., 0]})
    found = by_mitsuba(path)
    assert found.dtype == rgb.dtype
    np.testing.assert_array_equal(found, rgb)
    ours = read_exr(path)
    assert ours["rgb"].dtype == np.float32
    np.testing.assert_array_equal(ours["rgb"], rgb.astype(np.float32))
    np.testing.assert_array_equal(ours["depth"], NOISE[..., 0])


def test_noise_is_stored_and_what_repeats_is_compressed(tmp_path: Path):
    packing = {}
    for name, rgb in {"noise": NOISE, "plain": PLAIN, "half": NOISE.astype(np.float16)}.items():
        path = tmp_path / f"{name}.exr"
        write_exr(path, {"rgb": rgb})
        with OpenEXR.File(str(path), header_only=True) as file:
            packing[name] = file.header()["compression"]
    assert packing["noise"] == OpenEXR.NO_COMPRESSION
    assert packing["plain"] == packing["half"] == OpenEXR.ZIP_COMPRESSION
    assert (tmp_path / "plain.exr").stat().st_size < PLAIN.nbytes / 50


@pytest.mark.parametrize("level", [RENDERED, 6])
def test_a_png_of_any_level_holds_the_same_pixels(tmp_path: Path, level: int):
    pixels = RNG.integers(0, 256, (H, W, 3), np.uint8)
    pixels[: H // 2] //= 64
    write_png(tmp_path / "p.png", pixels, level)
    with Image.open(tmp_path / "p.png") as image:
        np.testing.assert_array_equal(np.asarray(image), pixels)


def test_half_floats_are_rounded_as_ieee_754_says_and_counted():
    rgb = (np.exp2(RNG.uniform(-30, 22, (40, 50, 3))) * RNG.choice([-1, 1], 3)).astype(np.float32)
    rgb[0, :4, 0] = 0.0, np.nan, np.inf, 65504.0
    stored, record = as_half(rgb)
    sound = np.isfinite(rgb) & (np.abs(rgb) <= 65504)
    # Python's own conversion.
    told = [struct.unpack("<e", struct.pack("<e", value))[0] for value in rgb[sound].tolist()]
    np.testing.assert_array_equal(stored[sound].astype(np.float64), told)
    beyond = np.isfinite(rgb) & ~sound
    np.testing.assert_array_equal(stored[beyond], np.sign(rgb[beyond]) * 65504)
    assert np.isnan(stored[0, 1, 0])
    assert np.isposinf(stored[0, 2, 0])
    normal = sound & (np.abs(rgb) >= 2**-14)
    error = np.abs(np.subtract(stored, rgb, where=sound, out=np.zeros_like(rgb)))
    assert 2**-11.1 < (error[normal] / np.abs(rgb[normal])).max() <= 2**-11
    low = sound & ~normal
    assert error[low].max() <= 2**-25
    counts = {"clamped": int(beyond.sum()), "subnormal": int((low & (rgb != 0)).sum())}
    assert dataclasses.asdict(record) == counts
    assert min(counts.values()) > 100
