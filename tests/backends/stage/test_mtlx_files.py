"""Materials of ``.mtlx`` files that stages refer to, written by MaterialX itself."""

import sys
from dataclasses import replace

import MaterialX
import numpy as np
import pytest
from PIL import Image
from pxr import Sdf, UsdShade

from scenec.backends.stage.read import read_stage
from scenec.schemas.errors import StageError
from scenec.testing.foreign_stages import new_stage, polygons

UNREAD = "standard_surface", {"base_color": ("color3", "0.1, 0.2, 0.3"), "coat": ("float", "1.0")}


def document(model, inputs, space="lin_rec709"):
    """A document of one material ``Look`` and its surface ``shade``."""
    made = MaterialX.createDocument()
    made.setColorSpace(space)
    shade = made.addNode(model, "shade", "surfaceshader")
    for name, (kind, value) in inputs.items():
        shade.addInput(name, kind).setValueString(value)
    look = made.addNode("surfacematerial", "Look", "material")
    look.addInput("surfaceshader", "surfaceshader").setConnectedNode(shade)
    return made


def add(made, kind, category, name, **inputs):
    """Adds a node; an input is (type, value), or another node."""
    node = made.addNode(category, name, kind)
    for key, value in inputs.items():
        connect(node, key, value)
    return node


def connect(node, key, value):
    if isinstance(value, tuple):
        node.addInput(key, value[0]).setValueString(value[1])
    else:
        node.addInput(key, value.getType()).setConnectedNode(value)


def stage_of(folder, made, under="/MaterialX", holder="/Root/MaterialX", below="/Materials"):
    """A triangle whose material stands in ``look.mtlx``."""
    MaterialX.writeToXmlFile(made, str(folder / "look.mtlx"))
    stage = new_stage(folder / "stage.usda", "/Root")
    mesh = polygons(stage, "/Root/Mesh", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [3], [0, 1, 2])
    stage.DefinePrim(holder).GetReferences().AddReference("./look.mtlx", under)
    api = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
    api.GetDirectBindingRel().SetTargets([f"{holder}{below}/Look"])
    stage.GetRootLayer().Save()
    return folder / "stage.usda"


def surface_of(scene):
    return scene.surfaces[scene.meshes[0].layers[0]]


@pytest.mark.parametrize(
    ("model", "inputs", "expected"),
    [
        (
            "standard_surface",
            {"base": ("float", "0.5"), "base_color": ("color3", "0.2, 0.4, 0.6")}
            | {"metalness": ("float", "1"), "specular_roughness": ("float", "0.7")},
            {"base_color": (0.1, 0.2, 0.3), "metallic": 1.0, "roughness": 0.7, "specular": 0.04},
        ),
        # Its defaults, and the reflectance at an index of 2, (1 / 3) ** 2, at a weight of 0.25.
        (
            "standard_surface",
            {"specular": ("float", "0.25"), "specular_IOR": ("float", "2")},
            {"base_color": (0.8,) * 3, "roughness": 0.2, "specular": 0.25 / 9.0},
        ),
        (
            "standard_surface",
            {"emission": ("float", "2"), "emission_color": ("color3", "0.5, 0.25, 1")},
            {"emission": (1.0, 0.5, 2.0)},
        ),
        (
            "open_pbr_surface",
            {"base_weight": ("float", "0.5"), "base_metalness": ("float", "0.25")},
            {"base_color": (0.4,) * 3, "metallic": 0.25, "roughness": 0.3, "specular": 0.04},
        ),
        (
            "gltf_pbr",
            {"emissive": ("color3", "1, 0, 0.5"), "emissive_strength": ("float", "3")},
            {"base_color": (1.0,) * 3, "metallic": 1.0, "emission": (3.0, 0.0, 1.5)},
        ),
        (
            "UsdPreviewSurface",
            {"useSpecularWorkflow": ("integer", "1"), "specularColor": ("color3", "0.3, 0.3, 0.3")},
            {"base_color": (0.18,) * 3, "specular": 0.3, "roughness": 0.5},
        ),
    ],
)
def test_constants_of_each_surface(tmp_path, model, inputs, expected):
    scene = read_stage(stage_of(tmp_path, document(model, inputs)))
    surface = surface_of(scene)
    assert surface.path == "/Root/MaterialX/Materials/Look"
    for name, value in expected.items():
        assert getattr(surface, name) == pytest.approx(value, abs=1e-6), name
    assert scene.losses == ()


