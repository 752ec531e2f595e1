"""A stereo pair costs one build of the scene: counted where it would cost a second one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import counted_backend
import numpy as np
import pytest

from scenec.backends.contract import Backend
from scenec.backends.registry import open_backend
from scenec.backends.run import session
from scenec.backends.run.render import render
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.schemas.manifest import read_manifest
from scenec.testing.small import small_cfg, write_cfg

SENSOR = {"resolution": [24, 16], "fov_deg": 70}
#: Written anew for each camera: the cameras themselves, and what is to be rendered of them.
OF_CAMERAS = ("cameras.usdc", "stage.usda", "report.json")


def compiled(folder: Path, sensors: dict[str, Any], **change: Any) -> Path:
    folder.mkdir()
    cfg = small_cfg(samples=2, **change)
    cfg["terrain"]["spacing_m"] = 1.0
    cfg["objects"]["rocks"]["count"] = 40
    cfg["rigs"]["rover"]["sensors"] = sensors
    compile_cfg(write_cfg(folder, cfg), seed=1, out=folder / "out")
    return folder / "out"


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    right = SENSOR | {"mount": {"position_m": [0.12, 0, 0]}}
    sensors = {"left": SENSOR | {"partner": "right"}, "right": right}
    folder = tmp_path_factory.mktemp("pair") / "a"
    return compiled(folder, sensors, batches=2, outputs=["rgb", "label", "depth"])


class Counting:
    """A backend whose scenes are counted; all it does is the backend's own doing."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self.loads = 0

    def load(self, scene: RenderScene) -> None:
        """Counts, and hands on."""
        self.loads += 1
        self._backend.load(scene)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._backend, name)


@pytest.mark.slow
def test_a_renderer_and_the_exact_caster_build_a_pairs_scene_once(
    pair: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[RenderScene] = []
    real = session.ExactCaster

    def counting(scene: RenderScene, trees: bool = True) -> Any:
        built.append(scene)
        return real(scene, trees)

    monkeypatch.setattr(session, "ExactCaster", counting)
    scene = read_stage(pair / "batch_0000" / "stage.usda")
    backend = Counting(open_backend("mitsuba"))
    work = Session(scene, backend)  # type: ignore[arg-type]
    pictures = []
    for sample, cameras in enumerate(scene.cameras):
        assert [camera.name for camera in cameras] == ["rover_left", "rover_right"]
        for camera in cameras:
            passes = work.passes(["rgb", "depth", "label"], camera)
            arrays = work.render(camera, sample, passes, 2, 0).arrays
            pictures.append(arrays["depth"])
    assert backend.loads == 1
    assert len(built) == 1
    assert built[0] is scene
    # Four views indeed, and no picture taken for another's.
    assert not any(np.array_equal(pictures[0], other) for other in pictures[1:])


@pytest.mark.slow
def test_a_render_starts_and_loads_a_backend_once_a_batch_whatever_the_cameras(
    pair: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = counted_backend.install(tmp_path, monkeypatch)
    report = render(pair, "counted", spp=1)
    assert report.rendered == 2 * 2 * 2
    assert report.deaths == report.replaced == 0
    lines = [line.split(" ", 1) for line in log.read_text(encoding="utf-8").splitlines()]
    assert [what for _, what in lines] == ["start", "load batch_0000", "start", "load batch_0001"]
    assert len({process for process, _ in lines}) == 2


def test_a_second_camera_in_the_same_place_adds_not_one_byte_of_geometry(tmp_path: Path) -> None:
    one = compiled(tmp_path / "one", {"a": SENSOR}, batches=1)
    two = compiled(tmp_path / "two", {"a": SENSOR, "b": SENSOR}, batches=1)
    first, second = (read_manifest(out).files for out in (one, two))
    assert list(first) == list(second)
    changed = {name.partition("/")[2] or name for name in first if first[name] != second[name]}
    assert changed <= {*OF_CAMERAS, "cfg.json"}
    assert "cameras.usdc" in changed
    assert "batch_0000/terrain.usdc" in first
    both = read_stage(two / "batch_0000" / "stage.usda")
    assert [len(cameras) for cameras in both.cameras] == [2, 2]
    assert len(both.meshes) == len(read_stage(one / "batch_0000" / "stage.usda").meshes)
