"""Blender's files: what is shown of them, no script of theirs, and one message for what is wrong.

The files are made here, by Blender; where it is not installed, only the message for that is tested.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_assets_model import fails, pixels

from scenec.compiler.assets import blend
from scenec.compiler.assets.model import read_model
from scenec.compiler.assets.parse import parse_model
from scenec.compiler.scene.material import ImageFile
from scenec.testing import models
from scenec.testing.models import BOX


def needs_blender(test):
    """Blender takes seconds to start, in each process that reads."""
    missing = importlib.util.find_spec("bpy") is None
    return pytest.mark.slow(pytest.mark.skipif(missing, reason="bpy is not installed")(test))


PRELUDE = """
import sys
from pathlib import Path
import bpy
folder = Path(sys.argv[1])
bpy.ops.wm.read_factory_settings(use_empty=True)

def material(name):
    made = bpy.data.materials.new(name)
    return made, made.node_tree, made.node_tree.nodes["Principled BSDF"]

def box(name, points, quads, st=None, sides=()):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], quads)
    if st is not None:
        layer = mesh.uv_layers.new(name="UVMap")
        layer.uv.foreach_set("vector", [x for pair in st * len(quads) for x in pair])
    for made in sides:
        mesh.materials.append(made)
    if sides:
        for i, polygon in enumerate(mesh.polygons):
            polygon.material_index = i // 3
    shown = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(shown)
    return shown

def save(name, **choice):
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / name), **choice)
"""


def blender(folder: Path, script: str, *arguments: str) -> str:
    """What a script prints that runs in Blender."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PRELUDE + script, str(folder), *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


BOX_SCRIPT = f"""
plain, _, shader = material("plain")
shader.inputs["Base Color"].default_value = (0.5, 0.25, 0.125, 1)
shader.inputs["Roughness"].default_value = 0.75
shader.inputs["Metallic"].default_value = 0.25
painted, tree, shader = material("painted")

def texture(file, space):
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.load(str(folder / "tex" / f"{{file}}.png"))
    node.image.colorspace_settings.name = space
    return node

tree.links.new(texture("color", "sRGB").outputs["Color"], shader.inputs["Base Color"])
split = tree.nodes.new("ShaderNodeSeparateColor")
tree.links.new(texture("packed", "Non-Color").outputs["Color"], split.inputs["Color"])
tree.links.new(split.outputs["Green"], shader.inputs["Roughness"])
tree.links.new(split.outputs["Blue"], shader.inputs["Metallic"])
normal = tree.nodes.new("ShaderNodeNormalMap")
tree.links.new(texture("normal", "Non-Color").outputs["Color"], normal.inputs["Color"])
tree.links.new(normal.outputs["Normal"], shader.inputs["Normal"])
points, quads, st = {BOX.tolist()}, {models.QUADS.tolist()}, {models.SQUARE.tolist()}
shown = box("box", points, quads, st, (plain, painted))
save("beside.blend")
bpy.ops.file.make_paths_relative()
save("beside.blend")
bpy.ops.file.make_paths_absolute()
save("absolute.blend", relative_remap=False)
bpy.ops.file.pack_all()
save("packed.blend")
save("small.blend", compress=True)
hidden = box("hidden", points, quads)
hidden.hide_render = True
empty = bpy.data.objects.new("rig", None)
bpy.context.scene.collection.objects.link(empty)
empty.location = (10, 0, 0)
shown.parent = empty
many = shown.modifiers.new("many", "ARRAY")
many.count = 3
many.use_relative_offset = False
many.use_constant_offset = True
many.constant_offset_displace = (4, 0, 0)
bpy.context.scene.unit_settings.scale_length = 0.01
save("array.blend")
"""

