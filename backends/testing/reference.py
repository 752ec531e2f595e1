"""Direct light in float64, by the definitions: what a renderer's pictures are held against.

First hits and shadows are the exact caster's, surfaces what ``stage.scene`` and ``surface`` define
them to be; the GGX lobe is written out here. A pixel is the mean over a grid of rays. There is no
light from one surface to another and none of the sky: of scenes without either, such as of convex
bodies under suns and lamps, this is what every renderer shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import NO_ROW, Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.scene import (
    DEFAULT_SURFACE,
    Camera,
    Lamp,
    Maps,
    Mesh,
    RenderScene,
    Sun,
    Surface,
)
from scenec.backends.surface import facets, lobes, merges
from scenec.backends.surface.algebra import FLOAT64
from scenec.backends.surface.gobo import passed
from scenec.backends.surface.maps import face_tangents
from scenec.backends.surface.pictures import Point, has_maps, values_at
from scenec.backends.surface.reflectance import brdf
from scenec.schemas.maps import MAP_CHANNELS

#: Smoother surfaces are drawn as rough as this.
LEAST_ROUGHNESS = 0.032
#: Cosines of what is compared: renderers differ where shading normals and faces disagree.
LEAST_COSINE, LEAST_VIEW = 0.1, 0.2
#: Shadow rays begin so far off a surface, as a share of its largest coordinate.
_LIFT = 1e-9

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Expected:
    """A picture as it is to be.

    Attributes:
        radiance: Light from surfaces, premultiplied by coverage, float64 [h, w, 3].
        coverage: Share of each pixel that surfaces cover, float64 [h, w].
        sound: Where the mean of rays says what the pixel shows, bool [h, w]: no edge of a surface
            or of a shadow is near, and nothing is seen or lit at a grazing angle.
    """

    radiance: Floats
    coverage: Floats
    sound: NDArray[np.bool_]


class Points(NamedTuple):
    """Surface points of one mesh, all in the world.

    face int [n]; row int [n]; share float64 [n, 3], barycentric; position, view (unit, to the
    camera), geometric and shading (unit normals, outward) float64 [n, 3]; uv float64 [n, 2];
    along_u, along_v float64 [n, 3], directions of dP/du and dP/dv.
    """

    face: NDArray[np.integer]
    row: NDArray[np.integer]
    share: Floats
    position: Floats
    view: Floats
    geometric: Floats
    shading: Floats
    uv: Floats
    along_u: Floats
    along_v: Floats


class Light(NamedTuple):
    """Holds the light that arrives at surface points from one direction each.

    toward float64 [n, 3], unit; flux float64 [n, 3], irradiance across it, 0 in shadow; sharp
    bool [n], whether it arrives, as far as that changes within a hair.
    """

    toward: Floats
    flux: Floats
    sharp: NDArray[np.bool_]


def picture(scene: RenderScene, sample: int = 0, side: int = 4, disc: int = 1) -> Expected:
    """Renders the picture of a sample's first camera.

    Args:
        scene: The scene; its camera is a pinhole.
        sample: Time code.
        side: Rays on a side of a pixel.
        disc: Directions that a sun's disc is made of.
    """
    camera = scene.cameras[sample][0]
    caster = ExactCaster(scene)
    caster.pose(sample)
    rays = pixel_rays(camera, side)
    row, face, _ = caster.cast(rays)
    radiance = np.zeros((len(row), 3))
    fit = row != NO_ROW
    # What has to be the same all over a pixel: the row, where faces matter the face, the shadows.
    suns, lamps = scene.lighting[sample].suns, scene.lighting[sample].lamps
    place = np.full((len(row), 2 + len(suns) * disc + len(lamps)), -1, np.int64)
    for number, mesh in enumerate(scene.meshes):
        at = np.flatnonzero(fit)
        at = at[scene.rows.mesh[row[at]] == number]
        if not len(at):
            continue
        points = _points(scene, sample, mesh, rays, at, row[at], face[at])
        reach = _Reach(caster, any(scene.surfaces[layer].transmits for layer in mesh.layers))
        lights = [_from_sun(reach, points, sun, disc, k) for sun in suns for k in range(disc)]
        lights += [_from_lamp(reach, points, lamp) for lamp in lamps]
        radiance[at], sound = _shade(scene, mesh, points, lights)
        fit[at] &= sound
        place[at, 0] = points.row
        place[at, 1] = _facet(mesh, points)
        for k, light in enumerate(lights):
            place[at, 2 + k] = light.sharp
    shape = (camera.height, side, camera.width, side)
    coverage = (row != NO_ROW).reshape(shape).mean(axis=(1, 3))
    sound = fit.reshape(shape).all(axis=(1, 3)) & _even(place.reshape(*shape, -1))
    return Expected(radiance.reshape(*shape, 3).mean(axis=(1, 3)), coverage, sound)


def coverage(scene: RenderScene, sample: int = 0, side: int = 4) -> Floats:
    """Share of each pixel that surfaces cover, as of ``picture``."""
    camera = scene.cameras[sample][0]
    caster = ExactCaster(scene)
    caster.pose(sample)
    row, _, _ = caster.cast(pixel_rays(camera, side))
    result: Floats = (row != NO_ROW).reshape(camera.height, side, camera.width, side).mean((1, 3))
    return result


def pixel_rays(camera: Camera, side: int) -> Rays:
    """Rays on a grid of ``side`` by ``side`` in each pixel of a pinhole, by K's own equations."""
    k, pose = camera.intrinsics, camera.camera_to_world
    shape = (camera.height * side, camera.width * side)
    v, u = np.meshgrid(*((np.arange(n) + 0.5) / side for n in shape), indexing="ij")
    y = (v - k[1, 2]) / k[1, 1]
    x = (u - k[0, 2] - k[0, 1] * y) / k[0, 0]
    directions = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ pose[:3, :3].T
    return Rays(np.broadcast_to(pose[:3, 3], directions.shape).copy(), directions, shape)


