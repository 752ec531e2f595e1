"""Scenes of light: what falls on a plane, into a bowl, past an edge; with closed forms."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.contract import BOUNCES
from scenec.backends.picture.sky import combine, lookup
from scenec.backends.stage.scene import Dome, Gobo, Lamp, Lighting, Maps, RenderScene, Sun
from scenec.backends.testing.scenes import (
    affine,
    at_samples,
    dome,
    icosphere,
    lighting_of,
    look_at,
    mesh,
    plane,
    rotation,
    scene,
    sun,
    surface,
    write_latlong,
)

ABOVE = look_at((0, 0, 10), (0, 0, 0), 24, 16)
ALBEDO = 0.5


# A plane under suns and an even sky

_COLORED = dataclasses.replace(sun(90.0), irradiance=np.array([10.0, 400.0, 0.0]))
#: The light over a gray plane.
OVER_PLANE: dict[str, Sequence[Sun | Dome]] = {
    "sun in the zenith": [sun(90.0)],
    "high sun": [sun(40.0, 20.0)],
    "low sun": [sun(8.0)],
    "grazing sun": [sun(4.0, 70.0)],
    "point sun": [sun(35.0, 100.0, diameter_deg=0.0)],
    # Irradiance over a disc that is up as a whole is exactly that of its middle.
    "wide sun": [sun(35.0, diameter_deg=10.0)],
    "colored sun": [_COLORED],
    "sky": [dome(20.0)],
    "suns and sky": [sun(50, 0, 400, 5), sun(30, 80, 600, 1), dome(20.0)],
    "dark": [],
}


def plane_scene() -> RenderScene:
    """A gray plane of several faces, at each sample in another of these lights."""
    made = scene([mesh(*plane(cells=4))], [surface((ALBEDO,) * 3)])
    return at_samples(made, [lighting_of(around) for around in OVER_PLANE.values()], ABOVE)


def plane_radiance(case: str) -> NDArray[np.float64]:
    """Lambert's law: albedo / pi of what falls on the plane, [3]."""
    falls = np.zeros(3)
    for light in OVER_PLANE[case]:
        if isinstance(light, Sun):
            falls += light.irradiance * light.to_light[2]
        else:
            falls += np.pi * light.scale
    return ALBEDO / np.pi * falls


# Cavities


def white_ball() -> RenderScene:
    """A white ball that fills the view, in an even sky of 3."""
    return scene(
        [mesh(*icosphere(2))],
        [surface((1.0, 1.0, 1.0))],
        cameras=[look_at((0, -1.7, 0), (0, 0, 0), 24, 24, 40)],
        lights=[dome(3.0)],
    )


def white_sheet() -> RenderScene:
    """A white sheet that stands upright and fills the view, in an even sky of 3."""
    points, faces = plane(6.0)
    return scene(
        [mesh(points[:, [2, 0, 1]], faces)],
        [dataclasses.replace(surface((1.0, 1.0, 1.0)), diffuse_transmission=0.35)],
        cameras=[look_at((2.0, 0.3, 0.2), (0, 0, 0), 24, 24, 40)],
        lights=[dome(3.0)],
    )


#: Share of a sphere's area that is open in ``bowl``: a cap of 60 degrees.
OPEN = 0.25


def bowl() -> RenderScene:
    """A white sphere with an opening towards an even sky of 1, looked into."""
    rings, around = 49, 96
    angles = np.linspace(np.pi / 3.0, np.pi, rings)
    t, p = np.meshgrid(angles, np.arange(around) * (2.0 * np.pi / around), indexing="ij")
    points = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
    here = np.arange(rings * around).reshape(rings, around)
    beside = np.roll(here, -1, axis=1)
    upper = np.stack([here[:-1], beside[:-1], beside[1:]], axis=-1)
    # At the pole these would have no area.
    lower = np.stack([here[:-2], beside[1:-1], here[1:-1]], axis=-1)
    faces = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    return scene(
        [mesh(points.reshape(-1, 3), faces)],
        [surface((1.0, 1.0, 1.0))],
        cameras=[look_at((0, 0, 3.0), (0, 0, -1.0), 48, 48, 12)],
        lights=[dome(1.0)],
    )


