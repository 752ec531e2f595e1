"""Cells and the far scale as defined: they keep the picture's values, and nothing repeats."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from scenec.backends.stage.scene import Cells, Maps
from scenec.backends.surface import cells, maps
from scenec.backends.surface.pictures import Point, values_at

SIZE = 2.0
UP = np.array([[0.0], [0.0], [1.0]])


@pytest.fixture(scope="module")
def described(tmp_path_factory) -> Maps:
    """A picture of blots, 3 texels wide; its normals lean by up to 30 degrees, to one side more."""
    folder: Path = tmp_path_factory.mktemp("maps")
    rng = np.random.default_rng(0)

    def noise(channels: int) -> np.ndarray:
        values = ndimage.gaussian_filter(
            rng.normal(size=(96, 96, channels)), (3, 3, 0), mode="wrap"
        )
        return values / values.std()

    Image.fromarray(np.clip(120 + 30 * noise(3), 0, 255).astype(np.uint8)).save(folder / "c.png")
    Image.fromarray(np.clip(110 + 40 * noise(1)[..., 0], 0, 255).astype(np.uint8)).save(
        folder / "h.png"
    )
    tilt = 0.15 * noise(2)
    normal = np.concatenate([tilt, np.ones((96, 96, 1))], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    Image.fromarray(np.rint(127.5 * (normal + 1.0)).astype(np.uint8)).save(folder / "n.png")
    return Maps(
        SIZE,
        folder / "c.png",
        normal=folder / "n.png",
        height=folder / "h.png",
        cells=Cells(2.0, 5),
    )


def value(described: Maps, kind: str, xy: np.ndarray) -> np.ndarray:
    """Of level ground at points [..., 2]: [..., c], a map of normals' unit vectors among them."""
    flat = np.reshape(xy, (-1, 2)).T
    at = np.concatenate([flat, np.zeros((1, flat.shape[1]))])
    up = np.broadcast_to(UP, at.shape)
    found = np.atleast_2d(values_at(described, (kind,), Point(at, up, up))[kind])
    return found.T.reshape(*np.shape(xy)[:-1], -1)


def grid(step: float, count: int) -> np.ndarray:
    at = np.arange(count) * step
    return np.stack(np.meshgrid(at, at), axis=-1)


def correlation(values: np.ndarray, shift: int) -> float:
    """Of values with themselves, so many samples on, along x and along y; the larger."""
    off = values - values.mean()
    along = (off[:, shift:] * off[:, :-shift]).mean()
    return float(max(along, (off[shift:] * off[:-shift]).mean()) / off.var())


def test_the_table_is_the_documented_hash():
    def by_hand(i: int, j: int, seed: int) -> list[float]:
        x, y, z = ((v * 1664525 + 1013904223) % 2**32 for v in (i, j, seed))
        x = (x + y * z) % 2**32
        y = (y + z * x) % 2**32
        z = (z + x * y) % 2**32
        x, y, z = (v ^ v >> 16 for v in (x, y, z))
        x = (x + y * z) % 2**32
        y = (y + z * x) % 2**32
        z = (z + x * y) % 2**32
        return [(v >> 22) / 1024 for v in (x, y, z)]

    for seed in (0, 7, 2**32 - 1):
        for i, j in ((0, 0), (63, 1), (17, 40)):
            assert cells.table(seed)[j, i].tolist() == by_hand(i, j, seed)
    entries = cells.table(7).reshape(-1, 3)
    assert np.abs(entries.mean(axis=0) - 0.5).max() < 0.02
    assert np.abs(np.corrcoef(entries.T) - np.eye(3)).max() < 0.05
    # Half precision holds them as they are.
    np.testing.assert_array_equal(entries.astype(np.float16).astype(float), entries)


@pytest.mark.parametrize(
    "side", [1.0, *(pytest.param(side, marks=pytest.mark.slow) for side in (2.0, 3.0))]
)
def test_nothing_repeats_and_mean_and_contrast_stay(described, side):
    moved = dataclasses.replace(described, cells=Cells(side, 5))
    plain = dataclasses.replace(described, cells=None)
    # 32 samples a repeat.
    xy = grid(SIZE / 32, 32 * 24)
    for kind in ("base_color", "height"):
        before, after = (value(m, kind, xy) for m in (plain, moved))
        assert correlation(before[..., 0], 32) > 0.999
        for repeats in (1, 2, 3):
            assert correlation(after[..., 0], 32 * repeats) < 0.1
        np.testing.assert_allclose(after.mean((0, 1)), before.mean((0, 1)), rtol=0.01)
        np.testing.assert_allclose(after.std((0, 1)), before.std((0, 1)), rtol=0.03)


