"""Finds what other packages add by entry points: passes, and kinds of things that a cfg names.

A cfg's kind is a dataclass whose fields are its keys: declared as scenec's own
(``scenec.compiler.kinds.declare``), or by a ``SCHEMA``, the JSON Schema of them. Which kinds there
are: ``KINDS``. Nothing is imported to know that one is there.

What is made by another package's code depends on it: ``origin`` states package, version and a
digest of the code, without running any of it.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenec.schemas.errors import PluginError, ScenecError
from scenec.schemas.spelling import nearest, shown

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint, EntryPoints

#: Groups of entry points whose names a cfg can give, and what one of each is called.
KINDS = {
    "scenec.relief": "relief operator",
    "scenec.conditions": "condition",
    "scenec.densities": "density",
    "scenec.rocks": "family of rocks",
    "scenec.surfaces": "surface",
    "scenec.poses": "pose",
    "scenec.skies": "sky",
    "scenec.clouds": "layer of clouds",
    "scenec.effects": "effect",
    "scenec.scans": "scan pattern",
}

#: The same, with what is no kind.
_ALL = KINDS | {
    "scenec.passes": "pass",
    "scenec.exporters": "format",
    "scenec.backends": "backend",
}

#: What marks, in a field's metadata, a key of the cfg, and what is made of where it stands.
KEY, GIVEN = "scenec.key", "scenec.given"
#: Hexadecimal digits that a digest of code is stated by.
_DIGITS = 12
#: Digests of code by module and ``sys.path``: of the code that this process runs, edited or not.
_codes: dict[tuple[str, tuple[str, ...]], str] = {}
#: Where the code lies that was loaded, and whose it is.
_loaded: dict[Path, str] = {}
#: Names that kinds were loaded by; also of the classes that they draw.
_names: dict[tuple[str, Any], str] = {}


def entry_points_of(group: str, name: str) -> tuple[EntryPoint, ...]:
    """Returns other packages' entry points of a name."""
    return _offered(group, tuple(sys.path)).get(name, ())


def names_of(group: str) -> tuple[str, ...]:
    """All names in a group, sorted."""
    return tuple(sorted(_offered(group, tuple(sys.path))))


def installed() -> dict[str, list[str]]:
    """Returns what other packages offer, by package: each with what it is called and its name."""
    found: dict[str, list[str]] = {}
    for group, title in _ALL.items():
        for name in names_of(group):
            for point in entry_points_of(group, name):
                whose = f"{point.dist.name} {point.dist.version}" if point.dist else point.module
                found.setdefault(whose, []).append(f"{title} {name}")
    return found


def origin(group: str, name: str) -> str:
    """Returns package, version and code that something comes from."""
    return ", ".join(
        (f"{point.dist.name} {point.dist.version}" if point.dist else point.value) + _code_of(point)
        for point in entry_points_of(group, name)
    )


def origins(group: str, names: Iterable[str]) -> dict[str, str]:
    """The same by name, of those that packages offer."""
    return {name: origin(group, name) for name in names if entry_points_of(group, name)}


def place(point: EntryPoint) -> str:
    """Returns the target of an entry point, for messages."""
    return point.value + (f" of {point.dist.name}" if point.dist else "")


def named(group: str, name: str) -> str:
    """Returns what a kind that packages offer is called in messages, and whose it is."""
    return f"{KINDS[group]} {shown(name)} ({', '.join(map(place, entry_points_of(group, name)))})"


def load(point: EntryPoint) -> Any:
    """Loads an entry point's object; its exceptions are another package's, see ``error_line``."""
    # First: what is stated is what runs.
    _code_of(point)
    who = point.dist.name if point.dist else point.module
    _loaded.update((root, who) for root in _roots(point.module))
    return point.load()


def offered(group: str, name: str, title: str, kind: type[ScenecError]) -> EntryPoint:
    """Finds the entry point of a name that packages offer.

    Args:
        group, name: Of the entry point; there is one.
        title: What it is called in messages.
        kind: Of the error.

    Raises:
        ScenecError: Of that kind: several packages offer it.
    """
    points = entry_points_of(group, name)
    if len(points) > 1:
        listed = ", ".join(map(place, points))
        raise kind(f"several packages offer the {title}: {listed}; remove one")
    return points[0]


def load_offered(group: str, name: str, title: str, kind: type[ScenecError]) -> tuple[Any, str]:
    """Loads what a package offers under a name; gives it, and whose it is, for messages.

    Args:
        group, name, title, kind: As of ``offered``.

    Raises:
        ScenecError: Of that kind: several packages offer it, or it cannot be imported.
    """
    point = offered(group, name, title, kind)
    who = f"{title} ({place(point)})"
    try:
        return load(point), who
    except Exception as error:
        raise kind(f"{who}: cannot be imported: {error_line(error)}") from error


def error_line(error: BaseException) -> str:
    """Describes an error of another package's code, and where in it it was raised, in a line."""
    text, found = _text(error), _raised_in(error)
    said = f"{type(error).__name__}{text and f': {text}'}"
    if found is None:
        return said
    root, at = found
    return f"{said} ({Path(at.filename).relative_to(root.parent).as_posix()}, line {at.lineno})"


