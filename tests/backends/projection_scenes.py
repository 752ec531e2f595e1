"""Objects with surface maps by every projection, and what they must look like in any renderer.

The oracle meets triangles in float64 and takes values and normals from ``surface_oracle``; light is
one sun, on which nothing else throws a shadow.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mitsuba_scenes as ms
import numpy as np
import surface_oracle as oracle
from numpy.typing import NDArray
from PIL import Image
from scenes import icosphere

from scenec.backends.stage.scene import Maps, Mesh, RenderScene, Surface
from scenec.backends.surface import maps

IRRADIANCE = 1000.0
COLOR = (0.9, 0.8, 0.7)
SIZE = 3.5
WIDTH, HEIGHT = 48, 36
#: Of the grid of rays in a pixel that the oracle takes the mean of.
_SIDE = 3
#: What ``scene`` takes: of a triplanar ball (kind, pose, smooth), of one with texture coordinates
#: (kind, pose, coordinates, flip_green). Shading normals are not interpolated the same by all
#: renderers where a row stretches them: such a row is drawn flat.
TRIPLANAR = [
    ("base_color", "plain", True),
    ("base_color", "stretched", False),
    ("base_color", "mirrored", True),
    ("normal", "plain", True),
    ("normal", "stretched", False),
    ("normal", "mirrored", True),
]
BY_UV = [
    ("base_color", "plain", "smooth", False),
    ("base_color", "mirrored", "islands", False),
    ("normal", "plain", "smooth", False),
    ("normal", "plain", "islands", True),
    ("normal", "stretched", "islands", False),
    ("normal", "mirrored", "islands", True),
]


@dataclass(frozen=True)
class Hits:
    """What the rays through pixel centers meet first; all float64 [h, w, ...].

    Attributes:
        face: -1 where they meet nothing.
        position, view: World point, and direction to the camera.
        geometric, shading: Unit normals, outward.
        uv, along_u, along_v: Texture coordinates, and directions of dP/du and dP/dv.
        share: Barycentric coordinates.
    """

    face: NDArray[np.int64]
    position: NDArray[np.float64]
    view: NDArray[np.float64]
    geometric: NDArray[np.float64]
    shading: NDArray[np.float64]
    uv: NDArray[np.float64]
    along_u: NDArray[np.float64]
    along_v: NDArray[np.float64]
    share: NDArray[np.float64]


def write_picture(folder: Path, kind: str, flip_green: bool = False) -> Path:
    """A small picture without symmetry: colors, or normals that lean by up to 35 degrees."""
    rng = np.random.default_rng(11)
    file = folder / f"{kind}_{flip_green}.png"
    if kind == "base_color":
        pixels = rng.integers(30, 230, (5, 5, 3))
    else:
        tilt = rng.uniform(-0.4, 0.4, (5, 5, 2))
        normal = np.concatenate([tilt, np.sqrt(1 - (tilt**2).sum(-1, keepdims=True))], axis=-1)
        if flip_green:
            normal[..., 1] *= -1.0
        pixels = np.rint((normal + 1.0) / 2.0 * 255.0)
    Image.fromarray(pixels.astype(np.uint8)).save(file)
    return file


def ball(smooth: bool, uv: str | None, subdivisions: int | None = None) -> Mesh:
    """A ball of radius 2: "smooth" coordinates over space, or "islands" of their own on each face.

    Every other island is a mirrored one.
    """
    points, faces = icosphere(subdivisions or (2 if smooth and uv is None else 1))
    points = 2.0 * points
    mesh = ms.mesh(points, faces, normals=points / 2.0 if smooth else None)
    if uv is None:
        return mesh
    corners = points[faces]
    if uv == "smooth":
        found = smooth_coordinates(corners)
    else:
        rng = np.random.default_rng(2)
        shape = np.array([[0.0, 0.0], [0.3, 0.05], [0.1, 0.25]])
        found = shape + rng.uniform(0.0, 5.0, (len(faces), 1, 2))
        found[::2, :, 0] *= -1.0
    return Mesh(**{**vars(mesh), "uv": found.astype(np.float32)})


def smooth_coordinates(points: NDArray) -> NDArray[np.float64]:
    """Texture coordinates of a ball's points, [..., 2]."""
    found: NDArray[np.float64] = (
        points[..., :2] * 0.21 + points[..., 2:] * np.array([0.1, 0.07]) + 0.3
    )
    return found