@pytest.mark.parametrize(
    ("under", "holder", "below"),
    [
        ("/MaterialX", "/Root/M", "/Materials"),
        ("/MaterialX/Materials", "/Root/M", ""),
        (Sdf.Path(), "/Root/M", "/Materials"),
    ],
)
def test_references_lead_to_the_file_its_materials_or_its_default(tmp_path, under, holder, below):
    scene = read_stage(stage_of(tmp_path, document(*UNREAD), under, holder, below))
    assert surface_of(scene).base_color == pytest.approx((0.1, 0.2, 0.3))
    (line,) = scene.losses
    assert "shade (standard_surface): not followed: coat" in line
    assert f"{holder}{below}/Look" in line


def test_colors_of_srgb_are_decoded(tmp_path):
    made = document("standard_surface", {"base_color": ("color3", "0.5, 0.04, 1")}, "srgb_texture")
    linear = (((0.5 + 0.055) / 1.055) ** 2.4, 0.04 / 12.92, 1.0)
    assert surface_of(read_stage(stage_of(tmp_path, made))).base_color == pytest.approx(linear)


def textured(folder):
    """Pictures through tiling, arithmetic, channels and a graph; a surface that reads them."""
    Image.new("RGB", (2, 2), (255, 128, 0)).save(folder / "color.png")
    Image.new("RGB", (2, 2), (128, 128, 255)).save(folder / "normal.png")
    made = document("standard_surface", {})
    graph = made.addNodeGraph("graph")
    color = add(graph, "color3", "tiledimage", "tiled", file=("filename", "color.png"),
                uvtiling=("vector2", "2, 3"), uvoffset=("vector2", "0.25, 0.5"))  # fmt: skip
    color.getInput("file").setColorSpace("srgb_texture")
    dark = add(graph, "color3", "multiply", "dark", in1=color, in2=("float", "0.5"))
    place = add(graph, "vector2", "place2d", "place", scale=("vector2", "0.5, 0.25"),
                pivot=("vector2", "0.5, 0"), offset=("vector2", "-0.25, 0.5"))  # fmt: skip
    packed = add(graph, "color3", "image", "packed", file=("filename", "color.png"), texcoord=place)
    green = add(graph, "float", "extract", "green", index=("integer", "1"))
    connect(green, "in", packed)
    smooth = add(graph, "float", "invert", "smooth")
    connect(smooth, "in", green)
    lying = add(graph, "vector3", "image", "lying", file=("filename", "normal.png"))
    normal = add(graph, "vector3", "normalmap", "bent")
    connect(normal, "in", lying)
    shade = made.getNode("shade")
    for name, node in (("base_color", dark), ("specular_roughness", smooth), ("normal", normal)):
        output = graph.addOutput(f"{name}_out", node.getType())
        output.setConnectedNode(node)
        shade.addInput(name, node.getType()).setConnectedOutput(output)
    return made


@pytest.mark.parametrize("packed", [False, True])
def test_pictures_go_through_tiling_arithmetic_and_channels(tmp_path, packed):
    path = stage_of(tmp_path, textured(tmp_path))
    if packed:
        with Sdf.ZipFileWriter.CreateNew(str(tmp_path / "all.usdz")) as writer:
            for name in ("stage.usda", "look.mtlx", "color.png", "normal.png"):
                writer.AddFile(str(tmp_path / name), name)
        path = tmp_path / "all.usdz"
    scene = read_stage(path)
    maps = surface_of(scene).maps
    assert str(maps.base_color).endswith("all.usdz[color.png]" if packed else "/color.png")
    assert maps.uv_transform == pytest.approx((2.0, 0.0, -0.25, 0.0, 3.0, -0.5))
    reading = dict(maps.readings)["base_color"]
    assert (reading.srgb, reading.scale) == (True, (0.5, 0.5, 0.5))
    # A second set of coordinates, and a normal without tiling: one is kept, the others are told.
    assert maps.roughness is None
    assert any("roughness of UsdPreviewSurface" in line for line in scene.losses)


