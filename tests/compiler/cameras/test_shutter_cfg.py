"""A cfg's shutter: what is drawn, where cameras are meanwhile, what stands in the stage."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from shutter_cfgs import ORBIT, SHUTTER, cfg

from scenec.compiler.assets.tracks import Stamped
from scenec.compiler.cameras.lens import Equirectangular, KannalaBrandt
from scenec.compiler.cameras.paths.descent import Descent
from scenec.compiler.cameras.paths.lawn_mower import LawnMower
from scenec.compiler.cameras.paths.mav import Mav
from scenec.compiler.cameras.paths.motion import MotionContext, Way
from scenec.compiler.cameras.paths.orbit import Orbit, PointAim
from scenec.compiler.cameras.paths.rover import Rover
from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.cameras.rigs import build_rigs
from scenec.compiler.cameras.sensor import SensorPlan
from scenec.compiler.cameras.shutters import ERROR_PX, way_of
from scenec.compiler.cameras.tracks import Gaps, Sampling, TrackPlan, TrackWay
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.scene.rig import OpenShutter, Rig, Sensor
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.views.frustum import MOVING, in_view, views_of_all
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import CfgError, SceneError
from scenec.schemas.left_out import read_left_out
from scenec.schemas.lens import Lens, directions, to_plane
from scenec.schemas.shutter import Shutter, between
from scenec.testing import small
from scenec.testing.pruned_scenes import annotation, compiled, drawn_cfg

SENSOR = Sensor(
    "front", (200, 100), (180.0, 182.0, 98.0, 53.0, 0.5), np.eye(4), np.zeros(1), ("depth",)
)
FREE = Sampling()


def drawn(folder: Path, document: dict[str, Any], batch: int = 0) -> SensorPlan:
    return draw(load(small.write_cfg(folder, document)), 1, batch).rigs[0].sensors[0]


# What is drawn, and what is refused --------------------------------------------------------------


def test_the_exposure_is_that_of_a_manual_imaging(tmp_path: Path) -> None:
    """Of each sample, where the shutter says none; its own goes before."""
    time = {"type": "log_uniform", "min": 1e-3, "max": 1e-1}
    imaging = {"exposure": {"type": "manual", "time_s": time, "iso": 200}}
    made = drawn(tmp_path, cfg({"direction": "up"}, imaging=imaging))
    assert made.shutter is not None
    assert [one.exposure_s for one in made.shutter] == [one.time_s for one in made.imaging.samples]
    assert len({one.exposure_s for one in made.shutter}) == 3
    assert {(one.readout_s, one.upward) for one in made.shutter} == {(0.0, True)}
    own = drawn(tmp_path, cfg({"exposure_s": 0.5}, imaging=imaging))
    assert own.shutter == (Shutter(0.5, 0.0, False),) * 3


def test_numbers_are_drawn_once_a_batch(tmp_path: Path) -> None:
    spread = {"type": "uniform", "min": 0.01, "max": 0.03}
    made = [drawn(tmp_path, cfg(SHUTTER | {"readout_s": spread}), batch) for batch in (0, 1)]
    assert len(set(made[0].shutter)) == 1
    assert made[0].shutter[0].readout_s != made[1].shutter[0].readout_s


@pytest.mark.parametrize(
    ("shutter", "change", "where", "said"),
    [
        ({}, {}, "/shutter", "expected the key exposure_s"),
        (SHUTTER, {"pose": small.small_cfg()["rigs"]["rover"]["pose"]}, "/shutter", "of no time"),
    ],
)
def test_each_fault_is_said_where_it_is(
    tmp_path: Path, shutter: Any, change: dict[str, Any], where: str, said: str
) -> None:
    with pytest.raises(CfgError) as caught:
        load(small.write_cfg(tmp_path, cfg(shutter, **change)))
    text = str(caught.value)
    assert f"/rigs/rover/sensors/front{where}" in text
    assert said in text


# Where cameras are -------------------------------------------------------------------------------


def flat() -> GroundSurface:
    grid = Grid.with_spacing((60.0, 40.0), 0.5)
    return GroundSurface(HeightField(grid, np.zeros(grid.shape)))


def rig_of(pose: Any, shutter: Shutter, samples: int = 3, **change: Any) -> tuple[Rig, Any, Way]:
    """A rig with an open shutter, what is said of it, and its way."""
    still = replace(SENSOR, exposure_ev=np.zeros(samples), **change)
    sensor = SensorPlan(still, False, shutter=(shutter,) * samples)
    plan = RigPlan("r", pose, (sensor,))
    surface = flat()
    (rig,), facts = build_rigs((plan,), surface, None, {})
    around = MotionContext("rigs/r/pose", samples, surface, (still,))
    way = way_of(pose, pose.built(around), around)
    assert way is not None
    return rig, facts["r"]["shutter"]["front"], way


def track(spin: float = 1.0, sway: float = 1.0) -> Stamped:
    """A handheld camera: every 0.1 s, by a clock that begins at 5."""
    time = np.arange(40) * 0.1
    position = np.stack([time, sway * np.sin(3.0 * time), 1.6 + 0.1 * np.cos(5.0 * time)], axis=1)
    turn = Rotation.from_rotvec(
        spin * np.stack([np.sin(2.0 * time), 0.5 * time, np.cos(3.0 * time)], axis=1)
    )
    return Stamped(time, 5.0, position, turn.as_quat(scalar_first=True), tuple(range(40)))


def tracked(method: str = "cubic", **change: Any) -> TrackPlan:
    at = np.array([0.0, 1.33, 3.9])
    way = TrackWay(at, track(**change), method, Gaps(), "track.csv", False)
    # By a clock of whose seconds a float has few digits left.
    return TrackPlan(way.at(at), 1.7e9 + at, way)


WAYS: dict[str, Any] = {
    "track": tracked(),
    "orbit": Orbit(center=PointAim(), radius_m=6.0, height_m=2.0, sweep_deg=90.0, period_s=8.0,
        clearance_m=0.1, sampling=FREE),
    "whole orbit": Orbit(center=PointAim(), radius_m=6.0, height_m=2.0, period_s=20.0,
        clearance_m=0.1,
        sampling=FREE),
    "lawn_mower": LawnMower(along_m=20.0, across_m=12.0, bearing_deg=30.0, spacing_m=4.0,
        overlap=0.2,
        height_m=8.0, speed_m_s=5.0, turn_radius_m=2.0, pitch_deg=-60.0, sampling=FREE),
    "rover": Rover(waypoints_m=[[-8.0, 0.0], [4.0, 3.0], [4.0, -6.0]], height_m=1.2, speed_m_s=1.0,
        turn_rate_deg_s=40.0, max_slope_deg=30.0, max_object_m=0.2, pitch_deg=-10.0,
        sampling=FREE),
    "mav": Mav(waypoints_m=[[-15.0, -5.0], [0.0, 8.0], [15.0, -5.0]], height_m=5.0, follow_m=6.0,
        clearance_m=1.0, speed_m_s=6.0, acceleration_m_s2=4.0, jerk_m_s3=10.0, tilt=True,
        sampling=FREE),
    "descent": Descent(entry_height_m=40.0, touchdown_height_m=2.0, entry_speed_m_s=8.0,
        drift_m_s=3.0,
        drift_deg=40.0, heading_deg=10.0, pitch_deg=-80.0, sampling=FREE),
}  # fmt: skip


@pytest.mark.parametrize("name", WAYS)
def test_between_its_poses_a_camera_is_where_the_motion_takes_it(name: str) -> None:
    """To what the report says, below a thousandth of a pixel, of points as near as the ground."""
    to_rig = np.eye(4)
    to_rig[:3, :3] = Rotation.from_euler("xyz", [5.0, -20.0, 3.0], degrees=True).as_matrix()
    to_rig[:3, 3] = 0.3, -0.1, 0.4
    rig, facts, way = rig_of(WAYS[name], Shutter(0.005, 0.02), to_rig=to_rig)
    opened = rig.sensors[0].shutter
    assert facts["error_px"] <= ERROR_PX
    assert facts["poses"] == len(opened.times) <= 65
    assert opened.times[0] == -0.0125
    assert opened.times[-1] == 0.0125
    assert rig.times is not None
    middle = len(opened.times) // 2
    rng = np.random.default_rng(7)
    k = np.array([[180.0, 0.5, 98.0], [0.0, 182.0, 53.0], [0.0, 0.0, 1.0]])
    worst = 0.0
    for i, time in enumerate(way.times):
        assert np.array_equal(opened.to_world[i, middle], rig.to_world[i] @ to_rig) or np.allclose(
            opened.to_world[i, middle], rig.to_world[i] @ to_rig, rtol=0, atol=1e-15 * 50
        )
        at = rng.uniform(-0.0125, 0.0125, 50)
        found = between(opened.times, opened.to_world[i], at)
        expected = way.at(time + at) @ to_rig
        pixel = np.stack([rng.uniform(0, 200, 50), rng.uniform(0, 100, 50), np.ones(50)], axis=1)
        local = np.linalg.solve(k, pixel.T).T
        local *= facts["no_nearer_than_m"] / np.linalg.norm(local, axis=1)[:, None]
        points = expected[:, :3, 3] + (expected[:, :3, :3] @ local[:, :, None])[:, :, 0]
        seen = (points - found[:, :3, 3])[:, None, :] @ found[:, :3, :3]
        shown = (k @ seen[:, 0].T).T
        worst = max(worst, float(np.abs(shown[:, :2] / shown[:, 2:] - pixel[:, :2]).max()))
    assert worst <= 1.5 * ERROR_PX
    assert worst <= 2.0 * max(facts["error_px"], 1e-7)


def test_before_its_beginning_and_after_its_end_a_rig_stands_still() -> None:
    for pose in (WAYS["orbit"], WAYS["track"], WAYS["mav"]):
        rig = rig_of(pose, Shutter(0.0, 0.5))[0]
        opened = rig.sensors[0].shutter
        assert (opened.to_world[0][opened.times < 0.0] == rig.to_world[0]).all()
        late = opened.to_world[-1][opened.times > 0.0]
        assert np.abs(late - rig.to_world[-1]).max() < 1e-12
        assert (opened.to_world[1][opened.times > 0.0] != rig.to_world[1]).any()


def test_a_motion_of_no_length_stands_still() -> None:
    hover = replace(WAYS["mav"], waypoints_m=[[1.0, 2.0]])
    point = Stamped(np.zeros(1), 2.0, np.ones((1, 3)), np.array([[1.0, 0, 0, 0]]), (1,))
    way = TrackWay(np.zeros(1), point, "linear", Gaps(), "t", False)
    alone = TrackPlan(way.at(np.zeros(1)), np.full(1, 2.0), way)
    still = replace(WAYS["orbit"], sweep_deg=0.0)
    for pose, samples in ((hover, 3), (alone, 1), (still, 3)):
        sensor = replace(SENSOR, exposure_ev=np.zeros(samples))
        drawn_sensor = SensorPlan(sensor, False, shutter=(Shutter(0.1, 0.2),) * samples)
        (rig,), _ = build_rigs((RigPlan("r", pose, (drawn_sensor,)),), flat(), None, {})
        opened = rig.sensors[0].shutter
        assert (opened.to_world == opened.to_world[:, :1]).all()
        assert opened.times[-1] >= 0.5 * (0.1 + 0.2)


def test_the_number_of_poses_is_bounded_and_the_error_said() -> None:
    """A second of a shaken camera's track: more than 64 steps can follow to a thousandth."""
    rig, facts, _ = rig_of(tracked(spin=6.0, sway=4.0), Shutter(2.0, 1.0))
    opened = rig.sensors[0].shutter
    assert facts["poses"] == len(opened.times) == 65
    assert facts["error_px"] > ERROR_PX
    _, calm, _ = rig_of(tracked(spin=6.0, sway=4.0), Shutter(1e-4, 0.0))
    assert calm["poses"] == 3
    assert calm["error_px"] < ERROR_PX


