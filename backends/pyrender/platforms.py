"""An OpenGL context without a window: through EGL, or else through OSMesa.

PyOpenGL binds to one platform when it is first imported and cannot change its mind, so EGL is tried
beforehand, by hand. A process has one context, which all ``Pyrender`` objects in it share.
"""

from __future__ import annotations

import atexit
import ctypes
import importlib
import importlib.metadata
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenec.schemas.errors import BackendError

#: Environment variable that names a platform, "egl" or "osmesa", for those who want that one.
PLATFORM_VARIABLE = "SCENEC_PYRENDER_PLATFORM"
MEND = "Mend it with: pip install 'scenec[osmesa]'"

# From EGL/egl.h and EGL/eglext.h.
_EGL_EXTENSIONS = 0x3055
_EGL_PLATFORM_DEVICE_EXT = 0x313F
_EGL_OPENGL_API = 0x30A2
_EGL_OPENGL_BIT = 0x0008
_EGL_NONE = 0x3038
_EGL_CONFIG = (0x3033, 1, 0x3040, _EGL_OPENGL_BIT, 0x3025, 24, _EGL_NONE)  # pbuffer, GL, depth
_EGL_CONTEXT = (0x3098, 4, 0x30FB, 1, 0x30FD, 1, _EGL_NONE)  # 4.1 core
_MAX_DEVICES = 64

#: Software OpenGL in a wheel.
_WHEEL = "lavavu-osmesa"
#: Name of our platform for PyOpenGL, and its class as PyOpenGL loads it.
_PLUGIN = ("scenec_osmesa", "scenec.backends.pyrender.osmesa.WheelOSMesaPlatform")


@dataclass(frozen=True)
class EglDevice:
    """A device that EGL can draw with.

    Attributes:
        index: Among all of EGL's devices; -1 is the default display (EGL without a list of them).
        nvidia: Whether it is an NVIDIA GPU.
        software: Whether it is no GPU at all.
    """

    index: int
    nvidia: bool
    software: bool


@dataclass(frozen=True)
class Context:
    """The process's OpenGL context.

    Attributes:
        platform: pyrender's platform object.
        name: "egl" or "osmesa".
        device: "cuda" on an NVIDIA GPU, else "cpu".
        renderer: What OpenGL calls itself.
    """

    platform: Any
    name: str
    device: str
    renderer: str


_context: Context | None = None


def acquire(device: str = "auto") -> Context:
    """The process's context, current; made when first asked for.

    Args:
        device: "cpu", "cuda", or "auto": an NVIDIA GPU where there is one, else software.

    Raises:
        BackendError: There is no way to draw here, or not with this device; says what mends it.
    """
    global _context
    if _context is None:
        _context = _make(device)
    elif device not in ("auto", _context.device):
        raise BackendError(
            f"pyrender: this process already draws with {_context.device}; it has no second device"
        )
    _context.platform.make_current()
    return _context


def alive() -> bool:
    """Whether there is a context to free things in; not so while Python ends."""
    return _context is not None


@atexit.register
def _close() -> None:
    """Free the context while modules are still there to do it with."""
    global _context
    context, _context = _context, None
    if context is not None:
        context.platform.delete_context()
        # pyrender's own finalizer would do it again.
        context.platform.delete_context = lambda: None


