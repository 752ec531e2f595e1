"""Surfaces of all kinds, each a small board of its own in one large scene.

Boards are flat or convex and lie far apart, so that none sends light to another; each has a sample
of its own, with its own camera and sun. So a renderer loads a scene, and compiles what it needs for
it, once for many checks.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.stage.scene import (
    Cells,
    Lighting,
    Maps,
    Mesh,
    Reflectance,
    RenderScene,
    Sun,
    Surface,
)
from scenec.backends.testing.scenes import (
    at_samples,
    dome,
    icosphere,
    look_at,
    mesh,
    plane,
    scene,
    sun,
    surface,
    with_lights,
)

#: Meters from one board to the next: a ball of 2 m fills 4e-4 of the sky there.
SPACING = 100.0
#: Where the first board lies: far from the origin, at no whole number.
ORIGIN = np.array([1003.7, -508.2, 31.4])
COLOR = (0.9, 0.8, 0.7)
#: Meters of a picture's side.
SIZE = 3.5
CELLS = Cells(2.3, 7)
FAR = (2.7, 0.6)

MARE = Reflectance("hapke", 0.254, 0.16, 1.993, 0.06, math.radians(23.657))
GRAINS = Reflectance("lommel_seeliger", 0.3, -0.2, 0.8, 0.05, 0.0)
SMOOTH = dataclasses.replace(MARE, roughness=0.0, opposition=0.5)
LAWS = {"hapke": MARE, "smooth": SMOOTH, "lommel_seeliger": GRAINS}

_RIGHT_SIDE_UP = np.eye(3)


def _low_sun() -> Sun:
    return sun(50.0, 70.0, diameter_deg=0.1)


@dataclass(frozen=True)
class Look:
    """A board.

    Attributes:
        mesh: Its layers are indices into ``surfaces``.
        surfaces: What it is made of.
        eye: Where its camera stands, from its middle.
        sun: Its light.
        linear: How it is turned, stretched and mirrored, [3, 3].
        variation: Of its row.
        fov_deg: Of its camera.
        size: Of its picture, pixels.
    """

    mesh: Mesh
    surfaces: Sequence[Surface]
    eye: Sequence[float] = (1.0, -3.0, 6.0)
    sun: Sun = field(default_factory=_low_sun)
    linear: NDArray = field(default_factory=lambda: _RIGHT_SIDE_UP)
    variation: float = 0.0
    fov_deg: float = 30.0
    size: tuple[int, int] = (24, 16)


def boards(looks: Mapping[str, Look]) -> RenderScene:
    """All of them in one scene; sample i shows the i-th."""
    surfaces: list[Surface] = []
    meshes, rows, cameras, lighting = [], [], [], []
    side = math.ceil(math.sqrt(len(looks)))
    for number, look in enumerate(looks.values()):
        middle = ORIGIN + SPACING * np.array([number % side, number // side, 0.0])
        layers = tuple(len(surfaces) + layer for layer in look.mesh.layers)
        surfaces += look.surfaces
        meshes.append(dataclasses.replace(look.mesh, layers=layers))
        rows.append((number, np.column_stack([look.linear, middle])))
        cameras.append(look_at(middle + look.eye, middle, *look.size, look.fov_deg))
        lighting.append(Lighting((look.sun,), ()))
    made = scene(
        meshes,
        surfaces,
        rows=rows,
        row_variation=[look.variation for look in looks.values()],
    )
    return at_samples(made, lighting, cameras)


def dull() -> dict[str, Look]:
    """Colors, layers, variation and normals on flat boards, without gloss or maps."""
    points, faces = plane(6.0)
    count = len(points)
    colors = [surface(color) for color in np.random.default_rng(0).uniform(0.0, 1.0, (3, 3))]
    across = (points[:, 0] + 6.0) / 12.0
    varying = mesh(points, faces, variation=np.full(count, 0.5))
    # All but black: a rasterizer may show what such normals would see of the ground.
    dark = [surface((0.01, 0.01, 0.01))]
    leaning = mesh(points, faces, normals=np.tile([-0.28, 0.0, 0.96], (count, 1)))
    wound_down = dataclasses.replace(leaning, faces=leaning.faces[:, ::-1].copy())
    sheared = np.array([[-1.0, 0.3, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.5]])
    return {
        "layers": Look(mesh(points, faces, (0, 1, 2), _two_merges(count)), colors),
        "blend": Look(
            mesh(points, faces, (0, 1), across[None]), [surface((0, 0, 0)), surface((1, 1, 1))]
        ),
        "variation": Look(varying, [surface((0.4, 0.2, 0.1), variation=0.3)], variation=-0.8),
        "clipped": Look(varying, [surface((0.4, 0.2, 0.9), variation=0.3)], variation=1.0),
        "vertex colors": Look(
            # The same at each vertex: a rasterizer may shade neighbors as one.
            dataclasses.replace(mesh(points, faces), color=_vertex_colors(len(points))[faces]),
            [surface((0.9, 0.6, 0.4))],
        ),
        "back": Look(mesh(points, faces[:, ::-1]), [surface()]),
        "mirrored normals": Look(leaning, dark, sun=_high_sun(), linear=sheared),
        "normals wound down": Look(wound_down, dark, sun=_high_sun(), linear=sheared),
        "no material": Look(dataclasses.replace(mesh(points, faces), layers=()), []),
    }


def glossy() -> dict[str, Look]:
    """Gloss, metal, their layers and varied roughness on flat boards, without maps."""
    points, faces = plane(6.0)
    count = len(points)
    flat = mesh(points, faces)
    copper = Surface("", (0.9, 0.5, 0.1), 0.4, 0.7, 0.0)
    stacked = [
        Surface("", (0.5, 0.3, 0.2), 0.2, 0.9, 0.0),
        Surface("", (0.1, 0.2, 0.6), 0.5, 0.6, 0.0, 0.3),
        Surface("", (0.7, 0.7, 0.1), 0.1, 0.6, 0.0),
    ]
    rough = Surface("", (0.5, 0.3, 0.1), 0.4, 0.5, 0.0, 0.3, None, 0.8)
    varied = [
        rough,
        dataclasses.replace(rough, roughness_variation=-0.5),
        dataclasses.replace(rough, base_color=(0.1, 0.2, 0.7), specular=0.1),
    ]
    ramp = Surface("", (1.0, 1.0, 1.0), 0.0, 0.6, 0.0, 1.0, None, 0.7)
    low = sun(20.0, 70.0, diameter_deg=0.1)
    over_all = _two_merges(count)

    def varying(value: NDArray | float) -> Mesh:
        return mesh(points, faces, variation=np.broadcast_to(value, count))

    return {
        "steep": Look(flat, [copper], (0.0, -10.0, 10.0), fov_deg=0.5),
        "grazing": Look(flat, [copper], (0.0, -10.0, 3.0), low, fov_deg=0.5),
        "half metal": Look(
            flat, [dataclasses.replace(copper, metallic=0.6)], (0.0, -10.0, 10.0), fov_deg=0.5
        ),
        "metal": Look(
            flat, [Surface("", (0.8, 0.5, 0.2), 0.3, 0.6, 0.0, 1.0)], (2.0, -1.0, 6.0), _high_sun()
        ),
        # Colors of each vertex, and one weight for all.
        "varied metal": Look(
            varying(0.5), [Surface("", (0.4, 0.2, 0.1), 0.1, 0.9, 0.4, 0.5)], variation=0.5
        ),
        "layers": Look(mesh(points, faces, (0, 1, 2), over_all), stacked),
        "roughness between vertices": Look(varying(points[:, 0] / 6.0), [ramp], sun=_high_sun()),
        "rough layers": Look(
            mesh(points, faces, (0, 1, 2), over_all, np.full(count, 0.6)), varied, variation=0.25
        ),
        # Beyond both ends of roughness.
        "roughest": Look(varying(0.9), [rough], variation=0.9),
        "smoothest": Look(varying(-1.0), [dataclasses.replace(rough, roughness_variation=1.0)]),
    }


def mapped(folder: Path) -> dict[str, Look]:
    """Maps from above, in cells, of two scales, mixed by heights; of ``write_pictures``."""
    points, faces = plane(6.0)
    flat, high = mesh(points, faces), _high_sun()
    varying = mesh(points, faces, variation=points[:, 0] / 6.0)
    # A slope, so that tangents lie along no axis.
    leaning = mesh(points + np.outer(points[:, :2] @ [0.3, -0.2], [0.0, 0.0, 1.0]), faces)
    color, height, normal = (_picture(folder, kind) for kind in ("base_color", "height", "normal"))
    colors, normals = Maps(SIZE, base_color=color), Maps(SIZE, normal=normal)
    numbers = Maps(3.0, roughness=folder / "rough.png", metallic=folder / "metal.png")
    tinted = Surface("", COLOR, 0.3, 0.5, 0.0, 0.3, colors, 0.8)
    # Weights that cross triangles show any product taken at vertices.
    crossing = np.stack([(points[:, 0] + 6.0) / 12.0, np.full(len(points), 0.3)])
    half = np.full(len(points), 0.5)
    metals = [
        surface((0.2, 0.5, 0.1), 0.4, 0.3),
        Surface("", (0.7, 0.2, 0.1), 0.0, 0.5, 0.0, 0.5),
    ]
    mound, weights = hill()
    merged = dataclasses.replace(mound, layers=(0, 1, 2), weights=weights)
    # A merge that heeds heights, and one above it that does so too, or does not.
    heeding, first_alone = (
        dataclasses.replace(merged, height_blends=blends) for blends in ((0.25, 0.6), (0.3, 0.0))
    )
    tall = dataclasses.replace(colors, height=height, cells=CELLS)
    glow = dataclasses.replace(colors, emission=_picture(folder, "emission"), cells=CELLS)
    upper = [
        dataclasses.replace(_dull(Maps(2.0, height=_picture(folder, "height", 6))),
                            base_color=(0.1, 0.2, 0.4)),
        surface((0.6, 0.1, 0.1)),
    ]  # fmt: skip
    bright = dataclasses.replace(_dull(glow), emission=(30.0, 300.0, 3000.0))
    looks = {
        "color": Look(flat, [_dull(colors)]),
        "color on gloss that varies": Look(varying, [tinted], variation=0.25),
        "roughness and metal": Look(
            flat, [Surface("", (0.9, 0.5, 0.1), 0.4, 0.1, 0.0, 0.9, numbers)],
            (0.0, -10.0, 4.0), fov_deg=10.0,
        ),
        "map below gloss and metal": Look(
            mesh(points, faces, (0, 1, 2), crossing, half), [tinted, *metals]
        ),
        "normals": Look(flat, [_dull(normals)], sun=high),
        "normals flipped": Look(
            flat, [_dull(dataclasses.replace(normals, flip_green=True))], sun=high
        ),
        "normals on a slope": Look(leaning, [_dull(normals)], sun=high),
        "normals on a mirrored slope": Look(
            leaning, [_dull(normals)], sun=high, linear=np.diag([-1.0, 1.0, 1.0])
        ),
        "normals in cells": Look(
            mound, [_dull(dataclasses.replace(normals, cells=CELLS))], sun=high
        ),
        "heights": Look(heeding, [_dull(tall), *upper]),
        "emission": Look(first_alone, [bright, *upper]),
    }  # fmt: skip
    for name, described in {
        "cells": dataclasses.replace(colors, cells=CELLS),
        "far": dataclasses.replace(colors, far=FAR),
        "cells and far": dataclasses.replace(colors, cells=CELLS, far=FAR),
    }.items():
        looks[name] = Look(mound, [_dull(described)])
    rough = _dull(dataclasses.replace(normals, lean=0.35))
    by_law = dataclasses.replace(rough, reflectance=MARE, specular=0.1)
    for name, own, azimuth in (
        ("facets against the sun", rough, 180.0),
        ("facets before the sun", rough, 15.0),
        ("facets beside the sun", rough, 260.0),
        ("facets of a law", by_law, 140.0),
    ):
        # The viewer stands in the north. Low, but each texel is lit.
        light = sun(30.0, azimuth, diameter_deg=0.1)
        looks[name] = Look(leaning, [own], (0.0, 8.0, 5.0), light, fov_deg=10.0)
    return looks


def facets_under_sky(folder: Path) -> RenderScene:
    """A level plane whose map of normals is level, and stands for a relief all the same."""
    level = Maps(SIZE, normal=folder / "level.png", lean=0.35)
    return _under_sky([_dull(level)], (6.0, 0.0, 3.0))


def projected(folder: Path) -> dict[str, Look]:
    """Maps on balls and a sheet, by each projection; of ``write_pictures``."""
    color, normal = (_picture(folder, kind) for kind in ("base_color", "normal"))
    flipped = _picture(folder, "normal", flipped=True)
    looks = {}
    for posed in ("plain", "stretched", "mirrored"):
        # Renderers interpolate normals that a row stretches each in their own way.
        smooth = posed != "stretched"
        for kind, described in (
            ("color", Maps(SIZE, base_color=color, projection="triplanar")),
            ("normals", Maps(SIZE, normal=normal, projection="triplanar")),
        ):
            looks[f"triplanar {kind}, {posed}"] = _ball(ball(smooth), described, posed)
    for kind, posed, coordinates, green in (
        ("color", "plain", "smooth", False),
        ("color", "mirrored", "islands", False),
        ("normals", "plain", "smooth", False),
        ("normals", "plain", "islands", True),
        ("normals", "stretched", "islands", False),
        ("normals", "mirrored", "islands", True),
    ):
        if kind == "color":
            described = Maps(SIZE, base_color=color, projection="uv")
        else:
            file = flipped if green else normal
            described = Maps(SIZE, normal=file, flip_green=green, projection="uv")
        looks[f"uv {kind}, {posed}, {coordinates}"] = _ball(
            ball(posed != "stretched", coordinates), described, posed
        )
    points, faces = plane(2.0, cells=2)
    uv = (points[faces][..., :2] * 0.2 + 0.1).astype(np.float32)
    sheet = dataclasses.replace(mesh(points, faces), uv=uv)
    lean = math.radians(35.0)
    tilt = np.array(
        [[1, 0, 0], [0, math.cos(lean), -math.sin(lean)], [0, math.sin(lean), math.cos(lean)]]
    )
    for projection in ("triplanar", "uv"):
        behind = Maps(SIZE, normal=normal, projection=projection)
        looks[f"{projection} normals from behind"] = Look(
            sheet, [_dull(behind)], (1.0, 1.0, -7.0), sun(-60.0, 20.0, diameter_deg=0.1), tilt
        )
        numbers = Maps(
            1.0,
            roughness=folder / "rough.png",
            metallic=folder / "all_metal.png",
            projection=projection,
        )
        copper = Surface("", (0.8, 0.5, 0.2), 0.3, 0.1, 0.0, 0.0, numbers)
        looks[f"{projection} roughness and metal"] = Look(
            ball(True, "smooth"), [copper], (5.0, -6.0, 4.0), _side_sun(), size=(48, 36)
        )
    looks["layers of three projections"] = _three_projections(color)
    return looks


def sheets(folder: Path) -> dict[str, Look]:
    """Thin sheets, lit from behind and from before; of ``write_pictures``."""
    points, faces = plane(6.0)
    count = len(points)
    flat, behind = mesh(points, faces), sun(-50.0, 70.0, diameter_deg=0.1)
    leaf = dataclasses.replace(surface((0.4, 0.7, 0.2)), diffuse_transmission=0.4)
    varied = dataclasses.replace(leaf, variation=0.3)
    waxed = dataclasses.replace(leaf, specular=0.3)
    normals = np.tile([-0.28, 0.0, 0.96], (count, 1))
    colors = Maps(SIZE, base_color=_picture(folder, "base_color"))
    over = mesh(points, faces, (0, 1, 2), _two_merges(count))
    return {
        "from behind": Look(flat, [leaf], sun=behind),
        "from before": Look(flat, [leaf]),
        "its back": Look(mesh(points, faces[:, ::-1]), [leaf], sun=behind),
        "all of it": Look(
            flat, [dataclasses.replace(leaf, diffuse_transmission=1.0)], sun=behind
        ),
        "leaning normals": Look(mesh(points, faces, normals=normals), [leaf], sun=behind),
        "variation": Look(
            mesh(points, faces, variation=np.full(count, 0.5)), [varied], sun=behind,
            variation=-0.8,
        ),
        "gloss behind": Look(flat, [waxed], sun=behind),
        "gloss before": Look(flat, [waxed]),
        "layers": Look(over, [leaf, surface(), waxed], sun=behind),
        "layers before": Look(over, [surface(), waxed, leaf]),
        "map": Look(flat, [dataclasses.replace(leaf, maps=colors)], sun=behind),
    }  # fmt: skip


def planetary() -> dict[str, Look]:
    """Laws of reflectance on a leaning plane, from all around; layers of several."""
    normal = np.array([0.2, -0.1, 1.0]) / math.sqrt(1.05)
    points, faces = plane(2.0)
    points[:, 2] = -(points[:, :2] @ normal[:2]) / normal[2]
    flat = mesh(points, faces)
    several = mesh(points, faces, (0, 1, 2), _two_merges(len(points)))
    # A hair of variation, so that colors are looked up and not known beforehand.
    varied = mesh(points, faces, variation=np.full(len(points), 1e-4))
    looks = {}

    def add(name: str, one: Mesh, surfaces: list[Surface], view: str) -> None:
        elevation, azimuth, eye = _VIEWS[view]
        light = sun(elevation, azimuth)
        if isinstance(eye, float):
            # So many degrees beside the sun.
            turn = math.radians(eye)
            aside = np.cross(light.to_light, [0.0, 0.0, 1.0])
            aside /= np.linalg.norm(aside)
            eye = tuple(8.0 * (math.cos(turn) * light.to_light + math.sin(turn) * aside))
        looks[f"{name}, {view}"] = Look(one, surfaces, eye, light, fov_deg=0.1, size=(8, 8))

    for name, law in LAWS.items():
        for seen in _VIEWS:
            add(name, flat, [law_surface(law)], seen)
    add("varied", varied, [dataclasses.replace(law_surface(MARE), variation=1.0)], "ahead")
    mixed = [law_surface(MARE), surface((0.4, 0.2, 0.1)), law_surface(GRAINS, (0.2, 0.2, 0.2))]
    add("layers", several, mixed, "ahead")
    glossy = dataclasses.replace(law_surface(MARE), specular=0.2, roughness=0.7)
    add("gloss", flat, [glossy], "ahead")
    return looks


#: Sun's elevation and azimuth; the camera: degrees beside the sun, or where it stands.
_VIEWS: dict[str, tuple[float, float, float | tuple[float, ...]]] = {
    "sun behind": (30.0, 10.0, 0.0),
    "sun ten degrees off": (30.0, 10.0, 10.0),
    "ahead": (40.0, 200.0, (6.0, 2.0, 3.0)),
    "grazing": (8.0, 70.0, (-3.0, 5.0, 3.0)),
}


def law_surface(
    law: Reflectance, color: tuple[float, float, float] = (0.063, 0.3, 0.85)
) -> Surface:
    """A material of a law."""
    return dataclasses.replace(surface(color), reflectance=law)


#: Radiance of the sky over laws and metals.
SKY = 10.0
#: Roughness of metals under it: as smooth as there is, and up.
METALS = {"mirror": 0.0, "polished": 0.3, "dull": 0.6, "rough": 1.0}


def laws_under_sky() -> RenderScene:
    """Planes of each law."""
    return _under_sky([law_surface(law) for law in LAWS.values()], (4.0, 0.0, 5.0))


def metals_under_sky() -> RenderScene:
    """Planes of metals."""
    metals = [Surface("", (0.8, 0.6, 0.4), 0.0, rough, 0.0, 1.0) for rough in METALS.values()]
    return _under_sky(metals, (0.0, -10.0, 10.0))


def _under_sky(surfaces: list[Surface], eye: tuple[float, float, float]) -> RenderScene:
    points, faces = plane(20.0)
    found = {
        str(number): Look(mesh(points, faces), [own], eye, fov_deg=0.1, size=(16, 16))
        for number, own in enumerate(surfaces)
    }
    return with_lights(boards(found), [dome(SKY)])


def cosine(scene: RenderScene) -> float:
    """Between the normal of these planes and the way to their viewers."""
    return float(-scene.cameras[0][0].camera_to_world[2, 2])


def hill() -> tuple[Mesh, NDArray[np.float32]]:
    """A smooth convex mound, which no light leaves for itself, and weights of two merges on it."""
    points, faces = plane(6.0, cells=8)
    x, y = points[:, 0], points[:, 1]
    points[:, 2] = -0.01 * (x * x + 0.7 * y * y)
    normals = np.stack([0.02 * x, 0.014 * y, np.ones_like(x)], axis=1)
    normals /= np.sqrt((normals**2).sum(axis=1, keepdims=True))
    weights = np.stack([np.clip(0.5 + 0.2 * x, 0, 1), np.clip(0.3 - 0.2 * y, 0, 1)])
    return mesh(points, faces, normals=normals), weights.astype(np.float32)


def ball(smooth: bool, uv: str | None = None) -> Mesh:
    """A ball of radius 2: "smooth" coordinates over space, or "islands" of their own on each face.

    Every other island is a mirrored one.
    """
    points, faces = icosphere(2 if smooth and uv is None else 1)
    points = 2.0 * points
    made = mesh(points, faces, normals=points / 2.0 if smooth else None)
    if uv is None:
        return made
    corners = points[faces]
    if uv == "smooth":
        found = smooth_coordinates(corners)
    else:
        rng = np.random.default_rng(2)
        shape = np.array([[0.0, 0.0], [0.3, 0.05], [0.1, 0.25]])
        found = shape + rng.uniform(0.0, 5.0, (len(faces), 1, 2))
        found[::2, :, 0] *= -1.0
    return dataclasses.replace(made, uv=found.astype(np.float32))


def smooth_coordinates(points: NDArray) -> NDArray[np.float64]:
    """Texture coordinates of a ball's points, [..., 2]."""
    result: NDArray[np.float64] = (
        points[..., :2] * 0.21 + points[..., 2:] * np.array([0.1, 0.07]) + 0.3
    )
    return result


