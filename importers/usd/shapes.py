"""Makes the ground and the objects of a cfg, of what a stage's reader draws."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, UsdGeom

from scenec.importers.numbers import tidy
from scenec.importers.poses import turns_of
from scenec.importers.report import APPROXIMATED, DROPPED, TRANSLATED
from scenec.importers.scene import scattered_rocks, unused
from scenec.importers.usd.models import Placed
from scenec.importers.usd.objects import Class, Thing, key_of, things
from scenec.importers.usd.scene import Scene, name_of
from scenec.importers.usd.surfaces import Materials
from scenec.importers.writers import table_writer
from scenec.schemas.errors import ScenecError
from scenec.schemas.spelling import nearest, shown

#: Height samples along the ground.
_SPACINGS = 256
#: Different shapes of one class: where there are more, uneven scales are evened out.
_MOST_MODELS = 100

type _Box = NDArray[np.float64]


def add_shapes(scene: Scene, ground: str) -> None:
    """Adds the ground, and all else as objects on it; ``ground``: of its prim, or "".

    Raises:
        ScenecError: No prim is called so.
    """
    read, cfg = scene.read, scene.imported.cfg
    materials = Materials(read.surfaces, scene.imported)
    rows_of = _origins(scene)
    boxes = {
        path: _box(scene, rows)
        for path, rows in rows_of.items()
        if not scene.stage.GetPrimAtPath(path).IsA(UsdGeom.PointInstancer)
    }
    chosen = _ground(scene, boxes, rows_of, ground)
    layer: dict[str, Any] = {"material": "ground"}
    cfg["terrain"]["ground"] = [layer]
    extras: list[Placed] = []
    if chosen:
        labels, extras = _mesh_ground(scene, materials, chosen, rows_of[chosen], boxes[chosen])
    else:
        labels = {}
        _plane(scene, list(boxes.values()))
        materials.of_ground(-1)
    if labels := labels or scene.labels.of_class("ground"):
        layer["labels"] = labels
    taken = set(rows_of.get(chosen, ()))
    if extras:
        made = Thing(1, np.eye(4)[None], (), ())
        _write(scene, materials, chosen, False, [(made, 0)], [extras])
    for members in _classes(scene, rows_of, boxes, chosen, taken):
        _add(scene, materials, members)


def _origins(scene: Scene) -> dict[str, list[int]]:
    """Groups rows by the prim that they come from."""
    rows_of: dict[str, list[int]] = {}
    first = 0
    for path, count in scene.read.origins:
        rows_of.setdefault(path, []).extend(range(first, first + count))
        first += count
    return {path: rows for path, rows in rows_of.items() if rows}


def _box(scene: Scene, rows: Sequence[int]) -> _Box:
    """Returns corners of what some rows hold at the first sample, [2, 3]; in meters, z up."""
    found = [np.zeros((0, 3))]
    for row in rows:
        mesh, matrix = scene.read.meshes[scene.read.rows.mesh[row]], scene.read.rows.to_world[row]
        if len(mesh.faces):
            found.append(mesh.used_points @ matrix[:, :3].T + matrix[:, 3])
    points = np.concatenate(found)
    return np.stack([points.min(axis=0), points.max(axis=0)]) if len(points) else np.zeros((2, 3))


def _plan(box: _Box) -> float:
    return float(np.prod((box[1] - box[0])[:2]))


def _ground(scene: Scene, boxes: dict[str, _Box], rows_of: dict[str, list[int]], name: str) -> str:
    """Selects the prim that is the ground; "" where none is level and wide."""
    motion = scene.read.rows.motion
    moving = set() if motion is None else set(motion.rows.tolist())
    if name:
        named = [path for path in boxes if name in (path, path.rpartition("/")[2])]
        if not named:
            names = [text for path in boxes for text in (path.rpartition("/")[2], path)]
            raise ScenecError(f"--ground {shown(name)}: no mesh is called so{nearest(name, names)}")
        return named[0] if _plan(boxes[named[0]]) > 0.0 else ""
    flat = [
        path
        for path, box in boxes.items()
        if box[1][2] - box[0][2] < _plan(box) ** 0.5 and moving.isdisjoint(rows_of[path])
    ]
    return max(flat, key=lambda path: _plan(boxes[path]), default="")


def _plane(scene: Scene, boxes: Sequence[_Box]) -> None:
    everything = np.concatenate(boxes) if boxes else np.eye(3)
    low, high = everything.min(axis=0), everything.max(axis=0)
    side = 4.0 * max(float(np.linalg.norm((high - low)[:2])), 1.0)
    scene.extent_m = (tidy(side), tidy(side))
    scene.shift[:2] = -0.5 * (low + high)[:2]
    relief = [{"type": "plane", "height_m": tidy(float(low[2]))}]
    spacing = tidy(side / _SPACINGS)
    scene.imported.cfg["terrain"].update(
        size_m=list(scene.extent_m), spacing_m=spacing, relief=relief
    )
    scene.imported.report.added("terrain", "nothing is level and wide: a plane below all")


def _mesh_ground(
    scene: Scene, materials: Materials, path: str, rows: Sequence[int], box: _Box
) -> tuple[dict[str, str], list[Placed]]:
    """Returns the ground's labels, and parts of its prim with other labels or surface."""
    low, high = box
    scene.extent_m = (tidy(high[0] - low[0]), tidy(high[1] - low[1]))
    scene.shift[:2] = -0.5 * (low + high)[:2]
    moved = np.column_stack([np.zeros((3, 3)), scene.shift])
    kinds: dict[tuple[int, tuple[int, ...]], list[Placed]] = {}
    for row in rows:
        matrix = scene.read.rows.to_world[row]
        for piece in scene.models.pieces(int(scene.read.rows.mesh[row])):
            kind = (piece.surface, piece.labels)
            kinds.setdefault(kind, []).append((piece, matrix + moved))
    widest = max(kinds, key=lambda kind: sum(piece.area for piece, _ in kinds[kind]))
    ground = kinds.pop(widest)
    widest_pieces = [piece for piece, _ in ground]
    part = scene.models.add(f"{name_of(path)}_model", ground)
    scene.imported.cfg["terrain"].update(
        size_m=list(scene.extent_m),
        spacing_m=float(f"{min(scene.extent_m) / _SPACINGS:.4g}"),
        relief=[
            {
                "type": "mesh",
                "file": _file(scene),
                "part": part,
                "place": "keep",
                # Its border need not be a rectangle's.
                "holes": "fill",
            }
        ],
    )
    notes = []
    if (ids := scene.read.rows.instance_id[list(rows)]).any():
        notes.append(f"the ground is no instance: its id {int(ids.max())} becomes 0")
    if scene.shift.any():
        offset = [tidy(float(v)) for v in scene.shift[:2]]
        scene.imported.report.add(
            TRANSLATED, path, None, "", f"all is moved by {offset} m: its middle is the origin"
        )
    fate = APPROXIMATED if notes else TRANSLATED
    scene.imported.report.add(fate, path, None, "terrain/relief/0", "; ".join(notes))
    materials.of_ground(widest[0], scene.models.mean_color(widest_pieces))
    return scene.labels.choice(widest[1]), [one for kind in kinds.values() for one in kind]


