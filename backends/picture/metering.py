"""Meters a scene's light: estimates radiance by a few paths of the exact caster.

An exposure must not depend on who draws the picture, on which frames are drawn, or on their noise;
so it does not look at pictures. A camera's rays are cast, one anywhere in each cell of a coarse
grid, so that what is thinner than a cell counts by its area, wherever it lies. From each hit goes a
path of diffuse reflections: at each of its points the light of suns, lamps and sky is gathered
through shadow rays (next event estimation). The numbers that choose directions have one fixed key.
A thing that takes the share p of all pictures that are metered is missed with a chance of
exp(-12288 p): what takes a thousandth, 5 times in a million.

The surfaces are those of the shared model with colors from maps, variation and layers, and with
their laws of reflectance, and light passes through sheets; but glossy lobes scatter like diffuse
ones: a highlight is what a meter should not heed. Left out beside these: normal maps, the order
that height maps give to layers, and the size of suns and lamps. What that costs against the
pictures of renderers is measured in ``docs/sensors.md``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import rays_at
from scenec.backends.camera.tiles import coarse
from scenec.backends.contract import BOUNCES, Rays
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.noise_seeds import metering_paths, metering_places
from scenec.backends.picture.airlight import ambient, arrive
from scenec.backends.picture.haze import Hazy
from scenec.backends.picture.sky import Sky, combine, lookup, texel_directions
from scenec.backends.stage.scene import (
    DEFAULT_SURFACE,
    Camera,
    Lamp,
    Mesh,
    RenderScene,
    Rows,
    Surface,
)
from scenec.backends.surface import facets, lamps, lobes, reflectance
from scenec.backends.surface.algebra import FLOAT64
from scenec.backends.surface.gobo import passed
from scenec.backends.surface.maps import map_mean
from scenec.backends.surface.pictures import Point, has_maps, values_at
from scenec.schemas.picture import luminance

#: Directions to the sky at the first hit; one at later ones.
_SKY_RAYS = 8
#: Rows of the lat-long picture that directions to the sky are drawn from, 1.4 degrees each.
_SKY_ROWS = 128
#: Points are lifted by this share of their distance, so that they do not shade themselves.
_LIFT = 1e-8


@dataclass(frozen=True)
class Metering:
    """Holds luminance along a camera's rays, [W/(m^2 sr)], without the suns' discs.

    Attributes:
        surfaces: Of rays that hit one, float64 [n].
        sky: Of the others, float64 [m].
    """

    surfaces: NDArray[np.float64]
    sky: NDArray[np.float64]


def look(
    scene: RenderScene,
    caster: ExactCaster,
    camera: Camera,
    sample: int,
    rays: int,
    hazy: Hazy | None = None,
) -> Metering:
    """Estimate what a camera sees at a sample.

    Args:
        scene: The stage.
        caster: Its caster; left posed as at the sample.
        camera: The camera at the sample.
        sample: Time code.
        rays: About how many rays of the camera are cast.
        hazy: Its haze, if it has any.
    """
    caster.pose(sample)
    paths = _Paths(scene, caster, sample, hazy)
    table = _spread(camera, rays, sample)
    known = np.ones(len(table.origins), np.bool_) if table.known is None else table.known
    table = Rays(table.origins[known], table.directions[known], (int(known.sum()), 1))
    surfaces, hit = paths.radiance(table)
    sky = np.zeros((int((~hit).sum()), 3))
    if paths.sky is not None:
        sky = lookup(paths.sky, table.directions[~hit]).astype(np.float64)
    return Metering(luminance(surfaces), luminance(sky))


def _spread(camera: Camera, rays: int, sample: int) -> Rays:
    """Draws about so many rays, one anywhere in each cell of a grid, others at each sample."""
    cells = coarse(camera, rays)
    jitter = metering_places(sample).random((2, cells.height, cells.width))
    u = (np.arange(cells.width) + jitter[0]) * (camera.width / cells.width)
    v = (np.arange(cells.height)[:, None] + jitter[1]) * (camera.height / cells.height)
    return rays_at(camera, u.ravel(), v.ravel())


class _LayerHits(NamedTuple):
    """Hits of one layer of a surface.

    Attributes:
        number: From the bottom up.
        surface: The surface.
        which: Hits, int64 [n].
        share: Of what is seen, float64 [n, 1].
        own, of_row: Variations of the vertices and of the row, floating [n].
        uv: Float64 [n, 2], or None.
        color: Factor of the base color, floating [n, 3].
    """

    number: int
    surface: Surface
    which: NDArray[np.int64]
    share: NDArray[np.float64]
    own: NDArray[np.float64]
    of_row: NDArray[np.floating]
    uv: NDArray[np.float64] | None
    color: NDArray[np.floating]


def _joined(layers: list[_LayerHits]) -> list[_LayerHits]:
    """Joins layers of one surface on all meshes; from the top down, as they are on each mesh."""
    groups: dict[tuple[int, int, bool], list[_LayerHits]] = {}
    for one in layers:
        groups.setdefault((-one.number, id(one.surface), one.uv is None), []).append(one)
    joined = []
    for _, alike in sorted(groups.items()):
        number, surface, *columns = zip(*alike, strict=True)
        arrays: list[Any] = [None if of[0] is None else np.concatenate(of) for of in columns]
        joined.append(_LayerHits(number[0], surface[0], *arrays))
    return joined


@dataclass
class _Points:
    """Hits, and what surfaces do there.

    Attributes:
        at, normal, to_viewer: World, float64 [k, 3]; the normal faces the viewer, both are units.
        lift: How far ``at`` is above the surface, meters, float64 [k, 1].
        diffuse: Albedo of what scatters as Lambert's law says, float64 [k, 3].
        through: The same of light from behind, float64 [k, 3].
        emission: float64 [k, 3].
        laws: Other laws, or facets that hide each other: (the surface, which hits, the share [n, 1]
            of its dull part, its color [n, 3]).
    """

    at: NDArray[np.float64]
    normal: NDArray[np.float64]
    to_viewer: NDArray[np.float64]
    lift: NDArray[np.float64]
    diffuse: NDArray[np.float64]
    through: NDArray[np.float64]
    emission: NDArray[np.float64]
    laws: list[tuple[Surface, NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]] = field(
        default_factory=list
    )

    def shown(self, to_light: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns BRDF, or BTDF from behind, times the cosine, for directions [k, 3], float64."""
        cosine = (self.normal * to_light).sum(axis=1)[:, None]
        out = self.diffuse / np.pi
        for surface, which, share, color in self.laws:
            mu = (self.normal * self.to_viewer).sum(axis=1)[which, None]
            phase = (to_light * self.to_viewer).sum(axis=1)[which, None]
            f = color / np.pi
            if surface.reflectance is not None:
                f = reflectance.brdf(surface.reflectance, color, cosine[which], mu, phase)
            rough = facets.deviation(surface)
            if rough > 0.0:
                f = f * facets.factor(FLOAT64, rough, mu, cosine[which], phase)
            out[which] += share * f
        out *= np.maximum(cosine, 0.0)
        if self.through.any():
            out += self.through / np.pi * np.maximum(-cosine, 0.0)
        return np.asarray(out)

    def rays(self, ways: NDArray[np.float64]) -> Rays:
        """Makes rays from the points, on the sides of the surfaces that the ways [k, 3] go to."""
        behind = (self.normal * ways).sum(axis=1, keepdims=True) < 0.0
        at = np.where(behind, self.at - 2.0 * self.lift * self.normal, self.at)
        return Rays(at, np.ascontiguousarray(ways), (len(at), 1))


