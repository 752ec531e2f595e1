"""A polygon that is not convex is labeled where it is, and nowhere else."""

from __future__ import annotations

import json

import numpy as np
import pytest
from pxr import Sdf, UsdGeom, UsdShade

from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.schemas.frames import read_frame
from scenec.testing.foreign_stages import bind, label, opened

#: A C that opens to the right, 2 m by 2 m, from a corner where a fan is wrong.
C = [(1, 0), (1, 0.5), (-0.5, 0.5), (-0.5, 1.5), (1, 1.5), (1, 2), (-1, 2), (-1, 0)]
USD = """#usda 1.0
( defaultPrim = "C"
  upAxis = "Z"
  metersPerUnit = 1 )
def Mesh "C" ( prepend apiSchemas = ["SemanticsLabelsAPI:class"] )
{
    token[] semantics:labels:class = ["c"]
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = [8]
    int[] faceVertexIndices = [0, 1, 2, 3, 4, 5, 6, 7]
    point3f[] points = [%s]
}
def Camera "Camera"
{
    matrix4d xformOp:transform = ( (1,0,0,0), (0,0,1,0), (0,-1,0,0), (0,-4,1,1) )
    uniform token[] xformOpOrder = ["xformOp:transform"]
    float focalLength = 20
}
def DomeLight "Sky" {}
"""


def labeled(folder, value):
    """Where a frame has a label, and where the C covers the centers of its pixels."""
    (sidecar,) = folder.rglob("000000.json")
    frame = read_frame(sidecar)
    labels = frame.passes["label.class"]
    k, pose = (np.array(m) for m in (frame.sidecar.intrinsics, frame.sidecar.camera_to_world))
    v, u = np.mgrid[0.5 : labels.shape[0], 0.5 : labels.shape[1]]
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], axis=-1)
    rays = rays @ pose[:3, :3].T
    # It stands in the plane y = 0.
    along = -pose[1, 3] / rays[..., 1]
    x, z = (pose[i, 3] + along * rays[..., i] for i in (0, 2))
    notch = (x > -0.5) & (z > 0.5) & (z < 1.5)
    inside = (along > 0) & (abs(x) < 1) & (z > 0) & (z < 2) & ~notch
    return labels == value, inside


@pytest.mark.parametrize("winding", [1, -1])
def test_a_c_of_a_foreign_stage_has_the_pixels_that_it_covers(tmp_path, winding, workers_here):
    points = ", ".join(f"({x}, 0, {z})" for x, z in C[::winding])
    (tmp_path / "C.usda").write_text(USD % points)
    render(tmp_path / "C.usda", "annotation", passes=["label"])
    found, truth = labeled(tmp_path, 1)
    assert np.array_equal(found, truth)
    # Its hull has 93,330.
    assert truth.sum() == 58_293


def test_a_c_of_a_model_has_the_pixels_that_it_covers(tmp_path, workers_here):
    rows = "".join(f"v {x} 0 {z}\n" for x, z in C)
    (tmp_path / "C.obj").write_text(rows + "f 1 2 3 4 5 6 7 8\n")
    pose = {
        "type": "random_target",
        "position": {"x_m": 0, "y_m": -4, "height_m": 2},
        "target": {"distance_m": 4, "bearing_deg": 0, "height_m": 2},
    }
    cfg = {
        "version": 1, "name": "c", "samples": 1, "labels": {"class": {"ground": 1, "c": 2}},
        "terrain": {"size_m": [20, 20], "spacing_m": 0.5,
                    "relief": [{"type": "plane", "height_m": -1}],
                    "ground": [{"material": "m", "labels": {"class": "ground"}}]},
        "materials": {"m": {"base_color": [0.3, 0.3, 0.3]}},
        "light": {"sun": {"elevation_deg": 40}},
        "objects": {"c": {
            "type": "placed", "models": [{"file": "C.obj", "unit_m": 1, "up": "z"}],
            "material": "m", "labels": {"class": "c"}, "heights": "world",
            "poses": [{"x_m": 0, "y_m": 0, "z_m": 0}]}},
        "rigs": {"r": {"sensors": {"c": {"resolution": [160, 120], "fov_deg": 50}}, "pose": pose}},
    }  # fmt: skip
    (tmp_path / "c.json").write_text(json.dumps(cfg))
    compile_cfg(tmp_path / "c.json", seed=0, out=tmp_path / "out")
    render(tmp_path / "out", "annotation", passes=["label"])
    found, truth = labeled(tmp_path / "out", 2)
    assert np.array_equal(found, truth)
    # Its hull has 7,396.
    assert truth.sum() == 4_708


