"""Buffers and targets of OpenGL that pyrender has no kinds of: tables, integers, floats."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from OpenGL.error import Error as OpenGLError
from OpenGL.raw.GL.VERSION.GL_1_1 import glReadPixels

from scenec.schemas.errors import BackendError

#: Components and kind of number -> format of a buffer texture.
_BUFFER_FORMATS = {
    (1, "f"): GL.GL_R32F,
    (3, "f"): GL.GL_RGB32F,
    (4, "f"): GL.GL_RGBA32F,
    (1, "u"): GL.GL_R32UI,
    (3, "u"): GL.GL_RGB32UI,
    (4, "u"): GL.GL_RGBA32UI,
}


@contextmanager
def gl_errors() -> Iterator[None]:
    """Turns what PyOpenGL raises into an error a user can meet.

    Raises:
        BackendError: OpenGL failed; most often it has no memory left.
    """
    try:
        yield
    except (OpenGLError, MemoryError) as error:
        said = getattr(error, "description", None) or type(error).__name__
        why = said.decode(errors="replace") if isinstance(said, bytes) else str(said)
        raise BackendError(
            f"pyrender: OpenGL failed ({why}); use smaller pictures or a smaller scene"
        ) from error


class Table:
    """An array that programs look up by index: a buffer and the texture it is seen through."""

    def __init__(self) -> None:
        self._buffer = int(GL.glGenBuffers(1))
        self.texture = int(GL.glGenTextures(1))

    def fill(self, values: NDArray, usage: int = GL.GL_STATIC_DRAW) -> None:
        """Replace the contents: float32 or uint32, [n] or [n, components].

        Raises:
            BackendError: It is longer than this OpenGL can look up.
        """
        components = values.shape[1] if values.ndim == 2 else 1
        limit = int(GL.glGetIntegerv(GL.GL_MAX_TEXTURE_BUFFER_SIZE))
        if len(values) > limit:
            raise BackendError(
                f"pyrender: a table of {len(values):,} entries is more than this OpenGL's "
                f"{limit:,}; use fewer or coarser objects"
            )
        data = np.ascontiguousarray(values)
        GL.glBindBuffer(GL.GL_TEXTURE_BUFFER, self._buffer)
        # An empty buffer is no legal texture.
        GL.glBufferData(
            GL.GL_TEXTURE_BUFFER, max(data.nbytes, 16), data if data.nbytes else None, usage
        )
        GL.glBindTexture(GL.GL_TEXTURE_BUFFER, self.texture)
        kind = _BUFFER_FORMATS[components, data.dtype.kind]
        GL.glTexBuffer(GL.GL_TEXTURE_BUFFER, kind, self._buffer)
        GL.glBindBuffer(GL.GL_TEXTURE_BUFFER, 0)

    def delete(self) -> None:
        """Free it."""
        GL.glDeleteTextures(1, [self.texture])
        GL.glDeleteBuffers(1, [self._buffer])


@dataclass
class Target:
    """A framebuffer and what is drawn into.

    Attributes:
        framebuffer: Its name in OpenGL.
        width, height: Pixels.
        color: Texture, 0 if there is none.
        depth: Texture, 0 if there is none.
    """

    framebuffer: int
    width: int
    height: int
    color: int = 0
    depth: int = 0

    def bind(self) -> None:
        """Draw into it."""
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.framebuffer)
        GL.glViewport(0, 0, self.width, self.height)

    def read(self, kind: int, number: int, array: NDArray) -> None:
        """Copy what was drawn into an array, the bottom row first.

        PyOpenGL's own ``glReadPixels`` knows no integers.
        """
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.framebuffer)
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 4)
        pointer = array.ctypes.data_as(ctypes.c_void_p)
        glReadPixels(0, 0, self.width, self.height, kind, number, pointer)

    def delete(self) -> None:
        """Free it."""
        GL.glDeleteFramebuffers(1, [self.framebuffer])
        for texture in (self.color, self.depth):
            if texture:
                GL.glDeleteTextures(1, [texture])


def picture_target(width: int, height: int, color: int | None, depth: bool) -> Target:
    """A target of a color format (None: no color), with a float depth or without.

    Raises:
        BackendError: This OpenGL cannot draw such a picture.
    """
    target = Target(int(GL.glGenFramebuffers(1)), width, height)
    target.bind()
    if color is not None:
        target.color = _texture(width, height, color)
        GL.glFramebufferTexture2D(
            GL.GL_FRAMEBUFFER, GL.GL_COLOR_ATTACHMENT0, GL.GL_TEXTURE_2D, target.color, 0
        )
    if depth:
        target.depth = _texture(width, height, GL.GL_DEPTH_COMPONENT32F)
        GL.glFramebufferTexture2D(
            GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, GL.GL_TEXTURE_2D, target.depth, 0
        )
    _check()
    return target


def shadow_target(size: int, layers: int) -> Target:
    """Square depth pictures in layers, which programs compare with; ``bind_layer`` picks one."""
    target = Target(int(GL.glGenFramebuffers(1)), size, size)
    target.bind()
    target.depth = int(GL.glGenTextures(1))
    kind = GL.GL_TEXTURE_2D_ARRAY
    GL.glBindTexture(kind, target.depth)
    GL.glTexImage3D(
        kind, 0, GL.GL_DEPTH_COMPONENT32F, size, size, layers, 0, GL.GL_DEPTH_COMPONENT,
        GL.GL_FLOAT, None,
    )  # fmt: skip
    for name, value in (
        (GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_WRAP_S, GL.GL_CLAMP_TO_EDGE),
        (GL.GL_TEXTURE_WRAP_T, GL.GL_CLAMP_TO_EDGE),
        (GL.GL_TEXTURE_COMPARE_MODE, GL.GL_COMPARE_REF_TO_TEXTURE),
        # Depth grows towards the sun: lit is what is no farther from it.
        (GL.GL_TEXTURE_COMPARE_FUNC, GL.GL_GEQUAL),
    ):
        GL.glTexParameteri(kind, name, value)
    GL.glDrawBuffer(GL.GL_NONE)
    GL.glReadBuffer(GL.GL_NONE)
    return target


def bind_layer(target: Target, layer: int) -> None:
    """Draw into one layer of a ``shadow_target``."""
    target.bind()
    GL.glFramebufferTextureLayer(GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, target.depth, 0, layer)
    _check()


def _texture(width: int, height: int, kind: int) -> int:
    depth = kind == GL.GL_DEPTH_COMPONENT32F
    layout = {
        GL.GL_DEPTH_COMPONENT32F: (GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT),
        GL.GL_RG32UI: (GL.GL_RG_INTEGER, GL.GL_UNSIGNED_INT),
        GL.GL_RGBA32F: (GL.GL_RGBA, GL.GL_FLOAT),
    }[kind]
    texture = int(GL.glGenTextures(1))
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, kind, width, height, 0, *layout, None)
    for name in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
        GL.glTexParameteri(GL.GL_TEXTURE_2D, name, GL.GL_NEAREST)
    if depth:
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_COMPARE_MODE, GL.GL_NONE)
    return texture


def fill_integers(values: NDArray[np.uint32]) -> None:
    """Replaces the picture that is bound by a table of integers, uint32 [h, w, 4]."""
    height, width = values.shape[:2]
    kind = GL.GL_TEXTURE_2D
    GL.glTexImage2D(
        kind, 0, GL.GL_RGBA32UI, width, height, 0, GL.GL_RGBA_INTEGER, GL.GL_UNSIGNED_INT, values
    )
    # Integers are never mixed: without this the texture is not complete.
    for name in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
        GL.glTexParameteri(kind, name, GL.GL_NEAREST)


def lookup_texture(values: NDArray[np.float32], mirrored: bool = False) -> int:
    """A table in two dimensions, linear between texel centers, constant beyond the last ones.

    Args:
        values: float32 [h, w] or [h, w, 4].
        mirrored: Whether it is mirrored beyond its borders instead.
    """
    texture = int(GL.glGenTextures(1))
    kind = GL.GL_TEXTURE_2D
    GL.glBindTexture(kind, texture)
    height, width = values.shape[:2]
    stored, given = (GL.GL_R32F, GL.GL_RED) if values.ndim == 2 else (GL.GL_RGBA32F, GL.GL_RGBA)
    data = np.ascontiguousarray(values, np.float32)
    GL.glTexImage2D(kind, 0, stored, width, height, 0, given, GL.GL_FLOAT, data)
    beyond = GL.GL_MIRRORED_REPEAT if mirrored else GL.GL_CLAMP_TO_EDGE
    for name, value in (
        (GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_WRAP_S, beyond),
        (GL.GL_TEXTURE_WRAP_T, beyond),
    ):
        GL.glTexParameteri(kind, name, value)
    return texture


def volume_texture(values: NDArray[np.float32]) -> int:
    """A table in three dimensions, linear between centers, constant beyond: float32 [z, y, x]."""
    texture = int(GL.glGenTextures(1))
    kind = GL.GL_TEXTURE_3D
    GL.glBindTexture(kind, texture)
    deep, height, width = values.shape
    GL.glTexImage3D(
        kind, 0, GL.GL_R16F, width, height, deep, 0, GL.GL_RED, GL.GL_FLOAT,
        np.ascontiguousarray(values, np.float32),
    )  # fmt: skip
    for name in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
        GL.glTexParameteri(kind, name, GL.GL_LINEAR)
    for name in (GL.GL_TEXTURE_WRAP_S, GL.GL_TEXTURE_WRAP_T, GL.GL_TEXTURE_WRAP_R):
        GL.glTexParameteri(kind, name, GL.GL_CLAMP_TO_EDGE)
    return texture


def map_texture(layers: NDArray[np.float16]) -> int:
    """Repeating pictures in layers with coarser levels, float16 [layers, h, w, 4], bottom first."""
    texture = int(GL.glGenTextures(1))
    kind = GL.GL_TEXTURE_2D_ARRAY
    GL.glBindTexture(kind, texture)
    count, height, width = layers.shape[:3]
    GL.glTexImage3D(
        kind, 0, GL.GL_RGBA16F, width, height, count, 0, GL.GL_RGBA, GL.GL_HALF_FLOAT,
        np.ascontiguousarray(layers),
    )  # fmt: skip
    GL.glGenerateMipmap(kind)
    for name, value in (
        (GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_LINEAR),
        (GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_WRAP_S, GL.GL_REPEAT),
        (GL.GL_TEXTURE_WRAP_T, GL.GL_REPEAT),
    ):
        GL.glTexParameteri(kind, name, value)
    return texture


def _check() -> None:
    state = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
    if state != GL.GL_FRAMEBUFFER_COMPLETE:
        raise BackendError(
            f"pyrender: this OpenGL cannot draw into such a picture (status {int(state):#x})"
        )
