"""Models whose pictures of opacity cut parts of them out, as each format says it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pxr import Sdf, Usd, UsdGeom, UsdShade

from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.compiler.assets.looks import OPACITY
from scenec.compiler.assets.model import read_model
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.testing.overhangs import glb
from scenec.testing.small import write_cfg

TYPES = Sdf.ValueTypeNames
#: Texels of the picture's side, and of the disk that it leaves.
SIDE, RADIUS = 128, 50.0
#: Meters of the card's side and to it, pixels and degrees across.
CARD, AWAY, WIDE, FOV = 2.0, 4.0, 160, 50.0
FORMATS = ("leaf.glb", "leaf.obj", "leaf.usda")


def picture() -> Image.Image:
    """A disk of alpha, whose edge is a ramp of some texels that is 0.5 at the radius."""
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2
    texels = np.full((SIDE, SIDE, 4), (40, 160, 50, 0), np.uint8)
    texels[..., 3] = np.rint(255 * np.clip(0.5 + (RADIUS - np.hypot(x, y)) / 8, 0.0, 1.0))
    return Image.fromarray(texels)


def gltf(material: dict[str, Any], sampler: dict[str, int] | None = None) -> bytes:
    """A card of 2 m that stands upright on the origin, its picture beside it."""
    points = np.array([[-1, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]], np.float32)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    corners = np.array([0, 1, 2, 0, 2, 3], np.uint16)
    parts = [array.tobytes() for array in (points, uv, corners)]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    texture = {"source": 0} | ({} if sampler is None else {"sampler": 0})
    return glb(
        {
            "asset": {"version": "2.0"},
            "nodes": [{"mesh": 0}],
            "meshes": [
                {
                    "primitives": [
                        {
                            "attributes": {"POSITION": 0, "TEXCOORD_0": 1},
                            "indices": 2,
                            "material": 0,
                        }
                    ]
                }
            ],
            "accessors": [
                {"bufferView": i, "componentType": kind, "count": count, "type": of}
                for i, (kind, count, of) in enumerate(
                    [(5126, 4, "VEC3"), (5126, 4, "VEC2"), (5123, 6, "SCALAR")]
                )
            ],
            "bufferViews": [
                {"buffer": 0, "byteOffset": start, "byteLength": len(part)}
                for start, part in zip(starts, parts, strict=False)
            ],
            "buffers": [{"byteLength": starts[-1]}],
            "materials": [{"name": "leaf", **material}],
            "images": [{"uri": "leaf.png"}],
            "textures": [texture],
            "samplers": [sampler or {}],
        },
        b"".join(parts),
    )


MASK = {
    "alphaMode": "MASK",
    "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0},
}


def leaf(folder: Path, name: str) -> Path:
    """The card as a file of some format."""
    file = folder / name
    picture().save(folder / "leaf.png")
    if name.endswith(".glb"):
        file.write_bytes(gltf(MASK))
    elif name.endswith(".obj"):
        file.write_text(
            "mtllib leaf.mtl\nv -1 0 0\nv 1 0 0\nv 1 2 0\nv -1 2 0\n"
            "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl leaf\nf 1/1 2/2 3/3 4/4\n"
        )
        (folder / "leaf.mtl").write_text("newmtl leaf\nmap_Kd leaf.png\nmap_d leaf.png\n")
    else:
        usd(file)
    return file


def usd(file: Path) -> None:
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = UsdGeom.Mesh.Define(stage, "/leaf")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr([(-1, 0, 0), (1, 0, 0), (1, 2, 0), (-1, 2, 0)])
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", TYPES.TexCoord2fArray, "vertex")
    st.Set([(0, 0), (1, 0), (1, 1), (0, 1)])
    material = UsdShade.Material.Define(stage, "/look")
    shader = UsdShade.Shader.Define(stage, "/look/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", TYPES.Token))
    texture = UsdShade.Shader.Define(stage, "/look/texture")
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", TYPES.Asset).Set("./leaf.png")
    texture.CreateInput("wrapS", TYPES.Token).Set("clamp")
    texture.CreateInput("wrapT", TYPES.Token).Set("mirror")
    alpha = texture.CreateOutput("a", TYPES.Float)
    shader.CreateInput("opacity", TYPES.Float).ConnectToSource(alpha)
    shader.CreateInput("opacityThreshold", TYPES.Float).Set(0.5)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.Save()


def compiled(folder: Path, file: Path) -> RenderScene:
    """The card alone before a camera."""
    compile_cfg(write_cfg(folder, card(file)), seed=1, out=folder / "out")
    return read_stage(folder / "out" / "batch_0000" / "stage.usda")


def card(file: Path, **keys: Any) -> dict[str, Any]:
    """A cfg of the card alone before a camera, with more keys of the class."""
    model = {"file": file.name} | ({"unit_m": 1, "up": "y"} if file.suffix == ".obj" else {})
    return {
        "version": 1,
        "name": "leaf",
        "samples": 1,
        "labels": {"class": {"ground": 1, "leaf": 2}},
        "terrain": {
            "size_m": [20, 20],
            "spacing_m": 1,
            "relief": [{"type": "plane"}],
            "ground": [{"material": "m", "labels": {"class": "ground"}}],
        },
        "materials": {"m": {"base_color": [0.3, 0.3, 0.3]}},
        "light": {"sun": {"elevation_deg": 40}},
        "objects": {
            "leaf": {
                "type": "placed",
                "models": [model],
                "labels": {"class": "leaf"},
                "poses": [{"x_m": 0, "y_m": 0}],
                **keys,
            }
        },
        "rigs": {
            "r": {
                "sensors": {"c": {"resolution": [WIDE, 120], "fov_deg": FOV}},
                "pose": {
                    "type": "random_target",
                    "position": {"x_m": 0, "y_m": -AWAY, "height_m": 1},
                    "target": {"distance_m": AWAY, "bearing_deg": 0, "height_m": 1},
                },
            }
        },
    }


@pytest.mark.parametrize("name", FORMATS)
def test_a_leaf_has_the_area_of_its_mask_and_not_of_its_card(tmp_path, name):
    made = compiled(tmp_path, leaf(tmp_path, name))
    row = ExactCaster(made).cast(camera_rays(made.cameras[0][0]))[0]
    (number,) = [i for i, m in enumerate(made.rows.mesh) if made.cutout_of(made.meshes[m])]
    focal = 0.5 * WIDE / np.tan(np.radians(FOV / 2))
    radius = RADIUS / SIDE * CARD * focal / AWAY
    # Each pixel that the contour passes is in or out: far fewer are wrong on balance.
    assert np.count_nonzero(row == number) == pytest.approx(np.pi * radius**2, abs=radius)
    assert made.losses == ()


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({}, False),
        ({"material": "m"}, True),
        ({"parts": {"leaf": {"material": "m"}}}, True),
        ({"parts": {"look": {"material": "m"}}}, True),
        ({"parts": {"leaf": {"labels": {"class": "ground"}}}}, False),
    ],
)
def test_a_material_in_the_place_of_a_mask_is_told(tmp_path, keys, told):
    """Also that of a part, named by itself or by its material: it draws the card as solid."""
    warnings = load(write_cfg(tmp_path, card(leaf(tmp_path, "leaf.usda"), **keys))).warnings
    said = [line.message for line in warnings if line.message.endswith(OPACITY)]
    assert said == (["leaf.usda: material 'look': " + OPACITY] if told else [])


def test_what_cuts_is_read_as_formats_say_it(tmp_path):
    picture().save(tmp_path / "leaf.png")
    clamped, mirrored = 33071, 33648
    base = MASK["pbrMetallicRoughness"]
    cases: list[tuple[dict[str, Any], float, tuple[str, str]]] = [
        (MASK, 0.5, ("clamp", "mirror")),
        (MASK | {"alphaCutoff": 0.2}, 0.2, ("clamp", "mirror")),
        (MASK | {"alphaMode": "BLEND"}, 0.5, ("clamp", "mirror")),
    ]
    for material, threshold, wrap in cases:
        file = tmp_path / "case.glb"
        file.write_bytes(gltf(material, {"wrapS": clamped, "wrapT": mirrored}))
        (found,) = read_model(file).materials
        assert found.cutout is not None
        assert (found.cutout.threshold, found.cutout.wrap) == (threshold, wrap)
        assert "opacity" in found.pictures
    for material in (MASK | {"alphaMode": "OPAQUE"}, MASK | {"alphaCutoff": 0.0}):
        (tmp_path / "case.glb").write_bytes(gltf(material))
        (found,) = read_model(tmp_path / "case.glb").materials
        assert found.cutout is None
    # A factor of alpha is a part of it: half of it all is nowhere at 0.6.
    faint = MASK | {
        "alphaCutoff": 0.6,
        "pbrMetallicRoughness": base | {"baseColorFactor": [1, 1, 1, 0.5]},
    }
    (tmp_path / "case.glb").write_bytes(gltf(faint))
    (found,) = read_model(tmp_path / "case.glb").materials
    values = np.asarray(Image.open(_bytes(found.pictures["opacity"])))
    assert values.max() == 128


def _bytes(source: Any) -> Any:
    import io

    return io.BytesIO(source.data)


def test_a_foreign_stage_is_cut_as_its_preview_surface_says(tmp_path):
    file = leaf(tmp_path, "leaf.usda")
    (maps,) = [surface.cutout for surface in read_stage(file).surfaces if surface.cutout]
    assert (maps.opacity_threshold, maps.opacity_wrap) == (0.5, ("clamp", "mirror"))
    stage = Usd.Stage.Open(str(file))
    UsdShade.Shader(stage.GetPrimAtPath("/look/surface")).GetInput("opacityThreshold").Set(0.0)
    stage.Save()
    found = read_stage(file)
    assert [s.cutout.opacity_threshold for s in found.surfaces if s.cutout] == [0.5]
    (line,) = found.losses
    assert "what is below 0.5 is cut out" in line


def test_a_stage_of_ours_shows_viewers_the_mask(tmp_path):
    compiled(tmp_path, leaf(tmp_path, "leaf.glb"))
    stage = Usd.Stage.Open(str(tmp_path / "out" / "batch_0000" / "stage.usda"))
    surface = UsdShade.Shader(stage.GetPrimAtPath("/World/Looks/leaf_leaf/Surface"))
    assert surface.GetInput("opacityThreshold").Get() == 0.5
    (node,) = surface.GetInput("opacity").GetValueProducingAttributes()
    texture = UsdShade.Shader(node.GetPrim())
    assert texture.GetInput("file").Get().path.endswith("leaf_leaf_opacity.png")
