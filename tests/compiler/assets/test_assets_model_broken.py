"""Broken models: one line that names the file and the fault, and no crash."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdShade
from test_assets_broken import _broken
from test_assets_model import fails

from scenec.compiler.assets.model import read_model
from scenec.compiler.assets.parse import SUFFIXES
from scenec.schemas.errors import SceneError
from scenec.testing import models
from scenec.testing.models import keys, write
from scenec.testing.overhangs import glb

#: Where the reader of models knows more than that of meshes, or says it in other words.
OTHER_WORDS = {
    "mesh.fbx": "expected a model (.obj, .ply",
    "range.obj": "a face uses vertex 2 (from 0) of 1",
    "outside.glb": "the buffer 'mesh.bin', which is not there",
    "huge.glb": "an accessor of 10000000000 items",
}


@pytest.mark.parametrize("name", [name for name in _broken() if name != "back.obj"])
def test_a_broken_mesh_is_a_broken_model(tmp_path, name):
    content, words = _broken()[name]
    (tmp_path / name).write_bytes(content)
    assert OTHER_WORDS.get(name, words) in fails(tmp_path / name, unit_m=1, up="z")


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


def _read_or_fault(file: Path, suffix: str) -> None:
    model, fault = None, f"{file.name}: "
    try:
        model = read_model(file, **keys(suffix))
    except SceneError as error:
        fault = str(error)
    assert fault.startswith(f"{file.name}: ")
    assert "\n" not in fault
    if model is None:
        return
    assert np.isfinite(model.points).all()
    assert model.uv is None or np.isfinite(model.uv).all()
    assert model.material_of_face.max() < len(model.materials)


@pytest.mark.parametrize(
    ("name", "trials"),
    [("box.obj", 120), ("box.mtl", 80), ("tex/rough.png", 40), ("box.gltf", 100),
     ("box data.bin", 40), ("box.glb", 100), ("box.usda", 40), ("box.usdc", 40),
     ("box.usdz", 40)],
)  # fmt: skip
def test_wrong_bytes_and_missing_ends_are_a_model_or_a_fault_and_no_crash(tmp_path, name, trials):
    suffix = {"mtl": "obj", "png": "obj", "bin": "gltf"}.get(name[-3:], name.rpartition(".")[2])
    file = write(tmp_path / f"box.{suffix}")
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
