"""Opacity that is no picture: what is there of it, by the stated threshold."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Sdf, UsdGeom, UsdShade

from scenec.schemas.errors import StageError
from scenec.testing.foreign_stages import bind, opened, polygons, square

TYPES = Sdf.ValueTypeNames
BLENDED = "opacity of UsdPreviewSurface without opacityThreshold is no blend"
FADED = "displayOpacity is no blend"

#: opacity, opacityThreshold, opacityMode; whether it is there, and what is said.
CONSTANTS = {
    "opaque": (1.0, 0.0, None, True, None),
    "mostly there": (0.6, 0.0, None, True, BLENDED),
    "mostly not there": (0.4, 0.0, None, False, BLENDED),
    "by presence": (0.4, 0.0, "presence", False, BLENDED),
    "above its own threshold": (0.4, 0.3, None, True, None),
    "at its own threshold": (0.25, 0.25, None, True, None),
    "below its own threshold": (0.8, 0.9, "transparent", False, None),
}


def surface_of(stage, prim, opacity, threshold, mode):
    shader = bind(stage, prim)
    shader.CreateInput("opacity", TYPES.Float).Set(opacity)
    shader.CreateInput("opacityThreshold", TYPES.Float).Set(threshold)
    if mode is not None:
        shader.CreateInput("opacityMode", TYPES.Token).Set(mode)


@pytest.mark.parametrize("shape", ["mesh", "sphere"])
@pytest.mark.parametrize("name", CONSTANTS)
def test_a_surface_of_one_opacity_is_there_or_not(tmp_path, name, shape):
    opacity, threshold, mode, there, said = CONSTANTS[name]

    def build(stage):
        prim = square(stage, "/Root/it").GetPrim()
        if shape == "sphere":
            stage.RemovePrim("/Root/it")
            prim = UsdGeom.Sphere.Define(stage, "/Root/it").GetPrim()
        surface_of(stage, prim, opacity, threshold, mode)

    scene = opened(tmp_path, build)
    assert len(scene.rows.mesh) == there
    assert [line.startswith(said or "") for line in scene.losses] == [True] * (said is not None)


def test_of_a_mesh_s_materials_only_the_clear_one_is_not_there(tmp_path):
    def build(stage):
        mesh = two_squares(stage)
        subset = UsdGeom.Subset.CreateGeomSubset(
            UsdGeom.Imageable(mesh), "pane", "face", [1], "materialBind", "partition"
        )
        surface_of(stage, subset.GetPrim(), 0.1, 0.0, None)

    (mesh,) = opened(tmp_path, build).meshes
    np.testing.assert_array_equal(np.unique(mesh.authored_face), [0])
    assert len(mesh.points) == 4


def two_squares(stage):
    points = [(x, y, 0) for x in range(3) for y in range(2)]
    return polygons(stage, "/Root/it", points, [4, 4], [0, 2, 3, 1, 2, 4, 5, 3])


#: Values by interpolation; authored faces of the triangles that are there. Vertices 4 and 5 are of
#: the second square alone, which is cut from its first corner: (2, 4, 5) and (2, 5, 3).
DISPLAYED = {
    "constant, there": ("constant", [0.6], [0, 0, 1, 1]),
    "constant, not there": ("constant", [0.4], []),
    "uniform": ("uniform", [0.1, 0.9], [1, 1]),
    "vertex": ("vertex", [1, 1, 1, 1, 0, 0], [0, 0, 1]),
    "faceVarying": ("faceVarying", [1, 1, 1, 1, 1, 1, 0, 0], [0, 0, 1]),
}


@pytest.mark.parametrize("by_material", [False, True])
@pytest.mark.parametrize("name", DISPLAYED)
def test_triangles_of_a_mean_opacity_below_the_threshold_are_not_there(tmp_path, name, by_material):
    kind, values, kept = DISPLAYED[name]

    def build(stage):
        mesh = two_squares(stage)
        mesh.CreateDisplayOpacityPrimvar(kind).Set(values)
        if by_material:
            shader = bind(stage, mesh.GetPrim())
            reader = UsdShade.Shader.Define(stage, "/Root/Looks/material/reader")
            reader.CreateIdAttr("UsdPrimvarReader_float")
            reader.CreateInput("varname", TYPES.String).Set("displayOpacity")
            output = reader.CreateOutput("result", TYPES.Float)
            shader.CreateInput("opacity", TYPES.Float).ConnectToSource(output)

    scene = opened(tmp_path, build)
    found = [mesh.authored_face for mesh in scene.meshes]
    np.testing.assert_array_equal(np.concatenate([*found, np.zeros(0, int)]), kept)
    (line,) = scene.losses
    assert line.startswith(FADED)


def test_a_material_of_its_own_opacity_is_not_concerned_with_displayed_one(tmp_path):
    def build(stage):
        mesh = two_squares(stage)
        mesh.CreateDisplayOpacityPrimvar("constant").Set([0.1])
        bind(stage, mesh.GetPrim())

    scene = opened(tmp_path, build)
    assert len(scene.meshes[0].faces) == 4
    assert scene.losses == ()


def test_opacities_of_another_length_are_a_fault(tmp_path):
    def build(stage):
        two_squares(stage).CreateDisplayOpacityPrimvar("vertex").Set([0.1, 0.2])

    with pytest.raises(StageError, match=r"displayOpacity \(vertex\) must hold 6 finite numbers"):
        opened(tmp_path, build)
