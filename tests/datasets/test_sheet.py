"""The contact sheet of an output shows frames of its stages alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenec.datasets.sheet import write_sheet
from scenec.schemas.errors import FrameError
from scenec.testing.made_output import edit, make_output, some_passes

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