def ggx(alpha: Floats, normal: Floats, toward: Floats, view: Floats) -> Floats:
    """A white microfacet lobe, 1/sr, [n]: D G / (4 cos cos).

    Trowbridge and Reitz's D (Walter et al. 2007) and Smith's masking and shadowing, correlated by
    height (Heitz 2014).
    """
    half = unit(toward + view)
    cosine, mu0, mu = (_dot(normal, way) for way in (half, toward, view))
    alpha2 = alpha * alpha
    density = alpha2 / (np.pi * (cosine * cosine * (alpha2 - 1.0) + 1.0) ** 2)
    with np.errstate(all="ignore"):
        hidden = [0.5 * (np.sqrt(1.0 + alpha2 * (1.0 / (c * c) - 1.0)) - 1.0) for c in (mu0, mu)]
        lobe = density / (1.0 + hidden[0] + hidden[1]) / (4.0 * mu0 * mu)
    return np.where((mu0 > 0.0) & (mu > 0.0), lobe, 0.0)


def lobe_albedo(roughness: float, mu: float, nodes: int = 400) -> float:
    """Share of an even sky's light that a white lobe sends towards a viewer at the cosine ``mu``.

    Over half vectors h drawn by D cos h (tan^2 h = alpha^2 u / (1 - u)) on a grid: with f cos i
    dw_i = D G (o.h) / mu dw_h, the mean of G (o.h) / (mu cos h).
    """
    alpha = max(roughness, LEAST_ROUGHNESS) ** 2
    steps = (np.arange(nodes) + 0.5) / nodes
    u, phi = np.meshgrid(steps, 2.0 * np.pi * steps)
    cosine = 1.0 / np.sqrt(1.0 + alpha * alpha * u / (1.0 - u))
    along = np.sqrt((1.0 - mu * mu) * (1.0 - cosine * cosine)) * np.cos(phi) + mu * cosine
    out = 2.0 * along * cosine - mu
    there = (along > 0.0) & (out > 0.0)
    hidden = [
        0.5 * np.sqrt(1.0 + alpha * alpha * (1.0 / (c * c) - 1.0)) - 0.5
        for c in (np.float64(mu), np.where(there, out, 1.0))
    ]
    shown = along / (mu * cosine) / (1.0 + hidden[0] + hidden[1])
    return float(np.where(there, shown, 0.0).mean())


