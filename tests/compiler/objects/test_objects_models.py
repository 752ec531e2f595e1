"""Models from files in a scene: parts, materials, labels, ids, poses over time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from elsewhere import printed_elsewhere, printed_here
from hypothesis import given
from hypothesis import strategies as st
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils

from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.geometry.rotations import upright_to
from scenec.compiler.objects.placed import PoseKeys, slerp
from scenec.schemas.errors import CfgError, SceneError
from scenec.testing.examples import examples
from scenec.testing.small import small_cfg, write_cfg

#: A table: a top of 1 m by 1 m at 0.8 m, and a leg; meters, Z up.
TABLE = {"top": ((-0.5, -0.5, 0.7), (0.5, 0.5, 0.8)), "leg": ((-0.1, -0.1, 0.0), (0.1, 0.1, 0.7))}


def write_table(path: Path) -> Path:
    """The table as USD: two meshes under /table, each with a material."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.Xform.Define(stage, "/table")
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    colors = {"top": (0.6, 0.4, 0.2), "leg": (0.1, 0.1, 0.1)}
    for name, (low, high) in TABLE.items():
        mesh = UsdGeom.Mesh.Define(stage, f"/table/{name}")
        mesh.CreateSubdivisionSchemeAttr("none")
        corners = [
            [(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]]
            for i in (0, 1) for j in (0, 1) for k in (0, 1)
        ]  # fmt: skip
        mesh.CreatePointsAttr([Gf.Vec3f(*c) for c in corners])
        mesh.CreateFaceVertexCountsAttr([4] * 6)
        mesh.CreateFaceVertexIndicesAttr([v for quad in quads for v in quad])
        material = UsdShade.Material.Define(stage, f"/looks/{name}_paint")
        shader = UsdShade.Shader.Define(stage, f"/looks/{name}_paint/shader")
        shader.CreateIdAttr("UsdPreviewSurface")
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*colors[name]))
        shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.5)
        material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.Save()
    return path


def cfg_with(folder: Path, objects: dict, samples: int = 3) -> Path:
    write_table(folder / "table.usda")
    cfg = small_cfg()
    cfg["samples"] = samples
    cfg["labels"] = {
        "class": {"sky": 1, "ground": 2, "table": 3},
        "part": {"sky": 1, "ground": 2, "wood": 3, "iron": 4},
    }
    layer = {"material": "soil", "labels": {"class": "ground", "part": "ground"}}
    cfg["terrain"]["relief"] = [{"type": "plane"}]
    cfg["terrain"]["ground"] = [layer]
    cfg["materials"] = {"soil": {"base_color": [0.2, 0.1, 0.1]}}
    cfg["light"] = {"sky": {"type": "clear", "labels": {"class": "sky", "part": "sky"}}}
    for node in objects.values():
        node.setdefault("models", [{"file": "table.usda"}])
        node.setdefault("labels", {"class": "table", "part": "wood"})
        node.setdefault("parts", {"leg": {"labels": {"part": "iron"}}})
    cfg["objects"] = objects
    return write_cfg(folder, cfg)


def compiled(folder: Path, objects: dict, **more) -> Path:
    compile_cfg(cfg_with(folder, objects, **more), seed=5, out=folder / "out")
    return folder / "out" / "batch_0000" / "stage.usda"


def rows_of(scene, first: int, last: int) -> np.ndarray:
    return np.flatnonzero((scene.rows.instance_id >= first) & (scene.rows.instance_id <= last))


def test_scattered_models_keep_parts_materials_and_ids(tmp_path):
    path = compiled(tmp_path, {"tables": {"type": "meshes", "count": 7, "scale": 0.5}})
    scene = read_stage(path)
    rows = rows_of(scene, 1, 7)
    assert set(scene.rows.instance_id[rows]) == set(range(1, 8))
    names = {surface.path.rpartition("/")[2]: surface for surface in scene.surfaces}
    assert names["tables_top_paint"].base_color == pytest.approx((0.6, 0.4, 0.2))
    assert names["tables_leg_paint"].base_color == pytest.approx((0.1, 0.1, 0.1))
    for row in rows:
        mesh = scene.meshes[scene.rows.mesh[row]]
        top = scene.surfaces[mesh.layers[0]] == names["tables_top_paint"]
        assert set(mesh.labels["part"]) == {3 if top else 4}
        assert set(mesh.labels["class"]) == {3}
        points = mesh.points[mesh.faces]
        assert points[..., 2].min() == pytest.approx(0.7 if top else 0.0)
        # Half as large, upright, its origin on the ground.
        matrix = scene.rows.to_world[row]
        assert matrix[2, :3] == pytest.approx([0, 0, 0.5], abs=2e-4)
        assert matrix[2, 3] == pytest.approx(0.0, abs=1e-6)
    faces = sum(len(scene.meshes[scene.rows.mesh[row]].faces) for row in rows)
    assert faces == 7 * 24


