"""The pyrender backend: visibility by drawn ids, radiance as a quick preview."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.tiles import by_columns
from scenec.backends.contract import NO_ROW, Backend, LoadCost, Radiance, Rays, Visibility
from scenec.backends.pyrender import geometry, platforms
from scenec.backends.pyrender.ambience import (
    CELLS,
    Ambience,
    Ground,
    is_flat,
    light_ground,
    make_ground,
    view_from_above,
    world_bounds,
)
from scenec.backends.pyrender.camera import camera_view, pixel_rays
from scenec.backends.pyrender.canopy import make_canopy
from scenec.backends.pyrender.detail import add_levels
from scenec.backends.pyrender.lamps import lamp_shadow_maps
from scenec.backends.pyrender.lighting import CASCADES, DARK, fit_shadow_maps, losses, smooth_sky
from scenec.backends.pyrender.points import DrawnView, face_normals, find_points, resolve
from scenec.backends.pyrender.tables import Tables, make_tables, place_maps
from scenec.backends.pyrender.tiles import without_glow
from scenec.backends.stage import posing
from scenec.backends.stage.scene import Camera, RenderScene, Sun
from scenec.backends.surface.corners import split_corners
from scenec.schemas.errors import BackendError, CameraRefusedError
from scenec.schemas.kernels import kernel

if TYPE_CHECKING:
    from scenec.backends.pyrender.renderer import Renderer

#: Most samples on a side of a pixel.
MAX_SIDE = 4
#: Samples drawn at once, 12 bytes each; of larger pictures one band of rows after the other.
MAX_SAMPLES = 1 << 23
#: What makes no difference to a preview, in pixels.
DETAIL = 1.0


class Pyrender(Backend):
    """Implements ``contract.Backend``: ``load`` once, then any number of samples.

    Args:
        device: "cpu" (software), "cuda" (an NVIDIA GPU), or "auto".
        culling: Whether to leave out what is not in view; for benchmarks and tests.

    Raises:
        BackendError: No OpenGL here, or not on this device.
    """

    name = "pyrender"
    devices = ("cpu", "cuda")
    load_cost = LoadCost(row=500.0, triangle=200.0)
    stochastic = False

    def __init__(self, device: str = "auto", culling: bool = True) -> None:
        self._context = platforms.acquire(device)
        self.device = self._context.device
        self._culling = culling
        self._scene: RenderScene | None = None
        self._geometry = geometry.EMPTY
        self._renderer: Renderer | None = None
        self._posed = 0
        self._tables: Tables | None = None
        self._normals = np.zeros((0, 3), np.float32)
        self._ground: Ground | None = None
        self._ambience: tuple[int, Ambience] | None = None

    def version(self) -> str:
        """pyrender, how its context came about, and what OpenGL calls itself."""
        import pyrender

        return f"pyrender {pyrender.__version__} {self._context.name} {self._context.renderer}"

    def losses(self, scene: RenderScene) -> tuple[str, ...]:
        """Lists what the preview leaves out of this scene."""
        return losses(scene)

    def load(self, scene: RenderScene) -> None:
        """Cut the scene up and bring its meshes to OpenGL.

        Raises:
            BackendError: OpenGL is too old, or has no room for the scene.
        """
        scene = posing.posable(split_corners(scene) if scene.has_cutouts else scene)
        self._use(scene, geometry.prepare(scene))
        self._posed = 0
        self._tables = None

    def witness(self, rays: Rays, sample: int, camera: Camera | None = None) -> Visibility | None:
        """First hits at pixel centers, but for float32 and rounding of edges to 1/256 pixel.

        Raises:
            BackendError: No scene is loaded, or OpenGL failed.
        """
        renderer, scene = self._loaded()
        if camera is None:
            return None
        self._pose(sample)
        from scenec.backends.pyrender.resources import gl_errors

        def look(part: Camera) -> Visibility:
            parts = []
            for first, rows in bands(part, 1, renderer.largest):
                view, _ = camera_view(part, self._reach(part), first, rows)
                selection = geometry.select(scene, self._geometry, view, self._culling)
                renderer.draw_ids("pixels", view, selection, part.width, rows)
                parts.append(self._visibility(renderer.read_ids("pixels"), selection))
            return Visibility(
                np.concatenate([part.row for part in parts]),
                np.concatenate([part.face for part in parts]),
            )

        with gl_errors():
            return by_columns(look, camera, renderer.largest)

    def radiance(
        self, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
    ) -> Radiance:
        """Surface light of n x n samples a pixel on a grid, n = sqrt(spp) rounded, at most 4.

        They see and are shadowed each for itself; what looks alike in half a pixel is shaded once.
        Nothing in it is random: both halves are the same, and the error is unknown.

        Raises:
            BackendError: No scene is loaded, or OpenGL failed.
            StageError: A map or a sky's picture cannot be read.
        """
        renderer, scene = self._loaded()
        from scenec.backends.pyrender.resources import gl_errors

        self._pose(sample)
        side = int(np.clip(np.rint(np.sqrt(spp)), 1, MAX_SIDE))
        with gl_errors():
            if self._tables is None:
                # Only now, so that annotation alone never pays for it.
                self._use(scene, add_levels(scene, self._geometry))
                self._normals = face_normals(scene, self._geometry)
                renderer, _ = self._loaded()
                self._tables = make_tables(scene, self._geometry)
                renderer.set_tables(self._tables)
                self._ground = self._find_ground(renderer, self._tables)
                canopy = make_canopy(scene)
                if canopy is not None:
                    renderer.set_canopy(canopy)
                self._ambience = None
            light = np.concatenate(
                [
                    self._band(renderer, self._tables, camera, sample, side, first, rows)
                    for first, rows in bands(camera, side, renderer.largest)
                ]
            )
        rgb = np.ascontiguousarray(light[..., :3])
        coverage = np.ascontiguousarray(light[..., 3])
        return Radiance(np.stack([rgb, rgb]), coverage, side * side, stochastic=False)

    def _band(
        self,
        renderer: Renderer,
        tables: Tables,
        camera: Camera,
        sample: int,
        side: int,
        first: int,
        rows: int,
    ) -> NDArray[np.float32]:
        """Light and coverage of some rows of a picture, float32 [rows, w, 4]."""
        _, scene = self._loaded()
        lighting = scene.lighting[sample]
        view, near = camera_view(camera, self._reach(camera), first, rows, DETAIL)
        selection = geometry.select(scene, self._geometry, view, self._culling)
        renderer.draw_ids("samples", view, selection, camera.width * side, rows * side)
        rays = pixel_rays(camera)
        rays[:, 2] += first * rays[:, 1]
        surfaces = place_maps(tables, view.origin)
        with_facets = "WITH_FACETS" in tables.features
        sky = smooth_sky(lighting, ground=self._ground is not None, facets=with_facets)
        if self._ground is not None:
            if self._ambience is None or self._ambience[0] != sample:
                self._ambience = (sample, light_ground(self._ground, lighting))
            renderer.set_ground(self._ground, self._ambience[1], view.origin)
        suns = [sun for sun in lighting.suns if np.any(np.asarray(sun.irradiance) > 0.0)]
        depth = renderer.read_depth("samples") if suns else np.zeros((1, 1), np.float32)
        points = find_points(
            renderer.read_ids("samples"), side, self._normals, self._first_faces(selection)
        )
        drawn = DrawnView("samples", near, points, selection, rays, view.origin)
        total: NDArray[np.float32] | None = None
        # Each further sun adds a picture of its own light alone.
        for sun in suns or [Sun(np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0)]:
            shadows = fit_shadow_maps(
                depth, near, rays / [side, side, 1.0], view.origin, sun, renderer.shadow_size
            )
            for layer, shadow in enumerate(shadows):
                casters = geometry.select(scene, self._geometry, shadow.view, self._culling)
                renderer.draw_shadow(layer, shadow, casters)
            light = renderer.shade(drawn, surfaces, sky, sun, shadows)
            if total is None:
                total = light
            else:
                total += light
            sky = DARK
            surfaces = without_glow(tables.all_surfaces, surfaces)
        assert total is not None
        reach = self._reach(camera)
        for lamp in lighting.lamps:
            maps = lamp_shadow_maps(lamp, view, reach, renderer.shadow_size)
            for start in range(0, len(maps), CASCADES):
                shadows = maps[start : start + CASCADES]
                for layer, shadow in enumerate(shadows):
                    casters = geometry.select(scene, self._geometry, shadow.view, self._culling)
                    renderer.draw_shadow(layer, shadow, casters)
                total += renderer.shade(drawn, surfaces, DARK, lamp, shadows)
        return resolve(points, total).reshape(rows, camera.width, 4)

    def _find_ground(self, renderer: Renderer, tables: Tables) -> Ground | None:
        """The scene's height field, if it is ground with things on it; without what moves."""
        _, scene = self._loaded()
        bounds = world_bounds(scene)
        if not is_flat(bounds):
            return None
        view = view_from_above(bounds)
        selection = geometry.select(scene, self._geometry, view, standing=True)
        renderer.draw_ids("above", view, selection, CELLS, CELLS)
        return make_ground(
            scene, self._geometry, tables, bounds, selection,
            renderer.read_ids("above"), renderer.read_depth("above"),
        )  # fmt: skip

    def _pose(self, sample: int) -> None:
        """Put what moves where it is at a sample."""
        scene = self._scene
        if scene is not None and scene.rows.motion is not None and sample != self._posed:
            geometry.pose(scene, self._geometry, sample)
            self._posed = sample

    def _use(self, scene: RenderScene, parts: geometry.Geometry) -> None:
        from scenec.backends.pyrender.renderer import Renderer
        from scenec.backends.pyrender.resources import gl_errors

        self._context.platform.make_current()
        if self._renderer is not None:
            self._renderer.delete()
            self._renderer = None
        with gl_errors():
            self._renderer = Renderer(scene, parts)
        self._scene, self._geometry = scene, parts

    def _visibility(self, ids: NDArray[np.uint32], selection: geometry.Selection) -> Visibility:
        """From slots and drawn faces, [h, w, 2], to rows and faces."""
        rows = self._geometry.items.row[selection.items]
        firsts = self._first_faces(selection)
        row = np.empty(ids.shape[0] * ids.shape[1], np.int32)
        face = np.empty_like(row)
        _decode(ids.reshape(-1, 2), rows, firsts, self._geometry.order, row, face)
        return Visibility(row, face)

    def _first_faces(self, selection: geometry.Selection) -> NDArray[np.int64]:
        """Returns the first face of each slot's mesh among all drawn faces, int64 [slots]."""
        items = self._geometry.items
        return self._geometry.first_face[items.group_mesh[items.group[selection.items]]]

    def _reach(self, camera: Camera) -> float:
        """A distance that nothing lies beyond, meters."""
        spheres = self._geometry.items.spheres
        away = np.sqrt(((spheres[:, :3] - camera.camera_to_world[:3, 3]) ** 2).sum(axis=1))
        away += spheres[:, 3]
        return float(np.max(away[np.isfinite(away)], initial=1e-30))

    def _loaded(self) -> tuple[Renderer, RenderScene]:
        if self._renderer is None or self._scene is None:
            raise BackendError("pyrender: no scene is loaded; call load first")
        self._context.platform.make_current()
        return self._renderer, self._scene


def bands(camera: Camera, side: int, largest: int) -> list[tuple[int, int]]:
    """(first row, rows) of the parts that a picture is drawn in.

    Args:
        camera: Whose picture it is.
        side: Samples on a side of a pixel.
        largest: Width or height that OpenGL can draw.

    Raises:
        BackendError: The picture is wider than that.
    """
    if camera.width * side > largest:
        raise CameraRefusedError(
            f"pyrender: {camera.width} pixels of {side} samples across are more than this OpenGL's "
            f"{largest}; use fewer samples or a narrower picture"
        )
    rows = max(1, min(largest, MAX_SAMPLES // (camera.width * side)) // side)
    return [(first, min(rows, camera.height - first)) for first in range(0, camera.height, rows)]


@kernel
def _decode(ids, rows, firsts, order, row, face):  # type: ignore[no-untyped-def]
    for k in range(len(ids)):
        row[k], face[k] = NO_ROW, 0
        if ids[k, 0] > 0:
            slot = np.int64(ids[k, 0]) - 1
            row[k] = rows[slot]
            face[k] = order[firsts[slot] + np.int64(ids[k, 1])]
