"""The contact sheet shows each pass in colors that say what they should."""

from __future__ import annotations

import itertools
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenec.datasets.colors import (
    NO_LABEL,
    TRAVERSABILITY_COLORS,
    label_colors,
    paint_classes,
    paint_depth,
    paint_instances,
    paint_labels,
    paint_slope,
    viridis,
)
from scenec.datasets.contact_sheet import SheetFrame, contact_sheet
from scenec.datasets.sheet import write_sheet
from scenec.schemas.errors import FrameError
from scenec.testing.made_output import edit, make_output, some_passes


def test_labels_get_colors_that_differ_clearly():
    colors = label_colors(list(range(1, 10)))
    for a, b in itertools.combinations(colors.values(), 2):
        assert np.abs(np.subtract(a, b)).sum() > 60
    assert colors[0] == NO_LABEL
    assert len(set(label_colors(list(range(1, 28))).values())) == 28


def test_a_label_has_the_same_color_wherever_it_is_seen():
    labels = np.array([[1, 2], [0, 2]], np.uint32)
    painted = paint_labels(labels, label_colors([1, 2, 3]))
    assert (painted[0, 1] == painted[1, 1]).all()
    assert tuple(painted[1, 0]) == NO_LABEL
    assert not (painted[0, 0] == painted[0, 1]).all()


def test_neighboring_instances_differ_and_keep_their_color_in_every_frame():
    ids = np.arange(1, 2001, dtype=np.uint32)[None]
    painted = paint_instances(ids)[0].astype(int)
    assert (np.abs(np.diff(painted, axis=0)).sum(axis=1) > 40).mean() > 0.97
    assert (paint_instances(ids[:, 1000:1001])[0, 0] == painted[1000]).all()
    assert (paint_instances(np.zeros((1, 1), np.uint32)) > 230).all()


def test_depth_is_brighter_when_nearer_and_white_where_nothing_is_hit():
    depth = np.array([[1.0, 2.0, 5.0, 20.0, np.inf]])
    painted = paint_depth(depth, 1.0, 20.0)[0].astype(int)
    assert (np.diff(painted[:4].sum(axis=1)) < 0).all()
    assert painted[4].tolist() == [255, 255, 255]


