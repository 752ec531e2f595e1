"""Opens OpenGL without a window through EGL, since PyOpenGL cannot switch once imported.

NVIDIA's EGL gives exactly the version of OpenGL that is asked for, Mesa's the highest compatible
one. pyrender asks for 4.1, in which our shaders do not compile; so contexts are made here.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from scenec.schemas.system_libraries import OF_EGL, mend

# From EGL/egl.h and EGL/eglext.h.
_EXTENSIONS = 0x3055
_PLATFORM_DEVICE_EXT = 0x313F
_OPENGL_API = 0x30A2
_OPENGL_BIT = 0x0008
_NONE = 0x3038
_CONFIG = (0x3033, 1, 0x3040, _OPENGL_BIT, 0x3025, 24, _NONE)  # pbuffer, OpenGL, depth
_MAJOR, _MINOR, _PROFILE, _CORE = 0x3098, 0x30FB, 0x30FD, 1
_MAX_DEVICES = 64

#: Versions of OpenGL to ask for: with 4.2, ARB_clip_control must be there beside.
VERSIONS = ((4, 5), (4, 2))


@dataclass(frozen=True)
class EglDevice:
    """Describes a device that EGL can draw with.

    Attributes:
        index: Among all of EGL's devices; -1 is the default display (EGL without a list of them).
        nvidia: Whether it is an NVIDIA GPU.
        software: Whether it is no GPU at all.
    """

    index: int
    nvidia: bool
    software: bool


class EglContext:
    """Holds a context of OpenGL, current in this thread, without a surface.

    Args:
        device: Where it draws.

    Raises:
        OSError: EGL is missing, or opens none of ``VERSIONS`` there.
    """

    def __init__(self, device: EglDevice) -> None:
        self._egl = _load()
        self._display = _displays(self._egl)[device.index]
        self._context = _create(self._egl, self._display)
        self.make_current()

    def make_current(self) -> None:
        """Makes it this thread's context."""
        self._egl.eglMakeCurrent(self._display, None, None, self._context)

    def delete_context(self) -> None:
        """Frees it, and all that it holds."""
        if self._context is not None:
            self._egl.eglMakeCurrent(self._display, None, None, None)
            self._egl.eglDestroyContext(self._display, self._context)
            self._egl.eglTerminate(self._display)
            self._context = None


def egl_devices() -> list[EglDevice]:
    """Lists the devices on which EGL makes a context, found without PyOpenGL.

    Raises:
        OSError: There is no EGL, or no OpenGL to go with it, or none of its devices works.
    """
    egl = _load()
    displays = _displays(egl)
    found = []
    for index, display in displays.items():
        try:
            context = _create(egl, display)
        except OSError:
            continue
        egl.eglDestroyContext(display, context)
        egl.eglTerminate(display)
        extensions = _extensions(egl, index)
        # Who has no list of devices says nothing of them either.
        software = index < 0 or b"EGL_MESA_device_software" in extensions
        found.append(EglDevice(index, b"EGL_NV_device_cuda" in extensions, software))
    if not found:
        versions = " or ".join(f"{major}.{minor}" for major, minor in VERSIONS)
        what = "its default display" if -1 in displays else f"none of its {len(displays)} devices"
        raise OSError(f"{what} opens an OpenGL {versions} core context")
    return found


def _create(egl: Any, display: Any) -> Any:
    """Creates a context on an initialized display, of the first version that it offers.

    Raises:
        OSError: It gives none.
    """
    if not display or not egl.eglInitialize(display, None, None):
        raise OSError("a display cannot be initialized")
    wanted = (ctypes.c_int * len(_CONFIG))(*_CONFIG)
    config, count = ctypes.c_void_p(), ctypes.c_int(0)
    chosen = egl.eglBindAPI(_OPENGL_API) and egl.eglChooseConfig(
        display, wanted, ctypes.byref(config), 1, ctypes.byref(count)
    )
    for major, minor in VERSIONS if chosen and count.value else ():
        attributes = (ctypes.c_int * 7)(_MAJOR, major, _MINOR, minor, _PROFILE, _CORE, _NONE)
        context = egl.eglCreateContext(display, config, None, attributes)
        if context and egl.eglMakeCurrent(display, None, None, context):
            egl.eglMakeCurrent(display, None, None, None)
            return context
        if context:
            egl.eglDestroyContext(display, context)
    egl.eglTerminate(display)
    raise OSError("it opens no context")


