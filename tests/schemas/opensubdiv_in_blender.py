"""Blender's subdivision modifier, which is OpenSubdiv's limit surface, for a test.

Runs in a process of its own: ``opensubdiv_in_blender.py FOLDER``, with cases in ``in.npy``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np

_BORDERS = {"edgeAndCorner": "PRESERVE_CORNERS", "edgeOnly": "ALL"}
_RULES = {
    "none": "SMOOTH_ALL",
    "cornersOnly": "PRESERVE_CORNERS",
    "cornersPlus1": "PRESERVE_CORNERS_AND_JUNCTIONS",
    "cornersPlus2": "PRESERVE_CORNERS_JUNCTIONS_AND_CONCAVE",
    "boundaries": "PRESERVE_BOUNDARIES",
    "all": "NONE",
}


def surface(points, counts, corners, border, creases, uv, rule):
    """Points, quads, and texture coordinates at their corners, three levels on."""
    mesh, ends = bpy.data.meshes.new("it"), np.cumsum(counts)
    polygons = [corners[e - n : e].tolist() for e, n in zip(ends, counts, strict=True)]
    mesh.from_pydata(points.tolist(), [], polygons)
    mesh.uv_layers.new().data.foreach_set("uv", uv.ravel().astype(np.float32))
    known = {frozenset((int(a), int(b))): s for a, b, s in creases}
    weights = mesh.attributes.new("crease_edge", "FLOAT", "EDGE")
    for edge in mesh.edges:
        # Blender squares its weights: ten times that is the sharpness.
        weights.data[edge.index].value = (known.get(frozenset(edge.vertices), 0.0) / 10) ** 0.5
    made = bpy.data.objects.new("it", mesh)
    bpy.context.scene.collection.objects.link(made)
    modifier = made.modifiers.new("it", "SUBSURF")
    modifier.levels, modifier.quality, modifier.use_limit_surface = 3, 10, True
    modifier.boundary_smooth, modifier.uv_smooth = _BORDERS[border], _RULES[rule]
    found = made.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    at, quads = np.empty(3 * len(found.vertices)), np.empty(len(found.loops), np.int32)
    flat = np.empty(2 * len(found.loops), np.float32)
    found.vertices.foreach_get("co", at)
    found.loops.foreach_get("vertex_index", quads)
    found.uv_layers[0].data.foreach_get("uv", flat)
    return at.reshape(-1, 3), quads.reshape(-1, 4), flat.reshape(-1, 2)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    cases = np.load(folder / "in.npy", allow_pickle=True)
    out = np.empty((len(cases), 3), object)
    for i, case in enumerate(cases):
        out[i] = surface(*case)
    np.save(folder / "out.npy", out, allow_pickle=True)
