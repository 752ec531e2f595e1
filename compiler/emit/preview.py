"""Writes UsdPreviewSurface of a material: what viewers can show of the shared surface model."""

from __future__ import annotations

from pxr import Gf, Sdf, Usd, UsdShade

from scenec.compiler.emit.layer import TYPES
from scenec.compiler.emit.maps import average_color
from scenec.compiler.scene.material import Material
from scenec.schemas import stage as names
from scenec.schemas.maps import COLORS

_PLAIN = (1.0, 1.0, 1.0)


def is_encoded(kind: str, file: str) -> bool:
    """Whether a map's values are colors in sRGB's transfer function."""
    return kind in COLORS and not file.endswith(".exr")


def write_preview(look: UsdShade.Material, material: Material, files: dict[str, str]) -> None:
    """Writes the nodes under a Material.

    It shows displayColor, where the merges of the ground are already blended, with the GGX lobe as
    its specular color (of a metal: its metallic part), and the material's number of roughness. A
    material whose maps lie by texture coordinates shows those, without variation: viewers can read
    them. Maps in the world are left out, and of what glows in pictures there the number is shown.

    Args:
        files: Its maps by kind, relative to the layer.
    """
    stage, path = look.GetPrim().GetStage(), look.GetPath()
    surface = UsdShade.Shader.Define(stage, path.AppendChild("Surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    by_uv = material.maps is not None and material.maps.projection == "uv"
    pictures = _Pictures(stage, path, material, files if by_uv else {})
    diffuse = surface.CreateInput("diffuseColor", TYPES.Color3f)
    if "base_color" in pictures.files:
        diffuse.ConnectToSource(pictures.output("base_color"))
    else:
        diffuse.ConnectToSource(_display_color(stage, path, material))
    if "metallic" in pictures.files:
        surface.CreateInput("metallic", TYPES.Float).ConnectToSource(pictures.output("metallic"))
    elif material.metallic > 0.0:
        surface.CreateInput("metallic", TYPES.Float).Set(material.metallic)
    else:
        surface.CreateInput("useSpecularWorkflow", TYPES.Int).Set(1)
        surface.CreateInput("specularColor", TYPES.Color3f).Set(Gf.Vec3f(material.specular))
    roughness = surface.CreateInput("roughness", TYPES.Float)
    if "roughness" in pictures.files:
        roughness.ConnectToSource(pictures.output("roughness"))
    else:
        roughness.Set(material.roughness)
    if "normal" in pictures.files:
        surface.CreateInput("normal", TYPES.Normal3f).ConnectToSource(pictures.output("normal"))
    if material.maps is not None and material.maps.cutout is not None:
        surface.CreateInput("opacity", TYPES.Float).ConnectToSource(pictures.output("opacity"))
        surface.CreateInput("opacityThreshold", TYPES.Float).Set(material.maps.cutout.threshold)
    if max(material.emission) > 0.0:
        glow = surface.CreateInput("emissiveColor", TYPES.Color3f)
        if "emission" in pictures.files:
            glow.ConnectToSource(pictures.output("emission"))
        else:
            glow.Set(Gf.Vec3f(*material.emission))
    look.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", TYPES.Token))


def _display_color(stage: Usd.Stage, path: Sdf.Path, material: Material) -> UsdShade.Output:
    color = UsdShade.Shader.Define(stage, path.AppendChild("Color"))
    color.CreateIdAttr("UsdPrimvarReader_float3")
    color.CreateInput("varname", TYPES.String).Set("displayColor")
    color.CreateInput("fallback", TYPES.Float3).Set(Gf.Vec3f(*average_color(material)))
    return color.CreateOutput("result", TYPES.Float3)


class _Pictures:
    """UsdUVTexture nodes, all at the mesh's texture coordinates."""

    def __init__(
        self, stage: Usd.Stage, path: Sdf.Path, material: Material, files: dict[str, str]
    ) -> None:
        self.files = files
        self._stage, self._path, self._material = stage, path, material

    def output(self, kind: str) -> UsdShade.Output:
        name = "".join(part.capitalize() for part in kind.split("_"))
        texture = UsdShade.Shader.Define(self._stage, self._path.AppendChild(f"{name}Texture"))
        texture.CreateIdAttr("UsdUVTexture")
        file = self.files[kind]
        texture.CreateInput("file", TYPES.Asset).Set(Sdf.AssetPath(file))
        texture.CreateInput("st", TYPES.Float2).ConnectToSource(self._coordinates())
        assert self._material.maps is not None
        cutout = self._material.maps.cutout if kind == "opacity" else None
        wraps = ("repeat", "repeat") if cutout is None else cutout.wrap
        for side, wrap in zip(("wrapS", "wrapT"), wraps, strict=True):
            texture.CreateInput(side, TYPES.Token).Set(wrap)
        texture.CreateInput("sourceColorSpace", TYPES.Token).Set(
            "sRGB" if is_encoded(kind, file) else "raw"
        )
        factors = {"base_color": self._material.base_color, "emission": self._material.emission}
        factor = factors.get(kind, _PLAIN)
        if factor != _PLAIN:
            texture.CreateInput("scale", TYPES.Float4).Set(Gf.Vec4f(*factor, 1.0))
        if kind == "normal":
            up = -1.0 if self._material.maps.normal_convention == "directx" else 1.0
            texture.CreateInput("scale", TYPES.Float4).Set(Gf.Vec4f(2.0, 2.0 * up, 2.0, 1.0))
            texture.CreateInput("bias", TYPES.Float4).Set(Gf.Vec4f(-1.0, -up, -1.0, 0.0))
        if kind in ("roughness", "metallic", "opacity"):
            return texture.CreateOutput("r", TYPES.Float)
        return texture.CreateOutput("rgb", TYPES.Float3)

    def _coordinates(self) -> UsdShade.Output:
        reader = UsdShade.Shader.Define(self._stage, self._path.AppendChild("Coordinates"))
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", TYPES.String).Set(names.PRIMVAR_UV)
        return reader.CreateOutput("result", TYPES.Float2)
