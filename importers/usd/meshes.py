"""Ground and objects of a stage."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom

from scenec.compiler.assets.model import cached_model
from scenec.importers.made import table_writer
from scenec.importers.numbers import tidy
from scenec.importers.poses import without_scale
from scenec.importers.report import APPROXIMATED, DROPPED, TRANSLATED
from scenec.importers.scene import identifier, scattered_rocks, soil, unused
from scenec.importers.usd.scene import Scene, is_prototype, shown_prims
from scenec.schemas.errors import ScenecError
from scenec.schemas.spelling import nearest, shown

#: Height samples along the ground.
_SPACINGS = 256


def model_of(
    scene: Scene, file: Path, instancers: Sequence[Usd.Prim], layout: dict[str, Any]
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

    why = "of several layers" if others else "without its point instancers"
    scene.imported.report.add(TRANSLATED, str(file.name), None, "a copy", f"one file {why}")
    return {
        "file": scene.imported.make("stage.usdc", lambda path: layer.Export(str(path))),
        **layout,
    }


def _take_apart(layer: Sdf.Layer, prim: Usd.Prim) -> None:
    """Moves the prototypes of an instancer to the root, where models are taken from."""
    for target in UsdGeom.PointInstancer(prim).GetPrototypesRel().GetTargets():
        Sdf.CopySpec(layer, target, layer, Sdf.Path(_prototype(prim, target)))
    layer.GetPrimAtPath(prim.GetPath()).active = False


def _prototype(prim: Usd.Prim, target: Sdf.Path) -> str:
    return f"/{identifier(f'{prim.GetPath()}_{target.name}')}"


def add_ground(scene: Scene, name: str) -> None:
    """The ground, and all other meshes as objects on it; ``name``: of the ground's mesh, or "".

    Raises:
        ScenecError: No mesh is called so.
    """
    meshes = [prim for prim in shown_prims(scene.stage, UsdGeom.Mesh) if not is_prototype(prim)]
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
        report.added("terrain", "no mesh is level and wide: a plane below all")
    for path, members in _groups(others, chosen):
        _placed(scene, path, members)


def _box(scene: Scene, prim: Usd.Prim) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
    scene: Scene, prim: Usd.Prim, box: tuple[NDArray[np.float64], NDArray[np.float64]]
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


def _color(scene: Scene, path: str) -> dict[str, Any] | None:
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


def _placed(scene: Scene, path: Sdf.Path, members: Sequence[Usd.Prim]) -> None:
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


def add_instances(scene: Scene, prim: Usd.Prim) -> None:
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
    made = scene.imported.make(f"{name}.csv", table_writer(poses, model=[int(i) for i in kept]))
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


def add_rocks(scene: Scene) -> None:
    """Rocks that each batch scatters anew."""
    cfg = scene.imported.cfg
    name, material = unused("rocks", cfg["objects"]), unused("stone", cfg["materials"])
    cfg["materials"][material] = {
        "base_color": [0.25, 0.21, 0.17],
        "maps": {"procedural": {"type": "weathered", "resolution": 512}},
    }
    area = scene.extent_m[0] * scene.extent_m[1]
    cfg["objects"][name] = scattered_rocks(area, material, scene.taxonomy.choice("rock"))
    scene.imported.report.added(f"objects/{name}", "rocks that each batch scatters")
