"""Pictures that stand inside of packages (usdz), also of packages within packages.

Their paths are OpenUSD's: ``scene.usdz[0/color.png]``, ``scene.usdz[inner.usdz[color.png]]``.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

_INTO = re.compile(r"(?<=\.usdz)\[", re.IGNORECASE)


def _split(path: Path) -> list[str]:
    """Returns the file, and the members that lead to a picture."""
    parts = _INTO.split(str(path))
    depth = len(parts) - 1
    if not depth or not parts[-1].endswith("]" * depth):
        return [str(path)]
    return [*parts[:-1], parts[-1][:-depth]]


def is_packaged(path: Path) -> bool:
    """Tells whether a path leads into a package."""
    return len(_split(path)) > 1


def file_around(path: Path) -> Path:
    """Returns the file on disk that a path leads into, or is."""
    return Path(_split(path)[0])


def in_package(package: str, name: str) -> Path:
    """Returns the path of a file in a package as its root layer names it."""
    return Path(f"{package}[{name.removeprefix('./')}]")


def packaged_name(path: Path) -> str:
    """Returns the name of a file, whether in a package or not."""
    return PurePosixPath(_split(path)[-1]).name


def beside(path: Path) -> list[Path]:
    """Lists what stands in the same folder as a file or, of one in a package, in that package."""
    if not is_packaged(path):
        return [*path.parent.iterdir()] if path.parent.is_dir() else []
    *outer, member = _split(path)
    depth = len(outer)
    before, after = str(path)[: -len(member) - depth], "]" * depth
    try:
        whole = packaged_bytes(Path(before[:-1] + after[:-1])) if depth > 1 else None
        with zipfile.ZipFile(outer[0] if whole is None else io.BytesIO(whole)) as archive:
            return [Path(before + name + after) for name in archive.namelist()]
    except (zipfile.BadZipFile, OSError, ValueError):
        return []


def packaged_bytes(path: Path) -> bytes:
    """Reads a member of a package.

    Raises:
        ValueError: There is none, or the package is broken or compressed, which usdz forbids.
    """
    file, *members = _split(path)
    try:
        data: str | io.BytesIO = file
        for member in members:
            with zipfile.ZipFile(data) as archive:
                if archive.getinfo(member).compress_type != zipfile.ZIP_STORED:
                    raise ValueError(f"{member} is compressed in its package, which usdz forbids")
                data = io.BytesIO(archive.read(member))
    except (zipfile.BadZipFile, KeyError, OSError, NotImplementedError, RuntimeError) as error:
        raise ValueError(f"cannot be read out of its package: {error}") from error
    assert isinstance(data, io.BytesIO)
    return data.getvalue()


@contextmanager
def as_file(path: Path) -> Iterator[Path]:
    """Yields a file of a path's bytes: of a package's, in a private folder that goes again.

    Raises:
        ValueError: As ``packaged_bytes``.
    """
    if not is_packaged(path):
        yield path
        return
    data = packaged_bytes(path)
    with TemporaryDirectory(prefix=".scenec-picture-") as folder:
        file = Path(folder) / packaged_name(path)
        file.write_bytes(data)
        yield file
