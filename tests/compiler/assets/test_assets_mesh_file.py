"""Mesh files: the same mesh whatever the format, sound whatever the file."""

from __future__ import annotations

import base64
import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Gf, Sdf, Usd, UsdGeom

from scenec.compiler.assets.model import MeshModel, read_model
from scenec.compiler.assets.parse import parse_model
from scenec.compiler.geometry.affine import TO_Z_UP, about_axis, sin_cos
from scenec.schemas.errors import SceneError
from scenec.testing import models
from scenec.testing.overhangs import FORMATS, glb, gltf_document, keys, shelter, triangles, write

read_mesh = partial(read_model, looks=False)
BOX = np.array([[x, y, z] for x in (0, 2) for y in (0, 3) for z in (0, 5)], float)
BOX_QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)


def ours(mesh: MeshModel) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.points, mesh.faces, process=False)


def fails(path: Path, **choice) -> str:
    with pytest.raises(SceneError) as caught:
        read_mesh(path, **choice)
    message = str(caught.value)
    assert message.startswith(f"{path.name}: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_gives_the_mesh_that_was_written(tmp_path, suffix):
    points, quads = shelter(12)
    mesh = read_mesh(write(tmp_path / f"a.{suffix}", points, quads), **keys(suffix))
    assert np.array_equal(mesh.points, points)
    assert np.array_equal(mesh.faces, triangles(quads))
    assert (mesh.degenerate, mesh.welded, len(mesh.parts)) == (0, 0, 1)


MIXED = [[0, 1, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4],
         [1, 5, 7, 3]]  # fmt: skip


def ply_box(path: Path, kind: str, extra: bool, polygons: list[list[int]]) -> Path:
    """The box as PLY, with or without properties besides positions and polygons."""
    order = ">" if "big" in kind else "<"
    header = f"ply\ncomment \xe9\nformat {kind} 1.0\nelement vertex 8\n"
    header += "property uchar red\n" if extra else ""
    header += "property double x\nproperty double y\nproperty double z\n"
    header += f"element face {len(polygons)}\n" + ("property float quality\n" if extra else "")
    header += "property list uchar uint vertex_index\nend_header\n"
    body = b""
    for x, y, z in BOX:
        if kind == "ascii":
            body += f"{'9 ' if extra else ''}{x} {y} {z}\n".encode()
        else:
            body += (b"\x09" if extra else b"") + np.array([x, y, z], order + "f8").tobytes()
    for polygon in polygons:
        if kind == "ascii":
            body += (
                f"{'0.5 ' if extra else ''}{len(polygon)} {' '.join(map(str, polygon))}\n".encode()
            )
        else:
            body += np.array([0.5], order + "f4").tobytes() if extra else b""
            body += bytes([len(polygon)]) + np.array(polygon, order + "u4").tobytes()
    path.write_bytes(header.encode("latin-1") + body)
    return path


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("extra", [False, True])
def test_ply_comes_as_text_and_in_either_byte_order(tmp_path, kind, extra):
    mesh = read_mesh(
        ply_box(tmp_path / "box.ply", kind, extra, BOX_QUADS.tolist()), unit_m=1, up="z"
    )
    assert np.array_equal(mesh.points, BOX)
    assert np.array_equal(mesh.faces, triangles(BOX_QUADS))


@pytest.mark.parametrize("extra", [False, True])
def test_ply_polygons_of_several_kinds_are_fans_in_text_and_refused_in_binary(tmp_path, extra):
    path = ply_box(tmp_path / "box.ply", "ascii", extra, MIXED)
    mesh = read_mesh(path, unit_m=1, up="z")
    fan = [[p[0], p[k], p[k + 1]] for p in MIXED for k in range(1, len(p) - 1)]
    assert np.array_equal(mesh.faces, fan)
    path = ply_box(tmp_path / "box.ply", "binary_little_endian", extra, MIXED)
    assert "polygons differ in their numbers of corners" in fails(path, unit_m=1, up="z")
    # As many bytes as quads alone would have: trimesh takes it for them.
    even = [[0, 1, 3, 2], [4, 6, 7], [0, 4, 5, 1, 0]]
    path = ply_box(tmp_path / "box.ply", "binary_little_endian", extra, even)
    assert "polygons differ in their numbers of corners" in fails(path, unit_m=1, up="z")


def solid(name: str, triangle: np.ndarray) -> str:
    """A solid of an STL file in text."""
    corners = [f"vertex {x!r} {y!r} {z!r}\n" for x, y, z in triangle.reshape(-1, 3).tolist()]
    facets = ["".join(corners[k : k + 3]) for k in range(0, len(corners), 3)]
    loops = [f"facet normal 0 0 1\nouter loop\n{f}endloop\nendfacet\n" for f in facets]
    return f"solid {name}\n{''.join(loops)}endsolid {name}\n"


def binary_stl(corners: np.ndarray) -> bytes:
    rows = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("n", "<u2")])
    rows["corners"] = corners
    return bytes(80) + np.array([len(rows)], "<u4").tobytes() + rows.tobytes()


