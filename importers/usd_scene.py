"""A foreign USD stage becomes a cfg: its meshes as ground and objects, light and cameras varied."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Tf, Usd, UsdGeom, UsdLux, UsdRender

from scenec.compiler.assets.model import cached_model
from scenec.compiler.geometry.affine import TO_Z_UP
from scenec.importers.numbers import tidy, uniform
from scenec.importers.output import Imported
from scenec.importers.poses import FLIP, track_writer
from scenec.importers.report import ADDED, APPROXIMATED, DROPPED, TRANSLATED
from scenec.importers.scene import (
    LEVEL,
    Taxonomy,
    identifier,
    orbit,
    scattered_rocks,
    soil,
    table_writer,
    unused,
    varied_pose,
    varied_sun,
    without_scale,
)
from scenec.schemas.errors import ScenecError
from scenec.schemas.native import native_reading
from scenec.schemas.spelling import nearest, shown

#: What may stay as it is.
KEEP = ("cameras", "light")
#: Width of pictures of a camera that no product names.
_WIDTH = 640
#: Shares of W/m² that a sun can have: what is outside was meant otherwise.
_LEAST_SUN, _MOST_SUN = 1.0, 1e5
_SAMPLES = 8
_SPACINGS = 256


@dataclass
class _Scene:
    """A stage under way.

    Attributes:
        stage: The stage.
        imported: The cfg and its report.
        to_world: From the stage's coordinates to the cfg's, [4, 4]: meters, z up.
        keep: Of ``KEEP``, what stays as it is.
        taxonomy: Its labels.
        model: What the cfg says of the file beside its parts.
        groups: Meshes of each class: path of the prim, and its meshes.
        extent_m: Size of the terrain.
    """

    stage: Usd.Stage
    imported: Imported
    to_world: NDArray[np.float64]
    keep: Sequence[str]
    taxonomy: Taxonomy = field(default_factory=Taxonomy)
    model: dict[str, Any] = field(default_factory=dict)
    extent_m: tuple[float, float] = (10.0, 10.0)

    def placed(self, prim: Usd.Prim, time: Usd.TimeCode) -> NDArray[np.float64]:
        """From a prim's own coordinates to the cfg's."""
        local = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)
        return self.to_world @ np.array(local, float).T


def import_usd(file: Path, out: Path, *, ground: str = "", keep: Sequence[str] = ()) -> Imported:
    """Makes a cfg of a stage.

    Args:
        file: The stage.
        out: The cfg that it becomes.
        ground: Path or name of the mesh that is the ground; "": the widest one.
        keep: What of ``KEEP`` does not vary.

    Raises:
        ScenecError: It cannot be read, or has no such mesh.
    """
    try:
        with native_reading(file):
            return _imported(file, out, ground, keep)
    except Tf.ErrorException as error:
        reason = str(error).strip().splitlines()[-1].strip() or "USD gives no reason"
        raise ScenecError(f"{file}: not a sound USD file: {reason[:300]}") from error


def _imported(file: Path, out: Path, ground: str, keep: Sequence[str]) -> Imported:
    if not file.is_file():
        raise ScenecError(f"{file}: {'not a file' if file.exists() else 'there is no such file'}")
    imported = Imported(out)
    stage = Usd.Stage.Open(str(file))
    unit, axis = UsdGeom.GetStageMetersPerUnit(stage), str(UsdGeom.GetStageUpAxis(stage)).lower()
    to_world = np.eye(4)
    to_world[:3, :3] = np.array(TO_Z_UP[axis], float) * unit
    scene = _Scene(stage, imported, to_world, keep)
    imported.report.add(TRANSLATED, "metersPerUnit", unit, "unit_m")
    imported.report.add(TRANSLATED, "upAxis", axis, "up")
    imported.cfg.update(
        version=1,
        name=identifier(file.stem),
        description=f"Imported from {file.name}",
        samples=_SAMPLES,
        outputs=["rgb", "label", "instance", "depth"],
        labels={},
        terrain={},
        materials={},
        objects={},
        light={},
        rigs={},
    )
    instancers = [p for p in _shown(stage, UsdGeom.PointInstancer) if not _within(p)]
    scene.model = _model(scene, file, instancers, {"unit_m": unit, "up": axis})
    sky = scene.taxonomy.choice("sky")
    _ground(scene, ground)
    for instancer in instancers:
        _instances(scene, instancer)
    _scatter(scene)
    _light(scene, sky)
    _cameras(scene)
    imported.cfg["labels"] = {LEVEL: scene.taxonomy.ids}
    return imported


def _shown(stage: Usd.Stage, kind: type) -> list[Usd.Prim]:
    """Prims of a kind that a renderer would show."""
    return [
        prim
        for prim in stage.Traverse(Usd.TraverseInstanceProxies())
        if prim.IsA(kind)
        and UsdGeom.Imageable(prim).ComputeVisibility() != UsdGeom.Tokens.invisible
        and UsdGeom.Imageable(prim).ComputePurpose() not in ("proxy", "guide")
    ]


def _within(prim: Usd.Prim) -> bool:
    """Whether a prim stands below a point instancer: it is shown where that says."""
    above = prim.GetParent()
    while above:
        if above.IsA(UsdGeom.PointInstancer):
            return True
        above = above.GetParent()
    return False


def _model(
    scene: _Scene, file: Path, instancers: Sequence[Usd.Prim], layout: dict[str, Any]
) -> dict[str, Any]:
    """How the cfg names the stage, or a copy in one file where it cannot take the stage itself."""
    root = scene.stage.GetRootLayer().realPath
    others = [
        layer
        for layer in scene.stage.GetUsedLayers()
        if not layer.anonymous and layer.realPath != root
    ]
    if not (others or instancers):
        return {"file": scene.imported.refer(file), **layout}
    layer = scene.stage.Flatten()
    for prim in instancers:
        _take_apart(layer, prim)

    def write(path: Path) -> None:
        layer.Export(str(path))

    why = "of several layers" if others else "without its point instancers"
    scene.imported.report.add(TRANSLATED, str(file.name), None, "a copy", f"one file {why}")
    return {"file": scene.imported.make("stage.usdc", write), **layout}


def _take_apart(layer: Sdf.Layer, prim: Usd.Prim) -> None:
    """Moves the prototypes of an instancer to the root, where models are taken from."""
    for target in UsdGeom.PointInstancer(prim).GetPrototypesRel().GetTargets():
        Sdf.CopySpec(layer, target, layer, Sdf.Path(_prototype(prim, target)))
    layer.GetPrimAtPath(prim.GetPath()).active = False


def _prototype(prim: Usd.Prim, target: Sdf.Path) -> str:
    return f"/{identifier(f'{prim.GetPath()}_{target.name}')}"


# Ground and objects.


def _ground(scene: _Scene, name: str) -> None:
    meshes = [prim for prim in _shown(scene.stage, UsdGeom.Mesh) if not _within(prim)]
    cfg, report = scene.imported.cfg, scene.imported.report
    boxes = {prim: _box(scene, prim) for prim in meshes}
    if name:
        chosen = [p for p in meshes if name in (str(p.GetPath()), p.GetName())]
        if not chosen:
            names = [text for p in meshes for text in (p.GetName(), str(p.GetPath()))]
            raise ScenecError(f"--ground {shown(name)}: no mesh is called so{nearest(name, names)}")
    else:
        flat = [p for p in meshes if boxes[p][1][2] - boxes[p][0][2] < _plan(boxes[p]) ** 0.5]
        chosen = sorted(flat, key=lambda p: -_plan(boxes[p]))[:1]
    labels = scene.taxonomy.choice("ground")
    cfg["materials"]["ground"] = soil()
    cfg["terrain"]["ground"] = [{"material": "ground", "labels": labels}]
    others = [prim for prim in meshes if prim not in chosen]
    if chosen and _plan(boxes[chosen[0]]) > 0.0:
        _mesh_ground(scene, chosen[0], boxes[chosen[0]])
    else:
        everything = np.array([corner for box in boxes.values() for corner in box] or np.eye(3))
        low, high = everything.min(axis=0), everything.max(axis=0)
        side = 4.0 * max(float(np.linalg.norm((high - low)[:2])), 1.0)
        scene.extent_m = (tidy(side), tidy(side))
        shift = [*(-0.5 * (low + high)[:2]), 0.0]
        scene.to_world[:3, 3] += shift
        relief = [{"type": "plane", "height_m": tidy(float(low[2]))}]
        spacing = side / _SPACINGS
        cfg["terrain"].update(size_m=list(scene.extent_m), spacing_m=spacing, relief=relief)
        report.add(ADDED, "", None, "terrain", "no mesh is level and wide: a plane below all")
    for path, members in _groups(others, chosen):
        _placed(scene, path, members)


def _box(scene: _Scene, prim: Usd.Prim) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    time = Usd.TimeCode.EarliestTime()
    points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(time) or (), float)
    if not len(points):
        return np.zeros(3), np.zeros(3)
    matrix = scene.placed(prim, time)
    placed = points @ matrix[:3, :3].T + matrix[:3, 3]
    return placed.min(axis=0), placed.max(axis=0)


def _plan(box: tuple[NDArray[np.float64], NDArray[np.float64]]) -> float:
    return float(np.prod((box[1] - box[0])[:2]))


def _mesh_ground(
    scene: _Scene, prim: Usd.Prim, box: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> None:
    low, high = box
    cfg, report = scene.imported.cfg, scene.imported.report
    path = str(prim.GetPath())
    scene.extent_m = (tidy(high[0] - low[0]), tidy(high[1] - low[1]))
    scene.to_world[:2, 3] -= 0.5 * (low + high)[:2]
    cfg["terrain"].update(
        size_m=list(scene.extent_m),
        spacing_m=float(f"{min(scene.extent_m) / _SPACINGS:.4g}"),
        relief=[{"type": "mesh", "part": path, **scene.model}],
    )
    moved = [tidy(float(v)) for v in scene.to_world[:2, 3]]
    note = f"all is moved by {moved} m, so that its middle is the origin" if any(moved) else ""
    report.add(TRANSLATED, path, None, "terrain/relief/0", note)
    look = _color(scene, path)
    if look is not None:
        cfg["materials"]["ground"] = look
        report.add(APPROXIMATED, path, None, "materials/ground", "its material's mean color")


def _color(scene: _Scene, path: str) -> dict[str, Any] | None:
    """A material's numbers, as a reader of models has them."""
    file = Path(scene.stage.GetRootLayer().realPath)
    if scene.model["file"] != scene.imported.refer(file):
        return None
    try:
        model = cached_model(file, scene.model["unit_m"], scene.model["up"], path)
    except ScenecError:
        return None
    look = next(iter(model.materials), None)
    if look is None:
        return None
    return {
        "base_color": [tidy(min(max(v, 0.0), 1.0)) for v in look.base_color],
        "roughness": tidy(look.roughness),
    }


