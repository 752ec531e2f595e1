"""What outputs do not need is not made: an explicit table against all prims and attributes."""

from __future__ import annotations

import fnmatch
import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from scenec.backends.check.stage import check_stage
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.needed import Keep, Needs, needs_of
from scenec.schemas.passes import PASSES
from scenec.testing import models
from scenec.testing.small import small_cfg, write_cfg

COLOR, LABELS, IDS = {"rgb"}, {"label"}, {"instance", "amodal"}
ALWAYS = set(PASSES)
#: Names of attributes and relationships -> outputs of which one at least shows them.
NEEDED_BY = {
    "points faceVertexCounts faceVertexIndices extent doubleSided orientation subdivisionScheme "
    "xformOp:* xformOpOrder protoIndices positions orientations scales prototypes "
    "scenec:schemaVersion scenec:time projection focalLength horizontalAperture verticalAperture "
    "horizontalApertureOffset verticalApertureOffset clippingRange scenec:intrinsics resolution "
    "camera orderedVars products dataType sourceName sourceType": ALWAYS,
    # It says that there are no ids.
    "scenec:instanceIdsEnabled": ALWAYS,
    "normals primvars:scenec_weight_* primvars:scenec_variation primvars:displayColor "
    "primvars:displayColor:indices primvars:st scenec:layers scenec:layers:* material:binding "
    "exposure scenec:exposure:per scenec:haze:* scenec:surface:* colorSpace:name inputs:* "
    "outputs:* info:id light:* treatAsPoint config:mtlx:version": COLOR,
    "primvars:scenec_label_* scenec:labels:* semantics:labels:* scenec:sky:*": LABELS,
    "ids scenec:instanceIdBase scenec:localInstanceId": IDS,
    # Of subsets, which carry materials and labels.
    "elementType familyName indices subsetFamily:*": COLOR | LABELS,
}
#: Types of prims that stand for one thing alone.
TYPES = {"Material Shader DomeLight DistantLight SphereLight": COLOR, "GeomSubset": COLOR | LABELS}
SCHEMAS = {
    "SemanticsLabelsAPI:*": LABELS,
    "MaterialBindingAPI ShapingAPI MaterialXConfigAPI ColorSpaceAPI": COLOR,
}
FILES = {
    "looks/* lights.usdc *.mtlx.usda textures/*": COLOR,
    "sky.usdc": COLOR | LABELS,
    "objects/* stage.usda terrain.usdc cameras.usdc report.json": ALWAYS,
}
#: All below these.
OF_COLOR = ("/World/Lights", "/World/Looks", "/World/GroundMix")
#: One output of each kind, none, and all together.
ROOMS = [
    tuple(part) for count in range(4) for part in combinations(("rgb", "label", "instance"), count)
]


def needed_by(table: dict[str, set[str]], name: str) -> set[str]:
    found = [
        needs
        for patterns, needs in table.items()
        for pattern in patterns.split()
        if fnmatch.fnmatchcase(name, pattern)
    ]
    assert found, f"{name} is in no table: which output needs it?"
    return set.union(*found)


def rich_cfg(folder: Path, **change: object) -> dict:
    """Everything that a stage can hold, small."""
    models.write(folder / "box.glb")
    cfg = small_cfg(samples=1)
    cfg["labels"]["class"]["box"] = 4
    cfg["labels"]["surface"]["lid"] = 40
    cfg["terrain"] |= {"size_m": [10, 10], "spacing_m": 0.5}
    cfg["materials"]["gravel"]["maps"] = {"procedural": {"type": "gravel", "resolution": 64}}
    cfg["objects"]["rocks"] |= {"count": 40, "prototypes": 2, "subdivisions": 1}
    cfg["objects"]["boxes"] = {
        "type": "placed",
        "models": [{"file": "box.glb"}, {"file": "box.glb"}],
        "labels": {"class": "box", "surface": "stone"},
        "parts": {"painted": {"labels": {"surface": "lid"}}},
        "poses": [{"x_m": 1, "y_m": 1, "scale": 0.2}, {"x_m": -2, "y_m": 0, "scale": 0.1}],
    }
    cfg["light"]["lamps"] = {
        "spot": {"mount": {"type": "rig", "rig": "rover"}, "intensity": 50, "cone_deg": 20},
        "up": {
            "mount": {"type": "world", "x_m": 0, "y_m": 0, "z_m": 50, "elevation_deg": 90},
            "intensity": 50,
            "cone_deg": 20,
        },
    }
    # It looks north, at the boxes.
    cfg["rigs"]["rover"]["pose"] |= {
        "position": {"x_m": 0, "y_m": -4, "height_m": 1.5},
        "target": {"distance_m": 5, "bearing_deg": 0, "height_m": 0},
    }
    cfg["light"]["haze"] = {"visibility_m": 400}
    return cfg | change