def test_stl_in_binary_and_text_is_the_surface_that_was_written(tmp_path):
    corners = BOX[triangles(BOX_QUADS)]
    first = np.unique(triangles(BOX_QUADS).ravel(), return_index=True)[1]
    expected = BOX[triangles(BOX_QUADS).ravel()[np.sort(first)]]
    (tmp_path / "b.stl").write_bytes(binary_stl(corners))
    (tmp_path / "t.stl").write_text(solid("left", corners[:5]) + solid("Right", corners[5:]))
    for name in ("b.stl", "t.stl"):
        mesh = read_mesh(tmp_path / name, unit_m=1, up="z")
        assert np.array_equal(mesh.points, expected)
        assert np.array_equal(mesh.points[mesh.faces], corners)
        assert mesh.welded == 28
        assert "give unit_m" in fails(tmp_path / name, up="z")
    assert mesh.parts == ("left", "Right")
    assert len(read_mesh(tmp_path / "t.stl", unit_m=1, up="z", part="Right").faces) == 7


def test_what_trimesh_remarks_does_not_reach_users(tmp_path, capsys):
    path = tmp_path / "a.stl"
    path.write_text(solid("a", BOX[:3]).replace("normal 0 0 1", "normal x"))
    assert len(read_mesh(path, unit_m=1, up="z").faces) == 1
    assert capsys.readouterr() == ("", "")


def test_off_is_the_surface_that_was_written(tmp_path):
    rows = [" ".join(map(repr, point)) for point in BOX.tolist()]
    rows += [f"{len(p)} {' '.join(map(str, p))}" for p in triangles(BOX_QUADS).tolist()]
    path = tmp_path / "a.off"
    path.write_text("OFF # a box\n8 12 0\n" + "\n".join(rows) + "\n")
    mesh = read_mesh(path, unit_m=1, up="z")
    assert np.array_equal(mesh.points, BOX)
    assert np.array_equal(mesh.faces, triangles(BOX_QUADS))
    assert "give up" in fails(path, unit_m=1)


def test_obj_parts_are_objects_or_groups_in_the_file_s_order(tmp_path):
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in BOX)
    path = tmp_path / "a.obj"
    path.write_text(
        f"mtllib none.mtl\n{vertices}o rock/1\ng x\nusemtl a\nf 1 2 4\nusemtl b\nf 1 4 3\n"
        "o \u00e9\nusemtl a\nf 5/1 7/1 8/1 # one\n\tf\t5//2 8//2 6//2\n"
    )
    mesh = read_mesh(path, unit_m=1, up="z")
    assert mesh.parts == ("rock/1", "\u00e9")
    assert mesh.part_of_face.tolist() == [0, 0, 1, 1]
    assert np.array_equal(
        mesh.points[mesh.faces], BOX[[[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]]]
    )
    path.write_text(path.read_text().replace("o ", "g ").replace("g x\n", ""))
    assert read_mesh(path, unit_m=1, up="z").parts == ("rock/1", "\u00e9")


