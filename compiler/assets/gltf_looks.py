"""Reads materials of glTF files: metallic and roughness, with the extensions known here."""

from __future__ import annotations

from typing import Any

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets import looks
from scenec.compiler.assets.gltf_file import GltfFile, natural
from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.pictures import Source, embedded
from scenec.compiler.geometry import affine
from scenec.compiler.scene.material import Cutout
from scenec.schemas.codec import JsonObject
from scenec.schemas.stage import OPACITY_THRESHOLD

_REPEAT = 10497
_WRAPS = {_REPEAT: "repeat", 33071: "clamp", 33648: "mirror"}
#: Extensions of materials that are read; of the others only their names are told.
_THROUGH = "KHR_materials_diffuse_transmission"
_READ = ("KHR_materials_ior", "KHR_materials_specular", "KHR_materials_pbrSpecularGlossiness",
         "KHR_materials_emissive_strength", _THROUGH)  # fmt: skip


class GltfLooks:
    """The materials of a document, each read when a mesh first uses it.

    Attributes:
        known: Those in use.
    """

    def __init__(self, file: GltfFile):
        self._file = file
        self._numbers: dict[int, int] = {}
        self.known: list[looks.FileLook] = []
        self._pictures: dict[int, tuple[Source, str]] = {}

    def number(self, index: Any) -> int:
        """Position of a document's material in ``known``."""
        if natural(index) not in self._numbers:
            self._numbers[index] = len(self.known)
            self.known.append(self._look(self._file.document["materials"][index]))
        return self._numbers[index]

    def sees_alpha(self, primitive: JsonObject) -> bool:
        """Whether a primitive's material is not opaque, whatever its vertices' alpha."""
        if "material" not in primitive:
            return False
        material = self._file.document["materials"][natural(primitive["material"])]
        return bool(material.get("alphaMode", "OPAQUE") != "OPAQUE")

    def _look(self, material: dict[str, Any]) -> looks.FileLook:
        name = str(material.get("name", ""))
        notes: list[str] = []
        clamps: list[bool] = []
        cutout = None
        pbr = material.get("pbrMetallicRoughness", {})
        extensions = material.get("extensions", {})
        slots: dict[str, looks.Slot] = {}

        def slot(kind: str, info: Any, channel: int = 0, scale: float = 1.0) -> None:
            found = self._slot(info, channel, scale, clamps)
            if found is None:
                notes.append(f"its {kind} picture is of a kind that is not known")
            else:
                slots[kind] = found

        red, green, blue = map(float, list(pbr.get("baseColorFactor", (1.0, 1.0, 1.0)))[:3])
        metallic = float(pbr.get("metallicFactor", 1.0))
        roughness = float(pbr.get("roughnessFactor", 1.0))
        if "baseColorTexture" in pbr:
            slot("base_color", pbr["baseColorTexture"])
        if "metallicRoughnessTexture" in pbr:
            slot("roughness", pbr["metallicRoughnessTexture"], 1, roughness)
            slot("metallic", pbr["metallicRoughnessTexture"], 2, metallic)
        gloss = extensions.get("KHR_materials_pbrSpecularGlossiness")
        if gloss is not None and not pbr:
            red, green, blue = map(float, list(gloss.get("diffuseFactor", (1.0, 1.0, 1.0)))[:3])
            metallic, roughness = 0.0, 1.0 - float(gloss.get("glossinessFactor", 1.0))
            if "diffuseTexture" in gloss:
                slot("base_color", gloss["diffuseTexture"])
            notes.append("its specular color and glossiness picture are left out")
        if "normalTexture" in material:
            slot("normal", material["normalTexture"])
            if material["normalTexture"].get("scale", 1) != 1:
                notes.append("the strength of its map of normals is taken as 1")
        mode, alpha = material.get("alphaMode", "OPAQUE"), 3
        picture, factors = pbr.get("baseColorTexture"), pbr.get("baseColorFactor", ())
        if gloss is not None and not pbr:
            picture, factors = gloss.get("diffuseTexture"), gloss.get("diffuseFactor", ())
        if mode != "OPAQUE" and picture is None:
            notes.append(looks.OPACITY)
        elif mode == "MASK":
            factor = float(factors[3]) if len(factors) > alpha else 1.0
            cutout = self._cutout(picture, float(material.get("alphaCutoff", 0.5)))
            slot("opacity", picture, alpha, factor)
        elif mode != "OPAQUE":
            cutout = self._cutout(picture, OPACITY_THRESHOLD)
            slot("opacity", picture, alpha)
            notes.append(looks.BLENDED)
        notes += self._left_out(material)
        specular = looks.reflectance(float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5)))
        specular *= float(extensions.get("KHR_materials_specular", {}).get("specularFactor", 1.0))
        base = (red, green, blue)
        through = extensions.get(_THROUGH, {})
        share = float(through.get("diffuseTransmissionFactor", 0.0))
        if share > 0.0 and not _of_one_color(through, base, pbr.get("baseColorTexture")):
            notes.append("the light that it transmits has the color of what it reflects")
        return looks.FileLook(
            name, base, roughness, metallic, specular, slots, tuple(notes),
            repeats=not any(clamps), diffuse_transmission=share, cutout=cutout,
        )  # fmt: skip

    @staticmethod
    def _left_out(material: dict[str, Any]) -> list[str]:
        notes = []
        if any(material.get("emissiveFactor", ())) or "emissiveTexture" in material:
            notes.append("its emission is left out")
        if "occlusionTexture" in material:
            notes.append("its occlusion picture is left out: light is traced")
        notes += [
            f"its {name} {looks.NOT_FOLLOWED}"
            for name in material.get("extensions", {})
            if name not in _READ
        ]
        return notes

    def _sampler(self, info: Any) -> dict[str, Any]:
        document = self._file.document
        texture = document["textures"][natural(info["index"])]
        return document["samplers"][natural(texture["sampler"])] if "sampler" in texture else {}

    def _cutout(self, info: Any, threshold: float) -> Cutout | None:
        """Returns how alpha cuts a surface; None where it cuts nothing."""
        across, up = (
            _WRAPS.get(self._sampler(info).get(key, _REPEAT), "repeat")
            for key in ("wrapS", "wrapT")
        )
        return Cutout(min(threshold, 1.0), (across, up)) if threshold > 0.0 else None

    def _slot(self, info: Any, channel: int, scale: float, clamps: list[bool]) -> looks.Slot | None:
        document = self._file.document
        texture = document["textures"][natural(info["index"])]
        webp = texture.get("extensions", {}).get("EXT_texture_webp", {}).get("source")
        index = texture.get("source", webp)
        if index is None and "KHR_texture_basisu" in texture.get("extensions", {}):
            raise MeshFileError(
                "a picture in KTX2 alone (KHR_texture_basisu), which no reader here knows: turn it "
                "into PNG, as 'ktx extract' of Khronos's KTX-Software does, or export it without"
            )
        if index is None:
            return None
        sampler = self._sampler(info)
        clamps.append(any(sampler.get(k, _REPEAT) != _REPEAT for k in ("wrapS", "wrapT")))
        moved = info.get("extensions", {}).get("KHR_texture_transform", {})
        uv_set = natural(moved.get("texCoord", info.get("texCoord", 0)))
        source, label = self._picture(natural(index))
        uv_map = _uv_map(moved) if moved else looks.SAME_UV
        return looks.Slot(source, label, channel, scale, 0.0, f"TEXCOORD_{uv_set}", uv_map)

    def _picture(self, index: int) -> tuple[Source, str]:
        if index not in self._pictures:
            image = self._file.document["images"][index]
            uri = image.get("uri")
            if uri is None:
                label = str(image.get("name") or f"of image {index}")
                source: Source = embedded(self._file.view(image["bufferView"]))
            elif str(uri).startswith("data:"):
                label = str(image.get("name") or f"of image {index}")
                source = embedded(self._file.fetch(str(uri), "picture"))
            else:
                label = str(uri)
                source = self._file.companion(label, "picture")
            self._pictures[index] = source, label
        return self._pictures[index]


def _of_one_color(through: dict[str, Any], base: looks.Color, picture: Any) -> bool:
    """Whether a sheet transmits what it reflects, evenly."""
    color = tuple(map(float, through.get("diffuseTransmissionColorFactor", (1.0, 1.0, 1.0))))
    own = through.get("diffuseTransmissionColorTexture")
    return color == base and own == picture and "diffuseTransmissionTexture" not in through


def _uv_map(moved: dict[str, Any]) -> looks.UvMap:
    """KHR_texture_transform for coordinates whose v runs up."""
    across, down = map(float, moved.get("offset", (0.0, 0.0)))
    wide, high = map(float, moved.get("scale", (1.0, 1.0)))
    angle = float(moved.get("rotation", 0.0))
    if not all(abs(value) < 1e6 for value in (across, down, wide, high, angle)):
        raise MeshFileError("a texture transform is not finite, or above 1e6")
    s, c = affine.sin_cos(angle * (180.0 / elementary.PI))
    # The extension's, about the lower left corner instead of the upper left one.
    return (c * wide, -s * high, across + s * high, s * wide, c * high, 1.0 - down - c * high)
