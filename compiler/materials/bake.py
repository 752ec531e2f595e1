"""Bakes pictures of others before they are shown: gloss, ambient occlusion, packed channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scenec.compiler.materials.periodic import Plane
from scenec.compiler.materials.plan import MapSources
from scenec.compiler.materials.resample import resampled
from scenec.compiler.materials.values import (
    Source,
    color_picture,
    colors,
    gray_picture,
    is_fine,
    raw,
    stored,
)
from scenec.compiler.scene.material import ImageFile, Material
from scenec.schemas.maps import MAP_CHANNELS

#: Letters of kinds in the order of a packed picture.
_LETTERS = {"ambient_occlusion": "o", "roughness": "r", "metallic": "m"}


def baked(material: Material, sources: MapSources | None) -> tuple[Material, dict[str, str]]:
    """A material whose maps hold all that its sources say, and what was done, by kind.

    Roughness is 1 - gloss. Albedo is multiplied with 1 - strength (1 - occlusion), in linear light;
    a picture of occlusion of another size is looked up bilinearly. Without a picture of colors one
    is made. What needs none of this stays the file it is.
    """
    maps = material.maps
    if maps is None or sources is None:
        return material, {}
    files: dict[str, Source] = dict(maps.files)
    done: dict[str, str] = {}
    if sources.gloss is not None:
        gloss = raw(sources.gloss)
        files["roughness"] = gray_picture(np.float32(1.0) - gloss, is_fine(sources.gloss))
        done["roughness"] = f"1 - {sources.gloss.name}"
    for kind in ("roughness", "metallic"):
        if sources.packed is not None and kind in sources.unpacked:
            channel = sources.packed_order.index(_LETTERS[kind])
            files[kind] = gray_picture(raw(sources.packed, channel), is_fine(sources.packed))
            done[kind] = f"channel {channel} of {sources.packed.name}"
    occlusion, channel = sources.occlusion, 0
    if occlusion is None and "ambient_occlusion" in sources.unpacked:
        occlusion = sources.packed
        channel = sources.packed_order.index(_LETTERS["ambient_occlusion"])
    if occlusion is not None and sources.occlusion_strength > 0.0:
        color = files.get("base_color")
        files["base_color"] = _occluded(color, raw(occlusion, channel), sources.occlusion_strength)
        done["base_color"] = f"times {occlusion.name}, strength {sources.occlusion_strength:g}"
    ordered = {kind: files[kind] for kind in MAP_CHANNELS if kind in files}
    return replace(material, maps=replace(maps, files=ordered)), done


def _occluded(color: Source | None, occlusion: Plane, strength: float) -> ImageFile:
    factor = np.float32(1.0) - np.float32(strength) * (np.float32(1.0) - occlusion)
    if color is None:
        return color_picture(np.repeat(factor[..., None], 3, axis=2))
    high, wide = stored(color).shape[:2]
    if factor.shape != (high, wide):
        factor = resampled(factor, high, wide)
    planes = np.clip(colors(color), np.float32(0.0), np.float32(1.0))
    return color_picture(planes * factor[..., None])