def test_obj_faces_of_one_file_may_differ_in_corners_and_in_what_they_name(tmp_path):
    path = tmp_path / "a.obj"
    hexagon = [[np.cos(k * np.pi / 3), np.sin(k * np.pi / 3), 0.0] for k in range(6)]
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.array(hexagon).tolist()]
    # A hexagon and a triangle with normals: six numbers in both lines.
    path.write_text("\n".join([*lines, "vn 0 0 1", "f 1 2 3 4 5 6", "f 1//1 2//1 4//1"]) + "\n")
    mesh = read_mesh(path, unit_m=1, up="z")
    expected = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 1, 3]]
    assert np.array_equal(mesh.points[mesh.faces], np.array(hexagon)[expected])


def test_without_trimesh_the_extra_to_install_is_named(tmp_path, monkeypatch):
    path = write(tmp_path / "a.ply", BOX, BOX_QUADS)
    monkeypatch.setitem(sys.modules, "trimesh.exchange.load", None)
    assert "pip install 'scenec[meshes]'" in fails(path, unit_m=1, up="z")
    for suffix in ("obj", "glb", "usda"):
        other = write(tmp_path / f"a.{suffix}", BOX, BOX_QUADS)
        assert len(read_mesh(other, unit_m=1, up="z").faces) == 12


def test_what_a_model_looks_like_is_not_read_for_a_terrain(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(
        "mtllib missing.mtl\nvt bad\nusemtl rock\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/9/9 2/9/9 3/9/9\n"
    )
    assert read_mesh(path, unit_m=1, up="z").faces.tolist() == [[0, 1, 2]]
    with pytest.raises(SceneError, match="texture coordinate 8"):
        read_model(path, unit_m=1, up="z")


def test_only_a_mesh_file_that_needs_it_imports_trimesh(tmp_path):
    program = (
        "import sys; from pathlib import Path; import scenec.compiler.build\n"
        "from scenec.compiler.assets.model import read_model\n"
        "for name in sys.argv[1:]:\n"
        "    read_model(Path(name), unit_m=1, up='z', looks=False)\n"
        "    assert ('trimesh' in sys.modules) == name.endswith('.ply')\n"
    )
    suffixes = ("usda", "glb", "obj", "ply")
    files = [write(tmp_path / f"a.{suffix}", BOX, BOX_QUADS) for suffix in suffixes]
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, files)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""


def test_a_pentagon_becomes_three_triangles_of_its_area(tmp_path):
    angle = 2.0 * np.pi * np.arange(5) / 5
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    mesh = read_mesh(write(tmp_path / "p.ply", points, np.arange(5)[None]), unit_m=1, up="z")
    assert len(mesh.faces) == 3
    assert ours(mesh).area == pytest.approx(2.5 * np.sin(2.0 * np.pi / 5), rel=1e-6)


def test_copies_of_a_vertex_are_one_and_keep_the_order_of_their_first(tmp_path):
    path = tmp_path / "box.obj"
    corners = BOX[BOX_QUADS.ravel()]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    # Counted from the end, as some exporters do; a zero of either sign is a zero.
    lines += [f"f {4 * k - 24} {4 * k - 23} {4 * k - 22} {4 * k - 21}" for k in range(6)]
    path.write_text("\n".join(lines).replace("0.0", "-0.0", 3) + "\n")
    mesh = read_mesh(path, unit_m=1, up="z")
    first = np.unique(BOX_QUADS.ravel(), return_index=True)[1]
    assert np.array_equal(mesh.points, BOX[BOX_QUADS.ravel()[np.sort(first)]])
    assert mesh.welded == 16
    assert ours(mesh).is_watertight
    assert ours(mesh).volume == pytest.approx(30.0, rel=1e-14)


