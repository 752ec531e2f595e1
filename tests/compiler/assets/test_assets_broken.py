"""Broken mesh files: one line that names the file and the fault, and no crash."""

from __future__ import annotations

import numpy as np
import pytest
from test_assets_mesh_file import BOX, binary_stl, fails, read_mesh, solid

from scenec.schemas.errors import SceneError
from scenec.testing.overhangs import glb, gltf_document, shelter, triangles, write


def _broken() -> dict[str, tuple[bytes, str]]:
    header = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    header += b"property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
    header += b"end_header\n"
    vertices = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    document = gltf_document(3, 3)
    body = np.zeros(9, "<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
    outside = {**document, "buffers": [{"byteLength": 48, "uri": "mesh.bin"}]}
    draco = {**document, "extensionsRequired": ["KHR_draco_mesh_compression"]}
    still = {**document, "nodes": [{"mesh": 0, "rotation": [0, 0, 0, 0]}]}
    loop = {**document, "nodes": [{"children": [0], "mesh": 0}]}
    first, second = document["accessors"]
    long = {**document, "accessors": [{**first, "count": 4}, second]}
    kind = {**document, "accessors": [first, first]}
    huge = {**document, "accessors": [{**first, "count": 10**10}, second]}
    hollow = {**document, "accessors": [{**first, "bufferView": None}, second]}
    del hollow["accessors"][0]["bufferView"]
    sparse = {**document, "accessors": [{**first, "sparse": {}}, second]}
    beyond = np.zeros(9, "<f4").tobytes() + np.array([0, 1, 3], "<u4").tobytes()
    twice = {**document, "nodes": [{"children": [1, 1]}, {"mesh": 0}]}
    lines = {**document, "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]}]}
    return {
        "empty.obj": (b"", "the file is empty"),
        "text.glb": (b"just some words\n" * 4, "not a binary glTF file"),
        "text.usda": (b"just some words\n", "not a sound USD file"),
        "text.usdc": (b"PXR-USDC and no more", "not a sound USD file"),
        "text.ply": (b"just some words\n", "not a PLY file"),
        "text.gltf": (b"just some words\n", "not a sound glTF file"),
        "picture.obj": (b"\x89PNG\r\n\x1a\n" + bytes(64), "it holds no faces"),
        "renamed.obj": (header, "its content is that of a .ply file"),
        "mesh.fbx": (b"Kaydara", "expected a mesh (.obj, .ply"),
        "mesh": (b"v 0 0 0\n", "not a file without an ending"),
        "points.obj": (b"v 0 0 0\nv 1 0 0\n", "it holds no faces"),
        "range.obj": (b"v 0 0 0\nf 1 2 3\n", "uses vertex 2 (from 0) of 1"),
        "zero.obj": (vertices + b"f 0 1 2\n", "line 4: 'f 0 1 2' is no face"),
        "behind.obj": (vertices + b"f -1 -2 -4\n", "uses vertex -4"),
        "word.obj": (vertices + b"f 1 2 x\n", "line 4: 'f 1 2 x' is no face"),
        "lines.obj": (vertices + b"l 1 2 3\n", "it holds no faces"),
        "infinite.obj": (b"v 1e999 0 0\n" + vertices + b"f 1 2 3\n", "expected finite numbers"),
        "nan.obj": (b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "expected finite numbers"),
        "comma.obj": (b"v 0,5 0 0\n", "line 1: 'v 0,5 0 0' is no vertex"),
        "short.obj": (b"v 0 0 0\nv 1 2\n", "line 2"),
        "flat.obj": (b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "none of its 1 faces has an area"),
        "spline.obj": (b"v 0 0 0\ncstype bspline\n", "free-form surface"),
        "far.obj": (b"v 1e300 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "reaches out to 1e+300 m"),
        "nan.ply": (header + b"0 0 0\n1 0 nan\n0 1 0\n3 0 1 2\n", "expected finite numbers"),
        "range.ply": (header + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "uses vertex 7 (from 0) of 3"),
        "short.ply": (header + b"0 0 0\n1 0 0\n0 1 0\n", "cut short"),
        "words.ply": (header + b"0 0 zero\n1 0 0\n0 1 0\n3 0 1 2\n", "where a number belongs"),
        "header.ply": (b"ply\nformat ascii 1.0\nelement vertex x\nend_header\n", "a whole number"),
        "cloud.ply": (
            b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n",
            "without the element 'face'",
        ),
        "cut.glb": (glb(document, body)[:-8], "cut short"),
        "outside.glb": (glb(outside, b""), "the buffer 'mesh.bin', which is not there"),
        "draco.glb": (glb(draco, body), "KHR_draco_mesh_compression"),
        "still.glb": (glb(still, body), "a rotation is 0 0 0 0"),
        "loop.glb": (glb(loop, body), "node 0 is in two places"),
        "long.glb": (glb(long, body), "its header and its data do not fit"),
        "kind.glb": (glb(kind, body), "of type VEC3, expected SCALAR"),
        "huge.glb": (glb(huge, body), "an accessor of 10000000000 items"),
        "hollow.glb": (glb(hollow, body), "sparse accessors or empty ones"),
        "sparse.glb": (glb(sparse, body), "sparse accessors or empty ones"),
        "beyond.glb": (glb(document, beyond), "uses vertex 3 (from 0) of 3"),
        "twice.glb": (glb(twice, body), "node 1 is in two places"),
        "lines.glb": (glb(lines, body), "it holds no faces"),
        "short.stl": (binary_stl(np.ones((4, 3, 3)))[:-8], "cut short, or not an STL file"),
        "short_text.stl": (solid("a", BOX[:3])[:-12].encode(), "does not end with 'endsolid'"),
        "words.stl": (solid("a", BOX[:3]).replace("5.0", "five").encode(), "a number belongs"),
        "words.off": (b"just some words\n", "not an OFF file"),
        "short.off": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n", "not a sound OFF file"),
        "range.off": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "index outside the range"),
        "empty.glb": (glb({"asset": {"version": "2.0"}}, b""), "it holds no faces"),
        "old.glb": (glb({"asset": {"version": "1.0"}}, b""), "glTF of version 1.0"),
        "flat.glb": (glb(document, body), "none of its 1 faces has an area"),
        "empty.usda": (b"#usda 1.0\n(upAxis = \"Z\"\nmetersPerUnit = 1)\n", "it holds no faces"),
    }  # fmt: skip


@pytest.mark.parametrize("name", _broken())
def test_a_broken_file_ends_in_one_line_that_names_it_and_the_fault(tmp_path, name):
    content, words = _broken()[name]
    (tmp_path / name).write_bytes(content)
    assert words in fails(tmp_path / name, unit_m=1, up="z")


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb", "usda", "usdc"])
def test_a_file_cut_short_or_with_wrong_bytes_is_a_mesh_or_an_error_and_no_crash(tmp_path, suffix):
    points, quads = shelter(4)
    if suffix == "stl":
        whole = binary_stl(points[triangles(quads)])
    elif suffix == "off":
        rows = [*points.tolist(), *([3, *face] for face in triangles(quads).tolist())]
        text = "\n".join(" ".join(map(repr, row)) for row in rows)
        whole = f"OFF\n{len(points)} {2 * len(quads)} 0\n{text}\n".encode()
    else:
        whole = write(tmp_path / f"a.{suffix}", points, quads).read_bytes()
    rng = np.random.default_rng(5)
    path = tmp_path / f"b.{suffix}"
    count = 40 if suffix.startswith("usd") else 150
    for trial in range(2 * count):
        content = bytearray(whole[: rng.integers(len(whole))] if trial < count else whole)
        for _ in range(0 if trial < count else rng.integers(1, 6)):
            content[rng.integers(len(content))] = rng.integers(256)
        path.write_bytes(bytes(content))
        try:
            mesh = read_mesh(path, unit_m=1, up="z")
        except SceneError:
            continue
        assert np.isfinite(mesh.points).all()
        assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.points)
