"""What pyrender's ways would have one write to see rows and faces.

A primitive with instances' poses for each mesh, a program of its own for ids, one call each, all of
the scene.
"""

from __future__ import annotations

import ctypes
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.pyrender import platforms
from scenec.backends.pyrender.camera import camera_view
from scenec.backends.stage.scene import RenderScene

VERTEX = """#version 420 core
layout(location = 0) in vec3 position;
layout(location = 1) in mat4 pose;
uniform mat4 clip;
flat out int instance;
void main()
{
    instance = gl_InstanceID;
    gl_Position = clip * pose * vec4(position, 1.0);
}
"""
FRAGMENT = """#version 420 core
flat in int instance;
uniform int part;
layout(location = 0) out uvec4 id;
void main()
{
    id = uvec4(part + 1, instance, gl_PrimitiveID, 0);
}
"""


class Bare:
    """All of a scene, drawn with pyrender's primitives into integers."""

    def __init__(self, scene: RenderScene) -> None:
        self.scene = scene

    def load(self) -> None:
        """Puts meshes and poses onto the device."""
        # A context, as the adapter makes it; before what binds OpenGL otherwise.
        self.context, scene = platforms.acquire("auto"), self.scene
        import pyrender
        from OpenGL import GL
        from pyrender.shader_program import ShaderProgramCache

        self.gl = GL
        self.parts = []
        self.rows = []
        for index, mesh in enumerate(scene.meshes):
            rows = np.flatnonzero(scene.rows.mesh == index)
            if len(rows) == 0 or len(mesh.faces) == 0:
                continue
            poses = np.zeros((len(rows), 4, 4), np.float32)
            poses[:, :3] = scene.rows.to_world[rows]
            poses[:, 3, 3] = 1.0
            part = pyrender.Primitive(positions=mesh.points, indices=mesh.faces, poses=poses)
            part._add_to_context()
            self.parts.append(part)
            self.rows.append(rows)
        self.all_rows = np.concatenate(self.rows).astype(np.int32)
        self.first_row = np.cumsum([0, *(len(rows) for rows in self.rows)])
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "ids.vert").write_text(VERTEX, encoding="utf-8")
            Path(folder, "ids.frag").write_text(FRAGMENT, encoding="utf-8")
            cache = ShaderProgramCache(shader_dir=folder)
            self.program = cache.get_program("ids.vert", "ids.frag")
            self.program._add_to_context()
        self.framebuffer = 0

    def _target(self, width: int, height: int) -> None:
        gl = self.gl
        self.framebuffer = gl.glGenFramebuffers(1)
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self.framebuffer)
        for attachment, kind in (
            (gl.GL_COLOR_ATTACHMENT0, gl.GL_RGBA32UI),
            (gl.GL_DEPTH_ATTACHMENT, gl.GL_DEPTH_COMPONENT32F),
        ):
            buffer = gl.glGenRenderbuffers(1)
            gl.glBindRenderbuffer(gl.GL_RENDERBUFFER, buffer)
            gl.glRenderbufferStorage(gl.GL_RENDERBUFFER, kind, width, height)
            gl.glFramebufferRenderbuffer(gl.GL_FRAMEBUFFER, attachment, gl.GL_RENDERBUFFER, buffer)

    def witness(self, sample: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Row and face of each pixel."""
        from OpenGL.GL.ARB.clip_control import glClipControl
        from OpenGL.raw.GL.VERSION.GL_1_1 import glReadPixels

        gl, camera = self.gl, self.scene.cameras[sample][0]
        if not self.framebuffer:
            self._target(camera.width, camera.height)
        view, _ = camera_view(camera, 1e3, 0, camera.height)
        away = np.eye(4)
        away[:3, 3] = -view.origin
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self.framebuffer)
        gl.glViewport(0, 0, camera.width, camera.height)
        glClipControl(gl.GL_LOWER_LEFT, gl.GL_ZERO_TO_ONE)
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glDepthFunc(gl.GL_GREATER)
        gl.glClearDepth(0.0)
        gl.glClear(gl.GL_DEPTH_BUFFER_BIT)
        gl.glClearBufferuiv(gl.GL_COLOR, 0, np.zeros(4, np.uint32))
        self.program._bind()
        self.program.set_uniform("clip", (view.clip @ away).astype(np.float32))
        for index, part in enumerate(self.parts):
            self.program.set_uniform("part", index)
            part._bind()
            gl.glDrawElementsInstanced(
                gl.GL_TRIANGLES, part.indices.size, gl.GL_UNSIGNED_INT, ctypes.c_void_p(0),
                len(part.poses),
            )  # fmt: skip
            part._unbind()
        out = np.empty((camera.height, camera.width, 4), np.uint32)
        pointer = out.ctypes.data_as(ctypes.c_void_p)
        glReadPixels(
            0, 0, camera.width, camera.height, gl.GL_RGBA_INTEGER, gl.GL_UNSIGNED_INT, pointer
        )
        found = out.reshape(-1, 4)
        hit = np.flatnonzero(found[:, 0])
        row = np.full(len(found), -1, np.int32)
        face = np.zeros(len(found), np.int32)
        row[hit] = self.all_rows[self.first_row[found[hit, 0] - 1] + found[hit, 1]]
        face[hit] = found[hit, 2]
        return row, face