def pose(name: str) -> NDArray[np.float64]:
    """A local-to-world matrix, [3, 4]."""
    linear = np.eye(3)
    if name != "plain":
        turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        scales = {"stretched": [1.1, 0.8, 0.95], "mirrored": [0.9, 0.9, -0.9]}[name]
        linear = turn @ np.diag(scales)
    return np.concatenate([linear, [[1003.7], [-508.2], [31.4]]], axis=1)


def scene(
    folder: Path,
    projection: str,
    kind: str,
    posed: str = "plain",
    smooth: bool = True,
    uv: str | None = None,
    flip_green: bool = False,
) -> RenderScene:
    """One ball under one sun, with a map of base color or of normals."""
    file = write_picture(folder, kind, flip_green)
    described = Maps(SIZE, **{kind: file}, flip_green=flip_green, projection=projection)
    surface = Surface("/M", COLOR, 0.0, 0.5, 0.0, 0.0, described)
    matrix = pose(posed)
    middle = matrix[:, 3]
    camera = ms.look_at(middle + np.array([5.0, -6.0, 4.0]), middle, WIDTH, HEIGHT, 40.0)
    return ms.scene(
        [ball(smooth, uv)],
        [surface],
        rows=[(0, matrix)],
        cameras=[camera],
        lights=[ms.sun(40.0, -20.0, irradiance=IRRADIANCE, diameter_deg=0.1)],
    )


def sheet_scene(folder: Path, projection: str) -> RenderScene:
    """A leaning square with a map of normals, seen and lit from behind."""
    file = write_picture(folder, "normal")
    described = Maps(SIZE, normal=file, projection=projection)
    points, faces = ms.plane(2.0, cells=2)
    mesh = ms.mesh(points, faces)
    uv = (points[faces][..., :2] * 0.2 + 0.1).astype(np.float32)
    mesh = Mesh(**{**vars(mesh), "uv": uv})
    lean = np.radians(35.0)
    linear = np.array(
        [[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]]
    )
    camera = ms.look_at((1.0, 1.0, -7.0), (0.0, 0.0, 0.0), WIDTH, HEIGHT, 30.0)
    return ms.scene(
        [mesh],
        [Surface("/M", COLOR, 0.0, 0.5, 0.0, 0.0, described)],
        rows=[(0, np.concatenate([linear, np.zeros((3, 1))], axis=1))],
        cameras=[camera],
        lights=[ms.sun(-60.0, 20.0, irradiance=IRRADIANCE, diameter_deg=0.1)],
    )


