"""Paths through a scene whose instances are kept: rays by the exact caster, all else by Mitsuba.

Mitsuba's own ``instance`` takes 13.8 KB each in its JIT variants, and is one call target each in
every bounce (1,000 render 22 times as long as 10, measured). The caster holds an instance in some
700 bytes, and casts a million rays a second on a core. So paths go on bounce by bounce here: the
rays are cast, what was hit is handed to Mitsuba, and its lights and surfaces answer as they do its
path integrator, for the same numbers of the sampler.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import NO_ROW, Rays, Visibility
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.exact.trace import Beams, BestHits, trace_all
from scenec.backends.mitsuba.aligned import aligned_columns
from scenec.backends.mitsuba.geometry import Group, cofactors, group_surfaces, unplaced
from scenec.backends.stage.scene import RenderScene
from scenec.backends.surface.corners import vertex_color, vertex_uv
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Rays that are cast and shaded at once: some 400 bytes each.
_CHUNK = 1 << 19
#: Rays start this far above a face, as a share of 1 m and the place's distance from the center.
_OFFSET = 1e-8
#: A shadow's ray ends this share before the light.
_SHORT = 1e-4


@dataclass
class Lanes:
    """Holds the attributes of the surface at the shaded hits, for ``mix.channels_of``.

    Attributes:
        channels: Variation of the vertices, that of the row, the weight of each merge, then red,
            green and blue.
    """

    channels: list[Any] = field(default_factory=list)

    def at(self, mi: Any, channel: int, hit: Any, active: Any) -> Any:
        """One of them at hits of some numbers."""
        import drjit as dr

        if not self.channels:
            # Surfaces of another scene that is still loaded are traced, too, and never asked.
            return mi.Float(0.0)
        return dr.gather(mi.Float, self.channels[channel], hit, active)


class _Tables(NamedTuple):
    """Holds the attributes of all vertices, as ``Geometry.points`` has them, and of rows.

    Attributes:
        normals: Of shading, float32 [n, 3]; (0, 0, 0): the face's own.
        uv: float32 [n, 2].
        values: Variation, weights, and colors where there are any, float32 [n, channels - 1].
        row_values: Variation of rows, float32 [r].
    """

    normals: NDArray[np.float32]
    uv: NDArray[np.float32]
    values: NDArray[np.float32]
    row_values: NDArray[np.float32]


class InstancedScene:
    """A scene of instances, and the integrator over it.

    Args:
        mi: Mitsuba, of a JIT variant.
        scene: With one pair of texture coordinates a vertex, and no surface that gives off light.
        groups: Its rows by their materials.
        center: Of the scene: Mitsuba's positions are relative to it, meters.
        bounces: As of ``contract.BOUNCES``.
    """

    def __init__(
        self,
        mi: Any,
        scene: RenderScene,
        groups: tuple[Group, ...],
        center: NDArray[np.float64],
        bounces: int,
    ) -> None:
        # A class of Mitsuba's, which exists once its variant is set.
        from scenec.backends.mitsuba.stack import make_look

        self._mi, self._center, self._bounces = mi, center, bounces
        self._caster = ExactCaster(scene)
        self._lanes = Lanes()
        self._tables = _tables(scene)
        looks = [
            make_look(
                group_surfaces(scene, group),
                unplaced(scene, group, self._lanes),
                center,
            ).bsdf
            for group in groups
        ]
        # Their numbers; those behind them are alive as long as this is.
        self._held = looks
        self._looks = np.array([_number(mi, look) for look in looks], np.uint32)
        self._look_of_row = np.zeros(len(scene.rows.mesh), np.min_scalar_type(len(groups)))
        for number, group in enumerate(groups):
            self._look_of_row[group.rows] = number

    def pose(self, sample: int) -> None:
        """Take what moves where it is at a sample."""
        self._caster.pose(sample)

    def witness(self, rays: Rays) -> Visibility:
        """First hits: the exact caster's, which no other ray tracer bears out here."""
        row, face, _ = self._caster.cast(rays)
        return Visibility(row, face, independent=False)

    def sample(self, light: Any, sampler: Any, ray: Any) -> tuple[Any, Any]:
        """Light from surfaces along camera rays, and whether these meet any.

        Args:
            light: The scene's only emitter.
            sampler: Seeded, a sample a ray.
            ray: Relative to the center.

        Returns:
            ``mi.Color3f`` and ``mi.Bool``.
        """
        import drjit as dr

        mi = self._mi
        directions = np.array(ray.d, np.float64).T.copy()
        count = len(directions)
        origins = np.broadcast_to(np.array(ray.o, np.float64).T, (count, 3)) + self._center
        rays = Rays(origins, directions, (1, count))
        total = np.zeros((count, 3), np.float32)
        through = np.ones((count, 3), np.float32)
        # What a ray brings that leaves the scene; the sky behind the surfaces is drawn elsewhere.
        leaving = np.zeros((count, 3), np.float32)
        valid = np.zeros(count, bool)
        going = np.arange(count)
        for depth in range(self._bounces + 2):
            # As the path integrator asks for them; the last would be for Russian roulette.
            numbers = [*sampler.next_2d(), sampler.next_1d(), *sampler.next_2d()]
            sampler.next_1d()
            sampler.schedule_state()
            dr.eval(numbers)
            drawn = [np.array(values) for values in numbers]
            kept = []
            for first in range(0, len(going), _CHUNK):
                lanes = going[first : first + _CHUNK]
                row, face, _ = self._caster.cast(rays, lanes)
                met = row != NO_ROW
                total[lanes[~met]] += leaving[lanes[~met]]
                lanes = lanes[met]
                if depth == 0:
                    valid[lanes] = True
                if depth <= self._bounces and len(lanes):
                    hit = _Hits.of(self, rays, lanes, row[met], face[met])
                    shaded = self._shade(light, hit, [values[lanes] for values in drawn])
                    total[lanes] += through[lanes] * self._unshadowed(hit, shaded)
                    through[lanes] *= shaded.weight
                    leaving[lanes] = through[lanes] * shaded.leaving
                    origins[lanes] = hit.start(shaded.direction)
                    directions[lanes] = shaded.direction
                    kept.append(lanes[through[lanes].any(axis=1)])
            going = np.concatenate(kept) if kept else going[:0]
        self._lanes.channels = []
        return mi.Color3f(np.ascontiguousarray(total.T)), mi.Bool(valid)

    def guides(self, ray: Any) -> tuple[Any, Any]:
        """Albedo and normals at the first hits of camera rays, ``mi.Color3f`` each; 0 without."""
        import drjit as dr

        mi = self._mi
        directions = np.array(ray.d, np.float64).T.copy()
        count = len(directions)
        origins = np.broadcast_to(np.array(ray.o, np.float64).T, (count, 3)) + self._center
        rays = Rays(origins, directions, (1, count))
        found = np.zeros((2, 3, count), np.float32)
        for first in range(0, count, _CHUNK):
            lanes = np.arange(first, min(first + _CHUNK, count))
            row, face, _ = self._caster.cast(rays, lanes)
            met = row != NO_ROW
            lanes = lanes[met]
            if len(lanes):
                si, bsdf = self._interaction(_Hits.of(self, rays, lanes, row[met], face[met]))
                albedo = bsdf.eval_diffuse_reflectance(si)
                dr.eval(albedo)
                found[0][:, lanes] = np.array(albedo)
                found[1][:, lanes] = np.array(si.sh_frame.n)
        self._lanes.channels = []
        return mi.Color3f(found[0]), mi.Color3f(found[1])

    def _unshadowed(self, hit: _Hits, shaded: _Shaded) -> NDArray[np.float32]:
        """The light that was drawn, where nothing stands before it."""
        lit = np.flatnonzero(shaded.light.any(axis=1))
        origins = hit.start(shaded.to_light)
        none = np.full(len(lit), NO_ROW, np.int32)
        # What is found is nearer than the light.
        between = BestHits(none, np.zeros_like(none), shaded.distance[lit] * (1.0 - _SHORT))
        trace_all(self._caster.geometry, Beams(origins, shaded.to_light), lit, between)
        found = np.zeros_like(shaded.light)
        seen = lit[between.row == NO_ROW]
        found[seen] = shaded.light[seen]
        return found

    def _interaction(self, hit: _Hits) -> tuple[Any, Any]:
        """Returns Mitsuba's surface interactions at hits, and their BSDFs."""
        import drjit as dr

        mi = self._mi
        columns = [mi.Float(column) for column in hit.columns]
        count = len(hit.row)
        si = dr.zeros(mi.SurfaceInteraction3f, count)
        si.p, si.n = mi.Point3f(*columns[:3]), mi.Normal3f(*columns[3:6])
        si.sh_frame.n = mi.Normal3f(*columns[6:9])
        si.uv = mi.Point2f(*columns[9:11])
        across, along = mi.coordinate_system(si.n)
        mapped = dr.squared_norm(mi.Vector3f(*columns[11:14])) > 0.0
        si.dp_du = dr.select(mapped, mi.Vector3f(*columns[11:14]), across)
        si.dp_dv = dr.select(mapped, mi.Vector3f(*columns[14:17]), along)
        si.initialize_sh_frame()
        si.wi = si.to_local(-mi.Vector3f(*columns[17:20]))
        si.t = 1.0
        si.prim_index = dr.arange(mi.UInt32, count)
        self._lanes.channels = columns[20:]
        (which,) = aligned_columns([self._looks[self._look_of_row[hit.row]]], np.uint32)
        bsdf: Any = dr.reinterpret_array(mi.BSDFPtr, mi.UInt32(which))
        return si, bsdf

    def _shade(self, light: Any, hit: _Hits, drawn: list[NDArray[np.float32]]) -> _Shaded:
        """One step of the path integrator: light that is drawn, and the way on."""
        import drjit as dr

        # Of the variant, which is set by now.
        from scenec.backends.mitsuba import paths

        mi = self._mi
        count = len(hit.row)
        si, bsdf = self._interaction(hit)
        numbers = [mi.Float(values) for values in aligned_columns(drawn)]

        points = mi.Point2f(*numbers[:2]), numbers[2], mi.Point2f(*numbers[3:])
        shaded = paths.shade(light, si, bsdf, points, mi.Bool(True))
        dr.eval(shaded.to_light.d, shaded.to_light.dist, *shaded[1:])

        def rows(values: Any, kind: Any = np.float32) -> Any:
            # Channel by channel: all at once is another kernel for each number of hits.
            found = np.empty((count, 3), kind)
            for channel, value in enumerate(values):
                found[:, channel] = value
            return found

        return _Shaded(
            rows(shaded.to_light.d, np.float64),
            np.broadcast_to(np.array(shaded.to_light.dist, np.float64), count),
            rows(shaded.light),
            rows(shaded.direction, np.float64),
            rows(shaded.weight),
            rows(shaded.leaving),
        )


