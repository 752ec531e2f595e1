"""Pictures that suns shine through: how they lie, where they are read, what else goes by them."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, UsdGeom, UsdLux

from scenec.backends.contract import Radiance
from scenec.backends.model.collect import coarse_model
from scenec.backends.picture.airlight import air_of
from scenec.backends.picture.compose import compose
from scenec.backends.picture.sky import load_picture
from scenec.backends.stage.scene import Gobo, Haze
from scenec.backends.surface.gobo import load_gobo, mean_passed, passed
from scenec.backends.surface.maps import load_map
from scenec.backends.testing import lights
from scenec.backends.testing.scenes import look_at, sun, with_lights
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.testing.foreign_stages import opened

TYPES = Sdf.ValueTypeNames
#: From the world's x and y as they are to the picture's: rows go down.
AS_IS = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.0]])


def picture(path, codes) -> Gobo:
    Image.fromarray(np.asarray(codes)).save(path)
    return Gobo(path, AS_IS)


def overhead(gobo: Gobo):
    return replace(sun(90.0), gobo=gobo)


def test_between_texel_centers_it_is_linear_and_beyond_the_borders_mirrored(tmp_path):
    """A ramp along x of 5 texels: 0.2 to 1 between their centers, even outside of these."""
    codes = np.tile(np.rint(65535.0 * np.arange(1, 6) / 5.0), (3, 1)).astype(np.uint16)
    one = overhead(picture(tmp_path / "a.png", codes))
    x = np.linspace(-3.0, 3.0, 241)
    places = np.stack([x, 0.37 * x, 5.0 * x], axis=1)
    saw = np.abs((x + 1.0) % 2.0 - 1.0)
    assert passed(one, places) == pytest.approx(np.clip(saw + 0.1, 0.2, 1.0), abs=2e-5)
    assert mean_passed(one) == pytest.approx(0.6, abs=1e-5)
    assert (passed(sun(90.0), places) == 1.0).all()


def test_the_first_row_is_the_uppermost_and_8_bits_will_do(tmp_path):
    one = overhead(picture(tmp_path / "a.png", np.array([[0, 51], [102, 255]], np.uint8)))
    places = np.array([[0.25, 0.75, 0], [0.75, 0.75, 9], [0.25, 0.25, 0], [0.75, 0.25, -4]])
    assert passed(one, places) == pytest.approx([0.0, 0.2, 0.4, 1.0], abs=1e-6)
    single = overhead(picture(tmp_path / "b.png", np.array([[51]], np.uint8)))
    assert passed(single, places) == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda path: None, "cannot read the light filter's picture"),
        (lambda path: path.write_bytes(b"no picture"), "cannot read the light filter's picture"),
        (lambda path: Image.new("RGB", (4, 4)).save(path), "has one channel of 8 or 16 bits"),
    ],
)
def test_what_is_no_such_picture_is_said_with_its_file(tmp_path, build, message):
    build(tmp_path / "a.png")
    with pytest.raises(StageError, match=rf"a\.png: .*{message}"):
        load_gobo(tmp_path / "a.png")


@pytest.mark.parametrize(
    "load", [load_gobo, load_picture, partial(load_map, kind="height")], ids=["gobo", "sky", "map"]
)
def test_a_picture_that_has_changed_is_read_again(tmp_path, load):
    path = tmp_path / "a.png"
    for code in (51, 204):
        Image.fromarray(np.full((2, 2), code, np.uint8)).save(path)
        os.utime(path, ns=(code, code))
        expected = ((code / 255 + 0.055) / 1.055) ** 2.4 if load is load_picture else code / 255
        assert load(path) == pytest.approx(expected)
        assert load(path) is load(path)


def filter_of(stage, light, file="./a.png", size=(4.0, 2.0)):
    made = UsdLux.LightFilter.Define(stage, light.GetPath().AppendChild("Clouds"))
    made.GetPrim().CreateAttribute(names.ATTR_GOBO_FILE, TYPES.Asset).Set(Sdf.AssetPath(file))
    made.GetPrim().CreateAttribute(names.ATTR_GOBO_SIZE, TYPES.Double2).Set(Gf.Vec2d(*size))
    UsdLux.LightAPI(light).CreateFiltersRel().SetTargets([made.GetPath()])
    return made


def test_a_filter_lies_where_its_prim_does_in_any_units_and_with_any_axis_up(tmp_path):
    """A stage in centimeters, Y up, of a sun above, turned a quarter about the vertical."""
    picture(tmp_path / "a.png", np.array([[0, 51], [102, 255]], np.uint8))

    def build(stage):
        UsdGeom.SetStageMetersPerUnit(stage, 0.01)
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        light = UsdLux.DistantLight.Define(stage, "/Root/sun")
        # Its Z to the stage's Y; then its X along the stage's -Z, which is the world's +Y.
        light.AddRotateYOp().Set(90.0)
        light.AddRotateXOp().Set(-90.0)
        light.CreateIntensityAttr(2.0)
        light.CreateNormalizeAttr(True)
        made = filter_of(stage, light, size=(400.0, 200.0))
        made.AddTranslateOp().Set(Gf.Vec3d(100.0, 0.0, 0.0))

    scene = opened(tmp_path, build)
    assert scene.losses == ()
    (one,) = scene.lighting[0].suns
    assert one.to_light == pytest.approx([0.0, 0.0, 1.0])
    # The picture's right is the world's +y, its top the world's -x; its middle is 1 m along y.
    upper, right = np.array([-0.5, 0.0, 7.0]), np.array([0.0, 1.0, 0.0])
    middle = np.array([0.0, 1.0, 0.0])
    places = [middle + upper - right, middle + upper + right]
    places += [middle - upper - right, middle - upper + right]
    assert passed(one, np.array(places)) == pytest.approx([0.0, 0.2, 0.4, 1.0], abs=1e-6)


def test_an_empty_path_is_no_gobo_and_samples_have_their_own(tmp_path):
    picture(tmp_path / "a.png", np.array([[51]], np.uint8))

    def build(stage):
        made = filter_of(stage, UsdLux.DistantLight.Define(stage, "/Root/sun"), "")
        file = made.GetPrim().GetAttribute(names.ATTR_GOBO_FILE)
        for time, name in enumerate(("", "./a.png")):
            file.Set(Sdf.AssetPath(name), time)

    scene = opened(tmp_path, build, samples=2)
    assert scene.losses == ()
    gobos = [lighting.suns[0].gobo for lighting in scene.lighting]
    assert gobos[0] is None
    assert gobos[1] is not None
    assert gobos[1].file.name == "a.png"


def two_filters(stage):
    light = UsdLux.DistantLight.Define(stage, "/Root/it")
    made = filter_of(stage, light)
    UsdLux.LightFilter.Define(stage, "/Root/other").GetPrim()
    light.CreateFiltersRel().SetTargets([made.GetPath(), "/Root/other"])


def of_a_lamp(stage):
    filter_of(stage, UsdLux.SphereLight.Define(stage, "/Root/it"))


@pytest.mark.parametrize(
    ("build", "lines"),
    [
        (
            two_filters,
            (
                "light:filters of DistantLight is not followed: 1 prim, /Root/it",
                "LightFilter is not read: 1 prim, /Root/other",
            ),
        ),
        (of_a_lamp, ("light:filters of SphereLight is not followed: 1 prim, /Root/it",)),
    ],
)
def test_other_filters_are_a_loss(tmp_path, build, lines):
    assert opened(tmp_path, build).losses == lines


@pytest.mark.parametrize("size", [(0.0, 1.0), (2.0, -1.0), (float("nan"), 1.0)])
def test_a_size_that_cannot_be_is_an_error(tmp_path, size):
    picture(tmp_path / "a.png", np.array([[51]], np.uint8))

    def build(stage):
        filter_of(stage, UsdLux.DistantLight.Define(stage, "/Root/sun"), size=size)

    with pytest.raises(StageError, match=r"/Root/sun/Clouds.*scenec:gobo:size"):
        opened(tmp_path, build)


def test_a_suns_disc_is_as_bright_as_comes_through_to_the_camera(tmp_path):
    one = overhead(picture(tmp_path / "a.png", np.array([[0, 51], [102, 255]], np.uint8)))
    discs = []
    for around in (one, replace(one, gobo=None)):
        made = with_lights(lights.plane_scene(), [around])
        camera = look_at((0.75, 0.75, 5.0), (0.75, 0.7501, 15.0), 8, 8, 2.0)
        made = replace(made, cameras=((camera,),) * made.samples)
        empty = Radiance(np.zeros((2, 8, 8, 3), np.float32), np.zeros((8, 8), np.float32), 2)
        discs.append(compose(empty, made, camera, 0).rgb)
    assert discs[1].max() > 0.0
    assert discs[0] == pytest.approx(0.2 * discs[1], rel=1e-6)


def test_haze_and_models_have_the_mean(tmp_path):
    one = overhead(picture(tmp_path / "a.png", np.array([[0, 51], [102, 255]], np.uint8)))
    haze = Haze(np.full(3, 1e-3))
    shaded = air_of(haze, (one,), None, 0.0)
    even = air_of(haze, (replace(one, gobo=None, irradiance=0.4 * one.irradiance),), None, 0.0)
    assert shaded.medium.beam == pytest.approx(even.medium.beam)
    model = coarse_model(
        with_lights(lights.plane_scene(), [one]), "a", ground_faces=99, object_faces=9, instances=9
    )
    assert model.suns[0][0][1] == pytest.approx(0.4 * one.irradiance)
