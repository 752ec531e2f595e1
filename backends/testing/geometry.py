"""Scenes of shapes: what is hit first, how much of a pixel is covered, what moves."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from scenec.backends.stage.scene import Motion, RenderScene
from scenec.backends.testing.scenes import (
    affine,
    at_samples,
    dome,
    icosphere,
    look_at,
    mesh,
    plane,
    rotation,
    scene,
    sun,
    surface,
)
from scenec.schemas.lens import Lens


def field(offset: float = 0.0, scale: float = 1.0, instances: int = 60) -> RenderScene:
    """Ground and instances: turned, stretched, sheared, mirrored; and a mesh without faces."""
    rng = np.random.default_rng(3)
    shift = np.array([offset, -offset, 0.0])
    ball, faces = icosphere(2)
    meshes = [
        mesh(*plane(20.0, 12)),
        mesh(ball, faces),
        mesh(ball * [1, 0.5, 0.7], faces, normals=ball),
        mesh(np.zeros((0, 3)), np.zeros((0, 3), int)),
    ]
    rows = [(0, affine(scale, shift)), (3, affine(scale, shift))]
    shear = np.array([[1, 0.8, 0], [0, 1, -0.6], [0, 0, 1]])
    for i in range(instances):
        linear = rotation(rng) * rng.uniform(0.2, 1.2)
        if i % 5 == 0:
            linear = linear @ np.diag([-1.0, 1, 1])
        if i % 3 == 0:
            linear = linear @ shear
        where = np.array([*rng.uniform(-12, 12, 2), rng.uniform(0, 1)])
        rows.append((1 + i % 2, affine(linear * scale, where * scale + shift)))
    eye, target = (shift + scale * np.array(at) for at in ((0, -18, 5.0), (0.1, 0, 0.5)))
    return scene(meshes, rows=rows, cameras=[look_at(eye, target, 160, 120, 60)])


def hills() -> RenderScene:
    """One mesh of many faces, seen from among its bumps."""
    points, faces = plane(9.0, 90)
    points[:, 2] = np.random.default_rng(5).normal(size=len(points)) * 0.15
    return scene([mesh(points, faces)], cameras=[look_at((0, -6, 1.2), (0, 4, 0), 160, 120, 75)])


def through_camera_plane() -> RenderScene:
    """Ground, wall and slivers through the camera's plane, some of them all but at its eye."""
    soup = np.random.default_rng(6).normal(size=(240, 3)) * [3.0, 3.0, 1.0]
    slivers = np.arange(240).reshape(-1, 3)
    one = np.array([[0, 1, 2]])
    meshes = [
        mesh(np.array([[-50, -60, -1.5], [60, -50, -1.5], [0, 70, -1.5]]), one),
        mesh(np.array([[0.4, -5, -3], [0.4, 40, -3], [0.4, 3, 9]]), one),
        mesh(soup, slivers),
        mesh(soup * 1e-3 + [0, 0.004, 0], slivers),
    ]
    return scene(meshes, cameras=[look_at((0, 0, 0), (0.2, 1, -0.1), 160, 120, 95)])


def large_ids() -> RenderScene:
    """66,000 rows before the one in view, and 68,450 faces in it: more than 16 bits count."""
    count = 66_000
    far = np.zeros((count, 3, 4))
    far[:, :, :3] = np.eye(3)
    far[:, 0, 3] = np.linspace(-9, 9, count)
    far[:, 2, 3] = -5.0
    meshes = [mesh(np.eye(3) * 1e-3, np.array([[0, 1, 2]])), mesh(*plane(10.0, 185))]
    rows = [(0, matrix) for matrix in far] + [(1, affine())]
    return scene(meshes, rows=rows, cameras=[look_at((0.3, -9, 5), (0, 0, 0), 64, 48, 60)])


def into_sky() -> RenderScene:
    """Nothing in view."""
    return scene([mesh(*plane())], cameras=[look_at((0, 0, 1), (0, 0, 60), 16, 12)])


def empty() -> RenderScene:
    """A mesh without faces, and no other."""
    made = into_sky()
    nothing = mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    return dataclasses.replace(made, meshes=(nothing,))


def facing(*squares: tuple[float, float]) -> RenderScene:
    """Squares across +X, each (distance, half its side), before a camera at the origin.

    It looks past their middles, or their diagonals would lie on centers of pixels.
    """
    points, faces = plane(1.0)
    meshes = [
        mesh(np.stack([np.full(4, away), half * points[:, 0], half * points[:, 1]], 1), faces)
        for away, half in squares
    ]
    return scene(meshes, cameras=[look_at((0, 0, 0), (1, 0.003, 0.002), 64, 48, 90.0)])


#: First hits are asked of each.
SEEN: dict[str, Callable[[], RenderScene]] = {
    "field": field,
    "a thousand kilometers off": lambda: field(1e6),
    "a tenth of a millimeter": lambda: field(scale=1e-5),
    "as large as a planet": lambda: field(scale=1e5),
    "many instances": lambda: field(instances=700),
    "one mesh of many faces": hills,
    "through the camera's plane": through_camera_plane,
    "ids beyond 16 bits": large_ids,
    "into the sky": into_sky,
    "empty": empty,
    # 24 bits of the usual depth between 0.01 m and 1 km are steps of 60 mm there.
    "a millimeter at a hundred meters": lambda: facing((100.001, 80), (100.0, 40), (0.01, 0.001)),
    "near": lambda: facing((1e-4, 2e-4)),
    "far": lambda: facing((1e7, 2e7)),
}
#: Width, height and K of cameras before the field.
INTRINSICS: dict[str, tuple[int, int, list[list[float]]]] = {
    "off center": (80, 60, [[75.0, 0, 35.3], [0, 47.5, 33.2], [0, 0, 1]]),
    "beside the picture": (80, 60, [[45.0, 0, 10.3], [0, 67.5, -3.2], [0, 0, 1]]),
    "upright": (45, 80, [[30.0, 0, 22.6], [0, 30.5, 40.1], [0, 0, 1]]),
    "wide": (80, 60, [[1.5, 0, 40.2], [0, 1.5, 30.1], [0, 0, 1]]),
    "narrow": (80, 60, [[15000.0, 0, 40.0], [0, 15000.0, 30.0], [0, 0, 1]]),
    "small": (3, 2, [[2.0, 0, 1.4], [0, 1.5, 1.1], [0, 0, 1]]),
    "one pixel": (1, 1, [[50.0, 0, 0.46], [0, 50.0, 0.53], [0, 0, 1]]),
    "skewed": (80, 60, [[75.0, 6.0, 35.5], [0, 47.5, 20.25], [0, 0, 1]]),
}


