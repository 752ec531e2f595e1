"""Materials of ``.mtlx`` files as layers of USD, by the package MaterialX (extra ``materialx``).

A surface becomes a UsdPreviewSurface at the path that USD's own plug-in gives it,
``/MaterialX/Materials/NAME``: constants, and pictures through nodes that scale and shift them. What
is more than that has its default, and a line that names material and node. Looks become variants
``LookVariant`` of ``/ModelRoot``, as that plug-in has them: geometry is named from there.
"""

from __future__ import annotations

import importlib
import math
import os
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Usd, UsdShade

from scenec.backends.stage.materialx_nodes import (
    ONES,
    SPACES,
    ZEROS,
    NodeValue,
    UnreadNodeError,
    constant_of,
    followed,
    placing,
    source_of,
)
from scenec.schemas.errors import StageError
from scenec.schemas.packages import as_file
from scenec.schemas.stage import LOSSES
from scenec.schemas.udim import is_tiled, tiles_of

_ROOT, _MODEL = "/MaterialX", "/ModelRoot"
_TYPES = Sdf.ValueTypeNames
#: By surface: its inputs whose product an input of UsdPreviewSurface is.
MODELS: dict[str, dict[str, tuple[str, ...]]] = {
    "standard_surface": {
        "diffuseColor": ("base_color", "base"),
        "roughness": ("specular_roughness",),
        "metallic": ("metalness",),
        "normal": ("normal",),
        "emissiveColor": ("emission_color", "emission"),
        "opacity": ("opacity",),
        "ior": ("specular_IOR", "specular"),
    },
    # Its emission is in nits, and the stage's unit of light is any.
    "open_pbr_surface": {
        "diffuseColor": ("base_color", "base_weight"),
        "roughness": ("specular_roughness",),
        "metallic": ("base_metalness",),
        "normal": ("geometry_normal",),
        "opacity": ("geometry_opacity",),
        "ior": ("specular_ior", "specular_weight"),
    },
    "gltf_pbr": {
        "diffuseColor": ("base_color",),
        "roughness": ("roughness",),
        "metallic": ("metallic",),
        "normal": ("normal",),
        "emissiveColor": ("emissive", "emissive_strength"),
        "opacity": ("alpha",),
        "opacityThreshold": ("alpha_cutoff",),
        "ior": ("ior", "specular"),
    },
    "UsdPreviewSurface": {
        name: (name,)
        for name in (
            *("diffuseColor", "roughness", "metallic", "normal", "emissiveColor", "opacity"),
            *("opacityThreshold", "ior", "specularColor", "useSpecularWorkflow"),
        )
    },
}
_LIBRARIES = ("standard_surface", "open_pbr_surface", "gltf_pbr", "usd_preview_surface")
#: Without effect on what is drawn here.
_ASIDE = ("occlusion", "alpha_mode", "opacityMode", "clearcoatRoughness", "emission_color")
_COLORS = ("diffuseColor", "emissiveColor", "specularColor")
_WRAPS = {"periodic": "repeat", "clamp": "clamp", "mirror": "mirror"}


@dataclass
class MaterialXLook:
    """Writes one material, and notes what of it is not read.

    Attributes:
        material: The material.
        file: The file that it stands in: pictures are sought beside it.
        below: Of the material: what its new shaders stand in.
        lines: What is lost.
    """

    material: UsdShade.Material
    file: str
    below: str = "."
    lines: list[str] = field(default_factory=list)

    def path(self, name: str) -> Sdf.Path:
        """Returns the path of a new shader."""
        return self.material.GetPath().AppendPath(self.below).AppendChild(name)

    def lose(self, what: str) -> None:
        """Notes what is not read."""
        self.lines.append(what)