def test_a_picture_is_placed_inverted_and_read_in_one_channel(tmp_path):
    made = textured(tmp_path)
    made.getNode("shade").removeInput("base_color")
    maps = surface_of(read_stage(stage_of(tmp_path, made))).maps
    # (x - 0.5) / 0.5 + 0.25 + 0.5, y / 0.25 - 0.5
    assert maps.uv_transform == pytest.approx((2.0, 0.0, -0.25, 0.0, 4.0, -0.5))
    reading = dict(maps.readings)["roughness"]
    assert (reading.channel, reading.scale[0], reading.bias[0]) == ("g", -1.0, 1.0)
    made.getNode("shade").removeInput("specular_roughness")
    maps = surface_of(read_stage(stage_of(tmp_path, made))).maps
    assert maps.normal is not None
    assert not maps.flip_green


@pytest.mark.parametrize(("mode", "cut"), [("0", None), ("1", 0.25), ("2", 0.5)])
def test_masks_of_gltf_cut_at_their_own_threshold(tmp_path, mode, cut):
    Image.new("RGBA", (2, 2), (255, 128, 0, 99)).save(tmp_path / "leaf.png")
    made = document("gltf_pbr", {"alpha_mode": ("integer", mode)}
                    | {"alpha_cutoff": ("float", "0.25")})  # fmt: skip
    leaf = add(made, "multioutput", "gltf_colorimage", "leaf", file=("filename", "leaf.png"))
    leaf.getInput("file").setColorSpace("srgb_texture")
    for name, kind, output in (("base_color", "color3", "outcolor"), ("alpha", "float", "outa")):
        port = made.getNode("shade").addInput(name, kind)
        port.setNodeName(leaf.getName())
        port.setOutputString(output)
    scene = read_stage(stage_of(tmp_path, made))
    maps = surface_of(scene).maps
    assert (maps.opacity is not None) == (cut is not None)
    if cut is not None:
        assert maps.opacity_threshold == pytest.approx(cut)
        reading = dict(maps.readings)["opacity"]
        assert (reading.channel, reading.srgb) == ("a", None)
    assert bool(scene.losses) == (mode == "2")


def test_what_is_more_complex_has_its_default_and_a_line(tmp_path):
    made = document("standard_surface", {})
    connect(made.getNode("shade"), "base_color", add(made, "color3", "noise2d", "noise"))
    turned = add(made, "vector2", "rotate2d", "turned", amount=("float", "30"))
    rough = add(made, "float", "image", "rough", file=("filename", "r.png"), texcoord=turned)
    connect(made.getNode("shade"), "specular_roughness", rough)
    tiles = add(made, "float", "image", "tiles", file=("filename", "r.<UVTILE>.png"))
    connect(made.getNode("shade"), "metalness", tiles)
    scene = read_stage(stage_of(tmp_path, made))
    surface = surface_of(scene)
    assert surface.base_color == pytest.approx((0.8,) * 3)
    assert (surface.roughness, surface.metallic) == pytest.approx((0.2, 0.0))
    assert len(scene.losses) == 3
    for told in (
        "base_color of shade (standard_surface): the node noise (noise2d) is not read",
        "specular_roughness of shade (standard_surface): the node turned (rotate2d) is not read",
        "metalness of shade (standard_surface): the file, or the tiles, of the node tiles is not",
    ):
        (line,) = [line for line in scene.losses if told in line]
        assert "/Root/MaterialX/Materials/Look" in line
    scene = read_stage(stage_of(tmp_path, document("disney_principled", {})))
    assert "the surface shade (disney_principled) is not read" in scene.losses[0]


