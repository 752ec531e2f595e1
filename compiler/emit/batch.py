"""Writes one batch: the root layer and everything it is composed from."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdUtils, Vt

from scenec.compiler.emit.cameras import camera_path, clipping_range, write_cameras
from scenec.compiler.emit.layer import TYPES, Appearance, custom, label_names, new_layer
from scenec.compiler.emit.lights import write_lights
from scenec.compiler.emit.looks import write_look
from scenec.compiler.emit.maps import copy_maps
from scenec.compiler.emit.materialx import mixed_materials, write_ground_mix, write_material
from scenec.compiler.emit.objects import class_path, write_placed, write_scatter
from scenec.compiler.emit.sky_prim import write_sky_prim
from scenec.compiler.emit.terrain import write_terrain
from scenec.compiler.scene.material import Material
from scenec.compiler.scene.objects import Placed
from scenec.compiler.scene.scene import Scene
from scenec.schemas import stage as names
from scenec.schemas.errors import SceneError
from scenec.schemas.files import inside
from scenec.schemas.manifest import STAGE
from scenec.schemas.materialx import LAYER_SUFFIX

#: More layers of one kind are joined: USD asks each for every value, and 2,000 of them are read in
#: minutes where one is read in seconds.
MOST_LAYERS = 256
_LARGEST_ID = 2**32 - 1


def write_batch(folder: Path, scene: Scene) -> None:
    """Writes ``stage.usda`` and its sublayers and textures into an empty folder.

    Each object class and each material has a layer of its own, so adding one leaves the bytes of
    all other layers as they were; only the root layer, which lists them, changes. From
    ``MOST_LAYERS`` on, all classes share a layer, and likewise all materials. The MaterialX network
    of the mixed ground depends on all the ground's materials, and has a layer, too.

    Raises:
        SceneError: More instances than ids.
        OutputError: A name leads out of the folder.
    """
    # Parts of a scene come from the cache's files, whoever wrote those.
    for name in (*scene.materials, *(objects.name for objects in scene.objects)):
        inside(folder, name)
    table = scene.label_table
    layers = scene.ground.parts[-1].layers
    layer_names = [label_names(table, layer.labels) for layer in layers]
    used = [layer.material for layer in layers]
    shown = _only(scene.materials, used)
    write_terrain(folder / "terrain.usdc", scene.ground, shown, layer_names, scene.craters)
    classes = []
    for objects in scene.objects:
        if not objects.count:
            # Its ids stay reserved; that is all.
            continue
        classes.append(f"objects/{objects.name}.usdc")
        own = Appearance(_only(scene.materials, objects.materials), table)
        if isinstance(objects, Placed):
            write_placed(folder / classes[-1], objects, own)
        else:
            write_scatter(folder / classes[-1], objects, own)
    sublayers = ["terrain.usdc", *_joined(folder, classes, "objects.usdc")]
    sublayers.extend(_write_looks(folder, scene))
    # Binary, whatever is in them: samples of many time codes are large and slow as text.
    if scene.sun is not None or scene.sky is not None or scene.more_suns or scene.lamps:
        sublayers.append("lights.usdc")
        write_lights(folder / sublayers[-1], scene)
    if scene.sky_labels or scene.haze is not None:
        sublayers.append("sky.usdc")
        write_sky_prim(folder / sublayers[-1], scene)
    sublayers.append("cameras.usdc")
    write_cameras(folder / sublayers[-1], scene)
    _write_root(folder / STAGE, scene, sublayers)


def _only(materials: dict[str, Material], used: Iterable[str]) -> dict[str, Material]:
    """Selects the materials that a layer is written from: others may change without it."""
    # None at all would say that no color is asked for.
    return {name: materials[name] for name in sorted(used) if name in materials} or materials


def _write_looks(folder: Path, scene: Scene) -> list[str]:
    """Writes what all is made of; returns the layers' names."""
    sublayers = []
    mixed = mixed_materials(scene.ground) if scene.materials else ()
    maps = {name: copy_maps(folder, name, made) for name, made in scene.materials.items()}
    for name, material in scene.materials.items():
        sublayers.append(f"looks/{name}.usda")
        write_look(folder / sublayers[-1], name, material, maps[name])
        if name not in mixed:
            sublayers.append(f"looks/{name}{LAYER_SUFFIX}")
            write_material(folder / sublayers[-1], name, material, maps[name])
    sublayers = _joined(folder, sublayers, "looks.usda")
    if mixed:
        sublayers.append(f"terrain{LAYER_SUFFIX}")
        write_ground_mix(folder / sublayers[-1], mixed, scene.materials, maps)
    return sublayers