def bowl_radiance() -> float:
    """Returns the radiance in a bowl: two points of a sphere see each other equally anywhere.

    So a point gets ``OPEN`` of the sky and 1 - OPEN of what the walls give: after k surfaces
    OPEN (1 - OPEN)^(k - 1), summed up to the surface that is seen and those between it and the sky.
    """
    return 1.0 - (1.0 - OPEN) ** (BOUNCES + 1)


# Skies

#: Where small squares look.
FACING = {"+x": (0, 1), "-x": (0, -1), "+y": (1, 1), "-y": (1, -1), "+z": (2, 1), "-z": (2, -1)}


def squares_under_sky(folder: Path) -> RenderScene:
    """Far apart, each seen from its front at its own sample; a turned sky with bright spots."""
    values = np.random.default_rng(5).uniform(0.0, 4.0, (8, 16, 3))
    values[2, 3] = values[5, 12, 1] = 20.0
    file = write_latlong(folder / "sky.exr", values)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    sky = Dome(file, np.array([1.0, 2.0, 0.5]), turn * np.sign(np.linalg.det(turn)))
    quad, faces = plane(2.0)
    rows, cameras = [], []
    for number, (axis, side) in enumerate(FACING.values()):
        middle = np.array([300.0 * number, 0.0, 0.0])
        normal = np.zeros(3)
        normal[axis] = side
        # Two axes of the square, and the third to its front.
        first = np.roll(normal * side, 1)
        linear = np.stack([first, np.cross(normal, first), normal], axis=1)
        rows.append((0, affine(linear, middle)))
        cameras.append(look_at(middle + 10.0 * normal, middle, 16, 12, 12))
    made = scene([mesh(quad, faces)], [surface((ALBEDO,) * 3)], rows=rows)
    return at_samples(made, [lighting_of([sky])] * len(rows), cameras)


def under_sky(scene: RenderScene, case: str) -> NDArray[np.float64]:
    """Albedo / pi of the integral of radiance times cosine, by the midpoint rule, [3]."""
    sky = combine(scene.lighting[0].domes)
    assert sky is not None
    theta = (np.arange(360) + 0.5) * (np.pi / 360)
    phi = (np.arange(720) + 0.5) * (2 * np.pi / 720)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    w = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    axis, side = FACING[case]
    weight = np.maximum(side * w[:, axis], 0.0) * np.sin(t).ravel() * (np.pi / 360) ** 2
    total: NDArray[np.float64] = (lookup(sky, w).astype(float) * weight[:, None]).sum(axis=0)
    return ALBEDO / np.pi * total


# Pictures that suns shine through

#: Suns, and width and height of the picture before the first, meters.
GOBOS: dict[str, tuple[Sequence[Sun | Dome], tuple[float, float]]] = {
    "overhead": ([sun(90.0)], (6.0, 4.0)),
    "high": ([sun(50.0, 30.0)], (6.0, 4.0)),
    "low": ([sun(15.0, 200.0)], (6.0, 1.5)),
    # What is seen lies beyond its borders, too.
    "mirrored": ([sun(60.0, 110.0)], (1.7, 1.3)),
    "beside a sun and a sky": ([sun(50.0, 30.0), sun(30.0, 80.0, 600.0, 1.0), dome(20.0)], (6, 4)),
}


def gobo_scene(folder: Path) -> RenderScene:
    """A gray pyramid, each of whose places sees all of the sky, under a sun with a picture."""
    from PIL import Image

    codes = np.random.default_rng(8).integers(0, 65536, (10, 16)).astype(np.uint16)
    file = folder / "gobo.png"
    Image.fromarray(codes).save(file)
    points = np.array([[-3.0, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0], [0.4, 0.3, 1.6]])
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    made = scene([mesh(points, faces)], [surface((ALBEDO,) * 3)])
    lighting = []
    for around, (width, height) in GOBOS.values():
        first = around[0]
        assert isinstance(first, Sun)
        z = first.to_light
        x = np.cross([0.0, 0.0, 1.0] if z[2] < 0.9 else [0.0, 1.0, 0.0], z)
        x /= np.sqrt((x * x).sum())
        rows = np.stack([x / width, -np.cross(z, x) / height])
        gobo = Gobo(file, np.column_stack([rows, [0.45, 0.6]]))
        lighting.append(lighting_of([dataclasses.replace(first, gobo=gobo), *around[1:]]))
    return at_samples(made, lighting, look_at((0, 0, 10), (0, 0, 0), 48, 32, 25.0))