def test_without_the_package_the_shape_is_drawn_and_a_line_says_so(tmp_path, monkeypatch):
    path = stage_of(tmp_path, document(*UNREAD))
    monkeypatch.setitem(sys.modules, "MaterialX", None)
    scene = read_stage(path)
    assert len(scene.meshes) == 1
    (line,) = scene.losses
    assert line.startswith(
        "/Root/MaterialX: its reference to look.mtlx, MaterialX, is not read without the extra "
        "materialx, displayColor is shown"
    )
    (tmp_path / "look.mtlx").unlink()
    with pytest.raises(StageError, match=r"look\.mtlx does not exist"):
        read_stage(path)


def test_a_file_that_is_none_and_a_picture_that_is_missing_end_the_reading(tmp_path):
    path = stage_of(tmp_path, textured(tmp_path))
    (tmp_path / "normal.png").unlink()
    with pytest.raises(StageError, match=r"normal\.png does not exist"):
        read_stage(path)
    (tmp_path / "look.mtlx").write_text("<materialx")
    with pytest.raises(StageError, match=r"look\.mtlx: cannot be read"):
        read_stage(path)


def test_the_digest_tells_files_apart_and_layers_stay_as_they_are(tmp_path):
    path = stage_of(tmp_path, document(*UNREAD))
    kept = Sdf.Layer.FindOrOpen(str(path))
    before = kept.ExportToString()
    first = read_stage(path)
    assert kept.ExportToString() == before
    assert read_stage(path).digest == first.digest
    MaterialX.writeToXmlFile(document("gltf_pbr", {}), str(tmp_path / "look.mtlx"))
    assert read_stage(path).digest != first.digest


def test_coordinates_are_turned_as_materialx_turns_them(tmp_path):
    """By the formula of its node graph NG_place2d, in both orders."""
    Image.new("RGB", (2, 2)).save(tmp_path / "color.png")
    scale, offset, pivot, angle = (
        np.array(each) for each in ([0.5, 0.25], [0.1, -0.2], [0.5, 0.3], 30)
    )
    a = np.radians(angle)
    turn = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
    at = np.random.default_rng(1).uniform(size=(5, 2))
    for order, expected in (
        ("0", ((at - pivot) / scale) @ turn.T - offset + pivot),
        ("1", ((at - pivot - offset) @ turn.T) / scale + pivot),
    ):
        made = document("standard_surface", {})
        place = add(made, "vector2", "place2d", "place", scale=("vector2", "0.5, 0.25"),
                    rotate=("float", "30"), offset=("vector2", "0.1, -0.2"),
                    pivot=("vector2", "0.5, 0.3"), operationorder=("integer", order))  # fmt: skip
        picture = add(made, "color3", "image", "it", file=("filename", "color.png"), texcoord=place)
        connect(made.getNode("shade"), "base_color", picture)
        found = surface_of(read_stage(stage_of(tmp_path, made))).maps.uv_transform
        matrix = np.array(found).reshape(2, 3)
        np.testing.assert_allclose(at @ matrix[:, :2].T + matrix[:, 2], expected, atol=1e-6)


def test_colors_of_acescg_become_those_of_rec709(tmp_path):
    """White stays white, and a primary is within five digits of its place."""
    for text, expected in (("1, 1, 1", (1, 1, 1)), ("1, 0, 0", (1.70505, 0.0, 0.0))):
        made = document("standard_surface", {"base_color": ("color3", text)}, "acescg")
        found = surface_of(read_stage(stage_of(tmp_path, made))).base_color
        assert found == pytest.approx(expected, abs=2e-5)


