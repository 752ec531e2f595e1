"""Hashes what else than its inputs decides what a step makes: code, libraries, machine."""

from __future__ import annotations

import hashlib
import platform
import sys
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import scenec.compiler
import scenec.schemas
from scenec.schemas.files import digest_of_folder

#: Whose version can change what is computed.
_LIBRARIES = (
    *("scenec", "numpy", "numba", "llvmlite", "scipy", "usd-core", "openexr", "pillow"),
    *("trimesh", "rasterio", "bpy", "dracopy", "meshopt"),
)
#: What of the folders is code: data that code reads counts, too.
_SUFFIXES = frozenset({".py", ".json", ".csv", ".npz", ".npy", ".txt"})


@lru_cache(maxsize=1)
def fingerprint() -> str:
    """SHA-256 over every source file of compiler and schemas, versions, and the architecture.

    CPUs of one architecture give the same bits, and so do any number of threads, so neither counts.
    """
    digest = hashlib.sha256()
    for room in (scenec.compiler, scenec.schemas):
        digest.update(digest_of_folder(Path(room.__path__[0]), _SUFFIXES).encode())
    for name in _LIBRARIES:
        digest.update(f"{name} {_version(name)}\n".encode())
    python = platform.python_implementation(), *sys.version_info[:3]
    digest.update(f"{python} {platform.machine()} {sys.byteorder} {sys.platform}".encode())
    return digest.hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"
