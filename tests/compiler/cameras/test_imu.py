"""IMUs read what motions make them feel, and err as their Allan parameters say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_motions import around, descent, hills, mav, orbit

from scenec.compiler.assets.tracks import Stamped
from scenec.compiler.cameras.imu import ImuPlan
from scenec.compiler.cameras.imu_readings import noise_of, read_along
from scenec.compiler.cameras.tracks import Gaps, Sampling, TrackPlan, TrackWay
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.schemas.errors import CfgError, SceneError
from scenec.schemas.imu import ImuNoise
from scenec.testing.small import small_cfg, write_cfg
from scenec.testing.tumbling import quaternions, rotations, top

#: An IMU that looks ahead, in the rig's axes: x forward, y left, z up.
AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
NEVER = ImuNoise()
TRACK = {"type": "track", "file": "t.csv", "sampling": {}, "interpolation": "spline"}


def plan(to_rig=AHEAD, rate=200.0, noise=NEVER, gravity=9.81):
    return ImuPlan("imu", to_rig, rate, gravity, noise, 7)


def tumbling(hz, seconds=3.0, samples=31):
    """A track of a top without torque that flies on a circle, by poses at a rate."""
    time = np.arange(int(seconds * hz) + 1) / hz
    position = np.stack([2 * np.cos(time), 2 * np.sin(time), 0.3 * np.sin(2 * time)], axis=1)
    at = np.linspace(0, seconds, samples)
    way = TrackWay(
        at,
        Stamped(time, 1.7e9, position, quaternions(top(time)[0]), ()),
        "spline",
        Gaps(),
        "t.csv",
        False,
    )
    return TrackPlan(way.resampled(at), 1.7e9 + at, way)


def read(motion, context, **keys):
    return read_along(plan(**keys), motion, motion.built(context), context)


def integrated(imu):
    """Positions and attitudes from the first state and the readings alone, by strapdown.

    Two readings are a step: each is taken to change evenly to the next. R(k + 1) = R(k) exp of the
    mean rate, with the coning term of Miller's two-sample formula left out: second order.
    """
    step = np.diff(imu.time_s)[:, None]
    attitude = [rotations(imu.orientation[0])]
    for rate, h in zip(0.5 * (imu.gyroscope[1:] + imu.gyroscope[:-1]), step, strict=True):
        attitude.append(attitude[-1] * Rotation.from_rotvec(rate * h))
    turns = Rotation.concatenate(attitude)
    felt = turns.apply(imu.accelerometer) - [0.0, 0.0, imu.gravity_m_s2]
    velocity, position = imu.velocity_m_s[:1], imu.position_m[:1]
    speeds = np.cumsum(0.5 * (felt[1:] + felt[:-1]) * step, axis=0)
    velocity = np.concatenate([velocity, velocity + speeds])
    shift = 0.5 * (velocity[1:] + velocity[:-1]) * step
    return np.concatenate([position, position + np.cumsum(shift, axis=0)]), turns


FLOOR = {"mav": (2e-5, 2e-6)}
TEN = Sampling(rate_hz=10)
MOTIONS = {
    "orbit": lambda: (
        orbit(radius_m=5.0, height_m=3.0, sweep_deg=-200.0, period_s=20.0, sampling=TEN),
        around(),
    ),
    "mav": lambda: (
        mav([[-10.0, -5.0], [5.0, 8.0], [12.0, -3.0]], height_m=3.0, sampling=TEN),
        around(hills),
    ),
    "descent": lambda: (
        descent(drift_m_s=3.0, drift_deg=30.0, entry_height_m=30.0, sampling=TEN),
        around(samples=20),
    ),
    "track": lambda: (tumbling(50), around()),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_integrated_the_readings_lead_back_onto_the_poses_ever_closer_with_the_rate(name):
    motion, context = MOTIONS[name]()
    built = motion.built(context)
    errors = []
    for rate in (100, 200, 400, 800):
        imu = read(motion, context, rate=float(rate))
        position, turns = (part[:: rate // 10] for part in integrated(imu))
        ahead = Rotation.from_matrix(built.to_world[:, :3, :3] @ AHEAD[:3, :3])
        assert len(position) == len(ahead)
        off = np.abs(position - built.to_world[:, :3, 3]).max()
        errors.append((off, (ahead.inv() * turns).magnitude().max()))
    (_, _, _, (off, turned)) = errors
    assert off < 2e-5
    assert turned < 2e-6
    # By the square of the step; what has no error has that of rounding. A mav looks for the first
    # and last millionth of its flight where it will, or did: a turn of 3e-7.
    fell = np.array(errors[:-1]) / np.maximum(errors[1:], 1e-12)
    assert ((fell > 3.5) | (np.array(errors[1:]) < FLOOR.get(name, (1e-9, 1e-9)))).all()


@pytest.mark.parametrize("name", MOTIONS)
def test_the_state_beside_the_readings_is_the_imu_s_own_wherever_it_is_mounted(name):
    motion, context = MOTIONS[name]()
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix()
    if name != "mav":
        mount[:3, 3] = 0.4, -0.2, 0.7
    imu = read(motion, context, to_rig=mount, rate=1000.0)
    built = motion.built(context)
    assert np.abs(imu.position_m[0] - (built.to_world[0] @ mount)[:3, 3]).max() < 1e-12
    turn = rotations(imu.orientation[:1]).as_matrix()[0]
    assert np.abs(turn - built.to_world[0, :3, :3] @ mount[:3, :3]).max() < 1e-12
    # The readings lead along its own positions: the lever arm is in them.
    position, turns = integrated(imu)
    assert np.abs(position - imu.position_m).max() < 2e-5
    assert (rotations(imu.orientation).inv() * turns).magnitude().max() < 2e-6


def test_on_a_circle_it_feels_the_pull_to_the_middle_and_its_even_turn():
    # 5 m around in 20 s, level with the center, counterclockwise from above: to the left ahead...
    motion = orbit(radius_m=5.0, height_m=0.0, sweep_deg=-200.0, period_s=20.0)
    motion = replace(motion, clearance_m=0.0)
    imu = read(motion, around(height=lambda x, y: 0 * x - 9.0), gravity=1.62)
    rate = 2 * np.pi / 20
    assert np.allclose(imu.angular_velocity, [0, 0, rate], rtol=0, atol=1e-13)
    # ... it looks at the center: the pull is forward, along x.
    assert np.allclose(imu.specific_force, [5 * rate * rate, 0, 1.62], rtol=0, atol=1e-12)
    assert len(imu.time_s) == int(np.floor(imu.time_s[-1] * 200 + 0.5)) + 1


def test_on_a_free_top_the_readings_are_its_closed_form_to_the_spline_s_order():
    errors = []
    for hz in (25, 50, 100):
        imu = read(tumbling(hz), around(), to_rig=np.eye(4))
        # Stamps since 1970 are doubles of 2e-7 s.
        t = np.arange(len(imu.time_s)) / 200
        attitude, rate, _ = top(t)
        up = np.stack([-2 * np.cos(t), -2 * np.sin(t), 9.81 - 1.2 * np.sin(2 * t)], axis=1)
        inner = (t > 1) & (t < 2)
        felt = attitude.inv().apply(up)
        errors.append(
            [np.abs(imu.gyroscope - rate)[inner].max(),
             np.abs(imu.accelerometer - felt)[inner].max()]
        )  # fmt: skip
    errors = np.array(errors)
    assert (errors[-1] < [2e-6, 2e-4]).all()
    assert (np.log2(errors[0] / errors[1]) > [2.7, 1.7]).all()


def allan(values, m):
    """Overlapping Allan deviation over m steps, by its definition (IEEE Std 952, C.1), [axes]."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    mean = (total[m:] - total[:-m]) / m
    return np.sqrt(0.5 * ((mean[m:] - mean[:-m]) ** 2).mean(axis=0))