def made(tmp_path: Path, outputs: tuple[str, ...], **change: object) -> Path:
    """The folder of the batch."""
    folder = tmp_path / "-".join(outputs)
    folder.mkdir()
    cfg = rich_cfg(folder, **change)
    cfg["outputs"] = list(outputs)
    compile_cfg(write_cfg(folder, cfg), seed=5, out=folder / "out", keep=Keep.UNPRUNED)
    return folder / "out" / "batch_0000"


def properties(batch: Path) -> dict[tuple[str, str], set[str]]:
    """All authored properties of a stage, classes and prototypes included; and what needs them."""
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    found = {}
    for prim in stage.TraverseAll():
        path, kind = str(prim.GetPath()), str(prim.GetTypeName())
        for schema in prim.GetPrimTypeInfo().GetAppliedAPISchemas():
            found[path, schema] = needed_by(SCHEMAS, schema)
        if any(kind in kinds.split() for kinds in TYPES):
            found[path, kind] = needed_by(TYPES, kind)
        for one in prim.GetAuthoredProperties():
            needs = needed_by(NEEDED_BY, one.GetName())
            # Where a light stands is what lights are needed for.
            found[path, one.GetName()] = COLOR if path.startswith(OF_COLOR) else needs
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("whole"), ("rgb", "label", "instance", "depth"))


@pytest.fixture(scope="module", params=[("depth", *room) for room in ROOMS])
def chosen(request, tmp_path_factory: pytest.TempPathFactory) -> tuple[tuple[str, ...], Path]:
    return request.param, made(tmp_path_factory.mktemp("some"), request.param)


def of_ground(path: str) -> bool:
    return path.startswith("/World/Terrain/")


def test_nothing_in_a_stage_is_there_for_no_output(chosen):
    outputs, batch = chosen
    found = properties(batch)
    idle = {key: needs for key, needs in found.items() if not needs & set(outputs)}
    assert idle == {}
    for file in (path for path in batch.rglob("*") if path.is_file()):
        assert needed_by(FILES, file.relative_to(batch).as_posix()) & set(outputs), file
    shows_ids = bool(IDS & set(outputs))
    off = [path for path, name in found if name == "scenec:instanceIdsEnabled"]
    assert (not off) if shows_ids else len(off) == 2
    assert check_stage(batch / "stage.usda") == []


def test_nothing_that_an_output_needs_is_missing(chosen, whole):
    outputs, batch = chosen
    # Without labels the ground is not cut, and is in one piece: see the test of subsets.
    wanted = {
        key
        for key, needs in properties(whole).items()
        if needs & set(outputs)
        and not (of_ground(key[0]) and needs <= COLOR | LABELS)
        # Subsets are there for what differs from the whole.
        and needs != COLOR | LABELS
        and not key[0].startswith("/Render/")
    }
    assert wanted <= properties(batch).keys()


def test_each_face_of_the_ground_has_the_material_and_label_that_outputs_show(chosen):
    outputs, batch = chosen
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    tiles = [p for p in stage.GetPrimAtPath("/World/Terrain").GetChildren()]
    for tile in tiles:
        faces = len(UsdGeom.Mesh(tile).GetFaceVertexCountsAttr().Get())
        subsets = tile.GetChildren()
        held = subsets or [tile]
        bound = [p for p in held if p.HasRelationship("material:binding")]
        assert len(bound) == (len(held) if "rgb" in outputs else 0)
        ids = UsdGeom.PrimvarsAPI(tile).GetPrimvar("scenec_label_surface")
        assert (ids.HasValue() and len(ids.Get()) == faces) == ("label" in outputs)
        if subsets:
            assert "label" in outputs
            counts = [len(UsdGeom.Subset(p).GetIndicesAttr().Get()) for p in subsets]
            assert sum(counts) == faces