def _load() -> Any:
    """Loads EGL's library, with the types of the functions that are called."""
    egl = library("libEGL.so.1", "libEGL.so")
    library("libOpenGL.so.0", "libOpenGL.so", "libGL.so.1", "libGL.so")
    pointer, yes = ctypes.c_void_p, ctypes.c_uint
    for name, result, arguments in (
        ("eglGetProcAddress", pointer, [ctypes.c_char_p]),
        ("eglGetDisplay", pointer, [pointer]),
        ("eglInitialize", yes, [pointer, pointer, pointer]),
        ("eglBindAPI", yes, [ctypes.c_uint]),
        ("eglChooseConfig", yes, [pointer, pointer, pointer, ctypes.c_int, pointer]),
        ("eglCreateContext", pointer, [pointer, pointer, pointer, pointer]),
        ("eglMakeCurrent", yes, [pointer, pointer, pointer, pointer]),
        ("eglDestroyContext", yes, [pointer, pointer]),
        ("eglTerminate", yes, [pointer]),
    ):
        entry = getattr(egl, name)
        entry.restype, entry.argtypes = result, arguments
    return egl


def _handles(egl: Any) -> list[Any] | None:
    """Lists EGL's devices; None where it has no list of them.

    Raises:
        OSError: It has a list and does not give it.
    """
    pointer = ctypes.c_void_p
    query = _extension(egl, "eglQueryDevicesEXT", ctypes.c_uint, ctypes.c_int, pointer, pointer)
    if query is None:
        return None
    handles, count = (ctypes.c_void_p * _MAX_DEVICES)(), ctypes.c_int(0)
    if not query(_MAX_DEVICES, ctypes.addressof(handles), ctypes.addressof(count)):
        raise OSError("it lists no devices")
    return list(handles[: count.value])


def _displays(egl: Any) -> dict[int, Any]:
    """Returns displays by device index; -1 is the default one, where there is no list."""
    pointer = ctypes.c_void_p
    display = _extension(egl, "eglGetPlatformDisplayEXT", pointer, ctypes.c_uint, pointer, pointer)
    handles = _handles(egl)
    if handles is None or display is None:
        with _no_window():
            return {-1: egl.eglGetDisplay(None)}
    return {i: display(_PLATFORM_DEVICE_EXT, handle, None) for i, handle in enumerate(handles)}


def _extensions(egl: Any, index: int) -> list[bytes]:
    """Lists the extensions of the device of an index."""
    text = _extension(
        egl, "eglQueryDeviceStringEXT", ctypes.c_char_p, ctypes.c_void_p, ctypes.c_int
    )
    handles = _handles(egl)
    if text is None or handles is None or index < 0:
        return []
    return (text(handles[index], _EXTENSIONS) or b"").split()


def _extension(egl: Any, name: str, result: Any, *arguments: Any) -> Any:
    """Returns a function of an extension; None if it is missing."""
    address = egl.eglGetProcAddress(name.encode())
    return ctypes.CFUNCTYPE(result, *arguments)(address) if address else None


@contextmanager
def _no_window() -> Iterator[None]:
    """Takes away the variable that would make the default display a window's."""
    kept = os.environ.pop("DISPLAY", None)
    try:
        yield
    finally:
        if kept is not None:
            os.environ["DISPLAY"] = kept


def library(*names: str) -> Any:
    """Loads the first library of several that is there.

    Raises:
        OSError: None is; says what brings the first.
    """
    for name in names:
        with suppress(OSError):
            return ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
    raise OSError(mend(names[:1]) if names[0] in OF_EGL else f"{names[0]} is missing")
