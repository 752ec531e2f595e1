"""Scenes of BlenderProc become cfgs with the cameras and objects where they were."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from made_bop import CAMERAS, at, make_bop

from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.cli.main import main
from scenec.compiler.assets.tracks import read_track
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.importers.blenderproc.read import import_blenderproc
from scenec.importers.output import Imported, write
from scenec.importers.poses import FLIP, rotation_of
from scenec.schemas.errors import CfgError, ScenecError

STILL = [at(0.1, 0.0, 0.2, 30.0), at(-0.1, 0.05, 0.2)]


def imported(source: Path, tmp_path: Path, *, stand_ins: bool = False) -> Imported:
    return import_blenderproc(source, tmp_path / "ours.json", stand_ins=stand_ins)


def poses_of(tmp_path: Path, name: str = "camera.csv") -> list[np.ndarray]:
    track = read_track(tmp_path / "ours_files" / name)
    found = []
    for place, turn in zip(track.position_m, track.quaternion, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation_of(turn), place
        found.append(pose)
    return found


def test_cameras_and_objects_of_a_bop_scene_stand_where_they_stood(tmp_path: Path) -> None:
    made = imported(make_bop(tmp_path, [STILL, STILL]), tmp_path)
    assert write(made) == []
    assert np.array(poses_of(tmp_path)) == pytest.approx(np.array(CAMERAS), abs=1e-9)
    sensor = made.cfg["rigs"]["camera"]["sensors"]["rgb"]
    assert sensor["resolution"] == [64, 48]
    # The middle of the first pixel is (0, 0) there.
    assert sensor["intrinsics"] == {"fx": 60, "fy": 60, "cx": 32, "cy": 24}
    assert made.cfg["samples"] == 2
    rows = (tmp_path / "ours_files" / "obj_000003.csv").read_text().splitlines()
    assert len(rows) == 3
    assert [float(v) for v in rows[1].split(",")[:3]] == pytest.approx([0.1, 0.0, 0.2])
    # They stand on the plane.
    assert made.cfg["terrain"]["relief"][0]["height_m"] == pytest.approx(0.2)


@pytest.mark.slow
def test_a_bop_scene_compiles_to_boxes_at_their_poses(tmp_path: Path) -> None:
    write(imported(make_bop(tmp_path, [STILL, STILL]), tmp_path))
    compile_cfg(load(tmp_path / "ours.json"), seed=0, out=tmp_path / "out")
    scene = read_stage(tmp_path / "out" / "batch_0000" / "stage.usda")
    places = [(0.1, 0.0), (-0.1, 0.05), (0.5, 0.5)]
    rays = Rays(
        np.array([(x, y, 5.0) for x, y in places]), np.tile((0.0, 0.0, -1.0), (3, 1)), (1, 3)
    )
    heights = 5.0 - ExactCaster(scene).cast(rays)[2]
    assert heights == pytest.approx([0.3, 0.3, 0.2], abs=1e-6)


def test_objects_that_move_have_a_pose_for_each_picture(tmp_path: Path) -> None:
    moved = [at(0.2, 0.0, 0.2), STILL[1]]
    write(imported(make_bop(tmp_path, [STILL, moved]), tmp_path))
    rows = (tmp_path / "ours_files" / "obj_000003.csv").read_text().splitlines()
    assert rows[0].endswith("scale,id,time_s")
    assert [row.split(",")[8:] for row in rows[1:]] == [
        ["1", "0"],
        ["1", "1"],
        ["2", "0"],
        ["2", "1"],
    ]


def test_cameras_that_do_not_say_where_they_are_are_placed_by_objects(tmp_path: Path) -> None:
    write(imported(make_bop(tmp_path, [STILL, STILL], world=False), tmp_path))
    first, second = poses_of(tmp_path)
    expected = np.linalg.inv(CAMERAS[0]) @ CAMERAS[1]
    assert np.linalg.inv(first) @ second == pytest.approx(expected, abs=1e-9)
    # The first one looks level.
    assert first[:3, 2] == pytest.approx([0, 1, 0])


def test_missing_models_are_named_at_once_and_boxes_stand_in(tmp_path: Path) -> None:
    scene = make_bop(tmp_path, [STILL, STILL])
    (tmp_path / "models" / "obj_000003.ply").unlink()
    with pytest.raises(CfgError, match=r'no model "obj_000003\.ply"'):
        imported(scene, tmp_path)
    made = imported(scene, tmp_path, stand_ins=True)
    assert made.cfg["terrain"]["relief"][0]["height_m"] == pytest.approx(0.2)
    assert made.cfg["objects"]["obj_000003"]["models"][0]["file"] == "ours_files/obj_000003.usdc"
    write(made)


def test_faults_of_a_bop_scene_have_file_and_line(tmp_path: Path) -> None:
    scene = make_bop(tmp_path, [STILL, STILL])
    file = scene / "scene_camera.json"
    cameras = json.loads(file.read_text())
    cameras["0"]["cam_K"] = [1, 2]
    cameras["1"]["cam_R_w2c"] = [1, 0, 0, 0, 1, 0, 0, 0, 5]
    cameras["one"] = {}
    file.write_text(json.dumps(cameras, indent=1))
    with pytest.raises(CfgError) as caught:
        imported(scene, tmp_path)
    text = str(caught.value)
    assert "scene_camera.json" in text
    assert "/1/cam_R_w2c" in text
    assert "expected a rotation matrix" in text
    assert '"one": expected the number of a picture' in text
    assert all(fault.line for fault in caught.value.faults)


def make_hdf5(folder: Path, *, cameras: bool = True, matrix: object = None) -> Path:
    folder.mkdir()
    for number, pose in enumerate(CAMERAS):
        blender = pose.copy()
        blender[:3, :3] = pose[:3, :3] @ FLIP
        camera = {
            "cam2world_matrix": blender.tolist(),
            "cam_K": matrix or [[60, 0, 31.5], [0, 60, 23.5], [0, 0, 1]],
        }
        states = [{"name": "cube.001", "matrix_world": STILL[0].tolist()}]
        with h5py.File(folder / f"{number}.hdf5", "w") as file:
            file["colors"] = np.zeros((48, 64, 3), np.uint8)
            file["depth"] = np.zeros((48, 64), np.float32)
            if cameras:
                file["campose"] = json.dumps([camera])
            file["object_states"] = np.bytes_(json.dumps(states))
    return folder


def test_hdf5_files_with_states_are_read(tmp_path: Path) -> None:
    made = imported(make_hdf5(tmp_path / "frames"), tmp_path, stand_ins=True)
    assert write(made) == []
    assert np.array(poses_of(tmp_path)) == pytest.approx(np.array(CAMERAS), abs=1e-9)
    assert made.cfg["rigs"]["camera"]["sensors"]["rgb"]["intrinsics"]["cx"] == 32
    assert set(made.cfg["objects"]) == {"cube_001"}


def test_hdf5_files_without_a_sound_camera_say_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(ScenecError, match="no data set 'campose'"):
        imported(make_hdf5(tmp_path / "none", cameras=False), tmp_path)
    with pytest.raises(
        ScenecError, match=r"cam_K: \[\[60, 0\], \[0\]\]: expected a matrix of 3 by 3"
    ):
        imported(make_hdf5(tmp_path / "ragged", matrix=[[60, 0], [0]]), tmp_path)


def test_a_folder_of_neither_is_a_fault_that_names_scenes_below(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_bop(tmp_path, [STILL, STILL])
    out = tmp_path / "ours.json"
    assert main(["import", "blenderproc", str(tmp_path), "-o", str(out)]) == 2
    assert "scenes below it: 000000" in capsys.readouterr().err
    assert not out.exists()