def test_faces_without_area_are_dropped_and_counted_and_stray_vertices_with_them(tmp_path):
    path = tmp_path / "d.obj"
    path.write_text(
        "v 0 0 0\nv nan 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nv 0 0 0\n"
        "f 1 3 4\nf 1 3 5\nf 1 6 4\nf 3 3 4\n"
    )
    mesh = read_mesh(path, unit_m=1, up="z")
    assert np.array_equal(mesh.points, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert np.array_equal(mesh.faces, [[0, 1, 2]])
    assert mesh.degenerate == 3


@pytest.mark.parametrize("up", sorted(TO_Z_UP))
def test_the_upward_axis_becomes_z_by_a_turn(up):
    turn = np.array(TO_Z_UP[up], float)
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up.startswith("-") else 1.0
    assert np.array_equal(turn @ axis, [0, 0, 1])
    assert np.linalg.det(turn) == 1.0


def test_quarter_turns_are_exact_and_others_those_of_the_math_library():
    for quarter in range(-8, 9):
        s, c = sin_cos(90.0 * quarter)
        assert (s, c) == ((0, 1, 0, -1)[quarter % 4], (1, 0, -1, 0)[quarter % 4])
    for degrees in np.linspace(-400, 400, 81):
        expected = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
        assert sin_cos(degrees) == pytest.approx(expected, abs=1e-15)
    assert np.allclose(about_axis(2, 90.0)[:3, :3] @ [1, 0, 0], [0, 1, 0], atol=0)


def test_unit_and_axis_come_from_the_file_from_the_caller_or_are_asked_for(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usda"))
    mesh = UsdGeom.Mesh.Define(stage, "/box")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr(BOX.tolist())
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(BOX_QUADS.ravel().tolist())
    stage.Save()
    assert "give unit_m" in fails(tmp_path / "a.usda", up="y")
    assert "give up" in fails(tmp_path / "a.usda", unit_m=1)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.Save()
    read = read_mesh(tmp_path / "a.usda")
    assert np.allclose(np.ptp(read.points, axis=0), [0.02, 0.05, 0.03], atol=1e-17)
    read = read_mesh(tmp_path / "a.usda", unit_m=2.0, up="z")
    assert np.array_equal(np.ptp(read.points, axis=0), [4.0, 6.0, 10.0])
    write(tmp_path / "a.obj", BOX, BOX_QUADS)
    assert "give unit_m" in fails(tmp_path / "a.obj", up="z")
    assert "give up" in fails(tmp_path / "a.obj", unit_m=1)


def test_usd_transforms_are_those_of_usd(tmp_path):
    path = tmp_path / "deep.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    xform = UsdGeom.Xform.Define(stage, "/a")
    xform.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    pivot = xform.AddTranslateOp(opSuffix="pivot")
    pivot.Set(Gf.Vec3d(0.5, -1, 2))
    xform.AddRotateXYZOp().Set(Gf.Vec3f(11, 22, 33))
    xform.AddRotateZYXOp(opSuffix="again").Set(Gf.Vec3f(-40, 5, 70))
    xform.AddScaleOp().Set(Gf.Vec3f(1, 2, 0.5))
    xform.AddTranslateOp(opSuffix="pivot", isInverseOp=True)
    inner = UsdGeom.Xform.Define(stage, "/a/b")
    inner.AddRotateYOp().Set(77.0)
    inner.AddOrientOp().Set(Gf.Quatf(0.6, 0.0, 0.8, 0.0))
    inner.AddRotateYXZOp().Set(Gf.Vec3f(3, 5, 7))
    inner.AddTransformOp().Set(Gf.Matrix4d(Gf.Rotation(Gf.Vec3d(1, 1, 0), 20), Gf.Vec3d(4, 5, 6)))
    mesh = UsdGeom.Mesh.Define(stage, "/a/b/box")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.AddRotateXOp(opSuffix="back", isInverseOp=False).Set(-15.0)
    mesh.AddScaleOp().Set(Gf.Vec3f(-1, 1, 1))
    mesh.CreatePointsAttr(BOX.tolist())
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(BOX_QUADS.ravel().tolist())
    stage.Save()
    matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(mesh.GetPrim()))
    expected = BOX @ matrix[:3, :3] + matrix[3, :3]
    read = read_mesh(path)
    assert np.allclose(read.points, expected, rtol=0, atol=1e-12)
    # Mirrored, so that it would be inside out without a turn of its faces.
    assert ours(read).volume == pytest.approx(30.0, rel=1e-12)


def test_usd_left_handed_holes_visibility_and_instances_count(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)

    def box(path: str, quads: np.ndarray) -> UsdGeom.Mesh:
        mesh = UsdGeom.Mesh.Define(stage, path)
        mesh.CreateSubdivisionSchemeAttr("none")
        mesh.CreatePointsAttr(BOX.tolist())
        mesh.CreateFaceVertexCountsAttr([4] * 6)
        mesh.CreateFaceVertexIndicesAttr(quads.ravel().tolist())
        return mesh

    box("/left", BOX_QUADS[:, ::-1]).CreateOrientationAttr("leftHanded")
    box("/hidden", BOX_QUADS).MakeInvisible()
    box("/guide", BOX_QUADS).CreatePurposeAttr("guide")
    holed = box("/holed", BOX_QUADS)
    holed.CreateHoleIndicesAttr([5])
    holed.AddTranslateOp().Set(Gf.Vec3d(10, 0, 0))
    box("/Library/kit/box", BOX_QUADS)
    stage.GetPrimAtPath("/Library").SetSpecifier(Sdf.SpecifierOver)
    for i in range(2):
        prim = UsdGeom.Xform.Define(stage, f"/copy{i}")
        prim.GetPrim().GetReferences().AddInternalReference("/Library/kit")
        prim.GetPrim().SetInstanceable(True)
        prim.AddTranslateOp().Set(Gf.Vec3d(0, 10 + 10 * i, 0))
    stage.Save()
    mesh = read_mesh(tmp_path / "a.usda")
    assert mesh.parts == ("/left", "/holed", "/copy0/box", "/copy1/box")
    assert np.bincount(mesh.part_of_face).tolist() == [12, 10, 12, 12]
    assert ours(read_mesh(tmp_path / "a.usda", part="left")).volume == pytest.approx(30.0)
    assert ours(read_mesh(tmp_path / "a.usda", part="/copy1")).bounds[0, 1] == 20.0
    UsdGeom.PointInstancer.Define(stage, "/many")
    stage.Save()
    assert "/many is a point instancer" in fails(tmp_path / "a.usda")


def test_usd_that_takes_in_other_files_is_refused(tmp_path):
    write(tmp_path / "inner.usda", BOX, BOX_QUADS)
    stage = Usd.Stage.CreateNew(str(tmp_path / "outer.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.DefinePrim("/a").GetReferences().AddReference("./inner.usda", "/World")
    stage.Save()
    assert "takes in another file (inner.usda)" in fails(tmp_path / "outer.usda")


def test_a_usdz_package_is_one_file(tmp_path):
    from pxr import UsdUtils

    points, quads = shelter(8)
    write(tmp_path / "a.usdc", points, quads)
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "a.usdc"), str(tmp_path / "a.usdz"))
    assert np.array_equal(read_mesh(tmp_path / "a.usdz").points, points)


def test_gltf_nodes_are_placed_by_what_stands_above_them(tmp_path):
    points = BOX.astype("<f4")
    faces = BOX_QUADS[:, [0, 1, 2, 0, 2, 3]].astype("<u4")
    document = gltf_document(8, 36)
    document["scenes"] = [{"nodes": [0]}]
    document["nodes"] = [
        # x to -z, y to x, z to -y.
        {"name": "top", "children": [1, 2], "rotation": [0.5, 0.5, -0.5, 0.5]},
        {"name": "a", "mesh": 0, "translation": [1, 2, 3], "scale": [1, 2, -3]},
        {"name": "b", "children": [3], "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 7, 8, 9, 1]},
        # About y by the angle of sine 0.96.
        {"mesh": 0, "rotation": [0, 0.6, 0, 0.8]},
    ]
    path = tmp_path / "a.glb"
    path.write_bytes(glb(document, points.tobytes() + faces.tobytes()))
    mesh = read_mesh(path)
    assert mesh.parts == ("/top/a", "/top/b/node_3")

    def top(x, y, z):
        return np.stack([y, -z, -x], axis=1)

    x, y, z = BOX.T
    a = top(x + 1, 2 * y + 2, -3 * z + 3)
    turned_x, turned_z = 0.28 * x + 0.96 * z, -0.96 * x + 0.28 * z
    b = top(-y + 7, turned_x + 8, turned_z + 9)
    expected = np.concatenate([a, b])
    y_up = np.stack([mesh.points[:, 0], mesh.points[:, 2], -mesh.points[:, 1]], axis=1)
    assert np.allclose(y_up, expected, rtol=0, atol=1e-14)
    for part, volume in (("a", 180.0), ("b", 30.0)):
        assert ours(read_mesh(path, part=part)).volume == pytest.approx(volume, rel=1e-12)


def test_gltf_strips_small_integers_and_data_uris(tmp_path):
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]], "<i2")
    document = gltf_document(4, 0)
    document["extensionsRequired"] = ["KHR_mesh_quantization"]
    attributes = {"POSITION": 0}
    other = np.array([1, 3, 0, 2], "u1")
    document["meshes"][0]["primitives"] = [
        {"attributes": attributes, "mode": 5},
        {"attributes": attributes, "mode": 5, "indices": 1},
        {"attributes": attributes, "mode": 0},
    ]
    document["accessors"] = [
        {"bufferView": 0, "componentType": 5122, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5121, "count": 4, "type": "SCALAR"},
    ]
    padded = np.zeros((4, 4), "<i2")
    padded[:, :3] = points
    document["bufferViews"] = [
        {"buffer": 0, "byteOffset": 0, "byteLength": 32, "byteStride": 8},
        {"buffer": 0, "byteOffset": 32, "byteLength": 4},
    ]
    data = base64.b64encode(padded.tobytes() + other.tobytes()).decode()
    uri = f"data:application/octet-stream;base64,{data}"
    document["buffers"] = [{"byteLength": 36, "uri": uri}]
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(document))
    mesh = read_mesh(path)
    assert len(mesh.faces) == 4
    triangle = mesh.points[mesh.faces]
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    # All four face the same way, glTF's +z, and cover the square twice.
    assert np.array_equal(normal, [[0, -4, 0]] * 4)
    # Shorts that stand for -1 to 1.
    document["accessors"][0]["normalized"] = True
    path.write_text(json.dumps(document))
    assert np.array_equal(read_mesh(path).points, mesh.points / 32767.0)
    document["meshes"][0]["primitives"] = [{"attributes": attributes, "mode": 6}]
    path.write_text(json.dumps(document))
    fan = read_mesh(path).faces.tolist()
    assert [sorted(face) for face in fan] == [[0, 1, 2], [0, 2, 3]]


def test_a_buffer_beside_a_gltf_is_read_and_its_pictures_are_not(tmp_path):
    whole = read_mesh(models.write(tmp_path / "box.glb"))
    mesh = read_mesh(models.write(tmp_path / "box.gltf"))
    assert np.array_equal(mesh.points[mesh.faces], whole.points[whole.faces])
    found = parse_model(tmp_path / "box.gltf", looks=False).companions
    assert [path.name for path in found] == ["box data.bin"]
