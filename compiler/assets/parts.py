"""Shares what readers of mesh files have in common: faults, names, warnings of polygons."""

from __future__ import annotations


class MeshFileError(Exception):
    """Says what is wrong with a mesh file, in words that follow its name."""


def polygon_warnings(*faults: dict[str, int]) -> tuple[str, ...]:
    """Lists what ``schemas.polygons`` finds wrong in a file's meshes, and how often."""
    total: dict[str, int] = {}
    for found in faults:
        for what, count in found.items():
            total[what] = total.get(what, 0) + count
    return tuple(f"{what}: {count:,} in all" for what, count in sorted(total.items()))


def is_of(path: str, name: str) -> bool:
    """Whether a part's path is a name's, or stands below it in the file's hierarchy."""
    return path == name or path.startswith(name.rstrip("/") + "/") or name in path.split("/")
