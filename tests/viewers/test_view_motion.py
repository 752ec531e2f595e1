"""Motion and sensors' pictures on the page of ``scenec view``, in a real browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import canvas_pixels, open_browser, opened_page
from numpy.typing import NDArray
from sensor_frames import add_sensor, on_disk

from scenec.datasets import motion_colors
from scenec.datasets.view.page import write_view
from scenec.testing import made_output

pytestmark = pytest.mark.slow
WIDTH, HEIGHT = 60, 40


def scene(number: int) -> made_output.Passes:
    """A motion that grows from the middle, with numbers that are none, and all codes."""
    passes = made_output.some_passes(number, WIDTH, HEIGHT)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    flow = np.stack([0.4 * (x - 25), 0.3 * (y - 18)], axis=2)
    flow[:3, :5] = np.nan
    flow[20, 30] = -70_000.0, 1e-7
    vectors = np.stack([0.01 * (x - 30), 0.02 * (y - 20), 0 * x - 0.3], axis=2)
    vectors[-1] = np.nan
    disparity = 40.0 / (1.0 + y) - 1.5
    disparity[:, :2] = np.nan
    measured = np.where(x > 20, 3.0 + y, 0.0)
    codes = ((x + y) % 4).astype(np.uint32)
    floats = {"flow": flow, "flow_backward": -flow, "scene_flow": vectors, "disparity": disparity,
              "depth_measured": measured}  # fmt: skip
    ids = {"occlusion": codes, "occlusion_backward": codes, "disparity_occlusion": codes}
    return passes | {name: array.astype(np.float32) for name, array in floats.items()} | ids


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("motion") / "out"
    out = made_output.make_output(folder, scene, batches=1, cameras=("rover_left",), samples=2)
    add_sensor(out)
    return out


@pytest.fixture(scope="module")
def page(out: Path) -> Iterator:
    path = out / "view.html"
    write_view(out, path)
    with open_browser() as browser, opened_page(browser, path, 1300, 900) as page:
        page.focus("#grid")
        page.keyboard.press("Enter")
        page.wait_for_selector("#readout .hint")
        yield page


def shown(page, layer: str) -> NDArray[np.int64]:
    page.click(f'#viewer-bar [data-pass="{layer}"]')
    page.wait_for_selector(f'#large[data-done$="/{layer}"]')
    return canvas_pixels(page, "#large").astype(np.int64)


def scale(page, name: str) -> float:
    return float(page.get_attribute(f'#facts [data-motion="{name}"]', "data-scale"))


def hover(page, column: int, row: int) -> dict[str, str]:
    box = page.locator("#large").bounding_box()
    page.mouse.move(
        box["x"] + (column + 0.5) * box["width"] / WIDTH,
        box["y"] + (row + 0.5) * box["height"] / HEIGHT,
    )
    told = page.eval_on_selector_all(
        "#readout div", "all => all.map(d => [d.dataset.name, d.textContent])"
    )
    return {name: text.removeprefix(name) for name, text in told}


def test_motion_has_the_colors_of_the_contact_sheet_and_black_is_no_number(page):
    passes = scene(0)
    ways = {
        "flow": motion_colors.paint_flow,
        "flow_backward": motion_colors.paint_flow,
        "scene_flow": motion_colors.paint_vectors,
        "disparity": motion_colors.paint_sizes,
    }
    for name, paint in ways.items():
        found = shown(page, name)
        far = motion_colors.lengths(passes[name])
        within = (far[np.isfinite(far)] <= scale(page, name)).mean()
        assert within >= motion_colors.WITHIN - 0.002
        assert np.abs(found - paint(passes[name], scale(page, name))).max() <= 2
        none = np.isnan(far)
        assert none.any()
        assert (found[none] == 0).all()
        assert (found[~none].sum(axis=1) > 0).all()
    for name in ("occlusion", "occlusion_backward", "disparity_occlusion"):
        assert (shown(page, name) == motion_colors.paint_codes(passes[name])).all()


def test_hovering_tells_the_numbers(page):
    passes = scene(0)
    shown(page, "flow")
    for column, row in ((40, 30), (7, 11), (59, 0), (30, 20), (1, 1), (30, 39)):
        told = hover(page, column, row)
        for name in ("flow", "flow_backward", "scene_flow", "disparity"):
            text = told[name.replace("flow_backward", "flow, backward").replace("scene_", "scene ")]
            wanted = np.atleast_1d(passes[name][row, column]).astype(float)
            if np.isnan(wanted).any():
                assert text == "not a number"
                continue
            numbers = re.match(r"(.+?) (px|m)", text).group(1).split(", ")
            limited = np.clip(wanted, -65504, 65504)
            assert np.array(numbers, float) == pytest.approx(limited, rel=1.2e-3, abs=6e-8)
        code = int(passes["occlusion"][row, column])
        assert told["occlusion"].endswith(f"({code})")
        measured = float(passes["depth_measured"][row, column])
        if measured == 0.0:
            assert told["measured"] == "no answer"
        else:
            assert float(told["measured"].split(" ")[0]) == pytest.approx(measured, rel=1e-4)


def test_the_picture_is_the_sensors_with_the_clean_one_and_raw_numbers_beside_it(page, out):
    wanted = on_disk(out, "rover_left", 0)
    assert np.abs(shown(page, "rgb") - wanted["picture"]).mean() < 3
    assert np.abs(shown(page, "clean") - wanted["clean"]).mean() < 3
    gray = 255 * (wanted["raw"] / wanted["raw"].max()) ** (1 / 2.2)
    assert np.abs(shown(page, "raw") - gray[..., None]).max() <= 1
    for column, row in ((0, 0), (59, 39), (17, 23)):
        told = hover(page, column, row)["raw"].replace(",", "")
        assert int(told) == wanted["raw"][row, column]