def metal_albedo(surface: Surface, mu: float) -> Floats:
    """``lobe_albedo`` of a metal, [3], with what its facets reflect to each other as defined."""
    found = lobes.lobes_of(FLOAT64, lobes.numbers_of(FLOAT64, surface), {}, ())
    once = lobe_albedo(surface.roughness, mu)
    return np.asarray(once * lobes.gloss_color(found, mu)[:, 0])


def unit(vectors: NDArray) -> Floats:
    """Scales vectors to length 1 along the last axis."""
    result: Floats = vectors / np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    return result


def _dot(a: NDArray, b: NDArray) -> Floats:
    total: Floats = (a * b).sum(axis=-1)
    return total


def _points(
    scene: RenderScene,
    sample: int,
    mesh: Mesh,
    rays: Rays,
    at: NDArray[np.int64],
    row: NDArray[np.int32],
    face: NDArray[np.int32],
) -> Points:
    """Intersects rays with triangles of a mesh (Moeller and Trumbore 1997)."""
    matrix = scene.rows_at(sample).to_world[row]
    linear = matrix[:, :, :3]
    local = mesh.points.astype(np.float64)[mesh.faces[face]]
    corners = np.einsum("nij,nkj->nki", linear, local) + matrix[:, None, :, 3]
    origins, directions = rays.origins[at], rays.directions[at]
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across, start = np.cross(directions, ac), origins - corners[:, 0]
    scale = 1.0 / _dot(across, ab)
    second, third = _dot(across, start) * scale, _dot(directions, np.cross(start, ab)) * scale
    share = np.stack([1.0 - second - third, second, third], axis=1)
    geometric = np.sign(np.linalg.det(linear))[:, None] * unit(np.cross(ab, ac))
    shading = geometric
    if mesh.normals is not None:
        own = (share[..., None] * mesh.normals.astype(np.float64)[mesh.faces[face]]).sum(axis=1)
        shading = unit(np.einsum("ni,nij->nj", own, np.linalg.inv(linear)))
        # Outward is where the face says, however its normals are wound.
        shading = shading * np.sign(_dot(shading, geometric))[:, None]
    uv = np.zeros((len(at), 2))
    if mesh.uv is not None:
        uv = (share[..., None] * mesh.uv.astype(np.float64)[face]).sum(axis=1)
    along = (t.astype(np.float64)[face] for t in face_tangents(mesh))
    u, v = (np.einsum("nij,nj->ni", linear, t) for t in along)
    position = (share[..., None] * corners).sum(axis=1)
    return Points(face, row, share, position, -unit(directions), geometric, shading, uv, u, v)


def _facet(mesh: Mesh, points: Points) -> NDArray[np.int64]:
    """A number for what may change from face to face: texture coordinates, or flat normals."""
    if mesh.uv is not None:
        return points.face.astype(np.int64)
    if mesh.normals is not None:
        return np.zeros(len(points.face), np.int64)
    steps = np.rint(points.geometric * 1e5).astype(np.int64)
    result: NDArray[np.int64] = steps @ np.array([1, 1 << 20, 1 << 40])
    return result