def materialx_layer(file: str, named: str) -> Sdf.Layer | None:
    """Reads the materials of a file into a layer in memory, with ``LOSSES`` of each.

    Args:
        file: A ``.mtlx``, also one inside of a package.
        named: What an error calls it.

    Returns:
        None where the package MaterialX is not installed.

    Raises:
        StageError: The file is no MaterialX.
    """
    try:
        mx: Any = importlib.import_module("MaterialX")
    except ImportError:
        return None
    document = mx.createDocument()
    try:
        with as_file(Path(file)) as there:
            mx.readFromXmlFile(document, str(there))
        bxdf = Path(mx.__file__).parent / "libraries" / "bxdf"
        for library in _LIBRARIES:
            definitions = mx.createDocument()
            mx.readFromXmlFile(definitions, str(bxdf / f"{library}.mtlx"))
            document.importLibrary(definitions)
        stage = Usd.Stage.CreateInMemory()
        stage.SetDefaultPrim(stage.DefinePrim(_ROOT))
        stage.DefinePrim(f"{_ROOT}/Materials")
        for node in document.getMaterialNodes():
            path = f"{_ROOT}/Materials/{node.getName().replace(':', '__')}"
            look = MaterialXLook(UsdShade.Material.Define(stage, path), file)
            for surface in mx.getShaderNodes(node, "surfaceshader"):
                write_surface(look, surface)
            if look.lines:
                look.material.GetPrim().SetCustomDataByKey(LOSSES, "\n".join(look.lines))
        for look in document.getLooks():
            _write_variant(stage, look)
    except _faults(mx) as error:
        raise StageError(f"{named}: cannot be read: {' '.join(str(error).split())}") from error
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    return layer


def _write_variant(stage: Usd.Stage, look: Any) -> None:
    """Writes a look as a variant of the model: the first of its assignments is strongest."""
    root = stage.DefinePrim(_MODEL)
    variants = root.GetVariantSets().AddVariantSet("LookVariant")
    variants.AddVariant(look.getName())
    variants.SetVariantSelection(look.getName())
    assigned, heirs = [], [look]
    while heirs[-1] is not None and heirs[-1].getName() not in {h.getName() for h in heirs[:-1]}:
        assigned += heirs[-1].getMaterialAssigns()
        heirs.append(heirs[-1].getInheritsFrom())
    with variants.GetVariantEditContext():
        binding = UsdShade.MaterialBindingAPI.Apply(root)
        for number, assign in enumerate(assigned):
            material = assign.getMaterial().replace(":", "__")
            source = stage.GetPrimAtPath(f"{_ROOT}/Materials/{material}")
            if not source:
                continue
            prim = stage.DefinePrim(f"{_MODEL}/Materials/assign_{number}")
            prim.GetReferences().AddInternalReference(source.GetPath())
            lines = (source.GetCustomDataByKey(LOSSES) or "").splitlines()
            if assign.getChildren():
                lines.append(f"variants of the look {look.getName()} are not followed")
            if assign.getGeom() or assign.getCollectionString():
                # Bindings are in the order of their names.
                collection = Usd.CollectionAPI.Apply(root, f"assign_{number:06d}")
                _gather(collection, assign, lines, set())
                binding.Bind(collection, UsdShade.Material(prim), collection.GetName())
            else:
                binding.Bind(UsdShade.Material(prim))
            if lines:
                prim.SetCustomDataByKey(LOSSES, "\n".join(lines))
    variants.ClearVariantSelection()


def _gather(
    collection: Usd.CollectionAPI, element: Any, lines: list[str], visited: set[str]
) -> None:
    """Adds the geometry of an assignment, or of a collection that it names, to a collection."""
    prefix, into = element.getActiveGeomPrefix(), collection.CreateIncludesRel()
    for attribute in ("geom", "includegeom", "excludegeom"):
        added = collection.CreateExcludesRel() if attribute == "excludegeom" else into
        for path in _listed(element, attribute):
            whole = f"{_MODEL}/{prefix}{path}".replace("//", "/").rstrip("/")
            if Sdf.Path.IsValidPathString(whole):
                added.AddTarget(whole)
            else:
                lines.append(f"the geometry {path} of a look is no path, and has not its material")
    for name in _listed(element, "collection") + _listed(element, "includecollection"):
        found = element.getDocument().getCollection(name)
        if found is not None and name not in visited:
            _gather(collection, found, lines, visited | {name})


def _listed(element: Any, attribute: str) -> list[str]:
    return [name.strip() for name in element.getAttribute(attribute).split(",") if name.strip()]


def _faults(mx: Any) -> tuple[type[Exception], ...]:
    # They derive from one another in C++ alone.
    return (
        *(mx.Exception, mx.ExceptionParseError, mx.ExceptionFileMissing),
        *(mx.ExceptionFoundCycle, mx.ExceptionOrphanedElement, ValueError),
    )


