"""Reads OFF files as models: geometry only; normals of vertices are passed over."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scenec.compiler.assets.looks import NO_FACE_COLORS, NO_VERTEX_COLORS
from scenec.compiler.assets.parts import MeshFileError, polygon_warnings
from scenec.compiler.assets.shells import ParsedModel, Shell
from scenec.compiler.assets.trimesh_file import sound
from scenec.schemas.polygons import triangulate


def read_off(file: Path, looks: bool) -> ParsedModel:
    """Reads an ``.off`` file: one part.

    Its faces come as triangles, the first and then the second halves of quads, larger polygons.

    Raises:
        MeshFileError: The file is not sound.
    """
    with sound(".off"):
        text = file.read_bytes().decode("utf-8", errors="replace")
        text = "\n".join(line.partition("#")[0] for line in text.splitlines())
        if "OFF" not in text:
            raise MeshFileError("not an OFF file: it does not begin with 'OFF'")
        header, *rows = filter(None, map(str.split, text.partition("OFF")[2].splitlines()))
        vertices, faces = int(header[0]), int(header[1])
        points = np.array([row[:3] for row in rows[:vertices]], np.float64).reshape(vertices, 3)
        polygons = [row[1 : int(row[0]) + 1] for row in rows[vertices : vertices + faces]]
        counts = np.array([len(polygon) for polygon in polygons], np.int64)
        corners = np.array([word for polygon in polygons for word in polygon], np.int64)
        promised = sum(int(row[0]) for row in rows[vertices : vertices + faces])
        if len(polygons) != faces or len(corners) != promised:
            raise ValueError("cut short: it has not the vertices and faces that it promises")
        if corners.size and (corners.min() < 0 or corners.max() >= vertices):
            raise ValueError("a face index outside the range of its vertices")
        cut = triangulate(points, corners, counts)
        triangles = corners[cut.corners]
        size = counts[cut.polygon]
        second = (size == 4) & (np.diff(cut.polygon, prepend=-1) == 0)
        triangles[second] = np.roll(triangles[second], -1, axis=1)
        order = np.argsort(np.minimum(size, 5) + (second | (size > 4)), kind="stable")
        notes = []
        if "C" in text.partition("OFF")[0]:
            notes.append(NO_VERTEX_COLORS)
        if any(len(row) > int(row[0]) + 1 for row in rows[vertices : vertices + faces]):
            notes.append(NO_FACE_COLORS)
        shell = Shell("", points, triangles[order])
        warnings = polygon_warnings(cut.faults)
        return ParsedModel((shell,), (), None, None, notes=tuple(notes), warnings=warnings)