def test_what_was_left_out_is_said_with_its_bytes(chosen):
    outputs, batch = chosen
    report = json.loads((batch / "report.json").read_text())
    said = [one for one in report["left_out"] if one["why"].startswith("no sensor asks for")]
    why = {one["why"].removeprefix("no sensor asks for ") for one in said}
    assert why == {"rgb", "labels", "instances"} - {
        {"rgb": "rgb", "label": "labels", "instance": "instances"}.get(one) for one in outputs
    }
    if "instance" not in outputs:
        assert [one["bytes"] for one in said if one["what"].endswith("instances")] == [8 * 42]


def test_geometry_stands_where_it_stands_whatever_is_asked_for(chosen, whole):
    outputs, batch = chosen
    one, other = (Usd.Stage.Open(str(folder / "stage.usda")) for folder in (batch, whole))
    for path, name in (
        ("/World/Objects/rocks", "positions"),
        ("/World/Objects/rocks", "orientations"),
        ("/World/Objects/rocks", "protoIndices"),
        ("/World/Objects/boxes/instance_2", "xformOp:transform"),
        ("/World/Objects/rocks/Prototypes/rock_00", "points"),
        ("/World/Rigs/rover", "xformOp:transform"),
        *([("/World/Terrain/tile_000_000", "points")] if "label" in outputs else []),
    ):
        first, second = (s.GetPrimAtPath(path).GetAttribute(name).Get() for s in (one, other))
        assert first is not None
        assert first == second, (path, name)


def test_someone_who_walks_around_in_a_stage_gets_all_of_it():
    assert needs_of(("depth",), Keep.ALL) == Needs(True, True, True)
    assert needs_of(("depth",), Keep.ALL, levels=False) == Needs(True, False, True)
    assert needs_of(("depth",), Keep.UNPRUNED) == needs_of(("depth",))


def test_geometric_outputs_need_geometry_and_nothing_else(tmp_path):
    kept = made(tmp_path, ("range", "normal", "position", "face", "flow", "occlusion"))
    asked = [p for p in kept.rglob("*") if p.is_file()]
    assert sorted(p.name for p in asked) == [
        "boxes.usdc", "cameras.usdc", "report.json", "rocks.usdc", "stage.usda", "terrain.usdc"
    ]  # fmt: skip
    assert all(needs == ALWAYS for needs in properties(kept).values())


def test_amodal_masks_need_what_instances_need(tmp_path):
    one, other = (made(tmp_path, (name,)) for name in ("amodal", "instance"))
    for name in ("terrain.usdc", "objects/rocks.usdc", "objects/boxes.usdc", "stage.usda"):
        assert (one / name).read_bytes() == (other / name).read_bytes()


def test_each_sensor_has_what_its_own_outputs_need(tmp_path):
    cfg = rich_cfg(tmp_path)
    front = cfg["rigs"]["rover"]["sensors"].pop("front")
    cfg["rigs"]["rover"]["sensors"] = {
        "color": front | {"outputs": ["rgb"]},
        "range": front | {"outputs": ["depth", "instance"]},
    }
    compile_cfg(write_cfg(tmp_path, cfg), seed=5, out=tmp_path / "out", keep=Keep.UNPRUNED)
    stage = Usd.Stage.Open(str(tmp_path / "out/batch_0000/stage.usda"))
    exposed = {
        name: stage.GetPrimAtPath(f"/World/Rigs/rover/{name}").GetAttribute("exposure").IsAuthored()
        for name in ("color", "range")
    }
    assert exposed == {"color": True, "range": False}
    assert stage.GetPrimAtPath("/World/Looks")
    assert not any("label" in name for _, name in properties(tmp_path / "out/batch_0000"))
    variables = {str(p.GetName()) for p in stage.GetPrimAtPath("/Render/Vars").GetChildren()}
    assert variables == {"rgb", "depth", "instance"}


def annotated(batch: Path, outputs: tuple[str, ...]) -> dict[str, np.ndarray]:
    scene = read_stage(batch / "stage.usda")
    session = Session(scene, None)
    camera = scene.cameras[0][0]
    names = tuple(name for name in outputs if name != "rgb")
    passes = session.passes((*names, "range", "normal", "position", "face"), camera)
    return session.render(camera, 0, passes, 1, 0).arrays