def test_values_and_normals_are_continuous_across_all_seams(described):
    # Along lines that cross cells, at triangles' edges and corners among them.
    t = np.arange(0.0, 1.0, 1e-5)[:, None]
    ends = np.array([[4.0, 0.0], [3.0, 3.0 * np.sqrt(3.0)], [2.17, -3.31]])
    for start in ([0.0, 0.0], [0.31, 0.77]):
        for end in ends:
            xy = np.array(start) + t * end
            steep = np.abs(np.diff(value(described, "base_color", xy), axis=0)).max()
            # A texel's step of 0.3 over a fiftieth of a meter, thrice.
            assert steep < 3.0 * 0.3 * 50.0 * 6.0 * 1e-5
            lean = np.abs(np.diff(value(described, "normal", xy), axis=0)).max()
            assert lean < 3.0 * 0.5 * 50.0 * 6.0 * 1e-5


def test_a_cell_s_middle_shows_the_picture_turned_and_shifted(described):
    moved = Cells(1.7, 9)
    corner = np.array([3, -2])
    at = np.array(cells.TO_WORLD) @ corner * moved.size_m
    near = at + np.random.default_rng(1).uniform(-0.05, 0.05, (50, 2))
    shift_u, shift_v, turn = cells.table(9)[corner[1] % 64, corner[0] % 64]
    cosine, sine = np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)
    off = (near - at) / SIZE
    u = cosine * off[:, 0] - sine * off[:, 1] + shift_u
    v = sine * off[:, 0] + cosine * off[:, 1] + shift_v
    wanted = maps.sample(maps.map_values(described, "base_color"), u, v)
    got = value(dataclasses.replace(described, cells=moved), "base_color", near)
    np.testing.assert_allclose(got, wanted, atol=1e-4)


def test_normals_are_those_of_the_turned_relief(described, tmp_path):
    # One slope everywhere: in the world it points where the cell's turn leaves it.
    normal = np.array([0.6, 0.0, 0.8])
    file = tmp_path / "slope.png"
    Image.fromarray(np.full((2, 2, 3), np.rint(127.5 * (normal + 1.0)), np.uint8)).save(file)
    lone = Maps(SIZE, normal=file, cells=Cells(3.0, 2))
    for corner in ([0, 0], [1, 0], [0, 1], [-3, 5]):
        at = np.array(cells.TO_WORLD) @ np.array(corner) * 3.0
        turn = 2.0 * np.pi * cells.table(2)[corner[1] % 64, corner[0] % 64, 2]
        # u = x cos - y sin + ...: a height that falls along u falls along (cos, -sin).
        wanted = [0.6 * np.cos(turn), -0.6 * np.sin(turn), 0.8]
        np.testing.assert_allclose(value(lone, "normal", at), wanted, atol=0.01)


def test_normals_keep_their_lean_and_lose_the_picture_s_direction(described):
    xy = grid(SIZE / 24, 24 * 20)
    plain = dataclasses.replace(described, cells=None)
    before, after = value(plain, "normal", xy), value(described, "normal", xy)
    np.testing.assert_allclose(np.linalg.norm(after, axis=-1), 1.0, atol=1e-12)
    lean = [np.sqrt((n[..., :2] ** 2).sum(-1).mean()) for n in (before, after)]
    np.testing.assert_allclose(lean[1], lean[0], rtol=0.05)


@pytest.mark.slow
def test_the_far_scale_multiplies_by_the_larger_picture_over_its_mean(described):
    plain = dataclasses.replace(described, cells=None)
    xy = grid(0.37, 40)
    near = value(plain, "base_color", xy)
    larger = dataclasses.replace(plain, size_m=SIZE * 5.0)
    wide = value(larger, "base_color", xy) / maps.map_mean(plain, "base_color")
    for share in (0.0, 0.4, 1.0):
        got = value(dataclasses.replace(plain, far=(5.0, share)), "base_color", xy)
        np.testing.assert_allclose(got, near * (1.0 + share * (wide - 1.0)), atol=1e-12)
    both = dataclasses.replace(described, far=(6.3, 0.5))
    xy = grid(SIZE / 8, 8 * 120)
    np.testing.assert_allclose(
        value(both, "base_color", xy).mean((0, 1)),
        maps.map_mean(described, "base_color"), rtol=0.01,
    )  # fmt: skip
    # Heights and the like have no second scale.
    np.testing.assert_array_equal(value(both, "height", xy[:5]), value(described, "height", xy[:5]))


def test_a_black_channel_stays_black(tmp_path):
    file = tmp_path / "red.png"
    Image.fromarray(np.array([[[200, 0, 0], [90, 0, 0]]], np.uint8)).save(file)
    described = Maps(1.0, base_color=file, cells=Cells(0.7, 3), far=(4.0, 1.0))
    got = value(described, "base_color", grid(0.31, 50))
    assert np.isfinite(got).all()
    assert not got[..., 1:].any()
    assert got[..., 0].max() > 0.0