@contextmanager
def blaming(what: str = "", kind: type[ScenecError] = PluginError) -> Iterator[None]:
    """Turns an exception that comes out of another package's code into one line that names it.

    Args:
        what: Was being made, for the message.
        kind: Of the error.

    Raises:
        ScenecError: Of that kind. Exceptions of scenec's own, and of its code, stay as they are.
    """
    try:
        yield
    except (ScenecError, KeyboardInterrupt):
        raise
    except BaseException as error:
        found = _raised_in(error)
        if found is None:
            raise
        before = f"{what}: " if what else ""
        raise kind(f"{before}plug-in {_loaded[found[0]]}: {error_line(error)}") from error


def _text(error: BaseException) -> str:
    """Returns an error's message, in a line; "" if asking fails: it is not our code."""
    try:
        return " ".join(str(error).split())
    except KeyboardInterrupt:
        raise
    except BaseException:  # noqa: BLE001 (as in ``blaming``)
        return ""


def _raised_in(error: BaseException) -> tuple[Path, traceback.FrameSummary] | None:
    """Returns the innermost line of another package's code that raised an error, and its root."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        for root in _loaded:
            if Path(frame.filename).is_relative_to(root):
                return root, frame
    return None


def _code_of(point: EntryPoint) -> str:
    """Returns a digest of the code behind an entry point, in words; "" where none is found."""
    key = point.module, tuple(sys.path)
    if key not in _codes:
        # Imported here: few processes meet another package.
        import hashlib

        from scenec.schemas.files import digest_of_folder, sha256

        digest = hashlib.sha256()
        roots = _roots(point.module)
        for root in roots:
            digest.update((digest_of_folder(root) if root.is_dir() else sha256(root)).encode())
        # Other modules that came with it.
        there = set(roots)
        for name in sorted((point.dist.files if point.dist else None) or (), key=str):
            file = Path(str(name.locate()))
            if name.suffix == ".py" and file.is_file():
                digest.update(f"{name} {sha256(file)}\n".encode())
                there |= {file, file.parent}
        # Of an editable install these are elsewhere, and only their names came with it.
        listed = (point.dist.read_text("top_level.txt") if point.dist else None) or ""
        for root in (root for one in sorted(listed.split()) for root in _roots(one)):
            if root not in there:
                more = digest_of_folder(root) if root.is_dir() else sha256(root)
                digest.update(f"{root.name} {more}\n".encode())
        _codes[key] = f" (code {digest.hexdigest()[:_DIGITS]})" if roots else ""
    return _codes[key]


def _roots(module: str) -> list[Path]:
    """Returns a module's file, or its package's folder; runs no code."""
    name, _, rest = module.partition(".")
    try:
        spec = importlib.util.find_spec(name)
        while spec is not None and not spec.has_location and rest:
            # A namespace holds packages of many.
            part, _, rest = rest.partition(".")
            name = f"{name}.{part}"
            spec = importlib.util.find_spec(name)
    except (ImportError, ValueError, AttributeError):
        return []
    if spec is None:
        return []
    folders = [Path(folder) for folder in spec.submodule_search_locations or ()]
    return folders or ([Path(spec.origin)] if spec.has_location and spec.origin else [])


@cache
def load_kind(group: str, name: str) -> type[Any]:
    """Returns the class of a kind that a cfg names.

    Raises:
        ScenecError: There is none, or several; or it is not what it should be.
    """
    title = f"{KINDS[group]} {shown(name)}"
    if not entry_points_of(group, name):
        raise ScenecError(f"no {title}{nearest(name, names_of(group))}")
    made, who = load_offered(group, name, title, ScenecError)
    schema = getattr(made, "SCHEMA", {} if _declares(made) else None)
    if not dataclasses.is_dataclass(made) or not isinstance(schema, Mapping):
        raise ScenecError(
            f"{who}: expected a dataclass with a SCHEMA, a JSON Schema of its keys, or one whose "
            "fields are made by key"
        )
    keys = schema.get("properties", {})
    if not isinstance(keys, Mapping):
        raise ScenecError(f"{who}: SCHEMA: expected its keys under properties")
    lacks = sorted(set(keys) - {field.name for field in dataclasses.fields(made)})
    if lacks:
        raise ScenecError(f"{who}: SCHEMA: the class has no field {shown(lacks[0])}")
    give_name(group, made, name)  # type: ignore[arg-type]
    return made  # type: ignore[return-value]


def _declares(kind: Any) -> bool:
    """Whether all fields of a class are declared, but for those that it derives."""
    if not dataclasses.is_dataclass(kind):
        return False
    own = [field for field in dataclasses.fields(kind) if field.name in kind.__annotations__]
    return all({KEY, GIVEN} & field.metadata.keys() or field.name == "key" for field in own)


def plugin_name(group: str, kind: type[Any]) -> str:
    """Returns the name that a class was loaded by, or that what was loaded by it has drawn."""
    return _names[group, kind]


def give_name(group: str, kind: type[Any], name: str) -> None:
    """Remembers by which name a class was loaded, or what was loaded by it has drawn one."""
    _names.setdefault((group, kind), name)


@cache
def _offered(group: str, _path: tuple[str, ...]) -> Mapping[str, tuple[EntryPoint, ...]]:
    """All entry points of a group, by name."""
    points: dict[str, tuple[EntryPoint, ...]] = {}
    for point in _all(_path).select(group=group):
        points[point.name] = (*points.get(point.name, ()), point)
    return points


@cache
def _all(_path: tuple[str, ...]) -> EntryPoints:
    """All entry points; searching other packages' metadata takes milliseconds."""
    from importlib.metadata import entry_points

    return entry_points()