@pytest.mark.parametrize(
    ("name", "of", "expected"),
    [
        ("noise_density", "white", lambda tau, value: value / np.sqrt(tau)),
        ("random_walk", "bias", lambda tau, value: value * np.sqrt(tau / 3)),
        ("bias_instability", "bias", lambda tau, value: value * np.sqrt(2 * np.log(2) / np.pi)),
    ],
)
def test_the_allan_deviation_of_the_noise_is_that_of_its_parameters(name, of, expected):
    rate, value = 100.0, 0.02
    noise = ImuNoise(**{f"{part}_{name}": value for part in ("gyroscope", "accelerometer")})
    runs = [noise_of(noise, rate, 60_000, key) for key in range(6)]
    values = np.concatenate([run[of == "white"] for run in runs], axis=1)
    for m in (8, 32, 128, 512):
        # 36 axes: the estimate of each errs by about 1 / sqrt(n / m).
        found = np.sqrt((allan(values, m) ** 2).mean())
        assert found == pytest.approx(expected(m / rate, value), rel=0.06)
    assert np.abs(np.corrcoef(np.diff(values, axis=0).T) - np.eye(36)).max() < 0.03


def test_readings_are_the_truth_with_bias_and_white_noise_and_longer_ones_begin_alike():
    noise = ImuNoise(*[0.01, 0.02, 0.03, 0.1, 0.2, 0.3])
    motion, context = MOTIONS["orbit"]()
    imu = read(motion, context, noise=noise)
    bias, white = noise_of(noise, 200.0, len(imu.time_s), 7)
    assert np.array_equal(imu.gyroscope, imu.angular_velocity + bias[:, :3] + white[:, :3])
    assert np.array_equal(imu.accelerometer, imu.specific_force + bias[:, 3:] + white[:, 3:])
    for one, longer in zip(noise_of(noise, 200.0, 50, 7), (bias, white), strict=True):
        assert np.array_equal(one, longer[:50])


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        ({**TRACK, "interpolation": "linear"}, '"linear"'),
        ({**TRACK, "interpolation": "screw"}, '"screw"'),
        ({**TRACK, "interpolation": "cubic"}, '"cubic"'),
        ({"type": "track", "file": "t.csv"}, "without sampling"),
        ({"type": "track", "file": "t.csv", "sampling": {}}, '"linear"'),
        ({**TRACK, "max_gap_s": 1, "gaps": "hold"}, "held in gaps"),
        ({**TRACK, "heights": "ground"}, "heights over the world"),
        ({"type": "rover", "speed_m_s": 1}, '"rover"'),
        ({"type": "lawn_mower", "along_m": 2, "across_m": 2, "height_m": 3}, '"lawn_mower"'),
        ({"type": "mav", "height_m": 3, "tilt": True}, "tilt"),
    ],
)
def test_motions_whose_accelerations_have_jumps_are_refused_by_name(tmp_path, pose, said):
    (tmp_path / "t.csv").write_text("0,0,0,3,1,0,0,0\n1,1,0,3,1,0,0,0\n2,2,1,3,1,0,0,0\n")
    cfg = small_cfg(samples=2)
    cfg["rigs"]["rover"] |= {"pose": pose, "imus": {"imu": {"gravity_m_s2": 9.81}}}
    with pytest.raises(CfgError) as caught:
        load(write_cfg(tmp_path, cfg))
    assert "rigs/rover/imus/imu: needs accelerations without jumps" in str(caught.value)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("imu", "said"),
    [
        ({}, "imus/imu: nothing says on which planet it is: expected the key gravity_m_s2"),
        ({"rate_hz": 0}, "imus/imu/rate_hz"),
        ({"gravity": 9.8}, 'gravity"'),
    ],
)
def test_faults_of_an_imu_name_their_place(tmp_path, imu, said):
    cfg = small_cfg(samples=2)
    cfg["light"]["sky"] = {"type": "clear"}
    cfg["rigs"]["rover"] |= {"pose": {"type": "orbit", "radius_m": 2}, "imus": {"imu": imu}}
    with pytest.raises(CfgError) as caught:
        load(write_cfg(tmp_path, cfg))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("planet", "ground", "gravity"),
    [
        ("earth", {}, 9.80665),
        ("mars", {}, 3.73),
        ("mars", {"planet": {"radius_m": 1e6}}, 3.73),
        ("mars", {"planet": {"body": "moon"}}, 1.62),
    ],
)
def test_gravity_is_that_of_the_grounds_planet_else_of_the_skys(tmp_path, planet, ground, gravity):
    cfg = small_cfg(samples=2)
    cfg["light"]["sky"] = cfg["light"]["sky"] | {"type": "atmosphere", "planet": planet}
    cfg["terrain"] |= ground
    cfg["rigs"]["rover"] |= {
        "pose": {"type": "orbit", "radius_m": 2, "height_m": 3}, "imus": {"a": {}, "b": {}}
    }  # fmt: skip
    first, second = draw(load(write_cfg(tmp_path, cfg)), 1, 0).rigs[0].imus
    assert (first.name, first.gravity_m_s2, second.name) == ("a", gravity, "b")
    assert np.array_equal(first.to_rig, AHEAD)
    assert first.key != second.key


