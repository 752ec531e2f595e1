"""Tracks from files, at any times: stamps, gaps, formats and conventions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from test_motions import around as on_slope

from scenec.compiler.assets.tracks import read_stamped
from scenec.compiler.cameras.tracks import Gaps, Sampling, TrackWay
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.schemas.errors import CfgError, SceneError
from scenec.testing.small import small_cfg, write_cfg

HALF_TURN = np.diag([1.0, -1.0, -1.0])


def made(n: int = 9, seed: int = 0):
    rng = np.random.default_rng(seed)
    time = 1305031102.175 + np.cumsum(rng.integers(1, 40, n)) / 64.0
    return time, rng.uniform(-5, 5, (n, 3)), Rotation.random(n, random_state=seed)


def write_tum(file: Path, time, p, r) -> Path:
    lines = ["# ground truth", "# timestamp tx ty tz qx qy qz qw"]
    for t, xyz, q in zip(time, p, r.as_quat(), strict=True):
        lines.append(" ".join(f"{v:.17g}" for v in (t, *xyz, *q)))
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def planned(folder: Path, samples: int, **pose):
    cfg = small_cfg(samples=samples)
    cfg["rigs"]["rover"]["pose"] = {"type": "track", **pose}
    return draw(load(write_cfg(folder, cfg)), 1, 0).rigs[0].pose


def test_a_tum_track_is_followed_at_any_rate_as_scipy_does(tmp_path):
    time, p, r = made()
    write_tum(tmp_path / "t.txt", time, p, r)
    sampling = {"rate_hz": 20, "start_s": 0.3}
    pose = planned(tmp_path, 18, file="t.txt", format="tum", sampling=sampling)
    at = time[0] + 0.3 + np.arange(18) / 20
    assert np.allclose(pose.times, at, rtol=0, atol=1e-6)
    off = Rotation.from_matrix(pose.to_world[:, :3, :3]).inv() * Slerp(time, r)(at)
    # Stamps since 1970 are doubles of 2e-7 s.
    assert off.magnitude().max() < 1e-5
    expected = np.stack([np.interp(at, time, p[:, k]) for k in range(3)], axis=1)
    assert np.allclose(pose.to_world[:, :3, 3], expected, rtol=0, atol=1e-4)


def test_without_a_rate_samples_are_spread_from_the_first_stamp_to_the_last(tmp_path):
    time, p, r = made()
    write_tum(tmp_path / "t.txt", time, p, r)
    pose = planned(tmp_path, 5, file="t.txt", format="tum", sampling={})
    assert np.allclose(np.diff(pose.times), (time[-1] - time[0]) / 4, rtol=1e-6)
    assert np.allclose(pose.to_world[[0, -1], :3, 3], p[[0, -1]], rtol=0, atol=1e-12)


def test_given_times_and_one_sample_are_taken(tmp_path):
    time, p, r = made()
    write_tum(tmp_path / "t.txt", time, p, r)
    times = [0.0, 0.125, 0.126]
    pose = planned(tmp_path, 3, file="t.txt", format="tum", sampling={"times_s": times})
    assert np.allclose(pose.times - time[0], times, rtol=0, atol=1e-6)
    one = planned(tmp_path, 1, file="t.txt", format="tum", sampling={})
    assert np.array_equal(one.to_world[0, :3, 3], p[0])


@pytest.mark.parametrize("generation", ["2021", "today"])
def test_both_conventions_of_oaisys_are_imported_with_a_frame_rate(tmp_path, generation):
    _, p, r = made(4)
    # What the file of today says of the same cameras: Blender's axes.
    turn = r if generation == "2021" else r * Rotation.from_matrix(HALF_TURN)
    rows = [[k + 1, *p[k], *np.roll(turn.as_quat()[k], 1)] for k in range(4)]
    np.savetxt(tmp_path / "c.csv", np.array(rows), "%.17g", ",")
    convention = {"2021": "opencv", "today": "usd"}[generation]
    pose = planned(
        tmp_path, 4, file="c.csv", format="oaisys", frame_rate_hz=25, convention=convention
    )
    assert np.allclose(pose.times, (np.arange(4) + 1) / 25, rtol=0, atol=1e-15)
    assert np.allclose(pose.to_world[:, :3, :3], r.as_matrix(), rtol=0, atol=1e-14)
    assert np.array_equal(pose.to_world[:, :3, 3], p)
    between = planned(
        tmp_path, 2, file="c.csv", format="oaisys", frame_rate_hz=25, convention=convention,
        sampling={"times_s": [0.02, 0.04]},
    )  # fmt: skip
    assert np.allclose(between.to_world[0, :3, 3], 0.5 * (p[0] + p[1]), rtol=0, atol=1e-14)
    assert np.allclose(between.to_world[1, :3, :3], r.as_matrix()[1], rtol=0, atol=1e-14)


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_the_order_of_quaternions_is_declared(tmp_path, order):
    time, p, r = made()
    q = np.roll(r.as_quat(), 1 if order == "wxyz" else 0, axis=1)
    np.savetxt(tmp_path / "t.csv", np.column_stack([time - time[0], p, q]), "%.17g", ",")
    track = read_stamped(tmp_path / "t.csv", "csv", order)
    assert np.allclose(track.quaternion, np.roll(r.as_quat(), 1, axis=1), rtol=0, atol=1e-15)
    np.savetxt(tmp_path / "t.txt", np.column_stack([time, p, q]), "%.17g", " ")
    track = read_stamped(tmp_path / "t.txt", "tum", order)
    assert np.allclose(track.quaternion, np.roll(r.as_quat(), 1, axis=1), rtol=0, atol=1e-15)


def test_a_stamp_that_is_repeated_with_the_same_pose_counts_once(tmp_path):
    rows = "0 1 2 3 0 0 0 1\n1 1 2 4 0 0 1 0\n1 1 2 4 0 0 -1 0\n1 1 2 4 0 0 1 0\n2 1 2 5 0 0 0 1\n"
    (tmp_path / "t.txt").write_text(rows, encoding="utf-8")
    track = read_stamped(tmp_path / "t.txt", "tum")
    assert track.time_s.tolist() == [0, 1, 2]
    assert track.lines == (1, 2, 5)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("0 1 2 3 0 0 0 1\n1 1 2 4 0 0 1 0\n1 1 2 4.1 0 0 1 0\n", "t.txt:3: another pose at"),
        ("0 1 2 3 0 0 0 1\n1 1 2 4 0 0 1 0\n1 1 2 4 0 1 0 0\n", "of line 2: expected one pose"),
        ("1 1 2 3 0 0 0 1\n\n0.5 1 2 4 0 0 1 0\n", "t.txt:3: time_s is 0.5 after 1 in line 1"),
        ("1 1 2 3 0 0 0 1 9\n", "t.txt:1: 9 columns, expected 8: time_s x_m"),
        ("1 1 2 3 0 0 0.1 1\n", "t.txt:1: the quaternion has the length 1.00499"),
        ("1 1 2 3 0 0 nan 1\n", 't.txt:1: qz is "nan"'),
        ("time tx ty tz qx qy qz qw\n", 'time_s is "time"'),
        ("# nothing\n\n", "no poses"),
    ],
)
def test_what_is_wrong_with_a_track_is_told_with_its_line(tmp_path, text, part):
    (tmp_path / "t.txt").write_text(text, encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        read_stamped(tmp_path / "t.txt", "tum")
    assert part in str(caught.value)
    # The same is said when the cfg is loaded, in its place.
    with pytest.raises(CfgError) as caught:
        planned(tmp_path, 1, file="t.txt", format="tum")
    assert part in str(caught.value)


def test_missing_stamps_are_an_error_or_hold_the_pose_before_them(tmp_path):
    (tmp_path / "t.txt").write_text(
        "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n5 9 0 0 0 0 0 1\n6 10 0 0 0 0 0 1\n", encoding="utf-8"
    )
    track = read_stamped(tmp_path / "t.txt", "tum")
    at = np.array([0.5, 1.0, 1.5, 4.999, 5.0, 5.5])

    def x(gaps):
        way = TrackWay(at, track, "linear", gaps, "here: t.txt", False)
        return way.resampled(at)[:, 0, 3].tolist()

    assert x(Gaps()) == pytest.approx([0.5, 1, 2, 8.998, 9, 9.5])
    assert x(Gaps(2.0, hold=True)) == [0.5, 1, 1, 1, 9, 9.5]
    with pytest.raises(SceneError, match=r"t\.txt:3: 4 s without a pose after line 2, .* sample 2"):
        x(Gaps(2.0))
    # The ends of a gap are given poses.
    way = TrackWay(at, track, "linear", Gaps(2.0), "", False)
    assert way.resampled(at[[1, 4]])[:, 0, 3].tolist() == [1, 9]
    times = {"times_s": [0, 0.2, 1, 3, 4, 5, 6]}
    with pytest.raises(SceneError, match="sample 3 falls into"):
        planned(tmp_path, 7, file="t.txt", format="tum", sampling=times, max_gap_s=2)
    held = planned(
        tmp_path, 7, file="t.txt", format="tum", sampling={"rate_hz": 1}, max_gap_s=2, gaps="hold"
    )
    assert held.to_world[:, 0, 3].tolist() == [0, 1, 1, 1, 1, 9, 10]


def test_times_beyond_a_track_are_refused_with_what_to_do(tmp_path):
    write_tum(tmp_path / "t.txt", np.arange(4.0), np.zeros((4, 3)), Rotation.identity(4))
    for sampling, part in (
        ({"rate_hz": 1}, "sample 4 is at 4 s, expected 0 s to 3 s: ask for fewer samples than 5"),
        ({"start_s": 4}, "sample 0 is at 4 s"),
        ({"stop_s": 4}, "stop_s is 4, but the motion ends after 3 s"),
        ({"rate_hz": 2, "stop_s": 1}, "sample 3 is at 1.5 s, expected 0 s to 1 s"),
    ):
        with pytest.raises(SceneError) as caught:
            planned(tmp_path, 5, file="t.txt", format="tum", sampling=sampling)
        assert part in str(caught.value)
        assert "rigs/rover/pose: t.txt" in str(caught.value)


def test_the_last_sample_at_a_rate_may_be_the_last_stamp_whatever_rounding_says():
    # 0.1 * 3 is above 0.3.
    times = Sampling(rate_hz=10.0).times(0.3, 4, "here")
    assert times[-1] == 0.3
    for rate in (3.0, 7.0, 30.0, 29.97):
        for n in (2, 10, 1000, 100_000):
            assert len(Sampling(rate_hz=rate).times((n - 1) / rate, n, "here")) == n


@pytest.mark.parametrize(
    ("pose", "pointer", "part"),
    [
        ({"format": "oaisys"}, "/format", "frame_rate_hz"),
        ({"frame_rate_hz": 5}, "/frame_rate_hz", "take it away"),
        ({"interpolation": "cubic"}, "/interpolation", "nothing without sampling"),
        ({"sampling": {}, "gaps": "hold"}, "/gaps", "nothing without max_gap_s"),
        ({"sampling": {"rate_hz": 1, "times_s": [1, 2, 3]}}, "/sampling/times_s", "take one"),
        ({"sampling": {"times_s": [1, 2]}}, "/sampling/times_s", "2 times for 3 samples"),
        ({"sampling": {"times_s": [1, 2, 2]}}, "/sampling/times_s/2", "expected times that rise"),
        ({"format": "tumm"}, "/format", 'did you mean "tum"'),
    ],
)
def test_keys_that_do_not_go_together_are_told(tmp_path, pose, pointer, part):
    np.savetxt(tmp_path / "t.csv", [[t, 0, 0, 1, 1, 0, 0, 0] for t in range(4)], "%g", ",")
    with pytest.raises(CfgError) as caught:
        planned(tmp_path, 3, file="t.csv", **pose)
    assert [fault.pointer for fault in caught.value.faults] == [f"/rigs/rover/pose{pointer}"]
    assert part in caught.value.faults[0].message


def test_heights_over_the_ground_follow_it_between_the_samples_too(tmp_path):
    (tmp_path / "t.csv").write_text(
        "time_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,-4,1,1.5,1,0,0,0\n4,4,1,2.5,1,0,0,0\n"
    )
    asked = {"file": "t.csv", "sampling": {"rate_hz": 1}, "heights": "ground"}
    plan = planned(tmp_path, 5, **asked)
    context = on_slope(lambda x, y: 0.25 * x + 0.5 * y, samples=5)
    at = plan.built(context).to_world[:, :3, 3]
    x = np.array([-4.0, -2.0, 0.0, 2.0, 4.0])
    expected = np.stack([x, 1.0 + 0.0 * x, 0.25 * x + 0.5 + np.linspace(1.5, 2.5, 5)], axis=1)
    assert np.allclose(at, expected, rtol=0, atol=1e-6)
    way = TrackWay(
        plan.times, read_stamped(tmp_path / "t.csv", "csv"), "linear", Gaps(), "t", False
    )
    between = replace(plan, way=way).built(context).way.at(np.array([0.5, 3.25]))
    assert np.allclose(between[:, 2, 3], [1.625 - 0.75 + 0.5, 2.3125 + 0.625 + 0.5], atol=1e-6)
    over_world = planned(tmp_path, 5, **asked | {"heights": "world"}).built(context)
    assert np.array_equal(over_world.to_world[:, 2, 3], np.linspace(1.5, 2.5, 5))
    with pytest.raises(SceneError, match=r"heights are over the ground, reaches \(-4, 1\) m"):
        plan.built(on_slope(lambda x, y: 0.0 * x, samples=5, size=(6.0, 6.0)))
