"""Files that a cfg names: beside it, or inside an installed Python package."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import re
from collections.abc import Callable
from pathlib import Path

from scenec.schemas.extras import install
from scenec.schemas.spelling import closest, shown

PREFIX = "package:"
#: Folders of scenec's own that cfgs can name as if they were packages.
OWN = ("assets", "configs")

# Where the name that is imported is not the one that is installed.
_DISTRIBUTIONS = {"warp": "warp-lang"}


class ResourceError(Exception):
    """A file that cannot be found; the message says what was looked for and what would help."""


def find_file(reference: str, folder: Path, what: str = "file") -> Path:
    """The file that a cfg's string stands for.

    A plain path is relative to the cfg's folder. ``package:NAME/path`` is a file of the installed
    package NAME, which is found without importing it; in the path, ``*`` stands for any part of a
    file's or folder's name, and exactly one file must match. ``package:assets/path`` and
    ``package:configs/path`` are scenec's own.

    Raises:
        ResourceError: There is no such file, or no such package, or more than one match.
    """
    if "\0" in reference:
        raise ResourceError(f"{shown(reference)}: a path cannot hold a zero character")
    fits = Path.is_file if what == "file" else Path.is_dir
    try:
        if reference.startswith(PREFIX):
            return _find_in_package(reference, what, fits)
        return _find_relative(reference, folder, what, fits)
    except OSError as error:
        raise ResourceError(f"{shown(reference)}: {error.strerror or error}") from error


def _find_relative(reference: str, folder: Path, what: str, fits: Callable[[Path], bool]) -> Path:
    path = folder / reference
    if fits(path):
        return path
    if path.is_dir() or path.is_file():
        found = "folder" if what == "file" else "file"
        raise ResourceError(f"{shown(reference)} is a {found}: expected a {what}")
    message = f"no {what} {shown(reference)} (paths are relative to the cfg's folder)"
    if path.parent.is_dir():
        there = sorted(path.parent.iterdir())
        guess = closest(path.name, [e.name for e in there if what == "file" or fits(e)])
        message += f"; did you mean {shown(guess)}?" if guess else ""
    raise ResourceError(message)


def _find_in_package(reference: str, what: str, fits: Callable[[Path], bool]) -> Path:
    name, _, pattern = reference.removeprefix(PREFIX).partition("/")
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or not pattern.strip("/"):
        raise ResourceError(f'{shown(reference)}: expected "{PREFIX}NAME/path/in/the/package"')
    parts = (pattern.rstrip("/") if what == "folder" else pattern).split("/")
    if {"..", "", "."} & set(parts):
        raise ResourceError(f"{shown(reference)}: expected a plain path below the package")
    matches = [
        path
        for root in _package_folders(name)
        for path in sorted(root.glob("/".join(parts)))
        if fits(path)
    ]
    if len(matches) == 1:
        return matches[0]
    if not matches:
        raise ResourceError(f"no {what} {shown(pattern)} in the installed package {shown(name)}")
    listed = ", ".join(match.name for match in matches[:4]) + (" …" if len(matches) > 4 else "")
    raise ResourceError(
        f"{shown(reference)} matches {len(matches)} {what}s, expected exactly one: {listed}"
    )


def packaged_files(folder: str, pattern: str) -> list[Path]:
    """Files that come with scenec, of one of its folders ``OWN``, sorted."""
    return [path for root in _package_folders(folder) for path in sorted(root.glob(pattern))]


def packaged_reference(file: Path) -> str | None:
    """Returns a cfg's reference to a file that comes with scenec; None for any other."""
    for name in OWN:
        for folder in _package_folders(name):
            if file.resolve().is_relative_to(folder.resolve()):
                inside = file.resolve().relative_to(folder.resolve())
                return f"{PREFIX}{name}/{inside.as_posix()}"
    return None


def _package_folders(name: str) -> list[Path]:
    if name in OWN:
        return [folder / name for folder in _package_folders("scenec")]
    # For a name without a dot, find_spec looks at files only and runs nothing of the package.
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError, AttributeError):
        spec = None
    if spec is None or not spec.submodule_search_locations:
        raise ResourceError(
            f"the Python package {shown(name)} is not installed here: {_how_to_install(name)}"
        )
    return [Path(location) for location in spec.submodule_search_locations]


def distribution_of(name: str) -> str:
    """Names the distribution to install for the package ``name``."""
    return _DISTRIBUTIONS.get(name, name)


def _how_to_install(name: str) -> str:
    distribution = distribution_of(name)
    try:
        requirements = importlib.metadata.requires("scenec") or []
    except importlib.metadata.PackageNotFoundError:
        requirements = []
    for requirement in requirements:
        required = re.match(r"[A-Za-z0-9._-]+", requirement)
        extra = re.search(r"extra == ['\"]([^'\"]+)['\"]", requirement)
        if required and extra and _canonical(required.group()) == _canonical(distribution):
            return install(extra.group(1))
    return f"pip install {distribution}"


def _canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
