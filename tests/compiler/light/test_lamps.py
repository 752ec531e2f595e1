"""Further suns and lamps have the strength, the place and the aim that the cfg gives them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdLux

from scenec.backends.check.stage import check_stage
from scenec.backends.stage.read import read_stage
from scenec.compiler.cameras.paths.random_target import RandomTargetPlan
from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.cameras.sensor import SensorPlan
from scenec.compiler.compile import CompileReport, compile_cfg
from scenec.compiler.light.build import SceneLight, without_dark
from scenec.compiler.light.earthshine import earthshine_irradiance
from scenec.compiler.light.lamp import LampPlan, LampTarget, WorldMount
from scenec.compiler.light.lamps import build_lamps, lamp_irradiance, meter_lamps
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.scene.exposure import incident_exposure
from scenec.compiler.scene.light import Lamp, SkyLight, SunDisc
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.testing.small import small_cfg, write_cfg

LIGHTS = "/World/Lights"
MOUNT = {"position_m": [0.3, 0.1, -0.2], "rotation_deg": [-10, 20, 5]}


def earthshine(phase_deg: Any, albedo: float = 0.367) -> np.ndarray:
    phase = np.atleast_1d(np.asarray(phase_deg, float))
    return earthshine_irradiance(phase, np.full(len(phase), 1361.0), np.full(len(phase), albedo))


def test_a_full_earth_gives_the_moon_what_is_published():
    # Glenar et al. 2019 (Icarus 321): about 0.15 W/m^2 in all wavelengths, half of it thermal.
    assert 0.1 < earthshine(0.0)[0] < 0.15
    assert earthshine(0.0)[0] / 1361.0 == pytest.approx(1e-4, rel=0.02)
    assert earthshine(0.0, 0.22)[0] == pytest.approx(0.5 * 0.15, rel=0.15)


def test_the_earths_phases_are_those_of_a_lambert_sphere():
    full = earthshine(0.0)[0]
    assert earthshine(90.0)[0] == pytest.approx(full / np.pi)
    assert earthshine(180.0)[0] == 0.0
    assert 0.0 < earthshine(179.9)[0] < 1e-8 * full
    # The phase integral of a Lambert sphere is 3/2: a geometric albedo of 2/3 returns everything.
    angle = np.linspace(0.0, np.pi, 20001)
    law = earthshine(np.degrees(angle)) / full
    assert 2.0 * np.trapezoid(law * np.sin(angle), angle) == pytest.approx(1.5, rel=1e-6)
    assert (np.diff(law) <= 0.0).all()


def flat(height: float = 2.0) -> GroundSurface:
    grid = Grid.with_spacing((40.0, 40.0), 1.0)
    return GroundSurface(HeightField(grid, np.full(grid.shape, height)), smooth=False)


def world_lamp(**change: Any) -> LampPlan:
    mount = {
        "x_m": np.ones(1),
        "y_m": np.full(1, 2.0),
        "z_m": np.full(1, 3.0),
        "heights": "ground",
        "bearing_deg": np.zeros(1),
        "elevation_deg": np.full(1, -90.0),
        "target": None,
    }
    numbers = {
        "intensity": np.full((1, 3), 18.0),
        "radius_m": np.zeros(1),
        "cone_deg": np.full(1, 40.0),
        "softness": np.full(1, 0.5),
    }
    return LampPlan(name="a", mount=WorldMount(**{k: change.pop(k, v) for k, v in mount.items()}),
                    **{k: change.pop(k, v) for k, v in numbers.items()})  # fmt: skip


def built(**change: Any) -> Lamp:
    return build_lamps((world_lamp(**change),), (), flat())[0]


@pytest.mark.parametrize(
    ("bearing_deg", "elevation_deg", "axis"),
    [
        (0, 0, (0, 1, 0)),
        (90, 0, (1, 0, 0)),
        (90, -30, (np.cos(np.pi / 6), 0, -0.5)),
        (77, -90, (0, 0, -1)),
        (0, 90, (0, 0, 1)),
    ],
)
def test_a_standing_lamp_shines_along_its_bearing_and_elevation(bearing_deg, elevation_deg, axis):
    lamp = built(bearing_deg=np.full(1, bearing_deg), elevation_deg=np.full(1, elevation_deg))
    pose = lamp.to_world[0]
    assert np.allclose(-pose[:3, 2], axis, atol=1e-12)
    assert np.allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    # On ground at 2 m.
    assert pose[:3, 3].tolist() == [1.0, 2.0, 5.0]


def test_a_standing_lamp_shines_at_its_target_over_the_same_ground():
    target = LampTarget(x_m=np.full(1, 4.0), y_m=np.full(1, -2.0), z_m=np.zeros(1))
    lamp = built(target=target)
    way = np.array([4.0, -2.0, 2.0]) - [1.0, 2.0, 5.0]
    assert np.allclose(-lamp.to_world[0][:3, 2], way / np.linalg.norm(way), atol=1e-12)
    over_zero = built(target=target, heights="world")
    assert over_zero.to_world[0][:3, 3].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("angle_deg", [0.0, 15.0, 25.0, 30.0, 39.0, 41.0, 120.0, 180.0])
def test_what_a_lamp_gives_is_its_intensity_over_the_squared_distance_within_its_cone(angle_deg):
    lamp = built()
    angle = np.radians(angle_deg)
    point = np.array([1.0 + 3.0 * np.sin(angle), 2.0, 5.0 - 3.0 * np.cos(angle)])
    x = np.clip((angle_deg - 20.0) / 20.0, 0.0, 1.0)
    expected = 18.0 * (1.0 - x * x * (3.0 - 2.0 * x)) / 9.0
    assert lamp_irradiance(lamp, 0, point) == pytest.approx(expected, abs=1e-12)


def test_nothing_is_metered_inside_of_a_lamp():
    lamp = built(radius_m=np.full(1, 0.5))
    assert lamp_irradiance(lamp, 0, np.array([1.0, 2.0, 4.6])) == 0.0
    assert lamp_irradiance(built(), 0, np.array([1.0, 2.0, 5.0])) == 0.0


def metered(irradiance: float, lamps: tuple[Lamp, ...], down_deg: float = 45.0) -> float:
    """Exposure of a camera 4 m over flat ground at (1, 2) that looks down by an angle."""
    pose = np.eye(4)
    c, s = np.cos(np.radians(down_deg)), np.sin(np.radians(down_deg))
    pose[:3, :3] = np.array([[1, 0, 0], [0, -s, c], [0, -c, -s]])
    pose[:3, 3] = (1.0, 2.0, 6.0)
    k = (50.0, 50.0, 32.0, 24.0, 0.0)
    sensor = Sensor("s", (64, 48), k, np.eye(4), np.zeros(1), ("rgb",))
    plan = SensorPlan(sensor, True)
    unused = RandomTargetPlan(*[np.zeros((1, 2))] + [np.zeros(1)] * 5)
    (rig,) = meter_lamps(
        (Rig("r", pose[None], (sensor,)),),
        (RigPlan("r", unused, (plan,)),),
        lamps,
        flat(),
        np.full(1, irradiance),
    )
    return float(rig.sensors[0].exposure_ev[0])


def test_a_metered_exposure_counts_lamps_where_the_middle_of_the_picture_meets_the_ground():
    # The lamp is 3 m over the ground, the middle 4 m north of the camera.
    lamp = built(cone_deg=np.full(1, 180.0), softness=np.zeros(1))
    arrives = 18.0 / (9.0 + 16.0)
    assert metered(0.0, (lamp,)) == incident_exposure(np.full(1, arrives))[0]
    assert metered(0.5, (lamp,)) == incident_exposure(np.full(1, 0.5 + arrives))[0]


def test_a_metered_exposure_looks_below_the_middle_where_no_lamp_lights_that():
    lamp = built(cone_deg=np.full(1, 180.0), softness=np.zeros(1))
    # The middle is at the horizon; an eighth of 48 rows below it meets the ground 33 m away, off
    # the terrain, a quarter 16.7 m away.
    far = 4.0 * 50.0 / 12.0
    expected = incident_exposure(np.full(1, 18.0 / (9.0 + far * far)))[0]
    assert metered(0.0, (lamp,), down_deg=0.0) == expected
    assert metered(0.0, (lamp,), down_deg=-60.0) == 0.0


def sun(elevation_deg: list[float], irradiance: float = 100.0) -> SunDisc:
    n = len(elevation_deg)
    return SunDisc(
        np.zeros(n), np.array(elevation_deg), np.full(n, irradiance), np.full(n, 2.0),
        np.ones((n, 3)),
    )  # fmt: skip


def sky(value: float, intensity: float = 1.0) -> SkyLight:
    picture = np.full((8, 16, 3), value, np.float32)
    return SkyLight({"a.exr": picture}, ("a.exr",), np.full(1, intensity), np.zeros(1))


def light(sun: SunDisc | None, sky: SkyLight | None = None, **more: SunDisc) -> SceneLight:
    return SceneLight(sun, sky, more, None, None, np.zeros(1))


def test_lights_that_give_nothing_at_any_sample_are_left_out_and_reported():
    dark = built(intensity=np.zeros((1, 3)))
    kept, lamps, left_out = without_dark(
        light(sun([-1.1]), sky(0.0), low=sun([-30.0]), none=sun([40.0], 0.0)), (dark,)
    )
    assert (kept.sun, kept.sky, kept.more_suns, lamps) == (None, None, {}, ())
    assert left_out == [
        ("light/sun", "below the horizon at every sample"),
        ("light/more/low", "below the horizon at every sample"),
        ("light/more/none", "no light at every sample"),
        ("light/sky", "black at every sample"),
        ("light/lamps/a", "no light at every sample"),
    ]


def test_lights_that_give_something_stay_as_they_are():
    # A disc of 2 degrees whose middle is half a degree below the horizon is still partly up.
    given = light(sun([-0.5]), sky(1e-6), other=sun([80.0]))
    kept, lamps, left_out = without_dark(given, (built(),))
    assert kept.sun is given.sun
    assert kept.sky is given.sky
    assert kept.more_suns["other"] is given.more_suns["other"]
    assert len(lamps) == 1
    assert left_out == []
    assert without_dark(light(None, sky(1.0, 0.0)), ())[0].sky is None


def test_a_sun_gives_nothing_at_samples_where_it_is_below_the_horizon():
    kept, _, _ = without_dark(light(sun([-5.0, 30.0])), ())
    assert kept.sun.irradiance.tolist() == [0.0, 100.0]


@pytest.fixture(scope="module")
def night(tmp_path_factory) -> tuple[Path, CompileReport]:
    """A stage of three samples: a second sun, a lamp mounted as the camera is, a standing one."""
    cfg = small_cfg(objects={})
    del cfg["materials"]["stone"], cfg["labels"]["class"]["rock"]
    del cfg["labels"]["surface"]["stone"]
    cfg["terrain"]["relief"] = [{"type": "plane"}]
    cfg["terrain"]["spacing_m"] = 1
    cfg["rigs"]["rover"]["sensors"]["front"]["mount"] = MOUNT
    cfg["light"]["sun"] = {"elevation_deg": -10}
    cfg["light"]["more"] = {
        "Earth": {"type": "earthshine", "phase_deg": 90, "elevation_deg": 30, "azimuth_deg": 90},
        "Set": {"type": "sun", "elevation_deg": -20},
    }
    spread = {"type": "uniform", "min": 5, "max": 50}
    cfg["light"]["lamps"] = {
        "Head": {
            "mount": {"type": "rig", "rig": "rover"} | MOUNT,
            "intensity": spread,
            "color": [1, 0.5, 0.25],
        },
        "Mast": {
            "mount": {"type": "world", "x_m": 1, "y_m": -2, "z_m": 4},
            "intensity": 7,
            "radius_m": 0,
            "cone_deg": 60,
            "softness": 0.25,
        },
    }
    folder = tmp_path_factory.mktemp("lamps")
    report = compile_cfg(write_cfg(folder, cfg), seed=2, out=folder / "out")
    return folder / "out" / "batch_0000" / "stage.usda", report


def test_a_lamp_on_a_rig_follows_it_over_the_samples(night):
    stage = Usd.Stage.Open(str(night[0]))
    camera = UsdGeom.Camera.Get(stage, "/World/Rigs/rover/front")
    lamp = UsdLux.SphereLight.Get(stage, f"{LIGHTS}/Head")
    places = set()
    for sample in range(3):
        seen, shines = (
            np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(sample))
            for prim in (camera, lamp)
        )
        # Both look along -z, mounted alike.
        np.testing.assert_allclose(shines, seen, atol=1e-12)
        places.add(tuple(shines[3]))
    assert len(places) == 3


def test_the_stage_gives_lamps_back_as_the_cfg_has_them(night):
    scene = read_stage(night[0])
    strengths = set()
    for lighting in scene.lighting:
        head, mast = lighting.lamps
        weights = np.array([0.2126, 0.7152, 0.0722])
        np.testing.assert_allclose(head.intensity / head.intensity[0], [1, 0.5, 0.25], rtol=1e-6)
        assert 5.0 <= weights @ head.intensity <= 50.0
        strengths.add(float(head.intensity[0]))
        assert head.radius_m == pytest.approx(0.03)
        np.testing.assert_allclose(mast.position, [1, -2, 4], atol=1e-12)
        np.testing.assert_allclose(mast.axis, [0, 0, -1], atol=1e-12)
        assert weights @ mast.intensity == pytest.approx(7.0)
        assert mast.radius_m == 0.0
        assert mast.cone == pytest.approx(np.radians(60.0))
        assert mast.softness == 0.25
    assert len(strengths) == 3


def test_a_normalized_sphere_of_four_times_the_intensity_has_it_whatever_its_radius(night):
    # UsdLux: radiance is intensity over the surface 4 pi r^2; from afar a sphere shows pi r^2.
    stage = Usd.Stage.Open(str(night[0]))
    for name in ("Head", "Mast"):
        lamp = UsdLux.SphereLight.Get(stage, f"{LIGHTS}/{name}")
        assert lamp.GetNormalizeAttr().Get()
        area = np.pi * lamp.GetRadiusAttr().Get() ** 2
        radiance = lamp.GetIntensityAttr().Get() / (4.0 * area)
        color = np.array(lamp.GetColorAttr().Get())
        read = {"Head": 0, "Mast": 1}[name]
        expected = read_stage(night[0]).lighting[0].lamps[read].intensity
        np.testing.assert_allclose(radiance * area * color, expected, rtol=1e-6)


def test_default_values_of_lamps_are_those_of_the_first_sample(night):
    stage = Usd.Stage.Open(str(night[0]))
    for name in ("Head", "Mast"):
        prim = stage.GetPrimAtPath(f"{LIGHTS}/{name}")
        for attribute in prim.GetAuthoredAttributes():
            assert attribute.Get() == attribute.Get(0.0), attribute.GetName()


def test_the_stage_holds_what_shines_and_says_what_was_left_out(night):
    path, report = night
    stage = Usd.Stage.Open(str(path))
    names = [prim.GetName() for prim in stage.GetPrimAtPath(LIGHTS).GetChildren()]
    assert names == ["Earth", "Head", "Mast", "Dome"]
    left_out = [entry.what for entry in report.reports["batch_0000"].left_out]
    assert left_out == ["light/sun", "light/more/Set"]
    (earth,) = read_stage(path).lighting[0].suns
    np.testing.assert_allclose(earth.to_light, [np.cos(np.pi / 6), 0, 0.5], atol=1e-12)
    weights = np.array([0.2126, 0.7152, 0.0722])
    assert weights @ earth.irradiance == pytest.approx(earthshine(90.0)[0], rel=1e-6)
    assert earth.diameter_rad == pytest.approx(np.radians(1.9))
    assert earth.irradiance[2] > earth.irradiance[1] > earth.irradiance[0]
    assert not check_stage(path)
