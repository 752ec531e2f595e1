"""glTF whose geometry or pictures are compressed, by their encoders: read as without."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from scenec.compiler.assets.model import read_model
from scenec.schemas.errors import SceneError
from scenec.testing.models import gltf_parts
from scenec.testing.overhangs import glb

#: Of Draco's positions and texture coordinates: far below what a float32 picture of them shows.
BITS = 24


def rows(binary: bytes, accessor: dict[str, Any], view: dict[str, Any]) -> np.ndarray:
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    width = {"VEC3": 3, "VEC2": 2}[accessor["type"]]
    return np.frombuffer(binary, "<f4", accessor["count"] * width, start).reshape(-1, width)


def add_view(document: dict[str, Any], binary: bytes, data: bytes) -> tuple[int, bytes]:
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)}
    document["bufferViews"].append(view)
    return len(document["bufferViews"]) - 1, binary + data + bytes(-len(data) % 4)


def by_draco(document: dict[str, Any], binary: bytes) -> bytes:
    import DracoPy

    for primitive in document["meshes"][0]["primitives"]:
        places, uv = (
            rows(binary, accessor, document["bufferViews"][accessor["bufferView"]])
            for name in ("POSITION", "TEXCOORD_0")
            for accessor in (document["accessors"][primitive["attributes"][name]],)
        )
        faces = np.arange(len(places), dtype=np.uint32).reshape(-1, 3)
        data = DracoPy.encode(
            places, faces, quantization_bits=BITS, preserve_order=True,
            generic_attributes={7: uv},
        )  # fmt: skip
        mesh = DracoPy.decode(data)
        (place,) = (a["unique_id"] for a in mesh.attributes if a["attribute_type"] == 0)
        view, binary = add_view(document, binary, data)
        for index in primitive["attributes"].values():
            document["accessors"][index] |= {"count": len(mesh.points)}
            del document["accessors"][index]["bufferView"]
        document["accessors"].append(
            {"componentType": 5125, "count": mesh.faces.size, "type": "SCALAR"}
        )
        primitive["indices"] = len(document["accessors"]) - 1
        primitive["extensions"] = {
            "KHR_draco_mesh_compression": {
                "bufferView": view, "attributes": {"POSITION": place, "TEXCOORD_0": 7},
            },
        }  # fmt: skip
    document["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return glb(document, binary)


def by_meshopt(document: dict[str, Any], binary: bytes) -> bytes:
    import meshopt

    document["buffers"].append({
        "byteLength": 720, "extensions": {"EXT_meshopt_compression": {"fallback": True}},
    })  # fmt: skip
    for view, size in zip(document["bufferViews"][:2], (12, 8), strict=True):
        start = view.get("byteOffset", 0)
        plain = np.frombuffer(binary, np.uint8, view["byteLength"], start).reshape(-1, size)
        data = meshopt.encode_gltf_buffer(plain, "ATTRIBUTES")
        view |= {"buffer": 1, "extensions": {"EXT_meshopt_compression": {
            "buffer": 0, "byteOffset": len(binary), "byteLength": len(data),
            "byteStride": size, "count": len(plain), "mode": "ATTRIBUTES",
        }}}  # fmt: skip
        binary += data + bytes(-len(data) % 4)
    document["extensionsRequired"] = ["EXT_meshopt_compression"]
    return glb(document, binary)


@pytest.mark.parametrize(("pack", "tolerance"), [(by_draco, 2.0**-20), (by_meshopt, 0.0)])
def test_a_packed_model_is_the_plain_one(tmp_path, pack, tolerance):
    document, binary = gltf_parts(False)
    (tmp_path / "plain.glb").write_bytes(glb(document, binary))
    (tmp_path / "packed.glb").write_bytes(pack(*gltf_parts(False)))
    plain, packed = (read_model(tmp_path / f"{name}.glb") for name in ("plain", "packed"))
    for one, other in (
        (plain.points[plain.faces], packed.points[packed.faces]),
        (plain.uv, packed.uv),
    ):
        assert one.shape == other.shape
        assert np.abs(one - other).max() <= tolerance
    assert packed.materials == plain.materials
    assert packed.notes == plain.notes


@pytest.mark.parametrize(("pack", "package"), [(by_draco, "DracoPy"), (by_meshopt, "meshopt")])
def test_without_its_package_a_packed_model_is_refused_by_name(
    tmp_path, monkeypatch, pack, package
):
    (tmp_path / "a.glb").write_bytes(pack(*gltf_parts(False)))
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(SceneError, match=r"_compression: .*pip install 'scenec\[gltf\]'"):
        read_model(tmp_path / "a.glb")


def test_a_picture_in_ktx2_alone_is_refused_with_the_mend(tmp_path):
    document, binary = gltf_parts(False)
    document["textures"][1] = {"extensions": {"KHR_texture_basisu": {"source": 1}}}
    (tmp_path / "a.glb").write_bytes(glb(document, binary))
    with pytest.raises(SceneError, match=r"a\.glb: .*KHR_texture_basisu.*ktx extract"):
        read_model(tmp_path / "a.glb")
    # What stands beside it for readers without it is taken.
    document["textures"][1]["source"] = 1
    (tmp_path / "a.glb").write_bytes(glb(document, binary))
    assert "roughness" in read_model(tmp_path / "a.glb").materials[1].pictures


@pytest.mark.parametrize(("mode", "told"), [("OPAQUE", False), ("MASK", True), ("BLEND", True)])
def test_alpha_of_vertices_is_told_where_it_would_cut(tmp_path, mode, told):
    document, binary = gltf_parts(False)
    view, binary = add_view(document, binary, np.full((18, 4), 0.25, "<f4").tobytes())
    document["accessors"].append(
        {"bufferView": view, "componentType": 5126, "count": 18, "type": "VEC4"}
    )
    document["meshes"][0]["primitives"][1]["attributes"]["COLOR_0"] = 4
    document["materials"][1]["alphaMode"] = mode
    (tmp_path / "a.glb").write_bytes(glb(document, binary))
    found = [line for line in read_model(tmp_path / "a.glb").warnings if "vertices" in line]
    assert found == ["the alpha of its vertices cuts nothing out"] * told