def _groups(
    meshes: Sequence[Usd.Prim], ground: Sequence[Usd.Prim]
) -> Iterable[tuple[Sdf.Path, list[Usd.Prim]]]:
    """Meshes by the uppermost prim that holds no ground: one class each."""
    grounds = [prim.GetPath() for prim in ground]
    paths = [prim.GetPath() for prim in meshes]
    common = paths[0].GetParentPath() if paths else Sdf.Path.absoluteRootPath
    for path in [*paths, *grounds]:
        common = common.GetCommonPrefix(path.GetParentPath())
    found: dict[Sdf.Path, list[Usd.Prim]] = {}
    for prim in meshes:
        path = prim.GetPath()
        while path.GetParentPath() != common and not any(
            other.HasPrefix(path.GetParentPath()) for other in grounds
        ):
            path = path.GetParentPath()
        found.setdefault(path, []).append(prim)
    return found.items()


def _placed(scene: _Scene, path: Sdf.Path, members: Sequence[Usd.Prim]) -> None:
    """A class of one object that stands where the stage has it."""
    objects = scene.imported.cfg["objects"]
    name = unused(path.name, objects)
    moves = any(UsdGeom.Xformable(prim).TransformMightBeTimeVarying() for prim in members)
    place = [tidy(float(v)) for v in scene.to_world[:3, 3]]
    objects[name] = {
        "type": "placed",
        "models": [{**scene.model, "part": str(path)}],
        "labels": scene.taxonomy.choice(name),
        "poses": [{"x_m": place[0], "y_m": place[1], "z_m": place[2]}],
        "heights": "world",
    }
    note = "where it is at the first time" if moves else ""
    fate = APPROXIMATED if moves else TRANSLATED
    scene.imported.report.add(fate, str(path), None, f"objects/{name}", note)


