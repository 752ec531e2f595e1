"""Reads photographed skies, takes their sun out where asked, and reads their label maps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets.label_maps import decode
from scenec.compiler.light.latlong import horizontal_irradiance, luminance, read_picture
from scenec.compiler.light.picture_sun import DIAMETER_DEG, PictureSun, extract_sun
from scenec.compiler.light.plan import ImageSkyPlan, LabelMapPlan
from scenec.compiler.scene.light import SkyLabelMaps, SkyLight, SunLight
from scenec.compiler.views.illumination import SHARP


def build_panorama(plan: ImageSkyPlan) -> tuple[SkyLight, SunLight | None, dict[str, Any]]:
    """Measured skies, copied byte for byte unless something about them is changed.

    Photographed panoramas hold negative radiances, by a little, where a color left the gamut; no
    renderer can sample them, so they become 0 and the change is reported.

    Returns:
        (sky, the sun that was taken out of the pictures or None, what to report). At samples whose
        picture has none the sun's irradiance is 0.

    Raises:
        SceneError: A picture cannot be read.
    """
    names = _names(plan.files)
    pictures: dict[str, NDArray[np.float32] | Path] = {}
    suns: dict[Path, PictureSun | None] = {}
    clipped, found = {}, {}
    for file, name in names.items():
        picture = read_picture(file)
        pictures[name] = file
        negative = picture < 0.0
        if negative.any():
            clipped[name] = {
                "negative_fraction": float(negative.mean()),
                "lowest_radiance": float(picture.min()),
            }
            pictures[name] = picture = np.maximum(picture, np.float32(0.0))
        if plan.extract_sun:
            left, suns[file], found[name] = extract_sun(picture)
            if suns[file] is not None:
                pictures[name] = left
    report: dict[str, Any] = {}
    if clipped:
        report["set_to_zero"] = clipped
    if plan.extract_sun:
        report["suns"] = found
    texture = tuple(names[file] for file in plan.files)
    sharp = any(map(_is_sharp, pictures.values()))
    sky = SkyLight(pictures, texture, plan.strength, plan.rotation_deg, sharp)
    return sky, _sun(plan, suns), report


def _is_sharp(picture: NDArray[np.float32] | Path) -> bool:
    """Whether its brightest texel is far brighter than an even sky of the same irradiance."""
    pixels = read_picture(picture) if isinstance(picture, Path) else picture
    even = float(luminance(horizontal_irradiance(pixels))) / elementary.PI
    return float(luminance(pixels).max()) > SHARP * even


def _names(files: tuple[Path | LabelMapPlan, ...]) -> dict[Any, str]:
    """A file name for each: folders may hold files of one name, of which later get a number."""
    names: dict[Any, str] = {}
    for one in dict.fromkeys(files):
        file = one.file if isinstance(one, LabelMapPlan) else one
        name, number = file.name, 1
        while name in names.values():
            number += 1
            name = f"{file.stem}_{number}{file.suffix}"
        names[one] = name
    return names


def _sun(plan: ImageSkyPlan, suns: dict[Path, PictureSun | None]) -> SunLight | None:
    """The pictures' suns as one light: turned and as strong as the pictures are."""
    of_samples = [suns.get(file) for file in plan.files]
    if not any(of_samples):
        return None
    none = PictureSun(0.0, 90.0, 0.0, np.ones(3), DIAMETER_DEG)
    chosen = [sun or none for sun in of_samples]
    return SunLight(
        azimuth_deg=np.array([sun.azimuth_deg for sun in chosen]) + plan.rotation_deg,
        elevation_deg=np.array([sun.elevation_deg for sun in chosen]),
        irradiance=np.array([sun.irradiance for sun in chosen]) * plan.strength,
        diameter_deg=np.array([sun.diameter_deg for sun in chosen]),
        color=np.stack([sun.color for sun in chosen]),
    )


def build_label_maps(plan: ImageSkyPlan) -> SkyLabelMaps | None:
    """The panoramas' label maps, or None where no level has any.

    Raises:
        SceneError: A picture cannot be read, or has a value that its table lacks.
    """
    pictures: dict[str, NDArray[np.uint16]] = {}
    texture: dict[str, tuple[str | None, ...]] = {}
    for level, maps in plan.label_maps.items():
        names = _names(tuple(one for one in maps if one is not None))
        for one, name in names.items():
            # No material has a dot in its name, so none of its maps has this one.
            names[one] = f"sky.{level}.{Path(name).stem}.png"
            pictures[names[one]] = decode(one.file, dict(one.ids))
        texture[level] = tuple(None if one is None else names[one] for one in maps)
    if not texture:
        return None
    return SkyLabelMaps(pictures, texture, plan.rotation_deg)
