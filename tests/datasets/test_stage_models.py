"""glTF and USDZ of a stage: read back, they hold what the stage holds, and say what they do not."""

from __future__ import annotations

import json
import shutil
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from pxr import Usd, UsdGeom, UsdShade, UsdValidation
from scipy.spatial.transform import Rotation

from scenec.backends.model.colors import vertex_colors
from scenec.backends.stage.read import read_stage
from scenec.cli.main import main
from scenec.datasets.models.gltf import decomposed
from scenec.schemas.quaternions import quaternions
from scenec.testing.processes import output_of
from scenec.testing.small import small_cfg, write_cfg

TEXELS = "texels=16384"


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    asked = small_cfg(samples=2)
    asked["materials"]["stone"]["diffuse_transmission"] = 0.3
    cfg = write_cfg(folder, asked)
    assert main(["compile", str(cfg), "-o", str(folder / "out"), "--no-cache"]) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def scene(out):
    return read_stage(out / "batch_0000" / "stage.usda")


@pytest.fixture(scope="module")
def glb(out):
    assert main(["export", str(out), "--format", "gltf", "--set", TEXELS]) == 0
    return out / "datasets" / "gltf" / "batch_0000.glb"


@pytest.fixture(scope="module")
def usdz(out):
    assert main(["export", str(out), "--format", "usdz", "--set", TEXELS]) == 0
    return out / "datasets" / "usdz" / "batch_0000.usdz"