def write_surface(look: MaterialXLook, node: Any) -> None:
    """Writes a surface of MaterialX as the UsdPreviewSurface of a material.

    Args:
        look: The material.
        node: The surface: of the package MaterialX, or alike.
    """
    model = MODELS.get(node.getCategory())
    if model is None or node.getNodeDef() is None:
        look.lose(f"the surface {node.getName()} ({node.getCategory()}) is not read, "
                  "displayColor is shown")  # fmt: skip
        return
    stage = look.material.GetPrim().GetStage()
    shader = UsdShade.Shader.Define(stage, look.path("Surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    output = shader.CreateOutput("surface", _TYPES.Token)
    look.material.CreateSurfaceOutput().ConnectToSource(output)
    aside: tuple[str, ...] = ()
    if node.getCategory() == "gltf_pbr":
        # Opaque, masked at the cutoff, or blended.
        mode = int(_input(look, node, "alpha_mode").bias[0])
        aside = (("opacity", "opacityThreshold"), (), ("opacityThreshold",))[min(max(mode, 0), 2)]
    for name, factors in model.items():
        if name in aside or (name == "normal" and node.getInput(factors[0]) is None):
            continue
        first, *others = (_input(look, node, factor) for factor in factors)
        if name == "ior":
            _write(look, shader, name, _ior(look, first, *others))
        else:
            _write(look, shader, name, _product(look, first, *others))
    known = {name for factors in model.values() for name in (*factors, *_ASIDE)}
    ports = [port for port in node.getInputs() if port.getName() not in known]
    unread = [port.getName() for port in ports if _has_effect(node, port)]
    if unread:
        look.lose(f"{node.getName()} ({node.getCategory()}): not followed: {', '.join(unread)}")


def _product(look: MaterialXLook, value: NodeValue, *weights: NodeValue) -> NodeValue:
    for weight in weights:
        if weight.image is not None and value.image is not None:
            look.lose("a weight from a picture, of what is another picture, is not followed")
        elif weight.image is not None:
            value = weight.affine(value.bias, ZEROS)
        else:
            value = value.affine(weight.bias, ZEROS)
    return value


def _has_effect(node: Any, port: Any) -> bool:
    default = node.getNodeDef().getActiveInput(port.getName())
    if any(map(port.hasAttribute, ("nodename", "nodegraph", "interfacename"))):
        return True
    return default is None or port.getValue() != default.getValue()


def _ior(look: MaterialXLook, *factors: NodeValue) -> NodeValue:
    """The index whose reflectance at normal incidence is an index's times any weight."""
    ior, weight = factors if len(factors) == 2 else (*factors, NodeValue(ONES))
    if ior.image is not None or weight.image is not None:
        look.lose("an index of refraction, or its weight, from a picture is not followed")
        return NodeValue((1.5,) * 4)
    root = abs((ior.bias[0] - 1.0) / (ior.bias[0] + 1.0)) * math.sqrt(max(weight.bias[0], 0.0))
    return NodeValue(((1.0 + root) / max(1.0 - root, 1e-6),) * 4)


def _input(look: MaterialXLook, node: Any, name: str) -> NodeValue:
    """What an input of a surface is; its default where the network is not read."""
    default = constant_of(node.getNodeDef().getActiveInput(name))
    port = node.getInput(name)
    if port is None:
        return default
    try:
        value = followed(port)
        if value.image is not None and value.channel != "rgb" and "color" in name:
            raise UnreadNodeError(f"a color of one channel, from {value.image.getName()},")
        return value
    except UnreadNodeError as why:
        told = f"{name} of {node.getName()} ({node.getCategory()})"
        look.lose(f"{told}: {why} is not read, the default is taken")
        return default


def _write(look: MaterialXLook, shader: UsdShade.Shader, name: str, value: NodeValue) -> None:
    kind = _TYPES.Color3f if name in _COLORS else _TYPES.Float
    kind = {"normal": _TYPES.Normal3f, "useSpecularWorkflow": _TYPES.Int}.get(name, kind)
    if value.image is not None:
        shader.CreateInput(name, kind).ConnectToSource(_texture(look, name, value))
    elif name in _COLORS:
        shader.CreateInput(name, kind).Set(value.bias[:3])
    elif name == "opacity":
        shader.CreateInput(name, kind).Set(sum(value.bias[:3]) / 3.0)
    elif name != "normal":
        number = value.bias[0]
        shader.CreateInput(name, kind).Set(int(number) if kind == _TYPES.Int else number)


def _texture(look: MaterialXLook, name: str, value: NodeValue) -> UsdShade.Output:
    node = value.image
    file, _ = source_of(node.getInput("file"))
    srgb = False
    colored = node.getType() not in ("float", "vector2", "vector3", "vector4")
    if colored and name != "normal" and value.channel != "a":
        space = file.getActiveColorSpace()
        if space not in SPACES:
            look.lose(f"the color space {space} of the node {node.getName()} is taken as linear")
        srgb = SPACES.get(space, False)
    path = look.path(f"{name}_texture")
    texture = UsdShade.Shader.Define(look.material.GetPrim().GetStage(), path)
    texture.CreateIdAttr("UsdUVTexture")
    picture = Sdf.AssetPath(_picture(look.file, file))
    texture.CreateInput("file", _TYPES.Asset).Set(picture)
    texture.CreateInput("sourceColorSpace", _TYPES.Token).Set("sRGB" if srgb else "raw")
    for ours, theirs in (("wrapS", "uaddressmode"), ("wrapT", "vaddressmode")):
        port = node.getInput(ours if node.getCategory() == "UsdUVTexture" else theirs)
        mode = "periodic" if port is None else port.getValueString()
        texture.CreateInput(ours, _TYPES.Token).Set(_WRAPS.get(mode, "black"))
    if name == "normal":
        # A node of normals in MaterialX decodes by itself; a texture of USD says 2 * value - 1.
        decoded = node.getCategory() == "UsdUVTexture" and value.scale != ONES
        value = value if decoded else replace(value, scale=(2.0,) * 4, bias=(-1.0,) * 4)
    for label, four, neutral in (("scale", value.scale, ONES), ("bias", value.bias, ZEROS)):
        if four != neutral:
            texture.CreateInput(label, _TYPES.Float4).Set(four)
    texture.CreateInput("st", _TYPES.Float2).ConnectToSource(_coordinates(look, path, node))
    channel = value.channel
    if channel == "rgb" and name not in (*_COLORS, "normal"):
        channel = "r"
    kind = _TYPES.Float3 if channel == "rgb" else _TYPES.Float
    return texture.CreateOutput(channel, kind)


def _picture(beside: str, file: Any) -> str:
    """The path of a picture: by its prefixes, or without, as USD's own reader has it."""
    own = file.getValueString()
    candidates = [f"{file.getActiveFilePrefix()}{own}", own]
    paths = [Sdf.ComputeAssetPathRelativeToLayer(Sdf.Layer.CreateAnonymous(), c) if
             os.path.isabs(c) else _joined(beside, c) for c in candidates]  # fmt: skip
    tiled = (path for path in paths if is_tiled(path) and tiles_of(Path(path)))
    plain = (path for path in paths if Ar.GetResolver().Resolve(path))
    return next(chain(plain, tiled), paths[-1])


def _joined(beside: str, relative: str) -> str:
    if Ar.IsPackageRelativePath(beside):
        package, inner = Ar.SplitPackageRelativePathInner(beside)
        inside = os.path.normpath(os.path.join(os.path.dirname(inner), relative))
        return str(Ar.JoinPackageRelativePath(package, inside))
    return os.path.normpath(os.path.join(os.path.dirname(os.path.abspath(beside)), relative))


def _coordinates(look: MaterialXLook, path: Sdf.Path, node: Any) -> UsdShade.Output:
    """The nodes of a picture's texture coordinates; those of its own tiling come last."""
    stage = look.material.GetPrim().GetStage()
    primvar, steps = placing(node)
    reader = UsdShade.Shader.Define(stage, path.AppendChild("st"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", _TYPES.String).Set(primvar)
    output = reader.CreateOutput("result", _TYPES.Float2)
    for number, (scale, turn_deg, translation) in enumerate(steps):
        step = UsdShade.Shader.Define(stage, path.AppendChild(f"place_{number}"))
        step.CreateIdAttr("UsdTransform2d")
        step.CreateInput("in", _TYPES.Float2).ConnectToSource(output)
        step.CreateInput("scale", _TYPES.Float2).Set(scale)
        if turn_deg:
            step.CreateInput("rotation", _TYPES.Float).Set(turn_deg)
        step.CreateInput("translation", _TYPES.Float2).Set(translation)
        output = step.CreateOutput("result", _TYPES.Float2)
    return output
