"""USD and PLY files as models: primvars, subsets, transforms of coordinates, colors of vertices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade
from test_assets_model import fails

from scenec.compiler.assets.model import read_model
from scenec.compiler.assets.parse import parse_model
from scenec.testing import models
from scenec.testing.models import BOX, write


def usd_box(path: Path) -> tuple[Usd.Stage, UsdGeom.Mesh]:
    stage = Usd.Stage.Open(str(write(path)))
    return stage, UsdGeom.Mesh(stage.GetPrimAtPath("/box"))


@pytest.mark.parametrize("kind", ["constant", "uniform", "vertex", "varying", "faceVarying"])
def test_usd_coordinates_of_every_interpolation_stand_at_their_corners(tmp_path, kind):
    stage, mesh = usd_box(tmp_path / "box.usda")
    mesh.GetPrim().RemoveProperty("primvars:st")
    mesh.GetPrim().RemoveProperty("primvars:st:indices")
    mesh.CreateHoleIndicesAttr([1])
    rng = np.random.default_rng(1)
    count = {"constant": 1, "uniform": 6, "vertex": 8, "varying": 8, "faceVarying": 24}[kind]
    values = rng.integers(0, 64, (count, 2)) / 64.0
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, kind)
    st.Set(values.tolist())
    stage.Save()
    index = {
        "constant": np.zeros((6, 4), int),
        "uniform": np.repeat(np.arange(6)[:, None], 4, axis=1),
        "vertex": models.QUADS,
        "varying": models.QUADS,
        "faceVarying": np.arange(24).reshape(6, 4),
    }[kind]
    expected = values[index][[0, 2, 3, 4, 5]][:, models.SPLIT].reshape(-1, 3, 2)
    model = read_model(tmp_path / "box.usda")
    assert np.array_equal(model.uv, expected)
    st.Set(values[: count - 1].tolist())
    stage.Save()
    if count > 1:
        assert "values of st" in fails(tmp_path / "box.usda")


def test_usd_parts_are_prims_and_subsets_and_can_be_asked_for(tmp_path):
    stage, mesh = usd_box(tmp_path / "box.usda")
    subset = UsdGeom.Subset(stage.GetPrimAtPath("/box/plain"))
    subset.GetIndicesAttr().Set([1, 2])
    material = UsdShade.Material.Define(stage, "/looks/unknown")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.Save()
    model = read_model(tmp_path / "box.usda")
    assert model.parts == ("/box", "/box/plain", "/box/painted")
    assert np.bincount(model.part_of_face).tolist() == [2, 4, 6]
    assert [m.name for m in model.materials] == ["unknown", "plain", "painted"]
    assert any("'unknown'" in note and "not known" in note for note in model.notes)
    chosen = read_model(tmp_path / "box.usda", part="painted")
    assert len(chosen.faces) == 6
    assert [m.name for m in chosen.materials] == ["painted"]
    assert len(read_model(tmp_path / "box.usda", part="/box").faces) == 12
    assert "no part 'lid'" in fails(tmp_path / "box.usda", part="lid")


def test_usd_left_handed_meshes_keep_their_coordinates_at_their_corners(tmp_path):
    stage, mesh = usd_box(tmp_path / "box.usda")
    mesh.CreateOrientationAttr("leftHanded")
    stage.Save()
    model = read_model(tmp_path / "box.usda")
    assert np.array_equal(model.points[model.faces], BOX[models.faces()][:, ::-1])
    assert np.array_equal(model.uv, models.uv()[:, ::-1])


def test_usd_texture_transforms_are_applied_and_downward_normals_told(tmp_path):
    stage, _ = usd_box(tmp_path / "box.usda")
    types = Sdf.ValueTypeNames
    node = UsdShade.Shader.Define(stage, "/looks/painted/move")
    node.CreateIdAttr("UsdTransform2d")
    reader = UsdShade.Shader(stage.GetPrimAtPath("/looks/painted/st"))
    node.CreateInput("in", types.Float2).ConnectToSource(reader.GetOutput("result"))
    node.CreateInput("rotation", types.Float).Set(90.0)
    node.CreateInput("scale", types.Float2).Set((2, 3))
    node.CreateInput("translation", types.Float2).Set((0.25, 0.5))
    moved = node.CreateOutput("result", types.Float2)
    for key in ("diffuseColor", "roughness", "metallic", "normal"):
        texture = UsdShade.Shader(stage.GetPrimAtPath(f"/looks/painted/{key}"))
        texture.GetInput("st").ConnectToSource(moved)
        if key == "normal":
            texture.GetInput("scale").Set((2, -2, 2, 1))
    stage.Save()
    model = read_model(tmp_path / "box.usda")
    u, v = models.uv()[6:, :, 0], models.uv()[6:, :, 1]
    assert np.array_equal(model.uv[6:], np.stack([-3 * v + 0.25, 2 * u + 0.5], axis=-1))
    assert np.array_equal(model.uv[:6], models.uv()[:6])
    assert model.materials[1].normal_convention == "directx"


def ply(path: Path, header: str, rows: list[str]) -> Path:
    kinds = header.split()
    lines = ["ply", "format ascii 1.0", "element vertex 3"]
    lines += [f"property {'uchar' if k in 'red green blue' else 'float'} {k}" for k in kinds]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    path.write_text("\n".join([*lines, *rows, "3 0 1 2"]) + "\n")
    return path


def test_ply_colors_are_of_its_vertices_and_its_picture_lies_on_its_coordinates(tmp_path):
    rows = ["0 0 0 255 0 0", "1 0 0 255 0 188", "0 1 0 255 0 0"]
    file = ply(tmp_path / "a.ply", "x y z red green blue", rows)
    model = read_model(file, unit_m=1, up="z")
    (material,) = model.materials
    blue = ((188 / 255 + 0.055) / 1.055) ** 2.4
    assert material.base_color == (1.0, 1.0, 1.0)
    expected = np.array([[[1, 0, 0], [1, 0, blue], [1, 0, 0]]], np.float32)
    np.testing.assert_allclose(model.colors, expected, rtol=1e-6)
    models.write_pictures(tmp_path)
    file = ply(tmp_path / "b.ply", "x y z s t", ["0 0 0 0 0", "1 0 0 .5 0", "0 1 0 0 .25"])
    text = file.read_text().replace("element v", "comment TextureFile tex/color.png\nelement v")
    file.write_text(text)
    model = read_model(file, unit_m=1, up="z")
    assert np.array_equal(model.uv, [[[0, 0], [0.5, 0], [0, 0.25]]])
    assert parse_model(file).companions == (tmp_path / "tex" / "color.png",)
    assert model.materials[0].pictures == {"base_color": tmp_path / "tex" / "color.png"}
