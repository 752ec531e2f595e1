"""Materials of USD files: UsdPreviewSurface, with UsdUVTexture and UsdTransform2d before it.

MDL's OmniPBR is translated to that.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pxr import Sdf, Usd, UsdShade

from scenec.compiler.assets import looks
from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.pictures import Source, companion, embedded
from scenec.compiler.assets.usd import TIME
from scenec.compiler.geometry import affine
from scenec.compiler.scene.material import Cutout
from scenec.schemas.omnipbr import as_preview_surface, mdl_shader
from scenec.schemas.packages import in_package, is_packaged, packaged_bytes, packaged_name
from scenec.schemas.stage import LOSSES, OPACITY_THRESHOLD
from scenec.schemas.udim import is_tiled, tiles_of

_KINDS = {
    "base_color": "diffuseColor", "roughness": "roughness", "metallic": "metallic",
    "normal": "normal", "opacity": "opacity",
}  # fmt: skip
_CHANNELS = {"r": 0, "g": 1, "b": 2, "a": 3}
_WRAPS = {"clamp": "clamp", "black": "clamp", "mirror": "mirror"}


class UsdLooks:
    """The materials of a stage, each read when a mesh first uses it.

    Attributes:
        known: Those in use.
        companions: Pictures beside the file.
        notes: What of the stage is left out.
    """

    def __init__(self, file: Path):
        self._file = file
        self._numbers: dict[str, int] = {}
        # Holds translations of MDL.
        self._scratch = Usd.Stage.CreateInMemory()
        self.known: list[looks.FileLook] = []
        self.companions: list[Path] = []
        self.notes: list[str] = []

    def number(self, material: UsdShade.Material | None) -> int:
        """Position of a material in ``known``; -1 for none."""
        if material is None:
            return -1
        prim = material.GetPrim()
        # Of instances, the one that they share.
        path = str((prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim).GetPath())
        if path not in self._numbers:
            self._numbers[path] = len(self.known)
            self.known.append(self._look(material))
        return self._numbers[path]

    def _look(self, material: UsdShade.Material) -> looks.FileLook:
        name, mdl = str(material.GetPrim().GetName()), mdl_shader(material)
        material = as_preview_surface(material, self._scratch, resolved=False) or material
        shader = material.ComputeSurfaceSource()[0]
        kind = str(shader.GetIdAttr().Get()) if shader else ""
        if kind != "UsdPreviewSurface":
            what = f"its shader {kind}" if shader else "a material without a UsdPreviewSurface"
            what = f"its MDL material {mdl[1]}" if mdl else what
            return looks.FileLook(name, notes=(f"{what} is not known: it is shown in gray",))
        notes: list[str] = (material.GetPrim().GetCustomDataByKey(LOSSES) or "").splitlines()
        clamps: list[bool] = []
        slots: dict[str, looks.Slot] = {}
        values: dict[str, Any] = {"diffuseColor": (0.18, 0.18, 0.18)}
        for kind, key in _KINDS.items():
            producer = _producer(shader.GetInput(key))
            if producer is None:
                continue
            if isinstance(producer, UsdShade.Output):
                slot = self._slot(name, kind, producer, notes, clamps, values)
                if slot is not None:
                    slots[kind] = slot
            else:
                values[key] = producer.Get(TIME)
        specular = looks.reflectance(float(_value(shader, "ior", 1.5)))
        if _value(shader, "useSpecularWorkflow", 0) == 1:
            color = _value(shader, "specularColor")
            specular = sum(map(float, color)) / 3.0 if color is not None else 0.0
            values["metallic"] = 0.0
            slots.pop("metallic", None)
            notes.append("the tint of its highlight is left out")
        for key, what, default in (
            ("opacity", looks.OPACITY, 1.0),
            ("clearcoat", "its coat is left out", 0.0),
            ("displacement", "its displacement is left out", 0.0),
        ):
            producer = _producer(shader.GetInput(key))
            textured = producer is not None and not _is_value(producer)
            if (textured and key not in slots) or float(_value(shader, key, default)) != default:
                notes.append(what)
        threshold, cutout = min(float(_value(shader, "opacityThreshold", 0.0)), 1.0), None
        if "opacity" in slots:
            if not threshold > 0.0:
                threshold = OPACITY_THRESHOLD
                notes.append(looks.BLENDED)
            cutout = Cutout(threshold, values["wraps"])
        glow = _producer(shader.GetInput("emissiveColor"))
        if glow is not None and (not _is_value(glow) or any(glow.Get(TIME) or ())):
            notes.append("its emission is left out")
        red, green, blue = map(float, values["diffuseColor"])
        return looks.FileLook(
            name,
            (red, green, blue),
            float(values.get("roughness", 0.5)),
            float(values.get("metallic", 0.0)),
            specular,
            slots,
            tuple(dict.fromkeys(notes)),
            not any(clamps),
            "directx" if values.get("normal") == "directx" else "opengl",
            cutout=cutout,
        )

    def _slot(
        self,
        name: str,
        kind: str,
        output: UsdShade.Output,
        notes: list[str],
        clamps: list[bool],
        values: dict[str, Any],
    ) -> looks.Slot | None:
        texture = UsdShade.Shader(output.GetPrim())
        shader = str(texture.GetIdAttr().Get()) if texture else ""
        if shader != "UsdUVTexture":
            if kind == "base_color" and shows_display_color(texture):
                values["diffuseColor"] = (1.0, 1.0, 1.0)
            elif kind == "base_color" and shader.startswith("UsdPrimvarReader"):
                notes.append(looks.NO_VERTEX_COLORS)
            else:
                notes.append(f"what gives its {kind} ({shader or 'a node'}) is not known")
            return None
        asset = _value(texture, "file")
        if not isinstance(asset, Sdf.AssetPath) or not asset.path:
            raise MeshFileError(f"material {name!r}: its {kind} picture has no file")
        channel = _CHANNELS.get(str(output.GetBaseName()), 0)
        if channel == 3 and kind != "opacity":
            notes.append(f"its {kind}, which is the alpha of {asset.path}, is left out")
            return None
        scale = [float(x) for x in _value(texture, "scale", (1.0,) * 4)]
        bias = [float(x) for x in _value(texture, "bias", (0.0,) * 4)]
        space = _value(texture, "sourceColorSpace", "auto")
        if kind == "base_color":
            values["diffuseColor"] = tuple(scale[:3])
            if any(bias[:3]):
                notes.append("what is added to its base color picture is left out")
            if space == "raw":
                notes.append(f"its base color picture {asset.path} is taken as sRGB, not as raw")
        elif kind == "normal":
            if scale[:2] not in ([2.0, 2.0], [1.0, 1.0], [2.0, -2.0]):
                notes.append("the strength of its map of normals is taken as 1")
            if scale[1] < 0.0:
                values["normal"] = "directx"
        elif space == "sRGB":
            notes.append(f"its {kind} picture {asset.path} is taken as raw, not as sRGB")
        wraps = [_value(texture, key, "useMetadata") for key in ("wrapS", "wrapT")]
        if kind == "opacity":
            values["wraps"] = tuple(_WRAPS.get(wrap, "repeat") for wrap in wraps)
        else:
            clamps += [wrap in _WRAPS for wrap in wraps]
        uv_set, uv_map = _coordinates(texture, notes)
        source = self._picture(asset)
        return looks.Slot(
            source, asset.path, channel, scale[channel], bias[channel], uv_set, uv_map
        )

    def _picture(self, asset: Sdf.AssetPath) -> Source:
        package, inner = Sdf.Layer.SplitIdentifier(asset.path)[0], Path(asset.resolvedPath)
        if is_tiled(package) and self._file.suffix.lower() == ".usdz":
            tiles = in_package(str(self._file), package)
            if tiles_of(tiles):
                return tiles
        if is_packaged(inner):
            try:
                return embedded(packaged_bytes(inner))
            except ValueError as error:
                name = packaged_name(inner)
                raise MeshFileError(f"the picture {name} in it cannot be read") from error
        path = companion(self._file, package, "picture")
        if path not in self.companions:
            self.companions.append(path)
        return path


def shows_display_color(node: UsdShade.Shader) -> bool:
    """Tells whether a node reads displayColor."""
    kind = str(node.GetIdAttr().Get()) if node else ""
    return kind.startswith("UsdPrimvarReader") and _value(node, "varname") == "displayColor"


def has_display_color(material: UsdShade.Material | None) -> bool:
    """Tells whether a material's color is displayColor; so it is without a material."""
    if material is None:
        return True
    shader = material.ComputeSurfaceSource()[0]
    producer = _producer(shader.GetInput("diffuseColor")) if shader else None
    if producer is None or _is_value(producer):
        return False
    return shows_display_color(UsdShade.Shader(producer.GetPrim()))


