"""Small lit RenderScenes for the tests of rendering."""

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
    eye: Sequence[float],
    target: Sequence[float],
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
    to_world = np.array([matrix for _, matrix in rows], np.float64)
    lows, highs = [], []
    for (index, _), matrix in zip(rows, to_world, strict=True):
        world = meshes[index].points.astype(float) @ matrix[:, :3].T + matrix[:, 3]
        lows.append(world.min(0))
        highs.append(world.max(0))
    lighting = Lighting(
        tuple(light for light in lights if isinstance(light, Sun)),
        tuple(light for light in lights if isinstance(light, Dome)),
    )
    return RenderScene(
        source=Path("stage.usda"),
        digest="0" * 64,
        samples=samples,
        meshes=tuple(meshes),
        rows=Rows(
            np.array([index for index, _ in rows], np.int32),
            to_world,
            np.arange(len(rows), dtype=np.uint32),
            np.asarray(row_variation or np.zeros(len(rows)), np.float32),
        ),
        surfaces=tuple(surfaces) or (surface(),),
        levels=("class",),
        label_names={"class": {1: "sky", 2: "ground"}},
        sky_labels={"class": 1},
        cameras=(tuple(cameras),) * samples,
        lighting=(lighting,) * samples,
        bounds=np.array([np.min(lows, 0), np.max(highs, 0)]),
        times=np.zeros(samples),
    )


def with_lights(scene: RenderScene, lights: Sequence[Sun | Dome]) -> RenderScene:
    """The same scene in other light."""
    lighting = Lighting(
        tuple(light for light in lights if isinstance(light, Sun)),
        tuple(light for light in lights if isinstance(light, Dome)),
    )
    return dataclasses.replace(scene, lighting=(lighting,) * scene.samples)
