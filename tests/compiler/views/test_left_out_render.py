"""Annotation alone needs no renderer, no materials, no pictures and no light."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.backends.run.session import Session
from scenec.backends.run.units import Opening, OpenStage
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.schemas.units import Keeper
from scenec.testing.small import small_cfg, write_cfg

PASSES = ("depth", "instance", "label", "normal", "face")


@pytest.fixture(scope="module")
def colored(tmp_path_factory: pytest.TempPathFactory) -> RenderScene:
    """A stage with all there is to see, pictures on the ground, too."""
    folder = tmp_path_factory.mktemp("colored")
    cfg = small_cfg(samples=1)
    cfg["materials"]["sand"]["maps"] = {"procedural": {"type": "sand", "resolution": 64}}
    cfg["objects"]["rocks"] |= {"count": 60, "prototypes": 2}
    compile_cfg(write_cfg(folder, cfg), seed=2, out=folder / "out")
    return read_stage(folder / "out" / "batch_0000" / "stage.usda")


def annotated(scene: RenderScene) -> dict:
    session, camera = Session(scene, None), scene.cameras[0][0]
    return session.render(camera, 0, session.passes(PASSES, camera), 1, 0).arrays


@pytest.mark.parametrize(("passes", "pictures"), [(["depth"], False), (["rgb", "depth"], True)])
def test_a_worker_starts_a_renderer_only_where_there_will_be_pictures(colored, passes, pictures):
    opening, keeper = Opening(str(colored.source), "mitsuba", passes=tuple(passes)), Keeper()
    told = OpenStage(opening).run(keeper)
    assert (opening.session(keeper).backend is not None) is pictures
    assert told.renderer.backend == ("mitsuba" if pictures else "annotation")


def test_a_render_of_depth_reads_no_picture(colored):
    # Pictures that are gone, or broken, do not matter to who asks for depth.
    full = annotated(colored)
    textures = colored.source.parent / "textures"
    for file in sorted(textures.iterdir()):
        file.write_bytes(b"no picture")
    scene = read_stage(colored.source, allow_missing=True)
    lean = annotated(scene)
    for name, values in full.items():
        np.testing.assert_array_equal(values, lean[name], name)