# Shadows


def shadow_scene(lighting: Mapping[str, Lighting]) -> RenderScene:
    """A black square over a plane, and a black wall out of view, at each sample in other light."""
    square, faces = plane(0.5)
    wall = np.array([[-8.0, -30, 0], [-8, 30, 0], [-8, 30, 5], [-8, -30, 5]])
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    made = scene(
        [mesh(*plane()), mesh(square, faces, (1,)), mesh(wall, quad, (1,))],
        [surface((0.05, 0.05, 0.05)), surface((0.0, 0.0, 0.0))],
        rows=[(0, affine()), (1, affine(1.0, (0.0, 0.0, 1.5))), (2, affine())],
    )
    view = look_at((0, 0, 10), (0, 0, 0), 48, 32, 25.0)
    return at_samples(made, list(lighting.values()), view)


#: Ways to wrap a picture of opacity, along u and v.
CUTOUTS = {
    "repeated": ("repeat", "repeat"),
    "clamped, mirrored": ("clamp", "mirror"),
    "mirrored, clamped": ("mirror", "clamp"),
}


def cutout_scene(folder: Path) -> RenderScene:
    """At each sample two cards, one above the other, over ground of their own: parts are cut out.

    Args:
        folder: Receives the picture of opacity.
    """
    file = folder / "opacity.png"
    texels = np.random.default_rng(5).integers(0, 256, (5, 6))
    Image.fromarray(texels.astype(np.uint8)).save(file)
    square, faces = plane(1.0)
    # Over more than the picture on each side of it, and no square.
    uv = (square[faces][..., :2] * [1.4, 1.1] + [0.55, 0.4]).astype(np.float32)
    # Dark: what they send each other is no light of the reference.
    surfaces = [surface((0.01, 0.01, 0.01))]
    meshes, rows, cameras, lighting = [mesh(*plane(5.0))], [], [], []
    for number, wrap in enumerate(CUTOUTS.values()):
        middle = np.array([100.0 * number + 3.3, -7.1, 2.4])
        maps = Maps(1.0, projection="uv", opacity=file, opacity_threshold=0.5, opacity_wrap=wrap)
        surfaces.append(dataclasses.replace(surface((0.02, 0.01, 0.005)), maps=maps))
        meshes.append(dataclasses.replace(mesh(square, faces, (number + 1,)), uv=uv))
        turn = rotation(np.random.default_rng(number))
        rows.append((0, affine(1.0, middle)))
        x, y, z = middle.tolist()
        rows += [(number + 1, affine(turn, (x, y, z + height))) for height in (1.5, 2.5)]
        cameras.append(look_at((x + 1.0, y - 4.0, z + 6.0), (x, y, z + 1.0), 64, 48, 40.0))
        lighting.append(Lighting((sun(50.0, 70.0, diameter_deg=0.1),), ()))
    return at_samples(scene(meshes, surfaces, rows=rows), lighting, cameras)


def edge_scene() -> RenderScene:
    """A black edge halfway between a white plane and a lamp of radius 0.2, from below the edge."""
    points = np.array([[0.0, -5, 0], [5, -5, 0], [5, 5, 0], [0, 5, 0]])
    made = scene(
        [mesh(*plane()), mesh(points, np.array([[0, 1, 2], [0, 2, 3]]), (1,))],
        [surface((1.0, 1.0, 1.0)), surface((0.0, 0.0, 0.0))],
        rows=[(0, affine()), (1, affine(1.0, (0.0, 0.0, 1.5)))],
    )
    view = look_at((0.0, 0.0, 1.0), (0, 0, 0), 32, 8, 40.0)
    return at_samples(made, [only_lamps(lamp(radius_m=0.2))], view)


