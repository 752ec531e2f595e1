"""Errors of pictures of colors: exact means over pixels, and pictures of any shape."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.materials.values import color_picture, colors
from scenec.compiler.scene.material import Material, MaterialMaps
from scenec.quality.ladder import cost
from scenec.quality.ladder.pixel_means import pixel_means
from scenec.quality.ladder.textures import _Picture, _rung, _through
from scenec.testing.examples import examples


def read(level: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A repeating picture read linearly between texels, by its definition."""
    high, wide = level.shape
    x, y = u * wide - 0.5, v * high - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    s, t = x - i, y - j
    rows = [
        (1 - s) * level[r % high, i % wide] + s * level[r % high, (i + 1) % wide]
        for r in (j, j + 1)
    ]
    return (1 - t) * rows[0] + t * rows[1]


@examples(25)
@given(
    st.integers(1, 9),
    st.integers(1, 9),
    st.floats(-2.0, 2.0),
    st.floats(-2.0, 2.0),
    st.floats(0.01, 2.5),
    st.integers(0, 1000),
)
def test_a_pixel_shows_what_very_many_samples_of_it_show(
    high: int, wide: int, u: float, v: float, side: float, seed: int
) -> None:
    level = np.random.default_rng(seed).uniform(size=(high, wide))
    inside = ((np.arange(300) + 0.5) / 300 - 0.5) * side
    expected = read(level, *np.meshgrid(u + inside, v + inside)).mean()
    found = pixel_means(level, np.array([[u, v]]), side)
    assert found == pytest.approx(expected, abs=1e-4)


def test_pixels_of_many_texels_show_no_noise_of_sampling() -> None:
    """Of 64 x 64 texels of noise they are the means: off by 1/64 of its deviation, not by 1/8."""
    level = np.random.default_rng(1).normal(1.0, 0.25, (512, 512))
    planes = np.repeat(level[..., None], 3, axis=2)
    deviation = _through(planes, 8.0).std()
    # Hardly more than the pixels' own number of texels says: they overlap.
    assert deviation == pytest.approx(0.25 / 64.0, rel=0.2)


def picture(high: int, wide: int, pixels: float, halved: int) -> _Picture:
    planes = np.random.default_rng(3).uniform(0.2, 0.8, (high, wide, 3)).astype(np.float32)
    source = color_picture(planes)
    maps = MaterialMaps(1.0, {"base_color": source}, "opengl")
    material = Material((0.5, 0.5, 0.5), 0.9, 0.0, 0.0, maps=maps)
    truth = _through(colors(source), pixels) / 0.5
    return _Picture("bark", material, source, pixels, halved, truth, 0.5)


def test_a_picture_one_texel_high_stays_as_it_is_beside_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cost, "ENOUGH_S", 0.0)
    strip, square = picture(1, 16, 4.0, 0), picture(32, 32, 4.0, 1)
    for times, texels in ((-1, 32), (0, 16), (1, 8), (9, 2)):
        rung = _rung([strip, square], times)
        assert rung.details["texels_across_least"] == 1
        assert rung.details["texels_across_most"] == texels
    assert _rung([strip, square], -3).worst == 0.0