def as_network(stage, made, path):
    """Writes a document's material as UsdShade prims, as usdMtlx and other programs do."""
    libraries = MaterialX.createDocument()
    MaterialX.loadLibraries(
        MaterialX.getDefaultDataLibraryFolders(), MaterialX.getDefaultDataSearchPath(), libraries
    )
    made.importLibrary(libraries)
    kinds = {"color3": "color3f", "float": "float", "vector2": "float2", "vector3": "float3",
             "integer": "int", "filename": "asset", "surfaceshader": "token",
             "color4": "color4f", "string": "string"}  # fmt: skip
    material = UsdShade.Material.Define(stage, path)

    def typed(kind):
        return Sdf.ValueTypeNames.Find(kinds[kind])

    def value(port):
        text = port.getValueString()
        if port.getType() == "filename":
            return Sdf.AssetPath(f"./{text}")
        numbers = [float(word) for word in text.split(",")]
        return {"float": float, "integer": int}.get(port.getType(), lambda _: tuple(numbers))(
            numbers[0]
        )

    def shader(node, below):
        found = UsdShade.Shader.Define(stage, f"{below}/{node.getName()}")
        found.CreateIdAttr(node.getNodeDef().getName())
        for output in node.getNodeDef().getActiveOutputs():
            found.CreateOutput(output.getName(), typed(output.getType()))
        for port in node.getInputs():
            made_port = found.CreateInput(port.getName(), typed(port.getType()))
            if port.hasAttribute("nodegraph"):
                graph = UsdShade.NodeGraph(
                    stage.GetPrimAtPath(f"{path}/{port.getAttribute('nodegraph')}")
                )
                made_port.ConnectToSource(graph.GetOutput(port.getAttribute("output")))
            elif port.getConnectedNode() is not None:
                source = shader(port.getConnectedNode(), below)
                made_port.ConnectToSource(source.GetOutput(port.getOutputString() or "out"))
            else:
                made_port.Set(value(port))
                if port.getActiveColorSpace() and port.getType() in ("color3", "filename"):
                    made_port.GetAttr().SetColorSpace(port.getActiveColorSpace())
        return found

    for graph in made.getNodeGraphs():
        if graph.getName() != "graph":
            continue
        prim = UsdShade.NodeGraph.Define(stage, f"{path}/graph")
        for output in graph.getOutputs():
            source = shader(output.getConnectedNode(), f"{path}/graph")
            prim.CreateOutput(output.getName(), typed(output.getType())).ConnectToSource(
                source.GetOutput("out")
            )
    surface = shader(made.getNode("shade"), path)
    material.CreateSurfaceOutput("mtlx").ConnectToSource(surface.GetOutput("out"))
    return material


def leaf_of_gltf(folder):
    Image.new("RGBA", (2, 2), (255, 128, 0, 99)).save(folder / "leaf.png")
    made = document("gltf_pbr", {"alpha_mode": ("integer", "1")})
    leaf = add(made, "multioutput", "gltf_colorimage", "leaf", file=("filename", "leaf.png"))
    leaf.getInput("file").setColorSpace("srgb_texture")
    for name, kind, output in (("base_color", "color3", "outcolor"), ("alpha", "float", "outa")):
        port = made.getNode("shade").addInput(name, kind)
        port.setNodeName(leaf.getName())
        port.setOutputString(output)
    return made


DOCUMENTS = {
    "constants": lambda _: document("standard_surface", {"base_color": ("color3", "0.1, 0.2, 0.3")}
                                    | {"emission": ("float", "2"), "coat": ("float", "1")}),
    "defaults": lambda _: document("standard_surface", {}),
    "openpbr": lambda _: document("open_pbr_surface", {"base_metalness": ("float", "0.5")}),
    "gltf": lambda _: document("gltf_pbr", {"emissive": ("color3", "1, 0.5, 0")}, "srgb_texture"),
    "preview": lambda _: document("UsdPreviewSurface", {"roughness": ("float", "0.25")}),
    "pictures": textured,
    "mask": leaf_of_gltf,
}  # fmt: skip


