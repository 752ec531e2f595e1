"""The page's view in three dimensions, in a real browser: it draws what is in the model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from browser import canvas_pixels, open_browser, opened_page

from scenec.datasets.colors import label_colors, paint_instances
from scenec.datasets.view.ground import Ground
from scenec.datasets.view.page import write_view
from scenec.schemas.manifest import Batch
from scenec.schemas.model import Look, Model, Part, Placement, View
from scenec.testing import made_output

pytestmark = pytest.mark.slow

SKY = (159, 180, 200)


def slab(size: float, z: float, labels: int, look: int) -> Part:
    """A square around the origin."""
    points = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * size
    points[:, 2] = z
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    ids = {level: np.full(2, labels, np.uint32) for level in ("class", "surface")}
    return Part("", points, faces, None, None, None, ids, look)


def model() -> Model:
    """Red ground and, above its middle, one green instance; a camera looks down at both."""
    identity = np.eye(4)[None, :3]
    none = np.zeros(1, np.float32)
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 10.0
    return Model(
        "batch_0000",
        np.zeros(3),
        (slab(8.0, 0.0, 20, 0), slab(2.0, 1.0, 300, 1)),
        (Look("ground", (0.6, 0.0, 0.0), 1.0), Look("stone", (0.0, 0.6, 0.0), 1.0)),
        (
            Placement("", (0,), identity, np.zeros(1, np.uint32), none),
            Placement("/World/Stones", (1,), identity, np.array([5], np.uint32), none),
        ),
        (
            View(
                "rover_front", 64, 48, np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]), down[None]
            ),
        ),
        (((np.array([0.0, 0.0, 1.0]), np.ones(3)),),),
        np.zeros(1),
        {},
        ("light: the sky's is left out",),
    )


def ground(_: Batch) -> Ground:
    return Ground((0.0, 0.0), (1.0, 1.0), np.zeros((4, 4)), (), model())


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Iterator:
    folder = tmp_path_factory.mktemp("space")
    out = made_output.make_output(
        folder / "out", lambda number: made_output.some_passes(number, 48, 32), samples=1
    )
    write_view(out, folder / "view.html", ground=ground)
    page_file = folder / "view.html"
    with open_browser() as browser, opened_page(browser, page_file, 900, 640) as page:
        page.click("#tab-space")
        page.wait_for_selector("#space-canvas[data-drawn]")
        for what in ("cameras", "suns"):
            page.uncheck(f'[data-show="{what}"]')
        page.click('[data-camera="rover_front"]')
        yield page


def shown(page, mode: str) -> np.ndarray:
    # What was drawn before the last click says the same of itself.
    page.eval_on_selector("#space-canvas", "c => delete c.dataset.drawn")
    page.select_option("#space-mode", mode)
    page.wait_for_selector(f'#space-canvas[data-drawn*=" {mode} "]')
    return canvas_pixels(page, "#space-canvas").astype(float)


def places(page, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colors where the camera's picture has the instance, and where the ground beside it."""
    height, width = picture.shape[:2]
    scale = min(height / 48, width / 64)
    # The instance's half side, 2 m, at 9 m; the ground is 10 m away.
    inner = int(0.7 * 50 * 2 / 9 * scale)
    y, x = height // 2, width // 2
    instance = picture[y - inner : y + inner, x - inner : x + inner]
    out = int((50 * 2 / 9 + 3) * scale)
    return instance.reshape(-1, 3), picture[y - inner : y + inner, x + out : x + out + 8].reshape(
        -1, 3
    )


def hue(color: np.ndarray) -> np.ndarray:
    """Linear color without its brightness."""
    linear = (np.asarray(color) / 255.0) ** 2.2
    return linear / linear.max()


def test_materials_are_drawn_where_the_camera_sees_them(page):
    instance, beside = places(page, shown(page, "drawn"))
    assert np.all(instance[:, 1] > 4 * instance[:, 0].clip(1))
    assert np.all(beside[:, 0] > 4 * beside[:, 1].clip(1))


def test_labels_have_the_colors_of_the_frames(page):
    instance, beside = places(page, shown(page, "label.surface"))
    colors = label_colors(list(made_output.LABELS["surface"]))
    for found, label in ((instance, 300), (beside, 20)):
        assert np.allclose(hue(found.mean(axis=0)), hue(np.array(colors[label])), atol=0.12)


def test_instances_have_the_colors_of_the_frames_and_ground_has_none(page):
    instance, beside = places(page, shown(page, "instance"))
    assert np.allclose(
        hue(instance.mean(axis=0)),
        hue(paint_instances(np.array([[5]], np.uint32))[0, 0]),
        atol=0.12,
    )
    assert hue(beside.mean(axis=0)).min() > 0.8


def test_the_side_counts_triangles_and_names_what_is_left_out(page):
    text = page.text_content("#space-side")
    assert "4 triangles" in text
    assert "the sky's is left out" in text
    assert page.get_attribute("#space-canvas", "data-triangles") == "4"