def test_the_stage_says_the_same_in_standard_usd(tmp_path):
    path = compiled(tmp_path, {"tables": {"type": "meshes", "count": 2}})
    stage = Usd.Stage.Open(str(path))
    prims = [p for p in stage.Traverse() if p.IsA(UsdGeom.Subset) and "Objects" in str(p.GetPath())]
    assert sorted(p.GetName() for p in prims) == ["leg", "top_paint"]
    for prim in prims:
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        assert material.GetPath().name.startswith("tables_")
    assert UsdUtils.ComputeAllDependencies(Sdf.AssetPath(str(path)))[2] == []


def test_a_material_of_the_cfg_goes_before_the_files_and_leaves_them_out(tmp_path):
    objects = {
        "tables": {"type": "meshes", "count": 2, "material": "soil"},
        "other": {"type": "meshes", "count": 1, "parts": {"top": {"material": "soil"}}},
    }
    scene = read_stage(compiled(tmp_path, objects))
    used = {scene.surfaces[i].path.rpartition("/")[2] for mesh in scene.meshes for i in mesh.layers}
    assert used == {"soil", "other_leg_paint"}
    looks = sorted(p.name for p in (tmp_path / "out/batch_0000/looks").iterdir())
    assert [name for name in looks if name.startswith("tables")] == []


def test_without_rgb_no_materials_and_without_labels_no_labels(tmp_path):
    for outputs, there in ((["depth", "instance"], False), (["rgb", "depth"], True)):
        folder = tmp_path / outputs[0]
        folder.mkdir()
        file = cfg_with(folder, {"tables": {"type": "meshes", "count": 2}})
        cfg = json.loads(file.read_text())
        cfg["outputs"] = outputs
        file.write_text(json.dumps(cfg))
        compile_cfg(file, seed=5, out=folder / "out")
        stage = Usd.Stage.Open(str(folder / "out/batch_0000/stage.usda"))
        text = stage.Flatten().ExportToString()
        assert ("def Material" in text) == there
        assert "scenec_label" not in text
        assert ("GeomSubset" in text) == there


def test_single_objects_stand_where_they_are_told(tmp_path):
    poses = [
        {"x_m": 1, "y_m": 2},
        {"x_m": -3, "y_m": 0, "z_m": 1.5, "rotation_deg": [0, 0, 90], "scale": 2},
    ]
    scene = read_stage(compiled(tmp_path, {"tables": {"type": "placed", "poses": poses}}))
    assert scene.rows.motion is None
    for number, expected in (
        (1, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 0]]),
        (2, [[0, -2, 0, -3], [2, 0, 0, 0], [0, 0, 2, 1.5]]),
    ):
        rows = rows_of(scene, number, number)
        assert len(rows) == 2
        for row in rows:
            assert scene.rows.to_world[row] == pytest.approx(np.array(expected, float), abs=1e-12)


def test_a_table_of_poses_moves_objects_and_keeps_their_ids(tmp_path):
    half = np.sqrt(0.5)
    (tmp_path / "poses.csv").write_text(
        "id,time_s,x_m,y_m,z_m,qw,qx,qy,qz\n"
        "4,0,0,0,0,1,0,0,0\n"
        f"4,2,4,2,1,{half},0,0,{half}\n"
        "2,0,5,5,0,1,0,0,0\n",
        encoding="utf-8",
    )
    path = compiled(tmp_path, {"tables": {"type": "placed", "file": "poses.csv"}})
    scene = read_stage(path)
    assert set(scene.rows.instance_id) == {0, 2, 4}
    for sample, turn in ((0, 0.0), (1, np.pi / 4), (2, np.pi / 2)):
        rows = scene.rows_at(sample)
        for row in np.flatnonzero(rows.instance_id == 4):
            c, s = np.cos(turn), np.sin(turn)
            expected = [[c, -s, 0, 2 * sample], [s, c, 0, sample], [0, 0, 1, 0.5 * sample]]
            assert rows.to_world[row] == pytest.approx(np.array(expected), abs=1e-12)
        for row in np.flatnonzero(rows.instance_id == 2):
            still = [[1, 0, 0, 5], [0, 1, 0, 5], [0, 0, 1, 0]]
            assert rows.to_world[row] == pytest.approx(np.array(still), abs=1e-12)
    stage = Usd.Stage.Open(str(path))
    table = stage.GetPrimAtPath("/World/Objects/tables/instance_4")
    attribute = UsdGeom.Xformable(table).GetOrderedXformOps()[0].GetAttr()
    assert attribute.GetTimeSamples() == [0, 1, 2]
    assert attribute.Get() == attribute.Get(0)


