"""Masks in exported models: other readers, and scenec itself, find the same cut out."""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from PIL import Image
from pxr import Usd, UsdShade

from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.model.collect import coarse_model, full_model
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.cli.main import main
from scenec.compiler.assets.gltf_file import GltfFile
from scenec.compiler.compile import compile_cfg
from scenec.datasets.models.gltf import write_gltf
from scenec.schemas.model import Look, Mask
from scenec.testing.leaves import FORMATS, card, compiled, leaf, picture
from scenec.testing.small import write_cfg

SOLID = "what pictures cut out is solid"
ALPHA = np.asarray(picture())[..., 3]
#: Of the card's picture by format.
WRAPS = {
    "leaf.glb": ("repeat", "repeat"),
    "leaf.obj": ("repeat", "repeat"),
    "leaf.usda": ("clamp", "mirror"),
}


@pytest.fixture(scope="module", params=FORMATS)
def out(request, tmp_path_factory):
    """A card of one format, compiled and exported to each format of models."""
    folder = tmp_path_factory.mktemp("masks")
    scene = compiled(folder, leaf(folder, request.param))
    for name in ("gltf", "usdz"):
        words = ["export", str(folder / "out"), "--format", name, "--set", "texels=16384"]
        assert main(words) == 0
    files = folder / "out" / "datasets"
    return SimpleNamespace(
        scene=scene,
        glb=files / "gltf" / "batch_0000.glb",
        usdz=files / "usdz" / "batch_0000.usdz",
        wrap=WRAPS[request.param],
        colored=request.param != "leaf.usda",
    )


def test_nothing_is_said_to_be_solid_but_in_the_coarse_model_of_pages(out):
    for file in (out.glb, out.usdz):
        losses = json.loads((file.parent / "export.json").read_text())["batches"]["batch_0000"]
        assert SOLID not in str(losses)
    model = coarse_model(out.scene, "b", ground_faces=10, object_faces=10, instances=10)
    assert f"opacity: {SOLID}" in model.losses


def test_the_package_holds_the_mask_and_viewers_find_it(out):
    stage = Usd.Stage.Open(str(out.usdz))
    card_prims = [p for p in stage.TraverseAll() if p.HasAttribute("primvars:st")
                  and not str(p.GetPath()).startswith("/World/Terrain")]  # fmt: skip
    assert card_prims
    for prim in card_prims:
        subsets = UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()
        bound = [UsdShade.MaterialBindingAPI(s).ComputeBoundMaterial()[0] for s in subsets]
        (material,) = bound or [UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]]
        surface = material.ComputeSurfaceSource()[0]
        assert surface.GetInput("opacityThreshold").Get() == 0.5
        texture, name, _ = surface.GetInput("opacity").GetConnectedSource()
        texture = UsdShade.Shader(texture.GetPrim())
        assert name == "r"
        assert tuple(texture.GetInput(w).Get() for w in ("wrapS", "wrapT")) == out.wrap
        reader = UsdShade.Shader(texture.GetInput("st").GetConnectedSource()[0].GetPrim())
        assert reader.GetInput("varname").Get() == "st"
        with zipfile.ZipFile(out.usdz) as archive:
            inside = texture.GetInput("file").Get().path.removeprefix("./")
            held = Image.open(io.BytesIO(archive.read(inside)))
        np.testing.assert_array_equal(np.asarray(held), ALPHA)


def test_another_reader_finds_the_mask_and_the_color_of_each_place_of_the_card(out):
    read = trimesh.load_scene(out.glb)
    masked = [
        (read.geometry[name], matrix)
        for node in read.graph.nodes_geometry
        for matrix, name in [read.graph.get(node)]
        if read.geometry[name].visual.material.alphaMode == "MASK"
    ]
    ((mesh, matrix),) = masked
    material = mesh.visual.material
    assert material.alphaCutoff == 0.5
    pixels = np.asarray(material.baseColorTexture)
    np.testing.assert_array_equal(pixels[..., 3], ALPHA)
    colors = np.asarray(picture())[..., :3] if out.colored else np.full((*ALPHA.shape, 3), 255)
    np.testing.assert_array_equal(pixels[..., :3], colors)
    # The card is 2 m wide and high, its picture over all of it; this reader knows no instances.
    place = trimesh.transform_points(mesh.vertices, matrix)[:, :2]
    np.testing.assert_allclose(mesh.visual.uv, (place - place.min(axis=0)) / 2, atol=1e-6)
    assert mesh.area == pytest.approx(4.0)