def _file(scene: Scene) -> str:
    return scene.imported.make("models.usdc", scene.models.write)


def _classes(
    scene: Scene,
    rows_of: dict[str, list[int]],
    boxes: dict[str, _Box],
    ground: str,
    used: set[int],
) -> list[Class]:
    """Groups rows into classes, in the order of the stage: those of instances by their ids."""
    read = scene.read
    ids = read.rows.instance_id.astype(np.int64)
    paths, bases = list(read.instance_paths), np.array([*read.instance_paths.values()], np.int64)
    groups = _groups([path for path, r in rows_of.items() if not ids[r].any()], boxes, ground)
    classes: dict[tuple[str, bool], Class] = {}
    for path, rows in rows_of.items():
        for row in rows:
            if row in used:
                continue
            number = int(ids[row])
            if number:
                at = int(np.searchsorted(bases, number)) - 1
                owner, local = (paths[at], number - int(bases[at])) if at >= 0 else (path, number)
            elif path in boxes:
                owner, local = groups.get(path, path), 1
            else:
                owner, local = path, row + 1
            made = classes.setdefault((owner, number > 0), Class(owner, number > 0))
            made.rows.setdefault(local, []).append(row)
    return list(classes.values())


def _groups(paths: Sequence[str], boxes: dict[str, _Box], ground: str) -> dict[str, str]:
    """Finds the uppermost prim around each that holds no ground: what is one object."""
    grounds = [Sdf.Path(ground)] if ground else []
    shapes = [Sdf.Path(path) for path in paths if path in boxes]
    common = shapes[0].GetParentPath() if shapes else Sdf.Path.absoluteRootPath
    for path in [*shapes, *grounds]:
        common = common.GetCommonPrefix(path.GetParentPath())
    found = {}
    for path in shapes:
        above = path
        while above.GetParentPath() != common and not any(
            other.HasPrefix(above.GetParentPath()) for other in grounds
        ):
            above = above.GetParentPath()
        found[str(path)] = str(above)
    return found


def _add(scene: Scene, materials: Materials, members: Class) -> None:
    """Adds a class of objects at their poses in the stage."""
    models: dict[bytes, list[Placed]] = {}
    found = list(things(scene, members))
    keys = [key_of(thing.content) for thing in found]
    evened = len(set(keys)) > _MOST_MODELS
    if evened:
        keys = [key_of(thing.even) for thing in found]
    for thing, key in zip(found, keys, strict=True):
        if key not in models:
            models[key] = [
                (piece, place)
                for mesh, place in (thing.even if evened else thing.content)
                for piece in scene.models.pieces(mesh)
            ]
    # What has no area is no model, and shows nothing.
    shown_keys = [
        key for key, content in models.items() if any(scene.models.shows(*one) for one in content)
    ]
    kept = [
        (thing, shown_keys.index(key))
        for thing, key in zip(found, keys, strict=True)
        if key in shown_keys
    ]
    flat = len(members.rows) - len({thing.number for thing, _ in kept} & set(members.rows))
    if flat:
        why = "it has no faces, or is scaled to nothing"
        scene.imported.report.add(DROPPED, members.path, flat, "", why)
    if kept:
        contents = [models[key] for key in shown_keys]
        _write(scene, materials, members.path, members.instances, kept, contents, evened)