class Glb:
    """A reader of its own: JSON, and accessors as arrays."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        magic, version, size = struct.unpack_from("<4sII", data)
        assert (magic, version, size) == (b"glTF", 2, len(data))
        length, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON"
        self.json: dict[str, Any] = json.loads(data[20 : 20 + length])
        at = 20 + length
        length, kind = struct.unpack_from("<I4s", data, at)
        assert kind == b"BIN\x00"
        self.data = data[at + 8 : at + 8 + length]
        assert at + 8 + length == len(data)

    def array(self, number: int) -> np.ndarray:
        """An accessor's values, [n] or [n, c]."""
        accessor = self.json["accessors"][number]
        view = self.json["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        assert view["byteOffset"] % 4 == 0
        values = np.frombuffer(
            self.data, kind, accessor["count"] * width, view["byteOffset"]
        ).reshape(-1, width)
        if "min" in accessor:
            assert np.array_equal(values.min(axis=0), np.float32(accessor["min"]))
            assert np.array_equal(values.max(axis=0), np.float32(accessor["max"]))
        return values if width > 1 else values[:, 0]

    def instanced(self) -> list[tuple[dict, dict[str, np.ndarray]]]:
        """(node, its instances' attributes)."""
        found = []
        for node in self.json["nodes"]:
            told = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
            if told:
                arrays = {name: self.array(n) for name, n in told["attributes"].items()}
                found.append((node, arrays))
        return found


def matrices(turn: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Linear parts out of quaternions (x, y, z, w) and scales."""
    return Rotation.from_quat(turn.astype(float)).as_matrix() * scale[:, None, :]


def test_each_instance_stands_in_the_gltf_where_the_stage_has_it(glb, scene):
    file = Glb(glb)
    origin = origin_of(file)
    rows = scene.rows
    wanted = {int(rows.instance_id[r]): rows.to_world[r] for r in np.flatnonzero(rows.instance_id)}
    found = {}
    for _, arrays in file.instanced():
        linear = matrices(arrays["ROTATION"], arrays["SCALE"])
        for number, a, p in zip(
            arrays["_FEATURE_ID_0"], linear, arrays["TRANSLATION"], strict=True
        ):
            found[int(number)] = np.column_stack([a, p + origin])
    assert found.keys() == wanted.keys()
    off = max(np.abs(found[i] - wanted[i]).max() for i in wanted)
    assert off < 1e-5
    assert "EXT_mesh_gpu_instancing" in file.json["extensionsRequired"]


def origin_of(file: Glb) -> np.ndarray:
    """World position of the root's children, which stand z up below it."""
    x, y, z = file.json["nodes"][0]["translation"]
    return np.array([x, -z, y])


def test_triangles_and_their_labels_are_those_of_the_stage(glb, scene):
    file = Glb(glb)
    levels = sorted(scene.label_names)
    meshes = {mesh["name"]: mesh for mesh in file.json["meshes"]}
    for mesh in scene.meshes:
        if not len(mesh.faces):
            continue
        (primitive,) = meshes[mesh.path]["primitives"]
        attributes = primitive["attributes"]
        faces = file.array(primitive["indices"]).reshape(-1, 3)
        assert np.array_equal(file.array(attributes["POSITION"])[faces], mesh.points[mesh.faces])
        for number, level in enumerate(levels):
            labels = file.array(attributes[f"_FEATURE_ID_{number}"])[faces]
            assert np.array_equal(labels, np.repeat(mesh.labels[level][:, None], 3, axis=1))
    names = file.json["nodes"][0]["extras"]["taxonomies"]
    assert names == {
        level: {str(i): text for i, text in of.items()} for level, of in scene.label_names.items()
    }


def test_another_reader_finds_the_ground_where_it_is(glb, scene):
    read = trimesh.load_scene(glb)
    ground = [m for m in scene.meshes if m.path.startswith("/World/Terrain")]
    of_ground = {mesh.path for mesh in ground}
    points = np.concatenate(
        [
            trimesh.transform_points(read.geometry[name].vertices, matrix)
            for node in read.graph.nodes_geometry
            for matrix, name in [read.graph.get(node)]
            if any(name.startswith(path) for path in of_ground)
        ]
    )
    placed = [
        scene.meshes[scene.rows.mesh[r]].points @ scene.rows.to_world[r, :, :3].T
        + scene.rows.to_world[r, :, 3]
        for r in np.flatnonzero(scene.rows.instance_id == 0)
    ]
    world = np.concatenate(placed)
    # The file has y up.
    z_up = points[:, [0, 2, 1]] * [1, -1, 1]
    assert np.allclose(z_up.min(axis=0), world.min(axis=0), atol=1e-4)
    assert np.allclose(z_up.max(axis=0), world.max(axis=0), atol=1e-4)
    with_picture = [g for g in read.geometry.values() if g.visual.kind == "texture"]
    assert len(with_picture) >= len(ground)


def test_cameras_and_suns_look_and_shine_as_in_the_stage(glb, scene):
    file = Glb(glb)
    nodes = {node.get("name"): node for node in file.json["nodes"]}
    channels = file.json["animations"][0]["channels"]
    samplers = file.json["animations"][0]["samplers"]
    numbers = [node.get("name") for node in file.json["nodes"]]
    for place, camera in enumerate(scene.cameras[0]):
        node = nodes[camera.name]
        lens = file.json["cameras"][node["camera"]]["perspective"]
        assert np.isclose(np.tan(lens["yfov"] / 2), camera.height / 2 / camera.intrinsics[1, 1])
        own = {
            c["target"]["path"]: file.array(samplers[c["sampler"]]["output"])
            for c in channels
            if numbers[c["target"]["node"]] == camera.name
        }
        turns = matrices(own["rotation"], np.ones((scene.samples, 3)))
        for sample in range(scene.samples):
            pose = scene.cameras[sample][place].camera_to_world
            # It looks along -z, with y up.
            assert np.allclose(-turns[sample][:, 2], pose[:3, 2], atol=1e-6)
            assert np.allclose(turns[sample][:, 1], -pose[:3, 1], atol=1e-6)
            where = own["translation"][sample] + origin_of(file)
            assert np.allclose(where, pose[:3, 3], atol=1e-4)
    sun = scene.lighting[0].suns[0]
    turn = matrices(np.array([nodes["sun_0"]["rotation"]]), np.ones((1, 3)))[0]
    assert np.allclose(-turn[:, 2], -sun.to_light)
    assert nodes["sun_0"]["extras"]["irradiance"] == sun.irradiance.tolist()


def test_what_is_not_in_the_file_is_said_in_it_and_beside_it(glb):
    losses = Glb(glb).json["nodes"][0]["extras"]["losses"]
    beside = json.loads((glb.parent / "export.json").read_text())["batches"]["batch_0000"]
    assert beside["losses"] == losses
    assert any(line.startswith("ground: merges of layers are baked") for line in losses)
    assert beside["bytes"] == glb.stat().st_size


def test_what_sheets_transmit_is_in_the_gltf_and_said_to_be_lost_in_the_usdz(glb, usdz):
    file = Glb(glb).json
    extension = "KHR_materials_diffuse_transmission"
    own = {m["name"]: m.get("extensions", {}).get(extension) for m in file["materials"]}
    assert own.pop("stone") == {
        "diffuseTransmissionFactor": pytest.approx(0.3),
        "diffuseTransmissionColorFactor": pytest.approx([0.15, 0.12, 0.1]),
    }
    assert not any(own.values())
    assert extension in file["extensionsUsed"]
    losses = json.loads((usdz.parent / "export.json").read_text())["batches"]["batch_0000"]
    assert sum("no light passes through sheets" in line for line in losses["losses"]) == 1


@pytest.mark.parametrize("pictured", [False, True])
def test_a_coating_is_drawn_once_or_said_to_be_left_out(tmp_path, pictured):
    """Factor times color of a vertex is the merged color, of which no part is squared."""
    asked = small_cfg(samples=1)
    coatings = [{"material": "sand", "tops": 0.5}]
    asked["objects"]["rocks"] |= {"coatings": coatings, "count": 9, "orientation": "normal"}
    if pictured:
        pixels = np.random.default_rng(1).integers(9, 250, (16, 16, 3)).astype(np.uint8)
        Image.fromarray(pixels).save(tmp_path / "stone.png")
        asked["materials"]["stone"]["maps"] = {"base_color": "stone.png", "size_m": 0.2}
    out = tmp_path / "out"
    assert main(["compile", str(write_cfg(tmp_path, asked)), "-o", str(out), "--no-cache"]) == 0
    assert main(["export", str(out), "--format", "gltf", "--set", TEXELS]) == 0
    file = Glb(out / "datasets" / "gltf" / "batch_0000.glb")
    scene = read_stage(out / "batch_0000" / "stage.usda")
    primitives = {m["name"]: m["primitives"][0] for m in file.json["meshes"]}
    coated = [m for m in scene.meshes if len(m.layers) > 1 and "/Objects/" in m.path]
    assert coated
    for mesh in coated:
        primitive = primitives[mesh.path]
        rough = file.json["materials"][primitive["material"]]["pbrMetallicRoughness"]
        said = f"{mesh.path}: what coats its picture is left out"
        assert (said in file.json["nodes"][0]["extras"]["losses"]) is pictured
        assert ("COLOR_0" in primitive["attributes"]) is not pictured
        assert ("baseColorTexture" in rough) is pictured
        if not pictured:
            faces = file.array(primitive["indices"]).reshape(-1, 3)
            shown = file.array(primitive["attributes"]["COLOR_0"]) * rough["baseColorFactor"][:3]
            np.testing.assert_allclose(
                shown[faces], vertex_colors(scene, mesh)[mesh.faces], atol=1e-6
            )


def test_turns_and_scales_make_up_their_matrices_again():
    rng = np.random.default_rng(1)
    turns = rng.normal(size=(200, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    turns[:4] = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    scales = rng.uniform(0.1, 3.0, (200, 3)) * np.where(rng.random((200, 1)) < 0.3, -1, 1)
    linear = matrices(turns, scales)
    whole = np.concatenate([linear, rng.normal(size=(200, 3, 1))], axis=2)
    position, turn, scale, sheared = decomposed(whole)
    assert sheared == 0
    assert np.allclose(matrices(turn, scale), linear, atol=1e-12)
    assert np.array_equal(position, whole[:, :, 3])
    assert np.allclose(np.abs((quaternions(matrices(turns, np.ones((200, 3)))) * turns).sum(1)), 1)


def test_a_sheared_matrix_and_a_hidden_one_are_told_apart():
    sheared = np.array([[1.0, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])
    hidden = np.zeros((3, 4))
    _, turn, scale, count = decomposed(np.stack([sheared, hidden]))
    assert count == 1
    assert np.allclose(np.linalg.norm(turn, axis=1), 1)
    assert np.array_equal(scale[1], np.zeros(3))


def test_the_package_is_sound_for_all_validators(usdz):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    context = UsdValidation.ValidationContext(validators)
    assert not [e.GetName() for e in context.Validate(Usd.Stage.Open(str(usdz)))]
    with zipfile.ZipFile(usdz) as archive:
        assert archive.testzip() is None
        assert all(member.compress_type == zipfile.ZIP_STORED for member in archive.infolist())


def test_unpacked_it_has_the_geometry_ids_and_labels_of_the_stage(usdz, scene, tmp_path):
    with zipfile.ZipFile(usdz) as archive:
        archive.extractall(tmp_path)
    again = read_stage(tmp_path / "stage.usdc")
    assert np.array_equal(again.rows.instance_id, scene.rows.instance_id)
    assert np.array_equal(again.rows.to_world, scene.rows.to_world)
    assert again.label_names == scene.label_names
    for one, other in zip(again.meshes, scene.meshes, strict=True):
        assert np.array_equal(one.points, other.points)
        assert np.array_equal(one.faces, other.faces)
        assert all(np.array_equal(one.labels[k], other.labels[k]) for k in scene.levels)
    for sample in range(scene.samples):
        for one, other in zip(again.cameras[sample], scene.cameras[sample], strict=True):
            assert np.array_equal(one.camera_to_world, other.camera_to_world)
            assert np.array_equal(one.intrinsics, other.intrinsics)
    suns = again.lighting[0].suns, scene.lighting[0].suns
    assert np.array_equal(suns[0][0].irradiance, suns[1][0].irradiance)


def test_the_ground_of_the_package_has_pictures_and_nothing_of_materialx(usdz):
    stage = Usd.Stage.Open(str(usdz))
    shaders = [UsdShade.Shader(p).GetIdAttr().Get() for p in stage.TraverseAll()
               if p.IsA(UsdShade.Shader)]  # fmt: skip
    assert "UsdUVTexture" in shaders
    assert not [name for name in shaders if name.startswith("ND_")]
    tiles = [p for p in stage.GetPrimAtPath("/World/Terrain").GetChildren() if p.IsA(UsdGeom.Mesh)]
    assert tiles
    for tile in tiles:
        material = UsdShade.MaterialBindingAPI(tile).ComputeBoundMaterial()[0]
        assert str(material.GetPath()).startswith("/World/BakedLooks/")
        st = UsdGeom.PrimvarsAPI(tile).GetPrimvar("st")
        values = np.asarray(st.Get())
        assert len(values) == len(UsdGeom.Mesh(tile).GetPointsAttr().Get())
        assert values.min() >= 0.0
        assert values.max() <= 1.0
        for subset in tile.GetChildren():
            assert not UsdShade.MaterialBindingAPI(subset).GetDirectBinding().GetMaterial()


def test_the_same_stage_gives_the_same_bytes(out, glb, usdz):
    for file, name in ((glb, "gltf"), (usdz, "usdz")):
        before = file.read_bytes()
        words = ["export", str(out), "--format", name, "--set", TEXELS]
        assert main(words) == 2
        assert main([*words, "--replace"]) == 0
        assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--split", "train=1"], "--split chooses among frames"),
        (["--keep", "area>=4"], "--keep chooses among frames"),
        (["--set", "texel=4"], "the only option here is texels=N"),
        (["--set", "texels=0"], "expected a whole number from 1"),
        (["--batches", "7:9"], "no such batches"),
    ],
)
def test_options_that_make_no_sense_are_refused(out, capsys, words, message):
    assert (
        message
        in output_of(
            capsys, ["export", str(out), "--format", "gltf", "-o", str(out / "x"), *words], 2
        ).err
    )
    assert not (out / "x").exists()


def test_check_knows_folders_of_models(glb, tmp_path, capsys):
    folder = tmp_path / "gltf"
    shutil.copytree(glb.parent, folder)
    assert "0 errors" in output_of(capsys, ["check", str(folder)]).out
    file, data = folder / glb.name, glb.read_bytes()
    for changed, message in (
        (data[:-1] + bytes([data[-1] ^ 1]), "was changed"),
        (data[:-1], "has"),
    ):
        file.write_bytes(changed)
        assert message in output_of(capsys, ["check", str(folder)], 1).out
    file.rename(folder / "batch_0007.glb")
    said = output_of(capsys, ["check", str(folder)], 1).out
    assert "batch_0000.glb: is missing" in said
    assert "batch_0007.glb: is no part" in said
