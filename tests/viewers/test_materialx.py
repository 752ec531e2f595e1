"""MaterialX networks: nodes that a real library knows, no more than is needed, checked."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import viewer_scene
from pxr import Sdf, Usd, UsdShade

from scenec.backends.check.stage import check_stage
from scenec.backends.stage.read import read_stage
from scenec.compiler.emit.materialx import write_material
from scenec.compiler.scene.material import Cutout, Material, MaterialMaps
from scenec.schemas import materialx

needs_bpy = pytest.mark.skipif(
    importlib.util.find_spec("bpy") is None, reason="needs bpy (its USD has a MaterialX library)"
)
MIX = "/World/GroundMix"
COORDINATES = "ND_geompropvalue_vector2"
CUT = "ND_ifgreatereq_float"


@pytest.fixture(scope="module")
def stage(tmp_path_factory) -> Path:
    """A stage with maps and metals: every kind of node stands in it but that of coordinates."""
    folder = tmp_path_factory.mktemp("materialx")
    cfg = viewer_scene.mapped_cfg(folder)
    cfg["materials"]["mud"]["maps"] |= {
        "projection": "triplanar",
        "base_color": "color.png",
        "normal": "normal.png",
    }
    return viewer_scene.compiled(folder, cfg)


@pytest.fixture(scope="module")
def library(stage):
    """What the MaterialX library out of bpy says of our nodes and networks."""
    out = stage.parent.parent / "library.json"
    script = Path(__file__).with_name("materialx_library.py")
    done = viewer_scene.run_apart(script, stage, out, *materialx.NODES, "ND_mix_bsfd")
    assert done.returncode == 0, done.stderr
    return json.loads(out.read_text())


@pytest.mark.slow
@needs_bpy
def test_every_node_is_in_the_library_with_these_types_and_in_every_shading_language(library):
    assert library["nodes"]["ND_mix_bsfd"] is None
    for name, ours in materialx.NODES.items():
        theirs = library["nodes"][name]
        assert ours.inputs.items() <= theirs["inputs"].items(), name
        assert theirs["outputs"] == {materialx.OUTPUT: ours.output}, name
        assert theirs["targets"] == ["genglsl", "genmsl", "genosl", "genmdl"], name


@pytest.mark.slow
@needs_bpy
def test_every_network_is_valid_materialx_from_which_shaders_are_made(library):
    networks = library["networks"]
    names = ("sand", "gravel", "mud", "stone")
    assert set(networks) == {f"/World/Looks/{name}" for name in names}
    for network in networks.values():
        assert network["valid"], network["message"]
        assert min(network["code"].values()) > 10_000
    # The ground's three are the mix; the stone is itself.
    assert networks["/World/Looks/sand"]["nodes"] > 3 * networks["/World/Looks/stone"]["nodes"]


def shaders(stage: Usd.Stage, under: str) -> dict[str, str]:
    """MaterialX nodes below a prim, name -> id."""
    prims = [UsdShade.Shader(prim) for prim in stage.GetPrimAtPath(under).GetAllChildren()]
    ids = {s.GetPrim().GetName(): s.GetShaderId() for s in prims if s}
    return {name: found for name, found in ids.items() if found.startswith("ND_")}


def test_the_stage_uses_every_kind_of_node_and_all_ground_materials_show_one_network(stage):
    opened = Usd.Stage.Open(str(stage))
    mix = shaders(opened, MIX)
    assert set(mix.values()) == set(materialx.NODES) - {COORDINATES, CUT}
    for name in ("sand", "gravel", "mud"):
        look = f"/World/Looks/{name}"
        assert shaders(opened, look) == mix
        surface, *_ = UsdShade.Material(opened.GetPrimAtPath(look)).ComputeSurfaceSource("mtlx")
        assert surface.GetPath() == f"{look}/MaterialX"
        # Viewers that do not know MaterialX show what they did.
        preview, *_ = UsdShade.Material(opened.GetPrimAtPath(look)).ComputeSurfaceSource()
        assert preview.GetShaderId() == "UsdPreviewSurface"


def network_of(folder: Path, **numbers) -> dict[str, str]:
    material = Material((0.5, 0.4, 0.3), 0.5, 0.1, 0.0)
    write_material(folder / "m.mtlx.usda", "m", dataclasses.replace(material, **numbers), {})
    opened = Usd.Stage.Open(str(folder / "m.mtlx.usda"))
    return shaders(opened, "/World/Looks/m")


LAMBERT = {"diffuse", "MaterialX"}
GLOSSY = LAMBERT | {"gloss", "glossy"}
VARIED = {"variation", "part", "factor", "varied"}
ROUGH = {"variation", "rough_part", "rough_factor", "rough_varied", "alpha"}


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ({}, GLOSSY),
        ({"specular": 0.0}, LAMBERT),
        ({"specular": 0.0, "variation": 0.2}, LAMBERT | VARIED),
        # Only colors that can pass 1 are clipped.
        ({"specular": 0.0, "variation": 1.0, "base_color": (0.6, 0.4, 0.3)},
         LAMBERT | VARIED | {"clipped"}),
        # What has no gloss needs no roughness, and only what can pass 1 is clipped.
        ({"specular": 0.0, "roughness_variation": 0.9}, LAMBERT),
        ({"roughness_variation": -0.9}, GLOSSY | ROUGH),
        ({"roughness": 0.6, "roughness_variation": -0.9}, GLOSSY | ROUGH | {"rough_clipped"}),
        ({"metallic": 1.0, "variation": 0.1, "roughness_variation": 0.9},
         {"metal", "MaterialX"} | VARIED | ROUGH),
        ({"metallic": 0.5}, GLOSSY | {"metal", "metallic"}),
        ({"specular": 0.0, "diffuse_transmission": 0.4}, LAMBERT | {"through", "sheet"}),
        ({"diffuse_transmission": 0.4}, GLOSSY | {"through", "sheet"}),
        ({"metallic": 1.0}, {"metal", "MaterialX"}),
    ],
)  # fmt: skip
def test_a_network_holds_only_what_its_numbers_need(tmp_path, numbers, expected):
    assert set(network_of(tmp_path, **numbers)) == expected


def test_a_normal_map_alone_brings_its_frame_and_nothing_else(tmp_path):
    maps = MaterialMaps(2.0, {}, "directx")
    material = Material((0.5, 0.4, 0.3), 0.5, 0.0, 0.0, maps=maps)
    write_material(tmp_path / "looks" / "m.mtlx.usda", "m", material, {"normal": "textures/n.png"})
    opened = Usd.Stage.Open(str(tmp_path / "looks" / "m.mtlx.usda"))
    frame = {"normal", "normal_x", "normal_part", "tangent_part", "tangent", "bitangent"}
    place = {"position", "xy", "uv", "normal_map"}
    assert set(shaders(opened, "/World/Looks/m")) == LAMBERT | frame | place | {"bumped"}
    file = opened.GetAttributeAtPath("/World/Looks/m/normal_map.inputs:file").Get().path
    assert file == "../textures/n.png"


def test_maps_by_texture_coordinates_are_read_there_in_the_viewer_s_own_frame(tmp_path):
    maps = MaterialMaps(1.0, {}, "directx", "uv")
    material = Material((1.0, 1.0, 1.0), 0.5, 0.0, 0.0, maps=maps)
    files = {"base_color": "textures/c.png", "normal": "textures/n.png"}
    write_material(tmp_path / "looks" / "m.mtlx.usda", "m", material, files)
    opened = Usd.Stage.Open(str(tmp_path / "looks" / "m.mtlx.usda"))
    found = shaders(opened, "/World/Looks/m")
    assert set(found) == LAMBERT | {"st", "base_color_map", "normal_map", "bumped"}
    assert found["st"] == COORDINATES
    geomprop = opened.GetAttributeAtPath("/World/Looks/m/st.inputs:geomprop").Get()
    assert geomprop == "st"
    scale = opened.GetAttributeAtPath("/World/Looks/m/bumped.inputs:scale").Get()
    assert tuple(scale) == (1.0, -1.0)


def test_a_mask_is_an_opacity_of_nothing_or_all(tmp_path):
    maps = MaterialMaps(1.0, {}, "opengl", "uv", cutout=Cutout(0.25, ("clamp", "repeat")))
    material = Material((1.0, 1.0, 1.0), 0.5, 0.0, 0.0, maps=maps)
    file = tmp_path / "looks" / "m.mtlx.usda"
    write_material(file, "m", material, {"opacity": "textures/o.png"})
    opened = Usd.Stage.Open(str(file))
    found = shaders(opened, "/World/Looks/m")
    assert set(found) == LAMBERT | {"st", "opacity_map", "opacity"}
    assert found["opacity"] == CUT
    surface, cut, picture = (
        UsdShade.Shader(opened.GetPrimAtPath(f"/World/Looks/m/{name}"))
        for name in ("MaterialX", "opacity", "opacity_map")
    )
    for shader, name, source in ((surface, "opacity", cut), (cut, "value1", picture)):
        (connected,), _ = shader.GetInput(name).GetConnectedSources()
        assert connected.source.GetPath() == source.GetPath()
    assert [cut.GetInput(name).Get() for name in ("value2", "in1", "in2")] == [0.25, 1.0, 0.0]
    modes = [picture.GetInput(f"{axis}addressmode").Get() for axis in "uv"]
    assert modes == ["clamp", "periodic"]


def test_a_triplanar_picture_is_read_on_three_planes(tmp_path):
    maps = MaterialMaps(2.0, {}, "opengl", "triplanar")
    material = Material((1.0, 1.0, 1.0), 0.5, 0.0, 0.0, maps=maps)
    write_material(tmp_path / "looks" / "m.mtlx.usda", "m", material, {"base_color": "c.png"})
    opened = Usd.Stage.Open(str(tmp_path / "looks" / "m.mtlx.usda"))
    found = shaders(opened, "/World/Looks/m")
    assert [n for n, i in found.items() if i == "ND_image_color3"] == [
        "base_color_map_x", "base_color_map_y", "base_color_map_z",
    ]  # fmt: skip
    for axis, u, v in (("x", 1, 2), ("y", 0, 2), ("z", 0, 1)):
        node = opened.GetPrimAtPath(f"/World/Looks/m/across_{axis}")
        read = [UsdShade.Shader(node).GetInput(f"in{i}").GetConnectedSources()[0] for i in (1, 2)]
        assert [c[0].source.GetPath().name for c in read] == [f"position_{u}", f"position_{v}"]


def test_nothing_is_mixed_on_a_ground_of_one_material(tmp_path):
    cfg = viewer_scene.viewer_cfg()
    del cfg["terrain"]["ground"][1:]
    for name in ("gravel", "mud"):
        del cfg["materials"][name], cfg["labels"]["surface"][name]
    stage = viewer_scene.compiled(tmp_path, cfg)
    assert not (stage.parent / "terrain.mtlx.usda").exists()
    assert (stage.parent / "looks" / "sand.mtlx.usda").is_file()
    assert not Usd.Stage.Open(str(stage)).GetPrimAtPath(MIX)


def test_our_reader_finds_the_same_scene_without_the_networks(stage, tmp_path):
    folder = tmp_path / "batch"
    shutil.copytree(stage.parent, folder)
    whole = read_stage(folder / "stage.usda")
    layer = Sdf.Layer.FindOrOpen(str(folder / "stage.usda"))
    kept = [name for name in layer.subLayerPaths if not name.endswith(materialx.LAYER_SUFFIX)]
    assert len(kept) == len(layer.subLayerPaths) - 2
    layer.subLayerPaths = kept
    layer.Save()
    for network in folder.rglob(f"*{materialx.LAYER_SUFFIX}"):
        network.unlink()
    without = read_stage(folder / "stage.usda")
    assert without.surfaces == whole.surfaces
    np.testing.assert_array_equal(without.rows.to_world, whole.rows.to_world)
    for ours, theirs in zip(without.meshes, whole.meshes, strict=True):
        assert ours.layers == theirs.layers
        np.testing.assert_array_equal(ours.weights, theirs.weights)


def test_the_check_allows_our_nodes_in_our_layers_and_finds_nothing_else(stage):
    assert [str(finding) for finding in check_stage(stage)] == []


def node(stage: Usd.Stage, name: str) -> UsdShade.Shader:
    return UsdShade.Shader(stage.GetPrimAtPath(f"/World/Looks/stone/{name}"))


FAULTS = {
    "a misspelled node": (
        lambda stage: node(stage, "glossy").CreateIdAttr("ND_add_bsfd"),
        "UsdValidation:MissingShaderIdInRegistry",
        "ND_add_bsfd",
    ),
    "a node that the compiler never writes": (
        lambda stage: node(stage, "MaterialX").CreateIdAttr("ND_standard_surface_surfaceshader"),
        "UsdValidation:MissingShaderIdInRegistry",
        "ND_standard_surface_surfaceshader",
    ),
    "an input that is none": (
        lambda stage: node(stage, "gloss").CreateInput("rough", Sdf.ValueTypeNames.Float).Set(1),
        "materialx",
        "ND_generalized_schlick_bsdf has no input rough",
    ),
    "a constant of another type": (
        lambda stage: node(stage, "gloss").GetInput("roughness").GetAttr().SetTypeName(
            Sdf.ValueTypeNames.Float
        ),
        "materialx",
        "input roughness is float, expected float2",
    ),
    "a source of another type": (
        lambda stage: node(stage, "varied").GetInput("in2").ConnectToSource(
            UsdShade.ConnectionSourceInfo(node(stage, "gloss").GetOutput("out"))
        ),
        "materialx",
        "input in2 takes /World/Looks/stone/gloss.outputs:out, of another type",
    ),
    "an input without a value": (
        lambda stage: node(stage, "part").GetInput("in2").GetAttr().Clear(),
        "materialx",
        "input in2 has neither a value nor a source",
    ),
    "an output that is none": (
        lambda stage: node(stage, "part").CreateOutput("result", Sdf.ValueTypeNames.Float),
        "materialx",
        "ND_multiply_float has no output result",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(FAULTS))
def test_the_check_finds(name, stage, tmp_path):
    change, check, words = FAULTS[name]
    folder = tmp_path / "batch"
    shutil.copytree(stage.parent, folder)
    opened = Usd.Stage.Open(str(folder / "stage.usda"))
    layer = Sdf.Layer.FindOrOpen(str(folder / "looks" / "stone.mtlx.usda"))
    with Usd.EditContext(opened, layer):
        change(opened)
    layer.Save()
    found = [f for f in check_stage(folder / "stage.usda") if f.severity == "error"]
    assert [f.check for f in found] == [check], [str(f) for f in found]
    assert words in found[0].message
    assert found[0].where.startswith("/World/Looks/stone/")


def test_the_check_finds_a_good_node_in_a_layer_that_is_not_materialx_s(stage, tmp_path):
    folder = tmp_path / "batch"
    shutil.copytree(stage.parent, folder)
    opened = Usd.Stage.Open(str(folder / "stage.usda"))
    UsdShade.Shader.Define(opened, "/World/Looks/stone/stray").CreateIdAttr("ND_add_float")
    opened.Save()
    (found,) = check_stage(folder / "stage.usda")
    assert found.check == "UsdValidation:MissingShaderIdInRegistry"
    assert found.where == "/World/Looks/stone/stray"
