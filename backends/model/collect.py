"""A stage as a ``Model``: coarse with mean colors for pages, whole with pictures for other formats.

What a model has no place for is said, a line each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.model.bake import bake, box_uv
from scenec.backends.model.colors import mean_color, surfaces_of, vertex_colors
from scenec.backends.model.simplify import simplify
from scenec.backends.stage.scene import Mesh, Reading, RenderScene, Surface
from scenec.backends.surface.corners import vertex_color
from scenec.backends.surface.gobo import mean_passed
from scenec.backends.surface.maps import map_values
from scenec.backends.surface.pictures import has_maps
from scenec.schemas import stage as names
from scenec.schemas.model import Look, Mask, Model, Part, Placement, View
from scenec.schemas.picture import srgb_bytes

#: Triangles that a prototype keeps however little room there is.
_LEAST_FACES = 24
#: Endings of pictures that other formats take as they are.
_PICTURES = (".png", ".jpg", ".jpeg")


def coarse_model(
    scene: RenderScene, name: str, *, ground_faces: int, object_faces: int, instances: int
) -> Model:
    """A model that is small: what a page shows.

    Args:
        scene: The stage.
        name: Of the batch.
        ground_faces: Triangles of the ground at most; what cameras are near to is finest.
        object_faces: Triangles of all prototypes at most, about.
        instances: Places of objects at most; those that look smallest go.
    """
    origin = _origin(scene)
    eyes = _eyes(scene) - origin
    losses = [*_losses(scene), *_pictures_lost(scene)]
    parts, looks, placements = [], [], []
    ground = _joined_ground(scene, origin)
    if ground is not None:
        part, points = ground
        small = simplify(points, part.faces, ground_faces, eyes)
        if len(small.faces) < len(part.faces):
            losses.append(
                f"ground: {len(small.faces):,} of {len(part.faces):,} triangles; vertices are "
                "means of those near each other"
            )
        assert part.colors is not None
        parts.append(
            replace(
                part,
                points=small.points.astype(np.float32),
                faces=small.faces,
                colors=small.mean(part.colors).astype(np.float32),
                labels={level: ids[small.kept] for level, ids in part.labels.items()},
            )
        )
        looks.append(Look("ground", (1.0, 1.0, 1.0), 1.0))
        placements.append(_still("", (0,)))
    groups = _groups(scene, origin)
    used = sorted({mesh for _, meshes in groups for mesh in meshes})
    share = min(1.0, object_faces / max(1, sum(len(scene.meshes[m].faces) for m in used)))
    place = {}
    for mesh in used:
        part, look, less = _object(scene, scene.meshes[mesh], share, len(looks))
        place[mesh] = len(parts)
        parts.append(part)
        looks.append(look)
        losses += less
    found = [replace(p, parts=tuple(place[m] for m in meshes)) for p, meshes in groups]
    kept, lost = _largest(found, parts, eyes, instances)
    if lost:
        losses.append(
            f"objects: the {lost:,} of {lost + sum(len(p.ids) for p in kept):,} that look smallest "
            "are left out"
        )
    return _model(scene, name, origin, parts, looks, [*placements, *kept], losses)


def full_model(scene: RenderScene, name: str, *, texels: int) -> Model:
    """A model with all triangles and instances; mixed ground becomes pictures.

    Args:
        scene: The stage.
        name: Of the batch.
        texels: Of all pictures of the ground together, about.
    """
    origin = _origin(scene)
    losses = _losses(scene)
    parts: list[Part] = []
    placements: list[Placement] = []
    looks = [_look(surface, f"look_{i:03d}") for i, surface in enumerate(scene.surfaces)]
    rows = np.flatnonzero(_ground(scene))
    baked = bake(scene, rows, texels)
    for row, (mesh, uv, picture) in zip(rows.tolist(), baked, strict=True):
        matrix = scene.rows.to_world[row] - np.column_stack([np.zeros((3, 3)), origin])
        placements.append(replace(_still("", (len(parts),)), to_world=matrix[None]))
        parts.append(Part(mesh.path, mesh.points, mesh.faces, mesh.normals, None, uv,
                          mesh.labels, len(looks)))  # fmt: skip
        shares = [s.roughness for s in surfaces_of(scene, mesh)]
        looks.append(
            Look(f"ground_{row:03d}", (1.0, 1.0, 1.0), float(np.mean(shares)), picture=picture)
        )
    if len(rows):
        losses += [
            "ground: merges of layers are baked into pictures, as seen from above; their normal "
            "and roughness maps are not",
        ]
    place, default = {}, len(looks)
    looks.append(Look("default", (0.18, 0.18, 0.18), 0.5))
    for placement, meshes in _groups(scene, origin):
        for index in meshes:
            if index not in place:
                place[index] = len(parts)
                mesh = scene.meshes[index]
                surface = surfaces_of(scene, mesh)[0]
                look = mesh.layers[0] if mesh.layers else default
                colors = None if mesh.color is None else vertex_color(mesh)
                if len(mesh.layers) > 1 and looks[look].picture is not None:
                    losses.append(f"{mesh.path}: what coats its picture is left out")
                elif len(mesh.layers) > 1:
                    # Whole colors, which a look's own would multiply.
                    colors = vertex_colors(scene, mesh).astype(np.float32)
                    look = len(looks)
                    looks.append(Look(f"coated_{look:03d}", (1.0, 1.0, 1.0), surface.roughness))
                parts.append(Part(mesh.path, mesh.points, mesh.faces, mesh.normals, colors,
                                  _object_uv(mesh, surface), mesh.labels, look))  # fmt: skip
        placements.append(replace(placement, parts=tuple(place[m] for m in meshes)))
    losses += _looks_lost(scene)
    if any(sun.gobo for lighting in scene.lighting for sun in lighting.suns):
        losses.append("light: shadows of clouds are left out, suns have their mean")
    return _model(scene, name, origin, parts, looks, placements, losses)


def _model(
    scene: RenderScene,
    name: str,
    origin: NDArray[np.float64],
    parts: Sequence[Part],
    looks: Sequence[Look],
    placements: Sequence[Placement],
    losses: Sequence[str],
) -> Model:
    suns = tuple(
        tuple((sun.to_light, sun.irradiance * mean_passed(sun)) for sun in lighting.suns)
        for lighting in scene.lighting
    )
    return Model(
        name,
        origin,
        tuple(parts),
        tuple(looks),
        tuple(placements),
        tuple(_views(scene, origin)),
        suns,
        scene.times,
        scene.label_names,
        tuple(dict.fromkeys(losses)),
        scene.georeference,
    )


def _origin(scene: RenderScene) -> NDArray[np.float64]:
    """The middle of the bounds, in whole meters."""
    if not np.isfinite(scene.bounds).all():
        return np.zeros(3)
    return np.floor(scene.bounds.mean(axis=0))


def _eyes(scene: RenderScene) -> NDArray[np.float64]:
    eyes = [camera.camera_to_world[:3, 3] for cameras in scene.cameras for camera in cameras]
    return np.array(eyes).reshape(-1, 3)


def _views(scene: RenderScene, origin: NDArray[np.float64]) -> list[View]:
    found = []
    for place, camera in enumerate(scene.cameras[0] if scene.cameras else ()):
        poses = np.stack([cameras[place].camera_to_world for cameras in scene.cameras])
        poses[:, :3, 3] -= origin
        found.append(View(camera.name, camera.width, camera.height, camera.intrinsics, poses))
    return found


def _still(owner: str, parts: tuple[int, ...]) -> Placement:
    return Placement(
        owner, parts, np.eye(4)[None, :3], np.zeros(1, np.uint32), np.zeros(1, np.float32)
    )


def _ground(scene: RenderScene) -> NDArray[np.bool_]:
    """Marks rows of ground: no instances, nor of classes without ids, nor placed often.

    A horizon counts as an object: what is finest where cameras are, and pictures from above, would
    be lost on its kilometers. So does what a mask cuts, which pictures from above would fill.
    """
    classes = (*(f"{path}/" for path in scene.instance_paths), f"{names.HORIZON}/")
    objects = [f"{mesh.path}/".startswith(classes) for mesh in scene.meshes]
    often = np.bincount(scene.rows.mesh, minlength=len(scene.meshes)) > 1
    cut = [scene.cutout_of(mesh) is not None for mesh in scene.meshes]
    apart = np.array(objects, bool) | np.array(cut, bool) | often
    return (scene.rows.instance_id == 0) & ~apart[scene.rows.mesh]


def _joined_ground(
    scene: RenderScene, origin: NDArray[np.float64]
) -> tuple[Part, NDArray[np.float64]] | None:
    """All that is no instance as one part, and its vertices in float64."""
    points, faces, colors, count = [], [], [], 0
    labels: dict[str, list[NDArray[np.uint32]]] = {level: [] for level in scene.levels}
    for row in np.flatnonzero(_ground(scene)).tolist():
        mesh = scene.meshes[scene.rows.mesh[row]]
        matrix = scene.rows.to_world[row]
        # No BLAS: threads of its own in each of several processes would only be in the way.
        local = mesh.points.astype(np.float64)
        world = (local[:, None, :] * matrix[None, :, :3]).sum(axis=2) + matrix[:, 3]
        points.append(world - origin)
        faces.append(mesh.faces + np.int32(count))
        colors.append(vertex_colors(scene, mesh))
        for level, ids in labels.items():
            ids.append(mesh.labels.get(level, np.zeros(len(mesh.faces), np.uint32)))
        count += len(local)
    if not count:
        return None
    world = np.concatenate(points)
    joined = {level: np.concatenate(ids) for level, ids in labels.items()}
    part = Part("", world.astype(np.float32), np.concatenate(faces), None,
                np.concatenate(colors).astype(np.float32), None, joined, 0)  # fmt: skip
    return part, world


def _groups(
    scene: RenderScene, origin: NDArray[np.float64]
) -> list[tuple[Placement, tuple[int, ...]]]:
    """Instances: where meshes stand, those that always stand together as one."""
    rows = scene.rows
    chosen = np.flatnonzero(~_ground(scene))
    order = chosen[np.argsort(rows.mesh[chosen], kind="stable")]
    meshes, first = np.unique(rows.mesh[order], return_index=True)
    shares = np.split(order, first[1:]) if len(meshes) else []
    together: dict[tuple[bytes, bytes], list[int]] = {}
    places: dict[tuple[bytes, bytes], NDArray[np.int64]] = {}
    for mesh, of in zip(meshes.tolist(), shares, strict=True):
        if not len(scene.meshes[mesh].faces):
            continue
        key = (rows.to_world[of].tobytes(), rows.instance_id[of].tobytes())
        together.setdefault(key, []).append(mesh)
        places.setdefault(key, of)
    found = []
    for key, members in together.items():
        of = places[key]
        to_world = rows.to_world[of].copy()
        to_world[:, :, 3] -= origin
        path = scene.meshes[members[0]].path
        owner = next((p for p in scene.instance_paths if f"{path}/".startswith(f"{p}/")), path)
        placement = Placement(owner, (), to_world, rows.instance_id[of], rows.variation[of])
        found.append((placement, tuple(members)))
    return found


def _object(
    scene: RenderScene, mesh: Mesh, share: float, look: int
) -> tuple[Part, Look, list[str]]:
    """A prototype of mean color, with about this share of its triangles."""
    # Subsets of a mesh have all its points, and models have points apart for each face.
    used = np.unique(mesh.faces)
    _, first, same = np.unique(mesh.points[used], axis=0, return_index=True, return_inverse=True)
    welded = np.zeros(len(mesh.points), np.int32)
    welded[used] = same.ravel()
    vertices = used[first]
    most = len(mesh.faces)
    if share < 1.0:
        most = min(most, max(_LEAST_FACES, int(share * most)))
    small = simplify(mesh.points[vertices].astype(np.float64), welded[mesh.faces], most)
    less = []
    if len(small.faces) < len(mesh.faces):
        less = [f"{mesh.path}: {len(small.faces):,} of {len(mesh.faces):,} triangles"]
    colors = None
    if len(mesh.layers) > 1 or mesh.variation is not None or mesh.color is not None:
        colors = small.mean(vertex_colors(scene, mesh)[vertices]).astype(np.float32)
    surface = surfaces_of(scene, mesh)[0]
    red, green, blue = mean_color(surface).tolist()
    part = Part(
        mesh.path,
        small.points.astype(np.float32),
        small.faces,
        None,
        colors,
        None,
        {level: ids[small.kept] for level, ids in mesh.labels.items()},
        look,
    )
    return part, Look(f"look_{look:03d}", (red, green, blue), surface.roughness), less


def _largest(
    placements: Sequence[Placement],
    parts: Sequence[Part],
    eyes: NDArray[np.float64],
    most: int,
) -> tuple[list[Placement], int]:
    """The places that look largest from where one looks from, and how many go."""
    total = sum(len(p.ids) for p in placements)
    if total <= most:
        return list(placements), 0
    sizes = []
    for placement in placements:
        points = np.concatenate([parts[p].points for p in placement.parts])
        radius = float(np.linalg.norm(np.abs(points).max(axis=0)))
        scale = np.sqrt((placement.to_world[:, :, :3] ** 2).sum(axis=(1, 2)) / 3.0)
        away = np.full(len(placement.ids), np.inf if len(eyes) else 1.0)
        for eye in eyes:
            distance = np.sqrt(((placement.to_world[:, :, 3] - eye) ** 2).sum(axis=1))
            away = np.minimum(away, distance)
        sizes.append(radius * scale / np.maximum(away, 1e-3))
    least = np.sort(np.concatenate(sizes))[total - most]
    kept = []
    for placement, size in zip(placements, sizes, strict=True):
        stays = size >= least
        if stays.any():
            kept.append(
                replace(
                    placement,
                    to_world=placement.to_world[stays],
                    ids=placement.ids[stays],
                    variation=placement.variation[stays],
                )
            )
    return kept, total - sum(len(p.ids) for p in kept)


def _look(surface: Surface, name: str) -> Look:
    """Reduces a surface to what other formats have: a picture only in sRGB, times a color."""
    picture: Path | NDArray[np.uint8] | None
    picture, color = None, np.array(surface.base_color)
    if surface.maps is not None and has_maps(surface.maps, "base_color"):
        reading = dict(surface.maps.readings).get("base_color", Reading())
        picture = surface.maps.base_color
        plain = reading.srgb is not False and not any(reading.bias)
        if reading.tiles != (1, 1):
            picture = srgb_bytes(map_values(surface.maps, "base_color"))
        elif picture is not None and plain and picture.suffix.lower() in _PICTURES:
            color = color * reading.scale
        else:
            picture, color = None, mean_color(surface)
    if surface.path:
        name = surface.path.rpartition("/")[2]
    red, green, blue = color.tolist()
    return Look(
        name,
        (red, green, blue),
        surface.roughness,
        surface.metallic,
        surface.emission,
        picture,
        surface.diffuse_transmission,
        _mask(surface),
    )


def _mask(surface: Surface) -> Mask | None:
    """The mask of a surface, in 8 bits: contours move by 1/510 of opacity's range at most."""
    maps = surface.cutout
    if maps is None:
        return None
    opacity = np.rint(255.0 * map_values(maps, "opacity")[..., 0]).astype(np.uint8)
    # The decimal that was meant: texels that are at it as float32 are not below it as float64.
    return Mask(opacity, float(str(np.float32(maps.opacity_threshold))), maps.opacity_wrap)


