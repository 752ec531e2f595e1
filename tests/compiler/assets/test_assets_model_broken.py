"""Broken meshes and models: one line that names the file and the fault, and no crash."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdShade
from test_assets_mesh_file import BOX, binary_stl, solid
from test_assets_mesh_file import fails as mesh_fails
from test_assets_model import fails

from scenec.compiler.assets.model import read_model
from scenec.compiler.assets.parse import SUFFIXES
from scenec.schemas.errors import SceneError
from scenec.testing import models
from scenec.testing.models import keys, write
from scenec.testing.overhangs import glb, gltf_document, shelter, triangles
from scenec.testing.overhangs import write as write_shelter


def _broken() -> dict[str, tuple[bytes, str]]:
    header = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    header += b"property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
    header += b"end_header\n"
    vertices = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    document = gltf_document(3, 3)
    body = np.zeros(9, "<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
    outside = {**document, "buffers": [{"byteLength": 48, "uri": "mesh.bin"}]}
    ((primitive,),) = (mesh["primitives"] for mesh in document["meshes"])
    packed = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    draco = {**document, "meshes": [{"primitives": [{**primitive, "extensions": packed}]}]}
    views = document["bufferViews"]
    packed = {
        "EXT_meshopt_compression": {
            "buffer": 0,
            "byteLength": 36,
            "byteStride": 12,
            "count": 3,
            "mode": "ATTRIBUTES",
        }
    }
    meshopt = {**document, "bufferViews": [{**views[0], "extensions": packed}, *views[1:]]}
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
        "draco.glb": (glb(draco, body), "not draco encoded"),
        "meshopt.glb": (glb(meshopt, body), "Malformed buffer data"),
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
    assert words in mesh_fails(tmp_path / name, unit_m=1, up="z")
    assert words.replace("a mesh (", "a model (") in fails(tmp_path / name, unit_m=1, up="z")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_empty_file_a_missing_one_and_a_folder_are_faults(tmp_path, suffix):
    (tmp_path / f"a{suffix}").write_bytes(b"")
    (tmp_path / f"c{suffix}").mkdir()
    assert "the file is empty" in fails(tmp_path / f"a{suffix}")
    assert "there is no such file" in fails(tmp_path / f"b{suffix}")
    assert "not a file" in fails(tmp_path / f"c{suffix}")


MTL_FAULTS = [
    ("Kd 1 2", "line 2: 'Kd 1 2': expected red, green and blue as finite numbers"),
    ("Kd spectral a.rfl 1", "expected red, green and blue"),
    ("Kd 1 nan 0", "expected red, green and blue as finite numbers"),
    ("Pr rough", "line 2: 'Pr rough': expected a finite number"),
    ("map_Kd", None),
    ("map_Kd -s 1 1 1", "refers to the picture ''"),
    ("map_Kd words.png", "the picture words.png: not a readable picture"),
    ("map_Pr short.png", "the picture short.png: not a readable picture"),
    ("map_Kd .", "refers to the picture '.', which is not there"),
    ("map_Kd box.obj", "the picture box.obj: not a readable picture"),
    ("map_Kd " + "x" * 5000, "which is not there"),
]


@pytest.mark.parametrize(("line", "words"), MTL_FAULTS)
def test_a_broken_mtl_file_is_named_with_its_line(tmp_path, line, words):
    file = write(tmp_path / "box.obj")
    (tmp_path / "words.png").write_text("just some words")
    content = (tmp_path / "tex" / "rough.png").read_bytes()
    (tmp_path / "short.png").write_bytes(content[: len(content) // 2])
    (tmp_path / "box.mtl").write_text(f"newmtl plain\n{line}\n")
    if words is None:
        assert read_model(file, unit_m=1, up="z").materials[0].pictures == {}
    else:
        assert words in fails(file, unit_m=1, up="z")


def _gltf_faults() -> dict[str, tuple[list, object, str]]:
    pbr = ["materials", 1, "pbrMetallicRoughness"]
    return {
        "material": (["meshes", 0, "primitives", 0, "material"], 7, "not a sound glTF file"),
        "texture": ([*pbr, "baseColorTexture", "index"], -1, "-1 where an index"),
        "image": (["textures", 0, "source"], 9, "not a sound glTF file"),
        "color": (["materials", 0, "pbrMetallicRoughness", "baseColorFactor"], [1], "glTF"),
        "nan": (["materials", 0, "pbrMetallicRoughness", "roughnessFactor"], float("nan"),
                "'plain': its roughness is nan"),
        "uv": (["accessors", 1, "count"], 17, "17 values of an attribute for 18 vertices"),
        "view": (["bufferViews", 0, "byteLength"], 10**9, "a view beyond its buffer"),
        "reach": (["accessors", 0, "byteOffset"], 10**6, "an accessor beyond its view"),
        "stride": (["bufferViews", 0, "byteStride"], 4, "an accessor beyond its view"),
        "uri": (["images", 0], {"uri": "data:image/png;base64,@@@"}, "a broken data URI"),
        "words": (["images", 0], {"uri": "data:,abc"}, "a data URI that is not base64"),
        "move": ([*pbr, "baseColorTexture", "extensions"],
                 {"KHR_texture_transform": {"scale": [1e300, 1]}}, "a texture transform"),
    }  # fmt: skip


@pytest.mark.parametrize("name", _gltf_faults())
def test_a_broken_gltf_file_is_one_line(tmp_path, name):
    place, value, words = _gltf_faults()[name]
    document, binary = models.gltf_parts(False)
    inner = document
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    (tmp_path / "a.glb").write_bytes(glb(document, binary))
    assert words in fails(tmp_path / "a.glb")


def test_coordinates_that_are_not_finite_are_a_fault(tmp_path):
    document, binary = models.gltf_parts(False)
    broken = bytearray(binary)
    broken[432:436] = np.float32(np.nan).tobytes()
    (tmp_path / "a.glb").write_bytes(glb(document, bytes(broken)))
    assert "a texture coordinate is not finite" in fails(tmp_path / "a.glb")


def test_broken_materials_of_usd_are_one_line(tmp_path):
    stage = Usd.Stage.Open(str(write(tmp_path / "box.usda")))
    texture = UsdShade.Shader(stage.GetPrimAtPath("/looks/painted/diffuseColor"))
    texture.GetInput("file").Set(Sdf.AssetPath(str(tmp_path / "tex" / "color.png")))
    stage.Save()
    assert "expected a path relative to box.usda" in fails(tmp_path / "box.usda")
    texture.GetInput("file").Set(Sdf.AssetPath(""))
    stage.Save()
    assert "material 'painted': its base_color picture has no file" in fails(tmp_path / "box.usda")
    texture.GetInput("file").Set(Sdf.AssetPath("./tex/color.png"))
    stage.Save()
    (tmp_path / "tex" / "color.png").write_bytes(b"")
    assert "the picture ./tex/color.png: not a readable picture" in fails(tmp_path / "box.usda")


def _sheet(file: Path) -> Path:
    """The shelter as one of the formats that hold no materials."""
    points, quads = shelter(4)
    if file.suffix == ".ply":
        return write_shelter(file, points, quads)
    rows = [*points.tolist(), *([3, *face] for face in triangles(quads).tolist())]
    text = "\n".join(" ".join(map(repr, row)) for row in rows)
    stl = binary_stl(points[triangles(quads)])
    off = f"OFF\n{len(points)} {2 * len(quads)} 0\n{text}\n".encode()
    file.write_bytes(stl if file.suffix == ".stl" else off)
    return file


def _read_or_fault(file: Path, suffix: str) -> None:
    given = keys(suffix) if suffix not in ("ply", "stl", "off") else {"unit_m": 1, "up": "z"}
    for looks in (True, False):
        model, fault = None, f"{file.name}: "
        try:
            model = read_model(file, **given, looks=looks)
        except SceneError as error:
            fault = str(error)
        assert fault.startswith(f"{file.name}: ")
        assert "\n" not in fault
        if model is None:
            continue
        assert np.isfinite(model.points).all()
        assert model.uv is None or np.isfinite(model.uv).all()
        assert model.material_of_face.max() < max(len(model.materials), 1)
        assert 0 <= model.faces.min() <= model.faces.max() < len(model.points)


@pytest.mark.parametrize(
    ("name", "trials"),
    [("a.ply", 300), ("a.stl", 300), ("a.off", 300), ("box.obj", 120), ("box.mtl", 80),
    ("tex/rough.png", 40), ("box.gltf", 100),
     ("box data.bin", 40), ("box.glb", 100), ("box.usda", 40), ("box.usdc", 40),
     ("box.usdz", 40)],
)  # fmt: skip
def test_wrong_bytes_and_missing_ends_are_a_model_or_a_fault_and_no_crash(tmp_path, name, trials):
    suffix = {"mtl": "obj", "png": "obj", "bin": "gltf"}.get(name[-3:], name.rpartition(".")[2])
    file = _sheet(tmp_path / name) if name[0] == "a" else write(tmp_path / f"box.{suffix}")
    whole = (tmp_path / name).read_bytes()
    rng = np.random.default_rng(8)
    for trial in range(trials):
        content = bytearray(whole[: rng.integers(len(whole))] if trial % 3 == 0 else whole)
        for _ in range(rng.integers(0 if trial % 3 == 0 else 1, 6) if content else 0):
            content[rng.integers(len(content))] = rng.integers(256)
        (tmp_path / name).write_bytes(bytes(content))
        _read_or_fault(file, suffix)


def test_any_value_in_any_place_of_a_gltf_document_is_a_model_or_a_fault(tmp_path):
    file = write(tmp_path / "box.gltf")
    whole = file.read_text()

    def places(value: object, place: tuple = ()) -> list[tuple]:
        inner = value.items() if isinstance(value, dict) else enumerate(value)
        found = []
        for key, item in inner:
            found.append((*place, key))
            if isinstance(item, dict | list):
                found += places(item, (*place, key))
        return found

    values = [None, -1, 1e30, float("nan"), "x", [], {}, True, 10**12, 0.5]
    for i, place in enumerate(places(json.loads(whole))):
        for value in values[i % 3 :: 3]:
            document = inner = json.loads(whole)
            for key in place[:-1]:
                inner = inner[key]
            inner[place[-1]] = value
            file.write_text(json.dumps(document))
            _read_or_fault(file, "gltf")