def test_an_instant_has_one_pose() -> None:
    rig, facts, _ = rig_of(WAYS["orbit"], Shutter(0.0, 0.0))
    opened = rig.sensors[0].shutter
    assert opened.times.tolist() == [0.0]
    assert facts["poses"] == 1
    assert facts["error_px"] == 0.0


def test_a_gap_of_a_track_is_one_while_a_shutter_is_open() -> None:
    stamped = track()
    keep = np.r_[0:20, 30:40]
    stamped = replace(
        stamped, time_s=stamped.time_s[keep], position_m=stamped.position_m[keep],
        quaternion=stamped.quaternion[keep], lines=tuple(keep.tolist()),
    )  # fmt: skip
    at = stamped.time_s[[5, 19]]
    way = TrackWay(at, stamped, "linear", Gaps(0.2), "track.csv", False)
    pose = TrackPlan(way.at(at), at, way)
    assert rig_of(pose, Shutter(0.0, 0.0), 2)
    with pytest.raises(
        SceneError, match=r"while a shutter is open: track.csv:\d+: .* without a pose"
    ):
        rig_of(pose, Shutter(0.1, 0.0), 2)


@pytest.mark.parametrize(
    ("motion", "seconds", "ends"),
    [
        (LawnMower(along_m=20.0, across_m=0.0, bearing_deg=90.0, spacing_m=1.0, overlap=0.0,
             height_m=1.0, above="world", speed_m_s=1.0, sampling=FREE),
         8.0, (0.0, 20.0)),
        (Descent(entry_height_m=1.0, touchdown_height_m=0.5, entry_speed_m_s=0.05,
             touchdown_speed_m_s=0.05, drift_m_s=1.0, drift_deg=90.0, sampling=FREE),
         3.5, (0.0, 10.0)),
    ],
)  # fmt: skip
def test_what_is_wrong_between_samples_is_said_by_its_time_and_not_by_a_number(
    motion: Any, seconds: float, ends: tuple[float, float]
) -> None:
    # A wall from x = -3 m to -1 m: a survey at 1 m/s from -10 m on is in it after 8 s, a drift
    # whose way to the end is 0.05 t^2 m, t from 10 s down, after 3.5 s.
    grid = Grid.with_spacing((60.0, 40.0), 0.5)
    x = (np.arange(grid.shape[1]) - 0.5 * (grid.shape[1] - 1)) * 0.5
    wall = np.broadcast_to(np.where(np.abs(x + 2.0) < 1.1, 9.0, 0.0), grid.shape)
    around = MotionContext(
        "rigs/r/pose", 2, GroundSurface(HeightField(grid, np.ascontiguousarray(wall))), (SENSOR,)
    )
    free = replace(motion, sampling=Sampling(times_s=ends))
    way = way_of(free, free.built(around), around)
    with pytest.raises(SceneError) as caught:
        way.at(np.array([0.0, 0.1, seconds, ends[1]]))
    said = str(caught.value)
    assert said.startswith(f"while a shutter is open: rigs/r/pose: the exposure at {seconds:g} s, ")
    assert "below the ground" in said
    with pytest.raises(SceneError, match=r"^rigs/r/pose: sample 1, at .* below the ground"):
        replace(motion, sampling=Sampling(times_s=(0.0, seconds))).built(around)


