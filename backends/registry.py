"""Backends by name: ours, and those of third parties through entry points.

A package adds one with an entry point in the group ``scenec.backends``: its name is the backend's,
its value the class, which implements ``contract.Backend``. Nothing is
imported before it is asked for.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable
from functools import partial
from typing import Any

from scenec.backends.contract import Backend
from scenec.schemas.errors import BackendError
from scenec.schemas.frames import ANNOTATION, ANNOTATION_NAMES
from scenec.schemas.plugins import entry_points_of, load, names_of, offered, origin, told

GROUP = "scenec.backends"

#: Name -> (module:class, extra of the package that brings what it needs).
BUILT_IN: dict[str, tuple[str, str | None]] = {
    "mitsuba": ("scenec.backends.mitsuba:Mitsuba", "mitsuba"),
    "cycles": ("scenec.backends.cycles:Cycles", "cycles"),
    "pyrender": ("scenec.backends.pyrender:Pyrender", "pyrender"),
}
#: The packages that draw for them.
_PACKAGES = {"mitsuba": "mitsuba", "cycles": "bpy", "pyrender": "pyrender-maintained"}
#: What people also call them.
_OTHER_NAMES = {"blender": "cycles", "bpy": "cycles", "opengl": "pyrender", "gl": "pyrender"}
#: In place of a name: the first that works (``scenec.backends.run.auto``).
AUTO = "auto"


def backend_names() -> tuple[str, ...]:
    """Names of all renderers that could be asked for, installed or not; ours first."""
    return (*BUILT_IN, *(name for name in names_of(GROUP) if name not in BUILT_IN))


def require_name(name: str) -> None:
    """Check a name without importing anything.

    Raises:
        BackendError: There is no such backend; says the nearest name.
    """
    if name in BUILT_IN or name in ANNOTATION_NAMES:
        # Other packages' metadata need not be searched, which takes tens of milliseconds.
        return
    names = backend_names()
    if name not in names:
        known = {**{other: other for other in names}, **_OTHER_NAMES}
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
        hint = f"did you mean {known[near[0]]!r}? " if near else ""
        there = ", ".join((*names, ANNOTATION))
        raise BackendError(f"no backend {name!r}: {hint}there are {there}")


def distribution(name: str) -> tuple[str, ...]:
    """The package whose version a backend's pictures depend on; none for what is no renderer."""
    if name in _PACKAGES:
        return (_PACKAGES[name],)
    return tuple(point.dist.name for point in entry_points_of(GROUP, name) if point.dist)


def version_of(backend: Backend) -> str:
    """Returns a backend's version; with package and code if from another package."""
    others = "" if backend.name in BUILT_IN else origin(GROUP, backend.name)
    return f"{backend.version()} of {others}" if others else backend.version()


def backend_class(name: str, device: str = "auto") -> type[Backend]:
    """Import a backend's class, which says what it can do: no renderer starts.

    Args:
        name: One of ``backend_names``.
        device: "auto", or one of the backend's own devices.

    Raises:
        BackendError: No such backend, its class cannot be imported, or it has no such device.
    """
    require_name(name)
    if name in ANNOTATION_NAMES:
        raise BackendError(
            f"{name} has no rgb; leave rgb out of --passes, or use --backend mitsuba"
        )
    get, mend = _target(name)
    try:
        found: type[Backend] = get()
    except Exception as error:
        if name in BUILT_IN and not isinstance(error, ImportError | AttributeError):
            raise
        raise _not_imported(name, error, mend) from error
    if device not in ("auto", *found.devices):
        raise BackendError(
            f"backend {name} has no device {device!r}; it has auto, {', '.join(found.devices)}"
        )
    return found


def open_backend(name: str, device: str = "auto") -> Backend:
    """Import a backend and make one.

    Args:
        name: One of ``backend_names``.
        device: "auto", or one of the backend's own devices.

    Raises:
        BackendError: No such backend, not installed (says what to install), it has no such device,
            or it cannot start.
    """
    made = backend_class(name, device)
    try:
        return made(device=device)  # type: ignore[call-arg]
    except ImportError as error:
        raise _not_imported(name, error, _target(name)[1]) from error


def _target(name: str) -> tuple[Callable[[], Any], str]:
    """What imports a backend's class, and what mends it if that fails."""
    if name in BUILT_IN:
        target, extra = BUILT_IN[name]
        module, _, attribute = target.partition(":")
        mend = f"pip install 'scenec[{extra}]'" if extra else "pip install --force-reinstall scenec"
        return lambda: getattr(importlib.import_module(module), attribute), mend
    point = offered(GROUP, name, f"backend {name}", BackendError)
    package = point.dist.name if point.dist else name
    return partial(load, point), f"pip install --force-reinstall {package}"


def _not_imported(name: str, error: Exception, mend: str) -> BackendError:
    why = str(error) if name in BUILT_IN else told(error)
    return BackendError(f"backend {name} cannot be imported ({why}). Mend it with: {mend}")
