"""MaterialX networks within a stage's own layers, read without the package MaterialX.

A material whose only surface is one of ``outputs:mtlx:surface`` gets a UsdPreviewSurface beside it,
in the stage's session layer, by the same rules as those of ``.mtlx`` files. Its shaders are shown
to these as nodes of MaterialX.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pxr import Sdf, Usd, UsdShade

from scenec.backends.stage.materialx import (
    LOSSES,
    MODELS,
    MaterialXLook,
    write_surface,
)
from scenec.backends.stage.materialx_nodes import KNOWN_NODES
from scenec.schemas import stage as names

_CONTEXT = "mtlx"
_BELOW = "scenecPreview"
#: Of MaterialX 1.39: what an input that is not authored is, where that is not 0.
_DEFAULTS: dict[str, dict[str, str]] = {
    "standard_surface": {
        "base": "1", "base_color": "0.8 0.8 0.8", "specular": "1", "specular_roughness": "0.2",
        "specular_IOR": "1.5", "emission_color": "1 1 1", "opacity": "1 1 1",
    },
    "open_pbr_surface": {
        "base_weight": "1", "base_color": "0.8 0.8 0.8", "specular_weight": "1",
        "specular_roughness": "0.3", "specular_ior": "1.5", "geometry_opacity": "1",
    },
    "gltf_pbr": {
        "base_color": "1 1 1", "metallic": "1", "roughness": "1", "specular": "1", "ior": "1.5",
        "alpha": "1", "alpha_cutoff": "0.5", "emissive_strength": "1",
    },
    "UsdPreviewSurface": {
        "diffuseColor": "0.18 0.18 0.18", "roughness": "0.5", "opacity": "1", "ior": "1.5",
    },
}  # fmt: skip
#: Inputs whose value 0 means that something is not there; others only say how it is.
_WEIGHTS = (
    *("coat", "sheen", "subsurface", "transmission", "thin_film_thickness"),
    *("coat_weight", "fuzz_weight", "subsurface_weight", "transmission_weight"),
    *("thin_film_weight", "specular_anisotropy", "specular_roughness_anisotropy", "clearcoat"),
)
_TYPES = {
    "color3f": "color3", "color4f": "color4", "float": "float", "float2": "vector2",
    "float3": "vector3", "float4": "vector4", "normal3f": "vector3", "vector3f": "vector3",
    "texCoord2f": "vector2", "int": "integer", "token": "string", "string": "string",
    "asset": "filename", "bool": "boolean",
}  # fmt: skip


@dataclass(frozen=True)
class _UnauthoredInput:
    """An input that is not authored."""

    name: str
    text: str

    def getName(self) -> str:  # noqa: N802 - MaterialX's own names
        return self.name

    def getType(self) -> str:  # noqa: N802
        return "float"

    def getValueString(self) -> str:  # noqa: N802
        return self.text

    getValue = getValueString  # noqa: N815


@dataclass(frozen=True)
class _ShaderPort:
    """An input, as a port of MaterialX: what it stands for through graphs and interfaces."""

    name: str
    attribute: Usd.Attribute

    def getName(self) -> str:  # noqa: N802
        return self.name

    def getType(self) -> str:  # noqa: N802
        return _TYPES.get(str(self.attribute.GetTypeName()), "")

    def hasAttribute(self, _: str) -> bool:  # noqa: N802
        return False

    def getAttribute(self, _: str) -> str:  # noqa: N802
        return ""

    def getActiveFilePrefix(self) -> str:  # noqa: N802
        return ""

    def getActiveColorSpace(self) -> str:  # noqa: N802
        return str(self.attribute.GetColorSpace() if self.attribute.HasColorSpace() else "")

    def getConnectedNode(self) -> _ShaderNode | None:  # noqa: N802
        shader = UsdShade.Shader(self.attribute.GetPrim())
        return _ShaderNode(shader) if UsdShade.Output.IsOutput(self.attribute) and shader else None

    def getOutputString(self) -> str:  # noqa: N802
        return str(self.attribute.GetName().removeprefix("outputs:"))

    def getValueString(self) -> str:  # noqa: N802
        value = self.attribute.Get(Usd.TimeCode.EarliestTime())
        if isinstance(value, Sdf.AssetPath):
            return str(value.resolvedPath or value.path)
        if isinstance(value, bool):
            return str(int(value))
        try:
            return " ".join(f"{number:.9g}" for number in value)
        except (TypeError, ValueError):
            return "" if value is None else str(value)

    getValue = getValueString  # noqa: N815


@dataclass(frozen=True)
class _ShaderNode:
    """A shader, as a node of MaterialX."""

    shader: UsdShade.Shader

    def _id(self) -> str:
        return str(self.shader.GetIdAttr().Get() or "").removeprefix("ND_")

    def getName(self) -> str:  # noqa: N802
        return str(self.shader.GetPrim().GetName())

    def getCategory(self) -> str:  # noqa: N802
        """The longest name of a node that the shader's id begins with; else the id."""
        known = (n for n in (*MODELS, *KNOWN_NODES) if f"{self._id()}_".startswith(f"{n}_"))
        return max(known, key=len, default=self._id())

    def getType(self) -> str:  # noqa: N802
        outputs = self.shader.GetOutputs()
        return _TYPES.get(str(outputs[0].GetTypeName()), "") if len(outputs) == 1 else ""

    def getInput(self, name: str) -> _ShaderPort | None:  # noqa: N802
        found = self.shader.GetInput(name)
        producing = found.GetValueProducingAttributes() if found else ()
        return _ShaderPort(name, producing[0]) if producing else None

    def getInputs(self) -> list[_ShaderPort]:  # noqa: N802
        """Those that say something of what is not read."""
        own = [self.getInput(str(found.GetBaseName())) for found in self.shader.GetInputs()]
        heard = [port for port in own if port is not None and port.name in _WEIGHTS]
        return [p for p in heard if p.getConnectedNode() or p.getValueString().strip("0. ")]

    def getNodeDef(self) -> _ShaderNode:  # noqa: N802
        return self

    def getActiveInput(self, name: str) -> Any:  # noqa: N802
        """What an input is where it is not authored."""
        return _UnauthoredInput(name, _DEFAULTS.get(self.getCategory(), {}).get(name, "0"))


