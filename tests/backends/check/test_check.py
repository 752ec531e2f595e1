"""``scenec check`` finds what public validators miss."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from scenec.backends.check.files import check_files
from scenec.backends.check.scene import check_scene
from scenec.backends.check.stage import check_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import OutputError
from scenec.schemas.manifest import read_manifest
from scenec.testing.foreign_stages import opened, square
from scenec.testing.small import write_cfg

ROCKS = "/World/Objects/rocks"
TILE = "/World/Terrain/tile_000_000"
CAMERA = "/World/Rigs/rover/front"


@pytest.fixture(scope="module")
def output(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("check")
    compile_cfg(write_cfg(folder), seed=3, out=folder / "out", keep=Keep.UNPRUNED)
    return folder / "out"


def broken(attribute: str, change):
    """A function that changes one attribute's value."""

    def apply(stage: Usd.Stage) -> None:
        found = stage.GetAttributeAtPath(attribute)
        assert found, attribute
        found.Set(change(found.Get()))

    return apply


def with_nan(values):
    array = np.array(values)
    array[7] = np.nan
    return Vt.Vec3fArray.FromNumpy(array)


def ids(values) -> Vt.Int64Array:
    return Vt.Int64Array([int(v) for v in values])


FAULTS = {
    "instancer-arrays: prototypes": (
        broken(f"{ROCKS}.protoIndices", lambda v: [*list(v)[:-1], 99]),
        "protoIndices go from 0 to 99, there are",
    ),
    "instancer-arrays: positions": (
        broken(f"{ROCKS}.positions", lambda v: list(v)[:-1]),
        "300 protoIndices, but 299 positions",
    ),
    "instancer-arrays: NaN": (broken(f"{ROCKS}.positions", with_nan), "1 positions are not finite"),
    "instancer-arrays: scales": (
        broken(f"{ROCKS}.scales", lambda v: list(v) * 2),
        "300 protoIndices, but 600 scales",
    ),
    "instancer-arrays: zero": (
        broken(f"{ROCKS}.orientations", lambda v: [Gf.Quath(0)] * len(v)),
        "orientations hold zero quaternions",
    ),
    "instancer-arrays: primvar": (
        broken(f"{ROCKS}.primvars:scenec_variation", lambda v: list(v)[:5]),
        "has 5 values for 300 instances",
    ),
    "instancer-ids: twice": (
        broken(f"{ROCKS}.ids", lambda v: ids([1, *list(v)[:-1]])),
        "ids [1] stand more than once",
    ),
    "instancer-ids: zero": (
        broken(f"{ROCKS}.ids", lambda v: ids(i - 1 for i in v)),
        "the lowest id is 0",
    ),
    "instancer-ids: number": (
        broken(f"{ROCKS}.ids", lambda v: ids(list(v)[:-2])),
        "300 protoIndices, but 298 ids",
    ),
    "mesh-topology: NaN": (broken(f"{TILE}.points", with_nan), "1 points are not finite"),
    "mesh-topology: indices": (
        broken(f"{TILE}.faceVertexIndices", lambda v: [*list(v)[:-1], 10**6]),
        "faceVertexIndices go from 0 to 1000000",
    ),
    "mesh-topology: counts": (
        broken(f"{TILE}.faceVertexCounts", lambda v: list(v)[:-1]),
        "faceVertexCounts add up to",
    ),
    "mesh-labels: length": (
        broken(f"{TILE}.primvars:scenec_label_class", lambda v: list(v)[:-1]),
        "values for",
    ),
    "mesh-labels: id": (
        broken(f"{TILE}.primvars:scenec_label_surface", lambda v: [99] * len(v)),
        "ids [99] that the table lacks",
    ),
    "mesh-primvars: length": (
        broken(f"{TILE}.primvars:scenec_weight_2", lambda v: list(v)[1:]),
        "scenec_weight_2 has",
    ),
    "camera: focal length": (
        broken(f"{CAMERA}.focalLength", lambda v: v * 1.01),
        "differ from scenec:intrinsics by",
    ),
    "camera: clipping": (
        broken(f"{CAMERA}.clippingRange", lambda v: Gf.Vec2f(10, 1)),
        "is not 0 < near < far",
    ),
    "assets": (
        broken(
            "/World/Lights/Dome.inputs:texture:file", lambda v: Sdf.AssetPath("./textures/none.exr")
        ),
        "none.exr does not exist",
    ),
    "labels": (
        broken("/World.scenec:labels:class:ids", lambda v: [1]),
        "names and ids differ in number",
    ),
    "layout": (
        lambda stage: UsdGeom.SetStageMetersPerUnit(stage, 0.01),
        "metersPerUnit is 0.01, expected 1",
    ),
}


