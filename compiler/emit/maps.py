"""Copies surface maps beside the stage, and averages them for viewers without them."""

from __future__ import annotations

import shutil
from functools import lru_cache
from pathlib import Path

import numpy as np

from scenec.compiler.arithmetic.srgb import linear_codes
from scenec.compiler.materials.heights import stamp
from scenec.compiler.scene.material import ImageFile, Material
from scenec.schemas.files import Stamp, inside
from scenec.schemas.maps import read_pixels

TEXTURES = "textures"


def copy_maps(folder: Path, name: str, material: Material) -> dict[str, str]:
    """Copies a material's maps into ``textures/``, under names that say what they are.

    Returns:
        Paths relative to the batch's folder, by kind.
    """
    copied = {}
    for kind, source in material.maps.files.items() if material.maps else ():
        copied[kind] = f"{TEXTURES}/{name}_{kind}{source.suffix.lower()}"
        target = inside(folder, copied[kind])
        target.parent.mkdir(exist_ok=True)
        if isinstance(source, ImageFile):
            target.write_bytes(source.data)
        else:
            shutil.copyfile(source, target)
    return copied


def average_color(material: Material) -> tuple[float, float, float]:
    """base_color times the average of its map, linear Rec.709."""
    file = material.maps.files.get("base_color") if material.maps else None
    if file is None:
        return material.base_color
    average = _average(file, stamp(file) if isinstance(file, Path) else None)
    red, green, blue = (c * a for c, a in zip(material.base_color, average, strict=True))
    return (red, green, blue)


@lru_cache(maxsize=32)
def _average(source: Path | ImageFile, _stamp: Stamp | None) -> tuple[float, float, float]:
    pixels = read_pixels(source.data if isinstance(source, ImageFile) else source)
    if pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    if pixels.dtype.kind == "f":
        red, green, blue = np.clip(pixels, 0.0, 1.0).astype(np.float64).mean(axis=(0, 1)).tolist()
        return (red, green, blue)
    largest = int(np.iinfo(pixels.dtype).max)
    linear = linear_codes(largest)
    red, green, blue = (
        float((np.bincount(pixels[..., i].ravel(), minlength=largest + 1) * linear).sum())
        / pixels[..., i].size
        for i in range(3)
    )
    return (red, green, blue)
