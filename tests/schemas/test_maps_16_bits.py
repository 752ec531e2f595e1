"""Pictures of 16 bits keep them, whatever their kind; OpenCV writes them."""

from __future__ import annotations

import sys

import cv2
import numpy as np
import pytest

from scenec.schemas.maps import decode, read_pixels

RNG = np.random.default_rng(5)


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("largest", [255, 65535])
def test_a_picture_and_its_alpha_have_all_their_bits(tmp_path, name, channels, largest):
    kind = np.uint8 if largest == 255 else np.uint16
    codes = RNG.integers(0, largest, (5, 7, channels), kind, endpoint=True)
    # OpenCV has blue first.
    order = [2, 1, 0, 3][:channels] if channels > 1 else [0]
    assert cv2.imwrite(str(tmp_path / name), codes[..., order])
    data = (tmp_path / name).read_bytes()
    for source in (tmp_path / name, data):
        found = read_pixels(source)
        assert found.dtype == kind
        assert np.array_equal(found, codes[..., :3])
    alpha = read_pixels(tmp_path / name, alpha=True)
    expected = codes[..., 3:] if channels == 4 else np.full((5, 7, 1), largest)
    assert np.array_equal(alpha / np.iinfo(alpha.dtype).max, expected / largest)


def test_a_shallow_slope_is_in_normals_of_16_bits_and_not_in_those_of_8(tmp_path):
    slope = 0.001
    vector = np.array([slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    errors = {}
    for largest, kind in ((255, np.uint8), (65535, np.uint16)):
        codes = np.rint((vector + 1.0) * largest / 2.0).astype(kind)
        cv2.imwrite(str(tmp_path / "n.png"), np.broadcast_to(codes[::-1], (4, 4, 3)).copy())
        normal = decode(read_pixels(tmp_path / "n.png"), "normal")[0, 0].astype(np.float64)
        errors[largest] = np.abs(normal - vector).max()
    assert errors[65535] < 1.6e-5
    assert errors[255] > 1e-3


def test_without_rasterio_colors_of_16_bits_are_refused_and_not_halved(tmp_path, monkeypatch):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((4, 4, 3), np.uint16))
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(ValueError, match=r"scenec\[geotiff\]"):
        read_pixels(tmp_path / "a.png")