def varied_views() -> RenderScene:
    """The field, at each sample by another camera of ``INTRINSICS``."""
    made = field()
    cameras = [
        dataclasses.replace(made.cameras[0][0], width=width, height=height, intrinsics=np.array(k))
        for width, height, k in INTRINSICS.values()
    ]
    return at_samples(made, made.lighting * len(cameras), cameras)


def edge(shift: float) -> RenderScene:
    """A plane that ends within a column of pixels: it covers ``shift`` of column 12 of 24."""
    points = np.array([[-50.0, -50, 0], [0, -50, 0], [0, 50, 0], [-50, 50, 0]])
    view = look_at((0, 0, 10), (0, 0, 0), 24, 16)
    k = view.intrinsics.copy()
    k[0, 2] += shift
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return scene([mesh(points, faces)], cameras=[dataclasses.replace(view, intrinsics=k)])


#: Samples of ``moving``.
STEPS = 4


def moving() -> RenderScene:
    """Balls far apart under a sun: two move, one shows up at the third sample, two stay."""
    ball, faces = icosphere(2)
    path = np.zeros((STEPS, 3, 3, 4))
    for step in range(STEPS):
        turn = rotation(np.random.default_rng(step))
        path[step, 0] = affine(turn, (0.8 * step - 3.0, 4.0, 0.5 * step))
        path[step, 1] = affine(turn @ np.diag([-0.8, 0.8, 0.8]), (3.0, 4.0 + step, 1.0 - step))
        # Scaled to a point, it has no surface.
        path[step, 2] = affine(float(step == 2), (0.0, 9.0, -3.0))
    still = [affine(1.0, (-5.0, 9.0, 2.0)), affine(1.0, (6.0, 12.0, 3.0))]
    rows = [(0, still[0]), *((1, matrix) for matrix in path[0]), (0, still[1])]
    # Nearly black, or they would light each other.
    made = scene(
        [mesh(ball, faces, normals=ball), mesh(ball, faces, (1,), normals=ball)],
        [surface((0.01, 0.02, 0.03)), surface((0.03, 0.02, 0.01))],
        rows=rows,
        cameras=[look_at((0.0, -2.0, 0.0), (0.0, 6.0, 0.0), 96, 72, 60.0)],
        lights=[sun(30.0, -70.0, diameter_deg=0.1)],
        samples=STEPS,
    )
    motion = Motion(np.array([1, 2, 3], np.int32), path)
    # Bounds hold all samples.
    return dataclasses.replace(
        made,
        rows=dataclasses.replace(made.rows, motion=motion),
        bounds=np.array([[-10.0, 0.0, -10.0], [10.0, 20.0, 10.0]]),
    )


def busy() -> RenderScene:
    """A glossy ball on ground under sun and sky: noise of all kinds."""
    ball, faces = icosphere(2)
    return scene(
        [mesh(*plane(8.0)), mesh(ball, faces, (1,), normals=ball)],
        [surface((0.5, 0.4, 0.3), 0.02, 0.9), surface((0.2, 0.3, 0.4), 0.1, 0.7)],
        rows=[(0, affine()), (1, affine(1.0, (0, 0, 0.8)))],
        cameras=[look_at((0, -6, 2.5), (0, 0, 0.5), 32, 24, 50)],
        lights=[sun(40, 20, 500, 3.0), dome(40.0)],
    )


LENSES = {
    "brown_conrady": Lens("brown_conrady", (-0.22, 0.05, 1.5e-3, -2e-3, 0.0, 0.0, 0.0, 0.0)),
    "kannala_brandt": Lens("kannala_brandt", (-0.012, 0.002, -5e-4, 1e-5), np.radians(110.0)),
    "equirectangular": Lens("equirectangular", ()),
}
#: Focal length of each, pixels.
_FOCAL = {"brown_conrady": 57.6, "kannala_brandt": 24.0, "equirectangular": 48.0 / np.pi}


def inside_glow(name: str) -> RenderScene:
    """A camera with a lens in a box that gives off light of 1 everywhere."""
    view = look_at((0.3, -0.2, 1.4), (4.0, 2.0, 0.4), 96, 48 if name == "equirectangular" else 72)
    k = np.array([[_FOCAL[name], 0, 48.0], [0, _FOCAL[name], view.height / 2], [0, 0, 1.0]])
    view = dataclasses.replace(view, intrinsics=k, lens=LENSES[name])
    corners = np.array([[x, y, z] for x in (-5, 5) for y in (-5, 5) for z in (-5, 5)], float)
    faces = [
        [0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]  # fmt: skip
    glow = dataclasses.replace(surface((0.0, 0.0, 0.0)), emission=(1.0, 1.0, 1.0))
    return scene([mesh(corners, np.array(faces))], [glow], cameras=[view])