class _Paths:
    """A scene at one sample, as paths meet it."""

    def __init__(
        self, scene: RenderScene, caster: ExactCaster, sample: int, hazy: Hazy | None
    ) -> None:
        lighting = scene.lighting[sample] if hazy is None else hazy.lighting(sample)
        self.sky = combine(lighting.domes)
        self._scene = scene
        self._caster = caster
        self._suns = lighting.suns
        self._lamps = lighting.lamps
        self._dome = None if self.sky is None else _Dome(self.sky)
        self._air = None if hazy is None else hazy.air(sample)
        self._rows = scene.rows_at(sample)
        self._random = metering_paths(sample)

    def radiance(self, rays: Rays) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Radiance along rays that hit something, float64 [n, 3], and which ones do."""
        row, face, t = self._caster.cast(rays)
        hit = np.isfinite(t)
        origins, directions, t = rays.origins[hit], rays.directions[hit], t[hit]
        points = self._points(origins, directions, row[hit], face[hit], t)
        light = points.emission + self._direct(points, _SKY_RAYS)
        alive, weight = np.arange(len(t)), np.ones((len(t), 3))
        for _ in range(BOUNCES):
            # By the cosine, which cancels: pi times the BRDF is what is left.
            ways, chance = self._bounces(points)
            cosine = np.maximum(np.abs((points.normal * ways).sum(axis=1)), 1e-12)[:, None]
            weight = weight * (np.pi / cosine) * points.shown(ways) / chance
            rays = points.rays(ways)
            row, face, far = self._caster.cast(rays)
            on = np.isfinite(far) & (weight > 0.0).any(axis=1)
            if not on.any():
                break
            alive, weight = alive[on], weight[on]
            starts = rays.origins[on]
            points = self._points(starts, ways[on], row[on], face[on], far[on])
            light[alive] += weight * (points.emission + self._direct(points, 1))
        if self._air is not None:
            glow = ambient(self._air, directions)
            passed, shown = arrive(self._air, origins, directions[:, None], t[:, None], glow)
            light = light * passed + shown
        return light, hit

    def _direct(self, points: _Points, sky_rays: int) -> NDArray[np.float64]:
        """Sums the light reflected of suns, lamps and sky, float64 [k, 3]."""
        out = np.zeros(points.at.shape)
        for sun in self._suns:
            ways = np.broadcast_to(sun.to_light, points.at.shape)
            light = sun.irradiance * passed(sun, points.at)[:, None]
            out += self._unshaded(points, points.shown(ways) * light, ways, np.inf)
        if self._lamps:
            out += self._lamplight(points)
        if self._dome is not None and self._dome.total > 0.0:
            for k in range(sky_rays):
                # One of each part of the sky, from its top down.
                u = (k + self._random.random(len(out))) / sky_rays
                ways, light = self._dome.draw(u)
                lit = points.shown(ways) * light
                out += self._unshaded(points, lit, ways, np.inf) / sky_rays
        return out

    def _lamplight(self, points: _Points) -> NDArray[np.float64]:
        """One of the lamps, drawn by what each would give if nothing stood before it."""
        each = np.stack([_irradiance(lamp, points.at) for lamp in self._lamps], axis=1)
        strength = luminance(each)
        sums = np.cumsum(strength, axis=1)
        total = sums[:, -1]
        drawn = self._random.random(len(total)) * total
        which = np.minimum((sums <= drawn[:, None]).sum(axis=1), len(self._lamps) - 1)
        k = np.arange(len(total))
        chance = np.where(strength[k, which] > 0.0, strength[k, which], 1.0)
        ways = np.stack([lamp.position for lamp in self._lamps])[which] - points.at
        length = np.sqrt((ways * ways).sum(axis=1))[:, None]
        units = ways / np.where(length > 0.0, length, 1.0)
        light = each[k, which] * (total / chance)[:, None]
        return self._unshaded(points, points.shown(units) * light, ways, 1.0)

    def _unshaded(
        self, points: _Points, lit: NDArray[np.float64], ways: NDArray[np.float64], end: float
    ) -> NDArray[np.float64]:
        """Light where nothing stands between a point and ``end`` ways from it; 0 elsewhere."""
        index = np.flatnonzero((lit > 0.0).any(axis=1))
        out = np.zeros(lit.shape)
        t = self._caster.cast(points.rays(ways), index)[2]
        free = index[t >= end]
        out[free] = lit[free]
        return out

    def _bounces(self, points: _Points) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Samples directions by the cosine (Malley), [k, 3], and their side's probability, [k, 1].

        Of sheets, each side about as often as it shows more light.
        """
        normals = points.normal
        u = self._random.random((len(normals), 2))
        turn, radius = 2.0 * np.pi * u[:, :1], np.sqrt(u[:, 1:])
        # An axis across the normal: of the world's the one that is farthest from it.
        least = np.argmin(np.abs(normals), axis=1)
        across = np.cross(normals, np.eye(3)[least])
        across /= np.sqrt((across * across).sum(axis=1))[:, None]
        flat = np.cos(turn) * across + np.sin(turn) * np.cross(normals, across)
        ways = np.asarray(radius * flat + np.sqrt(1.0 - u[:, 1:]) * normals)
        chance = np.ones((len(ways), 1))
        if points.through.any():
            passed, kept = (luminance(part)[:, None] for part in (points.through, points.diffuse))
            whole = passed + kept
            # Never all of them: other laws than Lambert's are not in ``diffuse``.
            share = np.minimum(passed / np.where(whole > 0.0, whole, 1.0), 0.5)
            behind = self._random.random(chance.shape) < share
            up = (ways * normals).sum(axis=1, keepdims=True)
            ways = np.where(behind, ways - 2.0 * up * normals, ways)
            chance = np.where(behind, share, 1.0 - share)
        return ways, chance

    def _points(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        row: NDArray[np.int32],
        face: NDArray[np.int32],
        t: NDArray[np.float64],
    ) -> _Points:
        way = directions / np.sqrt((directions * directions).sum(axis=1))[:, None]
        at = origins + t[:, None] * directions
        distance = np.abs(at).max(axis=1) + t * np.abs(directions).max(axis=1)
        diffuse, through, emission = np.zeros((3, *at.shape))
        lift = (_LIFT * distance)[:, None]
        out = _Points(at, np.empty_like(at), -way, lift, diffuse, through, emission)
        mesh_of, layers = self._rows.mesh[row], list[_LayerHits]()
        for number in np.unique(mesh_of):
            mesh, index = self._scene.meshes[number], np.flatnonzero(mesh_of == number)
            there = row[index], face[index]
            corners, normal = _corner_shares(mesh, self._rows, *there, at[index])
            to_viewer = -way[index]
            facing = (normal * to_viewer).sum(axis=1, keepdims=True)
            # A sliver whose area underflows has no normal of its own.
            flat = (normal == 0.0).all(axis=1, keepdims=True)
            out.normal[index] = np.where(flat, to_viewer, np.where(facing < 0.0, -normal, normal))
            layers += self._layers(mesh, index, *there, corners)
        for layer in _joined(layers):
            _add_layer(out, layer)
        out.at += out.lift * out.normal
        return out

    def _layers(
        self,
        mesh: Mesh,
        index: NDArray[np.int64],
        row: NDArray[np.int32],
        face: NDArray[np.int32],
        corners: NDArray[np.float64],
    ) -> Iterator[_LayerHits]:
        surfaces = [self._scene.surfaces[i] for i in mesh.layers] or [DEFAULT_SURFACE]
        vertices = mesh.faces[face]
        own, of_row = np.zeros(len(index)), self._rows.variation[row]
        if mesh.variation is not None:
            own = (corners * mesh.variation[vertices]).sum(axis=1)
        uv = None if mesh.uv is None else (corners[..., None] * mesh.uv[face]).sum(axis=1)
        color = np.ones((len(index), 3))
        if mesh.color is not None:
            color = (corners[..., None] * mesh.color[face]).sum(axis=1)
        # From the top down: what a merge leaves is for those below.
        left = np.ones(len(index))
        for layer in range(len(surfaces) - 1, -1, -1):
            share = left
            if layer:
                weight = (corners * mesh.weights[layer - 1][vertices]).sum(axis=1)
                share, left = left * weight, left * (1.0 - weight)
            yield _LayerHits(layer, surfaces[layer], index, share[:, None], own, of_row, uv, color)