def test_a_pair_that_rolls_differently_is_none(tmp_path: Path) -> None:
    document = cfg(SHUTTER)
    sensors = document["rigs"]["rover"]["sensors"]
    sensors["right"] = json.loads(json.dumps(sensors["front"])) | {
        "mount": {"position_m": [0.2, 0, 0]}
    }
    sensors["front"] |= {"partner": "right", "outputs": ["disparity"]}
    plans = draw(load(small.write_cfg(tmp_path, document)), 1, 0).rigs
    assert build_rigs(plans, flat(), None, {})
    sensors["right"]["shutter"]["direction"] = "up"
    plans = draw(load(small.write_cfg(tmp_path, document)), 1, 0).rigs
    with pytest.raises(SceneError, match="read out differently"):
        build_rigs(plans, flat(), None, {})


# Views that pruning goes by ----------------------------------------------------------------------

LENSES: dict[str, Lens | None] = {
    "pinhole": None,
    "kannala_brandt": KannalaBrandt(max_angle_deg=70).build(),
    "equirectangular": Equirectangular().build(),
}


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("spin", [0.02, 0.6, 5.0])
def test_all_that_is_seen_at_any_time_is_in_a_view(lens: str, spin: float) -> None:
    """Points on rays of random pixels at random times, near ones, too; and not just everything."""
    rng = np.random.default_rng(3)
    times = np.linspace(-1.0, 1.0, 17)
    turn = Rotation.from_rotvec(
        spin * np.stack([np.sin(times), 0.7 * times, np.cos(2.0 * times)], axis=1)
    )
    poses = np.repeat(np.eye(4)[None], 17, axis=0)
    poses[:, :3, :3] = turn.as_matrix()
    poses[:, :3, 3] = 0.3 * np.stack([times, np.sin(3.0 * times), times * times], axis=1)
    opened = OpenShutter((Shutter(0.0, 2.0),), times, poses[None])
    made = LENSES[lens]
    intrinsics = (60.0, 62.0, 50.0, 41.0, 0.7) if made is None else (50.0, 50.0, 48.0, 40.0, 0.0)
    sensor = Sensor("s", (96, 80), intrinsics, np.eye(4), np.zeros(1), ("rgb",), lens=made,
                    shutter=opened)  # fmt: skip
    views = views_of_all((Rig("r", poses[8:9], (sensor,), np.zeros(1)),))
    moving = views.kind & MOVING > 0
    assert moving.sum() == 4
    k = np.array([[intrinsics[0], intrinsics[4], intrinsics[2]],
                  [0.0, intrinsics[1], intrinsics[3]], [0.0, 0.0, 1.0]])  # fmt: skip
    n = 400
    x, y = to_plane(k, rng.uniform(0.0, 96.0, n), rng.uniform(0.0, 80.0, n))
    local, known = directions(made, x, y)
    at = between(times, poses, rng.uniform(-1.0, 1.0, n))
    t = 10.0 ** rng.uniform(-3.0, 3.0, n)
    points = at[:, :3, 3] + t[:, None] * (at[:, :3, :3] @ local[:, :, None])[:, :, 0]

    def shown(which: NDArray[np.bool_], point: NDArray[np.float64]) -> bool:
        index = np.flatnonzero(which)
        return any(in_view(views, v, *point, 1e-9) for v in index.tolist())

    for point in points[known]:
        assert shown(moving, point)
    if spin < 0.1 and lens == "pinhole":
        anywhere = rng.normal(size=(300, 3)) * 30.0
        assert np.mean([shown(moving, p) for p in anywhere]) < 0.5


@pytest.mark.invariant
@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 4])
def test_pruning_changes_no_annotation_of_a_rolling_shutter(seed: int, tmp_path: Path) -> None:
    document = drawn_cfg(seed, tmp_path)
    for rig in document["rigs"].values():
        rig["pose"] = ORBIT | {"radius_m": 6, "height_m": 1, "sweep_deg": 200, "period_s": 20}
        for sensor in rig["sensors"].values():
            sensor["shutter"] = {"exposure_s": 0.02, "readout_s": 0.3}
    batch = compiled(tmp_path, document, Keep.SEEN)
    record = read_left_out(batch)
    counts = [one.counts() for one in record.classes.values()]
    assert sum(n for of in counts for why, n in of.items() if not why.kept) > 20
    pairs = zip(
        annotation(batch),
        annotation(compiled(tmp_path, document, Keep.UNPRUNED)),
        strict=True,
    )
    for (name, pruned), (other, whole) in pairs:
        assert name == other
        for key, values in whole.items():
            assert np.array_equal(pruned[key], values, equal_nan=values.dtype.kind == "f"), key