@pytest.fixture(scope="module")
def uncut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("uncut"), ("rgb", "instance", "depth"))


def test_annotation_is_the_same_to_the_bit_whatever_else_is_asked_for(chosen, whole, uncut):
    outputs, batch = chosen
    # The cut along label lines makes other faces, for those who ask for labels.
    other, has = (whole, ("label",)) if "label" in outputs else (uncut, ())
    full = annotated(other, ("depth", "instance", *has))
    for name, values in annotated(batch, outputs).items():
        np.testing.assert_array_equal(values, full[name], name)


@pytest.mark.slow
@pytest.mark.invariant
def test_without_label_lines_nothing_at_all_changes_annotation(tmp_path):
    plain = rich_cfg(tmp_path)["terrain"]
    plain["ground"] = plain["ground"][:1]
    cfg = rich_cfg(tmp_path)
    kept = {name: cfg["materials"][name] for name in ("sand", "stone")}
    table = {k: v for k, v in cfg["labels"]["surface"].items() if k not in ("gravel", "mud")}
    change = {
        "terrain": plain,
        "materials": kept,
        "labels": {**cfg["labels"], "surface": table},
    }
    full = annotated(
        made(tmp_path, ("rgb", "label", "instance", "depth"), **change),
        ("depth", "label", "instance"),
    )
    for outputs in (("depth",), ("depth", "rgb"), ("instance", "depth"), ("label", "depth")):
        for name, values in annotated(made(tmp_path, outputs, **change), outputs).items():
            np.testing.assert_array_equal(values, full[name], name)


@pytest.mark.slow
def test_the_cut_moves_the_ground_by_no_more_than_float32_does(tmp_path, whole):
    depth = annotated(made(tmp_path, ("depth",)), ("depth",))["depth"]
    other = annotated(whole, ("depth",))["depth"]
    assert np.array_equal(np.isinf(depth), np.isinf(other))
    seen = np.isfinite(depth)
    away = np.abs(depth[seen] - other[seen]) / depth[seen]
    # A grazing ray turns a micrometer of height into more of depth.
    assert np.quantile(away, 0.99) < 1e-4
    assert np.median(away) < 1e-6


def test_a_class_whose_ids_are_off_has_none_and_the_others_keep_theirs(tmp_path):
    cfg = rich_cfg(tmp_path)
    cfg["outputs"] = ["instance"]
    cfg["objects"]["more"] = cfg["objects"]["rocks"] | {"count": 7}
    cfg["objects"]["rocks"]["instances"] = False
    compile_cfg(write_cfg(tmp_path, cfg), seed=5, out=tmp_path / "out", keep=Keep.UNPRUNED)
    path = tmp_path / "out/batch_0000/stage.usda"
    stage = Usd.Stage.Open(str(path))
    rocks, more = (stage.GetPrimAtPath(f"/World/Objects/{name}") for name in ("rocks", "more"))
    assert not rocks.GetAttribute("ids").HasAuthoredValue()
    assert list(more.GetAttribute("ids").Get()) == list(range(1, 8))
    assert more.GetAttribute("scenec:instanceIdBase").Get() == 42
    assert check_stage(path) == []
    ids = set(read_stage(path).rows.instance_id.tolist())
    # 0: the ground, and the rocks; 41 and 42 are the boxes'.
    assert ids == {0, 41, 42, *range(43, 50)}


def test_a_class_without_objects_is_not_written_but_keeps_its_ids(tmp_path):
    cfg = rich_cfg(tmp_path)
    cfg["outputs"] = ["rgb", "instance"]
    cfg["objects"] = {"none": cfg["objects"]["rocks"] | {"count": 0}, **cfg["objects"]}
    compile_cfg(write_cfg(tmp_path, cfg), seed=5, out=tmp_path / "out", keep=Keep.UNPRUNED)
    batch = tmp_path / "out/batch_0000"
    assert sorted(p.name for p in (batch / "objects").iterdir()) == ["boxes.usdc", "rocks.usdc"]
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    assert not stage.GetPrimAtPath("/World/Objects/none")
    assert (
        stage.GetPrimAtPath("/World/Objects/rocks").GetAttribute("scenec:instanceIdBase").Get() == 0
    )
    assert check_stage(batch / "stage.usda") == []