def test_scattered_ids_follow_those_of_single_objects_whatever_their_order(tmp_path):
    objects = {
        "single": {"type": "placed", "poses": [{"x_m": 0, "y_m": 0}]},
        "tables": {"type": "meshes", "count": 3},
    }
    scene = read_stage(compiled(tmp_path, objects))
    assert scene.instance_paths == {"/World/Objects/single": 0, "/World/Objects/tables": 1}
    assert sorted(set(scene.rows.instance_id)) == [0, 1, 2, 3, 4]


def test_objects_on_a_slope_stand_along_it_where_asked(tmp_path):
    slope = 0.25
    objects = {
        "upright": {"type": "placed", "poses": [{"x_m": 2, "y_m": 1}]},
        "tilted": {"type": "placed", "orientation": "normal", "poses": [{"x_m": -2, "y_m": 1}]},
    }
    file = cfg_with(tmp_path, objects)
    cfg = json.loads(file.read_text())
    cfg["terrain"]["relief"] = [{"type": "plane", "slope": [slope, 0]}]
    file.write_text(json.dumps(cfg))
    compile_cfg(file, seed=5, out=tmp_path / "out")
    scene = read_stage(tmp_path / "out/batch_0000/stage.usda")
    upright, tilted = (scene.rows.to_world[rows_of(scene, i, i)[0]] for i in (1, 2))
    assert upright == pytest.approx(
        np.array([[1, 0, 0, 2], [0, 1, 0, 1], [0, 0, 1, 0.5]]), abs=1e-9
    )
    normal = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
    assert tilted[:, 2] == pytest.approx(normal, abs=1e-9)
    assert tilted[:, 3] == pytest.approx([-2, 1, -0.5], abs=1e-9)


def test_an_object_off_the_terrain_needs_a_height_of_its_own(tmp_path):
    objects = {
        "tables": {"type": "placed", "poses": [{"x_m": 0, "y_m": 0}, {"x_m": 999, "y_m": 0}]}
    }
    file = cfg_with(tmp_path, objects)
    with pytest.raises(SceneError, match=r"objects/tables: object 2 at x 999 m, y 0 m is off the"):
        compile_cfg(file, seed=5, out=tmp_path / "out")
    assert not (tmp_path / "out" / "manifest.json").exists()
    objects["tables"]["heights"] = "world"
    compile_cfg(cfg_with(tmp_path, objects), seed=5, out=tmp_path / "out")


_FAULTS = [
    ({"poses": [{"x_m": 0, "y_m": 0}], "file": "p.csv"}, "poses and file both say"),
    ({}, 'expected the key "poses" or the key "file"'),
    ({"poses": [{"x_m": 0, "y_m": 0, "model": 1}]}, "expected an index into models, at most 0"),
    ({"poses": [{"x_m": 0, "y_m": 0}], "parts": {"lg": {}}}, 'part "lg"; did you mean "leg"?'),
    ({"poses": [{"x_m": 0, "y_m": 0}], "models": [{"file": "no.glb"}]}, "no.glb"),
    ({"poses": [{"x_m": 0, "y_m": 0}], "models": [{"file": "table.obj"}]}, "table.obj"),
]


@pytest.mark.parametrize(("change", "said"), _FAULTS)
def test_faults_are_told_with_their_place(tmp_path, change, said):
    (tmp_path / "p.csv").write_text("x_m,y_m\n1,2\n", encoding="utf-8")
    (tmp_path / "table.obj").write_text("v 0 0 0\n", encoding="utf-8")
    file = cfg_with(tmp_path, {"tables": {"type": "placed", **change}})
    with pytest.raises(CfgError) as error:
        compile_cfg(file, seed=5, out=tmp_path / "out")
    assert said in str(error.value)
    assert any(fault.pointer.startswith("/objects/tables") for fault in error.value.faults)