def _add_layer(out: _Points, layer: _LayerHits) -> None:
    surface, index, part = layer.surface, layer.which, layer.share
    at, normal = out.at[index], out.normal[index]
    shown = _map(surface, "base_color", at, normal, layer.uv)
    picture = {"base_color": shown * layer.color.T}
    numbers = lobes.numbers_of(FLOAT64, surface)
    found = lobes.lobes_of(FLOAT64, numbers, picture, (layer.own, layer.of_row))
    color, dull = found.color.T, found.dull
    if found.through is not None:
        out.through[index] += part * np.reshape(found.through, (-1, 1)) * color
    gloss = found.white + found.tinted * color
    if surface.reflectance is None and not facets.deviation(surface):
        gloss = gloss + dull * color
    else:
        out.laws.append((surface, index, part * dull, color))
    out.diffuse[index] += part * gloss
    if surface.emits:
        glow = np.array(surface.emission) * _map(surface, "emission", at, normal, layer.uv).T
        out.emission[index] += part * glow


def _corner_shares(
    mesh: Mesh,
    rows: Rows,
    row: NDArray[np.int32],
    face: NDArray[np.int32],
    at: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Barycentric coordinates [k, 3] and unit normals [k, 3] of hits on one mesh."""
    local = mesh.points[mesh.faces[face]].astype(np.float64)
    matrix = rows.to_world[row]
    world = np.einsum("kij,kcj->kci", matrix[:, :, :3], local) + matrix[:, None, :, 3]
    first, second = world[:, 1] - world[:, 0], world[:, 2] - world[:, 0]
    across = np.cross(first, second)
    area = (across * across).sum(axis=1)
    area = np.where(area > 0.0, area, 1.0)
    offset = at - world[:, 0]
    b = (np.cross(offset, second) * across).sum(axis=1) / area
    c = (np.cross(first, offset) * across).sum(axis=1) / area
    shares = np.clip(np.stack([1.0 - b - c, b, c], axis=1), 0.0, 1.0)
    shares /= shares.sum(axis=1)[:, None]
    return shares, across / np.sqrt(area)[:, None]


def _map(
    surface: Surface,
    kind: str,
    at: NDArray[np.float64],
    normal: NDArray[np.float64],
    uv: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    """Returns a map's factor on a color, float64 [3, k] or [3, 1]; 1 without a map."""
    maps = surface.maps
    if maps is None or not has_maps(maps, kind):
        return np.ones((3, 1))
    if maps.projection == "uv" and uv is None:
        return map_mean(maps, kind)[:, None]
    point = Point(at.T, normal.T, uv=None if uv is None else uv.T)
    return values_at(maps, (kind,), point)[kind]


def _irradiance(lamp: Lamp, at: NDArray[np.float64]) -> NDArray[np.float64]:
    """On surfaces that face a lamp, as if it were a point, float64 [k, 3]."""
    offset = at - lamp.position
    squared = (offset * offset).sum(axis=1)
    outside = squared > lamp.radius_m * lamp.radius_m
    squared = np.where(outside, squared, 1.0)
    away = (offset / np.sqrt(squared)[:, None]).T
    share = lamps.falloff(FLOAT64, away, lamp.axis[:, None], lamps.cone(lamp))
    return np.asarray(np.where(outside, share / squared, 0.0)[:, None] * lamp.intensity)


class _Dome:
    """A sky to draw directions from, by the luminance that comes from there.

    Attributes:
        total: Luminance over all directions, times their solid angle.
    """

    def __init__(self, sky: Sky) -> None:
        picture = sky.picture.astype(np.float64)
        if sky.constant:
            picture = np.broadcast_to(picture, (_SKY_ROWS // 4, _SKY_ROWS // 2, 3))
        # Means over blocks of texels; what does not fill a block at the right or below is left.
        side = max(1, picture.shape[0] // _SKY_ROWS)
        height, width = (size // side for size in picture.shape[:2])
        blocks = picture[: height * side, : width * side].reshape(height, side, width, side, 3)
        picture = blocks.mean(axis=(1, 3))
        rows = -np.diff(np.cos(np.arange(height + 1) * (np.pi / height)))
        level = luminance(picture)
        self._sums = np.cumsum((level * rows[:, None]).ravel())
        self.total = float(self._sums[-1]) * 2.0 * np.pi / width
        colors = picture / np.where(level > 0.0, level, 1.0)[..., None]
        self._colors = colors.reshape(-1, 3)
        self._directions = (texel_directions(height, width) @ sky.to_world.T).reshape(-1, 3)

    def draw(self, u: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Unit vectors [k, 3] and radiance over their density [k, 3], from numbers in [0, 1)."""
        which = np.searchsorted(self._sums, u * self._sums[-1], side="right")
        which = np.minimum(which, len(self._sums) - 1)
        return self._directions[which], self.total * self._colors[which]