class _Shaded(NamedTuple):
    """Holds Mitsuba's results at hits.

    Attributes:
        to_light: Directions in which light was drawn, float64 [n, 3].
        distance: Of that light, meters.
        light: What it gives along the path's last ray if nothing stands before it, [n, 3].
        direction: In which the path goes on, float64 [n, 3].
        weight: What of the light from there goes along the last ray, [n, 3].
        leaving: The light from there if nothing is met, by its share beside what is drawn, [n, 3].
    """

    to_light: NDArray[np.float64]
    distance: NDArray[np.float64]
    light: NDArray[np.float32]
    direction: NDArray[np.float64]
    weight: NDArray[np.float32]
    leaving: NDArray[np.float32]


class _Hits(NamedTuple):
    """Points of surfaces.

    Attributes:
        row: int32 [n].
        places: In the world, float64 [n, 3].
        lifts: Along the face's normal to where rays start, float64 [n, 3].
        columns: Of each point: place relative to the center, normal of the face and of shading,
            texture coordinates, dP/du and dP/dv or zeros, the ray's unit direction, and
            ``Lanes.channels``, float32 [20 + channels, n].
    """

    row: NDArray[np.int32]
    places: NDArray[np.float64]
    lifts: NDArray[np.float64]
    columns: NDArray[np.float32]

    @staticmethod
    def of(
        scene: InstancedScene,
        rays: Rays,
        lanes: NDArray[np.int64],
        row: NDArray[np.int32],
        face: NDArray[np.int32],
    ) -> _Hits:
        tables = scene._tables
        places, lifts = np.empty((2, len(lanes), 3))
        columns = aligned_columns(np.empty((21 + tables.values.shape[1], len(lanes)), np.float32))
        over_threads(
            _interact, len(lanes), scene._caster.geometry, tables,
            Beams(rays.origins, rays.directions), (lanes, row, face), scene._center,
            (places, lifts, columns),
        )  # fmt: skip
        return _Hits(row, places, lifts, columns)

    def start(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the origins of rays in these directions, on their side of the face."""
        above = (self.lifts * directions).sum(axis=1)
        return self.places + np.sign(above)[:, None] * self.lifts


def _number(mi: Any, bsdf: Any) -> int:
    import drjit as dr

    return int(np.array(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf)))[0])


def _tables(scene: RenderScene) -> _Tables:
    meshes = scene.meshes
    count = sum(len(mesh.points) for mesh in meshes)
    normals, uv = np.zeros((count, 3), np.float32), np.zeros((count, 2), np.float32)
    merges = max((len(mesh.weights) for mesh in meshes), default=0)
    colored = any(mesh.color is not None for mesh in meshes)
    values = np.zeros((count, 1 + merges + 3 * colored), np.float32)
    first = 0
    for mesh in meshes:
        own = slice(first, first + len(mesh.points))
        first = own.stop
        if mesh.normals is not None:
            normals[own] = mesh.normals
        uv[own] = vertex_uv(mesh)
        if mesh.variation is not None:
            values[own, 0] = mesh.variation
        values[own, 1 : 1 + len(mesh.weights)] = mesh.weights.T
        if colored:
            values[own, 1 + merges :] = vertex_color(mesh)
    return _Tables(normals, uv, values, scene.rows.variation.astype(np.float32))


@kernel
def _unit(v):  # type: ignore[no-untyped-def]
    length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return v / length if length > 0.0 else v


@kernel
def _corners(g, row, vertices):  # type: ignore[no-untyped-def]
    """Returns the corners of a face in the world, [3, 3]."""
    m = g.to_world[row]
    corners = np.empty((3, 3))
    for c in range(3):
        x, y, z = g.points[vertices[c]]
        for i in range(3):
            corners[c, i] = m[i, 0] * x + m[i, 1] * y + m[i, 2] * z + m[i, 3]
    return corners


@kernel
def _shares(origin, way, corner, p, q, normal):  # type: ignore[no-untyped-def]
    """Returns barycentric shares where a ray crosses the plane of a face, clamped into the face."""
    steep = -(normal * way).sum()
    v = w = 0.0
    if steep != 0.0:
        across = np.cross(way, corner - origin)
        v = min(max((across * q).sum() / steep, 0.0), 1.0)
        w = min(max(-(across * p).sum() / steep, 0.0), 1.0 - v)
    return 1.0 - v - w, v, w


@kernel
def _interact(begin, end, g, tables, beams, hits, center, out):  # type: ignore[no-untyped-def]
    """``_Hits`` of rays and the faces they meet.

    Args:
        begin, end: Which hits.
        g: ``bvh.Geometry``.
        tables: ``_Tables``.
        beams: The rays.
        hits: Of each, the ray, int64 [n]; row and face, int32 [n].
        center: Of the scene as Mitsuba has it, float64 [3].
        out: Receives ``places``, ``lifts`` and ``columns``.
    """
    lanes, row, face = hits
    places, lifts, columns = out
    for k in range(begin, end):
        vertices = g.faces[g.row_face[row[k]] + face[k]]
        corners = _corners(g, row[k], vertices)
        turn, side = cofactors(g.to_world[row[k]])
        p, q = corners[1] - corners[0], corners[2] - corners[0]
        normal = np.cross(p, q)
        # A mirrored row turns the winding; turn it back, as flattened meshes have it.
        unit = side * _unit(normal)
        way = beams.directions[lanes[k]]
        shares = _shares(beams.origins[lanes[k]], way, corners[0], p, q, normal)
        local = np.zeros(3)
        uv = np.zeros((3, 2))
        columns[20:, k] = 0.0
        columns[21, k] = tables.row_values[row[k]]
        for c in range(3):
            local += shares[c] * tables.normals[vertices[c]]
            uv[c] = tables.uv[vertices[c]]
            for i in range(tables.values.shape[1]):
                columns[20 if i == 0 else 21 + i, k] += shares[c] * tables.values[vertices[c], i]
        shading = np.zeros(3)
        for i in range(3):
            for j in range(3):
                shading[i] += side * turn[i, j] * local[j]
        shading = _unit(shading)
        if not shading.any():
            shading = unit
        place = corners[0] + shares[1] * p + shares[2] * q
        places[k] = place
        lifts[k] = (_OFFSET * (1.0 + np.abs(place).max())) * unit
        heading = _unit(way)
        uv1, uv2 = uv[1] - uv[0], uv[2] - uv[0]
        area = uv1[0] * uv2[1] - uv1[1] * uv2[0]
        for i in range(3):
            columns[i, k] = place[i] - center[i]
            columns[3 + i, k] = unit[i]
            columns[6 + i, k] = shading[i]
            columns[11 + i, k] = (uv2[1] * p[i] - uv1[1] * q[i]) / area if area != 0.0 else 0.0
            columns[14 + i, k] = (uv1[0] * q[i] - uv2[0] * p[i]) / area if area != 0.0 else 0.0
            columns[17 + i, k] = heading[i]
        for i in range(2):
            columns[9 + i, k] = uv[0, i] + shares[1] * uv1[i] + shares[2] * uv2[i]
