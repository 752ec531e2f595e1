"""Wavefront OBJ: vertices and polygons; materials, normals and texture coordinates are passed over.

The format says nothing of units or of the upward axis.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scenec.compiler.assets.parts import MeshFileError, Parsed, Part, fans

#: Free-form geometry, which has no polygons.
_FREE_FORM = frozenset({"curv", "curv2", "surf", "cstype", "bmat", "parm"})


def read_obj(file: Path) -> Parsed:
    """Reads an OBJ file.

    Its parts are its objects (``o``) or, where it has none, its groups (``g``).

    Raises:
        MeshFileError: A line makes no sense, or the file holds free-form surfaces.
    """
    # What is not ASCII can stand in names and comments only.
    lines = file.read_bytes().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
    named_by = b"o" if any(line[:2] in (b"o ", b"o\t") for line in lines) else b"g"
    points: list[tuple[float, float, float]] = []
    corners: dict[str, list[int]] = {}
    counts: dict[str, list[int]] = {}
    name = ""
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == b"v":
                x, y, z = words[1:4]
                points.append((float(x), float(y), float(z)))
            elif words[0] == b"f":
                # Of "v", "v/vt", "v//vn" or "v/vt/vn"; counted from 1, or back from the last.
                own = [int(word.split(b"/", 1)[0]) - 1 for word in words[1:]]
                if min(own, default=0) < -1:
                    own = [k if k >= -1 else k + 1 + len(points) for k in own]
                corners.setdefault(name, []).extend(own)
                counts.setdefault(name, []).append(len(own))
            elif words[0] == named_by:
                name = line.strip()[1:].strip().decode("utf-8", errors="replace")
            elif words[0].decode("latin-1") in _FREE_FORM:
                raise MeshFileError(f"line {number}: a free-form surface: export it as polygons")
        except ValueError as error:
            text = line.strip()[:60].decode("latin-1")
            raise MeshFileError(f"line {number}: {text!r} is no line of an OBJ file") from error
    array = np.array(points, np.float64).reshape(-1, 3)
    parts = (
        Part(key, array, fans(np.array(counts[key], np.int64), np.array(corners[key], np.int64)))
        for key in corners
    )
    return Parsed(tuple(parts), None, None)
