"""Rigs of a stage as exporters get them: poses, mounts, and what IMUs read."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt
from scipy.spatial.transform import Rotation

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.rigs import read_rigs
from scenec.compiler.compile import compile_cfg
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.imu import ImuNoise
from scenec.testing.damaged_stages import over
from scenec.testing.small import small_cfg, write_cfg

NOISE = {"gyroscope_random_walk": 0.01, "accelerometer_noise_density": 0.2}
PRIM = "/World/Rigs/rover/unit"


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rigs")
    cfg = small_cfg(samples=5)
    cfg["objects"] = {}
    cfg["terrain"]["spacing_m"] = 1.0
    rig = cfg["rigs"]["rover"]
    rig["pose"] = {"type": "orbit", "radius_m": 4, "height_m": 3, "period_s": 20,
                   "sweep_deg": 90, "sampling": {"rate_hz": 4}}  # fmt: skip
    rig["imus"] = {
        "unit": {"rate_hz": 100, "gravity_m_s2": 1.62, "noise": NOISE},
        "still": {"rate_hz": 50, "gravity_m_s2": 1.62, "mount": {"position_m": [0.1, 0.2, 0.3]}},
    }
    rig["lidars"] = {"top": {"beams": 4, "azimuths": 8, "mount": {"position_m": [0, -1, 0]}}}
    del cfg["materials"]["stone"], cfg["labels"]["class"]["rock"], cfg["labels"]["surface"]["stone"]
    compile_cfg(write_cfg(folder, cfg), seed=1, out=folder / "out")
    return folder / "out/batch_0000/stage.usda"


def test_readings_come_back_with_the_state_and_the_noise_they_were_made_with(stage):
    (rig,) = read_rigs(stage)
    unit, still = rig.imus
    assert (rig.name, unit.name, still.name) == ("rover", "unit", "still")
    assert (unit.rate_hz, unit.gravity_m_s2, unit.noise) == (100.0, 1.62, ImuNoise(**NOISE))
    assert np.array_equal(rig.time_s, 0.25 * np.arange(5))
    assert np.allclose(unit.time_s, 0.01 * np.arange(101), rtol=0, atol=1e-15)
    rate = 2 * np.pi / 20
    # The rig looks down at the center, at a slope of 3 : 4.
    turned = Rotation.from_quat(np.roll(unit.orientation, -1, axis=1))
    up = turned.inv().apply([0.0, 0.0, 1.0])
    assert np.allclose(unit.angular_velocity, -rate * up, rtol=0, atol=1e-12)
    toward = turned.inv().apply(np.c_[-4 * rate**2 * away(unit), 0 * unit.time_s])
    assert np.allclose(unit.specific_force, toward + 1.62 * up, rtol=0, atol=1e-12)
    assert unit.gyroscope_bias[1:].all()
    assert not unit.accelerometer_bias.any()
    assert np.array_equal(unit.gyroscope, unit.angular_velocity + unit.gyroscope_bias)
    white = unit.accelerometer - unit.specific_force
    assert white.std() == pytest.approx(0.2 * np.sqrt(100), rel=0.15)
    assert np.array_equal(still.gyroscope, still.angular_velocity)
    assert not still.gyroscope_bias.any()


def away(imu):
    """Level unit vectors from the middle of the orbit, at (0, 0)."""
    level = imu.position_m[:, :2]
    return level / np.linalg.norm(level, axis=1)[:, None]


def test_poses_and_mounts_put_cameras_and_lidars_where_the_renderer_has_them(stage):
    (rig,) = read_rigs(stage)
    scene = read_stage(stage)
    for sample in range(5):
        seen = (*scene.cameras[sample], *scene.lidars[sample])
        for one in seen:
            pose = one.to_world if hasattr(one, "to_world") else one.camera_to_world
            assert np.abs(rig.to_world[sample] @ rig.mounts[one.path] - pose).max() < 1e-12
    assert len(rig.mounts) == len(seen)
    unit, still = rig.imus
    first = rig.to_world[0] @ unit.to_rig
    assert np.abs(first[:3, 3] - unit.position_m[0]).max() < 1e-12
    turn = Rotation.from_quat(np.roll(unit.orientation[0], -1)).as_matrix()
    assert np.abs(first[:3, :3] - turn).max() < 1e-12
    assert still.to_rig[:3, 3].tolist() == [0.1, 0.2, 0.3]
    assert (still.to_rig[:3, :3] == unit.to_rig[:3, :3]).all()


FAULTS = {
    "times": (names.ATTR_IMU_TIMES, Sdf.ValueTypeNames.DoubleArray, Vt.DoubleArray([1.0, 1.0]),
              "expected times that rise"),
    "few": (names.ATTR_IMU_GYROSCOPE, Sdf.ValueTypeNames.Double3Array,
            Vt.Vec3dArray([(0, 0, 0)]), "has 1 values, expected one for each of the 101"),
    "nan": (names.ATTR_IMU_ACCELEROMETER, Sdf.ValueTypeNames.Double3Array,
            Vt.Vec3dArray([(np.nan, 0, 0)] * 101), "holds NaN"),
    "turn": (names.ATTR_IMU_ORIENTATIONS, Sdf.ValueTypeNames.Double4Array,
             Vt.Vec4dArray([(2, 0, 0, 0)] * 101), "expected quaternions of unit length"),
    "noise": (names.ATTR_IMU_NOISE, Sdf.ValueTypeNames.DoubleArray, Vt.DoubleArray([1.0]),
              "holds 1 numbers, expected 6"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_cannot_be_an_imu_is_named_with_its_prim(stage, tmp_path, fault):
    name, kind, value, said = FAULTS[fault]
    root = tmp_path / "bad.usda"
    over(stage, root).Save()
    opened = Usd.Stage.Open(str(root))
    opened.OverridePrim(PRIM).CreateAttribute(name, kind).Set(value)
    opened.Save()
    with pytest.raises(StageError, match=said) as caught:
        read_rigs(root)
    assert PRIM in str(caught.value)


def test_a_stage_that_lacks_other_layers_has_its_rigs_and_one_without_their_own_is_refused(
    stage, tmp_path
):
    shutil.copytree(stage.parents[1], tmp_path / "out")
    root = tmp_path / "out/batch_0000/stage.usda"
    (root.parent / "terrain.usdc").unlink()
    (rig,) = read_rigs(root)
    assert len(rig.imus) == 2
    (root.parent / "cameras.usdc").unlink()
    with pytest.raises(StageError, match=r"cameras\.usdc: is in the manifest"):
        read_rigs(root)


def test_a_stage_in_other_units_is_refused_and_one_without_rigs_has_none(stage, tmp_path):
    over(stage, tmp_path / "feet.usda").Save()
    feet = Usd.Stage.Open(str(tmp_path / "feet.usda"))
    UsdGeom.SetStageMetersPerUnit(feet, 0.3048)
    feet.Save()
    with pytest.raises(StageError, match="an IMU counts in meters with z up"):
        read_rigs(tmp_path / "feet.usda")
    empty = Usd.Stage.CreateNew(str(tmp_path / "empty.usda"))
    empty.DefinePrim("/World")
    empty.Save()
    assert read_rigs(tmp_path / "empty.usda") == ()
