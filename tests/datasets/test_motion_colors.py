"""Motion in colors, on the contact sheet and as the page stores it."""

from __future__ import annotations

import math
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from PIL import Image
from sensor_frames import add_sensor, on_disk

from scenec.datasets import motion_colors
from scenec.datasets.sheet import write_sheet
from scenec.datasets.view import fields
from scenec.testing import made_output
from scenec.testing.examples import examples


def middlebury(u: float, v: float) -> list[int]:
    """``computeColor`` of the benchmark's colorcode.cpp, pixel by pixel."""
    wheel = [(255, 255 * i // 15, 0) for i in range(15)]
    wheel += [(255 - 255 * i // 6, 255, 0) for i in range(6)]
    wheel += [(0, 255, 255 * i // 4) for i in range(4)]
    wheel += [(0, 255 - 255 * i // 11, 255) for i in range(11)]
    wheel += [(255 * i // 13, 0, 255) for i in range(13)]
    wheel += [(255, 0, 255 - 255 * i // 6) for i in range(6)]
    rad = math.sqrt(u * u + v * v)
    fk = (math.atan2(-v, -u) / math.pi + 1.0) / 2.0 * (len(wheel) - 1)
    k0 = int(fk)
    k1, f = (k0 + 1) % len(wheel), fk - k0
    found = []
    for b in range(3):
        col = (1 - f) * (wheel[k0][b] / 255.0) + f * (wheel[k1][b] / 255.0)
        col = 1 - rad * (1 - col) if rad <= 1 else col * 0.75
        found.append(int(255.0 * col))
    return found


def test_flow_has_the_colors_of_the_middlebury_benchmark():
    rng = np.random.default_rng(1)
    flow = rng.normal(0, 8.0, (40, 50, 2))
    flow[0, :4] = [[8, 0], [0, 8], [-8, 0], [0, -8]]
    painted = motion_colors.paint_flow(flow, 8.0)
    for y, x in np.ndindex(flow.shape[:2]):
        wanted = middlebury(*(flow[y, x] / 8.0).tolist())
        assert np.abs(painted[y, x].astype(int) - wanted).max() <= 1
    assert painted[0, 0].tolist() == [255, 0, 0]
    still = motion_colors.paint_flow(np.zeros((1, 1, 2)), 1.0)
    assert still.tolist() == [[[255, 255, 255]]]


def test_what_is_not_a_number_is_black_and_nothing_else_is():
    flow = np.array([[[np.nan, 0], [0, np.nan], [np.inf, 1], [1e6, -1e6], [0, 0]]])
    dark = motion_colors.paint_flow(flow, 1.0).sum(axis=2)[0] == 0
    assert dark.tolist() == [True, True, True, False, False]
    vectors = np.concatenate([flow, flow[..., :1]], axis=2)
    dark = motion_colors.paint_vectors(vectors, 1.0).sum(axis=2)[0] == 0
    assert dark.tolist() == [True, True, True, False, False]
    sizes = motion_colors.paint_sizes(np.array([[np.nan, 0.0, -3.0, 9.0]]), 4.0)[0]
    assert (sizes.sum(axis=1) == 0).tolist() == [True, False, False, False]
    assert sizes[2].tolist() == motion_colors.paint_sizes(np.array([[3.0]]), 4.0)[0, 0].tolist()
    codes = motion_colors.paint_codes(np.array([[0, 1, 2, 3, 9]], np.uint32))[0]
    assert len(np.unique(codes, axis=0)) == 5


def test_a_scale_holds_99_percent_and_has_two_digits():
    values = np.linspace(0, 12.34, 1000)[None]
    scale = motion_colors.scale_of("disparity", [values, np.full((1, 3), np.nan)])
    assert scale == pytest.approx(13.0)
    assert motion_colors.scale_of("flow", []) == 1.0
    still = [np.zeros((2, 2, 2)), np.full((2, 2, 2), np.nan)]
    assert motion_colors.scale_of("flow", still) == 1.0


def test_a_scale_of_pixels_ends_where_the_picture_does():
    far = np.full((30, 40, 2), 1e6)
    assert motion_colors.scale_of("flow", [far]) == pytest.approx(50.0)
    assert motion_colors.scale_of("scene_flow", [far]) > 1e6


def unpacked(data: bytes, planes: int, shape: tuple[int, int]) -> NDArray[np.int64]:
    """Codes [planes, h, w], pixel by pixel as a browser does it."""
    raw = zlib.decompress(data)
    height, width = shape
    n = height * width
    out = np.zeros((planes, height + 1, width + 1), np.int64)
    for k in range(planes):
        for i in range(n):
            y, x = divmod(i, width)
            folded = raw[2 * n * k + i] + 256 * raw[2 * n * k + n + i]
            rest = folded // 2 if folded % 2 == 0 else -(folded + 1) // 2
            plane = out[k, y + 1, x] + out[k, y, x + 1] - out[k, y, x]
            out[k, y + 1, x + 1] = (rest + plane) % 65536
    return out[:, 1:, 1:]


@examples(60)
@given(
    arrays.arrays(
        np.float32,
        st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 3)),
        elements=st.one_of(
            st.floats(-(2.0**18), 2.0**18, width=32), st.sampled_from([math.nan, math.inf, 0.0])
        ),
    )
)
def test_any_motion_comes_back_within_its_stated_error(values):
    layer = fields.store_field("flow", values)
    codes = unpacked(layer.data, values.shape[2], values.shape[:2])
    none = ~np.isfinite(values).all(axis=2)
    assert ((codes == 0xFFFF) == none).all()
    bits = np.where(codes & 0x8000, codes & 0x7FFF, ~codes & 0xFFFF).astype(np.uint16)
    found = np.moveaxis(bits.view(np.float16), 0, -1).astype(np.float64)[~none]
    wanted = np.clip(values[~none].astype(np.float64), -65504, 65504)
    assert (np.abs(found - wanted) <= fields.HALF_ERROR * np.abs(wanted) + 2.0**-25).all()


def test_raw_numbers_come_back_exactly():
    numbers = np.random.default_rng(0).integers(0, 2**16, (7, 9), np.uint16)
    layer = fields.store_whole("raw", numbers)
    assert (unpacked(layer.data, 1, numbers.shape)[0] == numbers).all()
    assert layer.facts["top"] == numbers.max()


def test_the_sheet_has_a_column_for_each_and_takes_the_sensors_picture(tmp_path):
    shape = (20, 30)
    flow = np.zeros((*shape, 2), np.float32)
    flow[..., 0] = 5.0
    flow[0] = np.nan

    def passes(number: int) -> made_output.Passes:
        extra = {"flow": flow, "disparity": np.full(shape, -2.5, np.float32),
                 "depth_measured": np.zeros(shape, np.float32),
                 "occlusion": np.full(shape, 1, np.uint32)}  # fmt: skip
        return made_output.some_passes(number, 30, 20) | extra

    out = made_output.make_output(tmp_path / "out", passes, batches=1, cameras=("a",), samples=2)
    before = write_sheet(out, tmp_path / "before.png", count=1).path
    add_sensor(out)
    after = write_sheet(out, tmp_path / "after.png", count=1).path
    wide, wider = (Image.open(path).convert("RGB") for path in (before, after))
    assert wider.width - wide.width == 490
    middle = np.asarray(wider)[68 + 150 : 68 + 170, :, :].astype(int)
    wanted = on_disk(out, "a", 0)
    for column, kind in enumerate(("picture", "clean")):
        seen = middle[:, 10 + 490 * column + 235 : 10 + 490 * column + 245].mean(axis=(0, 1))
        pixels = wanted[kind][9:11, 14:16].reshape(-1, 3).mean(axis=0)
        assert np.abs(seen - pixels).max() < 8
    # rgb, clean, two levels, instance, depth, measured, then motion.
    colors = {
        "measured": (6, (255, 255, 255)),
        "flow": (7, (255, 0, 0)),
        "occlusion": (9, (204, 68, 51)),
    }
    for column, color in colors.values():
        assert (middle[5, 10 + 490 * column + 200] == color).all()
    assert (np.asarray(wider)[68 + 40, 10 + 490 * 7 + 5] != 0).any()
    assert (np.asarray(wider)[68 + 2, 10 + 490 * 7 + 240] == 0).all()
