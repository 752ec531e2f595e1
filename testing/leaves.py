"""A leaf on a card, cut out by its picture's alpha, as files of each format: for tests of masks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pxr import Sdf, Usd, UsdGeom, UsdShade

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.testing.overhangs import glb
from scenec.testing.small import write_cfg

TYPES = Sdf.ValueTypeNames
#: Texels of the picture's side, and of the disk that it leaves.
SIDE, RADIUS = 128, 50.0
#: Meters of the card's side and to it, pixels and degrees across.
CARD, AWAY, WIDE, FOV = 2.0, 4.0, 160, 50.0
FORMATS = ("leaf.glb", "leaf.obj", "leaf.usda")


def picture(side: int = SIDE, radius: float = RADIUS, ramp: float = 8.0) -> Image.Image:
    """Draws a disk of alpha, whose edge is a ramp of some texels that is 0.5 at the radius."""
    y, x = np.mgrid[:side, :side] + 0.5 - side / 2
    texels = np.full((side, side, 4), (40, 160, 50, 0), np.uint8)
    texels[..., 0] = np.minimum(np.arange(side), 255)
    alpha = np.clip(0.5 + (radius - np.hypot(x, y)) / ramp, 0.0, 1.0)
    texels[..., 3] = np.rint(255 * alpha)
    return Image.fromarray(texels)


def gltf(
    material: dict[str, Any],
    sampler: dict[str, int] | None = None,
    pictures: Sequence[str] = ("leaf.png",),
    repeats: tuple[float, float] = (1.0, 1.0),
) -> bytes:
    """Writes a card of 2 m that stands upright on the origin, its pictures beside it."""
    points = np.array([[-1, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]], np.float32)
    # Counted from the top of the first picture.
    low, wide = 1.0 - repeats[1], repeats[0]
    uv = np.array([[0, 1], [wide, 1], [wide, low], [0, low]], np.float32)
    corners = np.array([0, 1, 2, 0, 2, 3], np.uint16)
    parts = [array.tobytes() for array in (points, uv, corners)]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    used = {} if sampler is None else {"sampler": 0}
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
            "images": [{"uri": name} for name in pictures],
            "textures": [{"source": i, **used} for i in range(len(pictures))],
            "samplers": [sampler or {}],
        },
        b"".join(parts),
    )


MASK = {
    "alphaMode": "MASK",
    "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0},
}


def leaf(folder: Path, name: str) -> Path:
    """Writes the card as a file of some format."""
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
    """Writes the card as a USD file, of the color that it has without a picture."""
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
    """Compiles and reads the card alone before a camera."""
    compile_cfg(write_cfg(folder, card(file)), seed=1, out=folder / "out")
    return read_stage(folder / "out" / "batch_0000" / "stage.usda")


def card(file: Path, **keys: Any) -> dict[str, Any]:
    """Returns a cfg of the card alone before a camera, with more keys of the class."""
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


def packed_card(file: Path, form: str, repeats: tuple[float, float]) -> Path:
    """Writes a card of 2 m that stands on the origin, with two pictures.

    Args:
        file: Of one of ``FORMATS``' endings.
        form: Their names, of ``color`` (with alpha) and ``packed`` (roughness, metal).
        repeats: Of the texture coordinates over the card, across and up.
    """
    color, packed = form.format("color"), form.format("packed")
    wide, high = repeats
    if file.suffix == ".glb":
        pbr = {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}}
        look: dict[str, Any] = {"alphaMode": "MASK", "pbrMetallicRoughness": pbr}
        file.write_bytes(gltf(look, None, (color, packed), repeats))
    elif file.suffix == ".obj":
        file.write_text(
            "mtllib card.mtl\nv -1 0 0\nv 1 0 0\nv 1 0 2\nv -1 0 2\n"
            f"vt 0 0\nvt {wide} 0\nvt {wide} {high}\nvt 0 {high}\nusemtl a\nf 1/1 2/2 3/3 4/4\n"
        )
        maps = f"map_Kd {color}\nmap_d {color}\nmap_Pr {packed}\nmap_Pm {packed}\n"
        file.with_suffix(".mtl").write_text(f"newmtl a\n{maps}")
    else:
        nodes = "".join(
            f"""    def Shader "{name}" {{
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @./{picture}@
        float2 inputs:st.connect = </look/st.outputs:result>
        color3f outputs:rgb
        float outputs:g
        float outputs:b
        float outputs:a
    }}
"""
            for name, picture in (("color", color), ("packed", packed))
        )
        file.write_text(f"""#usda 1.0
(
    defaultPrim = "card"
    upAxis = "Z"
    metersPerUnit = 1
)
def Mesh "card" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-1, 0, 0), (1, 0, 0), (1, 0, 2), (-1, 0, 2)]
    texCoord2f[] primvars:st = [(0, 0), ({wide}, 0), ({wide}, {high}), (0, {high})] (
        interpolation = "vertex"
    )
    rel material:binding = </look>
}}
def Material "look" {{
    token outputs:surface.connect = </look/surface.outputs:surface>
    def Shader "surface" {{
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </look/color.outputs:rgb>
        float inputs:opacity.connect = </look/color.outputs:a>
        float inputs:opacityThreshold = 0.5
        float inputs:roughness.connect = </look/packed.outputs:g>
        float inputs:metallic.connect = </look/packed.outputs:b>
        token outputs:surface
    }}
    def Shader "st" {{
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }}
{nodes}}}
""")
    return file
