"""One textured box, as each format of models writes it: for tests of ``compiler/assets``.

Six sides as quads, each with the whole picture; sides 0 to 2 have the material "plain", 3 to 5
"painted", which has pictures. Z is up, and one unit is a meter.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from scenec.testing.overhangs import glb

BOX = np.array([[x, y, z] for x in (0, 2) for y in (0, 3) for z in (0, 5)], float)
QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)
SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
#: Corners of the two triangles of a quad.
SPLIT = [0, 1, 2, 0, 2, 3]
PLAIN = {"base_color": (0.5, 0.25, 0.125), "roughness": 0.75, "metallic": 0.25}
MODELS = ("obj", "gltf", "glb", "usda", "usdc", "usdz")


def faces() -> np.ndarray:
    """The box's triangles."""
    return QUADS[:, SPLIT].reshape(-1, 3)


def uv() -> np.ndarray:
    """Texture coordinates of the triangles' corners, v up."""
    return np.tile(SQUARE[SPLIT].reshape(2, 3, 2), (6, 1, 1))


def pictures() -> dict[str, np.ndarray]:
    """Color, gray roughness and metallic, and one that packs the last two in green and blue."""
    rng = np.random.default_rng(3)
    color = rng.integers(0, 256, (8, 8, 3), np.uint8)
    rough, metal = (rng.integers(0, 256, (8, 8), np.uint8) for _ in range(2))
    packed = np.stack([np.zeros_like(rough), rough, metal], axis=-1)
    normal = np.clip(rng.normal([128, 128, 240], 10, (8, 8, 3)), 0, 255).astype(np.uint8)
    return {
        "color": color, "rough": rough, "metal": metal, "packed": packed, "normal": normal
    }  # fmt: skip


def encoded(pixels: np.ndarray, kind: str = "PNG") -> bytes:
    """The bytes of a picture file."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind)
    return stream.getvalue()


def write_pictures(folder: Path) -> None:
    """All of ``pictures`` into ``folder/tex``."""
    (folder / "tex").mkdir(exist_ok=True)
    for name, pixels in pictures().items():
        (folder / "tex" / f"{name}.png").write_bytes(encoded(pixels))


def keys(suffix: str) -> dict[str, object]:
    """What a cfg must say of a file that ``write`` wrote."""
    return {"unit_m": 1, "up": "z"} if suffix == "obj" else {}


def write(path: Path) -> Path:
    """The box in the format that the path's ending names, with its companions."""
    write_pictures(path.parent)
    {".obj": _obj, ".gltf": _gltf, ".glb": _gltf}.get(path.suffix, _usd)(path)
    return path


MTL = """# two materials
newmtl plain
Kd 0.5 0.25 0.125
Pr 0.75
Pm 0.25

newmtl painted
Kd 0.8 0.8 0.8
map_Kd tex/color.png
map_Pr tex/rough.png
map_Pm tex/metal.png
norm tex/normal.png
"""


def _obj(path: Path) -> None:
    lines = ["mtllib box.mtl", "o box", *(f"v {x} {y} {z}" for x, y, z in BOX.tolist())]
    lines += [f"vt {u} {v}" for u, v in SQUARE.tolist()]
    for i, quad in enumerate(QUADS.tolist()):
        lines += ["usemtl plain"] * (i == 0) + ["usemtl painted"] * (i == 3)
        lines.append("f " + " ".join(f"{p + 1}/{k + 1}" for k, p in enumerate(quad)))
    path.write_text("\n".join(lines) + "\n")
    (path.parent / "box.mtl").write_text(MTL)


