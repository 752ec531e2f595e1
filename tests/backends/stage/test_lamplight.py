"""Lamps are read from any stage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdLux

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.schemas.errors import StageError


def opened(folder: Path, build: Any) -> RenderScene:
    path = folder / "stage.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    build(stage)
    stage.GetRootLayer().Save()
    return read_stage(path)


def sphere_light(stage: Usd.Stage, name: str, **inputs: Any) -> UsdLux.SphereLight:
    light = UsdLux.SphereLight.Define(stage, f"/{name}")
    for key, value in inputs.items():
        light.GetPrim().GetAttribute(f"inputs:{key}").Set(value)
    return light


def test_a_sphere_light_without_shaping_shines_everywhere(tmp_path):
    # Radiance 2 * 3 of a sphere of radius 0.5: intensity pi r^2 times that.
    made = opened(
        tmp_path,
        lambda stage: sphere_light(
            stage, "a", intensity=3.0, exposure=1.0, color=Gf.Vec3f(1, 0.5, 0)
        ),
    )
    (lamp,) = made.lighting[0].lamps
    np.testing.assert_allclose(lamp.intensity, np.pi * 0.25 * 6.0 * np.array([1, 0.5, 0]))
    assert (lamp.radius_m, lamp.cone, lamp.softness) == (0.5, np.pi, 0.0)


def test_a_sphere_light_is_scaled_and_turned_by_its_transform(tmp_path):
    def build(stage: Usd.Stage) -> None:
        UsdGeom.SetStageMetersPerUnit(stage, 0.01)
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        for name, normalize in (("a", False), ("b", True)):
            light = sphere_light(stage, name, intensity=8.0, radius=5.0, normalize=normalize)
            light.AddTranslateOp().Set((100.0, 200.0, 300.0))
            light.AddScaleOp().Set((2.0, 2.0, 2.0))
            shaping = UsdLux.ShapingAPI.Apply(light.GetPrim())
            shaping.CreateShapingConeAngleAttr(20.0)
            shaping.CreateShapingConeSoftnessAttr(1.5)

    plain, normalized = opened(tmp_path, build).lighting[0].lamps
    # y up to z up: y becomes z, z becomes -y.
    np.testing.assert_allclose(plain.position, [1.0, -3.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(plain.axis, [0.0, 1.0, 0.0], atol=1e-12)
    assert plain.radius_m == pytest.approx(0.1)
    np.testing.assert_allclose(plain.intensity, np.pi * 0.01 * 8.0)
    # Over its surface in stage units, 4 pi 10^2: the same radiance shows pi (0.1 m)^2.
    np.testing.assert_allclose(normalized.intensity, 8.0 / (4 * np.pi * 100) * np.pi * 0.01)
    assert plain.cone == pytest.approx(np.radians(20.0))
    assert plain.softness == 1.0


def test_a_sphere_light_treated_as_a_point_keeps_its_power(tmp_path):
    def build(stage: Usd.Stage) -> None:
        sphere_light(stage, "a", intensity=3.0).CreateTreatAsPointAttr(True)

    (lamp,) = opened(tmp_path, build).lighting[0].lamps
    np.testing.assert_allclose(lamp.intensity, np.pi * 0.25 * 3.0)
    assert lamp.radius_m == 0.0


def test_a_color_temperature_tints_a_sphere_light(tmp_path):
    def build(stage: Usd.Stage) -> None:
        sphere_light(stage, "a", enableColorTemperature=True, colorTemperature=3000.0)

    (lamp,) = opened(tmp_path, build).lighting[0].lamps
    tint = np.array(UsdLux.BlackbodyTemperatureAsRgb(3000.0))
    np.testing.assert_allclose(lamp.intensity / lamp.intensity[0], tint / tint[0], rtol=1e-6)
    assert lamp.intensity[0] > lamp.intensity[2]


def test_sphere_lights_that_give_nothing_are_passed_over(tmp_path):
    def build(stage: Usd.Stage) -> None:
        sphere_light(stage, "dark", intensity=0.0)
        sphere_light(stage, "negative", intensity=-1.0)
        sphere_light(stage, "small", radius=0.0)
        sphere_light(stage, "flat").AddScaleOp().Set((0.0, 0.0, 0.0))
        narrow = sphere_light(stage, "narrow")
        UsdLux.ShapingAPI.Apply(narrow.GetPrim()).CreateShapingConeAngleAttr(0.0)
        aimless = sphere_light(stage, "aimless", normalize=True)
        aimless.AddScaleOp().Set((0.0, 0.0, 0.0))
        UsdLux.ShapingAPI.Apply(aimless.GetPrim())
        sphere_light(stage, "hidden").MakeInvisible()
        UsdLux.DistantLight.Define(stage, "/sun").AddScaleOp().Set((0.0, 0.0, 0.0))
        # Normalized, it shines however small it is.
        sphere_light(stage, "shown", normalize=True, intensity=4.0, radius=0.0)

    lighting = opened(tmp_path, build).lighting[0]
    assert lighting.suns == ()
    (lamp,) = lighting.lamps
    np.testing.assert_allclose(lamp.intensity, 1.0)
    assert lamp.radius_m == 0.0


@pytest.mark.parametrize(
    "inputs",
    [{"exposure": 2000.0}, {"intensity": np.nan}, {"intensity": np.inf}, {"radius": np.inf}],
)
def test_a_light_whose_strength_is_not_finite_is_named(tmp_path, inputs):
    with pytest.raises(StageError, match=r"/a(: a light whose|\.inputs:).* finite"):
        opened(tmp_path, lambda stage: sphere_light(stage, "a", **inputs))


def test_lights_that_are_not_drawn_are_losses(tmp_path):
    def build(stage: Usd.Stage) -> None:
        UsdLux.RectLight.Define(stage, "/rect")
        UsdLux.DiskLight.Define(stage, "/disk")
        light = sphere_light(stage, "focused")
        UsdLux.ShapingAPI.Apply(light.GetPrim()).CreateShapingFocusAttr(2.0)
        sphere_light(stage, "plain")

    assert opened(tmp_path, build).losses == (
        "RectLight is not read: 1 prim, /rect",
        "DiskLight is not read: 1 prim, /disk",
        "inputs:shaping:focus of SphereLight is not followed: 1 prim, /focused",
    )
