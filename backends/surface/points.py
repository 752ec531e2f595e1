"""Finds what surfaces do at points that rays meet: colors, layers, laws of reflectance, light.

Surfaces are those of the shared model with colors from maps, variation and layers, and with their
laws of reflectance, and light passes through sheets; but glossy lobes scatter like diffuse ones.
Left out beside these: normal maps, and the order that height maps give to layers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.backends.stage.scene import DEFAULT_SURFACE, Mesh, RenderScene, Rows, Surface
from scenec.backends.surface import facets, lobes, reflectance
from scenec.backends.surface.algebra import FLOAT64
from scenec.backends.surface.maps import map_mean
from scenec.backends.surface.pictures import Point, has_maps, values_at

#: Points are lifted by this share of their distance, so that they do not shade themselves.
_LIFT = 1e-8


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
class SurfacePoints:
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


def surface_points(
    scene: RenderScene,
    rows: Rows,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    hits: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]],
) -> SurfacePoints:
    """Looks up the surfaces that rays meet.

    Args:
        scene: The scene.
        rows: Of the scene, at the sample.
        origins, directions: Of the rays, world, float64 [k, 3].
        hits: Row, face and ray parameter of each, [k].
    """
    row, face, t = hits
    way = directions / np.sqrt((directions * directions).sum(axis=1))[:, None]
    at = origins + t[:, None] * directions
    distance = np.abs(at).max(axis=1) + t * np.abs(directions).max(axis=1)
    diffuse, through, emission = np.zeros((3, *at.shape))
    lift = (_LIFT * distance)[:, None]
    out = SurfacePoints(at, np.empty_like(at), -way, lift, diffuse, through, emission)
    mesh_of, layers = rows.mesh[row], list[_LayerHits]()
    for number in np.unique(mesh_of):
        mesh, index = scene.meshes[number], np.flatnonzero(mesh_of == number)
        there = row[index], face[index]
        corners, normal = _corner_shares(mesh, rows, *there, at[index])
        to_viewer = -way[index]
        facing = (normal * to_viewer).sum(axis=1, keepdims=True)
        # A sliver whose area underflows has no normal of its own.
        flat = (normal == 0.0).all(axis=1, keepdims=True)
        out.normal[index] = np.where(flat, to_viewer, np.where(facing < 0.0, -normal, normal))
        layers += _layers(scene, rows, mesh, index, *there, corners)
    for layer in _joined(layers):
        _add_layer(out, layer)
    out.at += out.lift * out.normal
    return out


def _layers(
    scene: RenderScene,
    rows: Rows,
    mesh: Mesh,
    index: NDArray[np.int64],
    row: NDArray[np.int32],
    face: NDArray[np.int32],
    corners: NDArray[np.float64],
) -> Iterator[_LayerHits]:
    surfaces = [scene.surfaces[i] for i in mesh.layers] or [DEFAULT_SURFACE]
    vertices = mesh.faces[face]
    own, of_row = np.zeros(len(index)), rows.variation[row]
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


def _add_layer(out: SurfacePoints, layer: _LayerHits) -> None:
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
