"""What a stage asks to be rendered: apertures and pictures of another shape, settings, windows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pxr import Gf, Sdf, UsdGeom, UsdRender

from scenec.backends.check.scene import check_scene
from scenec.backends.run.render import render
from scenec.backends.stage.products import POLICIES
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.exr import read_exr
from scenec.testing.foreign_stages import opened, square, written

FOCAL = 24.0
SIZE = (1280, 720)


def looking(stage, across=20.955, up=15.2908):
    camera = UsdGeom.Camera.Define(stage, "/Root/eye")
    camera.AddTranslateOp().Set((0, 0, 9))
    camera.CreateFocalLengthAttr(FOCAL)
    camera.CreateHorizontalApertureAttr(across)
    camera.CreateVerticalApertureAttr(up)
    return camera


def product(stage, camera="/Root/eye", size=SIZE, **values):
    made = UsdRender.Product.Define(stage, "/Render/product")
    made.CreateCameraRel().AddTarget(camera)
    if size is not None:
        made.CreateResolutionAttr(Gf.Vec2i(*size))
    for name, value in values.items():
        made.GetPrim().GetAttribute(name).Set(value)
    return made


@pytest.mark.parametrize("aspect", [1.0, 2.0, 0.8])
@pytest.mark.parametrize("aperture", [(20.955, 15.2908), (36.0, 12.0), (5.0, 30.0)])
@pytest.mark.parametrize("policy", POLICIES)
def test_apertures_are_conformed_as_the_schema_says(tmp_path, policy, aperture, aspect):
    """By what the picture shows: its sides over the focal length, in units of the aperture.

    The sentences of ``aspectRatioConformPolicy``'s documentation (pxr/usd/usdRender/schema.usda).
    """

    def build(stage):
        looking(stage, *aperture)
        product(stage, aspectRatioConformPolicy=policy, pixelAspectRatio=aspect)

    ((camera,),) = opened(tmp_path, build).cameras
    k = camera.intrinsics
    shown = np.array([SIZE[0] * FOCAL / k[0, 0], SIZE[1] * FOCAL / k[1, 1]])
    ratio = shown / aperture
    if policy == "adjustPixelAspectRatio":
        np.testing.assert_allclose(ratio, 1.0, rtol=1e-6)
        return
    # A pixel is so much wider than it is high.
    np.testing.assert_allclose(k[1, 1] / k[0, 0], aspect, rtol=1e-6)
    if policy == "adjustApertureWidth":
        np.testing.assert_allclose(ratio[1], 1.0, rtol=1e-6)
    elif policy == "adjustApertureHeight":
        np.testing.assert_allclose(ratio[0], 1.0, rtol=1e-6)
    elif policy == "expandAperture":
        np.testing.assert_allclose(ratio.min(), 1.0, rtol=1e-6)
    else:
        np.testing.assert_allclose(ratio.max(), 1.0, rtol=1e-6)
    np.testing.assert_array_equal(k[:2, 2], (640, 360))


def test_the_default_is_to_expand_the_aperture(tmp_path):
    def build(stage):
        looking(stage)
        product(stage)

    ((camera,),) = opened(tmp_path, build).cameras
    # The aperture is the higher one: 720 pixels show all of it.
    expected = 720 * FOCAL / 15.2908
    np.testing.assert_allclose(np.diag(camera.intrinsics)[:2], expected, rtol=1e-6)


def test_offsets_of_an_aperture_are_of_the_length_that_they_were(tmp_path):
    def build(stage):
        camera = looking(stage)
        camera.CreateHorizontalApertureOffsetAttr(2.0)
        camera.CreateVerticalApertureOffsetAttr(1.0)
        product(stage)

    ((camera,),) = opened(tmp_path, build).cameras
    k = camera.intrinsics
    # A pixel is 15.2908 / 720 units.
    expected = (640 - 2.0 * 720 / 15.2908, 360 + 1.0 * 720 / 15.2908)
    np.testing.assert_allclose(k[:2, 2], expected, rtol=1e-6)


@pytest.mark.parametrize("policy", POLICIES)
def test_a_camera_of_the_schema_keeps_the_intrinsics_that_it_states(tmp_path, policy):
    stated = [700.5, 0.25, 600.125, 0.0, 900.75, 333.5, 0.0, 0.0, 1.0]

    def build(stage):
        prim = looking(stage).GetPrim()
        prim.CreateAttribute(names.ATTR_INTRINSICS, Sdf.ValueTypeNames.DoubleArray).Set(stated)
        product(stage, aspectRatioConformPolicy=policy, pixelAspectRatio=2.0)

    ((camera,),) = opened(tmp_path, build).cameras
    assert camera.intrinsics.ravel().tolist() == stated


def test_a_product_inherits_from_the_settings_that_list_it(tmp_path):
    def build(stage):
        looking(stage)
        made = product(stage, size=None, pixelAspectRatio=1.0)
        made.GetCameraRel().ClearTargets(True)
        for name, size in (("other", (11, 12)), ("own", (90, 60))):
            settings = UsdRender.Settings.Define(stage, f"/Render/{name}")
            settings.CreateProductsRel().AddTarget(made.GetPath())
            settings.CreateCameraRel().AddTarget("/Root/eye")
            settings.CreateResolutionAttr(Gf.Vec2i(*size))
            settings.CreateAspectRatioConformPolicyAttr("cropAperture")
            settings.CreatePixelAspectRatioAttr(2.0)
        stage.SetMetadata("renderSettingsPrimPath", "/Render/own")

    scene = opened(tmp_path, build)
    ((camera,),) = scene.cameras
    assert (camera.width, camera.height) == (90, 60)
    assert camera.path == "/Root/eye"
    # Cropped: the picture is wider than the aperture. The product's own pixels are square.
    np.testing.assert_allclose(np.diag(camera.intrinsics)[:2], 90 * FOCAL / 20.955, rtol=1e-6)
    (line,) = scene.losses
    assert line.startswith("RenderSettings are not followed of products that others list")
    assert line.endswith("/Render/other")


def test_settings_in_an_instance_are_told_to_be_of_no_effect(tmp_path):
    def build(stage):
        looking(stage)
        stage.CreateClassPrim("/_asset")
        settings = UsdRender.Settings.Define(stage, "/_asset/settings")
        settings.CreateProductsRel().AddTarget("/_asset/product")
        UsdRender.Product.Define(stage, "/_asset/product").CreateCameraRel().AddTarget("/Root/eye")
        copy = stage.DefinePrim("/Root/copy", "Xform")
        copy.GetReferences().AddInternalReference("/_asset")
        copy.SetInstanceable(True)

    (line,) = opened(tmp_path, build).losses
    assert line.startswith("RenderSettings are not followed of products")


def test_without_products_the_settings_say_what_is_rendered(tmp_path):
    def build(stage):
        looking(stage)
        UsdGeom.Camera.Define(stage, "/Root/another")
        settings = UsdRender.Settings.Define(stage, "/Render/settings")
        settings.CreateCameraRel().AddTarget("/Root/eye")
        settings.CreateResolutionAttr(Gf.Vec2i(100, 80))

    ((camera,),) = opened(tmp_path, build).cameras
    assert (camera.name, camera.width, camera.height) == ("eye", 100, 80)


@pytest.mark.usefixtures("workers_here")
@pytest.mark.parametrize(
    ("window", "columns", "rows"),
    [
        ((0.25, 0.5, 0.75, 1.0), slice(8, 24), slice(0, 8)),
        ((0.0, 0.0, 0.5, 0.5), slice(0, 16), slice(8, 16)),
        # Borders on centers of pixels: the left and the lower one are in.
        ((1.5 / 32, 1.5 / 16, 30.5 / 32, 14.5 / 16), slice(1, 30), slice(2, 15)),
    ],
)
def test_a_data_window_is_a_part_of_the_picture(tmp_path, window, columns, rows):
    pictures = []
    for name, values in (("whole", {}), ("part", {"dataWindowNDC": Gf.Vec4f(*window)})):

        def build(stage, values=values):
            looking(stage)
            square(stage, "/Root/floor").AddRotateXYZOp().Set((20, 30, 10))
            product(stage, size=(32, 16), **values)

        folder = tmp_path / name
        folder.mkdir()
        render(written(folder, build), "reference", passes=["depth"], folder=folder)
        pictures.append(read_exr(folder / "frames/annotation/product/000000.exr")["depth"])
    whole, part = pictures
    assert np.isfinite(whole).any()
    np.testing.assert_allclose(part, whole[rows, columns], rtol=1e-12)


def test_a_data_window_may_reach_beyond_the_picture(tmp_path):
    def build(stage):
        looking(stage)
        product(stage, size=(40, 30), dataWindowNDC=Gf.Vec4f(-0.25, -0.5, 1.25, 1.5))

    ((camera,),) = opened(tmp_path, build).cameras
    assert (camera.width, camera.height) == (60, 60)
    assert camera.intrinsics[:2, 2].tolist() == [30.0, 30.0]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"dataWindowNDC": Gf.Vec4f(0.5, 0, 0.5, 1)}, "dataWindowNDC.*at least one"),
        ({"dataWindowNDC": Gf.Vec4f(0, 0, 1e9, 1e9)}, "dataWindowNDC.*at most"),
        ({"dataWindowNDC": Gf.Vec4f(0, 0, math.nan, 1)}, "dataWindowNDC.*finite"),
        ({"pixelAspectRatio": 0.0}, "pixelAspectRatio: is 0, expected a number above 0"),
        ({"aspectRatioConformPolicy": "expandApertur"}, "expandApertur.*expandAperture"),
        ({"resolution": Gf.Vec2i(0, 5)}, "/Render/product: a camera needs a resolution"),
    ],
)
def test_what_no_picture_can_have_is_refused_by_name(tmp_path, values, words):
    def build(stage):
        looking(stage)
        product(stage, **values)

    with pytest.raises(StageError, match=words):
        opened(tmp_path, build)


def test_a_window_of_a_rolling_shutters_picture_is_refused(tmp_path):
    def build(stage):
        prim = looking(stage).GetPrim()
        prim.CreateAttribute(names.ATTR_SHUTTER_EXPOSURE, Sdf.ValueTypeNames.Double).Set(0.01)
        product(stage, dataWindowNDC=Gf.Vec4f(0, 0, 0.5, 1))

    with pytest.raises(StageError, match=r"/Root/eye: has scenec:shutter:exposure.*dataWindowNDC"):
        opened(tmp_path, build)


def test_orthographic_cameras_are_left_out_and_named_unless_they_are_asked_for(tmp_path):
    def build(stage):
        looking(stage)
        UsdGeom.Camera.Define(stage, "/Root/top").CreateProjectionAttr("orthographic")

    scene = opened(tmp_path, build)
    assert [camera.path for camera in scene.cameras[0]] == ["/Root/eye"]
    assert scene.losses == ("an orthographic camera is not rendered: 1 prim, /Root/top",)

    def asked(stage):
        build(stage)
        product(stage, "/Root/top")

    with pytest.raises(StageError, match="/Root/top: is orthographic"):
        opened(tmp_path, asked)


LENSES = {
    "kit": ("cameraProjectionType", Sdf.ValueTypeNames.Token, "fisheyeOfTomorrow"),
    "sensor": ("omni:lensdistortion:model", Sdf.ValueTypeNames.Token, "ofTomorrow"),
    "older": ("physicalDistortionModel", Sdf.ValueTypeNames.String, "kannalaBrandt"),
    "karma": ("karma:camera:use_lensshader", Sdf.ValueTypeNames.Bool, True),
}


@pytest.mark.parametrize("name", LENSES)
def test_a_lens_of_another_renderer_is_a_loss_and_a_finding(tmp_path, name):
    attribute, kind, value = LENSES[name]

    def build(stage):
        looking(stage).GetPrim().CreateAttribute(attribute, kind).Set(value)

    scene = opened(tmp_path, build)
    (line,) = scene.losses
    assert line.startswith(attribute)
    assert "a pinhole is drawn: 1 prim, /Root/eye" in line
    assert [(f.check, f.severity, f.message) for f in check_scene(scene)] == [
        ("unread", "warning", line)
    ]


def test_a_pinhole_that_another_renderer_names_is_none(tmp_path):
    def build(stage):
        prim = looking(stage).GetPrim()
        prim.CreateAttribute("cameraProjectionType", Sdf.ValueTypeNames.Token).Set("pinhole")
        prim.CreateAttribute("fthetaWidth", Sdf.ValueTypeNames.Float).Set(1280.0)
        prim.CreateAttribute("karma:camera:use_lensshader", Sdf.ValueTypeNames.Bool).Set(False)

    assert opened(tmp_path, build).losses == ()


def test_a_camera_that_is_not_rendered_costs_no_loss(tmp_path):
    def build(stage):
        looking(stage)
        other = UsdGeom.Camera.Define(stage, "/Root/other").GetPrim()
        other.CreateAttribute("cameraProjectionType", Sdf.ValueTypeNames.Token).Set("fisheye")
        product(stage)

    assert opened(tmp_path, build).losses == ()


def test_products_of_one_name_make_pictures_of_two(tmp_path):
    def build(stage):
        looking(stage)
        for folder in "ab":
            made = UsdRender.Product.Define(stage, f"/Render/{folder}/product")
            made.CreateCameraRel().AddTarget("/Root/eye")

    (cameras,) = opened(tmp_path, build).cameras
    assert [camera.name for camera in cameras] == ["Render_a_product", "Render_b_product"]


def test_a_camera_in_a_prototype_is_at_no_place_and_named(tmp_path):
    def build(stage):
        looking(stage)
        many = UsdGeom.PointInstancer.Define(stage, "/Root/many")
        UsdGeom.Camera.Define(stage, "/Root/many/it")
        many.CreatePrototypesRel().SetTargets(["/Root/many/it"])
        many.CreatePositionsAttr([(0, 0, 0)])
        many.CreateProtoIndicesAttr([0])

    scene = opened(tmp_path, build)
    assert [camera.path for camera in scene.cameras[0]] == ["/Root/eye"]
    (line,) = scene.losses
    assert line.startswith("a camera in the prototype of an instancer is not rendered")
