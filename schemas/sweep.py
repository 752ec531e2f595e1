"""Reads a sweep: a folder of outputs, one a point, and ``sweep.json`` with their settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from scenec.schemas.codec import JSON, Natural, read_record, rest
from scenec.schemas.errors import OutputError
from scenec.schemas.files import inside
from scenec.schemas.manifest import MANIFEST

#: What makes a folder a sweep, where it holds no output itself.
SWEEP = "sweep.json"


@dataclass(frozen=True)
class SweepEntry:
    """Records a point: where its output lies, what came of it, the settings it was made with."""

    folder: str
    seed: Natural
    cfg_sha256: str
    state: str
    settings: Mapping[str, JSON] = rest()


@dataclass(frozen=True)
class SweepList:
    """Records a sweep: the cfg's name, and its points in order."""

    name: str
    points: tuple[SweepEntry, ...]


def is_sweep(out: Path) -> bool:
    """Whether a folder holds a sweep's list, and no output itself."""
    return (out / SWEEP).is_file() and not (out / MANIFEST).is_file()


def read_sweep(out: Path) -> SweepList:
    """Reads a sweep's list.

    Raises:
        FileNotFoundError: It is not there.
        OutputError: It is none, or names a folder outside of the sweep.
    """
    path = out / SWEEP
    found = read_record(path, SweepList, OutputError, "sweep's list")
    for i, point in enumerate(found.points):
        inside(out, point.folder, f"{path}: /points/{i}/folder")
    return found