#: What dichromats see of linear Rec.709 (Machado, Oliveira and Fernandes 2009, severity 1).
DICHROMATS = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                   [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                     [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                   [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


@pytest.mark.parametrize("eyes", DICHROMATS)
def test_classes_of_ground_differ_to_color_blind_eyes(eyes):
    seen = (np.array(TRAVERSABILITY_COLORS) / 255.0) ** 2.2 @ np.array(DICHROMATS[eyes]).T
    seen = 255.0 * np.clip(seen, 0.0, 1.0) ** (1 / 2.2)
    for a, b in itertools.combinations(seen, 2):
        assert np.abs(a - b).sum() > 60
    assert [tuple(c) for c in paint_classes(np.arange(4))] == list(TRAVERSABILITY_COLORS)


def test_slopes_are_brighter_when_steeper_up_to_45_degrees_and_white_without_a_hit():
    painted = paint_slope(np.array([0.0, 10.0, 30.0, 45.0, 80.0, np.nan])).astype(int)
    assert (np.diff(painted[:4].sum(axis=1)) > 0).all()
    assert painted[3].tolist() == painted[4].tolist()
    assert painted[5].tolist() == [255, 255, 255]


def test_the_sheet_has_the_ground_for_a_vehicle_and_its_legend():
    ids = np.repeat(np.arange(4, dtype=np.uint32), 30)[None].repeat(80, axis=0)
    frame = SheetFrame("one", None, {}, None, None,
                       terrain={"slope": ids * 15.0, "traversable": ids})  # fmt: skip
    sheet = np.asarray(contact_sheet([frame], {}, "h", tile_width=240)).reshape(-1, 3)
    for color in TRAVERSABILITY_COLORS:
        # A quarter of the picture, and a square of the legend.
        assert 240 * 160 / 4 < (sheet == color).all(axis=1).sum() < 240 * 160 / 4 + 600
    assert (sheet == paint_slope(np.array([30.0]))[0]).all(axis=1).sum() >= 240 * 160 / 4


def test_the_colormap_goes_from_dark_to_bright_without_a_step_back():
    bright = viridis(np.linspace(0, 1, 200)).astype(float) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(bright) > -1.0).all()
    assert bright[-1] > bright[0] + 150


def frame(**change) -> SheetFrame:
    h, w = 30, 40
    values = {
        "title": "camera, sample 0",
        "picture": np.full((h, w, 3), (10, 200, 30), np.uint8),
        "labels": {"class": np.full((h, w), 2, np.uint32)},
        "instance": np.full((h, w), 7, np.uint32),
        "depth": np.full((h, w), 3.0, np.float32),
    }
    return SheetFrame(**(values | change))


def test_the_sheet_has_a_column_a_pass_and_a_row_a_frame():
    names = {"class": {1: "sky", 2: "ground"}}
    one = contact_sheet([frame()], names, "heading", tile_width=100)
    two = contact_sheet([frame(), frame()], names, "heading", tile_width=100)
    assert one.size[0] == 10 + 4 * 110
    assert two.size[1] - one.size[1] == 75 + 10
    assert one.getpixel((60, 110)) == (10, 200, 30)
    assert one.getpixel((170, 110)) == label_colors([1, 2])[2]


def test_passes_that_are_not_there_take_no_room():
    sheet = contact_sheet(
        [frame(picture=None, labels={}, instance=None)], {}, "heading", tile_width=100
    )
    assert sheet.size[0] == 10 + 110
    nothing = frame(depth=np.full((30, 40), np.inf))
    assert contact_sheet([nothing], {}, "heading", tile_width=100).size[0] == 10 + 4 * 110


CAMERA = "batch_0000/frames/annotation/a"


def marked(folder: Path, **more: object) -> Path:
    out = make_output(folder, batches=1, cameras=("a",), samples=3)
    edit(out / CAMERA / "000000.json", **more)
    return out


def pixels(path: Path) -> np.ndarray:
    """Without the heading."""
    return np.asarray(Image.open(path).convert("RGB"))[34:]


def test_a_frame_of_another_stage_is_left_out_and_said(tmp_path):
    out = marked(tmp_path / "out", stage_digest="0" * 64)
    sheet = write_sheet(out, tmp_path / "a.png", count=2)
    (line,) = sheet.left_out
    assert "000000.json: foreign: was rendered from another stage" in line
    for name in ("json", "exr", "png", "instances.csv"):
        (out / CAMERA / f"000000.{name}").unlink()
    rest = write_sheet(out, tmp_path / "b.png", count=2)
    assert rest.left_out == ()
    assert np.array_equal(pixels(sheet.path), pixels(rest.path))


def test_a_stray_is_left_out_and_said(tmp_path):
    out = make_output(tmp_path / "out", batches=1, cameras=("a",), samples=2)
    for path in sorted((out / CAMERA).glob("000001.*")):
        shutil.copy(path, path.with_name(path.name.replace("000001", "000007")))
    sheet = write_sheet(out, tmp_path / "a.png", count=9)
    (line,) = sheet.left_out
    assert "000007.json: not of this stage: the batch has samples 0 to 1" in line
    other = write_sheet(out, tmp_path / "b.png", count=2)
    assert pixels(sheet.path).shape == pixels(other.path).shape


def test_an_output_of_foreign_frames_alone_is_an_error(tmp_path):
    out = make_output(tmp_path / "out", lambda n: some_passes(n, 4, 2), batches=1, samples=1)
    for path in sorted(out.rglob("00*.json")):
        edit(path, stage_digest="0" * 64)
    with pytest.raises(FrameError, match="all frames are of another stage, such as"):
        write_sheet(out, tmp_path / "a.png")