def edge_shadow() -> NDArray[np.float64]:
    """The lamp's light on the plane times the share of its disc that the edge leaves, [8, 32, 3].

    From a point x beside the edge's foot the edge covers the disc up to -x: of a unit disc cut at
    s, (acos s - s sqrt(1 - s^2)) / pi is left.
    """
    steps = (np.arange(32 * 8) + 0.5) / 8
    focal = 16.0 / np.tan(np.radians(20.0))
    x = (steps - 16.0) / focal
    y = ((np.arange(8 * 8) + 0.5) / 8 - 4.0) / focal
    s = np.clip(x / 0.2, -1.0, 1.0)
    share = (np.arccos(s) - s * np.sqrt(1.0 - s * s)) / np.pi
    squared = x[None, :] ** 2 + y[:, None] ** 2 + 9.0
    light = 3.0 / squared**1.5 / np.pi * share[None, :]
    mean = light.reshape(8, 8, 32, 8).mean(axis=(1, 3))
    return mean[..., None] * np.array([60.0, 30.0, 10.0])


# Lamps


def lamp(
    position: Sequence[float] = (0.0, 0.0, 3.0),
    axis: Sequence[float] = (0.0, 0.0, -1.0),
    intensity: Sequence[float] = (60.0, 30.0, 10.0),
    radius_m: float = 0.0,
    cone_deg: float = 180.0,
    softness: float = 0.0,
) -> Lamp:
    """A lamp; its cone is half the opening angle."""
    way = np.array(axis, float)
    return Lamp(
        np.array(position, float),
        way / np.sqrt((way * way).sum()),
        np.array(intensity, float),
        radius_m,
        float(np.radians(cone_deg)),
        softness,
    )


def _tilted(angle_deg: float) -> Lamp:
    t = np.radians(angle_deg)
    return lamp(axis=(np.sin(t), 0.0, -np.cos(t)), cone_deg=30.0, softness=0.6)


def only_lamps(*lamps: Lamp) -> Lighting:
    """Light without suns and sky."""
    return Lighting((), (), lamps)


#: Even sky beside some lamps.
SKY = 0.5
LAMPS: dict[str, Lighting] = {
    "point": only_lamps(lamp()),
    # A sphere of uniform radiance gives what a point does: E = L pi (r / d)^2 cos = I cos / d^2.
    "sphere": only_lamps(lamp(radius_m=0.5)),
    "hard cone": only_lamps(lamp(cone_deg=40.0)),
    "soft cone": only_lamps(lamp(cone_deg=35.0, softness=0.5, radius_m=0.02)),
    "leaning": only_lamps(lamp(axis=(1.0, 0.5, -2.0), cone_deg=60.0, softness=1.0)),
    "level": Lighting((), (), (lamp((-2, 0, 2), (1.0, 0.0, -0.3), cone_deg=85.0, softness=0.7),)),
    "more than half": only_lamps(lamp(axis=(0.5, 0.2, 0.3), cone_deg=130.0, softness=0.6)),
    "all soft": only_lamps(lamp((1.0, -1.0, 1.0), softness=1.0)),
    **{
        f"{angle} degrees off a cone's axis": only_lamps(_tilted(angle))
        for angle in (0, 14, 20, 26, 29, 31)
    },
    "with suns and sky": Lighting(
        (sun(50.0, 0.0, 3.0, 1.0), sun(20.0, 90.0, 2.0, 1.9)),
        (dome(SKY),),
        (
            lamp(cone_deg=40.0, softness=0.5),
            lamp((2.0, 1.0, 1.5), (-1.0, 0.0, -1.0), (5.0, 5.0, 20.0), 0.1, 60.0, 0.3),
            lamp((-2.0, -1.0, 4.0), intensity=(100.0, 5.0, 20.0), cone_deg=20.0, softness=1.0),
        ),
    ),
    "many": Lighting(
        (),
        (),
        tuple(
            lamp((x, y, 2.0), intensity=(3.0, 2.0, 1.0), cone_deg=50.0, softness=0.5)
            for x in (-2.0, -1.0, 0.0, 1.0, 2.0)
            for y in (-1.0, -0.3, 0.3, 1.0)
        ),
    ),
}
#: Their light is finite, whatever it is.
ODD_LAMPS: dict[str, Lighting] = {
    name: only_lamps(one)
    for name, one in {
        "bright": lamp(intensity=(1e12, 1e12, 1e12)),
        "narrow": lamp(cone_deg=1e-3),
        "narrow and soft": lamp(cone_deg=1e-3, softness=1.0),
        "huge": lamp(radius_m=1000.0),
        "tiny": lamp(radius_m=1e-30),
        "on the ground": lamp((0.0, 0.0, 0.0)),
        "far": lamp((0.0, 0.0, 1e9)),
        "faint": lamp(intensity=(0.0, 0.0, 1e-30)),
        "below": lamp((0.0, 0.0, -3.0)),
    }.items()
}
SUN_SHADOWS: dict[str, Lighting] = {
    "square": Lighting((sun(45.0, 45.0, diameter_deg=0.0),), ()),
    "wall out of view": Lighting((sun(30.0, 180.0, diameter_deg=0.0),), ()),
}
LAMP_SHADOWS = {"point": only_lamps(lamp()), "cone": only_lamps(lamp(cone_deg=50.0))}


