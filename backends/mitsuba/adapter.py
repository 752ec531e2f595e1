"""The Mitsuba backend: visibility by ray queries, radiance by its path integrator."""

from __future__ import annotations

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.lens import RayTable, ray_table
from scenec.backends.contract import (
    BOUNCES,
    NO_ROW,
    Backend,
    LoadCost,
    Radiance,
    Rays,
    Visibility,
)
from scenec.backends.mitsuba import geometry, variant
from scenec.backends.mitsuba.aligned import aligned
from scenec.backends.mitsuba.instanced import InstancedScene
from scenec.backends.noise_seeds import half_seed
from scenec.backends.picture import denoise as oidn
from scenec.backends.stage.posing import posable, pose
from scenec.backends.stage.scene import Camera, Lighting, RenderScene
from scenec.backends.surface.corners import split_corners
from scenec.schemas.errors import BackendError

#: Samples in flight at once; above it a half is rendered in several passes (16 bytes a sample).
MAX_WAVEFRONT = 1 << 25
#: Where paths are gathered: 160 bytes a sample.
MAX_GATHERED = 1 << 22
#: Where instances are kept: 150 bytes a sample.
MAX_KEPT = 1 << 21
#: Samples per pixel of what guides the denoiser.
GUIDE_SPP = 16


class _LoadCost(LoadCost):
    """Surfaces that give off light have to be written out."""

    def keeps(self, scene: RenderScene) -> bool:
        return super().keeps(scene) and not any(surface.emits for surface in scene.surfaces)


