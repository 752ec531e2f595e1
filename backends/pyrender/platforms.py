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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from scenec.backends.pyrender.egl import EglContext, EglDevice, egl_devices, library
from scenec.schemas.errors import BackendError
from scenec.schemas.extras import install

#: Environment variable that names a platform, "egl" or "osmesa", for those who want that one.
PLATFORM_VARIABLE = "SCENEC_PYRENDER_PLATFORM"
MEND = f"Mend it with: {install('osmesa')}"

#: Software OpenGL in a wheel.
_WHEEL = "lavavu-osmesa"
#: Name of our platform for PyOpenGL, and its class as PyOpenGL loads it.
_PLUGIN = ("scenec_osmesa", "scenec.backends.pyrender.osmesa.WheelOSMesaPlatform")


@dataclass(frozen=True)
class Context:
    """The process's OpenGL context.

    Attributes:
        platform: What makes it current, and deletes it.
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
    _leave_out_viewer()
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


def _leave_out_viewer() -> None:
    """Keeps pyrender's viewer from being imported: its pyglet wants X11 and libGL even unused.

    ``pyrender.Viewer`` is None in a process that draws for us.
    """
    if "pyrender" not in sys.modules:
        viewer = ModuleType("pyrender.viewer")
        vars(viewer)["Viewer"] = None
        sys.modules.setdefault(viewer.__name__, viewer)


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


def _through_egl(device: EglDevice) -> Context:
    os.environ["PYOPENGL_PLATFORM"] = "egl"
    return _opened(lambda: EglContext(device), "egl", "cuda" if device.nvidia else "cpu")


def _through_osmesa() -> Context:
    # First, since PyOpenGL would say nothing of what is missing.
    load_osmesa()
    from OpenGL.plugins import PlatformPlugin

    PlatformPlugin(*_PLUGIN)
    os.environ["PYOPENGL_PLATFORM"] = _PLUGIN[0]
    from pyrender.platforms.osmesa import OSMesaPlatform

    def open_context() -> Any:
        platform = OSMesaPlatform(1, 1)
        platform.init_context()
        platform.make_current()
        return platform

    return _opened(open_context, "osmesa", "cpu")


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
        return library("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
    reason = OSError(f"{_WHEEL} holds no libOSMesa")
    for _ in range(len(left)):
        failed = []
        for path in left:
            try:
                loaded = ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
            except OSError as error:
                failed.append(path)
                reason = error
                continue
            if path.name.startswith("libOSMesa"):
                return loaded
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


def _opened(open_context: Callable[[], Any], name: str, device: str) -> Context:
    try:
        platform = open_context()
    except Exception as error:
        raise BackendError(
            f"pyrender: cannot open OpenGL through {name} ({type(error).__name__}: {error}). {MEND}"
        ) from error
    gl = importlib.import_module("OpenGL.GL")
    renderer = gl.glGetString(gl.GL_RENDERER).decode(errors="replace")
    return Context(platform, name, device, renderer)