def _make(device: str) -> Context:
    wanted = os.environ.get(PLATFORM_VARIABLE) or None
    if wanted not in (None, "egl", "osmesa"):
        raise BackendError(f"{PLATFORM_VARIABLE} is {wanted!r}; it takes egl or osmesa")
    if "OpenGL.platform" in sys.modules:
        bound = type(sys.modules["OpenGL.platform"].PLATFORM).__name__
        found = "egl" if "EGL" in bound else "osmesa" if "OSMesa" in bound else None
        if found is None or wanted not in (None, found):
            raise BackendError(
                f"pyrender: PyOpenGL is already in use in this process ({bound}) and cannot be "
                "bound anew; it takes a process of its own"
            )
        wanted = found
    reasons = []
    if wanted != "osmesa":
        try:
            return _through_egl(choose(egl_devices(), device))
        except OSError as error:
            reasons.append(f"EGL: {error}")
    if wanted != "egl" and device != "cuda":
        try:
            return _through_osmesa()
        except OSError as error:
            reasons.append(f"OSMesa: {error}")
    why = "; ".join(reasons)
    if device == "cuda":
        raise BackendError(f"pyrender: no NVIDIA GPU to draw with ({why}); use --device cpu")
    raise BackendError(f"pyrender: no OpenGL without a window here ({why}). {MEND}")


def choose(devices: list[EglDevice], device: str) -> EglDevice:
    """The device to draw with.

    Graphics chips of other makers are taken only where there is nothing else: pictures were only
    ever compared on NVIDIA's and in software.

    Raises:
        OSError: There is none of that kind.
    """
    kinds = {
        "cuda": [d for d in devices if d.nvidia],
        "cpu": [d for d in devices if d.software],
    }
    kinds["auto"] = kinds["cuda"] or kinds["cpu"] or devices
    if not kinds[device]:
        raise OSError(f"none of its {len(devices)} devices is a {device} one")
    return kinds[device][0]


def egl_devices() -> list[EglDevice]:
    """Devices through which EGL makes a context here, found without PyOpenGL.

    Raises:
        OSError: There is no EGL, or no OpenGL to go with it, or none of its devices works.
    """
    egl = _library("libEGL.so.1", "libEGL.so")
    _library("libOpenGL.so.0", "libOpenGL.so", "libGL.so.1", "libGL.so")
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]
    pointer = ctypes.c_void_p

    def function(name: str, result: Any, *arguments: Any) -> Any:
        address = egl.eglGetProcAddress(name.encode())
        return ctypes.CFUNCTYPE(result, *arguments)(address) if address else None

    query = function("eglQueryDevicesEXT", ctypes.c_uint, ctypes.c_int, pointer, pointer)
    text = function("eglQueryDeviceStringEXT", ctypes.c_char_p, pointer, ctypes.c_int)
    display = function("eglGetPlatformDisplayEXT", pointer, ctypes.c_uint, pointer, pointer)
    if query is None or text is None or display is None:
        egl.eglGetDisplay.restype = pointer
        egl.eglGetDisplay.argtypes = [pointer]
        if not _opens(egl, egl.eglGetDisplay(None)):
            raise OSError("its default display opens no OpenGL 4.1 context")
        return [EglDevice(-1, False, True)]
    handles, count = (pointer * _MAX_DEVICES)(), ctypes.c_int(0)
    if not query(_MAX_DEVICES, ctypes.addressof(handles), ctypes.addressof(count)):
        raise OSError("it lists no devices")
    found = []
    for index in range(count.value):
        extensions = (text(handles[index], _EGL_EXTENSIONS) or b"").split()
        nvidia = b"EGL_NV_device_cuda" in extensions
        software = b"EGL_MESA_device_software" in extensions
        if _opens(egl, display(_EGL_PLATFORM_DEVICE_EXT, handles[index], None)):
            found.append(EglDevice(index, nvidia, software))
    if not found:
        raise OSError(f"none of its {count.value} devices opens an OpenGL 4.1 context")
    return found


