"""Mesh files: the same mesh whatever the format, sound whatever the file."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from overhangs import FORMATS, glb, gltf_document, keys, shelter, triangles, write
from pxr import Gf, Sdf, Usd, UsdGeom

from scenec.compiler.assets.affine import TO_Z_UP, about_axis, sin_cos
from scenec.compiler.assets.mesh_file import MeshFile, read_mesh
from scenec.schemas.errors import SceneError

BOX = np.array([[x, y, z] for x in (0, 2) for y in (0, 3) for z in (0, 5)], float)
BOX_QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)


def ours(mesh: MeshFile) -> trimesh.Trimesh:
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


@pytest.mark.parametrize("suffix", ["obj", "ply", "glb"])
def test_an_independent_reader_finds_the_same_triangles(tmp_path, suffix):
    points, quads = shelter(12)
    path = write(tmp_path / f"a.{suffix}", points, triangles(quads))
    theirs = trimesh.load(path, process=False, force="mesh").triangles
    if suffix == "glb":
        theirs = np.stack([theirs[..., 0], -theirs[..., 2], theirs[..., 1]], axis=-1)
    mesh = read_mesh(path, **keys(suffix))
    assert np.array_equal(mesh.points[mesh.faces], theirs)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("extra", [False, True])
def test_ply_polygons_of_any_kind_come_from_text_and_either_byte_order(tmp_path, kind, extra):
    polygons = [[0, 1, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4],
                [1, 5, 7, 3]]  # fmt: skip
    order = ">" if "big" in kind else "<"
    header = f"ply\nformat {kind} 1.0\ncomment é\nelement vertex 8\n"
    header += "property uchar red\n" if extra else ""
    header += "property double x\nproperty double y\nproperty double z\nelement face 7\n"
    header += "property float quality\n" if extra else ""
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
    path = tmp_path / "box.ply"
    path.write_bytes(header.encode("latin-1") + body)
    mesh = ours(read_mesh(path, unit_m=1, up="z"))
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(30.0, rel=1e-14)


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


def test_gltf_nodes_are_placed_as_an_independent_reader_places_them(tmp_path):
    points = BOX.astype("<f4")
    faces = BOX_QUADS[:, [0, 1, 2, 0, 2, 3]].astype("<u4")
    document = gltf_document(8, 36)
    document["scenes"] = [{"nodes": [0]}]
    document["nodes"] = [
        {"name": "top", "children": [1, 2], "rotation": [0.5, 0.5, -0.5, 0.5]},
        {"name": "a", "mesh": 0, "translation": [1, 2, 3], "scale": [1, 2, -3]},
        {"name": "b", "children": [3], "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 7, 8, 9, 1]},
        {"mesh": 0, "rotation": [0, 0.6, 0, 0.8]},
    ]
    path = tmp_path / "a.glb"
    path.write_bytes(glb(document, points.tobytes() + faces.tobytes()))
    mesh = read_mesh(path)
    assert mesh.parts == ("/top/a", "/top/b/node_3")
    theirs = trimesh.load(path, process=False).to_geometry()
    y_up = np.stack([mesh.points[:, 0], mesh.points[:, 2], -mesh.points[:, 1]], axis=1)
    theirs = trimesh.Trimesh(theirs.vertices, theirs.faces, process=False)
    assert np.allclose(np.sort(y_up, axis=0), np.sort(theirs.vertices, axis=0), atol=1e-12)
    for part, volume in (("a", 180.0), ("b", 30.0)):
        assert ours(read_mesh(path, part=part)).volume == pytest.approx(volume, rel=1e-12)


def test_gltf_strips_fans_small_integers_and_data_uris(tmp_path):
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]], "<i2")
    document = gltf_document(4, 0)
    document["extensionsRequired"] = ["KHR_mesh_quantization"]
    attributes = {"POSITION": 0}
    fan = np.array([0, 1, 3, 2], "u1")
    document["meshes"][0]["primitives"] = [
        {"attributes": attributes, "mode": 5},
        {"attributes": attributes, "mode": 6, "indices": 1},
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
    data = base64.b64encode(padded.tobytes() + fan.tobytes()).decode()
    uri = f"data:application/octet-stream;base64,{data}"
    document["buffers"] = [{"byteLength": 36, "uri": uri}]
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(document))
    mesh = read_mesh(path)
    assert np.bincount(mesh.part_of_face).tolist() == [2, 2]
    triangle = mesh.points[mesh.faces]
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    # All four face the same way, glTF's +z, and cover the square twice.
    assert np.array_equal(normal, [[0, -4, 0]] * 4)


def _broken() -> dict[str, tuple[bytes, str]]:
    header = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    header += b"property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
    header += b"end_header\n"
    document = gltf_document(3, 3)
    body = np.zeros(9, "<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
    outside = {**document, "buffers": [{"byteLength": 48, "uri": "mesh.bin"}]}
    draco = {**document, "extensionsRequired": ["KHR_draco_mesh_compression"]}
    still = {**document, "nodes": [{"mesh": 0, "rotation": [0, 0, 0, 0]}]}
    loop = {**document, "nodes": [{"children": [0], "mesh": 0}]}
    long = {**document, "accessors": [{**document["accessors"][0], "count": 4}] * 2}
    return {
        "empty.obj": (b"", "the file is empty"),
        "text.glb": (b"just some words\n" * 4, "not a binary glTF file"),
        "text.usda": (b"just some words\n", "not a sound USD file"),
        "text.usdc": (b"PXR-USDC and no more", "not a sound USD file"),
        "text.ply": (b"just some words\n", "not a PLY file"),
        "text.gltf": (b"just some words\n", "not a glTF file"),
        "picture.obj": (b"\x89PNG\r\n\x1a\n" + bytes(64), "it holds no faces"),
        "renamed.obj": (header, "its content is that of a .ply file"),
        "mesh.stl": (b"solid\n", "expected a mesh (.obj, .ply"),
        "mesh": (b"v 0 0 0\n", "not a file without an ending"),
        "points.obj": (b"v 0 0 0\nv 1 0 0\n", "it holds no faces"),
        "range.obj": (b"v 0 0 0\nf 1 2 3\n", "uses vertex 1 (from 0) of 1"),
        "zero.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "uses vertex -1"),
        "nan.obj": (b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "expected finite numbers"),
        "comma.obj": (b"v 0,5 0 0\n", "line 1: 'v 0,5 0 0' is no line"),
        "short.obj": (b"v 0 0 0\nv 1 2\n", "line 2"),
        "flat.obj": (b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "none of its 1 faces has an area"),
        "spline.obj": (b"v 0 0 0\ncstype bspline\n", "free-form surface"),
        "far.obj": (b"v 1e300 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "reaches out to 1e+300 m"),
        "nan.ply": (header + b"0 0 0 1 0 nan 0 1 0 3 0 1 2\n", "expected finite numbers"),
        "range.ply": (header + b"0 0 0 1 0 0 0 1 0 3 0 1 7\n", "uses vertex 7 (from 0) of 3"),
        "short.ply": (header + b"0 0 0 1 0 0 0 1 0 3 0 1\n", "cut short"),
        "words.ply": (header + b"0 0 zero 1 0 0 0 1 0 3 0 1 2\n", "not a number"),
        "header.ply": (b"ply\nformat ascii 1.0\nelement vertex x\nend_header\n", "PLY header"),
        "cloud.ply": (
            b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n",
            "without the element 'face'",
        ),
        "cut.glb": (glb(document, body)[:-8], "cut short"),
        "outside.glb": (glb(outside, b""), "in another file (mesh.bin)"),
        "draco.glb": (glb(draco, body), "KHR_draco_mesh_compression"),
        "still.glb": (glb(still, body), "a broken glTF file: ZeroDivisionError"),
        "loop.glb": (glb(loop, body), "own ancestor"),
        "long.glb": (glb(long, body), "over its buffer's end"),
        "empty.glb": (glb({"asset": {"version": "2.0"}}, b""), "it holds no faces"),
        "old.glb": (glb({"asset": {"version": "1.0"}}, b""), "glTF of version 1.0"),
        "flat.glb": (glb(document, body), "none of its 1 faces has an area"),
        "empty.usda": (b"#usda 1.0\n(upAxis = \"Z\"\nmetersPerUnit = 1)\n", "it holds no faces"),
    }  # fmt: skip


@pytest.mark.parametrize("name", _broken())
def test_a_broken_file_ends_in_one_line_that_names_it_and_the_fault(tmp_path, name):
    content, words = _broken()[name]
    (tmp_path / name).write_bytes(content)
    assert words in fails(tmp_path / name, unit_m=1, up="z")


def test_a_folder_and_a_missing_file_are_told(tmp_path):
    (tmp_path / "a.obj").mkdir()
    assert "not a file" in fails(tmp_path / "a.obj", unit_m=1, up="z")
    assert "there is no such file" in fails(tmp_path / "b.obj", unit_m=1, up="z")


def test_a_part_that_is_not_there_is_told_with_those_that_are(tmp_path):
    path = write(tmp_path / "a.usda", *shelter(6))
    assert "no part 'cliff'; it has /World/shelter" in fails(path, part="cliff")
    assert len(read_mesh(path, part="World").faces) == 50


@pytest.mark.parametrize("suffix", ["obj", "ply", "glb", "usda", "usdc"])
def test_a_file_cut_short_or_with_wrong_bytes_is_a_mesh_or_an_error_and_no_crash(tmp_path, suffix):
    whole = write(tmp_path / f"a.{suffix}", *shelter(4)).read_bytes()
    rng = np.random.default_rng(5)
    path = tmp_path / f"b.{suffix}"
    count = 40 if suffix.startswith("usd") else 150
    for trial in range(2 * count):
        content = bytearray(whole[: rng.integers(len(whole))] if trial < count else whole)
        for _ in range(0 if trial < count else rng.integers(1, 6)):
            content[rng.integers(len(content))] = rng.integers(256)
        path.write_bytes(bytes(content))
        try:
            mesh = read_mesh(path, unit_m=1, up="z")
        except SceneError:
            continue
        assert np.isfinite(mesh.points).all()
        assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.points)
