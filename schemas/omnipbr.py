"""Translates MDL's OmniPBR, of Omniverse, to UsdPreviewSurface.

Names, defaults and meaning of the inputs are those of OmniPBR 2 as documented
(docs.omniverse.nvidia.com, materials and rendering, templates):

- The color is ``diffuse_texture * albedo_brightness + albedo_add``, else
  ``diffuse_color_constant``, times ``diffuse_tint``.
- Roughness and metallic are mixed from constant and texture by the texture's influence, which is 0
  by default; with ``enable_ORM_texture`` the texture is that of ORM, green and blue.
- ``flip_tangent_v``, true by default, says that y of normals goes down, as DirectX has it.
- ``specular_level`` is the reflectance at normal incidence over .08.
- Opacity counts with ``enable_opacity``; ``opacity_threshold`` above 0 cuts out.
- Texture coordinates are turned by ``texture_rotate``, multiplied by ``texture_scale``, and moved
  by ``texture_translate``.

Textures of single numbers are gray here: a channel stands for MDL's mean of three.
"""

from __future__ import annotations

import math
from pathlib import PurePosixPath
from typing import Any

from pxr import Gf, Sdf, Usd, UsdShade

from scenec.schemas.stage import LOSSES

_TYPES = Sdf.ValueTypeNames
_FIRST = Usd.TimeCode.EarliestTime()
_OPACITY = ("OmniPBR_Opacity", "OmniPBR_ClearCoat_Opacity")
_COATED = ("OmniPBR_ClearCoat", "OmniPBR_ClearCoat_Opacity")
_KNOWN = ("OmniPBR", *_OPACITY, *_COATED)
#: Inputs of no effect on what is drawn here, or that only say how another one is meant.
_ASIDE = frozenset(
    (
        *("excludeFromWhiteMode", "enable_ORM_texture", "enable_opacity_texture", "opacity_mode"),
        *("world_or_object", "ao_texture", "enable_emission", "enable_clearcoat"),
    )
)
#: Beginnings of inputs that count if another one is not as by default.
_GATED = {"emissive_": "enable_emission", "clearcoat_": "enable_clearcoat",
          "detail_": "detail_normalmap_texture"}  # fmt: skip
#: Inputs that are not followed, and the value at which they do nothing.
_NEUTRAL: dict[str, Any] = {
    "albedo_desaturation": 0.0, "ao_to_diffuse": 0.0, "bump_factor": 1.0, "flip_tangent_u": False,
    "project_uvw": False, "uv_space_index": 0, "geometry_normal_roughness_strength": 0.0,
    "round_edges_radius": 0.0, "enable_emission": False, "enable_clearcoat": False,
}  # fmt: skip


def mdl_shader(material: UsdShade.Material) -> tuple[UsdShade.Shader, str] | None:
    """Returns a material's MDL shader and the name of its MDL material; None without one.

    Where there is a surface for all renderers, that is taken: None, too, then.
    """
    shader, universal = (material.ComputeSurfaceSource(name)[0] for name in ("mdl", ""))
    asset = shader.GetSourceAsset("mdl") if shader else None
    if asset is None or (universal and universal.GetIdAttr().Get()):
        return None
    return shader, str(shader.GetSourceAssetSubIdentifier("mdl")) or PurePosixPath(asset.path).stem


def as_preview_surface(
    material: UsdShade.Material, scratch: Usd.Stage, resolved: bool = True
) -> UsdShade.Material | None:
    """Translates a material whose surface is OmniPBR.

    Args:
        material: The material, of a prototype perhaps.
        scratch: Receives the translation, at the same path; ``LOSSES`` of its custom data has a
            line for what it lacks.
        resolved: Whether it names the files that its pictures were found at, not as is authored.

    Returns:
        None where its surface is none.
    """
    found = mdl_shader(material)
    if found is None or found[1] not in _KNOWN:
        return None
    made = UsdShade.Material.Define(scratch, material.GetPath())
    lines = _Translation(found[0], found[1], made, resolved).written()
    if lines:
        made.GetPrim().SetCustomDataByKey(LOSSES, "\n".join(lines))
    return made