@pytest.mark.parametrize(
    ("motion", "context", "said"),
    [
        (
            orbit(radius_m=5.0, height_m=0.5, clearance_m=1.2),
            around(hills),
            "rises over the ground",
        ),
        (mav([[-5.0, 0.0], [5.0, 0.0], [-5.0, 0.0]]), around(), "turns about at once"),
        (mav([[-5.0, 0.0]]), around(), "needs a motion over time"),
    ],
)
def test_a_motion_that_turns_out_to_have_jumps_is_refused_when_it_is_made(motion, context, said):
    with pytest.raises(SceneError, match=said):
        read(motion, context)


def test_a_track_whose_axes_are_usd_s_makes_an_imu_read_the_same():
    here = tumbling(50)
    half = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
    turned = quaternions(rotations(here.way.track.quaternion) * half)
    there = replace(here.way, usd=True, track=replace(here.way.track, quaternion=turned))
    one, other = (read(motion, around()) for motion in (here, replace(here, way=there)))
    for name in ("gyroscope", "accelerometer", "position_m", "velocity_m_s"):
        assert np.allclose(getattr(one, name), getattr(other, name), rtol=0, atol=1e-9)
    off = rotations(one.orientation).inv() * rotations(other.orientation)
    assert off.magnitude().max() < 1e-12


def test_a_gap_of_a_track_is_one_for_an_imu_too():
    motion = tumbling(50)
    gone = replace(
        motion.way, gaps=Gaps(0.01), track=replace(motion.way.track, lines=(*range(151),))
    )
    with pytest.raises(SceneError, match="without a pose after line 0, and the time"):
        read(replace(motion, way=gone), around())
