"""What a rig's IMU reads goes from a cfg into a bag, and leads back onto the rig's poses there."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

import scenec
from scenec.testing.bags import read, stamp
from scenec.testing.small import small_cfg, write_cfg


def test_the_imu_of_a_bag_integrates_onto_the_odometry_beside_it(tmp_path):
    cfg = small_cfg(samples=6)
    cfg["terrain"]["spacing_m"] = 1.0
    cfg["outputs"] = ["depth"]
    cfg["objects"]["rocks"] |= {"count": 5}
    rig = cfg["rigs"]["rover"]
    rig["pose"] = {"type": "orbit", "radius_m": 4, "height_m": 3, "period_s": 12,
                   "sweep_deg": 90, "sampling": {"rate_hz": 2}}  # fmt: skip
    rig["imus"] = {"imu": {"rate_hz": 500, "gravity_m_s2": 3.71}}
    for sensor in rig["sensors"].values():
        sensor |= {"outputs": ["depth"], "resolution": [16, 12]}
    out = tmp_path / "out"
    scenec.compile(write_cfg(tmp_path, cfg), out, seed=1)
    scenec.render(out, passes=("depth",), workers=0)
    folder = scenec.export(out, "rosbag2", workers=0).folder
    found = read(folder / "all/batch_0000")
    odometry = [message for _, message in found["/rover/odom"]]
    readings = [message for _, message in found["/rover_imu"]]
    assert len(odometry) == 6
    assert len(readings) == 1251
    place, turn = pose_of(odometry[0])
    # 4 m around (0, 0), clockwise from above, a turn in 12 s.
    velocity = 2 * np.pi / 12 * np.array([place[1], -place[0], 0.0])
    by_time = {0: (place, turn)}
    for one, two in itertools.pairwise(readings):
        h = (stamp(two) - stamp(one)) * 1e-9
        rate = 0.5 * (vector(one.angular_velocity) + vector(two.angular_velocity))
        after = turn * Rotation.from_rotvec(h * rate)
        felt = turn.apply(vector(one.linear_acceleration))
        felt = 0.5 * (felt + after.apply(vector(two.linear_acceleration))) - [0, 0, 3.71]
        place = place + h * (velocity + 0.5 * h * felt)
        velocity, turn = velocity + h * felt, after
        by_time[stamp(two)] = place, turn
    for message in odometry:
        truth, ahead = pose_of(message)
        place, turn = by_time[stamp(message)]
        assert np.abs(place - truth).max() < 1e-5
        assert (turn.inv() * ahead).magnitude() < 1e-9


def pose_of(odometry):
    q = odometry.pose.pose.orientation
    return vector(odometry.pose.pose.position), Rotation.from_quat([q.x, q.y, q.z, q.w])


def vector(message):
    return np.array([message.x, message.y, message.z])