def write_pictures(folder: Path) -> None:
    """All that boards show, small, and of one size: a renderer may bring a scene's to one."""
    for kind in ("base_color", "emission", "height", "normal"):
        write_picture(folder, kind)
    write_picture(folder, "height", seed=6)
    write_picture(folder, "normal", flipped=True)
    level = np.full((5, 5, 3), (128, 128, 255), np.uint8)
    Image.fromarray(level).save(folder / "level.png")
    for name, value in (("rough", 0.6), ("metal", 0.2), ("all_metal", 1.0)):
        values = np.full((5, 5), round(255 * value), np.uint8)
        Image.fromarray(values).save(folder / f"{name}.png")


def write_picture(folder: Path, kind: str, seed: int = 11, flipped: bool = False) -> Path:
    """A picture without symmetry: colors, numbers, or normals that lean by up to 35 degrees.

    Args:
        folder: Where it goes.
        kind: Of map.
        seed: Of its texels.
        flipped: Whether normals have y along -v.
    """
    rng = np.random.default_rng(seed)
    if kind == "normal":
        tilt = rng.uniform(-0.4, 0.4, (5, 5, 2))
        normal = np.concatenate([tilt, np.sqrt(1 - (tilt**2).sum(-1, keepdims=True))], axis=-1)
        normal[..., 1] *= -1.0 if flipped else 1.0
        texels = np.rint((normal + 1.0) / 2.0 * 255.0)
    else:
        texels = rng.integers(60, 200, (5, 5) if kind == "height" else (5, 5, 3))
    file = _picture(folder, kind, seed, flipped)
    Image.fromarray(texels.astype(np.uint8)).save(file)
    return file


