"""A picture in shares: what each light sends straight to what the camera sees, and all the rest.

Scenes with laws other than Lambert's are drawn so, because a shader knows one light at a time (see
``planetary``). The shares add up to the picture: they differ in which light is on, and at which
length of a path. A light's own share ends at the first hit; the rest has all lights from the second
hit on, and sky and glow. Shares get samples in proportion to the light that they may hold at the
most: of the Moon's picture all but 0.05 % is the sun's own share, and so are the samples.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from scenec.backends.cycles.geometry import Frame
from scenec.backends.cycles.graph import NODES, Graph
from scenec.backends.cycles.planetary import ShaderLight
from scenec.backends.picture.sky import MIN_SUN_DIAMETER_RAD, Sky, aureole
from scenec.backends.stage.scene import Lamp, Sun

_UP = np.array([0.0, 0.0, 1.0])


class Shares:
    """Switches Blender's scene between shares.

    Args:
        bpy: Blender.
        scene: Its scene.
        frame: Of its coordinates.
    """

    def __init__(self, bpy: Any, scene: Any, frame: Frame) -> None:
        self._bpy, self._scene, self._frame = bpy, scene, frame
        self.light = ShaderLight(bpy)
        self._lights: list[tuple[Any, Sun | Lamp]] = []
        self._parts: list[float] = []
        self._aureole = 0.0
        self._bright: Any = None
        self._dark: Any = None

    def __len__(self) -> int:
        return len(self._lights) + 1

    def prepare(
        self,
        lights: list[tuple[Any, Sun | Lamp]],
        sky: Sky | None,
        ambient: float,
        albedo: float,
    ) -> None:
        """Take over the light of a sample, as it has just been made.

        Args:
            lights: Objects, and what they stand for.
            sky: What is behind them.
            ambient: Irradiance from sky and glow, W/m^2; infinity where it is not known.
            albedo: The largest of a surface.
        """
        self._lights = lights
        strongest = self._strongest()
        self._aureole = aureole(sky, strongest.to_light) if isinstance(strongest, Sun) else 0.0
        own = [
            float(np.max(light.irradiance)) if isinstance(light, Sun) else np.inf
            for _, light in lights
        ]
        # A surface sends no more than half of what it reflects to others that the camera sees.
        held = [*own, ambient + 0.5 * albedo * sum(own)]
        most = max(held)
        known = 0.0 < most < np.inf
        self._parts = [part / most for part in held] if known else [1.0] * len(held)
        self._bright = self._scene.world
        self._dark = self._bpy.data.worlds.new("scenec_dark")
        self._dark.node_tree.nodes.clear()
        graph = Graph(self._dark.node_tree)
        background = graph.node("ShaderNodeBackground")
        graph.feed(background.inputs["Strength"], 0.0)
        graph.feed(graph.node("ShaderNodeOutputWorld").inputs["Surface"], background.outputs[0])
        for made, _ in lights:
            self._mask(made.data)

    def samples(self, number: int, samples: int) -> int:
        """Returns a share's samples per pixel, of the picture's."""
        return max(1, math.ceil(self._parts[number] * samples))

    def choose(self, number: int, bounces: int) -> int:
        """Switch to a share; returns how many bounces it takes.

        Args:
            number: Below ``len``; the last is the rest.
            bounces: Of whole paths.
        """
        alone = number < len(self._lights)
        for index, (made, light) in enumerate(self._lights):
            made.hide_render = alone and index != number
            # Where a light is masked by the length of the path, Cycles counts that of rays that
            # meet it and of those sent to it differently.
            found = alone and not (isinstance(light, Sun) and light.gobo)
            made.data.cycles.use_multiple_importance_sampling = found
        self._scene.world = self._dark if alone else self._bright
        known = self._lights[number][1] if alone else self._strongest()
        if isinstance(known, Lamp):
            self.light.set(alone, self._frame.place(known.position), near=True)
        elif known is not None:
            radius = 0.5 * max(known.diameter_rad, MIN_SUN_DIAMETER_RAD)
            self.light.set(alone, known.to_light, radius=radius, aureole=self._aureole)
        else:
            self.light.set(False, -_UP)
        return 0 if alone else bounces

    def _strongest(self) -> Sun | Lamp | None:
        suns = [light for _, light in self._lights if isinstance(light, Sun)]
        if suns:
            return max(suns, key=lambda sun: float(np.max(sun.irradiance)))
        lamps = [light for _, light in self._lights if isinstance(light, Lamp)]
        return max(lamps, key=lambda lamp: float(np.max(lamp.intensity)), default=None)

    def _mask(self, light: Any) -> None:
        """Have a light shine where it is alone, or else from the second hit on."""
        graph = Graph(light.node_tree)
        # Blender's own, or ours where a lamp fades towards its border.
        emission = next(n for n in light.node_tree.nodes if n.bl_idname == "ShaderNodeEmission")
        depth = graph.number(graph.node("ShaderNodeLightPath").outputs["Ray Depth"])
        # 1 is the first hit.
        mask = NODES.maximum(NODES.select(depth - 1.5, 1.0, 0.0), self.light.output(graph, "Alone"))
        strength = emission.inputs["Strength"]
        if strength.is_linked:
            mask = mask * graph.number(strength.links[0].from_socket)
        graph.feed(strength, mask)