def meet(scene: RenderScene, within: tuple[float, float] = (0.5, 0.5)) -> Hits:
    """The first hits of the only row at a place in each pixel (Moeller and Trumbore 1997)."""
    camera, mesh, matrix = scene.cameras[0][0], scene.meshes[0], scene.rows.to_world[0]
    k, placed = camera.intrinsics, camera.camera_to_world
    v, u = np.meshgrid(np.arange(HEIGHT) + within[1], np.arange(WIDTH) + within[0], indexing="ij")
    d = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
    d = d @ placed[:3, :3].T
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    corners = (mesh.points.astype(float) @ matrix[:, :3].T + matrix[:, 3])[mesh.faces]
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    nearest = np.full(u.shape, np.inf)
    face = np.full(u.shape, -1)
    share = np.zeros((*u.shape, 3))
    for f in range(len(a)):
        p = np.cross(d, ac[f])
        with np.errstate(all="ignore"):
            scale = 1.0 / (p @ ab[f])
        s = placed[:3, 3] - a[f]
        first = (p @ s) * scale
        q = np.cross(s, ab[f])
        second, t = (d @ q) * scale, (ac[f] @ q) * scale
        hit = (first >= 0) & (second >= 0) & (first + second <= 1) & (t > 0) & (t < nearest)
        nearest, face = np.where(hit, t, nearest), np.where(hit, f, face)
        share[hit] = np.stack([1 - first - second, first, second], -1)[hit]
    at = np.maximum(face, 0)
    handed = np.sign(np.linalg.det(matrix[:, :3]))
    geometric = handed * np.cross(ab, ac)[at]
    geometric /= np.linalg.norm(geometric, axis=-1, keepdims=True)
    shading = geometric
    if mesh.normals is not None:
        share[face < 0] = 1.0 / 3.0
        own = (share[..., None] * mesh.normals.astype(float)[mesh.faces[at]]).sum(-2)
        shading = own @ np.linalg.inv(matrix[:, :3])
        shading /= np.linalg.norm(shading, axis=-1, keepdims=True)
    uv = np.zeros((*u.shape, 2))
    if mesh.uv is not None:
        uv = (share[..., None] * mesh.uv[at]).sum(-2)
    along = [t.astype(float)[at] @ matrix[:, :3].T for t in maps.face_tangents(mesh)]
    position = (share[..., None] * corners[at]).sum(-2)
    return Hits(face, position, -d, geometric, shading, uv, *along, share)