def _picture(folder: Path, kind: str, seed: int = 11, flipped: bool = False) -> Path:
    return folder / f"{kind}_{seed}{'_flipped' if flipped else ''}.png"


def _vertex_colors(count: int) -> NDArray[np.float32]:
    return np.random.default_rng(4).uniform(0.2, 1.0, (count, 3)).astype(np.float32)


def _two_merges(count: int) -> NDArray:
    """Weights of two merges, the same at all vertices."""
    return np.repeat(np.array([[0.4], [0.3]]), count, axis=1)


def _high_sun() -> Sun:
    return sun(60.0, 30.0, diameter_deg=0.1)


def _dull(maps: Maps) -> Surface:
    return Surface("", COLOR, 0.0, 0.5, 0.0, 0.0, maps)


def _side_sun() -> Sun:
    return sun(40.0, -20.0, diameter_deg=0.1)


def _ball(mesh: Mesh, described: Maps, posed: str) -> Look:
    linear = np.eye(3)
    if posed != "plain":
        turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        scales = {"stretched": [1.1, 0.8, 0.95], "mirrored": [0.9, 0.9, -0.9]}[posed]
        linear = turn @ np.diag(scales)
    return Look(
        mesh, [_dull(described)], (5.0, -6.0, 4.0), _side_sun(), linear,
        fov_deg=32.0, size=(48, 36),
    )  # fmt: skip


def _three_projections(color: Path) -> Look:
    points, faces = plane(4.0)
    weights = np.array([[0.5] * len(points), [0.25] * len(points)])
    uv = (points[faces][..., 1::-1] * 0.13).astype(np.float32)
    made = dataclasses.replace(mesh(points, faces, (0, 1, 2), weights), uv=uv)
    surfaces = [
        _dull(Maps(size, base_color=color, projection=name))
        for name, size in (("above", 5.0), ("triplanar", 6.0), ("uv", 1.0))
    ]
    return Look(made, surfaces, (0.0, -0.1, 6.0), sun(90.0, diameter_deg=0.1))
