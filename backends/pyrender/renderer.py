"""Drawing: pyrender's renderer with passes of its own for ids, shadow maps and light.

pyrender brings context, vertex buffers and programs. Its own passes draw 8-bit colors into
multisampled buffers with a depth of 24 bits and know no ids; these draw integers and floats with a
float depth.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyrender
from numpy.typing import NDArray
from OpenGL import GL
from OpenGL.GL.ARB.clip_control import glClipControl
from pyrender.shader_program import ShaderProgramCache

from scenec.backends.pyrender import platforms, resources
from scenec.backends.pyrender.ambience import Ambience, Ground
from scenec.backends.pyrender.canopy import Canopy
from scenec.backends.pyrender.geometry import Geometry, Selection, View
from scenec.backends.pyrender.laws import LAW_ROWS
from scenec.backends.pyrender.lighting import (
    CASCADES,
    ShadowMap,
    SmoothSky,
)
from scenec.backends.pyrender.points import ROW, DrawnView
from scenec.backends.pyrender.surface_model import MARK, surface_functions
from scenec.backends.pyrender.tables import Tables
from scenec.backends.stage.scene import Gobo, Lamp, Maps, Mesh, RenderScene, Sun
from scenec.backends.surface import lamps
from scenec.backends.surface.corners import vertex_uv
from scenec.backends.surface.cutouts import field
from scenec.backends.surface.gobo import load_gobo
from scenec.backends.surface.lobes import MIN_ALPHA
from scenec.schemas.errors import BackendError
from scenec.schemas.stage import WRAPS

SHADERS = Path(__file__).parent / "shaders"
#: Texture units, by the numbers that the programs name them with.
UNITS = (
    "points", "poses", "faces", "vertices", "normals", "weights", "meshes", "layers", "surfaces",
    "laws", "maps", "shadows", "ground_sky", "ground_light", "uvs", "gobo",
    "depth", "canopy",
)  # fmt: skip
#: Share of a shadow map's texel that a surface may lie farther from the sun than itself.
_BIAS = 0.25

#: All renderers of a process share what takes longer to make than a small scene to draw: programs,
#: and shadow maps by size (48 MB of memory that a system has to clear).
_PROGRAMS = ShaderProgramCache(shader_dir=str(SHADERS))
_SHADOWS: dict[int, resources.Target] = {}


class Part(pyrender.Primitive):
    """A pyrender primitive whose vertex indices are not rounded to float32 on their way."""

    def __init__(
        self, mesh: Mesh, faces: NDArray[np.uint32], cutouts: bool, mask: MaskTexture | None
    ) -> None:
        uv = vertex_uv(mesh) if cutouts else None
        super().__init__(positions=mesh.points, texcoord_0=uv)
        self._indices, self.mask = faces, mask


class MaskTexture(NamedTuple):
    """Holds a surface's mask: the texture of ``surface.cutouts.field``, and how it wraps."""

    texture: int
    wrap: tuple[int, int]


