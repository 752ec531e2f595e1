"""Renderers that are asked for annotation alone make no materials, no pictures and no light."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest
from small import small_cfg, write_cfg

from scenec.backends.bare import bare
from scenec.backends.mitsuba.variant import load_mitsuba
from scenec.backends.reader import read_stage
from scenec.backends.registry import open_backend
from scenec.backends.render_scene import RenderScene
from scenec.backends.session import Session
from scenec.backends.worker import Worker
from scenec.compiler.compile import compile_cfg

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


def test_a_bare_scene_has_the_geometry_and_labels_and_nothing_to_see(colored):
    scene = bare(colored)
    assert scene.rows is colored.rows
    assert scene.digest == colored.digest
    assert scene.surfaces == ()
    assert all(not (light.suns or light.domes or light.lamps) for light in scene.lighting)
    for mesh, whole in zip(scene.meshes, colored.meshes, strict=True):
        assert mesh.points is whole.points
        assert mesh.faces is whole.faces
        assert mesh.labels is whole.labels
        assert mesh.layers == ()
        assert mesh.normals is None
        assert mesh.uv is None
        assert mesh.weights.shape == (0, len(mesh.points))


def annotated(scene: RenderScene, name: str, pictures: bool) -> tuple[dict, Session]:
    session = Session(scene, open_backend(name))
    session.pictures = pictures
    camera = scene.cameras[0][0]
    return session.render(camera, 0, session.passes(PASSES, camera), 1, 0)[0], session


def test_annotation_is_the_same_to_the_bit_without_what_pictures_need(colored):
    full, _ = annotated(colored, "reference", True)
    lean, _ = annotated(colored, "reference", False)
    for name, values in full.items():
        np.testing.assert_array_equal(values, lean[name], name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mitsuba", "cycles", "pyrender"])
def test_renderers_see_the_same_in_a_bare_scene(colored, name):
    # Not imported here: PyOpenGL binds to whatever it finds first.
    if find_spec({"cycles": "bpy"}.get(name, name)) is None:
        pytest.skip(f"{name} is not installed")
    full, _ = annotated(colored, "reference", True)
    lean, _ = annotated(colored, name, False)
    for key, values in full.items():
        np.testing.assert_array_equal(values, lean[key], key)


@pytest.mark.slow
def test_mitsuba_makes_one_plain_surface_for_annotation(colored):
    if find_spec("mitsuba") is None:
        pytest.skip("mitsuba is not installed")
    mi = load_mitsuba()
    found = {}
    for pictures in (True, False):
        _, session = annotated(colored, "mitsuba", pictures)
        keys = mi.traverse(session.backend._scene).keys()
        mixed = [key for key in keys if "vertex_mix" in key]
        surfaces = [str(shape.bsdf()) for shape in session.backend._scene.shapes()]
        found[pictures] = mixed, surfaces
    assert found[True][0]
    assert any("LayerMix" in text for text in found[True][1])
    mixed, surfaces = found[False]
    assert mixed == []
    assert len(surfaces) == 1
    assert "SmoothDiffuse" in surfaces[0]
    assert not any(word in surfaces[0] for word in ("LayerMix", "Ggx", "itmap"))


@pytest.mark.parametrize(("passes", "pictures"), [(["depth"], False), (["rgb", "depth"], True)])
def test_a_worker_knows_from_its_passes_whether_there_will_be_pictures(colored, passes, pictures):
    worker = Worker()
    request = {"op": "open", "stage": str(colored.source), "backend": "reference"}
    assert worker.answer(request | {"passes": passes})["ok"]
    assert worker._session.pictures is pictures


def test_a_render_of_depth_reads_no_picture(colored):
    # Pictures that are gone, or broken, do not matter to who asks for depth.
    full, _ = annotated(colored, "reference", False)
    textures = colored.source.parent / "textures"
    for file in sorted(textures.iterdir()):
        file.write_bytes(b"no picture")
    scene = read_stage(colored.source, allow_missing=True)
    lean, _ = annotated(scene, "reference", False)
    for name, values in full.items():
        np.testing.assert_array_equal(values, lean[name], name)