def test_what_a_model_says_nothing_of_is_asked_for(tmp_path):
    (tmp_path / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    objects = {"tables": {"type": "meshes", "count": 1, "models": [{"file": "t.obj"}], "parts": {}}}
    with pytest.raises(CfgError) as error:
        compile_cfg(cfg_with(tmp_path, objects), seed=5, out=tmp_path / "out")
    pointers = {fault.pointer for fault in error.value.faults}
    assert pointers >= {"/objects/tables/models/0"}
    assert 'the key "unit_m" is missing' in str(error.value)
    assert 'the key "up" is missing' in str(error.value)


def test_models_are_drawn_by_their_weights(tmp_path):
    models = [{"file": "table.usda", "weight": w} for w in (1, 0, 3)]
    objects = {"tables": {"type": "meshes", "count": 4000, "models": models, "lod_px": 0}}
    path = compiled(tmp_path, objects)
    stage = Usd.Stage.Open(str(path))
    instancer = UsdGeom.PointInstancer.Get(stage, "/World/Objects/tables")
    targets = [t.name for t in instancer.GetPrototypesRel().GetTargets()]
    assert targets == ["model_00_table", "model_02_table"]
    counts = np.bincount(np.array(instancer.GetProtoIndicesAttr().Get()))
    # Four standard deviations of a binomial of 1/4.
    assert abs(counts[0] - 1000) < 4 * np.sqrt(4000 * 3 / 16)


unit_quaternions = st.integers(0, 2**32 - 1).map(
    lambda seed: (lambda q: q / np.linalg.norm(q))(np.random.default_rng(seed).normal(size=4))
)


@examples(100)
@given(a=unit_quaternions, b=unit_quaternions, part=st.floats(0, 1))
def test_turns_between_two_go_the_shorter_way_at_an_even_rate(a, b, part):
    mixed = slerp(a, b, part)
    whole = np.arccos(min(abs(float((a * b).sum())), 1.0))
    done = np.arccos(min(abs(float((a * mixed).sum())), 1.0))
    assert np.linalg.norm(mixed) == pytest.approx(1.0, abs=1e-12)
    assert done == pytest.approx(part * whole, abs=3e-8)


def test_poses_hold_before_and_after_their_times():
    keys = PoseKeys(
        np.array([1.0, 2.0]),
        np.array([[0.0, 0, 0], [2, 4, 6]]),
        np.eye(4)[[0, 0]],
        np.array([1.0, 3]),
    )
    for time, part in ((-5, 0), (1, 0), (1.25, 0.25), (2, 1), (9, 1)):
        position, quaternion, scale = keys.at(time)
        assert position == pytest.approx(part * np.array([2, 4, 6]))
        assert quaternion == pytest.approx([1, 0, 0, 0])
        assert scale == pytest.approx(1 + 2 * part)


@examples(100)
@given(st.floats(-0.999, 0.999), st.floats(-np.pi, np.pi))
def test_standing_along_a_normal_is_a_rotation_that_takes_up_to_it(z, bearing):
    level = np.sqrt(1 - z * z)
    normal = np.array([level * np.cos(bearing), level * np.sin(bearing), z])
    matrix = upright_to(normal[None])[0]
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-9)
    assert matrix[:, 2] == pytest.approx(normal, abs=1e-12)


_HASHES = """
import hashlib, sys, pathlib, tempfile
from scenec.compiler.compile import compile_cfg
with tempfile.TemporaryDirectory() as folder:
    compile_cfg(sys.argv[1], seed=5, out=folder)
    print((pathlib.Path(folder) / "manifest.json").read_text())
"""


@pytest.mark.invariant
@pytest.mark.slow
def test_models_have_the_same_bytes_in_all_circumstances(tmp_path):
    (tmp_path / "poses.csv").write_text(
        "time_s,x_m,y_m,qw,qx,qy,qz\n0,0,0,1,0,0,0\n2,1,1,0.5,0.5,0.5,0.5\n", encoding="utf-8"
    )
    objects = {
        "single": {"type": "placed", "file": "poses.csv", "orientation": "normal"},
        "tables": {
            "type": "meshes", "count": 12, "lean_deg": 10, "orientation": "normal",
            "apart": {"gap_m": 0.2, "of": ["single", "tables"]},
        },
    }  # fmt: skip
    cfg = cfg_with(tmp_path, objects)
    assert printed_elsewhere(_HASHES, cfg) == printed_here(_HASHES, cfg)