def _instances(scene: _Scene, prim: Usd.Prim) -> None:
    """The copies of a point instancer, as a table of poses."""
    objects = scene.imported.cfg["objects"]
    name = unused(prim.GetName(), objects)
    instancer, time = UsdGeom.PointInstancer(prim), Usd.TimeCode.EarliestTime()
    local = instancer.ComputeInstanceTransformsAtTime(
        time, time, UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.ApplyMask
    )
    indices = np.array(instancer.GetProtoIndicesAttr().Get(time) or (), int)
    mask = instancer.ComputeMaskAtTime(time)
    kept = indices[np.array(mask, bool)] if len(mask) else indices
    targets = instancer.GetPrototypesRel().GetTargets()
    if not len(local) or not targets:
        scene.imported.report.add(DROPPED, str(prim.GetPath()), 0, "", "it has no copies")
        return
    above = scene.placed(prim, time)
    # A prototype's own transform is in its model already, and so is the way to z up.
    poses = []
    own = {t: _own(scene.stage.GetPrimAtPath(t), time) for t in targets}
    turn = np.eye(4)
    turn[:3, :3] = scene.to_world[:3, :3]
    for matrix, index in zip(local, kept, strict=False):
        whole = above @ np.array(matrix, float).T @ np.linalg.inv(own[targets[int(index)]])
        poses.append(whole @ np.linalg.inv(turn))
    uneven = any(_is_uneven(pose[:3, :3]) for pose in poses)
    made = scene.imported.make(f"{name}.csv", table_writer(poses, [int(i) for i in kept]))
    objects[name] = {
        "type": "placed",
        "models": [{**scene.model, "part": _prototype(prim, target)} for target in targets],
        "labels": scene.taxonomy.choice(name),
        "file": made,
        "heights": "world",
    }
    scene.imported.report.add(
        APPROXIMATED if uneven else TRANSLATED,
        str(prim.GetPath()),
        len(poses),
        f"objects/{name}",
        "uneven scales are evened out" if uneven else "",
    )


