"""Backends by name: ours, and those of third parties through entry points.

A package adds one with an entry point in the group ``scenec.backends``: its name is the backend's,
its value the class, which is a ``contract.Backend``. Nothing is
imported before it is asked for.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from scenec.backends.contract import Backend, completed
from scenec.schemas.errors import BackendError
from scenec.schemas.extras import install
from scenec.schemas.passes import ANNOTATION, ANNOTATION_NAMES
from scenec.schemas.plugins import entry_points_of, error_line, load, names_of, offered, origin

GROUP = "scenec.backends"


@dataclass(frozen=True)
class Entry:
    """A backend of ours.

    Attributes:
        target: Its class, ``module:class``.
        extra: Of scenec, brings what it needs.
        package: Draws for it.
        also: What people call it, too.
    """

    target: str
    extra: str
    package: str
    also: tuple[str, ...] = ()


#: Backends of ours by name, in order of preference.
BUILT_IN: dict[str, Entry] = {
    "mitsuba": Entry("scenec.backends.mitsuba:Mitsuba", "mitsuba", "mitsuba"),
    "cycles": Entry("scenec.backends.cycles:Cycles", "cycles", "bpy", ("blender", "bpy")),
    "pyrender": Entry(
        "scenec.backends.pyrender:Pyrender", "pyrender", "pyrender-maintained", ("opengl", "gl")
    ),
}
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
        known = {other: other for other in names}
        known |= {other: name for name, entry in BUILT_IN.items() for other in entry.also}
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
        hint = f"did you mean {known[near[0]]!r}? " if near else ""
        there = ", ".join((*names, ANNOTATION))
        raise BackendError(f"no backend {name!r}: {hint}there are {there}")


def distribution(name: str) -> tuple[str, ...]:
    """The package whose version a backend's pictures depend on; none for what is no renderer."""
    if name in BUILT_IN:
        return (BUILT_IN[name].package,)
    return tuple(point.dist.name for point in entry_points_of(GROUP, name) if point.dist)


def version_of(backend: Backend) -> str:
    """Returns a backend's version; with package and code if from another package."""
    others = "" if backend.name in BUILT_IN else origin(GROUP, backend.name)
    return f"{backend.version()} of {others}" if others else backend.version()


def backend_class(name: str, device: str = "auto") -> type[Backend]:
    """Imports a backend's class, which says what it can do: no renderer starts.

    A class that does not derive from ``Backend`` is given what it lacks of it.

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
        backend: type[Backend] = get()
    except Exception as error:
        if name in BUILT_IN and not isinstance(error, ImportError | AttributeError):
            raise
        raise _not_imported(name, error, mend) from error
    if not isinstance(backend, type) or not hasattr(backend, "devices"):
        raise BackendError(f"backend {name}: {origin(GROUP, name)} offers no class with devices")
    if device not in ("auto", *backend.devices):
        raise BackendError(
            f"backend {name} has no device {device!r}; it has auto, {', '.join(backend.devices)}"
        )
    kind = completed(backend)
    if lacks := sorted(kind.__abstractmethods__):
        raise BackendError(
            f"backend {name}: its class {backend.__name__} has no {' and no '.join(lacks)}"
        )
    return kind


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
        return made(device=device)
    except ImportError as error:
        raise _not_imported(name, error, _target(name)[1]) from error


def _target(name: str) -> tuple[Callable[[], Any], str]:
    """Returns a function that imports a backend's class, and the remedy if that fails."""
    if name in BUILT_IN:
        entry = BUILT_IN[name]
        module, _, attribute = entry.target.partition(":")
        return lambda: getattr(importlib.import_module(module), attribute), install(entry.extra)
    point = offered(GROUP, name, f"backend {name}", BackendError)
    package = point.dist.name if point.dist else name
    return partial(load, point), f"pip install --force-reinstall {package}"


def _not_imported(name: str, error: Exception, mend: str) -> BackendError:
    why = str(error) if name in BUILT_IN else error_line(error)
    return BackendError(f"backend {name} cannot be imported ({why}). Mend it with: {mend}")
