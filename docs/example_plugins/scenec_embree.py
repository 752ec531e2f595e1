"""A renderer: Embree traces the rays, NumPy does the rest (``pip install embreex``).

It draws diffuse surfaces in layers, suns and skies, light from surface to surface, and objects that
move. What it does not draw it lists as losses, of which users are warned.
"""

from importlib.metadata import version

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from scenec.backends.contract import BOUNCES, NO_ROW, Backend, Radiance, Visibility
from scenec.backends.picture.sky import combine, lookup
from scenec.backends.stage.scene import DEFAULT_SURFACE
from scenec.schemas.errors import BackendError

#: Rays that are traced at once.
AT_ONCE = 1 << 18


class Embree(Backend):
    """Diffuse surfaces in the light of suns and skies, by path tracing."""

    name = "embree"
    devices = ("cpu",)

    def __init__(self, device="auto"):
        self.device = "cpu"
        self._scene = None

    def version(self):
        """Stands in sidecars: another version renders again."""
        return f"embreex {version('embreex')}"

    def losses(self, scene):
        """Names what of the scene it leaves out."""
        surfaces = [scene.surfaces[i] for mesh in scene.meshes for i in mesh.layers]
        said = {
            "embree draws no maps": any(s.maps for s in surfaces),
            "embree draws no gloss and no metal": any(s.glossy for s in surfaces),
            "embree draws Lambert's law alone": any(s.reflectance for s in surfaces),
            "embree's surfaces give off no light": any(s.emits for s in surfaces),
            "embree lets no light through sheets": any(s.transmits for s in surfaces),
            "embree has no lamps": any(light.lamps for light in scene.lighting),
            "embree's suns have no clouds before them": any(
                sun.gobo for light in scene.lighting for sun in light.suns
            ),
        }
        return tuple(line for line, lost in said.items() if lost)

    def load(self, scene):
        """Takes a batch; triangles are written out for each sample."""
        self._scene, self._posed = scene, None

    def witness(self, rays, sample, camera=None):
        """Returns its own first hits, which checks hold against the annotation."""
        self._pose(sample)
        hit = self._trace(rays.origins - self._center, rays.directions)["primID"]
        row, face = self._names[:, hit]
        return Visibility(np.where(hit < 0, NO_ROW, row), np.where(hit < 0, 0, face))

    def radiance(self, camera, sample, spp, seed, denoise=False):
        """Returns the light of surfaces in two halves, whose difference tells the noise."""
        self._pose(sample)
        each = max(1, (spp + 1) // 2)
        seeds = (np.random.default_rng((seed, half)) for half in range(2))
        halves = [self._half(camera, sample, each, rng) for rng in seeds]
        light, coverage = (np.stack(parts) for parts in zip(*halves, strict=True))
        return Radiance(light.astype(np.float32), coverage.mean(0).astype(np.float32), 2 * each)

    def _pose(self, sample):
        """Write all triangles out, about the scene's middle, as they are at a sample."""
        scene = self._scene
        if scene is None:
            raise BackendError("embree: no scene is loaded; call load first")
        if self._posed is not None and (scene.rows.motion is None or self._posed == sample):
            return
        rows = scene.rows_at(sample)
        self._center, self._posed = scene.bounds.mean(axis=0), sample
        parts = [self._triangles(rows, index) for index in range(len(scene.meshes))]
        names, corners, self._normals, self._colors = (
            np.concatenate(part) for part in zip(*parts, strict=True)
        )
        # One more, for rays that meet nothing.
        self._names = np.append(names, [[NO_ROW, 0]], axis=0).T.astype(np.int32)
        self._embree = EmbreeScene()
        TriangleMesh(self._embree, corners.astype(np.float32))

    def _triangles(self, rows, index):
        """Rows and faces of a mesh's instances [n, 2]; corners, normals and colors [n, 3, 3]."""
        mesh, own = self._scene.meshes[index], np.flatnonzero(rows.mesh == index)
        linear, offset = rows.to_world[own, :, :3], rows.to_world[own, :, 3] - self._center
        points = np.einsum("rij,nj->rni", linear, mesh.points) + offset[:, None]
        corners = points[:, mesh.faces]
        a, b, c = np.moveaxis(corners, 2, 0)
        normals = np.repeat(np.cross(b - a, c - a)[:, :, None], 3, axis=2)
        if mesh.normals is not None:
            # The inverse transpose, but for its scale, which flattened rows have too.
            cofactors = np.cross(np.roll(linear, -1, axis=1), np.roll(linear, -2, axis=1))
            normals = np.einsum("rij,nj->rni", cofactors, mesh.normals)[:, mesh.faces]
        vertex = np.zeros(len(mesh.points)) if mesh.variation is None else mesh.variation
        color = None
        for number, layer in enumerate(mesh.layers or (None,)):
            surface = DEFAULT_SURFACE if layer is None else self._scene.surfaces[layer]
            factor = 1 + surface.variation * np.stack(
                np.meshgrid(vertex, rows.variation[own]), axis=-1
            )
            dull = np.clip(np.array(surface.base_color) * factor.prod(axis=2)[..., None], 0, 1)
            weight = 1.0 if color is None else mesh.weights[number - 1][:, None]
            color = dull if color is None else (1 - weight) * color + weight * dull
        color = color[:, mesh.faces] * (1 if mesh.color is None else mesh.color)
        face, row = np.meshgrid(np.arange(len(mesh.faces)), own)
        tables = (corners, normals, color)
        return np.stack([row.ravel(), face.ravel()], 1), *(t.reshape(-1, 3, 3) for t in tables)

    def _trace(self, origins, directions, query="INTERSECT"):
        """First hits, or with "OCCLUDED" whether there are any."""
        rays = (np.ascontiguousarray(table, np.float32) for table in (origins, directions))
        return self._embree.run(*rays, query=query, output=query == "INTERSECT")

    def _half(self, camera, sample, spp, rng):
        """Light of surfaces [h, w, 3] and coverage [h, w], each the mean of spp samples."""
        shape = (camera.height, camera.width)
        pixels = shape[0] * shape[1]
        light, hits = np.zeros((pixels, 3)), np.zeros(pixels)
        most = max(1, AT_ONCE // pixels)
        for done in range(0, spp, most):
            pixel = np.repeat(np.arange(pixels), min(most, spp - done))
            k, pose = camera.intrinsics, camera.camera_to_world
            u, v = np.array([pixel % shape[1], pixel // shape[1]]) + rng.random((2, len(pixel)))
            y = (v - k[1, 2]) / k[1, 1]
            x = (u - k[0, 2] - k[0, 1] * y) / k[0, 0]
            directions = np.stack([x, y, np.ones_like(x)], axis=1) @ pose[:3, :3].T
            origins = np.broadcast_to(pose[:3, 3] - self._center, directions.shape)
            self._paths(self._scene.lighting[sample], pixel, origins, directions, light, hits, rng)
        return (light / spp).reshape(*shape, 3), (hits / spp).reshape(shape)

    def _paths(self, lighting, pixel, origins, directions, light, hits, rng):
        """Follow paths from the camera; add what they bring to light and hits of pixels."""
        sky, share = combine(lighting.domes), np.ones((len(pixel), 3))
        for surface in range(BOUNCES + 2):
            hit = self._trace(origins, directions)
            there = hit["primID"] >= 0
            if surface > 0 and sky is not None:
                radiance = lookup(sky, np.ascontiguousarray(directions[~there]))
                np.add.at(light, pixel[~there], share[~there] * radiance)
            if surface > BOUNCES or not there.any():
                return
            pixel, share, directions = pixel[there], share[there], directions[there]
            face, t, second, third, geometric = (
                hit[name][there] for name in ("primID", "tfar", "u", "v", "Ng")
            )
            if surface == 0:
                np.add.at(hits, pixel, 1.0)
            between = np.stack([1 - second - third, second, third], axis=1)[..., None]
            share = share * (between * self._colors[face]).sum(axis=1)
            # Both normals to the side that is seen.
            facing = _unit(geometric) * -np.sign((geometric * directions).sum(axis=1))[:, None]
            normal = _unit((between * self._normals[face]).sum(axis=1))
            normal *= np.sign((normal * facing).sum(axis=1))[:, None]
            points = origins[there] + t[:, None] * directions
            origins = points + 1e-5 * np.abs(points).max(initial=1e-9) * facing
            for sun in lighting.suns:
                toward = _in_cone(sun.to_light, 0.5 * sun.diameter_rad, len(points), rng)
                cosine = np.maximum((normal * toward).sum(axis=1), 0.0)
                cosine *= (facing * toward).sum(axis=1) > 0.0
                cosine *= self._trace(origins, toward, "OCCLUDED") < 0
                np.add.at(light, pixel, share * (cosine / np.pi)[:, None] * sun.irradiance)
            # By the cosine: a point on the unit sphere about the normal's end.
            ball = rng.normal(size=points.shape)
            directions = _unit(normal + _unit(ball))
            share *= ((facing * directions).sum(axis=1) > 0.0)[:, None]


def _unit(vectors):
    length = np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    return vectors / np.maximum(length, 1e-30)


def _in_cone(axis, half_angle, count, rng):
    """Directions evenly over a disc of the sky."""
    first = _unit(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]))
    cosine = 1.0 - rng.random((count, 1)) * (1.0 - np.cos(half_angle))
    angle = 2.0 * np.pi * rng.random((count, 1))
    around = np.cos(angle) * first + np.sin(angle) * np.cross(axis, first)
    return cosine * axis + np.sqrt(1.0 - cosine * cosine) * around
