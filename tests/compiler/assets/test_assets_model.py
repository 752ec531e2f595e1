"""Models from files: the same box whatever the format, and what each format says of materials."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from scenec.compiler.assets.model import read_model
from scenec.compiler.assets.parse import parse_model
from scenec.compiler.assets.pictures import png
from scenec.compiler.scene.material import ImageFile
from scenec.schemas.errors import SceneError
from scenec.testing import models
from scenec.testing.models import BOX, MODELS, PLAIN, keys, write
from scenec.testing.overhangs import FORMATS, glb, shelter
from scenec.testing.overhangs import keys as shelter_keys
from scenec.testing.overhangs import write as write_shelter


def pixels(source: Path | ImageFile) -> np.ndarray:
    return np.asarray(Image.open(source if isinstance(source, Path) else io.BytesIO(source.data)))


def fails(path: Path, **choice) -> str:
    with pytest.raises(SceneError) as caught:
        read_model(path, **choice)
    message = str(caught.value)
    assert message.startswith(f"{path.name}: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("suffix", MODELS)
def test_the_same_box_is_the_same_model_in_every_format(tmp_path, suffix):
    model = read_model(write(tmp_path / f"box.{suffix}"), **keys(suffix))
    assert sorted(map(tuple, model.points.tolist())) == sorted(map(tuple, BOX.tolist()))
    assert np.array_equal(model.points[model.faces], BOX[models.faces()])
    assert model.uv.dtype == np.float32
    assert np.array_equal(model.uv, models.uv())
    assert [m.name for m in model.materials] == ["plain", "painted"]
    assert model.material_of_face.tolist() == [0] * 6 + [1] * 6
    plain, painted = model.materials
    assert plain.base_color == PLAIN["base_color"]
    assert (plain.roughness, plain.metallic) == (PLAIN["roughness"], PLAIN["metallic"])
    assert plain.specular == pytest.approx(0.04, abs=1e-15)
    assert plain.pictures == {}
    assert painted.base_color == (1.0, 1.0, 1.0)
    assert painted.normal_convention == "opengl"
    drawn = models.pictures()
    expected = {"base_color": "color", "roughness": "rough", "metallic": "metal",
                "normal": "normal"}  # fmt: skip
    assert list(painted.pictures) == list(expected)
    for kind, name in expected.items():
        assert np.array_equal(pixels(painted.pictures[kind]), drawn[name])
    assert painted.roughness == pytest.approx(drawn["rough"].mean() / 255, rel=1e-12)
    assert painted.metallic == pytest.approx(drawn["metal"].mean() / 255, rel=1e-12)
    assert model.normals is None
    by_part = ("/box/plain", "/box/painted") if suffix.startswith("usd") else None
    assert model.parts == (by_part or (("box",) if suffix == "obj" else ("/box",)))
    assert model.notes == ()


def test_companions_are_the_files_beside_a_model_in_the_order_of_their_names_in_it(tmp_path):
    def named(suffix: str) -> list[str]:
        file = write(tmp_path / f"box.{suffix}")
        return [str(path.relative_to(tmp_path)) for path in parse_model(file).companions]

    tex = ["tex/color.png", "tex/packed.png", "tex/normal.png"]
    obj = ["tex/color.png", "tex/rough.png", "tex/metal.png", "tex/normal.png"]
    assert named("obj") == ["box.mtl", *obj]
    assert named("gltf") == ["box data.bin", *tex]
    assert named("usda") == tex
    for suffix in ("glb", "usdz"):
        assert named(suffix) == []
    for name in ("a.stl", "a.off"):
        trimesh.creation.box().export(tmp_path / name)
        assert parse_model(tmp_path / name).companions == ()


@pytest.mark.parametrize(
    ("suffix", "gone"),
    [("obj", "box.mtl"), ("obj", "tex/rough.png"), ("gltf", "box data.bin"),
     ("gltf", "tex/normal.png"), ("usda", "tex/color.png")],
)  # fmt: skip
def test_a_companion_that_is_missing_is_a_fault_that_names_both_files(tmp_path, suffix, gone):
    file = write(tmp_path / f"box.{suffix}")
    (tmp_path / gone).unlink()
    message = fails(file, **keys(suffix))
    assert gone.replace(" ", "%20") in message
    assert "which is not there" in message


@pytest.mark.parametrize("where", ["/{}/color.png", "C:\\tex\\color.png", "file:///color.png"])
def test_a_companion_by_an_absolute_path_is_refused(tmp_path, where):
    file = write(tmp_path / "box.obj")
    absolute = where.format(str(tmp_path / "tex").strip("/"))
    (tmp_path / "box.mtl").write_text(models.MTL.replace("tex/color.png", absolute))
    assert "expected a path relative to box.mtl" in fails(file, unit_m=1, up="z")
    document = json.loads(write(tmp_path / "box.gltf").read_text())
    document["images"][0]["uri"] = absolute
    (tmp_path / "box.gltf").write_text(json.dumps(document))
    assert "expected a path relative to box.gltf" in fails(tmp_path / "box.gltf")


def test_pictures_may_lie_above_the_model_and_their_paths_may_have_backslashes(tmp_path):
    (tmp_path / "deep").mkdir()
    file = write(tmp_path / "deep" / "box.obj")
    (tmp_path / "deep" / "tex").rename(tmp_path / "tex")
    (tmp_path / "deep" / "box.mtl").write_text(models.MTL.replace("tex/", "..\\tex\\"))
    found = read_model(file, unit_m=1, up="z").materials[1].pictures
    assert np.array_equal(pixels(found["base_color"]), models.pictures()["color"])


@pytest.mark.parametrize("suffix", [s for s in FORMATS if s != "obj"])
def test_a_surface_is_the_same_with_and_without_looks(tmp_path, suffix):
    file = write_shelter(tmp_path / f"a.{suffix}", *shelter(9))
    model, mesh = (read_model(file, **shelter_keys(suffix), looks=looks) for looks in (True, False))
    assert np.array_equal(model.points, mesh.points)
    assert np.array_equal(model.faces, mesh.faces)
    assert (model.parts, model.materials, model.uv) == (mesh.parts, (), None)
    assert (model.material_of_face == -1).all()


def test_a_seam_of_texture_does_not_split_the_surface(tmp_path):
    model = read_model(write(tmp_path / "box.glb"))
    assert len(model.points) == 8
    mesh = trimesh.Trimesh(model.points, model.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(30.0, rel=1e-14)


def test_a_face_without_area_goes_with_its_coordinates_and_material(tmp_path):
    file = tmp_path / "a.obj"
    file.write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nvt 0 0\nvt .5 0\nvt .5 .5\nvt 0 .5\nvn 0 0 2\n"
        "usemtl flat\nf 1/1 2/2 4/3\nusemtl real\nf 1/2/1 2/3/1 3/4/1\n"
    )
    model = read_model(file, unit_m=1, up="z")
    assert np.array_equal(model.points, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert np.array_equal(model.uv, [[[0.5, 0], [0.5, 0.5], [0, 0.5]]])
    assert [m.name for m in model.materials] == ["real"]
    assert model.material_of_face.tolist() == [0]
    assert np.array_equal(model.normals, [[[0, 0, 1]] * 3])
    assert any("material 'real', which is shown in gray" in note for note in model.notes)


def test_obj_counts_backward_from_where_a_face_stands(tmp_path):
    file = tmp_path / "a.obj"
    one = "v {0} 0 0\nv {1} 0 0\nv {0} 1 0\nvt {0} 0\nvt {1} 0\nvt {0} 1\nf -3/-3 -2/-2 -1/-1\n"
    file.write_text(one.format(0, 1) + one.format(5, 7))
    model = read_model(file, unit_m=1, up="z")
    assert np.array_equal(model.points[model.faces][:, :, 0], [[0, 1, 0], [5, 7, 5]])
    assert np.array_equal(model.uv, model.points[model.faces][:, :, :2])


def test_obj_colors_of_vertices_are_one_average_for_each_part(tmp_path):
    file = tmp_path / "a.obj"
    colored = "v {} {} 0 {}\n"
    text = ""
    for name, tint in (("left", "1 0 0.5"), ("right", "0 1 1")):
        text += f"o {name}\n"
        text += "".join(colored.format(x, y, tint) for x, y in ((0, 0), (1, 0), (0, 1)))
        text += "f -3 -2 -1\n"
    file.write_text(text)
    model = read_model(file, unit_m=1, up="z")
    half = ((0.5 + 0.055) / 1.055) ** 2.4
    assert [m.base_color for m in model.materials] == [
        pytest.approx((1, 0, half)), pytest.approx((0, 1, 1))
    ]  # fmt: skip


MTL_NUMBERS = [
    ("Ns 250", {"roughness": 0.5}),
    ("Ns 0", {"roughness": 1.0}),
    ("Ns 1000", {"roughness": 0.0}),
    ("Ns 250\nPr 0.875", {"roughness": 0.875}),
    ("", {"roughness": 0.5, "metallic": 0.0, "specular": 0.04, "base_color": (0.8, 0.8, 0.8)}),
    ("Pm 1", {"metallic": 1.0}),
    ("Ni 2", {"specular": 1 / 9}),
    ("Ni 1", {"specular": 0.04}),
    ("illum 1", {"specular": 0.0}),
    ("Ks 0 0 0", {"specular": 0.0}),
    ("Kd 0.5", {"base_color": (0.5, 0.5, 0.5)}),
]


@pytest.mark.parametrize(("lines", "expected"), MTL_NUMBERS)
def test_the_numbers_of_an_mtl_file(tmp_path, lines, expected):
    (tmp_path / "a.mtl").write_text(f"newmtl a\n{lines}\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (material,) = read_model(tmp_path / "a.obj", unit_m=1, up="z").materials
    for key, value in expected.items():
        assert getattr(material, key) == pytest.approx(value, abs=1e-12)


def test_an_mtl_file_s_picture_may_be_scaled_and_shifted_and_have_spaces_in_its_name(tmp_path):
    file = write(tmp_path / "box.obj")
    (tmp_path / "tex" / "my color.png").write_bytes(models.encoded(models.pictures()["color"]))
    lines = (
        "newmtl painted\nmap_Kd -clamp on -s 2 3 1 -o 0.25 -0.5 tex/my color.png\nnewmtl plain\n"
    )
    (tmp_path / "box.mtl").write_text(lines)
    model = read_model(file, unit_m=1, up="z")
    expected = models.uv()[6:] * [2, 3] + [0.25, -0.5]
    assert np.array_equal(model.uv[6:], expected)
    assert np.array_equal(model.uv[:6], models.uv()[:6])


def test_bumps_are_heights_if_gray_and_normals_if_blue(tmp_path):
    file = write(tmp_path / "box.obj")
    (tmp_path / "box.mtl").write_text("newmtl plain\nbump tex/rough.png\nnewmtl painted\n"
                                      "map_Bump -bm 1.0 tex/normal.png\n")  # fmt: skip
    model = read_model(file, unit_m=1, up="z")
    assert [sorted(m.pictures) for m in model.materials] == [[], ["normal"]]
    assert any("its bumps (tex/rough.png) are left out" in note for note in model.notes)


def test_what_has_no_place_in_the_surface_model_is_noted(tmp_path):
    document, binary = models.gltf_parts(False)
    document["materials"][0] |= {
        "alphaMode": "BLEND", "emissiveFactor": [0, 1, 0], "occlusionTexture": {"index": 0},
        "extensions": {"KHR_materials_clearcoat": {}},
    }  # fmt: skip
    (tmp_path / "a.glb").write_bytes(glb(document, binary))
    notes = " ".join(read_model(tmp_path / "a.glb").notes)
    for words in ("opacity is not shown", "emission", "occlusion", "KHR_materials_clearcoat"):
        assert words in notes
    assert notes.count("material 'plain'") == 4


def test_gltf_factors_multiply_their_pictures_and_an_even_channel_is_a_number(tmp_path):
    document, binary = models.gltf_parts(False)
    pbr = document["materials"][1]["pbrMetallicRoughness"]
    pbr |= {"roughnessFactor": 0.5, "metallicFactor": 0, "baseColorFactor": [0.5, 1, 0.25, 1]}
    (tmp_path / "a.glb").write_bytes(glb(document, binary))
    painted = read_model(tmp_path / "a.glb").materials[1]
    rough = models.pictures()["rough"]
    halved = np.floor(rough / 2 + 0.5).astype(np.uint8)
    assert np.array_equal(pixels(painted.pictures["roughness"]), halved)
    assert "metallic" not in painted.pictures
    assert (painted.metallic, painted.base_color) == (0.0, (0.5, 1.0, 0.25))


def test_gltf_texture_transforms_and_second_sets_of_coordinates_are_applied(tmp_path):
    document, binary = models.gltf_parts(False)
    moved = {"offset": [0.25, 0.5], "rotation": np.pi / 6, "scale": [2, 3]}
    info = {"index": 0, "extensions": {"KHR_texture_transform": moved}}
    document["materials"][1] = {"name": "painted", "pbrMetallicRoughness": {
        "baseColorTexture": info, "metallicRoughnessTexture": {"index": 1}}}  # fmt: skip
    (tmp_path / "a.glb").write_bytes(glb(document, binary))
    model = read_model(tmp_path / "a.glb")
    # As the extension writes it, for v down the picture.
    u, v = models.uv()[6:, :, 0], 1.0 - models.uv()[6:, :, 1]
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    across, down = c * 2 * u + s * 3 * v + 0.25, -s * 2 * u + c * 3 * v + 0.5
    assert np.allclose(model.uv[6:], np.stack([across, 1.0 - down], axis=-1), atol=1e-6)
    assert any("roughness picture" in n and "other texture coordinates" in n for n in model.notes)
    assert list(model.materials[1].pictures) == ["base_color"]


def test_trimesh_s_own_textured_glb_comes_back(tmp_path):
    drawn = models.pictures()
    material = trimesh.visual.material.PBRMaterial(
        name="skin",
        baseColorTexture=Image.fromarray(drawn["color"]),
        roughnessFactor=0.25,
        metallicFactor=0.5,
        baseColorFactor=[255, 51, 0, 255],
    )
    corners = BOX[models.faces()].reshape(-1, 3)
    mesh = trimesh.Trimesh(
        corners,
        np.arange(36).reshape(-1, 3),
        visual=trimesh.visual.TextureVisuals(uv=models.uv().reshape(-1, 2), material=material),
        process=False,
    )
    mesh.export(tmp_path / "a.glb")
    model = read_model(tmp_path / "a.glb", up="z")
    assert np.allclose(model.points[model.faces], BOX[models.faces()])
    assert np.allclose(model.uv, models.uv(), atol=1e-7)
    (skin,) = model.materials
    assert (skin.roughness, skin.metallic) == (0.25, 0.5)
    assert skin.base_color == pytest.approx((1, 0.2, 0), abs=1e-6)
    assert np.array_equal(pixels(skin.pictures["base_color"]), drawn["color"])


def test_normals_turn_with_their_nodes_and_mirrors_keep_them_outside(tmp_path):
    sphere = trimesh.creation.icosphere(2)
    data = sphere.vertices.astype("<f4").tobytes()
    faces = sphere.faces.astype("<u4").tobytes()
    count = len(sphere.vertices)
    document = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0, "scale": [-2, 1, 0.5], "rotation": [0, 0.6, 0, 0.8]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": sphere.faces.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(data)},
            {"buffer": 0, "byteOffset": len(data), "byteLength": len(faces)},
        ],
        "buffers": [{"byteLength": len(data) + len(faces)}],
    }
    (tmp_path / "a.glb").write_bytes(glb(document, data + faces))
    model = read_model(tmp_path / "a.glb")
    assert np.allclose((model.normals**2).sum(axis=2), 1.0, atol=1e-6)
    # An ellipsoid's normal is the gradient of its equation.
    turn = np.array([[0.28, 0, 0.96], [0, 1, 0], [-0.96, 0, 0.28]])
    stretch = turn @ np.diag([-2, 1, 0.5])
    z_up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    inverse = np.linalg.inv(z_up @ stretch)
    at = model.points[model.faces]
    gradient = (at @ inverse.T) @ inverse
    gradient /= np.linalg.norm(gradient, axis=2, keepdims=True)
    assert np.allclose(model.normals, gradient, atol=1e-5)
    flat = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
    assert ((flat[:, None] * model.normals).sum(axis=2) > 0).all()


def test_instances_are_the_same_mesh_at_as_many_nodes(tmp_path):
    rng = np.random.default_rng(4)
    scales = rng.uniform(0.5, 2.0, (5, 3))
    scales[3:, 0] *= -1.0
    rows = {"TRANSLATION": rng.normal(size=(5, 3)), "ROTATION": rng.normal(size=(5, 4))}
    rows = {key: value.astype("<f4") for key, value in (rows | {"SCALE": scales}).items()}
    folders = [tmp_path / "nodes", tmp_path / "instances"]
    for folder in folders:
        folder.mkdir()
        document, binary = models.gltf_parts(beside=False)
        if folder.name == "nodes":
            document["nodes"] = [
                {"name": "box", "mesh": 0}
                | {k.lower(): [float(x) for x in v[i]] for k, v in rows.items()}
                for i in range(5)
            ]
        else:
            attributes = {}
            for key, values in rows.items():
                attributes[key] = len(document["accessors"])
                document["accessors"].append(
                    {
                        "bufferView": len(document["bufferViews"]), "componentType": 5126,
                        "count": 5, "type": f"VEC{values.shape[1]}",
                    }
                )  # fmt: skip
                document["bufferViews"].append(
                    {"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes}
                )
                binary += values.tobytes()
            told = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
            document["nodes"][0]["extensions"] = told
            document["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
        document["buffers"] = [{"byteLength": len(binary)}]
        (folder / "a.glb").write_bytes(glb(document, binary))
    one, other = (read_model(folder / "a.glb") for folder in folders)
    assert one.parts == other.parts

    def sides(model):
        at = model.points[model.faces]
        order = np.lexsort(np.round(at.reshape(len(at), -1), 6).T)
        return at[order], model.uv[order], model.material_of_face[order]

    for a, b in zip(sides(one), sides(other), strict=True):
        assert np.allclose(a, b, atol=1e-12)


@pytest.mark.parametrize(("kind", "channels"), [("uint8", 1), ("uint8", 3), ("uint16", 1)])
def test_our_png_is_read_back_by_pillow(kind, channels):
    rng = np.random.default_rng(2)
    drawn = rng.integers(0, np.iinfo(kind).max, (301, 257, channels)).astype(kind)
    read = np.asarray(Image.open(io.BytesIO(png(drawn))))
    assert np.array_equal(read, drawn[..., 0] if channels == 1 else drawn)


@pytest.mark.parametrize("kind", ["WEBP", "BMP", "TGA", "GIF", "JPEG", "TIFF"])
def test_kinds_of_pictures_that_renderers_may_not_read_become_png(tmp_path, kind):
    file = write(tmp_path / "box.obj")
    drawn = np.repeat(models.pictures()["rough"][..., None], 3, axis=2)
    name = f"tex/color.{kind.lower()}"
    options = {"lossless": True} if kind == "WEBP" else {}
    Image.fromarray(drawn).save(tmp_path / name, kind, **options)
    (tmp_path / "box.mtl").write_text(models.MTL.replace("tex/color.png", name))
    picture = read_model(file, unit_m=1, up="z").materials[1].pictures["base_color"]
    if kind in ("JPEG", "TIFF"):
        assert picture == tmp_path / name
    else:
        assert picture.suffix == ".png"
        assert np.array_equal(pixels(picture), drawn)


def test_many_small_parts_are_the_whole_that_they_were(tmp_path):
    points, quads = shelter(40)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    for i, quad in enumerate(quads.tolist()):
        lines += [f"g strip{i % 300}", "f " + " ".join(str(k + 1) for k in quad)]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    model = read_model(tmp_path / "a.obj", unit_m=1, up="z")
    assert model.parts == tuple(f"strip{i}" for i in range(300))
    own = [points[quads[k::300][:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)] for k in range(300)]
    assert np.array_equal(model.points[model.faces], np.concatenate(own))
    assert np.array_equal(model.part_of_face, np.repeat(np.arange(300), [len(o) for o in own]))


BYTES = """
import hashlib, sys
from pathlib import Path
from scenec.compiler.assets.model import read_model
digest = hashlib.sha256()
for name in sys.argv[1:]:
    given = {"unit_m": 0.3, "up": "y"} if name.endswith("obj") else {}
    model = read_model(Path(name), **given)
    for array in (model.points, model.faces, model.uv, model.material_of_face):
        digest.update(array.tobytes())
    for m in model.materials:
        digest.update(repr((m.name, m.base_color, m.roughness, m.metallic, m.specular)).encode())
        for source in m.pictures.values():
            digest.update(source.read_bytes() if isinstance(source, Path) else source.data)
print(digest.hexdigest())
"""


@pytest.mark.invariant
@pytest.mark.slow
def test_a_model_has_the_same_bytes_whatever_the_cpu(tmp_path):
    document, binary = models.gltf_parts(False)
    document["nodes"][0]["rotation"] = [0.1, 0.2, 0.3, 0.9]
    info = document["materials"][1]["pbrMetallicRoughness"]["baseColorTexture"]
    info["extensions"] = {"KHR_texture_transform": {"rotation": 0.7}}
    (tmp_path / "a.glb").write_bytes(glb(document, binary))
    files = [str(tmp_path / "a.glb"), str(write(tmp_path / "box.obj"))]
    plain_cpu = {
        "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX AVX2 FMA3",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F",
        "OPENBLAS_CORETYPE": "Nehalem",
        "NUMBA_CPU_NAME": "generic",
        "PYTHONHASHSEED": "7",
    }
    seen = set()
    for environment in ({}, plain_cpu):
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", BYTES, *files],
            capture_output=True,
            text=True,
            env={**os.environ, **environment},
            check=False,
        )
        assert done.returncode == 0, done.stderr
        seen.add(done.stdout)
    assert len(seen) == 1