TRAP = """
text = bpy.data.texts.new("trap.py")
text.from_string(f"open({str(folder / 'text_ran')!r}, 'w').close()")
text.use_module = True
shown = box("box", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
curve = shown.driver_add("location", 0)
curve.driver.type = "SCRIPTED"
curve.driver.expression = f"open({str(folder / 'driver_ran')!r}, 'w').close() or 7.0"
save("trap.blend")
"""
#: What somebody with scripts on would have: the trap is a trap.
SPRING = """
bpy.context.preferences.filepaths.use_scripts_auto_execute = True
bpy.ops.wm.open_mainfile(filepath=str(folder / "trap.blend"), use_scripts=True)
bpy.context.evaluated_depsgraph_get().update()
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blend")
    models.write_pictures(folder)
    blender(folder, BOX_SCRIPT + "bpy.ops.wm.read_factory_settings(use_empty=True)\n" + TRAP)
    return folder


@needs_blender
@pytest.mark.parametrize("name", ["beside", "packed", "small"])
def test_a_blend_file_is_the_model_that_the_other_formats_are(made, name):
    file = made / f"{name}.blend"
    model = read_model(file)
    assert np.array_equal(model.points[model.faces].reshape(6, -1, 3).max(axis=1),
                          BOX[models.faces()].reshape(6, -1, 3).max(axis=1))  # fmt: skip
    # Blender may split a quad along its other diagonal: compare coordinates by corner.
    side = np.repeat(np.arange(6), 2)
    for face, at, st in zip(side, model.points[model.faces], model.uv, strict=True):
        for point, pair in zip(at, st, strict=True):
            k = int(np.flatnonzero((BOX[models.QUADS[face]] == point).all(axis=1))[0])
            assert pair.tolist() == models.SQUARE[k].tolist()
    plain, painted = model.materials
    assert (plain.name, plain.base_color) == ("plain", (0.5, 0.25, 0.125))
    assert (plain.roughness, plain.metallic) == (0.75, 0.25)
    assert plain.specular == pytest.approx(0.04)
    drawn = models.pictures()
    for kind, name_of in (("base_color", "color"), ("roughness", "rough"), ("metallic", "metal"),
                          ("normal", "normal")):  # fmt: skip
        assert np.array_equal(pixels(painted.pictures[kind]), drawn[name_of])
    assert model.material_of_face.tolist() == [0] * 6 + [1] * 6
    assert model.parts == ("/box",)
    assert model.notes == ()
    flat = np.cross(*(model.points[model.faces][:, k] - model.points[model.faces][:, 0]
                      for k in (1, 2)))  # fmt: skip
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert np.allclose(model.normals, flat[:, None], atol=1e-6)
    beside = [path.name for path in parse_model(file).companions]
    assert beside == (["color.png", "packed.png", "normal.png"] if name == "beside" else [])
    assert isinstance(painted.pictures["base_color"], Path if name == "beside" else ImageFile)


@needs_blender
def test_modifiers_parents_units_and_what_is_hidden_count(made):
    model = read_model(made / "array.blend")
    assert model.parts == ("/rig/box",)
    assert len(model.faces) == 36
    assert np.allclose(model.points.min(axis=0), [0.1, 0, 0], atol=1e-9)
    assert np.allclose(model.points.max(axis=0), [0.2, 0.03, 0.05], atol=1e-8)
    assert np.allclose(read_model(made / "array.blend", unit_m=1).points.max(axis=0), [20, 3, 5])


@needs_blender
def test_no_script_of_a_blend_file_runs(made):
    model = read_model(made / "trap.blend")
    assert len(model.faces) == 1
    assert not (made / "text_ran").exists()
    assert not (made / "driver_ran").exists()
    blender(made, SPRING)
    assert (made / "text_ran").exists()
    assert (made / "driver_ran").exists()


@needs_blender
def test_pictures_of_a_blend_file_by_absolute_paths_or_missing_are_refused(made, tmp_path):
    assert "expected a path relative to absolute.blend" in fails(made / "absolute.blend")
    lonely = tmp_path / "lonely.blend"
    lonely.write_bytes((made / "beside.blend").read_bytes())
    assert "tex/color.png', which is not there" in fails(lonely)


@needs_blender
def test_a_broken_blend_file_is_one_message(made, tmp_path, monkeypatch):
    content = (made / "packed.blend").read_bytes()
    (tmp_path / "short.blend").write_bytes(content[: len(content) // 2])
    (tmp_path / "words.blend").write_bytes(b"BLENDER and then some words\n" * 9)
    assert "Blender" in fails(tmp_path / "short.blend")
    assert "Blender" in fails(tmp_path / "words.blend")
    monkeypatch.setattr(blend, "SECONDS", 0.0)
    (tmp_path / "slow.blend").write_bytes(content)
    assert "takes longer than 0 s" in fails(tmp_path / "slow.blend")
    monkeypatch.setattr(blend, "SECONDS", 300.0)
    monkeypatch.setattr(blend, "MEMORY_SHARE", 0.0)
    assert "GB over it" in fails(tmp_path / "slow.blend")


@needs_blender
def test_a_crash_of_blender_is_one_message(made, tmp_path, monkeypatch):
    dying = tmp_path / "dying"
    dying.write_text(f"#!{sys.executable}\nimport os, signal\nos.kill(os.getpid(), 11)\n")
    dying.chmod(0o755)
    (tmp_path / "a.blend").write_bytes((made / "packed.blend").read_bytes())
    monkeypatch.setattr(sys, "executable", str(dying))
    assert "Blender crashed at it (signal 11)" in fails(tmp_path / "a.blend")


def test_without_blender_the_message_names_the_extra(tmp_path, monkeypatch):
    (tmp_path / "a.blend").write_bytes(b"BLENDER-v500")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "pip install 'scenec[cycles]'" in fails(tmp_path / "a.blend")
    (tmp_path / "b.blend").write_bytes(b"no such thing")
    assert "does not begin with 'BLENDER'" in fails(tmp_path / "b.blend")


IMPORT = """
import json
if sys.argv[2].endswith("obj"):
    bpy.ops.wm.obj_import(filepath=sys.argv[2])
