"""A RenderScene in Blender: what is made once a batch, and the light that changes with samples."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np

from scenec.backends.cycles import blender, geometry, light, materials, planetary, render
from scenec.backends.cycles.shares import Shares
from scenec.backends.picture.sky import combine
from scenec.backends.stage.posing import posable, pose
from scenec.backends.stage.scene import Lamp, RenderScene, Sun

#: Cut-outs that a ray passes one behind the other: the most that Blender's setting takes.
MOST_CUTOUTS = 1024


class Built:
    """Blender's scene for a RenderScene; leaves Blender's data as it was when it goes.

    Args:
        bpy: Blender.
        scene: What to build; without one, a camera that sees nothing.
        device: See ``render.set_up``.
        bounces: See ``contract.BOUNCES``.

    Attributes:
        scene: Blender's scene.
        camera: The object that holds its camera.
        frame: Of Blender's coordinates.
        shares: What pictures are drawn in; None: at once.

    Raises:
        BackendError: Faces that name points which are not there.
        StageError: A map that cannot be read.
    """

    def __init__(self, bpy: Any, scene: RenderScene | None, device: str, bounces: int) -> None:
        self._bpy = bpy
        self._render_scene = scene = None if scene is None else posable(scene)
        self._glows = scene is not None and any(surface.emits for surface in scene.surfaces)
        self._posed = 0
        self._made = _BuiltData(bpy)
        weakref.finalize(self, self._made.remove).atexit = False
        self._light = _BuiltData(bpy)
        weakref.finalize(self, self._light.remove).atexit = False
        self._lit_sample: int | None = None
        self.shares: Shares | None = None
        with self._made:
            self.scene = bpy.data.scenes.new("scenec")
            render.set_up(self.scene, device, bounces)
            self.camera = bpy.data.objects.new("scenec_camera", bpy.data.cameras.new("scenec"))
            self.scene.collection.objects.link(self.camera)
            self.scene.camera = self.camera
            if scene is not None and scene.has_cutouts:
                self.scene.cycles.transparent_max_bounces = MOST_CUTOUTS
            if scene is not None:
                self.frame = geometry.scene_frame(scene)
                if planetary.surfaces_by_law(scene):
                    self.shares = Shares(bpy, self.scene, self.frame)
                known = None if self.shares is None else self.shares.light
                looks = materials.make_materials(bpy, scene, self.frame, known)
                self._rows = geometry.build(bpy, scene, self.frame, looks)
                for rows in self._rows.objects:
                    self.scene.collection.objects.link(rows)

    def pose(self, sample: int) -> None:
        """Put what moves where it is at a sample."""
        scene = self._render_scene
        if scene is None or scene.rows.motion is None or sample == self._posed:
            return
        pose(scene, sample)
        if len(self._rows.moving):
            geometry.pose(scene, self.frame, self._rows)
        self._posed = sample

    def set_light(self, sample: int) -> None:
        """Light the scene as at a sample. Geometry stays as it is.

        Raises:
            StageError: A sky's picture that cannot be read.
        """
        if self._render_scene is None or sample == self._lit_sample:
            return
        lighting = self._render_scene.lighting[sample]
        sky = combine(lighting.domes)
        self._light.remove()
        with self._light:
            # A surface turned anyhow towards a sun gets half its irradiance on average; in the
            # shadow of clouds the sky is all there is.
            from_suns = 0.5 * sum(
                float(np.mean(sun.irradiance)) for sun in lighting.suns if sun.gobo is None
            )
            self.scene.world = light.make_world(self._bpy, sky, from_suns)
            lights: list[tuple[Any, Sun | Lamp]] = [
                (light.make_sun(self._bpy, sun), sun)
                for sun in lighting.suns
                if sun.irradiance.max() > 0.0
            ]
            lights += [
                (light.make_lamp(self._bpy, lamp, self.frame), lamp)
                for lamp in lighting.lamps
                if lamp.intensity.max() > 0.0
            ]
            # Where there is little to choose, the tree costs a tenth of the time, and prefers a sun
            # so far to its sky that it adds noise.
            self.scene.cycles.use_light_tree = self._glows or len(lights) > 1
            gobos = [
                light.make_gobo(self._bpy, sun, self.frame) for sun in lighting.suns if sun.gobo
            ]
            for made in (*(one for one, _ in lights), *gobos):
                self.scene.collection.objects.link(made)
            if self.shares is not None:
                around = 0.0 if sky is None else np.pi * float(sky.picture.mean())
                albedo = max(max(surface.base_color) for surface in self._render_scene.surfaces)
                self.shares.prepare(lights, sky, np.inf if self._glows else around, albedo)
        self._lit_sample = sample


class _BuiltData:
    """Notes what a ``with`` block makes in Blender, to remove it later.

    By kind and name: Blender's own objects turn invalid when what they stand for goes.
    """

    def __init__(self, bpy: Any) -> None:
        self._bpy = bpy
        self._names: list[tuple[str, str]] = []
        self._before: set[tuple[str, str]] = set()

    def __enter__(self) -> None:
        self._before = blender.everything(self._bpy)

    def __exit__(self, *_: object) -> None:
        self._names += sorted(blender.everything(self._bpy) - self._before)

    def remove(self) -> None:
        """Remove it all."""
        names, self._names = self._names, []
        blender.remove(self._bpy, names)