@pytest.mark.parametrize("name", list(FAULTS))
def test_each_fault_is_found_and_said(name, output, tmp_path):
    change, words = FAULTS[name]
    folder = tmp_path / "batch"
    shutil.copytree(output / "batch_0000", folder)
    stage = Usd.Stage.Open(str(folder / "stage.usda"))
    # An opinion in the root layer is stronger than all sublayers.
    change(stage)
    stage.Save()
    found = [f for f in check_stage(folder / "stage.usda") if words in f.message]
    assert found, [str(f) for f in check_stage(folder / "stage.usda")]
    assert found[0].check == name.split(":")[0]
    assert found[0].severity == "error"


def test_overlapping_id_ranges_of_two_classes_are_found(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "two.usda"))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    for name, base in (("a", 0), ("b", 2)):
        many = UsdGeom.PointInstancer.Define(stage, f"/World/{name}")
        many.CreateIdsAttr([1, 2, 3])
        many.GetPrim().CreateAttribute("scenec:instanceIdBase", Sdf.ValueTypeNames.UInt).Set(base)
    stage.Save()
    (found,) = [f for f in check_stage(tmp_path / "two.usda") if f.check == "instance-ids"]
    assert found.where == "/World/b"


def test_changed_missing_and_foreign_files_are_found(output, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(output, out)
    manifest = read_manifest(out)
    assert list(check_files(out, manifest)) == []
    (out / "batch_0000" / "lights.usdc").write_text("changed")
    (out / "batch_0000" / "terrain.usdc").unlink()
    (out / "batch_0000" / "notes.txt").write_text("")
    found = {(f.where, f.severity) for f in check_files(out, manifest)}
    assert found == {
        ("batch_0000/lights.usdc", "error"),
        ("batch_0000/terrain.usdc", "error"),
        ("batch_0000/notes.txt", "warning"),
    }


@pytest.mark.parametrize("content", [None, "", "[]", "{}", '{"batches": 3, "files": {}}'])
def test_a_folder_without_a_manifest_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / "manifest.json").write_text(content)
    with pytest.raises(OutputError, match="manifest"):
        read_manifest(tmp_path)


def _ball(stage: Usd.Stage) -> None:
    UsdGeom.Sphere.Define(stage, "/Root/Ball").CreateRadiusAttr(2.0)


def _ground(stage: Usd.Stage) -> None:
    ground = square(stage, "/Root/Ground")
    ground.AddScaleOp().Set((100.0, 100.0, 1.0))
    ground.GetPointsAttr().Set([(x - 0.5, y - 0.5, z) for x, y, z in ground.GetPointsAttr().Get()])


def _mirrored(stage: Usd.Stage) -> None:
    _ball(stage)
    UsdGeom.Xformable(stage.GetPrimAtPath("/Root/Ball")).AddScaleOp().Set((-1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("build", "places", "samples"),
    [
        (_ball, [(0, 0, 1), (0, 0, 5)], "at sample 0 all"),
        (_ground, [(0, 0, 1), (0, 0, -1), (3, 3, -2)], "at sample 1 and 1 others"),
        # Mirrored, it still has its front outside.
        (_ball, [(0, 0, 2.05)], None),
        (_mirrored, [(0, 0, 2.05)], None),
    ],
)
def test_a_camera_that_sees_backs_alone_is_a_warning(tmp_path, build, places, samples) -> None:
    def all_of_it(stage: Usd.Stage) -> None:
        build(stage)
        eye = UsdGeom.Camera.Define(stage, "/Root/Eye")
        move = eye.AddTranslateOp()
        for code, place in enumerate(places):
            move.Set(Gf.Vec3d(*place), code)

    scene = opened(tmp_path, all_of_it, samples=len(places))
    found = [one for one in check_scene(scene) if one.check == "enclosed"]
    assert [one.where for one in found] == ([] if samples is None else ["/Root/Eye"])
    assert [one.severity for one in found] == ["warning"] * len(found)
    assert all(samples in one.message for one in found)