class _Translation:
    """Writes one surface, and collects the inputs that it lacks."""

    def __init__(
        self, source: UsdShade.Shader, name: str, made: UsdShade.Material, resolved: bool
    ) -> None:
        self._source, self._name, self._resolved = source, name, resolved
        self._stage = made.GetPrim().GetStage()
        self._lost: dict[str, None] = {}
        self._noted: list[str] = []
        self._used = set(_ASIDE)
        self._shader = UsdShade.Shader.Define(self._stage, source.GetPath())
        self._shader.CreateIdAttr("UsdPreviewSurface")
        output = self._shader.CreateOutput("surface", _TYPES.Token)
        made.CreateSurfaceOutput().ConnectToSource(output)
        self._st: UsdShade.Output | None = None

    def written(self) -> list[str]:
        """Writes it, and returns a line for each loss."""
        tint = self._color("diffuse_tint", (1.0, 1.0, 1.0))
        brightness = self._number("albedo_brightness", 1.0)
        add = self._number("albedo_add", 0.0)
        color = self._color("diffuse_color_constant", (0.2, 0.2, 0.2))
        scale, bias = ([one * factor for one in tint] for factor in (brightness, add))
        if not self._texture("diffuseColor", "diffuse_texture", "rgb", scale, bias):
            made = self._shader.CreateInput("diffuseColor", _TYPES.Color3f)
            made.Set(Gf.Vec3f(*(a * b for a, b in zip(color, tint, strict=True))))
        packed = self._flag("enable_ORM_texture", False)
        for name, ours, texture, channel, usual in (
            ("reflection_roughness", "roughness", "reflectionroughness_texture", "g", 0.5),
            ("metallic", "metallic", "metallic_texture", "b", 0.0),
        ):
            constant = self._number(f"{name}_constant", usual)
            share = self._number(f"{name}_texture_influence", 0.0)
            file = "ORM_texture" if packed else texture
            self._used |= {"ORM_texture", texture}
            rest = [constant * (1.0 - share)]
            if share == 0.0 or not self._texture(
                ours, file, channel if packed else "r", [share], rest
            ):
                if share != 0.0:
                    self._noted.append(f"{file} of {self._name} is none: its constant is taken")
                self._shader.CreateInput(ours, _TYPES.Float).Set(constant)
        root = math.sqrt(max(0.08 * self._number("specular_level", 0.5), 0.0))
        if root < 1.0:
            self._shader.CreateInput("ior", _TYPES.Float).Set((1.0 + root) / (1.0 - root))
        up = -1.0 if self._flag("flip_tangent_v", True) else 1.0
        if self._number("bump_factor", 1.0) != 0.0:
            self._texture(
                "normal", "normalmap_texture", "rgb", [2.0, 2.0 * up, 2.0], [-1.0, -up, -1.0]
            )
        self._used |= {"normalmap_texture"}
        self._opacity()
        self._note_others()
        return self._lines()

    def _opacity(self) -> None:
        self._used |= {"opacity_texture"}
        constant = self._number("opacity_constant", 1.0)
        threshold = self._number("opacity_threshold", 0.0)
        if not self._flag("enable_opacity", self._name in _OPACITY):
            return
        self._shader.CreateInput("opacityThreshold", _TYPES.Float).Set(threshold)
        # Of MDL's mono sources the first is alpha.
        channel = "a" if self._value("opacity_mode") == 0 else "r"
        textured = self._flag("enable_opacity_texture", False)
        if textured and self._texture("opacity", "opacity_texture", channel, [1.0], [0.0]):
            return
        self._shader.CreateInput("opacity", _TYPES.Float).Set(constant)

    def _value(self, name: str) -> Any:
        """An input's value, or the one that it is connected to; None without one."""
        attribute = self._attribute(name)
        return None if attribute is None else attribute.Get(_FIRST)

    def _attribute(self, name: str) -> Usd.Attribute | None:
        self._used.add(name)
        found = self._source.GetInput(name)
        for attribute in UsdShade.Utils.GetValueProducingAttributes(found) if found else ():
            if UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Input:
                return attribute
            self._noted.append(f"{name} of {self._name} from a node is not read")
        return None

    def _typed(self, name: str, kind: Any, usual: Any) -> Any:
        value = self._value(name)
        if value is None or isinstance(value, kind):
            return usual if value is None else value
        self._noted.append(f"{name} of {self._name} is no {usual!r:.20}: its default is taken")
        return usual

    def _number(self, name: str, usual: float) -> float:
        value = float(self._typed(name, int | float, usual))
        return value if math.isfinite(value) else usual

    def _flag(self, name: str, usual: bool) -> bool:
        return bool(self._typed(name, int | bool, usual))

    def _color(self, name: str, usual: tuple[float, float, float]) -> tuple[float, float, float]:
        red, green, blue = map(float, self._typed(name, Gf.Vec3f | Gf.Vec3d | Gf.Vec3h, usual))
        return (red, green, blue)

    def _texture(
        self, ours: str, name: str, channel: str, scale: list[float], bias: list[float]
    ) -> bool:
        """Has an input of ours read a texture, if there is one."""
        asset = self._typed(name, Sdf.AssetPath, Sdf.AssetPath())
        if not asset.path:
            return False
        node = UsdShade.Shader.Define(
            self._stage, self._shader.GetPath().AppendChild(f"{name}_{ours}")
        )
        node.CreateIdAttr("UsdUVTexture")
        file = node.CreateInput("file", _TYPES.Asset)
        found = asset.resolvedPath if self._resolved or "[" in asset.resolvedPath else ""
        if self._resolved and "<UDIM>" in asset.path:
            # USD resolves no tiles, and the translation stands in another layer.
            spec = self._attribute(name).GetPropertyStack(_FIRST)[0]  # type: ignore[union-attr]
            found = spec.layer.ComputeAbsolutePath(asset.path)
        file.Set(Sdf.AssetPath(found or asset.path))
        space = self._source.GetInput(name).GetAttr().GetColorSpace()
        if ours != "diffuseColor":
            space = "sRGB" if space == "sRGB" else "raw"
        if space in ("raw", "sRGB"):
            node.CreateInput("sourceColorSpace", _TYPES.Token).Set(space)
        for wrap in ("wrapS", "wrapT"):
            node.CreateInput(wrap, _TYPES.Token).Set("repeat")
        for label, numbers, neutral in (("scale", scale, 1.0), ("bias", bias, 0.0)):
            four = ([*numbers, neutral] if len(numbers) == 3 else numbers * 4)[:4]
            if any(one != neutral for one in four):
                node.CreateInput(label, _TYPES.Float4).Set(Gf.Vec4f(*four))
        node.CreateInput("st", _TYPES.Float2).ConnectToSource(self._coordinates())
        wide = channel == "rgb"
        output = node.CreateOutput(channel, _TYPES.Float3 if wide else _TYPES.Float)
        kind = _TYPES.Float if not wide else _TYPES.Normal3f if ours == "normal" else _TYPES.Color3f
        self._shader.CreateInput(ours, kind).ConnectToSource(output)
        return True

    def _coordinates(self) -> UsdShade.Output:
        """The nodes of the texture coordinates, which all textures share."""
        if self._st is not None:
            return self._st
        path = self._shader.GetPath()
        reader = UsdShade.Shader.Define(self._stage, path.AppendChild("st"))
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", _TYPES.String).Set("st")
        self._st = reader.CreateOutput("result", _TYPES.Float2)
        pairs = Gf.Vec2f | Gf.Vec2d
        scale = Gf.Vec2f(self._typed("texture_scale", pairs, Gf.Vec2f(1.0)))
        move = Gf.Vec2f(self._typed("texture_translate", pairs, Gf.Vec2f(0.0)))
        turn = self._number("texture_rotate", 0.0)
        steps: list[tuple[str, Any]] = [("rotation", turn)] if turn else []
        # One node scales before it turns: the same where both scales are.
        joined = scale[0] == scale[1]
        placing = {"scale": scale, "translation": move}
        for number, values in enumerate(
            [dict(steps) | placing] if joined else [dict(steps), placing] if turn else [placing]
        ):
            if values == {"scale": Gf.Vec2f(1.0), "translation": Gf.Vec2f(0.0)}:
                continue
            node = UsdShade.Shader.Define(self._stage, path.AppendChild(f"place_{number}"))
            node.CreateIdAttr("UsdTransform2d")
            node.CreateInput("in", _TYPES.Float2).ConnectToSource(self._st)
            for name, value in values.items():
                kind = _TYPES.Float if name == "rotation" else _TYPES.Float2
                node.CreateInput(name, kind).Set(value)
            self._st = node.CreateOutput("result", _TYPES.Float2)
        return self._st

    def _note_others(self) -> None:
        self._used |= {"texture_scale", "texture_translate", "texture_rotate"}
        coated = self._name in _COATED
        for found in self._source.GetInputs():
            name = str(found.GetBaseName())
            gate = next((g for start, g in _GATED.items() if name.startswith(start)), None)
            neutral = name in _NEUTRAL and self._value(name) in (None, _NEUTRAL[name])
            opens = getattr(self._value(gate), "path", self._value(gate)) if gate else True
            if not (opens or (coated and "coat" in str(gate))):
                continue
            if (name in self._used and name not in _NEUTRAL) or neutral:
                continue
            value = self._value(name)
            if getattr(value, "path", value) not in (None, ""):
                self._lost[name] = None

    def _lines(self) -> list[str]:
        lines = list(dict.fromkeys(self._noted))
        if self._lost:
            lines.append(f"of {self._name} is not followed: {', '.join(self._lost)}")
        return lines
