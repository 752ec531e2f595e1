"""Writes the Sky prim: what is said of the surroundings, with or without a dome."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from scenec.compiler.assets.pictures import png
from scenec.compiler.emit.layer import (
    TYPES,
    author,
    constant_label_ids,
    custom,
    label,
    label_names,
    new_layer,
)
from scenec.compiler.emit.maps import TEXTURES
from scenec.compiler.scene.light import Haze, SkyLabelMaps
from scenec.compiler.scene.scene import Scene
from scenec.schemas import stage as names
from scenec.schemas.files import inside


def write_sky_prim(path: Path, scene: Scene) -> None:
    """Writes ``sky.usdc``: labels, label maps (with their pictures in ``textures/``) and haze."""
    with new_layer(path) as stage:
        sky = UsdGeom.Scope.Define(stage, names.SKY_PRIM).GetPrim()
        if scene.sky_labels:
            constant_label_ids(sky, scene.sky_labels)
            label(sky, label_names(scene.label_table, scene.sky_labels))
        for level, number in scene.sky_labels_below.items():
            below = custom(sky, names.ATTR_SKY_LABEL_BELOW.format(level=level), TYPES.Int)
            below.Set(number)
        if scene.sky_label_maps is not None:
            _write_label_maps(sky, path.parent, scene.sky_label_maps)
        if scene.haze is not None:
            _write_haze(sky, scene.haze)


def _write_label_maps(sky: Usd.Prim, folder: Path, maps: SkyLabelMaps) -> None:
    for level, texture in maps.texture.items():
        # An empty path at samples without a map: the sky's one label.
        files = [Sdf.AssetPath("" if name is None else f"./{TEXTURES}/{name}") for name in texture]
        attribute = names.ATTR_SKY_LABEL_MAP.format(level=level)
        author(custom(sky, attribute, TYPES.Asset), files)
    if maps.rotation_deg.any():
        attribute = custom(sky, names.ATTR_SKY_ROTATION, TYPES.Double)
        author(attribute, maps.rotation_deg.tolist())
    for name, ids in maps.pictures.items():
        file = inside(folder, f"{TEXTURES}/{name}")
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(png((ids if ids.max() > 255 else ids.astype(np.uint8))[..., None]))


def _write_haze(sky: Usd.Prim, haze: Haze) -> None:
    author(
        custom(sky, names.ATTR_HAZE_EXTINCTION, TYPES.Color3f),
        [Gf.Vec3f(*extinction) for extinction in haze.extinction.tolist()],
    )
    author(custom(sky, names.ATTR_HAZE_SCALE_HEIGHT, TYPES.Double), haze.scale_height_m.tolist())
    author(custom(sky, names.ATTR_HAZE_ASYMMETRY, TYPES.Double), haze.asymmetry.tolist())
    author(
        custom(sky, names.ATTR_HAZE_ALBEDO, TYPES.Color3f),
        [Gf.Vec3f(*albedo) for albedo in haze.albedo.tolist()],
    )
    if haze.airlight is not None:
        author(
            custom(sky, names.ATTR_HAZE_AIRLIGHT, TYPES.Color3f),
            [Gf.Vec3f(*radiance) for radiance in haze.airlight.tolist()],
        )