def _opens(egl: Any, display: Any) -> bool:
    """Whether a display makes a context current without a surface, as pyrender will."""
    pointer = ctypes.c_void_p
    for name, result, arguments in (
        ("eglInitialize", ctypes.c_uint, [pointer, pointer, pointer]),
        ("eglBindAPI", ctypes.c_uint, [ctypes.c_uint]),
        ("eglChooseConfig", ctypes.c_uint, [pointer, pointer, pointer, ctypes.c_int, pointer]),
        ("eglCreateContext", pointer, [pointer, pointer, pointer, pointer]),
        ("eglMakeCurrent", ctypes.c_uint, [pointer, pointer, pointer, pointer]),
        ("eglDestroyContext", ctypes.c_uint, [pointer, pointer]),
        ("eglTerminate", ctypes.c_uint, [pointer]),
    ):
        entry = getattr(egl, name)
        entry.restype, entry.argtypes = result, arguments
    if not display or not egl.eglInitialize(display, None, None):
        return False
    wanted = (ctypes.c_int * len(_EGL_CONFIG))(*_EGL_CONFIG)
    attributes = (ctypes.c_int * len(_EGL_CONTEXT))(*_EGL_CONTEXT)
    config, count = pointer(), ctypes.c_int(0)
    opened = False
    if (
        egl.eglBindAPI(_EGL_OPENGL_API)
        and egl.eglChooseConfig(display, wanted, ctypes.byref(config), 1, ctypes.byref(count))
        and count.value
    ):
        context = egl.eglCreateContext(display, config, None, attributes)
        if context:
            opened = bool(egl.eglMakeCurrent(display, None, None, context))
            egl.eglMakeCurrent(display, None, None, None)
            egl.eglDestroyContext(display, context)
    egl.eglTerminate(display)
    return opened


def _library(*names: str) -> Any:
    for name in names:
        try:
            return ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
        except OSError:
            continue
    raise OSError(f"{names[0]} is missing")


def _through_egl(device: EglDevice) -> Context:
    os.environ["PYOPENGL_PLATFORM"] = "egl"
    from pyrender.platforms import egl

    chosen = egl.EGLDevice(None) if device.index < 0 else egl.get_device_by_index(device.index)
    return _opened(egl.EGLPlatform(1, 1, chosen), "egl", "cuda" if device.nvidia else "cpu")


def _through_osmesa() -> Context:
    # First, since PyOpenGL would say nothing of what is missing.
    load_osmesa()
    from OpenGL.plugins import PlatformPlugin

    PlatformPlugin(*_PLUGIN)
    os.environ["PYOPENGL_PLATFORM"] = _PLUGIN[0]
    from pyrender.platforms.osmesa import OSMesaPlatform

    return _opened(OSMesaPlatform(1, 1), "osmesa", "cpu")


def load_osmesa() -> Any:
    """The libOSMesa of the ``lavavu-osmesa`` wheel, or the system's, loaded.

    LavaVu, a viewer of its own, is never imported. What its libOSMesa needs lies beside it under
    names that only the wheel knows, and no library holds a path to another: once they are loaded,
    the linker finds them by those names. They need each other, so each round loads those whose
    needs have been met.

    Raises:
        OSError: There is none, or it cannot be loaded; says why.
    """
    left = wheel_libraries()
    if not left:
        return _library("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
    reason = OSError(f"{_WHEEL} holds no libOSMesa")
    for _ in range(len(left)):
        failed = []
        for path in left:
            try:
                library = ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
            except OSError as error:
                failed.append(path)
                reason = error
                continue
            if path.name.startswith("libOSMesa"):
                return library
        left = failed
    raise reason


def wheel_libraries() -> list[Path]:
    """The shared libraries that the wheel brings, in alphabetical order; [] if not installed."""
    try:
        files = importlib.metadata.files(_WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    # LavaVu's own extension modules lie elsewhere.
    paths = [Path(str(file.locate())) for file in files if file.parts[0].endswith(".libs")]
    return sorted(path for path in paths if path.is_file())


def _opened(platform: Any, name: str, device: str) -> Context:
    try:
        platform.init_context()
        platform.make_current()
    except Exception as error:
        raise BackendError(
            f"pyrender: cannot open OpenGL through {name} ({type(error).__name__}: {error}). {MEND}"
        ) from error
    gl = importlib.import_module("OpenGL.GL")
    renderer = gl.glGetString(gl.GL_RENDERER).decode(errors="replace")
    return Context(platform, name, device, renderer)