def expected(scene: RenderScene) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Radiance of pixels [h, w, 3], and where the mean of a few rays says it."""
    steps = (np.arange(_SIDE) + 0.5) / _SIDE
    seen = [_shade(scene, meet(scene, (x, y))) for x in steps for y in steps]
    same = np.all([faces == seen[0][2] for _, _, faces in seen], axis=0)
    whole = scene.meshes[0].uv is None and scene.meshes[0].normals is not None
    sound = np.all([lit for _, lit, _ in seen], axis=0) & (whole | same)
    # What else of a pixel might be another face's, or none's.
    face = seen[0][2]
    for shift in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        other = np.roll(face, shift, (0, 1))
        sound &= (other >= 0) if whole else (other == face)
    return np.mean([radiance for radiance, _, _ in seen], axis=0), sound


def _shade(
    scene: RenderScene, hits: Hits
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.int64]]:
    """Radiance, whether a point is well lit and well seen, and the face."""
    described = scene.surfaces[0].maps
    assert described is not None
    albedo = np.broadcast_to(np.array(COLOR), hits.position.shape)
    normal = hits.shading
    place = hits.position / described.size_m
    if described.base_color is not None:
        picture = maps.map_values(described, "base_color")
        if described.projection == "triplanar":
            values = oracle.triplanar(picture, described.size_m, hits.position, hits.shading)
        else:
            at = hits.uv if described.projection == "uv" else place
            values = maps.sample(picture, at[..., 0], at[..., 1])
        albedo = albedo * values
    if described.normal is not None:
        picture = maps.map_values(described, "normal")
        if described.projection == "triplanar":
            normal = oracle.triplanar_normal(picture, described.size_m, hits.position, hits.shading)
        else:
            mapped = maps.sample(picture, hits.uv[..., 0], hits.uv[..., 1])
            normal = oracle.uv_normal(mapped, hits.shading, hits.along_u, hits.along_v)
    behind = (hits.geometric * hits.view).sum(-1) < 0
    height = (normal * hits.shading).sum(-1, keepdims=True)
    # From behind, normals are mirrored in the surface.
    normal = np.where(behind[..., None], normal - 2 * height * hits.shading, normal)
    facing = np.where(behind[..., None], -hits.geometric, hits.geometric)
    to_light = scene.lighting[0].suns[0].to_light
    cosine = (normal * to_light).sum(-1)
    sound = (hits.face >= 0) & (cosine > 0.1) & ((facing * to_light).sum(-1) > 0.1)
    sound &= ((normal * hits.view).sum(-1) > 0.1) & ((facing * hits.view).sum(-1) > 0.2)
    radiance = albedo * np.maximum(cosine, 0.0)[..., None] * IRRADIANCE / np.pi
    return radiance, sound, hits.face


def differences(got: NDArray, scene: RenderScene) -> tuple[float, float, int]:
    """Root mean square and mean of (got / expected - 1) over sound pixels, and their number."""
    wanted, sound = expected(scene)
    off = got[sound] / wanted[sound] - 1.0
    return float(np.sqrt(np.mean(off**2))), float(np.mean(off)), int(sound.sum())


def metal_scene(folder: Path, projection: str | None) -> RenderScene:
    """A ball of rough metal, its numbers in pictures of one value where there is a projection."""
    described, roughness, metallic = None, 0.6, 1.0
    if projection is not None:
        rough, metal = folder / "rough.png", folder / "metal.png"
        Image.fromarray(np.full((2, 2), 153, np.uint8)).save(rough)
        Image.fromarray(np.full((2, 2), 255, np.uint8)).save(metal)
        described = Maps(1.0, roughness=rough, metallic=metal, projection=projection)
        roughness, metallic = 0.1, 0.0
    surface = Surface("/M", (0.8, 0.5, 0.2), 0.3, roughness, 0.0, metallic, described)
    return ms.scene(
        [ball(True, "smooth")],
        [surface],
        cameras=[ms.look_at((5.0, -6.0, 4.0), (0.0, 0.0, 0.0), WIDTH, HEIGHT, 40.0)],
        lights=[ms.sun(40.0, -20.0, irradiance=IRRADIANCE, diameter_deg=0.1)],
    )


def mixed_scene(folder: Path) -> RenderScene:
    """A level square of three layers, one for each projection, under a sun in the zenith."""
    file = write_picture(folder, "base_color")
    points, faces = ms.plane(4.0)
    weights = np.array([[0.5] * len(points), [0.25] * len(points)])
    mesh = ms.mesh(points, faces, (0, 1, 2), weights)
    uv = (points[faces][..., 1::-1] * 0.13).astype(np.float32)
    surfaces = [
        Surface(name, COLOR, 0.0, 0.5, 0.0, 0.0, Maps(size, base_color=file, projection=name))
        for name, size in (("above", 5.0), ("triplanar", 6.0), ("uv", 1.0))
    ]
    return ms.scene(
        [Mesh(**{**vars(mesh), "uv": uv})],
        surfaces,
        cameras=[ms.look_at((0.0, -0.1, 6.0), (0.0, 0.0, 0.0), WIDTH, HEIGHT, 30.0)],
        lights=[ms.sun(90.0, irradiance=IRRADIANCE, diameter_deg=0.1)],
    )


def mixed_expected(folder: Path) -> NDArray[np.float64]:
    """Radiance of ``mixed_scene``, [h, w, 3]."""
    scene = mixed_scene(folder)
    described = scene.surfaces[0].maps
    assert described is not None
    picture = maps.map_values(described, "base_color")
    steps = (np.arange(_SIDE) + 0.5) / _SIDE
    total = np.zeros((HEIGHT, WIDTH, 3))
    for across in steps:
        for down in steps:
            hits = meet(scene, (across, down))
            x, y = hits.position[..., 0], hits.position[..., 1]
            for share, u, v in (
                (0.375, x / 5.0, y / 5.0),
                (0.375, x / 6.0, y / 6.0),
                (0.25, y * 0.13, x * 0.13),
            ):
                total += share * maps.sample(picture, u, v)
    albedo = np.array(COLOR) * total / _SIDE**2
    radiance: NDArray[np.float64] = albedo * IRRADIANCE / np.pi
    return radiance