def _object_uv(mesh: Mesh, surface: Surface) -> NDArray[np.float32] | None:
    """Texture coordinates of an object: its own, or those of the side that a face looks to."""
    if surface.maps is None or not (surface.cutout or has_maps(surface.maps, "base_color")):
        return None
    if surface.maps.projection == "uv":
        return mesh.uv
    return box_uv(mesh.points, mesh.faces, surface.maps.size_m)


def _losses(scene: RenderScene) -> list[str]:
    """Lists what a model cannot hold."""
    found = list(scene.losses)
    if any(mesh.color is not None for mesh in scene.meshes):
        found.append("colors of corners: a vertex has that of one of its faces")
    if scene.rows.motion is not None:
        found.append(
            f"motion: {len(scene.rows.motion.rows):,} meshes of moving objects stand where they "
            "are at the first sample"
        )

    def some(what: str, has: Callable[..., bool]) -> None:
        names = [camera.name for camera in (scene.cameras or ((),))[0] if has(camera)]
        if names:
            found.append(f"cameras: {what} ({', '.join(names)})")

    some("lenses are left out, poses and K stay", lambda c: c.lens is not None)
    some("rolling shutters and exposure times are left out", lambda c: c.shutter is not None)
    some("depth of field is left out", lambda c: c.focus is not None)
    lights = scene.lighting[0] if scene.lighting else None
    if lights is not None and lights.domes:
        found.append("light: the sky's is left out")
    if lights is not None and lights.lamps:
        found.append(f"light: {len(lights.lamps)} lamps are left out")
    if any(haze is not None for haze in scene.haze):
        found.append("light: haze is left out")
    return found


def _pictures_lost(scene: RenderScene) -> list[str]:
    names = [s.path.rpartition("/")[2] for s in scene.surfaces if s.maps is not None]
    found = [f"looks: pictures count by their mean color ({', '.join(names)})"] if names else []
    return [*found, "opacity: what pictures cut out is solid"] if scene.has_cutouts else found


def _looks_lost(scene: RenderScene) -> list[str]:
    found = []
    maps = [s for s in scene.surfaces if s.maps is not None]
    if any(s.maps is not None and s.maps.projection != "uv" for s in maps):
        found.append(
            "objects: pictures that lie on the world lie on the sides of the prototype, so all "
            "instances have them alike"
        )
    if any(s.varies for s in scene.surfaces):
        found.append("objects: albedo varies neither over a mesh nor from instance to instance")
    if any(s.reflectance is not None for s in scene.surfaces):
        found.append("looks: reflectance of airless bodies (Hapke, Lommel-Seeliger) is Lambert's")
    return found
