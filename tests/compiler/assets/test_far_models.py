"""Models far from their origin, under maps that are no motions, and with what is not drawn."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from scenec.cli.main import main
from scenec.compiler.assets import blend_worker, looks
from scenec.compiler.assets.model import MeshModel, cached_model, read_model
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.schemas.errors import CfgError, SceneError
from scenec.testing.models import BOX, QUADS, faces, gltf_parts, write
from scenec.testing.overhangs import glb
from scenec.testing.small import small_cfg, write_cfg

#: Where a crate stands in UTM, and how large it is, meters.
PLACE = np.array([431234.37, 5412345.62, 512.3])
SIZE = np.array([1.0, 0.8, 0.5])
CRATE = PLACE + SIZE * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
FORMATS = ("a.obj", "float.ply", "double.ply", "a.stl", "a.off", "a.glb", "a.usda")


def write_crate(path: Path, place: np.ndarray = PLACE) -> Path:
    """The crate as the format that the ending names writes far coordinates."""
    corners = CRATE - PLACE + place
    lines = [" ".join(map(repr, row)) for row in corners.tolist()]
    count = f"{len(corners)} {len(QUADS)} 0"
    rows = ["4 " + " ".join(map(str, quad)) for quad in QUADS.tolist()]
    if path.suffix == ".obj":
        sides = ["f " + " ".join(str(v + 1) for v in quad) for quad in QUADS.tolist()]
        path.write_text("\n".join([*(f"v {line}" for line in lines), *sides, ""]))
    elif path.suffix == ".off":
        path.write_text("\n".join(["OFF", count, *lines, *rows, ""]))
    elif path.suffix == ".stl":
        text = ["solid crate"]
        for face in faces():
            text += ["facet normal 0 0 0", "outer loop"]
            text += [f"vertex {lines[v]}" for v in face] + ["endloop", "endfacet"]
        path.write_text("\n".join([*text, "endsolid crate", ""]))
    elif path.suffix == ".ply":
        kind = path.name.split(".")[0]
        form = "ascii" if kind == "float" else "binary_little_endian"
        head = ["ply", f"format {form} 1.0", f"element vertex {len(corners)}"]
        head += [f"property {kind} {axis}" for axis in "xyz"]
        head += [f"element face {len(QUADS)}", "property list uchar int vertex_indices"]
        data = "\n".join([*head, "end_header", ""]).encode()
        if kind == "float":
            data += "\n".join([*lines, *rows, ""]).encode()
        else:
            data += corners.astype("<f8").tobytes()
            data += b"".join(b"\4" + quad.astype("<i4").tobytes() for quad in QUADS)
        path.write_bytes(data)
    elif path.suffix == ".glb":
        document, binary = gltf_parts(False)
        document["nodes"][0] |= {
            "translation": [place[0], place[2], -place[1]],
            "scale": (SIZE / (2, 3, 5))[[0, 2, 1]].tolist(),
        }
        path.write_bytes(glb(document, binary))
    else:
        stage = Usd.Stage.CreateNew(str(path))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        mesh = UsdGeom.Mesh.Define(stage, "/crate")
        mesh.CreateSubdivisionSchemeAttr("none")
        mesh.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*place.tolist()))
        mesh.CreatePointsAttr((CRATE - PLACE).tolist())
        mesh.CreateFaceVertexCountsAttr([4] * 6)
        mesh.CreateFaceVertexIndicesAttr(QUADS.ravel().tolist())
        stage.Save()
    return path


def crate_cfg(folder: Path, name: str, **model: Any) -> Path:
    """A plane with one crate on it, at (2, 3)."""
    cfg = small_cfg()
    cfg["samples"] = 1
    cfg["terrain"]["relief"] = [{"type": "plane"}]
    keys: dict[str, Any] = {} if name.endswith(("glb", "usda")) else {"unit_m": 1, "up": "z"}
    cfg["objects"] = {
        "crate": {
            "type": "placed", "models": [{"file": name, **keys, **model}], "material": "stone",
            "labels": {"class": "rock", "surface": "stone"}, "poses": [{"x_m": 2, "y_m": 3}],
        }
    }  # fmt: skip
    return write_cfg(folder, cfg)


@pytest.mark.parametrize("name", FORMATS)
def test_a_model_in_map_coordinates_is_refused_or_moved_to_its_pose_in_doubles(tmp_path, name):
    path = write_crate(tmp_path / name)
    with pytest.raises(CfgError) as caught:
        load(crate_cfg(tmp_path, name))
    (fault,) = caught.value.faults
    assert fault.pointer == "/objects/crate/models/0/file"
    for words in (path.name, "1.37 m large", "5,412,346 m", '"origin": "base"', "431234.87"):
        assert words in fault.message
    load(crate_cfg(tmp_path, name, origin="base"))
    unit, up = (None, None) if name.endswith(("glb", "usda")) else (1.0, "z")
    expected = SIZE * np.array(
        [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0, 1)]
    )
    corner = tuple(PLACE.tolist())
    for origin, moved in (("base", expected), (corner, CRATE - PLACE)):
        points = cached_model(path, unit, up, None, origin).points
        order = np.lexsort(np.round(points, 6).T[::-1])
        # Doubles at 5,400 km are 1e-9 m apart; glTF and USD hold 0.8 and 0.3 in float32.
        assert np.abs(points[order] - moved).max() < (5e-8 if unit is None else 4e-9)


@pytest.mark.parametrize("name", ["obj", "usda"])
def test_a_crate_in_map_coordinates_stands_on_its_pose_and_keeps_its_shape(tmp_path, name):
    write_crate(tmp_path / f"a.{name}")
    compile_cfg(crate_cfg(tmp_path, f"a.{name}", origin="base"), seed=1, out=tmp_path / "out")
    batch = tmp_path / "out" / "batch_0000"
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    cache = UsdGeom.BBoxCache(Usd.TimeCode(0), [UsdGeom.Tokens.default_])
    crate = cache.ComputeWorldBound(stage.GetPrimAtPath("/World/Objects/crate/instance_1"))
    box = crate.ComputeAlignedRange()
    assert np.allclose(box.GetMin(), [1.5, 2.6, 0.0], rtol=0, atol=1e-7)
    assert np.allclose(box.GetMax(), [2.5, 3.4, 0.5], rtol=0, atol=1e-7)
    told = json.loads((batch / "report.json").read_text())["objects"]["crate"]
    # What 0.4 loses in float32, about 6e-9 m, is measured; as USD has it, it loses nothing.
    assert told["float32_error_max_m"] < 5e-8
    assert (told["float32_error_max_m"] > 0.0) == (name == "obj")


def test_the_error_of_float32_is_that_of_the_vertices_as_they_are_stored(tmp_path):
    place = np.array([100.3, -70.7, 0.1])
    write_crate(tmp_path / "a.obj", place)
    compile_cfg(crate_cfg(tmp_path, "a.obj"), seed=1, out=tmp_path / "out")
    batch = tmp_path / "out" / "batch_0000"
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    (mesh,) = (
        UsdGeom.Mesh(prim)
        for prim in stage.Traverse(Usd.TraverseInstanceProxies())
        if "/crate/" in str(prim.GetPath()) and prim.IsA(UsdGeom.Mesh)
    )
    stored = np.unique(np.array(mesh.GetPointsAttr().Get(), np.float64), axis=0)
    true = np.unique(CRATE - PLACE + place, axis=0)
    worst = np.sqrt(((stored - true) ** 2).sum(axis=1)).max()
    report = json.loads((batch / "report.json").read_text())
    assert 1e-6 < worst < 1e-5
    assert report["objects"]["crate"]["float32_error_max_m"] == pytest.approx(worst, rel=1e-6)
    assert report["precision"]["float32_error_max_m"] >= worst * (1 - 1e-6)


# Maps of nodes.


def volume(model: MeshModel) -> float:
    """Of a closed mesh, above 0 where its faces are seen counterclockwise from outside."""
    a, b, c = model.points[model.faces].transpose(1, 0, 2)
    return float((np.cross(a, b) * c).sum() / 6.0)


def placed_box(folder: Path, kind: str, matrix: np.ndarray) -> Path:
    """The box of ``models`` under a matrix, for columns."""
    path = write(folder / f"box.{kind}")
    if kind == "glb":
        document, binary = gltf_parts(False)
        document["nodes"][0]["matrix"] = matrix.T.ravel().tolist()
        path.write_bytes(glb(document, binary))
    else:
        stage = Usd.Stage.Open(str(path))
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/box"))
        mesh.AddTransformOp().Set(Gf.Matrix4d(*matrix.T.ravel().tolist()))
        stage.Save()
    return path


@pytest.mark.parametrize("kind", ["glb", "usda"])
@pytest.mark.parametrize("row", [[0, 0, 0, 2], [0.1, 0, 0, 1], [0, 0, 1e-3, 1]])
def test_a_projective_map_of_a_node_is_refused(tmp_path, kind, row):
    matrix = np.eye(4)
    matrix[3] = row
    with pytest.raises(SceneError, match=rf"box\.{kind}: /box: its transform is projective"):
        read_model(placed_box(tmp_path, kind, matrix))


@pytest.mark.parametrize("kind", ["glb", "usda"])
@pytest.mark.parametrize("scale", [(-1, 1, 1), (-1, -2, -3), (-1, -1, 1)])
def test_a_mirrored_node_keeps_its_faces_outward(tmp_path, kind, scale):
    matrix = np.diag([*map(float, scale), 1.0])
    matrix[0, 1] = 0.5
    model = read_model(placed_box(tmp_path, kind, matrix))
    bare = volume(read_model(write(tmp_path / f"box.{kind}")))
    assert abs(bare) == pytest.approx(np.prod(BOX.max(axis=0)))
    assert volume(model) == pytest.approx(bare * abs(np.prod(scale)))


# Extensions of glTF.


def with_extensions(path: Path, **document: Any) -> Path:
    whole, binary = gltf_parts(False)
    path.write_bytes(glb(whole | document, binary))
    return path


@pytest.mark.parametrize(
    "name",
    [
        "KHR_materials_", "KHR_materials_future", "KHR_texture_procedurals", "KHR_lights_area",
        "EXT_texture_future", "KHR_mesh_quantization_2", "EXT_mesh_gpu_instancing_2",
        "CESIUM_RTC", "EXT_meshopt_compression_2",
    ],
)  # fmt: skip
def test_a_required_extension_that_is_not_known_by_its_whole_name_is_refused(tmp_path, name):
    path = with_extensions(tmp_path / "a.glb", extensionsRequired=[name], extensionsUsed=[name])
    with pytest.raises(SceneError, match=rf"a\.glb: needs the extension {name}:"):
        read_model(path)
    told = read_model(with_extensions(path, extensionsUsed=[name])).warnings
    assert told == (f"its extension {name} is not followed",)


def test_required_extensions_that_are_known_are_read_and_lights_are_told(tmp_path):
    known = ["KHR_mesh_quantization", "KHR_texture_transform", "KHR_materials_ior"]
    path = with_extensions(tmp_path / "a.glb", extensionsRequired=known, extensionsUsed=known)
    assert read_model(path).warnings == ()
    lights = ["KHR_lights_punctual"]
    path = with_extensions(tmp_path / "a.glb", extensionsRequired=lights, extensionsUsed=lights)
    assert read_model(path).warnings == ("its extension KHR_lights_punctual is not followed",)


def test_nodes_that_are_not_visible_are_not_read(tmp_path):
    whole, binary = gltf_parts(False)
    hidden = {"extensions": {"KHR_node_visibility": {"visible": False}}}
    whole["nodes"] = [
        {"name": "shown", "mesh": 0},
        {"name": "above", "children": [2], **hidden},
        {"name": "hidden", "mesh": 0},
    ]
    whole["extensionsUsed"] = whole["extensionsRequired"] = ["KHR_node_visibility"]
    (tmp_path / "a.glb").write_bytes(glb(whole, binary))
    model = read_model(tmp_path / "a.glb")
    assert model.parts == ("/shown",)
    assert model.warnings == ()


# What is not drawn is told on the screen.


BLENDED = "its opacity is no blend: what is below 0.5 is cut out"
SOLID = "its opacity is not shown: it is drawn, and labeled, as if it were solid"


def told(folder: Path, name: str, material: str | None = None, **model: Any) -> list[str]:
    """What is said of a model when its cfg is read: by validate, compile and run."""
    path = crate_cfg(folder, name, **model)
    cfg = json.loads(path.read_text())
    cfg["objects"]["crate"].pop("material")
    if material is None:
        # What nothing uses is a fault.
        cfg["materials"].pop("stone")
    else:
        cfg["objects"]["crate"]["material"] = material
    lines = load(write_cfg(folder, cfg)).warnings
    assert all(line.pointer == "/objects/crate/models/0/file" for line in lines)
    return [line.message for line in lines]


@pytest.mark.parametrize(
    ("line", "lines"),
    [("d 0.4", [SOLID]), ("Tr 0.6", [SOLID]), ("map_d tex/rough.png", [BLENDED])],
)
def test_the_opacity_of_an_obj_is_told(tmp_path, line, lines):
    write(tmp_path / "box.obj")
    (tmp_path / "box.mtl").write_text(f"newmtl plain\n{line}\nnewmtl painted\nd 1\nTr 0\n")
    assert told(tmp_path, "box.obj") == [f"box.obj: material 'plain': {what}" for what in lines]
    # A cfg's material gives other colors, but no leaf its outline.
    assert f"box.obj: material 'plain': {SOLID}" in told(tmp_path, "box.obj", "stone")


@pytest.mark.parametrize("mode", ["MASK", "BLEND", "OPAQUE"])
def test_the_opacity_of_a_gltf_is_told(tmp_path, mode):
    whole, binary = gltf_parts(False)
    whole["materials"][0]["alphaMode"] = mode
    (tmp_path / "a.glb").write_bytes(glb(whole, binary))
    expected = [] if mode == "OPAQUE" else [f"a.glb: material 'plain': {SOLID}"]
    assert told(tmp_path, "a.glb") == expected


def test_glass_of_a_gltf_is_told(tmp_path):
    whole, binary = gltf_parts(False)
    whole["extensionsUsed"] = ["KHR_materials_transmission"]
    whole["materials"][0]["extensions"] = {"KHR_materials_transmission": {"transmissionFactor": 1}}
    (tmp_path / "a.glb").write_bytes(glb(whole, binary))
    line = "a.glb: material 'plain': its KHR_materials_transmission is not followed"
    assert told(tmp_path, "a.glb") == [line]


def quad_stage(path: Path) -> tuple[Usd.Stage, UsdGeom.Mesh]:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = UsdGeom.Mesh.Define(stage, "/quad")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)])
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    return stage, mesh


@pytest.mark.parametrize("opacity", [0.5, None, 1.0])
def test_the_opacity_of_a_usd_model_is_told(tmp_path, opacity):
    stage, mesh = quad_stage(tmp_path / "a.usda")
    types = Sdf.ValueTypeNames
    material = UsdShade.Material.Define(stage, "/leaf")
    shader = UsdShade.Shader.Define(stage, "/leaf/shader")
    shader.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", types.Token))
    if opacity is not None:
        shader.CreateInput("opacity", types.Float).Set(opacity)
    else:
        write(tmp_path / "box.usda")
        texture = UsdShade.Shader.Define(stage, "/leaf/mask")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", types.Asset).Set("./tex/rough.png")
        shader.CreateInput("opacityThreshold", types.Float).Set(0.5)
        shader.CreateInput("opacity", types.Float).ConnectToSource(
            texture.CreateOutput("r", types.Float)
        )
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.Save()
    expected = [f"a.usda: material 'leaf': {SOLID}"] if opacity == 0.5 else []
    assert told(tmp_path, "a.usda") == expected


def test_colors_and_opacities_of_a_usd_mesh_without_a_material_are_told(tmp_path):
    stage, mesh = quad_stage(tmp_path / "a.usda")
    colors = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    colors.Set([(1, 0, 0), (1, 0, 0), (0, 0, 1), (0, 0, 1)])
    mesh.CreateDisplayOpacityPrimvar(UsdGeom.Tokens.constant).Set([0.5])
    stage.Save()
    lines = told(tmp_path, "a.usda")
    assert lines == [f"a.usda: /quad: {SOLID}"]
    assert told(tmp_path, "a.usda", "stone") == [f"a.usda: /quad: {SOLID}"]
    colors.Set([(1, 0, 0)] * 4)
    mesh.GetDisplayOpacityPrimvar().Set([1.0])
    stage.Save()
    assert told(tmp_path, "a.usda") == []


@pytest.mark.parametrize("name", ["displayColor", "Cd"])
def test_colors_that_a_usd_material_takes_from_vertices_are_read_or_told(tmp_path, name):
    stage, mesh = quad_stage(tmp_path / "a.usda")
    mesh.CreateDisplayColorPrimvar("vertex").Set([(1, 0, 0), (1, 0, 0), (0, 0, 1), (0, 0, 1)])
    types = Sdf.ValueTypeNames
    material = UsdShade.Material.Define(stage, "/paint")
    shader, reader = (UsdShade.Shader.Define(stage, f"/paint/{name}") for name in "sr")
    shader.CreateIdAttr("UsdPreviewSurface")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", types.String).Set(name)
    shader.CreateInput("diffuseColor", types.Color3f).ConnectToSource(
        reader.CreateOutput("result", types.Float3)
    )
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", types.Token))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.Save()
    shown = name == "displayColor"
    lost = "a.usda: material 'paint': the colors of its vertices are left out"
    assert told(tmp_path, "a.usda") == ([] if shown else [lost])
    assert (read_model(tmp_path / "a.usda").colors is not None) == shown


@pytest.mark.parametrize("kind", ["obj", "ply", "glb"])
def test_colors_of_vertices_are_kept(tmp_path, kind):
    colors = np.where(np.arange(8)[:, None] < 4, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    path = tmp_path / f"a.{kind}"
    rows = np.concatenate([BOX, colors if kind == "obj" else 255 * colors], axis=1).tolist()
    if kind == "obj":
        sides = ["f " + " ".join(str(v + 1) for v in quad) for quad in QUADS.tolist()]
        lines = ["v " + " ".join(map(str, row)) for row in rows]
        path.write_text("\n".join([*lines, *sides, ""]))
    elif kind == "ply":
        head = ["ply", "format ascii 1.0", "element vertex 8"]
        head += [f"property float {axis}" for axis in "xyz"]
        head += [f"property uchar {name}" for name in ("red", "green", "blue")]
        head += ["element face 6", "property list uchar int vertex_indices", "end_header"]
        lines = [" ".join(f"{value:.0f}" for value in row) for row in rows]
        sides = ["4 " + " ".join(map(str, quad)) for quad in QUADS.tolist()]
        path.write_text("\n".join([*head, *lines, *sides, ""]))
    else:
        whole, binary = gltf_parts(False)
        start, shade = len(binary), np.repeat(colors[:6], 3, axis=0).astype("<f4")
        whole["bufferViews"].append({"buffer": 0, "byteOffset": start, "byteLength": shade.nbytes})
        whole["accessors"].append(
            {"bufferView": len(whole["bufferViews"]) - 1, "componentType": 5126, "count": 18,
             "type": "VEC3"}
        )  # fmt: skip
        primitive = whole["meshes"][0]["primitives"][0]
        primitive["attributes"]["COLOR_0"] = len(whole["accessors"]) - 1
        whole["buffers"] = [{"byteLength": start + shade.nbytes}]
        path.write_bytes(glb(whole, binary + shade.tobytes()))
    assert told(tmp_path, path.name) == []
    made = read_model(path, unit_m=1.0, up="z")
    assert made.colors is not None
    assert np.ptp(made.colors, axis=(0, 1)).max() > 0.1


def test_colors_of_some_vertices_of_an_obj_are_told(tmp_path):
    lines = [f"v {x} {y} {z}" for x, y, z in BOX.tolist()]
    sides = ["f " + " ".join(str(v + 1) for v in quad) for quad in QUADS.tolist()]
    (tmp_path / "a.obj").write_text("\n".join([lines[0] + " 1 0 0", *lines[1:], *sides, ""]))
    assert told(tmp_path, "a.obj") == ["a.obj: the colors of its vertices are left out"]


def test_the_process_that_reads_blend_files_tells_it_in_the_same_words():
    assert f"its {blend_worker._OPACITY}" == looks.OPACITY == SOLID
    assert blend_worker._NO_VERTEX_COLORS == looks.NO_VERTEX_COLORS


def test_colors_of_off_files_and_of_the_faces_of_ply_files_are_told(tmp_path):
    points = [" ".join(map(str, row)) for row in BOX.tolist()]
    sides = ["4 " + " ".join(map(str, quad)) for quad in QUADS.tolist()]
    colored = ["COFF", "8 6 0", *(f"{line} 255 0 0 255" for line in points), *sides, ""]
    (tmp_path / "v.off").write_text("\n".join(colored))
    assert told(tmp_path, "v.off") == ["v.off: the colors of its vertices are left out"]
    painted = ["OFF", "8 6 0", *points, *(f"{side} 255 0 0" for side in sides), ""]
    (tmp_path / "f.off").write_text("\n".join(painted))
    assert told(tmp_path, "f.off") == ["f.off: the colors of its faces are left out"]
    head = ["ply", "format ascii 1.0", "element vertex 8"]
    head += [f"property float {axis}" for axis in "xyz"]
    head += ["element face 6", "property list uchar int vertex_indices"]
    head += [f"property uchar {name}" for name in ("red", "green", "blue")] + ["end_header"]
    (tmp_path / "f.ply").write_text(
        "\n".join([*head, *points, *(f"{side} 255 0 0" for side in sides), ""])
    )
    assert told(tmp_path, "f.ply") == ["f.ply: the colors of its faces are left out"]
    plain = ["OFF", "8 6 0", *points, *sides, ""]
    (tmp_path / "p.off").write_text("\n".join(plain))
    assert told(tmp_path, "p.off") == []


def test_compile_tells_on_the_screen_and_in_the_report_what_is_not_drawn(tmp_path, capsys):
    whole, binary = gltf_parts(False)
    whole["materials"][0]["alphaMode"] = "MASK"
    (tmp_path / "a.glb").write_bytes(glb(whole, binary))
    out = tmp_path / "out"
    assert main(["compile", str(crate_cfg(tmp_path, "a.glb")), "-o", str(out), "--no-cache"]) == 0
    line = f"a.glb: material 'plain': {SOLID}"
    assert f"warning: {tmp_path}" in (screen := capsys.readouterr().err)
    assert screen.count(line) == 1
    report = json.loads((out / "batch_0000" / "report.json").read_text())
    assert line in report["objects"]["crate"]["left_out"]