class Renderer(pyrender.Renderer):
    """Draws one scene.

    Args:
        scene: The scene.
        geometry: Of the same scene.

    Raises:
        BackendError: This OpenGL is too old.
    """

    #: Texels on a side of a shadow map.
    shadow_size = 2048

    def __init__(self, scene: RenderScene, geometry: Geometry) -> None:
        super().__init__(1, 1)
        self._freed = False
        self._tables: dict[str, resources.Table] = {}
        self._targets: dict[str, resources.Target] = {}
        self._pictures: dict[str, int] = {}
        # File of the one of them that a sun shines through.
        self._gobo: Path | None = None
        self._canopy: Canopy | None = None
        numbers = (GL.GL_MAJOR_VERSION, GL.GL_MINOR_VERSION)
        found = tuple(int(GL.glGetIntegerv(number)) for number in numbers)
        # Either may be missing where OpenGL has it: PyOpenGL keeps the list of extensions of the
        # first context it met, and finds functions of the version not at all in OSMesa.
        named = (glClipControl, GL.glClipControl)
        self._clip_control = next((function for function in named if bool(function)), None)
        if found < (4, 2) or self._clip_control is None:
            raise BackendError(
                f"pyrender: this OpenGL is of version {found[0]}.{found[1]}, it takes 4.2 and "
                "ARB_clip_control (part of 4.5); update the graphics driver, or use --device cpu"
            )
        units = int(GL.glGetIntegerv(GL.GL_MAX_TEXTURE_IMAGE_UNITS))
        if units <= UNITS.index("depth"):
            raise BackendError(
                f"pyrender: this OpenGL has {units} texture units, it takes "
                f"{UNITS.index('depth') + 1}; use --device cpu"
            )
        self.largest = int(GL.glGetIntegerv(GL.GL_MAX_TEXTURE_SIZE))
        self._program_cache = _PROGRAMS
        self._defines: dict[str, int] = {}
        self._cutouts = scene.has_cutouts
        self._parts = []
        for drawn in geometry.meshes:
            mesh = scene.meshes[drawn.mesh]
            mask = self._mask(scene.cutout_of(mesh))
            self._parts.append(Part(mesh, drawn.faces, self._cutouts, mask))
        # What pyrender frees when it is deleted.
        self._meshes = {pyrender.Mesh(primitives=self._parts)}
        for part in self._parts:
            part._add_to_context()
        self._tables["poses"] = resources.Table()
        # OpenGL draws nothing without one, even where there are no attributes.
        self._no_attributes = int(GL.glGenVertexArrays(1))
        self._points = int(GL.glGenTextures(1))

    def _mask(self, maps: Maps | None) -> MaskTexture | None:
        if maps is None:
            return None
        name = f"{maps.opacity} {maps.opacity_threshold} {maps.readings}"
        if name not in self._pictures:
            self._pictures[name] = resources.lookup_texture(field(maps))
        across, up = map(WRAPS.index, maps.opacity_wrap)
        return MaskTexture(self._pictures[name], (across, up))

    def delete(self) -> None:
        """Free everything that OpenGL holds for it."""
        # Names of what is gone may be those of another's by now.
        if self._freed or not platforms.alive():
            return
        self._freed = True
        self._program_cache = ShaderProgramCache()
        super().delete()
        for table in self._tables.values():
            table.delete()
        for target in self._targets.values():
            target.delete()
        GL.glDeleteVertexArrays(1, [self._no_attributes])
        GL.glDeleteTextures(1, [self._points])
        if self._pictures:
            GL.glDeleteTextures(len(self._pictures), list(self._pictures.values()))
        self._tables, self._targets, self._pictures, self._gobo = {}, {}, {}, None

    def draw_ids(
        self, name: str, view: View, selection: Selection, width: int, height: int
    ) -> None:
        """Draw (slot + 1, face) of what is nearest, 0 where nothing is.

        Args:
            name: Of the target that is drawn into, kept for the other methods.
            view, selection: What is drawn.
            width, height: Of the picture.
        """
        target = self._target(name, width, height, GL.GL_RG32UI, depth=True)
        self._set_state()
        target.bind()
        GL.glClearBufferuiv(GL.GL_COLOR, 0, np.zeros(4, np.uint32))
        self._draw({"WITH_IDS": 1}, view, selection)

    def read_ids(self, name: str) -> NDArray[np.uint32]:
        """Returns the picture of ``draw_ids``, uint32 [h, w, 2], the view's first row first."""
        target = self._targets[name]
        out = np.empty((target.height, target.width, 2), np.uint32)
        target.read(GL.GL_RG_INTEGER, GL.GL_UNSIGNED_INT, out)
        return out

    def read_depth(self, name: str) -> NDArray[np.float32]:
        """Depth of what ``draw_ids`` drew, float32 [h, w]."""
        target = self._targets[name]
        out = np.empty((target.height, target.width), np.float32)
        target.read(GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, out)
        return out

    def draw_shadow(self, layer: int, shadow: ShadowMap, selection: Selection) -> None:
        """Draw a shadow map into its layer."""
        self._set_state()
        resources.bind_layer(self._shadows(), layer)
        if not shadow.of_lamp:
            # What lies between the sun and the map's box is drawn onto its near side.
            GL.glEnable(GL.GL_DEPTH_CLAMP)
        self._draw({}, shadow.view, selection)

    def _draw(self, defines: dict[str, int], view: View, selection: Selection) -> None:
        defines = defines | ({"WITH_CUTOUTS": 1} if self._cutouts else {})
        program = self._program("ids.vert", "ids.frag", defines)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthMask(GL.GL_TRUE)
        GL.glDepthFunc(GL.GL_GREATER)
        GL.glClearDepth(0.0)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        self._tables["poses"].fill(selection.poses.reshape(-1, 4), GL.GL_STREAM_DRAW)
        _bind("poses", GL.GL_TEXTURE_BUFFER, self._tables["poses"].texture)
        program.set_uniform("clip", view.clip)
        first_slot = GL.glGetUniformLocation(program._program_id, "first_slot")
        first_face = GL.glGetUniformLocation(program._program_id, "first_face")
        cutout = GL.glGetUniformLocation(program._program_id, "cutout")
        bound = -1
        for mesh, face, faces, slot, slots in selection.draws.tolist():
            if mesh != bound:
                bound = mesh
                self._parts[mesh]._bind()
                if self._cutouts:
                    mask = self._parts[mesh].mask
                    wrap = (0, 0, 0) if mask is None else (1, *mask.wrap)
                    GL.glUniform3i(cutout, *wrap)
                    # Of the units, that of a picture which this pass does not look at.
                    _bind("gobo", GL.GL_TEXTURE_2D, 0 if mask is None else mask.texture)
            GL.glUniform1i(first_slot, slot)
            if first_face >= 0:
                GL.glUniform1i(first_face, face)
            GL.glDrawElementsInstanced(
                GL.GL_TRIANGLES, 3 * faces, GL.GL_UNSIGNED_INT, ctypes.c_void_p(12 * face), slots
            )
        GL.glBindVertexArray(0)
        program._unbind()

    def set_tables(self, tables: Tables) -> None:
        """Bring what the shading program looks up, once per scene."""
        for name in (
            "faces", "vertices", "normals", "weights", "meshes", "layers", "surfaces", "uvs",
        ):  # fmt: skip
            self._tables[name] = resources.Table()
            self._tables[name].fill(getattr(tables, name))
        self._pictures["maps"] = resources.map_texture(tables.maps)
        self._defines = {"CASCADES": CASCADES} | dict.fromkeys(tables.features, 1)
        if "WITH_REFLECTANCE" in tables.features:
            self._pictures["laws"] = resources.lookup_texture(tables.laws)
            self._defines["LAW_ROWS"] = LAW_ROWS

    def set_canopy(self, canopy: Canopy) -> None:
        """Bring what leaves leave of the sky, if this OpenGL has a texture unit for it."""
        if int(GL.glGetIntegerv(GL.GL_MAX_TEXTURE_IMAGE_UNITS)) <= UNITS.index("canopy"):
            return
        self._pictures["canopy"] = resources.volume_texture(canopy.open)
        self._canopy = canopy
        self._defines["WITH_CANOPY"] = 1

    def set_ground(self, ground: Ground, ambience: Ambience, origin: NDArray[np.float64]) -> None:
        """Bring what ``shade`` is to know of the ground, seen from an origin."""
        for name, values in (("ground_sky", ambience.sky), ("ground_light", ambience.ground)):
            if name in self._pictures:
                GL.glDeleteTextures(1, [self._pictures[name]])
            self._pictures[name] = resources.lookup_texture(values)
        offset = (origin[:2] - ground.low) / ground.size
        self._ground_place = np.array([*(1.0 / ground.size), *offset])
        self._defines["WITH_GROUND"] = 1

    def shade(
        self,
        drawn: DrawnView,
        surfaces: NDArray[np.float32],
        sky: SmoothSky,
        sun: Sun | Lamp,
        shadows: Sequence[ShadowMap],
    ) -> NDArray[np.float32]:
        """The light of points of what ``draw_ids`` drew.

        Args:
            drawn: What it drew, and where light is asked for.
            surfaces: ``tables.place_maps`` for this camera.
            sky: The sky; a dark one leaves out the ground's light too.
            sun: The sun, or a lamp, that only shines where its shadow maps reach.
            shadows: What ``draw_shadow`` drew for it, by layer.

        Returns:
            Light of each point and nothing, float32 [n, 4].
        """
        points, origin = drawn.points, drawn.origin
        rows = len(points.packed) // ROW
        target = self._target("light", ROW, rows, GL.GL_RGBA32F, depth=False)
        # Made before the target is bound: making it binds it.
        shadow_maps = self._shadows().depth
        defines: dict[str, Any] = self._defines | (
            {"WITH_LAMPS": 1} if isinstance(sun, Lamp) else {"WITH_GOBO": 1} if sun.gobo else {}
        )
        # pyrender puts what is defined in place of its name.
        defines[MARK] = surface_functions(frozenset(defines))
        program = self._program("full.vert", "shade.frag", defines)
        self._set_state()
        target.bind()
        self._tables["poses"].fill(drawn.selection.poses.reshape(-1, 4), GL.GL_STREAM_DRAW)
        self._tables["surfaces"].fill(surfaces, GL.GL_STREAM_DRAW)
        for unit, table in self._tables.items():
            _bind(unit, GL.GL_TEXTURE_BUFFER, table.texture)
        _bind("depth", GL.GL_TEXTURE_2D, self._targets[drawn.name].depth)
        _bind("points", GL.GL_TEXTURE_2D, self._points)
        resources.fill_integers(points.packed.reshape(rows, ROW, 4))
        _bind("maps", GL.GL_TEXTURE_2D_ARRAY, self._pictures["maps"])
        _bind("shadows", GL.GL_TEXTURE_2D_ARRAY, shadow_maps)
        if "laws" in self._pictures:
            _bind("laws", GL.GL_TEXTURE_2D, self._pictures["laws"])
        if "ground_sky" in self._pictures:
            _bind("ground_sky", GL.GL_TEXTURE_2D, self._pictures["ground_sky"])
            _bind("ground_light", GL.GL_TEXTURE_2D, self._pictures["ground_light"])
            program.set_uniform("ground_place", self._ground_place)
        if self._canopy is not None:
            _bind("canopy", GL.GL_TEXTURE_3D, self._pictures["canopy"])
            program.set_uniform("canopy_scale", 1.0 / self._canopy.size)
            place = (origin - self._canopy.low) / self._canopy.size
            program.set_uniform("canopy_offset", place)
            # The lowest direction of ``make_canopy`` rises by its height over nearly six of it.
            program.set_uniform("canopy_reach", 6.0 * float(self._canopy.size[2]))
        program.set_uniform("samples", points.side)
        program.set_uniform("near", float(drawn.near))
        program.set_uniform("rays", drawn.rays)
        program.set_uniform("ground_share", float(not sky.dark))
        if "WITH_FACETS" in self._defines:
            program.set_uniform("aureole", sky.aureole)
        for name, values in (("sky", sky.irradiance), ("sky_mirrored", sky.mirrored)):
            for index, coefficient in enumerate(values):
                program.set_uniform(f"{name}[{index}]", coefficient)
        if isinstance(sun, Lamp):
            _set_lamp(program, sun, origin)
        else:
            program.set_uniform("to_sun", np.asarray(sun.to_light, np.float64))
            program.set_uniform("sun", np.asarray(sun.irradiance, np.float64))
            # Half vectors turn by half of what directions to the disc do, half its width each way.
            program.set_uniform("sun_alpha", max(MIN_ALPHA, 0.25 * float(sun.diameter_rad)))
            if sun.gobo is not None:
                self._set_gobo(program, sun.gobo, origin)
        program.set_uniform("cascades", len(shadows))
        for index, shadow in enumerate(shadows):
            program.set_uniform(f"shadow_clip[{index}]", shadow.view.clip)
            bias = _BIAS * shadow.texel_m / shadow.depth_m
            program.set_uniform(f"shadow_texel[{index}]", np.array([shadow.texel_m, bias]))
        GL.glBindVertexArray(self._no_attributes)
        GL.glDrawArrays(GL.GL_TRIANGLES, 0, 3)
        GL.glBindVertexArray(0)
        program._unbind()
        out = np.empty((len(points.packed), 4), np.float32)
        target.read(GL.GL_RGBA, GL.GL_FLOAT, out)
        return out

    def _set_gobo(self, program: Any, gobo: Gobo, origin: NDArray[np.float64]) -> None:
        """Put the picture before the sun; places are relative to ``origin``."""
        if self._gobo != gobo.file:
            if "gobo" in self._pictures:
                GL.glDeleteTextures(1, [self._pictures["gobo"]])
            self._pictures["gobo"] = resources.lookup_texture(load_gobo(gobo.file), mirrored=True)
            self._gobo = gobo.file
        _bind("gobo", GL.GL_TEXTURE_2D, self._pictures["gobo"])
        rows = gobo.to_picture.copy()
        rows[:, 3] += rows[:, :3] @ origin
        program.set_uniform("gobo_u", rows[0])
        program.set_uniform("gobo_v", rows[1])

    def _program(self, vertex: str, fragment: str, defines: dict[str, Any]) -> Any:
        program = self._program_cache.get_program(vertex, fragment, defines=defines)
        if not program._in_context():
            program._add_to_context()
        program._bind()
        return program

    def _target(
        self, name: str, width: int, height: int, color: int, depth: bool
    ) -> resources.Target:
        target = self._targets.get(name)
        if target is None or (target.width, target.height) != (width, height):
            if target is not None:
                target.delete()
            target = self._targets[name] = resources.picture_target(width, height, color, depth)
        return target

    def _shadows(self) -> resources.Target:
        if self.shadow_size not in _SHADOWS:
            _SHADOWS[self.shadow_size] = resources.shadow_target(self.shadow_size, CASCADES)
        return _SHADOWS[self.shadow_size]

    def _set_state(self) -> None:
        """OpenGL's state as all passes begin with it, whoever used the context before."""
        for feature in (
            GL.GL_BLEND, GL.GL_CULL_FACE, GL.GL_DEPTH_TEST, GL.GL_DEPTH_CLAMP, GL.GL_MULTISAMPLE,
            GL.GL_SCISSOR_TEST,
        ):  # fmt: skip
            GL.glDisable(feature)
        # Depth in [0, 1] as it is, so that a reversed one keeps all of float32's digits.
        assert self._clip_control is not None
        self._clip_control(GL.GL_LOWER_LEFT, GL.GL_ZERO_TO_ONE)
        GL.glDepthRange(0.0, 1.0)
        GL.glPolygonMode(GL.GL_FRONT_AND_BACK, GL.GL_FILL)
        GL.glColorMask(GL.GL_TRUE, GL.GL_TRUE, GL.GL_TRUE, GL.GL_TRUE)


def _set_lamp(program: Any, lamp: Lamp, origin: NDArray[np.float64]) -> None:
    program.set_uniform("lamp_position", np.asarray(lamp.position - origin, np.float64))
    program.set_uniform("lamp_axis", np.asarray(lamp.axis, np.float64))
    program.set_uniform("lamp", np.asarray(lamp.intensity, np.float64))
    program.set_uniform("lamp_cone", np.array([*lamps.cone(lamp), lamp.radius_m]))
    program.set_uniform("least_alpha", MIN_ALPHA)


def _bind(unit: str, kind: int, texture: int) -> None:
    GL.glActiveTexture(GL.GL_TEXTURE0 + UNITS.index(unit))
    GL.glBindTexture(kind, texture)