def preview_networks(stage: Usd.Stage) -> None:
    """Gives materials whose only surface is MaterialX's a UsdPreviewSurface, in the session layer.

    Args:
        stage: Composed; instances whose materials are so are no longer shared.
    """
    within = any(_lone(Usd.PrimRange(prototype)) for prototype in stage.GetPrototypes())
    prims = stage.Traverse(Usd.TraverseInstanceProxies()) if within else stage.Traverse()
    found = _lone(prims)
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for path in [prim.GetPath() for prim in found]:
            for above in path.GetPrefixes():
                if stage.GetPrimAtPath(above).IsInstance():
                    stage.GetPrimAtPath(above).SetInstanceable(False)
            _preview(UsdShade.Material.Get(stage, path))


def _lone(prims: Iterable[Usd.Prim]) -> list[Usd.Prim]:
    return [p for p in prims if p.IsA(UsdShade.Material) and _surface(UsdShade.Material(p))]


def _surface(material: UsdShade.Material) -> UsdShade.Shader | None:
    """The shader of MaterialX that is a material's only surface."""
    output = material.GetSurfaceOutput(_CONTEXT)
    if not output or material.GetPrim().HasAttribute(names.ATTR_BASE_COLOR):
        return None
    if material.ComputeSurfaceSource()[0]:
        return None
    return material.ComputeSurfaceSource(_CONTEXT)[0] or None


def _preview(material: UsdShade.Material) -> None:
    shader = _surface(material)
    if shader is None:
        return
    node = _ShaderNode(shader)
    if node.getCategory() not in MODELS:
        return
    prim = material.GetPrim()
    file = prim.GetPrimStack()[-1].layer.realPath
    look = MaterialXLook(material, file, _BELOW)
    write_surface(look, node)
    if look.lines:
        prim.SetCustomDataByKey(LOSSES, "\n".join(look.lines))