def lamp_scene(lamps: Mapping[str, Lighting] = LAMPS) -> RenderScene:
    """A white plane, at each sample under other lamps."""
    made = scene([mesh(*plane())], [surface((1.0, 1.0, 1.0))])
    # A few millimeters wide.
    near = look_at((0, 0, 1), (0, 0, 0), 8, 8, 0.3)
    views = [near if "degrees off" in name else ABOVE for name in lamps]
    return at_samples(made, list(lamps.values()), views)


def lamp_in_view() -> RenderScene:
    """A lamp that is a sphere before the dark, in the upper half of the picture."""
    view = look_at((0, -5, 1), (0, 0, 1), 8, 8, 20.0)
    one = only_lamps(lamp((0.0, 0.0, 1.0), radius_m=0.5))
    return at_samples(scene([mesh(*plane())]), [one], view)


# What gives off light

GLOW = np.array([10.0, 20.0, 30.0])


def panel_scene(turn: float) -> RenderScene:
    """A black panel that gives off light, upright on level ground; ``turn`` -1 shows its back."""
    points, faces = plane(1.0, cells=2)
    upright = np.array([[0.0, 0.0, turn], [0.0, 1.0, 0.0], [-turn, 0.0, 0.0]])
    panel = dataclasses.replace(surface((0.0, 0.0, 0.0)), emission=tuple(GLOW))
    return scene(
        [mesh(*plane(6.0)), mesh(points, faces, (1,))],
        [surface((ALBEDO,) * 3), panel],
        rows=[(0, affine()), (1, affine(upright, (0.0, 0.0, 1.2)))],
        cameras=[look_at((4.0, 0.0, 1.5), (0.0, 0.0, 0.9), 24, 24, 60.0)],
    )


def panel_radiance(scene: RenderScene) -> tuple[NDArray[np.float64], list[NDArray[np.bool_]]]:
    """Returns ``panel_scene``'s radiance, [24, 24, 3], and its pixels of panel and ground."""
    camera = scene.cameras[0][0]
    k, pose = camera.intrinsics, camera.camera_to_world
    v, u = np.meshgrid(np.arange(24) + 0.5, np.arange(24) + 0.5, indexing="ij")
    d = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
    d = d @ pose[:3, :3].T
    on_plane = pose[:3, 3] - d * (pose[0, 3] / d[..., :1])
    panel = (np.abs(on_plane[..., 1]) < 0.8) & (np.abs(on_plane[..., 2] - 1.2) < 0.8)
    at = pose[:3, 3] - d * (pose[2, 3] / np.minimum(d[..., 2:], -1e-9))
    ground = (d[..., 2] < 0.0) & (at[..., 0] > 0.6) & (at[..., 0] < 3.0) & ~panel
    # Cosines at the panel and at the ground, over the distance, over the panel.
    steps = (np.arange(60) + 0.5) / 30.0 - 1.0
    along, up = np.meshgrid(steps, steps + 1.2)
    x, y = at[..., 0, None, None], at[..., 1, None, None]
    squared = x**2 + (y - along) ** 2 + up**2
    irradiance = 4.0 * (np.abs(x) * up / squared**2).mean(axis=(-1, -2))
    radiance = ALBEDO / np.pi * irradiance[..., None] * GLOW
    radiance[panel] = GLOW
    return radiance, [panel, ground]
