"""Colors of vertices and corners: from files to the stage, and from other people's stages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade

from scenec.backends.stage.read import read_stage
from scenec.compiler.assets.model import read_model
from scenec.compiler.compile import compile_cfg
from scenec.testing.small import small_cfg, write_cfg

TYPES = Sdf.ValueTypeNames
COLORS = np.random.default_rng(1).uniform(0.1, 1.0, (6, 3)).astype(np.float32)
PLACED = {"type": "placed", "models": [{"file": "a.usda"}], "poses": [{"x_m": 0, "y_m": 0}]}
#: Colors that each interpolation takes, and which of them corners of the two triangles have.
KINDS = {
    "vertex": (4, [[0, 1, 2], [0, 2, 3]]),
    "faceVarying": (6, [[0, 1, 2], [3, 4, 5]]),
    "uniform": (2, [[0, 0, 0], [1, 1, 1]]),
}


def square(path: Path, kind: str) -> Usd.Stage:
    """Two triangles with displayColor, and no material."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = UsdGeom.Mesh.Define(stage, "/square")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)])
    mesh.CreateFaceVertexCountsAttr([3, 3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 0, 2, 3])
    mesh.CreateDisplayColorPrimvar(kind).Set(COLORS[: KINDS[kind][0]].tolist())
    stage.Save()
    return stage


@pytest.mark.parametrize("kind", KINDS)
def test_a_foreign_mesh_shows_display_color_at_each_corner(tmp_path, kind):
    stage = square(tmp_path / "a.usda", kind)
    scene = read_stage(tmp_path / "a.usda")
    (mesh,) = scene.meshes
    np.testing.assert_array_equal(mesh.color, COLORS[np.array(KINDS[kind][1])])
    assert scene.surfaces[mesh.layers[0]].base_color == (1.0, 1.0, 1.0)
    assert scene.losses == ()
    # Under a material with a color of its own it is not shown.
    material = UsdShade.Material.Define(stage, "/look")
    shader = UsdShade.Shader.Define(stage, "/look/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", TYPES.Color3f).Set((0.2, 0.3, 0.4))
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", TYPES.Token))
    binding = UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/square"))
    binding.Bind(material)
    stage.Save()
    (mesh,) = read_stage(tmp_path / "a.usda").meshes
    assert mesh.color is None


@pytest.mark.parametrize("kind", KINDS)
def test_colors_of_a_model_multiply_its_material_in_the_stage(tmp_path, kind):
    square(tmp_path / "a.usda", kind)
    expected = COLORS[np.array(KINDS[kind][1])]
    np.testing.assert_array_equal(read_model(tmp_path / "a.usda").colors, expected)
    cfg = small_cfg()
    cfg["objects"]["it"] = PLACED
    compile_cfg(write_cfg(tmp_path, cfg), seed=1, out=tmp_path / "out")
    scene = read_stage(tmp_path / "out" / "batch_0000" / "stage.usda")
    (mesh,) = [mesh for mesh in scene.meshes if mesh.color is not None]
    np.testing.assert_array_equal(mesh.color, expected)
    assert scene.surfaces[mesh.layers[0]].base_color == (1.0, 1.0, 1.0)


def test_faces_with_a_material_of_their_own_color_have_none_of_the_mesh(tmp_path):
    stage = square(tmp_path / "a.usda", "vertex")
    subset = UsdGeom.Subset.CreateGeomSubset(
        UsdGeom.Imageable(stage.GetPrimAtPath("/square")), "half", "face", [1], "materialBind"
    )
    material = UsdShade.Material.Define(stage, "/look")
    shader = UsdShade.Shader.Define(stage, "/look/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", TYPES.Color3f).Set((0.2, 0.3, 0.4))
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", TYPES.Token))
    UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
    stage.Save()
    colors = read_model(tmp_path / "a.usda").colors
    np.testing.assert_array_equal(colors[0], COLORS[:3])
    np.testing.assert_array_equal(colors[1], 1.0)


def test_a_class_with_a_material_of_the_cfg_has_no_colors(tmp_path):
    square(tmp_path / "a.usda", "vertex")
    cfg = small_cfg()
    cfg["objects"]["it"] = PLACED | {"material": next(iter(cfg["materials"]))}
    compile_cfg(write_cfg(tmp_path, cfg), seed=1, out=tmp_path / "out")
    scene = read_stage(tmp_path / "out" / "batch_0000" / "stage.usda")
    assert all(mesh.color is None for mesh in scene.meshes)
