"""Foreign stages: samples without a range of time codes, ids of instancers, lights that are off."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, Ts, UsdGeom, UsdLux, UsdSkel, Vt

from scenec.backends.check.scene import check_scene
from scenec.backends.stage.read import read_stage
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.testing.foreign_stages import label, opened, square, written

TYPES = Sdf.ValueTypeNames


def moving(stage, codes=(0, 10, 20, 30)):
    stage.SetTimeCodesPerSecond(10.0)
    move = UsdGeom.Cube.Define(stage, "/Root/box").AddTranslateOp()
    for code in codes:
        move.Set((0, 0.1 * code, 0), code)


def test_without_a_range_the_authored_samples_are_read(tmp_path):
    def build(stage):
        moving(stage)
        eye = UsdGeom.Camera.Define(stage, "/Root/eye")
        # Of a camera, too, and between those of the box.
        eye.CreateFocalLengthAttr().Set(30.0, 10)
        eye.GetFocalLengthAttr().Set(40.0, 15)

    scene = opened(tmp_path, build)
    assert scene.samples == 5
    assert scene.times.tolist() == [0.0, 1.0, 1.5, 2.0, 3.0]
    places = [scene.rows_at(i).to_world[0, 1, 3] for i in range(5)]
    np.testing.assert_allclose(places, [0.0, 1.0, 1.5, 2.0, 3.0], rtol=1e-12)
    focal = [cameras[0].intrinsics[0, 0] for cameras in scene.cameras]
    np.testing.assert_allclose(np.array(focal) / focal[0], [1, 1, 4 / 3, 4 / 3, 4 / 3], rtol=1e-6)
    assert scene.losses == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda stage: stage.SetMetadata("upAxis", "X"), 'upAxis is "X", expected Y or Z'),
        (lambda stage: stage.SetTimeCodesPerSecond(-24.0), "timeCodesPerSecond is -24, expected"),
    ],
)
def test_axes_and_rates_that_cannot_be_are_refused(tmp_path, change, words):
    def build(stage):
        moving(stage)
        change(stage)

    with pytest.raises(StageError, match=f"foreign.usda.*{words}"):
        opened(tmp_path, build)


def test_with_a_range_its_whole_steps_are_read_as_ever(tmp_path):
    def build(stage):
        moving(stage)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(3)

    scene = opened(tmp_path, build)
    assert scene.times.tolist() == [0.0, 0.1, 0.2, 0.3]


@pytest.mark.parametrize("end", ["start", "end"])
def test_half_a_range_is_none(tmp_path, end):
    def build(stage):
        moving(stage)
        stage.SetStartTimeCode(0) if end == "start" else stage.SetEndTimeCode(3)

    assert opened(tmp_path, build).samples == 4


def test_knots_of_a_spline_count_as_samples(tmp_path):
    def build(stage):
        op = UsdGeom.Cube.Define(stage, "/Root/box").AddRotateZOp()
        spline = Ts.Spline("float")
        for time, value in ((0, 0.0), (4, 90.0)):
            spline.SetKnot(Ts.Knot("float", time=time, value=value, nextInterp=Ts.InterpLinear))
        assert op.GetAttr().SetSpline(spline)

    scene = opened(tmp_path, build)
    assert scene.samples == 2
    np.testing.assert_allclose(scene.rows_at(1).to_world[0, :, 0], (0, 1, 0), atol=1e-6)


def test_what_is_not_followed_over_time_makes_no_samples_and_is_named(tmp_path):
    def build(stage):
        holes = square(stage, "/Root/flag").GetHoleIndicesAttr()
        for code in range(9):
            holes.Set([0] * (code % 2), code)

    scene = opened(tmp_path, build)
    assert scene.samples == 1
    (line,) = scene.losses
    assert line.startswith("a shape that deforms stands still")


def test_what_deforms_makes_samples(tmp_path):
    def build(stage):
        points = square(stage, "/Root/flag").GetPointsAttr()
        for code in range(9):
            points.Set([(0, 0, code), (1, 0, 0), (1, 1, 0), (0, 1, 0)], code)
        animation = UsdSkel.Animation.Define(stage, "/Root/bend")
        animation.CreateBlendShapeWeightsAttr().Set([0.0], 0)
        animation.GetBlendShapeWeightsAttr().Set([1.0], 8.5)

    scene = opened(tmp_path, build)
    assert (scene.samples, scene.losses) == (10, ())


@pytest.mark.parametrize("name", ["protoIndices", "ids"])
def test_instances_that_change_their_prototypes_or_ids_are_named(tmp_path, name):
    def build(stage):
        attribute = instancer(stage, [1, 2, 3]).GetPrim().GetAttribute(name)
        for time, value in enumerate(
            ([1, 2, 3], [3, 2, 1]) if name == "ids" else ([0] * 3, [1] * 3)
        ):
            attribute.Set(type(attribute.Get())(value), time)

    scene = opened(tmp_path, build, samples=2)
    assert any(line.startswith("prototypes and ids that change stay") for line in scene.losses)


def instancer(stage, ids, path="/Root/many", base=None):
    many = UsdGeom.PointInstancer.Define(stage, path)
    protos = [square(stage, f"{path}/{name}").GetPath() for name in "ab"]
    many.CreatePrototypesRel().SetTargets(protos)
    many.CreateProtoIndicesAttr([0, 0, 0])
    many.CreatePositionsAttr([(0, 0, 0), (2, 0, 0), (4, 0, 0)])
    if ids is not None:
        many.CreateIdsAttr(Vt.Int64Array(ids))
    if base is not None:
        many.GetPrim().CreateAttribute(names.ATTR_INSTANCE_ID_BASE, TYPES.Int).Set(base)
    return many


@pytest.mark.parametrize(
    "ids",
    [
        [0, 1, 2],
        [-5, 1, 2],
        [1, 2, 2**31],
        [1, 2, 2**40],
        [-(2**62), 3, 2**62],
        [1, 2, 2],
        [1, 2],
        [1, 2, 3, 4],
    ],
)
def test_ids_that_cannot_be_are_places_and_it_is_said(tmp_path, ids):
    scene = opened(tmp_path, lambda stage: instancer(stage, ids) and None)
    assert scene.rows.instance_id.tolist() == [1, 2, 3]
    (line,) = scene.losses
    assert line.startswith("ids that are not from 1 to 2147483647, one for each instance and each")
    assert line.endswith("/Root/many")
    assert line in [finding.message for finding in check_scene(scene)]


@pytest.mark.parametrize(("ids", "expected"), [(None, [1, 2, 3]), ([7, 3, 2**31 - 1], None)])
def test_ids_that_can_be_are_followed_and_none_are_places(tmp_path, ids, expected):
    scene = opened(tmp_path, lambda stage: instancer(stage, ids) and None)
    assert scene.rows.instance_id.tolist() == (expected or ids)
    assert scene.losses == ()


def test_instancers_without_bases_come_one_after_the_other(tmp_path):
    def build(stage):
        instancer(stage, [5, 6, 9], "/Root/a")
        instancer(stage, [1, 2, 3], "/Root/b")

    scene = opened(tmp_path, build)
    assert scene.rows.instance_id.tolist() == [5, 6, 9, 10, 11, 12]
    assert scene.instance_paths == {"/Root/a": 0, "/Root/b": 9}


def test_ids_beyond_32_bits_are_refused(tmp_path):
    def build(stage):
        for name in "abc":
            instancer(stage, [1, 2, 2**31 - 1], f"/Root/{name}")

    with pytest.raises(StageError, match="/Root/c: instance ids do not fit into 32 bits"):
        opened(tmp_path, build)


def test_a_chosen_base_among_authored_ones_is_refused_where_ids_would_be_the_same(tmp_path):
    def build(stage):
        instancer(stage, [1, 2, 3], "/Root/a")
        instancer(stage, [1, 2, 3], "/Root/b", base=1)

    with pytest.raises(StageError, match=r"/Root/a: has no scenec:instanceIdBase, and /Root/b sta"):
        opened(tmp_path, build)


def test_a_chosen_base_below_an_authored_one_stays(tmp_path):
    def build(stage):
        instancer(stage, [1, 2, 3], "/Root/a")
        instancer(stage, [1, 2, 3], "/Root/b", base=3)

    assert opened(tmp_path, build).rows.instance_id.tolist() == [1, 2, 3, 4, 5, 6]


def test_labels_that_are_authored_at_time_codes_hold_as_at_the_first(tmp_path):
    def build(stage):
        prim = square(stage, "/Root/floor").GetPrim()
        label(prim, "floor")
        attribute = prim.GetAttribute("semantics:labels:class")
        attribute.Clear()
        attribute.Set(Vt.TokenArray(["dry"]), 0)
        attribute.Set(Vt.TokenArray(["wet"]), 1)

    scene = opened(tmp_path, build, samples=2)
    assert scene.label_names["class"] == {1: "dry"}
    assert scene.meshes[0].labels["class"].tolist() == [1, 1]
    assert any(line.startswith("labels that change stay") for line in scene.losses)


LIGHTS = ("DistantLight", "DomeLight", "DomeLight_1", "SphereLight")


def strength(lighting) -> float:
    """What lights give, summed."""
    suns = sum(sun.irradiance.sum() for sun in lighting.suns)
    lamps = sum(lamp.intensity.sum() for lamp in lighting.lamps)
    return float(suns + lamps + sum(dome.scale.sum() for dome in lighting.domes))


@pytest.mark.parametrize("kind", LIGHTS)
def test_a_light_of_intensity_0_or_less_gives_nothing(tmp_path, kind):
    for intensity in (0.0, -3.0):
        path = written(
            tmp_path,
            lambda stage, i=intensity: (
                stage.DefinePrim("/Root/it", kind).GetAttribute("inputs:intensity").Set(i) and None
            ),
        )
        scene = read_stage(path)
        assert strength(scene.lighting[0]) == 0.0
        words = "a light of negative strength gives none"
        assert [line.startswith(words) for line in scene.losses] == [True] * (intensity < 0.0)


@pytest.mark.parametrize("kind", LIGHTS)
@pytest.mark.parametrize("above", [False, True])
def test_a_light_shines_at_the_samples_at_which_it_is_visible(tmp_path, kind, above):
    def build(stage):
        group = UsdGeom.Xform.Define(stage, "/Root/group")
        prim = stage.DefinePrim("/Root/group/it", kind)
        attribute = UsdGeom.Imageable(group if above else prim).CreateVisibilityAttr()
        attribute.Set("invisible", 0)
        attribute.Set("inherited", 1)
        attribute.Set("invisible", 2)

    scene = opened(tmp_path, build, samples=3)
    assert [strength(lighting) > 0.0 for lighting in scene.lighting] == [False, True, False]


def test_the_color_of_a_light_is_usds_blackbody_times_its_exposure(tmp_path):
    def build(stage):
        sun = UsdLux.DistantLight.Define(stage, "/Root/it")
        sun.CreateNormalizeAttr(True)
        sun.CreateIntensityAttr(2.0)
        sun.CreateExposureAttr(3.0)
        sun.CreateColorAttr(Gf.Vec3f(0.5, 1.0, 1.0))
        sun.CreateEnableColorTemperatureAttr(True)
        sun.CreateColorTemperatureAttr(3200.0)

    (sun,) = opened(tmp_path, build).lighting[0].suns
    expected = 16.0 * np.array([0.5, 1, 1]) * UsdLux.BlackbodyTemperatureAsRgb(3200.0)
    np.testing.assert_allclose(sun.irradiance, expected, rtol=1e-6)


def test_a_cone_without_an_applied_schema_shapes_a_light(tmp_path):
    def build(stage):
        prim = UsdLux.SphereLight.Define(stage, "/Root/it").GetPrim()
        prim.CreateAttribute("inputs:shaping:cone:angle", TYPES.Float).Set(30.0)

    (lamp,) = opened(tmp_path, build).lighting[0].lamps
    assert lamp.cone == pytest.approx(np.pi / 6)


@pytest.mark.parametrize(
    ("name", "kind", "value"),
    [
        ("inputs:shaping:focus", TYPES.Float, 2.0),
        ("inputs:shaping:ies:file", TYPES.Asset, Sdf.AssetPath("lamp.ies")),
        ("inputs:shadow:color", TYPES.Color3f, Gf.Vec3f(1, 0, 0)),
        ("collection:lightLink:includeRoot", TYPES.Bool, False),
        ("collection:shadowLink:membershipExpression", TYPES.PathExpression, None),
    ],
)
def test_what_shapes_or_links_a_light_is_named(tmp_path, name, kind, value):
    def build(stage):
        prim = UsdLux.SphereLight.Define(stage, "/Root/it").GetPrim()
        prim.CreateAttribute(name, kind).Set(Sdf.PathExpression("//") if value is None else value)

    (line,) = opened(tmp_path, build).losses
    assert line.startswith(f"{name} of SphereLight is not followed")


def test_a_light_whose_color_comes_from_a_node_is_named(tmp_path):
    def build(stage):
        dome = UsdLux.DomeLight.Define(stage, "/Root/it")
        stage.DefinePrim("/Root/node", "Shader").CreateAttribute("outputs:out", TYPES.Color3f)
        dome.GetColorAttr().AddConnection("/Root/node.outputs:out")

    (line,) = opened(tmp_path, build).losses
    assert line.startswith("inputs:color of DomeLight from a node is not read")
