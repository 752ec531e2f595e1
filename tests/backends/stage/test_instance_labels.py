"""Labeled things of foreign stages are instances, numbered in the order of the stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Kind, Sdf, Usd, UsdGeom

from scenec.backends.stage.labels import labeled_instances, read_table
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.schemas import stage as names
from scenec.testing.foreign_stages import label, opened, square
from scenec.testing.small import write_cfg

TYPES = Sdf.ValueTypeNames


def ids(scene: RenderScene) -> dict[str, set[int]]:
    """Instance ids by the prim of the mesh."""
    found: dict[str, set[int]] = {}
    for mesh, number in zip(scene.rows.mesh, scene.rows.instance_id, strict=True):
        found.setdefault(scene.meshes[mesh].path, set()).add(int(number))
    return found


def car(stage: Usd.Stage, path: str) -> None:
    """A labeled thing of two parts, one of them labeled at another level."""
    label(UsdGeom.Xform.Define(stage, path).GetPrim(), "car")
    square(stage, f"{path}/body")
    label(square(stage, f"{path}/wheel").GetPrim(), "wheel", "part")


def instancer(stage: Usd.Stage, path: str, count: int = 3) -> UsdGeom.PointInstancer:
    many = UsdGeom.PointInstancer.Define(stage, path)
    square(stage, f"{path}/tree")
    many.CreatePrototypesRel().SetTargets([f"{path}/tree"])
    many.CreatePositionsAttr([(i, 0, 0) for i in range(count)])
    many.CreateProtoIndicesAttr([0] * count)
    return many


def test_the_outermost_labeled_prim_is_one_instance(tmp_path):
    def build(stage):
        car(stage, "/Root/a")
        car(stage, "/Root/b")
        label(square(stage, "/Root/floor").GetPrim(), "floor")
        square(stage, "/Root/unlabeled")

    scene = opened(tmp_path, build)
    assert ids(scene) == {
        "/Root/a/body": {1},
        "/Root/a/wheel": {1},
        "/Root/b/body": {2},
        "/Root/b/wheel": {2},
        "/Root/floor": {3},
        "/Root/unlabeled": {0},
    }
    assert scene.instance_paths == {"/Root/a": 0, "/Root/b": 1, "/Root/floor": 2}


def test_a_labeled_group_is_no_thing_but_what_is_in_it(tmp_path):
    def build(stage):
        label(UsdGeom.Scope.Define(stage, "/Root/rocks").GetPrim(), "rock")
        group = UsdGeom.Xform.Define(stage, "/Root/rocks/pile").GetPrim()
        Usd.ModelAPI(group).SetKind(Kind.Tokens.group)
        square(stage, "/Root/rocks/a")
        square(stage, "/Root/rocks/pile/b")
        square(stage, "/Root/rocks/pile/c")

    scene = opened(tmp_path, build)
    assert ids(scene) == {
        "/Root/rocks/a": {3},
        "/Root/rocks/pile/b": {1},
        "/Root/rocks/pile/c": {2},
    }
    assert all((mesh.labels["class"] == 1).all() for mesh in scene.meshes)


def test_labels_come_after_all_authored_ids(tmp_path):
    def build(stage):
        car(stage, "/Root/a")
        own = square(stage, "/Root/b").GetPrim()
        own.CreateAttribute(names.ATTR_INSTANCE_ID, TYPES.UInt).Set(40)
        ground = square(stage, "/Root/c").GetPrim()
        ground.CreateAttribute(names.ATTR_INSTANCE_ID, TYPES.UInt).Set(0)
        label(ground, "ground")
        label(instancer(stage, "/Root/d").GetPrim(), "tree")

    assert ids(opened(tmp_path, build)) == {
        "/Root/a/body": {44},
        "/Root/a/wheel": {44},
        "/Root/b": {40},
        "/Root/c": {0},
        "/Root/d/tree": {41, 42, 43},
    }


def test_what_a_prim_says_itself_holds_inside_of_a_labeled_one(tmp_path):
    def build(stage):
        car(stage, "/Root/a")
        driver = square(stage, "/Root/a/driver").GetPrim()
        driver.CreateAttribute(names.ATTR_INSTANCE_ID, TYPES.UInt).Set(7)
        instancer(stage, "/Root/a/leaves")

    assert ids(opened(tmp_path, build)) == {
        "/Root/a/body": {11},
        "/Root/a/driver": {7},
        "/Root/a/leaves/tree": {8, 9, 10},
        "/Root/a/wheel": {11},
    }


def test_native_instances_are_things_of_their_own(tmp_path):
    def build(stage):
        square(stage, "/Model/mesh")
        label(stage.GetPrimAtPath("/Model"), "rock")
        for name in ("a", "b"):
            prim = UsdGeom.Xform.Define(stage, f"/Root/{name}").GetPrim()
            prim.GetReferences().AddInternalReference("/Model")
            prim.SetInstanceable(True)

    scene = opened(tmp_path, build)
    assert scene.instance_paths == {"/Root/a": 0, "/Root/b": 1, "/Model": 2}
    assert sorted(scene.rows.instance_id.tolist()) == [1, 2, 3]
    assert len(scene.meshes) <= 2


def test_ids_do_not_depend_on_what_shows_or_comes_later(tmp_path):
    def build(stage, hidden="", removed=""):
        for name in "abcd":
            if name != removed:
                label(square(stage, f"/Root/{name}").GetPrim(), name)
        if hidden:
            UsdGeom.Imageable(stage.GetPrimAtPath(hidden)).MakeInvisible()
        # Nothing that has no shape counts.
        label(UsdGeom.Xform.Define(stage, "/Root/empty").GetPrim(), "nothing")

    folders = [tmp_path / str(i) for i in range(3)]
    for folder in folders:
        folder.mkdir()
    whole = ids(opened(folders[0], build))
    assert whole == {"/Root/a": {1}, "/Root/b": {2}, "/Root/c": {3}, "/Root/d": {4}}
    hidden = ids(opened(folders[1], lambda stage: build(stage, hidden="/Root/b")))
    assert hidden == {path: whole[path] for path in ("/Root/a", "/Root/c", "/Root/d")}
    shorter = ids(opened(folders[2], lambda stage: build(stage, removed="d")))
    assert shorter == {path: whole[path] for path in ("/Root/a", "/Root/b", "/Root/c")}


def test_parts_of_a_labeled_thing_know_their_place_in_it(tmp_path):
    def build(stage):
        label(UsdGeom.Xform.Define(stage, "/Root/a").GetPrim(), "car")
        UsdGeom.Xformable(stage.GetPrimAtPath("/Root/a")).AddTranslateOp().Set((5, 0, 0))
        square(stage, "/Root/a/wheel").AddTranslateOp().Set((0, 2, 0))

    scene = opened(tmp_path, build)
    (part,) = scene.parts[scene.rows.part]
    np.testing.assert_array_equal(part[:, 3], (0, 2, 0))


def test_a_stage_that_is_compiled_here_says_all_its_ids(tmp_path):
    compile_cfg(write_cfg(tmp_path), seed=3, out=tmp_path / "out")
    path = tmp_path / "out/batch_0000/stage.usda"
    stage = Usd.Stage.Open(str(path))
    assert labeled_instances(stage, read_table(stage)) == {}
    scene = read_stage(path)
    terrain = [i for i, m in enumerate(scene.meshes) if "/Terrain/" in m.path]
    assert not scene.rows.instance_id[np.isin(scene.rows.mesh, terrain)].any()
    assert Path(path).with_name("report.json").is_file()