def _producer(source: UsdShade.Input | None) -> Any:
    """Returns the source of an input's value: an attribute, a shader's output, or None."""
    if not source:
        return None
    attributes = source.GetValueProducingAttributes()
    if not attributes:
        return None
    if UsdShade.Output.IsOutput(attributes[0]):
        return UsdShade.Output(attributes[0])
    return attributes[0] if attributes[0].Get(TIME) is not None else None


def _is_value(producer: Any) -> bool:
    return not isinstance(producer, UsdShade.Output)


def _value(shader: UsdShade.Shader, key: str, default: Any = None) -> Any:
    """A constant input; the default where it is left out, or comes from another node."""
    producer = _producer(shader.GetInput(key))
    return producer.Get(TIME) if producer is not None and _is_value(producer) else default


def _coordinates(texture: UsdShade.Shader, notes: list[str]) -> tuple[str, looks.UvMap]:
    """Primvar that a picture lies on, and what is done to it."""
    uv_map = looks.SAME_UV
    producer = _producer(texture.GetInput("st"))
    if producer is None or _is_value(producer):
        return "st", uv_map
    node = UsdShade.Shader(producer.GetPrim())
    if str(node.GetIdAttr().Get()) == "UsdTransform2d":
        # First scale, then rotation, then translation, as its specification says.
        s, c = affine.sin_cos(float(_value(node, "rotation", 0.0)))
        wide, high = map(float, _value(node, "scale", (1.0, 1.0)))
        x, y = map(float, _value(node, "translation", (0.0, 0.0)))
        uv_map = (c * wide, -s * high, x, s * wide, c * high, y)
        producer = _producer(node.GetInput("in"))
        if producer is None or _is_value(producer):
            return "st", uv_map
        node = UsdShade.Shader(producer.GetPrim())
    if str(node.GetIdAttr().Get()) != "UsdPrimvarReader_float2":
        notes.append("its texture coordinates come from what is not known: st is taken")
        return "st", uv_map
    return str(_value(node, "varname", "st")), uv_map
