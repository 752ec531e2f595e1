"""Small lit RenderScenes, made by hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from scenec.backends.stage.scene import (
    Camera,
    Dome,
    Lighting,
    Mesh,
    RenderScene,
    Rows,
    Sun,
    Surface,
)
from scenec.schemas.quaternions import rotation_entries

#: Rotation of a dome on a Z-up stage: rotateX 90, pole +Y to world +Z.
DOME_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def plane(half: float = 50.0, cells: int = 1) -> tuple[NDArray, NDArray]:
    """A square at z = 0, normal +Z."""
    axis = np.linspace(-half, half, cells + 1)
    y, x = np.meshgrid(axis, axis, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    i = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (q.ravel() for q in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    return points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def mesh(
    points: NDArray,
    faces: NDArray,
    layers: Sequence[int] = (0,),
    weights: NDArray | None = None,
    variation: NDArray | None = None,
    normals: NDArray | None = None,
) -> Mesh:
    """A mesh with one label level."""
    points = np.asarray(points, np.float32)
    faces = np.asarray(faces, np.int32)
    empty = np.empty((len(layers) - 1, len(points)), np.float32)
    return Mesh(
        path="/World/Mesh",
        points=points,
        faces=faces,
        authored_face=None,
        normals=None if normals is None else np.asarray(normals, np.float32),
        labels={"class": np.full(len(faces), 2, np.uint32)},
        layers=tuple(layers),
        weights=empty if weights is None else np.asarray(weights, np.float32),
        variation=None if variation is None else np.asarray(variation, np.float32),
    )


def surface(
    color: Sequence[float] = (0.5, 0.5, 0.5),
    specular: float = 0.0,
    roughness: float = 0.5,
    variation: float = 0.0,
) -> Surface:
    """A material."""
    r, g, b = color
    return Surface("/World/Looks/M", (r, g, b), specular, roughness, variation)


def look_at(
    eye: Sequence[float] | NDArray,
    target: Sequence[float] | NDArray,
    width: int = 32,
    height: int = 24,
    fov_deg: float = 50.0,
) -> Camera:
    """A pinhole camera, up is +Z (or +Y when it looks straight up or down)."""
    forward = np.subtract(target, eye).astype(float)
    forward /= np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(forward, right), forward
    pose[:3, 3] = eye
    f = 0.5 * width / np.tan(np.radians(fov_deg) / 2)
    k = np.array([[f, 0.0, width / 2], [0.0, f, height / 2], [0.0, 0.0, 1.0]])
    return Camera("rig_cam", "/World/Rig/cam", width, height, k, pose)


def sun(
    elevation_deg: float = 90.0,
    azimuth_deg: float = 0.0,
    irradiance: float = 1000.0,
    diameter_deg: float = 0.53,
) -> Sun:
    """A sun; azimuth from +X towards +Y."""
    e, a = np.radians([elevation_deg, azimuth_deg])
    to_light = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return Sun(to_light, np.full(3, irradiance), float(np.radians(diameter_deg)))


def dome(radiance: float = 1.0, texture: Path | None = None) -> Dome:
    """A dome on the Z-up stage."""
    return Dome(texture, np.full(3, radiance), DOME_Z_UP)


def write_latlong(path: Path, values: NDArray) -> Path:
    """A picture of a sky, [rows, columns, 3], as an OpenEXR file; its path."""
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    planes = {c: np.ascontiguousarray(values[..., i], np.float32) for i, c in enumerate("RGB")}
    OpenEXR.File(header, planes).write(str(path))
    return path


def scene(
    meshes: Sequence[Mesh],
    surfaces: Sequence[Surface] = (),
    *,
    rows: Sequence[tuple[int, NDArray]] | None = None,
    row_variation: Sequence[float] | None = None,
    cameras: Sequence[Camera] = (),
    lights: Sequence[Sun | Dome] = (),
    samples: int = 1,
) -> RenderScene:
    """A scene; one identity row per mesh unless rows are given."""
    if rows is None:
        rows = [(i, np.eye(4)[:3]) for i in range(len(meshes))]
    of_rows = np.array([index for index, _ in rows], np.int32)
    to_world = np.array([matrix for _, matrix in rows], np.float64)
    lows, highs = [], []
    for index, shape in enumerate(meshes):
        matrix = to_world[of_rows == index]
        if len(shape.points) and len(matrix):
            corners = shape.points.astype(float) @ matrix[:, :, :3].transpose(0, 2, 1)
            corners += matrix[:, None, :, 3]
            lows.append(corners.min((0, 1)))
            highs.append(corners.max((0, 1)))
    return RenderScene(
        source=Path("stage.usda"),
        digest="0" * 64,
        samples=samples,
        meshes=tuple(meshes),
        rows=Rows(
            of_rows,
            to_world,
            np.arange(len(rows), dtype=np.uint32),
            np.asarray(row_variation or np.zeros(len(rows)), np.float32),
        ),
        surfaces=tuple(surfaces) or (surface(),),
        levels=("class",),
        label_names={"class": {1: "sky", 2: "ground"}},
        sky_labels={"class": 1},
        cameras=(tuple(cameras),) * samples,
        lighting=(lighting_of(lights),) * samples,
        bounds=np.array([np.min(lows, 0), np.max(highs, 0)]),
        times=np.zeros(samples),
    )


def lighting_of(lights: Sequence[Sun | Dome]) -> Lighting:
    """Suns and skies of a sample."""
    return Lighting(
        tuple(light for light in lights if isinstance(light, Sun)),
        tuple(light for light in lights if isinstance(light, Dome)),
    )


def with_lights(scene: RenderScene, lights: Sequence[Sun | Dome]) -> RenderScene:
    """The same scene in other light."""
    return dataclasses.replace(scene, lighting=(lighting_of(lights),) * scene.samples)


def at_samples(
    made: RenderScene, lighting: Sequence[Lighting], cameras: Camera | Sequence[Camera]
) -> RenderScene:
    """A scene with another light, and maybe another camera, at each sample."""
    count = len(lighting)
    views = [cameras] * count if isinstance(cameras, Camera) else cameras
    return dataclasses.replace(
        made,
        samples=count,
        lighting=tuple(lighting),
        cameras=tuple((view,) for view in views),
        times=np.zeros(count),
    )


def affine(
    linear: NDArray | float = 1.0, offset: Sequence[float] | NDArray = (0.0, 0.0, 0.0)
) -> NDArray:
    """A 3x4 matrix from a linear part (a number scales) and an offset."""
    matrix = np.empty((3, 4))
    matrix[:, :3] = np.eye(3) * linear if np.ndim(linear) == 0 else linear
    matrix[:, 3] = offset
    return matrix


def rotation(rng: np.random.Generator) -> NDArray:
    """A random rotation matrix, uniform over all."""
    q = rng.normal(size=4)
    w, x, y, z = q / np.sqrt((q * q).sum())
    return np.reshape(rotation_entries(x, y, z, w, 2.0), (3, 3))


def icosphere(subdivisions: int) -> tuple[NDArray, NDArray]:
    """Vertices on the unit sphere (float64) and faces, closed, 20 * 4**subdivisions triangles."""
    g = (1 + 5**0.5) / 2
    points = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g),
              (0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]  # fmt: skip
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4),
             (11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8),
             (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]  # fmt: skip
    p = np.array(points, float)
    f = np.array(faces, np.int32)
    for _ in range(subdivisions):
        edges = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        m = len(p) + inverse.reshape(3, -1)
        p = np.concatenate([p, p[unique].mean(axis=1)])
        f = np.concatenate(
            [
                np.stack([f[:, 0], m[0], m[2]], 1),
                np.stack([f[:, 1], m[1], m[0]], 1),
                np.stack([f[:, 2], m[2], m[1]], 1),
                np.stack([m[0], m[1], m[2]], 1),
            ]
        )
    return p / np.sqrt((p * p).sum(axis=1))[:, None], f.astype(np.int32)