else:
    bpy.ops.import_scene.gltf(filepath=sys.argv[2])
found = {}
for one in bpy.data.materials:
    shader = one.node_tree.nodes.get("Principled BSDF")
    found[one.name] = {
        "base_color": list(shader.inputs["Base Color"].default_value)[:3],
        "roughness": shader.inputs["Roughness"].default_value,
        "metallic": shader.inputs["Metallic"].default_value,
    }
print("FOUND" + json.dumps(found))
"""


@needs_blender
@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_numbers_of_materials_are_those_that_blender_s_importers_read(tmp_path, suffix):
    file = models.write(tmp_path / f"box.{suffix}")
    if suffix == "obj":
        (tmp_path / "box.mtl").write_text(
            "newmtl plain\nKd 0.5 0.25 0.125\nKs 0.5 0.5 0.5\nNs 90\nillum 2\n"
            "newmtl painted\nKd 0.1 0.2 0.3\nPr 0.6\nPm 0.7\nillum 2\n"
        )
    _, _, answer = blender(tmp_path, IMPORT, str(file)).partition("FOUND")
    theirs = json.loads(answer.splitlines()[0])
    ours = {m.name: m for m in read_model(file, **models.keys(suffix)).materials}
    assert sorted(ours) == sorted(theirs)
    for name, numbers in theirs.items():
        for key, value in numbers.items():
            if key in ours[name].pictures or (suffix == "glb" and name == "painted"):
                continue
            assert getattr(ours[name], key) == pytest.approx(value, abs=1e-6)


EXPORT = """
save("beside.blend")
for extension in (False, True):
    bpy.ops.wm.obj_export(
        filepath=str(folder / f"{'pbr' if extension else 'plain'}.obj"),
        export_pbr_extensions=extension, forward_axis="Y", up_axis="Z", path_mode="RELATIVE",
    )
bpy.ops.export_scene.gltf(filepath=str(folder / "a.glb"))
bpy.ops.export_scene.gltf(filepath=str(folder / "b.gltf"), export_format="GLTF_SEPARATE")
bpy.ops.wm.usd_export(filepath=str(folder / "c.usdc"))
bpy.ops.wm.usd_export(filepath=str(folder / "d.usdz"))
"""


@needs_blender
def test_what_blender_exports_to_other_formats_is_the_model_of_its_own_file(tmp_path):
    models.write_pictures(tmp_path)
    blender(tmp_path, BOX_SCRIPT.partition('save("beside.blend")')[0] + EXPORT)
    own = read_model(tmp_path / "beside.blend")
    for name in ("plain.obj", "pbr.obj", "a.glb", "b.gltf", "c.usdc", "d.usdz"):
        other = read_model(tmp_path / name, **models.keys(name.rpartition(".")[2]))

        def corners(model):
            rows = np.concatenate(
                [model.points[model.faces], model.uv, model.normals], axis=2
            ).reshape(-1, 8)
            return sorted(set(map(tuple, np.round(rows, 5).tolist())))

        assert corners(other) == corners(own), name
        theirs = {m.name: m for m in other.materials}
        assert sorted(theirs) == ["painted", "plain"]
        for material in own.materials:
            found = theirs[material.name]
            assert found.base_color == pytest.approx(material.base_color, abs=1e-6)
            assert found.specular == pytest.approx(material.specular, abs=1e-6)
            # The format itself has no metallic, and Blender writes none of the pictures to it.
            obj = name.endswith("obj")
            kinds = ["base_color", "normal"] if obj else list(material.pictures)
            if material.pictures:
                assert list(found.pictures) == kinds
                for kind in kinds:
                    own_pixels = pixels(material.pictures[kind])
                    assert np.array_equal(pixels(found.pictures[kind]), own_pixels)
            if not (obj and material.pictures):
                assert found.roughness == pytest.approx(material.roughness, abs=1e-6)
                if name != "plain.obj":
                    assert found.metallic == pytest.approx(material.metallic, abs=1e-6)
