"""Subdivision surfaces of models are those that a stage's reader draws."""

from __future__ import annotations

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from scenec.backends.stage.read import read_stage
from scenec.compiler.assets.usd_model import read_usd_model

CORNERS = [0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]


def test_a_model_is_refined_as_a_stage_is_with_its_subsets_holes_and_texture(tmp_path):
    file = tmp_path / "cube.usda"
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = UsdGeom.Mesh.Define(stage, "/cube")
    stage.SetDefaultPrim(mesh.GetPrim())
    mesh.CreatePointsAttr([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(CORNERS)
    mesh.CreateCreaseIndicesAttr([0, 1, 3, 2, 0])
    mesh.CreateCreaseLengthsAttr([5])
    mesh.CreateCreaseSharpnessesAttr([10.0])
    mesh.CreateHoleIndicesAttr([1])
    mesh.CreateOrientationAttr("leftHanded")
    mesh.CreateNormalsAttr([(0, 0, 1)] * 8)
    uv = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying"
    )
    uv.Set(Vt.Vec2fArray([(i % 3, i // 3) for i in range(8)]))
    uv.SetIndices(Vt.IntArray(CORNERS))
    UsdGeom.Subset.CreateGeomSubset(mesh, "floor", "face", Vt.IntArray([0]))
    stage.Save()
    (drawn,) = read_stage(file).meshes
    model = read_usd_model(file, True)
    rest, floor = model.parts
    count = len(drawn.faces)
    assert len(rest.faces) + len(floor.faces) == count > 5 * 100
    authored = drawn.authored_face
    assert len(floor.faces) == (authored == 0).sum() == count / 5
    assert set(authored.tolist()) == {0, 2, 3, 4, 5}
    for part, own in ((floor, authored == 0), (rest, authored != 0)):
        # Both turn triangles over, around another corner.
        at, normals = (np.roll(v, 1, axis=1) for v in (part.points[part.faces], part.normals))
        assert np.allclose(at, drawn.points[drawn.faces[own]], atol=1e-6)
        assert np.allclose(normals, drawn.normals[drawn.faces[own]], atol=1e-6)
    # Left-handed, so inward; the floor is flat up to its sharp rim.
    assert np.allclose(floor.normals, (0, 0, 1), atol=1e-6)
    assert np.allclose(floor.points[:, 2], -1.0)
    # Texture coordinates are smooth in the floor, and pinned nowhere on it: they span less.
    assert 0.0 <= floor.uv["st"].min() < floor.uv["st"].max() < 2.0
    assert model.notes == ("/cube: its normals give way to those of its subdivision surface",)