def test_a_foreign_card_without_an_id_keeps_its_mask(tmp_path):
    model = full_model(read_stage(leaf(tmp_path, "leaf.usda")), "b", texels=16)
    (part,) = model.parts
    mask = model.looks[part.look].mask
    assert mask is not None
    np.testing.assert_array_equal(mask.opacity, ALPHA)
    assert (mask.threshold, mask.wrap) == (0.5, ("clamp", "mirror"))


@pytest.mark.parametrize(
    ("picture", "mask", "size", "said"),
    [
        ((4, 8), (4, 8), (4, 8), False),
        (None, (4, 8), (4, 8), False),
        ((2, 2), (4, 8), (4, 8), False),
        ((8, 4), (4, 8), (8, 8), True),
    ],
)
def test_of_color_and_mask_the_one_with_fewer_texels_is_resampled(
    out, tmp_path, picture, mask, size, said
):
    """Rows and columns; a mask that is not as it was is said."""
    model = full_model(out.scene, "b", texels=16)
    colors = None if picture is None else np.full((*picture, 3), 200, np.uint8)
    own = Mask(np.full(mask, 90, np.uint8), 0.2, ("mirror", "clamp"))
    look = Look("own", (1.0, 1.0, 1.0), 0.5, picture=colors, mask=own)
    content = write_gltf(
        dataclasses.replace(model, looks=(look,) * len(model.looks)), tmp_path / "m.glb"
    )
    assert any("the mask of own, 8 x 4 texels" in line for line in content.losses) is said
    held = GltfFile(tmp_path / "m.glb")
    pixels = np.asarray(Image.open(io.BytesIO(held.view(held.document["images"][0]["bufferView"]))))
    assert pixels.shape == (*size, 4)
    assert np.unique(pixels[..., 3]) == [90]
    assert np.unique(pixels[..., :3]) == [255 if picture is None else 200]
    (sampler,) = held.document["samplers"]
    assert (sampler["wrapS"], sampler["wrapT"]) == (33648, 33071)
    assert held.document["materials"][0]["alphaCutoff"] == 0.2


def cut(scene: RenderScene) -> np.ndarray:
    """Pixels that show what is labeled a leaf."""
    rays = camera_rays(scene.cameras[0][0])
    row, face, _ = ExactCaster(scene).cast(rays)
    found = np.zeros(len(row), bool)
    for number in np.unique(row[row >= 0]):
        at = row == number
        found[at] = scene.meshes[scene.rows.mesh[number]].labels["class"][face[at]] == 2
    return found


def test_the_exported_scene_as_an_asset_has_the_pixels_of_the_mask(out, tmp_path):
    asset = tmp_path / "again.glb"
    asset.write_bytes(out.glb.read_bytes())
    # The copy stands 5 m above the new scene's own ground, and so does the camera.
    cfg = card(asset, labels={"class": "ground"}, parts={"leaf": {"labels": {"class": "leaf"}}})
    cfg["objects"]["leaf"]["poses"][0]["z_m"] = 5
    pose = cfg["rigs"]["r"]["pose"]
    pose["position"]["height_m"] += 5
    pose["target"]["height_m"] += 5
    compile_cfg(write_cfg(tmp_path, cfg), seed=1, out=tmp_path / "out")
    again = read_stage(tmp_path / "out" / "batch_0000" / "stage.usda")
    was, now = cut(out.scene), cut(again)
    assert was.sum() > 3000
    assert np.count_nonzero(was != now) <= 2