def _own(prim: Usd.Prim, time: Usd.TimeCode) -> NDArray[np.float64]:
    return np.array(UsdGeom.Xformable(prim).GetLocalTransformation(time), float).T


def _is_uneven(matrix: NDArray[np.float64]) -> bool:
    rotation, scale = without_scale(matrix)
    return bool(np.abs(matrix - scale * rotation).max() > 1e-4 * scale)


def _scatter(scene: _Scene) -> None:
    cfg = scene.imported.cfg
    name, material = unused("rocks", cfg["objects"]), unused("stone", cfg["materials"])
    cfg["materials"][material] = {
        "base_color": [0.25, 0.21, 0.17],
        "maps": {"procedural": {"type": "weathered", "resolution": 512}},
    }
    area = scene.extent_m[0] * scene.extent_m[1]
    cfg["objects"][name] = scattered_rocks(area, material, scene.taxonomy.choice("rock"))
    scene.imported.report.add(ADDED, "", None, f"objects/{name}", "rocks that each batch scatters")


# Light.


def _light(scene: _Scene, labels: dict[str, str]) -> None:
    light: dict[str, Any] = {"sun": None}
    report = scene.imported.report
    for prim in scene.stage.Traverse():
        at = str(prim.GetPath())
        if prim.IsA(UsdLux.DistantLight) and light["sun"] is None:
            light["sun"] = _sun(scene, prim)
        elif prim.IsA(UsdLux.DomeLight) and "sky" not in light:
            sky = _dome(scene, prim)
            if sky is not None:
                light["sky"] = sky
        elif prim.HasAPI(UsdLux.LightAPI):
            report.add(DROPPED, at, None, "", f"no light of the kind {prim.GetTypeName()} is made")
    if "sky" not in light:
        light["sky"] = {"type": "clear"}
        report.add(ADDED, "", None, "light/sky", "a clear sky")
        if light["sun"] is None:
            light["sun"] = varied_sun()
            report.add(ADDED, "", None, "light/sun", "a sun that stands anywhere by day")
    light["sky"]["labels"] = labels
    scene.imported.cfg["light"] = light


