"""Leaves out pictures that no camera can notice: they become numbers, or go."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scenec.compiler.materials.periodic import moments
from scenec.compiler.materials.values import Source, colors, mean_color, raw, size_of, stored
from scenec.compiler.scene.material import Material, MaterialMaps

#: Parts of a unit vector along the surface up to here are a flat normal's half a code.
_FLAT = 1.0001 / 255.0
#: The part across it is at least this then: shorter vectors lean more than they say.
_UPRIGHT = 0.9


@dataclass(frozen=True)
class UnusedMap:
    """A picture that is not written.

    Attributes:
        kind: Of map.
        why: In words.
        bytes: Of its file.
    """

    kind: str
    why: str
    bytes: int


def without_unneeded(material: Material) -> tuple[Material, list[UnusedMap]]:
    """A material without pictures that show nothing a number would not.

    Constant ones become numbers; roughness of what has no glossy part goes, and flat normals.
    """
    left: list[UnusedMap] = []
    maps = material.maps
    if maps is None:
        return material, left
    files: dict[str, Source] = dict(maps.files)

    def drop(kind: str, why: str) -> None:
        left.append(UnusedMap(kind, why, size_of(files.pop(kind))))

    if "metallic" in files and _is_constant(files["metallic"]):
        value = float(raw(files["metallic"])[0, 0])
        material = replace(material, metallic=value)
        drop("metallic", f"it is {value:.3g} everywhere: a number")
    glossy = material.specular > 0.0 or material.metallic > 0.0 or "metallic" in files
    if "roughness" in files and not glossy:
        drop("roughness", "the material has no glossy part")
    if "roughness" in files and _is_constant(files["roughness"]):
        value = float(raw(files["roughness"])[0, 0])
        material = replace(material, roughness=value)
        drop("roughness", f"it is {value:.3g} everywhere: a number")
    if "normal" in files and _is_flat(files["normal"]):
        drop("normal", "it is flat")
    if "emission" in files and not max(material.emission) > 0.0:
        drop("emission", "the material gives off no light")
    for kind in ("base_color", "emission"):
        if kind in files and _is_constant(files[kind]):
            material = with_factor(material, kind, mean_color(colors(files[kind])[:1, :1]))
            drop(kind, "it is one color everywhere: a number")
    return replace(material, maps=replace(maps, files=files)), left


def unseen(material: Material, maps: MaterialMaps) -> tuple[Material, list[UnusedMap]]:
    """A material that no camera sees, as light that it sends on sees it: by its means."""
    left = []
    for kind, source in maps.files.items():
        if kind in ("base_color", "emission"):
            planes = colors(source)
            if kind == "base_color":
                planes = np.minimum(planes, np.float32(1.0))
            material = with_factor(material, kind, mean_color(planes))
        elif kind == "roughness":
            material = replace(material, roughness=moments(raw(source))[0])
        elif kind == "metallic":
            material = replace(material, metallic=moments(raw(source))[0])
        left.append(UnusedMap(kind, "no camera sees the material: its mean does", size_of(source)))
    return replace(material, maps=replace(maps, files={})), left


def with_factor(material: Material, kind: str, factor: tuple[float, float, float]) -> Material:
    """A material whose color of a kind of map is multiplied; the albedo never becomes larger."""
    if kind == "emission":
        red, green, blue = (e * f for e, f in zip(material.emission, factor, strict=True))
        return replace(material, emission=(red, green, blue))
    red, green, blue = (c * min(f, 1.0) for c, f in zip(material.base_color, factor, strict=True))
    return replace(material, base_color=(red, green, blue))


def _is_constant(source: Source) -> bool:
    pixels = stored(source)
    return bool((pixels == pixels[:1, :1]).all())


def _is_flat(source: Source) -> bool:
    pixels = stored(source)
    if pixels.shape[2] == 1:
        return False
    scale = 2.0 if pixels.dtype.kind == "f" else 2.0 / float(np.iinfo(pixels.dtype).max)
    # Few normals are flat: a glance at some spares the look at all.
    for part in (pixels[::16, ::16], pixels):
        along = np.abs(part[..., :2].astype(np.float64) * scale - 1.0)
        if not (along <= _FLAT).all() or not (part[..., 2] * scale - 1.0 >= _UPRIGHT).all():
            return False
    return True