@pytest.mark.parametrize("instanced", [False, True])
@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_network_of_the_stage_is_read_as_its_file_is_without_the_package(
    tmp_path, monkeypatch, name, instanced
):
    made = DOCUMENTS[name](tmp_path)
    expected = surface_of(read_stage(stage_of(tmp_path, made)))
    stage = new_stage(tmp_path / "own.usda", "/Root")
    base = "/Model" if instanced else "/Root/Model"
    mesh = polygons(stage, f"{base}/Mesh", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [3], [0, 1, 2])
    material = as_network(stage, made, f"{base}/Look")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    if instanced:
        prim = stage.DefinePrim("/Root/Model")
        prim.GetReferences().AddInternalReference("/Model")
        prim.SetInstanceable(True)
        stage.GetPrimAtPath("/Model").SetSpecifier(Sdf.SpecifierClass)
    stage.GetRootLayer().Save()
    before = (tmp_path / "own.usda").read_bytes()
    monkeypatch.setitem(sys.modules, "MaterialX", None)
    scene = read_stage(tmp_path / "own.usda")
    assert replace(surface_of(scene), path="") == replace(expected, path="")
    assert any("not followed: coat" in line for line in scene.losses) == (name == "constants")
    assert (tmp_path / "own.usda").read_bytes() == before


def test_a_surface_of_materialx_that_is_not_read_is_named(tmp_path):
    stage = new_stage(tmp_path / "own.usda", "/Root")
    mesh = polygons(stage, "/Root/Mesh", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [3], [0, 1, 2])
    material = as_network(stage, document("disney_principled", {}), "/Root/Look")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.GetRootLayer().Save()
    (line,) = read_stage(tmp_path / "own.usda").losses
    assert "displayColor is shown: 1 prim, /Root/Look" in line


def looks():
    """Two materials; a look of paths and of a collection, one that inherits it, one of all."""
    made = document(
        "standard_surface", {"base": ("float", "1"), "base_color": ("color3", "1, 0, 0")}
    )
    blue = add(made, "surfaceshader", "standard_surface", "blue", base=("float", "1"),
               base_color=("color3", "0, 0, 1"))  # fmt: skip
    add(made, "material", "surfacematerial", "Blue", surfaceshader=blue)
    inner = made.addCollection("inner")
    inner.setIncludeGeom("/b, /deep")
    inner.setAttribute("excludegeom", "/deep/e")
    # Names itself: it has no end.
    inner.setIncludeCollectionString("inner")
    first = made.addLook("first")
    first.addMaterialAssign("one", "Look").setGeom("/a, *no path*")
    first.addMaterialAssign("two", "Blue").setCollectionString("inner")
    second = made.addLook("second")
    second.setInheritString("first")
    second.setGeomPrefix("/deep")
    second.addMaterialAssign("three", "Look").setGeom("/d")
    second.addMaterialAssign("lost", "absent").setGeom("/e")
    made.addLook("all").addMaterialAssign("every", "Blue")
    return made


RED, BLUE, GRAY = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.5, 0.5, 0.5)


@pytest.mark.parametrize(
    ("look", "expected"),
    [
        (None, (GRAY,) * 4),
        ("first", (RED, BLUE, BLUE, GRAY)),
        ("second", (RED, BLUE, RED, GRAY)),
        ("all", (BLUE,) * 4),
    ],
)
def test_the_look_that_a_model_chooses_binds_its_materials(tmp_path, look, expected):
    MaterialX.writeToXmlFile(looks(), str(tmp_path / "look.mtlx"))
    stage = new_stage(tmp_path / "stage.usda", "/Root")
    model = stage.DefinePrim("/Root/model", "Xform")
    model.GetReferences().AddReference("./look.mtlx", "/ModelRoot")
    if look is not None:
        model.GetVariantSet("LookVariant").SetVariantSelection(look)
    for path in ("a", "b", "deep/d", "deep/e"):
        triangle = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
        polygons(stage, f"/Root/model/{path}", triangle, [3], [0, 1, 2]).CreateDisplayColorAttr(
            [GRAY]
        )
    stage.GetRootLayer().Save()
    scene = read_stage(tmp_path / "stage.usda")
    found = {mesh.path: scene.surfaces[mesh.layers[0]].base_color for mesh in scene.meshes}
    assert tuple(found[f"/Root/model/{p}"] for p in ("a", "b", "deep/d", "deep/e")) == expected
    told = ["the geometry *no path* of a look" in line for line in scene.losses]
    assert any(told) == (look in ("first", "second"))