def _sun(scene: _Scene, prim: Usd.Prim) -> dict[str, Any]:
    light = UsdLux.DistantLight(prim)
    toward = scene.placed(prim, Usd.TimeCode.EarliestTime())[:3, 2]
    toward = toward / np.linalg.norm(toward)
    elevation = math.degrees(math.asin(float(np.clip(toward[2], -1.0, 1.0))))
    azimuth = math.degrees(math.atan2(float(toward[0]), float(toward[1]))) % 360.0
    angle = float(light.GetAngleAttr().Get())
    strength = light.GetIntensityAttr().Get() * 2.0 ** light.GetExposureAttr().Get()
    if not light.GetNormalizeAttr().Get():
        # Then the intensity is a radiance: times the disc's projected solid angle.
        strength *= math.pi * math.sin(math.radians(0.5 * angle)) ** 2
    report, at = scene.imported.report, str(prim.GetPath())
    sun = varied_sun()
    if "light" in scene.keep:
        sun = {"elevation_deg": tidy(round(elevation, 6)), "azimuth_deg": tidy(round(azimuth, 6))}
        report.add(TRANSLATED, at, None, "light/sun")
    else:
        where = f"elevation {elevation:.1f}, azimuth {azimuth:.1f} there"
        report.add(APPROXIMATED, at, None, "light/sun", f"anywhere by day: {where}")
    if _LEAST_SUN <= strength <= _MOST_SUN:
        sun["irradiance"] = tidy(strength)
        report.add(TRANSLATED, f"{at}.inputs:intensity", strength, "light/sun/irradiance")
    else:
        note = "no irradiance of a sun in W/m²: 1000 in its place"
        report.add(DROPPED, f"{at}.inputs:intensity", strength, "", note)
    sun["diameter_deg"] = tidy(min(angle, 90.0))
    color = [min(max(float(v), 0.0), 1.0) for v in light.GetColorAttr().Get()]
    if any(color):
        sun["color"] = [tidy(v) for v in color]
    return sun


def _dome(scene: _Scene, prim: Usd.Prim) -> dict[str, Any] | None:
    light = UsdLux.DomeLight(prim)
    report, at = scene.imported.report, str(prim.GetPath())
    asset = light.GetTextureFileAttr().Get()
    if not asset or not asset.path:
        report.add(APPROXIMATED, at, None, "light/sky", "a clear sky in place of one even color")
        return None
    file = Path(asset.resolvedPath or asset.path)
    if not file.is_file() or file.suffix.lower() not in (".exr", ".png", ".jpg", ".jpeg", ".tif"):
        why = "no such file" if not file.is_file() else "not an OpenEXR file"
        report.add(DROPPED, at, asset.path, "", f"{why}: a clear sky in its place")
        return None
    strength = light.GetIntensityAttr().Get() * 2.0 ** light.GetExposureAttr().Get()
    sky: dict[str, Any] = {"type": "image", "files": [scene.imported.refer(file)]}
    if strength > 0.0 and strength != 1.0:
        sky["strength"] = tidy(strength)
    if "light" in scene.keep:
        sky["rotation_deg"] = _dome_turn(scene, prim)
        report.add(TRANSLATED, at, asset.path, "light/sky")
    else:
        sky["rotation_deg"] = uniform(0, 360)
        report.add(APPROXIMATED, at, asset.path, "light/sky", "turned by chance in each sample")
    return sky


def _dome_turn(scene: _Scene, prim: Usd.Prim) -> float | int:
    """How far a dome is turned from where a panorama's middle looks south, clockwise."""
    # The middle of a lat-long picture is the dome's +Z, of an unturned y-up stage our -y.
    middle = scene.placed(prim, Usd.TimeCode.EarliestTime())[:3, 2]
    if float(np.hypot(middle[0], middle[1])) < 1e-6 * float(np.linalg.norm(middle)):
        return 0
    bearing = math.degrees(math.atan2(float(middle[0]), float(middle[1])))
    return tidy(round((bearing - 180.0) % 360.0, 6))


# Cameras.


def _cameras(scene: _Scene) -> None:
    rigs, report = scene.imported.cfg["rigs"], scene.imported.report
    products = _products(scene.stage)
    for prim in scene.stage.Traverse(Usd.TraverseInstanceProxies()):
        if not prim.IsA(UsdGeom.Camera):
            continue
        camera, at = UsdGeom.Camera(prim), str(prim.GetPath())
        if camera.GetProjectionAttr().Get() == UsdGeom.Tokens.orthographic:
            report.add(DROPPED, at, None, "", "an orthographic camera has no counterpart")
            continue
        name = unused(prim.GetName(), rigs)
        rigs[name] = {
            "pose": _pose(scene, prim, name),
            "sensors": {"camera": _sensor(scene, camera, products, f"rigs/{name}/sensors/camera")},
        }
    if not rigs:
        rigs["orbit"] = orbit(min(scene.extent_m))
        report.add(ADDED, "", None, "rigs/orbit", "the stage has no camera: an orbit")


