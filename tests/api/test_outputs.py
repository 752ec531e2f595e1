"""Outputs, stages and frames in notebooks."""

from __future__ import annotations

import base64
import io
import os
import re
from contextlib import ExitStack

import numpy as np
import pytest
from PIL import Image

import scenec
from scenec.api import shown
from scenec.api.listener import StepProgress
from scenec.backends.run.executors import make_executor
from scenec.backends.stage.read import read_stage
from scenec.compiler.cfg import builder
from scenec.schemas.errors import CfgError, OutputError
from scenec.schemas.manifest import read_manifest
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")


def pictures_in(html: str) -> list[Image.Image]:
    """The pictures that a notebook would show."""
    found = re.findall(r"data:image/png;base64,([A-Za-z0-9+/=]+)", html)
    return [Image.open(io.BytesIO(base64.b64decode(text))) for text in found]


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    folder = tmp_path_factory.mktemp("notebook")
    cfg = builder.read(write_cfg(folder, small_cfg(samples=2)))
    return scenec.compile(cfg, folder / "out", seed=3)


def test_a_cfg_in_python_compiles_as_its_file_does(output, tmp_path):
    path = write_cfg(tmp_path, small_cfg(samples=2))
    by_file = scenec.compile(path, tmp_path / "out", seed=3)
    stages = [(o.path / "batch_0000").glob("*.usd?") for o in (output, by_file)]
    ours, theirs = ({p.name: p.read_bytes() for p in paths} for paths in stages)
    assert ours == theirs
    assert len(ours) > 3


class Watching(scenec.Listener, StepProgress):
    """Notes what is in the working directory whenever a step begins."""

    def __init__(self, there: list[str]) -> None:
        self._there = there

    def steps(self, *_: object, **__: object) -> StepProgress:
        """Is told of them itself."""
        return self

    def now(self, *_: object) -> None:
        """Looks."""
        self._there += os.listdir()


@pytest.mark.parametrize("workers", [0, 1])
def test_a_cfg_in_python_is_no_file_and_names_files_of_the_working_directory(
    tmp_path, monkeypatch, workers
):
    hills = tmp_path / "hills"
    hills.mkdir()
    np.save(hills / "dem.npy", np.ones((8, 8)))
    cfg = small_cfg(samples=1)
    cfg["terrain"]["relief"] = [{"type": "dem", "file": "dem.npy", "pixel_m": 9}]
    path = write_cfg(hills, cfg)
    monkeypatch.chdir(hills)
    cfg = builder.read(path)
    path.unlink()
    there: list[str] = []
    with ExitStack() as stack:
        executor = stack.enter_context(make_executor(workers, None)) if workers else None
        output = scenec.compile(
            cfg, tmp_path / "out", seed=3, executor=executor, listener=Watching(there)
        )
    assert set(there) == {"dem.npy"}
    assert list(read_manifest(output.path).cfg.inputs) == ["terrain/relief/0/file"]


def test_a_stage_shows_what_its_cameras_see(output):
    (stage,) = output.stages
    sketch = stage.sketch()
    camera = stage.cameras[0]
    assert sketch.shape == (camera.height, camera.width, 3)
    # Sky, ground and rocks have colors of their own; the sky is not shaded.
    assert (sketch == (136, 204, 238)).all(axis=-1).any()
    assert len(np.unique(sketch.reshape(-1, 3), axis=0)) > 50
    html = stage._repr_html_()
    assert [p.size for p in pictures_in(html)] == [(camera.width, camera.height)]
    assert ">300<" in html


def test_a_sketch_of_fewer_pixels_sees_the_same(output):
    scene = read_stage(output.stages[0].batch.stage)
    camera = scene.cameras[0][0]
    small = shown._smaller(camera, camera.width // 2)
    at = np.array([0.3, -0.2, 1.0])
    wide, narrow = (c.intrinsics @ at for c in (camera, small))
    scale = (camera.width / small.width, camera.height / small.height)
    assert wide[:2] == pytest.approx(narrow[:2] * scale, rel=1e-12)
    assert shown._smaller(camera, 10_000) is camera


def test_frames_give_arrays_and_show_every_pass(output):
    assert pictures_in(output._repr_html_())
    frames = output.render("annotation", passes=("label", "instance", "depth")).frames()
    assert len(frames) == 2
    assert frames[0]["depth"].shape == frames[0]["label.class"].shape
    assert frames[0].passes == ("label.class", "label.surface", "instance", "depth")
    assert len(pictures_in(frames[0]._repr_html_())) == 4
    # The sheet of two rows.
    (sheet,) = pictures_in(output._repr_html_())
    assert sheet.width > 4 * 400
    with pytest.raises(KeyError, match='has no pass "dept"; did you mean "depth"'):
        _ = frames[0]["dept"]


def test_faults_are_errors_of_the_library(tmp_path):
    cfg = builder.read(write_cfg(tmp_path))
    cfg.samples = 0
    with pytest.raises(CfgError, match=r"cfg:.* /samples: 0: expected at least 1"):
        scenec.compile(cfg, tmp_path / "out")
    assert os.listdir(tmp_path) == ["small.json"]
    with pytest.raises(OutputError, match="holds no manifest"):
        scenec.OutputFolder(tmp_path)
