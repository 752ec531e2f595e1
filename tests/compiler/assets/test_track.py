"""Camera tracks from CSV files."""

from __future__ import annotations

import numpy as np
import pytest
from small_cfg import changed, faults_of, load_cfg

from scenec.compiler.assets.tracks import read_stamped, read_track
from scenec.schemas.errors import SceneError

_ROWS = "0,1,2,3,1,0,0,0\n0.5,1,2,3,0.6,0,0.8,0\n"
_HEADER = "time_s,x_m,y_m,z_m,qw,qx,qy,qz\n"


def _read(tmp_path, text):
    file = tmp_path / "track.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_track(file)


@pytest.mark.parametrize(
    "text",
    [
        _ROWS,
        _HEADER + _ROWS,
        "# a remark, with a comma\n\n" + _HEADER + _ROWS,
        "\ufeff" + _HEADER.replace("\n", "\r\n") + _ROWS.replace("\n", "\r\n"),
        "note, qw,qx,qy,qz,time_s,x_m,y_m,z_m\na,1,0,0,0,0,1,2,3\nb,.6,0,+8e-1,0, 0.5 ,1,2,3",
    ],
)
def test_a_track_is_read_with_and_without_a_header(tmp_path, text):
    track = _read(tmp_path, text)
    assert track.time_s.tolist() == [0.0, 0.5]
    assert track.position_m.tolist() == [[1.0, 2.0, 3.0]] * 2
    assert np.allclose(track.quaternion, [[1, 0, 0, 0], [0.6, 0, 0.8, 0]], rtol=0, atol=1e-15)


@pytest.mark.parametrize("read", [read_track, read_stamped])
def test_latitude_and_longitude_stand_for_x_and_y_in_a_header(read, tmp_path):
    header = _HEADER.replace("x_m", "latitude_deg").replace("y_m", "longitude_deg")
    (tmp_path / "track.csv").write_text(header + _ROWS)
    track = read(tmp_path / "track.csv")
    assert track.is_geographic
    assert track.position_m.tolist() == [[1.0, 2.0, 3.0]] * 2


def test_quaternions_are_normalized(tmp_path):
    track = _read(tmp_path, "0,0,0,0,0.7071,0.7071,0,0\n")
    assert np.sqrt((track.quaternion**2).sum()) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "no poses"),
        (_HEADER, "no poses"),
        ("0,1,2,3,1,0,0\n", "track.csv:1: 7 columns, expected 8: time_s"),
        (_ROWS + "1,1,2,3,1,0,0\n", "track.csv:3: 7 columns"),
        (_HEADER.replace("qz", "q_z") + _ROWS, 'no column "qz" (is it "q_z"?)'),
        (_HEADER.replace("qz", "time") + _ROWS, 'no column "qz"; expected'),
        (_HEADER.replace("qz", "qy") + _ROWS, 'the column "qy" stands twice'),
        (_HEADER.replace("\n", ",qx\n") + _ROWS, 'the column "qx" stands twice'),
        (_ROWS + "1,1,2,x,1,0,0,0\n", 'track.csv:3: z_m is "x"'),
        (_ROWS + "1,1,2,nan,1,0,0,0\n", 'z_m is "nan"'),
        (_ROWS + "1,1,2,1e999,1,0,0,0\n", 'z_m is "1e999"'),
        (_ROWS + "1,1,2,1_0,1,0,0,0\n", 'z_m is "1_0"'),
        (_ROWS + "1,1,2,3,1,1,0,0\n", "track.csv:3: the quaternion has the length 1.41421"),
        (_ROWS + "1,1,2,3,0,0,0,0\n", "length 0"),
        (_ROWS + "0.5,1,2,3,1,0,0,0\n", "time_s is 0.5 after 0.5"),
        (b"\xff\xfe0", "UTF-8"),
        ('0,"1', "not a readable CSV file"),
        ("0,1\0", "expected"),
    ],
)
def test_what_is_not_a_track_is_refused_with_its_line(tmp_path, text, part):
    with pytest.raises(SceneError) as caught:
        _read(tmp_path, text)
    assert part in str(caught.value)
    assert str(caught.value).startswith("track.csv")


def test_a_track_has_a_row_for_each_sample(tmp_path):
    (tmp_path / "track.csv").write_text(_ROWS)
    pose = {"/rigs/rover/pose": {"type": "track", "file": "track.csv"}}
    spec = load_cfg(changed({**pose, "/samples": 2}), tmp_path)
    assert spec.files["rigs/rover/pose/file"].path.name == "track.csv"
    (fault,) = faults_of(changed({**pose, "/samples": 3}), tmp_path)
    assert fault.pointer == "/rigs/rover/pose/file"
    assert "2 poses for 3 samples" in fault.message