def _write(
    scene: Scene,
    materials: Materials,
    path: str,
    instances: bool,
    objects: Sequence[tuple[Thing, int]],
    models: Sequence[Sequence[Placed]],
    evened: bool = False,
) -> None:
    """Writes a class of the cfg.

    Args:
        path: Of its prim.
        instances: Whether its objects are instances in the stage.
        objects: Each with the index of its model.
        models: What they hold.
        evened: Whether uneven scales were evened out.
    """
    known = scene.imported.cfg["objects"]
    name = unused(name_of(path), known)
    pieces = {piece.name: piece for content in models for piece, _ in content}.values()
    first = next(iter(pieces))
    own = [set(enumerate(piece.labels)) for piece in pieces]
    common = set.intersection(*own)
    labels = [dict(common).get(level, 0) for level in range(len(first.labels))]
    entry: dict[str, Any] = {
        "type": "placed",
        "models": [
            {"file": _file(scene), "part": scene.models.add(f"{name}_model", m)} for m in models
        ],
    }
    # Colors of vertices are shown by the file's own materials alone.
    colored = {piece.name for piece in pieces if scene.models.is_colored(piece)}
    if not colored:
        entry["material"] = materials.name(first.surface)
    known[name] = entry
    parts: dict[str, dict[str, Any]] = {}
    for piece in pieces:
        rule: dict[str, Any] = {}
        own_rule = bool(colored) and piece.name not in colored
        if own_rule or (not colored and piece.surface != first.surface):
            rule["material"] = materials.name(piece.surface)
        others = [0 if same else n for n, same in zip(piece.labels, labels, strict=True)]
        if any(others):
            rule["labels"] = scene.labels.choice(others)
        if rule:
            parts[piece.name] = rule
    if parts:
        entry["parts"] = parts
    if found := scene.labels.choice(labels) or scene.labels.of_class(name):
        entry["labels"] = found
    if not instances and scene.labels.authored:
        entry["instances"] = False
    notes = sorted({note for thing, _ in objects for note in thing.notes})
    if any(map(scene.models.loses_colors, pieces)):
        notes.append("colors of vertices that multiply a picture are left out")
    exact = all("hidden by" in note for note in notes) and not evened
    if evened:
        notes.append(f"more than {_MOST_MODELS} shapes: uneven scales are evened out")
    entry |= _poses(scene, name, objects, notes) | {"heights": "world"}
    count = len(objects) if len(objects) > 1 else None
    fate = TRANSLATED if exact else APPROXIMATED
    scene.imported.report.add(fate, path, count, f"objects/{name}", "; ".join(notes))


def _poses(
    scene: Scene, name: str, objects: Sequence[tuple[Thing, int]], notes: list[str]
) -> dict[str, Any]:
    """Writes poses of a class's objects: one into the cfg, several into a table."""
    thing, _ = objects[0]
    if len(objects) == 1 and len(thing.poses) == 1:
        matrix = thing.poses[0]
        scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
        pose: dict[str, Any] = {
            key: float(f"{value:.12g}")
            for key, value in zip(("x_m", "y_m", "z_m"), matrix[:3, 3].tolist(), strict=True)
        }
        turns = [tidy(turn) + 0.0 for turn in turns_of(matrix[:3, :3] / scale)]
        if any(abs(turn) > 1e-9 for turn in turns):
            pose["rotation_deg"] = turns
        if abs(scale - 1.0) > 1e-9:
            pose["scale"] = tidy(scale)
        return {"poses": [pose]}
    times = scene.times_s if scene.tracked else np.arange(scene.read.samples, dtype=np.float64)
    moving = any(len(one.poses) > 1 for one, _ in objects)
    rows = [(one, model, i) for one, model in objects for i in range(len(one.poses))]
    columns: dict[str, list[float] | None] = {
        "model": [model for _, model, _ in rows] if any(model for _, model in objects) else None,
        "id": [one.number for one, _, _ in rows],
        "time_s": [float(times[i]) for _, _, i in rows] if moving else None,
    }
    if moving and not scene.tracked:
        notes.append("a sample a second, as no camera has a track")
    write = table_writer([one.poses[i] for one, _, i in rows], **columns)
    return {"file": scene.imported.make(f"{name}.csv", write)}


def add_rocks(scene: Scene) -> None:
    """Adds rocks that each batch scatters anew."""
    cfg = scene.imported.cfg
    name, material = unused("rocks", cfg["objects"]), unused("stone", cfg["materials"])
    cfg["materials"][material] = {
        "base_color": [0.25, 0.21, 0.17],
        "maps": {"procedural": {"type": "weathered", "resolution": 512}},
    }
    area = scene.extent_m[0] * scene.extent_m[1]
    cfg["objects"][name] = scattered_rocks(area, material, scene.labels.added("rock"))
    scene.imported.report.added(f"objects/{name}", "rocks that each batch scatters")