class Mitsuba(Backend):
    """Implements ``contract.Backend``: ``load`` once, then any number of samples.

    Light is built at the first radiance call, so annotation alone never pays for it; visibility
    and radiance share one scene, in which sky and suns have no geometry.
    """

    name = "mitsuba"
    devices = ("cpu", "cuda")
    denoiser = oidn.installed()
    denoiser_extra = "denoise"
    follows_lenses = True
    continues = True
    load_cost = _LoadCost(row=900.0, triangle=250.0, written=170.0, most_written=4e9)

    def __init__(self, bounces: int = BOUNCES, device: str = "auto") -> None:
        self._mi = variant.load_mitsuba(device)
        self.device = "cuda" if self._mi.variant().startswith("cuda") else "cpu"
        self._bounces = bounces
        # It is of the variant, which is set by now.
        self._sampler = importlib.import_module("scenec.backends.mitsuba.sampler").Sobol
        self._scene: Any = None
        self._kept: InstancedScene | None = None
        self._meshes: list[Any] = []
        self._render_scene: RenderScene | None = None
        self._groups: tuple[geometry.Group, ...] = ()
        self._center = np.zeros(3)
        self._light: Any = None
        self._lamps: Any = None
        self._glows: dict[int, Any] = {}
        self._lit_sample: int | None = None
        self._posed = 0
        self._integrator: Any = None
        self._dropped = 0
        self._table: RayTable | None = None
        #: Camera, sample, seed, and the denoiser's guides.
        self._guided: tuple[Camera, int, int, Any] | None = None
        self._uploaded: tuple[RayTable, list[Any]] | None = None

    def version(self) -> str:
        """Renderer, variant and integrator: whatever decides the picture."""
        return f"mitsuba {self._mi.__version__} {self._mi.variant()} path{self._bounces} sobol"

    def load(self, scene: RenderScene) -> None:
        """Flatten the scene and build Mitsuba's hierarchy over it, or keep too many instances.

        Raises:
            BackendError: The scene holds more than Mitsuba can address.
        """
        mi = self._mi
        scene = split_corners(scene)
        # The center is that of all samples.
        self._center = geometry.scene_center(scene)
        self._render_scene = scene = posable(scene)
        self._posed = 0
        self._groups = geometry.make_groups(scene)
        self._lit_sample = None
        self._glows = {}
        self._kept, self._meshes, self._guided = None, [], None
        if self.load_cost.keeps(scene):
            self._emitters(scene)
            self._kept = InstancedScene(mi, scene, self._groups, self._center, self._bounces)
            return
        self._meshes = [self._mesh(scene, group, i) for i, group in enumerate(self._groups)]
        parts: dict[str, Any] = {"type": "scene"}
        parts |= {f"mesh{i}": mesh for i, mesh in enumerate(self._meshes)}
        parts |= self._emitters(scene)
        # Merging equal meshes would renumber the faces that the witness names.
        self._scene = mi.load_dict(parts, optimize=False)
        # For a GPU, and for surfaces that give off light: ``paths`` does not look for them.
        self._integrator = mi.load_dict(
            {
                # The former does not look through what is cut out for light.
                "type": "volpath" if self._cut else "path",
                "max_depth": self._bounces + 2,
                # No Russian roulette before paths end anyway: it adds noise, saves little.
                "rr_depth": self._bounces + 3,
                # What gives off light is to be seen; ``_pass`` leaves out the sky itself then.
                "hide_emitters": not self._glows,
            }
        )

    def _emitters(self, scene: RenderScene) -> dict[str, Any]:
        """One that has all light; without any, one that is black."""
        # Classes of Mitsuba's, which exist once its variant is set.
        from scenec.backends.mitsuba import emitter, lamps

        mi = self._mi
        self._light = self._lamps = None
        with_lamps = any(lighting.lamps for lighting in scene.lighting)
        if not with_lamps or any(lighting.suns or lighting.domes for lighting in scene.lighting):
            self._light = mi.load_dict({"type": emitter.PLUGIN})
        if with_lamps:
            self._lamps = mi.load_dict({"type": lamps.PLUGIN})
            self._lamps.around = self._light
        self._set_light(Lighting((), ()))
        return {"light": self._emitter()}

    def _gathers(self) -> bool:
        """Whether paths are gathered after a bounce: not on a GPU, where nobody has tried it."""
        return self.device == "cpu" and not self._glows

    @property
    def _cut(self) -> bool:
        return self._loaded().has_cutouts

    @property
    def _meet(self) -> Any:
        """Finds first hits of rays with the scene."""
        if not self._cut:
            return self._mi.Scene.ray_intersect_preliminary
        # Of the variant, which is set by now.
        from scenec.backends.mitsuba import cutouts

        return cutouts.meet

    def _emitter(self) -> Any:
        return self._light if self._lamps is None else self._lamps

    def _set_light(self, lighting: Lighting) -> None:
        if self._lamps is not None:
            self._lamps.set_lighting(lighting, self._center)
        else:
            self._light.set_lighting(lighting, self._center)

    def witness(self, rays: Rays, sample: int, camera: Camera | None = None) -> Visibility:
        """First hits in float32; of kept instances the exact caster's."""
        self._pose(self._loaded(), sample)
        if self._kept is not None:
            return self._kept.witness(rays)
        import drjit as dr

        mi = self._mi
        n = len(rays.directions)
        origins = np.ascontiguousarray((rays.origins - self._center).T, np.float32)
        directions = np.ascontiguousarray(rays.directions.T, np.float32)
        ray = mi.Ray3f(mi.Point3f(origins), mi.Vector3f(directions))
        hit = self._meet(self._scene, ray, coherent=True)
        shape = dr.reinterpret_array(mi.UInt32, dr.select(hit.is_valid(), hit.shape, None))
        prim = mi.UInt32(hit.prim_index)
        dr.eval(shape, prim)
        shapes, prims = np.array(shape), np.array(prim)
        row = np.full(n, NO_ROW, np.int32)
        face = np.zeros(n, np.int32)
        for mesh, group in zip(self._meshes, self._groups, strict=True):
            own = int(np.array(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(mesh)))[0])
            index = np.flatnonzero(shapes == own)
            row[index], face[index] = group.locate(prims[index])
        return Visibility(row, face)

    def radiance(
        self,
        camera: Camera,
        sample: int,
        spp: int,
        seed: int,
        denoise: bool = False,
        first: int = 0,
    ) -> Radiance:
        """Surface light in two independent halves of ceil(spp / 2) samples a pixel each.

        Each half is a sequence of well-spread samples of its own (``mitsuba.sampler``): what the
        halves differ by tells the error of their mean.

        Box filter: the plain mean of samples placed anywhere in the pixel. The camera may have any
        K, skew included, and a lens, between whose rays on a lattice (``camera.lens``) samples are
        interpolated.
        """
        scene = self._loaded()
        self._pose(scene, sample)
        each = max(1, (spp + 1) // 2)
        halves = np.empty((2, camera.height, camera.width, 3), np.float32)
        coverage = np.zeros((camera.height, camera.width))
        self._table = None if camera.lens is None else ray_table(camera)
        if self._lit_sample != sample:
            self._set_light(scene.lighting[sample])
            self._lit_sample = sample
        if self._light is not None:
            # What goes on shares samples as what went before did.
            self._light.split(each if first == 0 else 4)
        self._dropped = 0
        for half in range(2):
            halves[half], alpha = self._half(camera, first // 2, each, half_seed(seed, half))
            coverage += 0.5 * alpha
        covered = np.minimum(coverage, 1.0).astype(np.float32)
        if self._table is not None:
            halves[:, ~self._table.known] = 0.0
            covered[~self._table.known] = 0.0
        made = Radiance(halves, covered, 2 * each, self._dropped)
        return self.denoise(camera, sample, made, seed) if denoise else made

    def denoise(self, camera: Camera, sample: int, radiance: Radiance, seed: int) -> Radiance:
        """A picture, each of its halves denoised apart, guided by what its pixels see."""
        if (
            self._guided is None
            or self._guided[0] is not camera
            or self._guided[1:3] != (sample, seed)
        ):
            self._pose(self._loaded(), sample)
            self._table = None if camera.lens is None else ray_table(camera)
            self._guided = (camera, sample, seed, self._guides(camera, half_seed(seed, 2)))
        halves = oidn.denoise(radiance.halves, radiance.coverage, *self._guided[3])
        mean = halves.mean(axis=0, dtype=np.float32)
        return replace(radiance, denoised=mean, denoised_halves=halves)

    def _half(
        self, camera: Camera, first: int, spp: int, seed: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        light = np.zeros((camera.height, camera.width, 3))
        alpha = np.zeros((camera.height, camera.width))
        most = MAX_GATHERED if self._gathers() else MAX_WAVEFRONT
        most = most if self._kept is None else MAX_KEPT
        for count in split_samples(spp, camera.width * camera.height, most):
            light_sum, alpha_sum = self._pass(camera, first, count, seed)
            light += light_sum
            alpha += alpha_sum
            first += count
        return (light / spp).astype(np.float32), (alpha / spp).astype(np.float32)

    def _pass(
        self, camera: Camera, first: int, spp: int, seed: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Sums over ``spp`` samples of each pixel: light [h, w, 3] and surface hits [h, w]."""
        import drjit as dr

        mi = self._mi
        pixels = camera.width * camera.height
        ray, sampler = self._rays(camera, first, spp, seed)
        if self._kept is not None:
            light, valid = self._kept.sample(self._emitter(), sampler, ray)
        elif self._gathers():
            # Of the variant, as the sampler is.
            from scenec.backends.mitsuba import paths

            light, valid = paths.sample(
                self._scene, self._emitter(), sampler, ray, self._bounces,
                self._meet if self._cut else None,
            )  # fmt: skip
        else:
            light, valid, _ = self._integrator.sample(self._scene, sampler, ray)
        if self._glows or (self._cut and not self._gathers()):
            valid = self._meet(self._scene, ray, coherent=True).is_valid()
        light &= valid
        # On float32 slivers a path's light can overflow or come out negative: it counts as black,
        # and is counted.
        sound = dr.all(dr.isfinite(light) & (light >= 0.0))
        light = dr.select(sound, light, 0.0)
        hit = dr.select(valid, mi.Float(1.0), 0.0)
        # In one go: block_sum evaluates its argument alone, which would trace every path again.
        dr.eval(light, hit, sound)
        self._dropped += pixels * spp - int(np.count_nonzero(np.array(sound)))
        sums = [dr.block_sum(channel, spp) for channel in (light.x, light.y, light.z)]
        hits = dr.block_sum(hit, spp)
        shape = (camera.height, camera.width)
        stacked = np.stack([np.array(channel).reshape(shape) for channel in sums], axis=-1)
        return stacked, np.array(hits).reshape(shape)

    def _guides(self, camera: Camera, seed: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Albedo and normals that pixels see first, float32 [h, w, 3] each; 0 of the sky."""
        import drjit as dr

        shape = (camera.height, camera.width)
        sums = np.zeros((6, *shape))
        most = MAX_WAVEFRONT if self._kept is None else MAX_KEPT
        first = 0
        for count in split_samples(GUIDE_SPP, shape[0] * shape[1], most):
            ray, _ = self._rays(camera, first, count, seed)
            first += count
            if self._kept is not None:
                albedo, normal = self._kept.guides(ray)
            else:
                hit = self._meet(self._scene, ray, coherent=True)
                si = hit.compute_surface_interaction(ray)
                met = si.is_valid()
                albedo = dr.select(met, si.bsdf(ray).eval_diffuse_reflectance(si, met), 0.0)
                normal = dr.select(met, si.sh_frame.n, 0.0)
            dr.eval(albedo, normal)
            for number, channel in enumerate((*albedo, *normal)):
                sums[number] += np.array(dr.block_sum(channel, count)).reshape(shape)
        means = np.moveaxis(sums / GUIDE_SPP, 0, -1).astype(np.float32)
        return np.ascontiguousarray(means[..., :3]), np.ascontiguousarray(means[..., 3:])

    def _rays(self, camera: Camera, first: int, spp: int, seed: int) -> tuple[Any, Any]:
        """Rays anywhere through each pixel, ``spp`` in a row, and the sampler they are drawn of.

        Args:
            camera: Whose.
            first: Sample of each pixel's sequence that comes first.
            spp: How many.
            seed: Of the noise.
        """
        import drjit as dr

        mi = self._mi
        lane = dr.arange(mi.UInt32, camera.width * camera.height * spp)
        # Opaque, or every number of samples and every seed is a kernel of its own to compile.
        each = dr.opaque(mi.UInt32, spp)
        pixel = lane // each
        index = lane - pixel * each + dr.opaque(mi.UInt32, first)
        sampler = self._sampler(dr.opaque(mi.UInt32, seed), pixel, index)
        return self._camera_rays(camera, pixel, sampler.next_2d()), sampler

    def _camera_rays(self, camera: Camera, pixel: Any, jitter: Any) -> Any:
        import drjit as dr

        mi = self._mi
        k, pose = camera.intrinsics, camera.camera_to_world

        def number(value: float) -> Any:
            # Opaque, so that another camera is not another kernel to compile.
            return dr.opaque(mi.Float, float(value))

        width = dr.opaque(mi.UInt32, camera.width)
        v = pixel // width
        u = pixel - v * width
        axes = [mi.Vector3f(*(number(value) for value in pose[:3, i])) for i in range(3)]
        origin = mi.Point3f(*(number(value) for value in pose[:3, 3] - self._center))
        if self._table is not None:
            x, y, z = self._lens_rays(self._table, u, v, jitter)
            direction = dr.normalize(axes[0] * x + axes[1] * y + axes[2] * z)
            return mi.RayDifferential3f(origin, direction)
        # The whole column minus cx first: exact, where u + jitter would round the jitter.
        y = (mi.Float(v) - number(k[1, 2]) + jitter.y) * number(1.0 / k[1, 1])
        x = (mi.Float(u) - number(k[0, 2]) + jitter.x - number(k[0, 1]) * y) * number(1.0 / k[0, 0])
        direction = dr.normalize(axes[0] * x + axes[1] * y + axes[2])
        return mi.RayDifferential3f(origin, direction)

    def _lens_rays(self, table: RayTable, u: Any, v: Any, jitter: Any) -> tuple[Any, Any, Any]:
        """Rays of samples of pixels, camera axes, bilinear between those of the table."""
        import drjit as dr

        mi = self._mi
        if self._uploaded is None or self._uploaded[0] is not table:
            flat = table.directions.reshape(-1, 3)
            self._uploaded = table, [mi.Float(np.ascontiguousarray(flat[:, c])) for c in range(3)]
        channels = self._uploaded[1]
        fine = dr.opaque(mi.UInt32, table.per_pixel)
        columns = dr.opaque(mi.UInt32, table.directions.shape[1])
        a, b = jitter.x * mi.Float(fine), jitter.y * mi.Float(fine)
        i, j = dr.minimum(mi.UInt32(a), fine - 1), dr.minimum(mi.UInt32(b), fine - 1)
        a, b = a - mi.Float(i), b - mi.Float(j)
        at = (v * fine + j) * columns + u * fine + i

        def between(channel: Any) -> Any:
            top = dr.lerp(dr.gather(mi.Float, channel, at), dr.gather(mi.Float, channel, at + 1), a)
            below = at + columns
            bottom = dr.lerp(
                dr.gather(mi.Float, channel, below), dr.gather(mi.Float, channel, below + 1), a
            )
            return dr.lerp(top, bottom, b)

        x, y, z = (between(channel) for channel in channels)
        return x, y, z

    def _mesh(self, scene: RenderScene, group: geometry.Group, index: int) -> Any:
        from scenec.backends.mitsuba import glow
        from scenec.backends.mitsuba.stack import make_look

        mi = self._mi
        vertices, faces = int(group.first_vertex[-1]), int(group.first_face[-1])
        if max(3 * vertices, 3 * faces) >= 1 << 32:
            raise BackendError(
                f"mitsuba: {faces:,} triangles of one material are more than it can address; "
                "use fewer or coarser objects"
            )
        flat = geometry.flatten(scene, group, self._center)
        surfaces = geometry.group_surfaces(scene, group)
        look = make_look(surfaces, flat, self._center)
        props = mi.Properties()
        props["bsdf"] = look.bsdf
        if look.glow is not None:
            weight = glow.light_share(scene, surfaces, flat)
            self._glows[index] = glow.make_emitter(look.glow, weight)
            props["emitter"] = self._glows[index]
        mesh = mi.Mesh(
            f"mesh{index}",
            vertices,
            faces,
            props=props,
            has_vertex_normals=group.smooth,
            has_vertex_texcoords=flat.texcoords is not None,
        )
        params = mi.traverse(mesh)
        params["vertex_positions"] = flat.points.ravel()
        params["faces"] = flat.faces.ravel()
        if flat.normals is not None:
            params["vertex_normals"] = flat.normals.ravel()
        if flat.texcoords is not None:
            params["vertex_texcoords"] = aligned(flat.texcoords).ravel()
        params.update()
        for name, values in look.attributes.items():
            mesh.add_attribute(name, values.shape[1], np.ascontiguousarray(values).ravel())
        if index in self._glows:
            self._glows[index].place(mesh, flat)
        return mesh

    def _pose(self, scene: RenderScene, sample: int) -> None:
        """Put what moves where it is at a sample; other meshes stay."""
        if scene.rows.motion is None or sample == self._posed:
            return
        pose(scene, sample)
        self._posed = sample
        if self._kept is not None:
            self._kept.pose(sample)
            return
        moving = [i for i, group in enumerate(self._groups) if group.moving]
        params = self._mi.traverse(self._scene)
        for index in moving:
            flat = geometry.flatten(scene, self._groups[index], self._center)
            params[f"mesh{index}.vertex_positions"] = flat.points.ravel()
            # A mirror image turns the winding.
            params[f"mesh{index}.faces"] = flat.faces.ravel()
            if flat.normals is not None:
                params[f"mesh{index}.vertex_normals"] = flat.normals.ravel()
            if flat.texcoords is not None:
                params[f"mesh{index}.vertex_texcoords"] = aligned(flat.texcoords).ravel()
            if index in self._glows:
                self._glows[index].place(self._meshes[index], flat)
        params.update()

    def _loaded(self) -> RenderScene:
        if self._render_scene is None:
            raise BackendError("mitsuba: no scene is loaded; call load first")
        return self._render_scene


def split_samples(spp: int, pixels: int, most: int) -> list[int]:
    """Split a sample count into near-equal passes that fit a wavefront each."""
    passes = max(1, -(-spp * pixels // most))
    passes = min(passes, spp)
    return [spp // passes + (i < spp % passes) for i in range(passes)]