def _even(place: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Pixels in which and next to which all rays [h, side, w, side, ...] are of one place."""
    height, _, width, _, _ = place.shape
    first = place[:, :1, :, :1]
    same = (place == first).all(axis=(1, 3, 4))
    own = np.pad(first[:, 0, :, 0], ((1, 1), (1, 1), (0, 0)), mode="edge")
    whole = np.pad(same, 1, mode="edge")
    near = [(i, j) for i in range(3) for j in range(3)]
    even = [whole[i : i + height, j : j + width] for i, j in near]
    even += [(own[i : i + height, j : j + width] == own[1:-1, 1:-1]).all(axis=-1) for i, j in near]
    return np.logical_and.reduce(even)


def _shade(
    scene: RenderScene, mesh: Mesh, points: Points, lights: list[Light]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Radiance [n, 3], and where it is seen and lit from well above the surface."""
    behind = _dot(points.geometric, points.view) < 0.0
    facing = np.where(behind[:, None], -points.geometric, points.geometric)
    sound = _dot(facing, points.view) > LEAST_VIEW
    for light in lights:
        sound &= ~light.flux.any(axis=1) | (np.abs(_dot(facing, light.toward)) > LEAST_COSINE)
    looks, levels = [], []
    for layer in mesh.layers or (None,):
        surface = DEFAULT_SURFACE if layer is None else scene.surfaces[layer]
        found = _of_maps(surface.maps, points)
        normal = found["normal"].T if "normal" in found else points.shading
        lift = _dot(normal, points.shading)[:, None]
        # From behind, normals are mirrored in the surface.
        normal = np.where(behind[:, None], normal - 2.0 * lift * points.shading, normal)
        if not facets.deviation(surface):
            sound &= _dot(normal, points.view) > LEAST_COSINE
        look = np.broadcast_to(np.array(surface.emission), points.position.shape)
        if "emission" in found:
            look = look * found["emission"].T
        for light in lights:
            lit = light.flux.any(axis=1)
            over = _dot(normal, light.toward) * np.sign(_dot(facing, light.toward))
            sound &= ~lit | (over > LEAST_COSINE)
            look = look + _reflected(scene, mesh, surface, found, points, normal, light)
        looks.append(look)
        levels.append(found.get("height", np.full(len(look), merges.FLAT)))
    weights = [_at(mesh, row, points) for row in mesh.weights]
    slopes = merges.all_slopes(FLOAT64, mesh.height_blends)
    total = looks[0]
    heeded = merges.heeded_weights(FLOAT64, weights, slopes, levels)
    for own, weight in zip(looks[1:], heeded, strict=True):
        total = total + weight[:, None] * (own - total)
    return total, sound


def _reflected(
    scene: RenderScene,
    mesh: Mesh,
    surface: Surface,
    pictured: dict[str, Floats],
    points: Points,
    normal: Floats,
    light: Light,
) -> Floats:
    """Returns one light's reflection by one layer, [n, 3]."""
    vertex = np.zeros(len(normal))
    if mesh.variation is not None:
        vertex = _at(mesh, mesh.variation, points)
    row = scene.rows.variation[points.row].astype(np.float64)
    if mesh.color is not None:
        color = (points.share[..., None] * mesh.color.astype(np.float64)[points.face]).sum(axis=1)
        pictured = pictured | {"base_color": pictured.get("base_color", 1.0) * color.T}
    numbers = lobes.numbers_of(FLOAT64, surface)
    found = lobes.lobes_of(FLOAT64, numbers, pictured, (vertex, row))
    color = found.color.T
    mu0, mu = _dot(normal, light.toward), _dot(normal, points.view)
    side = np.sign(_dot(points.geometric, points.view))
    over, below = (side * _dot(points.shading, way) for way in (points.view, light.toward))
    rough = facets.deviation(surface)
    dull = color / np.pi
    if surface.reflectance is not None:
        phase = _dot(light.toward, points.view)[:, None]
        seen = mu if rough == 0.0 else over
        dull = brdf(surface.reflectance, color, mu0[:, None], seen[:, None], phase)
    if rough > 0.0:
        shares = facets.factor(FLOAT64, rough, over, below, _dot(light.toward, points.view))
        dull = dull * shares[:, None]
    gloss = ggx(found.alpha, normal, light.toward, points.view)
    gloss = np.where(mu > LEAST_COSINE, gloss, 0.0)
    shine = lobes.gloss_color(found, np.maximum(mu, LEAST_COSINE)).T
    f = np.reshape(found.dull, (-1, 1)) * dull + gloss[:, None] * shine
    light_in = np.maximum(mu0, 0.0)[:, None] * light.flux
    if found.through is None:
        return np.asarray(f * light_in)
    passed = np.reshape(found.through, (-1, 1)) * color / np.pi
    return np.asarray(f * light_in + passed * np.maximum(-mu0, 0.0)[:, None] * light.flux)


def _at(mesh: Mesh, values: NDArray[np.float32], points: Points) -> Floats:
    """Values at vertices, between them."""
    return _dot(points.share, values.astype(np.float64)[mesh.faces[points.face]])


def _of_maps(described: Maps | None, points: Points) -> dict[str, Floats]:
    """Values of all maps that there are, by kind, [n] or [3, n]; normals are leaned already."""
    kinds = [kind for kind in MAP_CHANNELS if has_maps(described, kind)]
    if described is None or not kinds:
        return {}
    point = Point(
        points.position.T, points.shading.T, points.geometric.T, points.uv.T,
        points.along_u.T, points.along_v.T,
    )  # fmt: skip
    return values_at(described, kinds, point)


class _Reach(NamedTuple):
    """Holds the arguments of shadow rays; ``through``: whether light on the far side counts."""

    caster: ExactCaster
    through: bool


def _from_sun(reach: _Reach, points: Points, sun: Sun, disc: int, number: int) -> Light:
    """One of ``disc`` equal parts of a sun, on Vogel's spiral over its disc."""
    toward = np.asarray(sun.to_light, np.float64)
    if disc > 1:
        radius = 0.5 * sun.diameter_rad * np.sqrt((number + 0.5) / disc)
        angle = number * np.pi * (3.0 - np.sqrt(5.0))
        right = unit(np.cross(toward, np.eye(3)[np.argmin(np.abs(toward))]))
        aside = np.cos(angle) * right + np.sin(angle) * np.cross(toward, right)
        toward = unit(toward + radius * aside)
    way = np.broadcast_to(toward, points.position.shape)
    clear = _reaches(reach, points, way, np.inf)
    share = clear * passed(sun, points.position) / disc
    return Light(way, share[:, None] * np.asarray(sun.irradiance, np.float64), clear)


def _from_lamp(reach: _Reach, points: Points, lamp: Lamp) -> Light:
    """A lamp as a point: of a sphere that is seen whole, irradiance is the same."""
    way = lamp.position - points.position
    distance = np.sqrt(_dot(way, way))
    toward = way / distance[:, None]
    angle = np.arccos(np.clip(-_dot(toward, lamp.axis), -1.0, 1.0))
    start = lamp.cone * (1.0 - lamp.softness)
    x = np.clip((angle - start) / max(lamp.cone - start, 1e-9), 0.0, 1.0)
    law = np.where(angle > lamp.cone, 0.0, 1.0 - x * x * (3.0 - 2.0 * x))
    clear = _reaches(reach, points, way, 1.0)
    flux = (law * clear / distance**2)[:, None] * np.asarray(lamp.intensity, np.float64)
    return Light(toward, flux, clear & ((angle <= lamp.cone) | (lamp.softness > 0.0)))


def _reaches(reach: _Reach, points: Points, way: Floats, most: float) -> NDArray[np.bool_]:
    """Whether nothing stands between points and a light that lies ``most`` times ``way`` away.

    Light reaches the side that is seen, if that is turned towards it.
    """
    side = np.sign(_dot(points.geometric, points.view))[:, None] * points.geometric
    if reach.through:
        side = side * np.where(_dot(side, way) < 0.0, -1.0, 1.0)[:, None]
    lift = _LIFT * np.abs(points.position).max(initial=1.0)
    _, _, t = reach.caster.cast(Rays(points.position + lift * side, way.copy(), (1, len(way))))
    return (t >= most) & (_dot(side, way) > 0.0)