def _products(stage: Usd.Stage) -> dict[Sdf.Path, tuple[int, int]]:
    """Resolution of each camera that a render product names."""
    found = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdRender.Product):
            product = UsdRender.Product(prim)
            size = product.GetResolutionAttr().Get()
            for target in product.GetCameraRel().GetTargets():
                found[target] = (int(size[0]), int(size[1]))
    return found


def _pose(scene: _Scene, prim: Usd.Prim, name: str) -> dict[str, Any]:
    report, at = scene.imported.report, str(prim.GetPath())
    times = _times(prim)
    if len(times) > 1:
        rate = scene.stage.GetTimeCodesPerSecond() or 24.0
        poses = [_camera_pose(scene, prim, Usd.TimeCode(t)) for t in times]
        seconds = [(t - times[0]) / rate for t in times]
        made = scene.imported.make(f"{name}.csv", track_writer(seconds, poses))
        report.add(TRANSLATED, at, len(times), f"rigs/{name}/pose", "its motion, as a track")
        return {"type": "track", "file": made, "sampling": {}}
    pose = _camera_pose(scene, prim, Usd.TimeCode.EarliestTime())
    if "cameras" in scene.keep:
        made = scene.imported.make(f"{name}.csv", track_writer([0.0, 1.0], [pose, pose]))
        report.add(TRANSLATED, at, None, f"rigs/{name}/pose")
        return {"type": "track", "file": made, "sampling": {}}
    note = "about where it is and looks; --keep cameras leaves it there"
    report.add(APPROXIMATED, at, None, f"rigs/{name}/pose", note)
    return varied_pose(pose, min(scene.extent_m))


def _times(prim: Usd.Prim) -> list[float]:
    """Time codes at which a prim, or what it stands below, has another transform."""
    found: set[float] = set()
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(UsdGeom.Xformable):
            found.update(UsdGeom.Xformable(prim).GetTimeSamples())
        prim = prim.GetParent()
    return sorted(found)


def _camera_pose(scene: _Scene, prim: Usd.Prim, time: Usd.TimeCode) -> NDArray[np.float64]:
    pose = scene.placed(prim, time)
    pose[:3, :3] = without_scale(pose[:3, :3])[0] @ FLIP
    return pose


def _sensor(
    scene: _Scene, camera: UsdGeom.Camera, products: dict[Sdf.Path, tuple[int, int]], to: str
) -> dict[str, Any]:
    time = Usd.TimeCode.EarliestTime()
    report, at = scene.imported.report, str(camera.GetPath())
    wide, high, focal, right, up, stop, focus = (
        float(attribute.Get(time))
        for attribute in (
            camera.GetHorizontalApertureAttr(), camera.GetVerticalApertureAttr(),
            camera.GetFocalLengthAttr(), camera.GetHorizontalApertureOffsetAttr(),
            camera.GetVerticalApertureOffsetAttr(), camera.GetFStopAttr(),
            camera.GetFocusDistanceAttr(),
        )
    )  # fmt: skip
    if min(wide, high, focal) <= 0.0:
        found = f"{wide:g}, {high:g} and {focal:g}"
        raise ScenecError(f"{at}: apertures and focal length are {found}: expected them above 0")
    size = products.get(camera.GetPath())
    if size is None:
        size = (_WIDTH, max(round(_WIDTH * high / wide), 1))
        report.add(ADDED, at, list(size), f"{to}/resolution", "no render product names it")
    else:
        report.add(TRANSLATED, at, list(size), f"{to}/resolution")
    width, height = size
    report.add(TRANSLATED, f"{at}.focalLength", focal, f"{to}/intrinsics")
    sensor: dict[str, Any] = {
        "resolution": [width, height],
        "intrinsics": {
            "fx": tidy(width * focal / wide),
            "fy": tidy(height * focal / high),
            "cx": tidy(0.5 * width - right * width / wide),
            "cy": tidy(0.5 * height + up * height / high),
        },
    }
    if stop > 0.0 and focus > 0.0:
        unit = float(scene.model["unit_m"])
        sensor["focus"] = {
            "distance_m": tidy(focus * unit),
            "f_number": tidy(max(stop, 0.5)),
            # Of a camera, lengths are tenths of the stage's unit.
            "focal_length_mm": tidy(100.0 * focal * unit),
        }
        report.add(TRANSLATED, f"{at}.fStop", stop, f"{to}/focus")
    return sensor
