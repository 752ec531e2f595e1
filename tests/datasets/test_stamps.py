"""Time stamps in files are the stage's, whatever epoch they count from."""

from __future__ import annotations

from fractions import Fraction

import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.registry import find_format
from scenec.schemas.errors import OutputError
from scenec.testing.made_frames import LEFT, make_out

NANO = 10**9
#: Seconds: an epoch of its own, Unix time, an odd number of bits, the last that ROS knows.
EPOCHS = (0.0, 1.7e9, 1700000000.1234567, 2.0**31 - 4.0)


def track(begin: float) -> list[float]:
    """Stamps of 20 Hz, as a track in double precision has them."""
    return [begin + 0.05 * i for i in range(4)]


def exact(seconds: float, ticks: int, added: int = 0) -> int:
    """By whole numbers alone."""
    return round(Fraction(seconds) * ticks) + added * ticks


def made(tmp_path, times):
    return make_out(tmp_path / "out", (LEFT,), len(times), times=times).out


def euroc_stamps(folder):
    lines = (folder / "all/batch_0000_rover/mav0/cam0/data.csv").read_text().splitlines()[1:]
    stamps = [int(line.split(",")[0]) for line in lines]
    assert [line.split(",")[1] for line in lines] == [f"{stamp}.png" for stamp in stamps]
    truth = folder / "all/batch_0000_rover/mav0/state_groundtruth_estimate0/data.csv"
    assert [int(line.split(",")[0]) for line in truth.read_text().splitlines()[1:]] == stamps
    assert all((folder / f"all/batch_0000_rover/mav0/cam0/data/{s}.png").is_file() for s in stamps)
    return stamps


def bag_stamps(folder):
    store = get_typestore(Stores.ROS2_HUMBLE)
    found = {}
    with Reader(folder / "all/batch_0000") as reader:
        for connection, time, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            if connection.topic.startswith("/rover_left/"):
                header = message.header.stamp
                assert 0 <= header.nanosec < NANO
                assert header.sec * NANO + header.nanosec == time
                found.setdefault(connection.topic, []).append(time)
    (stamps,) = {tuple(times) for times in found.values()}
    return list(stamps)


@pytest.mark.parametrize("begin", EPOCHS)
def test_stamps_of_four_formats_are_the_stages_to_the_last_digit(tmp_path, begin):
    times = track(begin)
    out = made(tmp_path, times)
    for name in ("euroc", "rosbag2", "tum", "kitti"):
        export(out, name, tmp_path / name)
    wanted = [exact(t, NANO) for t in times]
    assert euroc_stamps(tmp_path / "euroc") == wanted
    assert bag_stamps(tmp_path / "rosbag2") == wanted
    micros = [f"{exact(t, 10**6) // 10**6}.{exact(t, 10**6) % 10**6:06d}" for t in times]
    truth = (tmp_path / "tum/all/batch_0000_rover_left/groundtruth.txt").read_text().splitlines()
    assert [line.split()[0] for line in truth if not line.startswith("#")] == micros
    assert (tmp_path / "kitti/sequences/00/times.txt").read_text().split() == micros


def test_euroc_goes_beyond_the_32_bits_of_ros(tmp_path):
    times = track(4e9)
    export(made(tmp_path, times), "euroc", tmp_path / "euroc")
    assert euroc_stamps(tmp_path / "euroc") == [exact(t, NANO) for t in times]


@pytest.mark.parametrize("name", ["euroc", "rosbag2", "tum", "kitti"])
def test_start_s_is_added_and_may_be_negative(tmp_path, name):
    out = made(tmp_path, track(1.7e9))
    export(out, name, tmp_path / "d", Choice(options={"start_s": "-1699999990"}))
    wanted = [exact(t, NANO, -1699999990) for t in track(1.7e9)]
    if name == "euroc":
        assert euroc_stamps(tmp_path / "d") == wanted
    elif name == "rosbag2":
        assert bag_stamps(tmp_path / "d") == wanted
    else:
        place = "sequences/00/times.txt" if name == "kitti" else "all/batch_0000_rover_left/rgb.txt"
        lines = (tmp_path / "d" / place).read_text().splitlines()
        assert next(line.split()[0] for line in lines if line[0] != "#") == "10.000000"
    option = find_format(name).options["start_s"]
    assert option.default == "0"
    assert option.help.startswith("relative: seconds added")


@pytest.mark.parametrize("name", ["euroc", "rosbag2", "tum", "kitti"])
@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([-0.5, 0.5], r"000000: its time is -0\.50* s, and format .* no negative ones"),
        ([0.0, 1e300], r"000001: its time (is 1e\+300 s|stamp is 1e).* below "),
    ],
)
def test_times_that_no_file_holds_are_refused_and_nothing_is_left(tmp_path, name, times, message):
    out = made(tmp_path, times)
    with pytest.raises(OutputError, match=message):
        export(out, name, tmp_path / "d")
    assert not (tmp_path / "d").exists()