def _joined(folder: Path, sublayers: list[str], name: str) -> list[str]:
    """The layers, each in a folder of its kind, or the name of one in their place if many."""
    if len(sublayers) <= MOST_LAYERS:
        return sublayers
    joined = Sdf.Layer.CreateNew(str(folder / name))
    # The last first: in that order a stage has the prims of its sublayers.
    for sublayer in reversed(sublayers):
        UsdUtils.StitchLayers(joined, Sdf.Layer.FindOrOpen(str(folder / sublayer)))
        (folder / sublayer).unlink()
    (folder / sublayers[0]).parent.rmdir()
    # It stands one folder further up than what it was made from.
    UsdUtils.ModifyAssetPaths(joined, lambda path: path.replace("../", "./", 1))
    joined.Save()
    return [name]


def _write_root(path: Path, scene: Scene, sublayers: list[str]) -> None:
    with new_layer(path) as stage:
        stage.SetStartTimeCode(0.0)
        stage.SetEndTimeCode(float(scene.samples - 1))
        stage.SetMetadata("renderSettingsPrimPath", f"{names.RENDER_SCOPE}/Settings")
        world = UsdGeom.Xform.Define(stage, names.ROOT).GetPrim()
        Usd.ModelAPI(world).SetKind("assembly")
        if scene.materials:
            Usd.ColorSpaceAPI.Apply(world).CreateColorSpaceNameAttr("lin_rec709_scene")
        custom(world, names.ATTR_SCHEMA_VERSION, TYPES.String).Set(names.SCHEMA_VERSION)
        for level, table in scene.label_table.items():
            custom(world, names.ATTR_LABEL_NAMES.format(level=level), TYPES.TokenArray).Set(
                Vt.TokenArray(list(table))
            )
            custom(world, names.ATTR_LABEL_IDS.format(level=level), TYPES.UIntArray).Set(
                Vt.UIntArray(list(table.values()))
            )
        if scene.haze is not None:
            # Of all there was: what was pruned must not move it.
            sky = stage.OverridePrim(names.SKY_PRIM)
            floor = custom(sky, names.ATTR_HAZE_FLOOR, TYPES.Double)
            floor.Set(float(scene.reach[0, 2]))
        _write_georeference(world, scene)
        _write_instance_bases(stage, scene)
        for rig in scene.rigs:
            for sensor in rig.sensors:
                camera = UsdGeom.Camera(stage.OverridePrim(camera_path(rig, sensor)))
                camera.CreateClippingRangeAttr(clipping_range(rig, sensor, scene.reach))
    # On the layer alone: a stage is composed anew with each of them, and there is one a class.
    layer = Sdf.Layer.FindOrOpen(str(path))
    del stage
    layer.subLayerPaths = [f"./{name}" for name in sublayers]
    layer.Save()


def _write_georeference(world: Usd.Prim, scene: Scene) -> None:
    place = scene.georeference
    if place is None:
        return
    for name, kind, value in (
        (names.ATTR_GEOREFERENCE_CRS, TYPES.String, place.crs),
        (names.ATTR_GEOREFERENCE_CENTER, TYPES.Double2, Gf.Vec2d(*place.center)),
        (names.ATTR_GEOREFERENCE_HEIGHT_OFFSET, TYPES.Double, place.height_offset_m),
    ):
        custom(world, name, kind).Set(value)
    for field in fields(place.place) if place.place else ():
        value = getattr(place.place, field.name)
        if field.name in names.GEOREFERENCE and value != field.default:
            name, kind = names.GEOREFERENCE[field.name]
            made = custom(world, name, getattr(TYPES, kind))
            made.Set(list(value) if isinstance(value, tuple) else value)


def _write_instance_bases(stage: Usd.Stage, scene: Scene) -> None:
    """Writes the first frame id of each class: running sums of the counts."""
    total = sum(objects.drawn for objects in scene.objects)
    if total > _LARGEST_ID:
        raise SceneError(f"{total} instances: a frame has ids for {_LARGEST_ID} at most")
    if not any(objects.instances for objects in scene.objects):
        # Nothing shows ids.
        return
    base = 0
    for objects in scene.objects:
        if objects.count:
            prim = stage.OverridePrim(class_path(objects.name))
            custom(prim, names.ATTR_INSTANCE_ID_BASE, TYPES.UInt).Set(base)
        base += objects.drawn
