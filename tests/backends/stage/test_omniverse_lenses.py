"""Calibrated cameras of Omniverse, held against OpenCV and against their own polynomials."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from pxr import Gf, Sdf, UsdGeom, UsdRender

from scenec.backends.camera.rays import camera_rays
from scenec.backends.stage.omniverse import TOLERANCE_PX
from scenec.schemas.errors import StageError
from scenec.schemas.lens import pixels_at
from scenec.testing.foreign_stages import opened, square

SIZE = (96, 64)
OMNI = "omni:lensdistortion:"
#: Of OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6.
RATIONAL = (-0.11, 0.02, 0.0011, -0.0007, -0.002, 0.02, 0.01, -0.004)
FISHEYE = (-0.012, 0.004, -0.0013, 0.0002)
TYPES = {int: Sdf.ValueTypeNames.Int, float: Sdf.ValueTypeNames.Float,
         str: Sdf.ValueTypeNames.Token}  # fmt: skip


def camera_with(numbers, size=SIZE, schema="", window=None):
    def build(stage):
        square(stage, "/Root/square")
        camera = UsdGeom.Camera.Define(stage, "/Root/eye")
        camera.AddTranslateOp().Set((0, 0, 2))
        if schema:
            camera.GetPrim().AddAppliedSchema(schema)
        for name, value in numbers.items():
            two = Sdf.ValueTypeNames.Int2 if "Size" in name else Sdf.ValueTypeNames.Float2
            kind = TYPES.get(type(value), two)
            made = value if kind != two else (Gf.Vec2i if "Size" in name else Gf.Vec2f)(*value)
            camera.GetPrim().CreateAttribute(name, kind).Set(made)
        made = UsdRender.Product.Define(stage, "/Render/product")
        made.CreateCameraRel().AddTarget("/Root/eye")
        made.CreateResolutionAttr(Gf.Vec2i(*size))
        if window is not None:
            made.CreateDataWindowNDCAttr(Gf.Vec4f(*window))

    return build


def polynomial(coefficients, fov=180.0, **others):
    letters = dict(zip("ABCDEF", map(float, coefficients), strict=False))
    return {
        "cameraProjectionType": "fisheyePolynomial",
        **{"fthetaWidth": 96.0, "fthetaHeight": 64.0, "fthetaCx": 47.5, "fthetaCy": 33.0},
        "fthetaMaxFov": fov,
        **{f"fthetaPoly{letter}": value for letter, value in letters.items()},
        **others,
    }


def older(model, coefficients):
    return polynomial((), cameraProjectionType=model, openCVFx=52.0, openCVFy=49.0) | coefficients


def newer(model, coefficients):
    named = {"imageSize": (96, 64), "cx": 47.5, "cy": 33.0, "fx": 52.0, "fy": 49.0, **coefficients}
    return {f"{OMNI}model": model, **{f"{OMNI}{model}:{k}": v for k, v in named.items()}}


PINHOLES = {
    "older": older("pinholeOpenCV", dict(zip(
        ("fthetaPolyA", "fthetaPolyB", "p0", "p1", *(f"fthetaPoly{c}" for c in "CDEF")),
        RATIONAL, strict=True))),
    "newer": newer("opencvPinhole", dict(zip(
        ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), RATIONAL, strict=True))),
}  # fmt: skip
FISHEYES = {
    "older": older("fisheyeOpenCV", {f"fthetaPoly{c}": k for c, k in zip("ABCD", FISHEYE,
                                                                       strict=True)}),
    "newer": newer("opencvFisheye", {f"k{i}": k for i, k in enumerate(FISHEYE, start=1)}),
}  # fmt: skip


def points(widest_deg, count=500):
    """Points in all directions up to an angle to the axis, float64 [n, 3]."""
    rng = np.random.default_rng(5)
    angle = np.radians(widest_deg) * np.sqrt(rng.random(count))
    turn = 2.0 * np.pi * rng.random(count)
    level = np.sin(angle)
    away = 1.0 + 9.0 * rng.random((count, 1))
    return away * np.stack([level * np.cos(turn), level * np.sin(turn), np.cos(angle)], axis=1)


@pytest.mark.parametrize("scale", [1, 2])
@pytest.mark.parametrize("fisheye", [False, True])
@pytest.mark.parametrize("generation", ["older", "newer"])
def test_opencv_s_cameras_show_points_where_opencv_does(tmp_path, generation, fisheye, scale):
    """A picture of twice the calibrated size shows them twice as far from its corner."""
    cases = FISHEYES if fisheye else PINHOLES
    size = (SIZE[0] * scale, SIZE[1] * scale)
    scene = opened(tmp_path, camera_with(cases[generation], size))
    assert scene.losses == ()
    camera = scene.cameras[0][0]
    space = points(80 if fisheye else 40)
    k = np.array([[52.0, 0.0, 47.5], [0.0, 49.0, 33.0], [0.0, 0.0, 1.0]])
    none = np.zeros(3)
    given = np.float32(FISHEYE if fisheye else RATIONAL).astype(np.float64)
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    order = (space[:, None], none, none, k, given)
    expected = project(*order)[0].reshape(-1, 2)
    found = pixels_at(camera.lens, camera.intrinsics, space)
    np.testing.assert_allclose(found, scale * expected, atol=2e-5 * scale)


def test_a_window_of_a_calibrated_picture_shows_points_so_much_nearer_to_its_corner(tmp_path):
    build = camera_with(FISHEYES["older"], window=(0.25, 0.5, 1.0, 1.0))
    camera = opened(tmp_path, build).cameras[0][0]
    assert (camera.width, camera.height) == (72, 32)
    np.testing.assert_allclose(camera.intrinsics[:2, 2], (47.5 - 24.0, 33.0))


POLYNOMIALS = {
    "equidistant": ((0.0, 0.02), 1e-9),
    "slower": ((0.0, 0.021, 0.0, -5e-7), 0.02),
    "even terms": ((0.0, 0.02, 2e-5, -2e-6, 1e-8), 0.2),
    "off the axis": ((1e-4, 0.02), 0.02),
}


@pytest.mark.parametrize("generation", ["older", "newer"])
@pytest.mark.parametrize("name", POLYNOMIALS)
def test_a_polynomial_s_error_is_stated_over_all_pixels(tmp_path, generation, name):
    """By OpenCV's fisheye, of the rays that the polynomial itself gives to pixels' centers."""
    coefficients, most = POLYNOMIALS[name]
    numbers = polynomial(coefficients)
    if generation == "newer":
        named = {"nominalWidth": 96.0, "nominalHeight": 64.0, "opticalCenter": (47.5, 33.0),
                 "maxFov": 180.0, **{f"k{i}": k for i, k in enumerate(coefficients)}}  # fmt: skip
        numbers = {f"{OMNI}model": "ftheta", **{f"{OMNI}ftheta:{k}": v for k, v in named.items()}}
    scene = opened(tmp_path, camera_with(numbers))
    (line,) = scene.losses
    stated = float(line.split("off by up to ")[1].split()[0])
    camera = scene.cameras[0][0]
    u, v = np.meshgrid(np.arange(96) + 0.5, np.arange(64) + 0.5)
    x, y = u.ravel() - 47.5, v.ravel() - 33.0
    r = np.hypot(x, y)
    angle = np.polyval(np.float32(coefficients)[::-1].astype(np.float64), r)
    seen = angle < 0.5 * math.pi
    share = np.sin(angle) / r
    rays = np.stack([x * share, y * share, np.cos(angle)], axis=1)[seen]
    k = camera.intrinsics
    found, _ = cv2.fisheye.projectPoints(
        rays[:, None], np.zeros(3), np.zeros(3), k, np.array(camera.lens.coefficients)
    )
    error = np.hypot(*(found[:, 0] - np.stack([u.ravel(), v.ravel()], axis=1)[seen]).T).max()
    assert error <= stated * 1.06 + 1e-6
    assert stated <= 1.5 * error + 1e-6
    assert stated <= most


def test_beyond_the_largest_field_of_view_there_are_no_rays(tmp_path):
    camera = opened(tmp_path, camera_with(polynomial((0.0, 0.02), fov=60.0))).cameras[0][0]
    known = camera_rays(camera).known
    u, v = np.meshgrid(np.arange(96) + 0.5, np.arange(64) + 0.5)
    r = np.hypot(u - 47.5, v - 33.0)
    np.testing.assert_array_equal(known.reshape(64, 96), 0.02 * r <= math.radians(30.0))


THIN = newer("opencvPinhole", {"s1": 1e-3})
REFUSED = {
    "orthographic": ({"cameraProjectionType": "fisheyeOrthographic"}, r"radii of sin\(t\)"),
    "spherical": ({"cameraProjectionType": "fisheyeSpherical"}, "angles per pixel"),
    "stereo": ({"cameraProjectionType": "omniDirectionalStereo"}, "more than one eye"),
    "k3": ({f"{OMNI}model": "kannalaBrandtK3"}, "opencvFisheye has the same terms"),
    "prism": (newer("opencvPinhole", {"s1": 0.5}), r"thin prism.*move pixels by up to"),
    "wide pinhole": (polynomial((0.0, 0.05, -6e-4), fov=360.0), "do not grow with the distance"),
    "kink": (polynomial((0.0, 0.015, 2e-4)), r"off by up to .* pixels, at most 0\.5 are taken"),
    "flat": (polynomial((0.0, 0.0)), "do not grow with the distance"),
    "far": (polynomial((0.0, 0.01), fthetaCx=1e9), r"1e\+09 pixels from the optical center"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_lens_that_none_is_like_is_refused_by_name(tmp_path, name):
    numbers, why = REFUSED[name]
    with pytest.raises(StageError, match=f"/Root/eye: .*no lens here is like it: .*{why}"):
        opened(tmp_path, camera_with(numbers))


UNSOUND = {
    "missing": ({"cameraProjectionType": "pinholeOpenCV"}, "fthetaWidth is not authored, expected"),
    "flat": (polynomial((0.0, 0.02), fthetaHeight=0.0), "fthetaHeight: is 0, expected a number"),
    "no view": (polynomial((0.0, 0.02), fov=0.0), "fthetaMaxFov: is 0, expected a number above 0"),
    "a word": (polynomial((0.0, 0.02), fthetaCx="left"), "fthetaCx: .*expected a finite number"),
}


@pytest.mark.parametrize("name", UNSOUND)
def test_a_missing_or_impossible_number_is_named(tmp_path, name):
    numbers, why = UNSOUND[name]
    with pytest.raises(StageError, match=why):
        opened(tmp_path, camera_with(numbers))


def test_small_thin_prism_terms_are_left_out_with_their_error(tmp_path):
    """s1 moves a pixel by fx s1 r^2, r the tangent of its ray: most at the farthest corner."""
    scene = opened(tmp_path, camera_with(THIN))
    (line,) = scene.losses
    x, y = (0.5 - 47.5) / 52.0, (0.5 - 33.0) / 49.0
    far = max(x * x, (95.5 - 47.5) ** 2 / 52.0**2) + max(y * y, (63.5 - 33.0) ** 2 / 49.0**2)
    stated = float(line.split("off by up to ")[1].split(":")[0])
    assert stated == pytest.approx(52.0 * 1e-3 * far, rel=0.06)
    assert stated < TOLERANCE_PX
    assert scene.cameras[0][0].lens is None


def test_a_schema_without_values_has_its_fallbacks(tmp_path):
    schema = "OmniLensDistortionFthetaAPI"
    camera = opened(tmp_path, camera_with({}, (1936, 1216), schema)).cameras[0][0]
    np.testing.assert_allclose(np.diag(camera.intrinsics), (1 / 0.00245, 1 / 0.00245, 1), rtol=1e-9)
    np.testing.assert_allclose(camera.intrinsics[:2, 2], (970.9424, 600.3748))
    assert camera.lens.max_angle == pytest.approx(math.radians(100.0))


def test_depth_of_field_of_a_calibrated_lens_is_a_loss(tmp_path):
    numbers = FISHEYES["older"] | {"fStop": 2.8, "focusDistance": 3.0}
    scene = opened(tmp_path, camera_with(numbers))
    assert scene.cameras[0][0].focus is None
    assert scene.losses == (
        "depth of field of a camera with a lens is not drawn: 1 prim, /Root/eye",
    )


def test_settings_of_omniverse_s_renderer_are_a_loss(tmp_path):
    scene = opened(tmp_path, camera_with({"omni:rtx:autoExposure:filterMode": "median"}))
    assert scene.losses == (
        "a camera's settings of Omniverse's renderer are not followed: 1 prim, /Root/eye",
    )
