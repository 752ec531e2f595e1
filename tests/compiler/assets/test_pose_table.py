"""Poses from CSV files: what they say, and one line for what is wrong with them."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.compiler.assets.pose_table import read_poses
from scenec.schemas.errors import SceneError


def table(tmp_path, text, models=3):
    file = tmp_path / "poses.csv"
    file.write_text(text, encoding="utf-8")
    return read_poses(file, models)


def test_rows_without_id_and_time_are_copies(tmp_path):
    poses = table(tmp_path, "# two\nx_m,y_m\n1,2\n\n3,4\n")
    assert poses.id.tolist() == [1, 2]
    assert poses.position_m.tolist() == [[1, 2, 0], [3, 4, 0]]
    assert poses.quaternion.tolist() == [[1, 0, 0, 0]] * 2
    assert poses.scale.tolist() == [1, 1]
    assert poses.model.tolist() == [0, 0]


def test_rows_with_time_and_without_id_are_one_object(tmp_path):
    poses = table(tmp_path, "time_s,x_m,y_m\n1,1,2\n0,3,4\n")
    assert poses.id.tolist() == [1, 1]
    assert poses.time_s.tolist() == [0, 1]
    assert poses.position_m[:, 0].tolist() == [3, 1]


def test_ids_group_rows_and_columns_stand_in_any_order(tmp_path):
    text = "y_m,x_m,id,time_s,model,qx,qy,qz,qw,scale,z_m\n"
    text += "1,2,7,0,2,0,0,1,0,0.5,9\n5,6,3,0,1,1,0,0,0,2,0\n1,3,7,1,2,0,0,0,1,0.5,9\n"
    poses = table(tmp_path, text)
    assert poses.id.tolist() == [3, 7, 7]
    assert poses.model.tolist() == [1, 2, 2]
    assert poses.position_m.tolist() == [[6, 5, 0], [2, 1, 9], [3, 1, 9]]
    assert poses.quaternion.tolist() == [[0, 1, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0]]
    assert poses.scale.tolist() == [2, 0.5, 0.5]


def test_latitude_and_longitude_stand_for_x_and_y(tmp_path):
    poses = table(tmp_path, "z_m,longitude_deg,latitude_deg\n5,30,-89\n")
    assert poses.is_geographic
    assert poses.position_m.tolist() == [[-89, 30, 5]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("latitude_deg,y_m\n1,2\n", ':1: no column is called "y_m"'),
        ("x_m,longitude_deg\n1,2\n", ':1: no column is called "longitude_deg"'),
        ("latitude_deg,z_m\n1,2\n", ':1: no column "longitude_deg"; expected columns of id'),
        ("", "no poses"),
        ("x_m,y_m\n", "no poses below the header"),
        ("x_m\n1\n", ':1: no column "y_m"'),
        ("x_m,y\n1,2\n", 'no column is called "y"'),
        ("x_m,y_m,x_m\n1,2,3\n", '"x_m" stands twice'),
        ("x_m,y_m\n1,2,3\n", ":2: 3 columns, expected 2"),
        ("x_m,y_m\n1,east\n", ':2: y_m is "east"'),
        ("x_m,y_m\n1,nan\n", ':2: y_m is "nan"'),
        ("x_m,y_m,qw\n1,2,1\n", 'no column "qx"'),
        ("x_m,y_m,qw,qx,qy,qz\n1,2,1,1,0,0\n", ":2: the quaternion has the length 1.41421"),
        ("x_m,y_m,id\n1,2,0\n", ":2: id is 0, expected a whole number from 1"),
        ("x_m,y_m,id\n1,2,1.5\n", ":2: id is 1.5"),
        ("x_m,y_m,id\n1,2,4\n3,4,4\n", ":3: object 4 stands in another row with the same time"),
        ("x_m,y_m,model\n1,2,3\n", ":2: model is 3, expected a whole number from 0 to 2"),
        ("time_s,x_m,y_m,model\n0,1,2,0\n1,1,2,1\n", ":3: object 1 has model 1, and another"),
        ("x_m,y_m,scale\n1,2,0\n", ":2: scale is 0, expected a number above 0"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, said):
    with pytest.raises(SceneError) as error:
        table(tmp_path, text)
    assert said in str(error.value)
    assert str(error.value).startswith("poses.csv")
    assert "\n" not in str(error.value)


def test_random_bytes_are_refused(tmp_path):
    rng = np.random.default_rng(0)
    for i in range(200):
        file = tmp_path / f"{i}.csv"
        file.write_bytes(rng.integers(0, 256, 40).astype(np.uint8).tobytes())
        with pytest.raises(SceneError):
            read_poses(file)