@pytest.mark.parametrize("orientation", ["rightHanded", "leftHanded"])
def test_labels_materials_and_coordinates_follow_the_triangles_of_a_concave_polygon(
    tmp_path, orientation
):
    def build(stage):
        mesh = UsdGeom.Mesh.Define(stage, "/Root/it")
        square = [(2, 0), (3, 0), (3, 1), (2, 1)]
        points = [*square, *C, (4, 0), (5, 0), (5, 1)]
        mesh.CreatePointsAttr([(x, 0, z) for x, z in points])
        mesh.CreateFaceVertexCountsAttr([4, 8, 3])
        mesh.CreateFaceVertexIndicesAttr(list(range(15)))
        mesh.CreateSubdivisionSchemeAttr("none")
        mesh.CreateOrientationAttr(orientation)
        for name, faces in (("s", [0, 2]), ("c", [1])):
            subset = UsdGeom.Subset.CreateGeomSubset(mesh, name, "face", faces, "parts")
            label(subset.GetPrim(), name)
        st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
            "st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying"
        )
        st.Set(points)
        shader = bind(stage, mesh.GetPrim())
        reader = UsdShade.Shader.Define(stage, "/Root/Looks/material/reader")
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        picture = UsdShade.Shader.Define(stage, "/Root/Looks/material/picture")
        picture.CreateIdAttr("UsdUVTexture")
        picture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set("a.png")
        picture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(
            reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        )
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(
            picture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
        )

    from PIL import Image

    Image.new("RGB", (2, 2)).save(tmp_path / "a.png")
    scene = opened(tmp_path, build)
    (mesh,) = scene.meshes
    assert mesh.authored_face.tolist() == [0] * 2 + [1] * 6 + [2]
    ids = {name: number for number, name in scene.label_names["class"].items()}
    assert mesh.labels["class"].tolist() == [ids[n] for n in ("s",) * 2 + ("c",) * 6 + ("s",)]
    corners = mesh.points[mesh.faces][..., [0, 2]]
    assert np.array_equal(mesh.uv, corners)
    (ax, ay), (bx, by) = np.moveaxis(corners[:, 1:] - corners[:, :1], (0, 1, 2), (2, 0, 1))
    area = 0.5 * (ax * by - ay * bx)
    assert (area > 0).all() if orientation == "rightHanded" else (area < 0).all()
    assert np.abs(area[2:8]).sum() == 2.5


def test_what_is_wrong_with_polygons_of_a_stage_is_a_loss(tmp_path):
    shapes = {
        "bow": ([(0, 0), (4, 4), (4, 0), (0, 2)], "crosses itself"),
        "line": ([(0, 0), (1, 1), (2, 2), (3, 3)], "has no area"),
        "twice": ([(0, 0), (4, 0), (4, 0), (4, 4)], "repeat"),
        "two": ([(0, 0), (4, 0)], "fewer than three"),
        "sound": ([(0, 0), (4, 0), (1, 1), (0, 4)], ""),
    }

    def build(stage):
        for name, (points, _) in shapes.items():
            mesh = UsdGeom.Mesh.Define(stage, f"/Root/{name}")
            mesh.CreatePointsAttr([(x, y, 0) for x, y in points])
            mesh.CreateFaceVertexCountsAttr([len(points)])
            mesh.CreateFaceVertexIndicesAttr(list(range(len(points))))
            mesh.CreateSubdivisionSchemeAttr("none")

    losses = opened(tmp_path, build).losses
    assert len(losses) == 4
    for line, (name, (_, words)) in zip(losses, shapes.items(), strict=False):
        assert words in line
        assert line.endswith(f": 1 prim, /Root/{name}")
    assert read_stage(tmp_path / "foreign.usda").losses == losses