def gltf_parts(beside: bool) -> tuple[dict, bytes]:
    """The document and the buffer of the box: two primitives, corners as vertices."""
    corners = BOX[faces()]
    y_up = np.stack([corners[..., 0], corners[..., 2], -corners[..., 1]], axis=-1)
    st = uv()
    st = np.stack([st[..., 0], 1.0 - st[..., 1]], axis=-1)
    binary = y_up.astype("<f4").tobytes() + st.astype("<f4").tobytes()
    views = [{"buffer": 0, "byteLength": 432}, {"buffer": 0, "byteOffset": 432, "byteLength": 288}]
    accessors = []
    for half in range(2):
        for view, kind, size in ((0, "VEC3", 12), (1, "VEC2", 8)):
            accessors.append({
                "bufferView": view, "byteOffset": 18 * size * half, "componentType": 5126,
                "count": 18, "type": kind,
            })  # fmt: skip
    images: list[dict[str, Any]] = []
    for name in ("color", "packed", "normal"):
        if beside:
            images.append({"uri": f"tex/{name}.png"})
            continue
        data = encoded(pictures()[name])
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        images.append({"bufferView": len(views) - 1, "mimeType": "image/png"})
        binary += data + bytes(-len(data) % 4)
    document = {
        "asset": {"version": "2.0"},
        "nodes": [{"name": "box", "mesh": 0}],
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 2 * k, "TEXCOORD_0": 2 * k + 1}, "material": k}
            for k in range(2)
        ]}],
        "materials": [
            {"name": "plain", "pbrMetallicRoughness": {
                "baseColorFactor": [0.5, 0.25, 0.125, 1], "roughnessFactor": 0.75,
                "metallicFactor": 0.25,
            }},
            {"name": "painted", "normalTexture": {"index": 2}, "pbrMetallicRoughness": {
                "baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1},
            }},
        ],
        "textures": [{"source": k} for k in range(3)],
        "images": images,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }  # fmt: skip
    return document, binary


def _gltf(path: Path) -> None:
    beside = path.suffix == ".gltf"
    document, binary = gltf_parts(beside)
    if beside:
        document["buffers"][0]["uri"] = "box%20data.bin"
        (path.parent / "box data.bin").write_bytes(binary)
        path.write_text(json.dumps(document))
    else:
        path.write_bytes(glb(document, binary))


def _usd(path: Path) -> None:
    from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdUtils

    stage = Usd.Stage.CreateNew(str(path.with_suffix(".usdc") if path.suffix == ".usdz" else path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = UsdGeom.Mesh.Define(stage, "/box")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr(BOX.tolist())
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(QUADS.ravel().tolist())
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
    )
    st.Set(SQUARE.tolist())
    st.SetIndices([0, 1, 2, 3] * 6)
    types = Sdf.ValueTypeNames
    for name, sides in (("plain", [0, 1, 2]), ("painted", [3, 4, 5])):
        material = UsdShade.Material.Define(stage, f"/looks/{name}")
        shader = UsdShade.Shader.Define(stage, f"/looks/{name}/surface")
        shader.CreateIdAttr("UsdPreviewSurface")
        material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", types.Token))
        if name == "plain":
            shader.CreateInput("diffuseColor", types.Color3f).Set(PLAIN["base_color"])
            shader.CreateInput("roughness", types.Float).Set(PLAIN["roughness"])
            shader.CreateInput("metallic", types.Float).Set(PLAIN["metallic"])
        else:
            reader = UsdShade.Shader.Define(stage, f"/looks/{name}/st")
            reader.CreateIdAttr("UsdPrimvarReader_float2")
            reader.CreateInput("varname", types.String).Set("st")
            for key, file, channel, kind in (
                ("diffuseColor", "color", "rgb", types.Color3f),
                ("roughness", "packed", "g", types.Float),
                ("metallic", "packed", "b", types.Float),
                ("normal", "normal", "rgb", types.Normal3f),
            ):
                texture = UsdShade.Shader.Define(stage, f"/looks/{name}/{key}")
                texture.CreateIdAttr("UsdUVTexture")
                texture.CreateInput("file", types.Asset).Set(f"./tex/{file}.png")
                texture.CreateInput("st", types.Float2).ConnectToSource(
                    reader.CreateOutput("result", types.Float2)
                )
                if key == "normal":
                    texture.CreateInput("scale", types.Float4).Set((2, 2, 2, 1))
                    texture.CreateInput("bias", types.Float4).Set((-1, -1, -1, 0))
                shader.CreateInput(key, kind).ConnectToSource(texture.CreateOutput(channel, kind))
        subset = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).CreateMaterialBindSubset(
            name, sides
        )
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
    stage.Save()
    if path.suffix == ".usdz":
        assert UsdUtils.CreateNewUsdzPackage(str(path.with_suffix(".usdc")), str(path))
        path.with_suffix(".usdc").unlink()
