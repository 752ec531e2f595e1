"""Scenes of BlenderProc become cfgs with the cameras and objects where they were."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from both_ways import notes
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
from scenec.testing.processes import output_of

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


def test_cameras_and_objects_of_a_bop_scene_stand_where_they_stood(tmp_path):
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
def test_a_bop_scene_compiles_to_boxes_at_their_poses(tmp_path):
    write(imported(make_bop(tmp_path, [STILL, STILL]), tmp_path))
    compile_cfg(load(tmp_path / "ours.json"), seed=0, out=tmp_path / "out")
    scene = read_stage(tmp_path / "out" / "batch_0000" / "stage.usda")
    places = [(0.1, 0.0), (-0.1, 0.05), (0.5, 0.5)]
    rays = Rays(
        np.array([(x, y, 5.0) for x, y in places]), np.tile((0.0, 0.0, -1.0), (3, 1)), (1, 3)
    )
    heights = 5.0 - ExactCaster(scene).cast(rays)[2]
    assert heights == pytest.approx([0.3, 0.3, 0.2], abs=1e-6)


def test_objects_that_move_have_a_pose_for_each_picture(tmp_path):
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


def test_cameras_that_do_not_say_where_they_are_are_placed_by_objects(tmp_path):
    write(imported(make_bop(tmp_path, [STILL, STILL], world=False), tmp_path))
    first, second = poses_of(tmp_path)
    expected = np.linalg.inv(CAMERAS[0]) @ CAMERAS[1]
    assert np.linalg.inv(first) @ second == pytest.approx(expected, abs=1e-9)
    # The first one looks level.
    assert first[:3, 2] == pytest.approx([0, 1, 0])


def test_missing_models_are_named_at_once_and_boxes_stand_in(tmp_path):
    scene = make_bop(tmp_path, [STILL, STILL])
    (tmp_path / "models" / "obj_000003.ply").unlink()
    with pytest.raises(CfgError, match=r'no model "obj_000003\.ply"'):
        imported(scene, tmp_path)
    made = imported(scene, tmp_path, stand_ins=True)
    assert made.cfg["terrain"]["relief"][0]["height_m"] == pytest.approx(0.2)
    assert made.cfg["objects"]["obj_000003"]["models"][0]["file"] == "ours_files/obj_000003.usdc"
    write(made)


def test_faults_of_a_bop_scene_have_file_and_line(tmp_path):
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


def test_hdf5_files_with_states_are_read(tmp_path):
    made = imported(make_hdf5(tmp_path / "frames"), tmp_path, stand_ins=True)
    assert write(made) == []
    assert np.array(poses_of(tmp_path)) == pytest.approx(np.array(CAMERAS), abs=1e-9)
    assert made.cfg["rigs"]["camera"]["sensors"]["rgb"]["intrinsics"]["cx"] == 32
    assert set(made.cfg["objects"]) == {"cube_001"}


def test_hdf5_files_without_a_sound_camera_say_what_is_wrong(tmp_path):
    with pytest.raises(ScenecError, match="no data set 'campose'"):
        imported(make_hdf5(tmp_path / "none", cameras=False), tmp_path)
    with pytest.raises(
        ScenecError, match=r"cam_K: \[\[60, 0\], \[0\]\]: expected a matrix of 3 by 3"
    ):
        imported(make_hdf5(tmp_path / "ragged", matrix=[[60, 0], [0]]), tmp_path)


def write_hdf5(
    file: Path, camera: dict, objects: list[dict], size: tuple[int, ...] = (48, 64, 3)
) -> None:
    file.parent.mkdir(exist_ok=True)
    with h5py.File(file, "w") as made:
        made["colors"] = np.zeros(size, np.uint8)
        made["campose"] = np.bytes_(json.dumps([camera]))
        made["object_states"] = np.bytes_(json.dumps(objects))


LOOKS = {"cam2world_matrix": [[1, 0, 0, 0], [0, 0, -1, -6], [0, 1, 0, 1], [0, 0, 0, 1]]}
K = [[60, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]


def test_an_object_that_is_called_camera_has_a_file_of_its_own(tmp_path):
    names = ("camera", "Camera")
    objects = [{"name": name, "matrix_world": at(float(n), 0.0, 0.0).tolist()}
               for n, name in enumerate(names)]  # fmt: skip
    write_hdf5(tmp_path / "frames" / "0.hdf5", {**LOOKS, "cam_K": K}, objects)
    made = imported(tmp_path / "frames", tmp_path, stand_ins=True)
    assert write(made) == []
    files = [made.cfg["rigs"]["camera"]["pose"]["file"]]
    files += [made.cfg["objects"][name]["file"] for name in names]
    assert len({file.casefold() for file in files}) == 3
    (pose,) = poses_of(tmp_path, Path(files[0]).name)
    assert pose[:3, 3].tolist() == [0.0, -6.0, 1.0]
    for number, file in enumerate(files[1:]):
        row = (tmp_path / file).read_text().splitlines()[1]
        assert float(row.split(",")[0]) == number


def test_an_uneven_scale_and_a_mirror_are_said_to_be_approximated(tmp_path):
    turned = rotation_of([0.8, 0.0, 0.6, 0.0])
    scales = {"long": (1, 1, 3), "mirrored": (-1, 1, 1), "even": (2, 2, 2), "both": (1, -2, 1)}
    objects = []
    for number, (name, scale) in enumerate(scales.items()):
        matrix = np.eye(4)
        matrix[:3, :3] = turned * scale
        matrix[:3, 3] = 3.0 * number, 0.0, 0.0
        objects.append({"name": name, "matrix_world": matrix.tolist()})
    write_hdf5(tmp_path / "frames" / "0.hdf5", {**LOOKS, "cam_K": K}, objects)
    made = imported(tmp_path / "frames", tmp_path, stand_ins=True)
    write(made)
    said = notes(made, "approximated")
    assert "a scale of 1 x 1 x 3 (or a shear) becomes an even one of 1.442" in said["long 1"]
    assert said["mirrored 1"] == "it is mirrored across its x axis, and here it is not"
    assert "mirrored" in said["both 1"]
    assert "1 x 2 x 1" in said["both 1"]
    assert "even 1" not in said
    for name, scale in (("even", 2.0), ("mirrored", 1.0)):
        row = (tmp_path / "ours_files" / f"{name}.csv").read_text().splitlines()[1].split(",")
        assert rotation_of([float(v) for v in row[3:7]]) == pytest.approx(turned, abs=1e-9)
        assert float(row[7]) == pytest.approx(scale)


def test_pictures_that_differ_in_size_and_camera_follow_the_first_and_say_so(tmp_path):
    other = [[120, 0, 319.5], [0, 120, 239.5], [0, 0, 1]]
    thing = {"name": "thing", "matrix_world": np.eye(4).tolist()}
    write_hdf5(tmp_path / "frames" / "0.hdf5", {**LOOKS, "cam_K": K}, [thing])
    more = {**LOOKS, "cam_K": other, "k1": -0.3}
    write_hdf5(tmp_path / "frames" / "1.hdf5", more, [thing], (480, 640, 3))
    made = imported(tmp_path / "frames", tmp_path, stand_ins=True)
    sensor = made.cfg["rigs"]["camera"]["sensors"]["rgb"]
    assert sensor["resolution"] == [64, 48]
    assert sensor["intrinsics"] == {"fx": 60, "fy": 60, "cx": 32, "cy": 24}
    said = notes(made, "approximated")["1.hdf5/campose"]
    assert said.startswith("640 x 480 pixels and another camera matrix")
    assert "1.hdf5/campose/k1" in notes(made, "dropped")


def test_categories_are_a_level_of_labels_and_objects_of_some_pictures_are_named(tmp_path):
    place = np.eye(4).tolist()
    first = {"name": "a", "matrix_world": place, "customprop_category_id": 7}
    second = {"name": "b", "matrix_world": place, "category_id": 9, "customprop_part": "x"}
    both = {"name": "c", "matrix_world": place, "category_id": 7}
    write_hdf5(tmp_path / "frames" / "0.hdf5", {**LOOKS, "cam_K": K}, [first, both])
    write_hdf5(tmp_path / "frames" / "1.hdf5", {**LOOKS, "cam_K": K}, [second, both])
    made = imported(tmp_path / "frames", tmp_path, stand_ins=True)
    write(made)
    assert made.cfg["labels"]["category"] == {"category_7": 7, "category_9": 9}
    labels = {name: of["labels"]["category"] for name, of in made.cfg["objects"].items()}
    assert labels == {"a": "category_7", "b": "category_9", "c": "category_7"}
    said = notes(made, "approximated")
    assert said["a 1"] == "in 1 of 2 pictures (0), here in all"
    assert said["b 1"] == "in 1 of 2 pictures (1), here in all"
    assert "in 1 of 2" not in said.get("c 1", "")
    assert "1.hdf5/object_states/b/customprop_part" in notes(made, "dropped")


def texts(**changes: object) -> dict[str, object]:
    """Data sets of a sound file, with changes."""
    sound = {"campose": np.bytes_(json.dumps([{**LOOKS, "cam_K": K}])),
             "colors": np.zeros((48, 64, 3), np.uint8)}  # fmt: skip
    return sound | changes


def states(**values: object) -> np.bytes_:
    return np.bytes_(json.dumps([{**LOOKS, **values}]))


def placed(row: int, column: int, value: float) -> np.bytes_:
    """The state of an object whose matrix has another number."""
    matrix = np.eye(4)
    matrix[row, column] = value
    return np.bytes_(json.dumps([{"name": "a", "matrix_world": matrix.tolist()}]))


DAMAGED = {
    "a group for a camera": (texts(campose="group"), "/campose: expected a text of JSON"),
    "a group for a picture": (texts(colors="group"), "/colors: a shape of []"),
    "numbers for a text": (texts(campose=np.arange(5)), "/campose: expected a text of JSON"),
    "a number for a text": (texts(campose=3.5), "/campose: expected a text of JSON"),
    "a text without end": (texts(campose="bomb"), "/campose: expected a text of JSON"),
    "a link to itself": (texts(campose="loop"), "cannot be read"),
    "a link to another file": (texts(campose="away"), "cannot be read"),
    "a picture in one dimension": (texts(colors=np.zeros(5, np.uint8)), "a shape of [5]"),
    "a picture of nothing": (texts(colors=np.zeros((0, 0, 3), np.uint8)), "a shape of [0, 0, 3]"),
    "a picture without end": (texts(colors="vast"), "a shape of [1000000, 1000000, 3]"),
    "deep JSON": (texts(campose=np.bytes_("[" * 100_000)), "is no JSON"),
    "no number": (texts(campose=states(cam_K=[[np.nan, 0, 0], [0, 5, 0], [0, 0, 1]])), "cam_K"),
    "no focal length": (texts(campose=states(cam_K=np.zeros((3, 3)).tolist())), "above 0"),
    "a matrix that is no K": (texts(campose=states(cam_K=[[9, 0, 1], [1, 9, 1], [0, 0, 1]])),
                              "0 below the diagonal"),
    "degrees": (texts(campose=states(fov_x=60)), "expected radians between 0 and pi"),
    "a mirrored camera": (texts(campose=states(cam2world_matrix=np.diag((-1, 1, 1, 1)).tolist())),
                          "expected a pose, but it is mirrored"),
    "a projection": (texts(object_states=placed(3, 0, 1.0)), "a last row of [1.0,"),
    "far away": (texts(object_states=placed(0, 3, 1e30)), "numbers of up to 1e+30"),
    "infinitely far": (texts(object_states=placed(0, 3, np.inf)), "not finite"),
    "flat": (texts(object_states=placed(0, 0, 0.0)), "flat"),
}  # fmt: skip


@pytest.mark.parametrize("name", list(DAMAGED))
def test_a_damaged_hdf5_file_is_one_line(name, tmp_path, capsys):
    sets, words = DAMAGED[name]
    file, out = tmp_path / "0.hdf5", tmp_path / "ours.json"
    with h5py.File(file, "w") as made:
        for key, value in sets.items():
            if type(value) is not str:
                made[key] = value
            elif value == "group":
                made.create_group(key)
            elif value == "loop":
                made[key] = h5py.SoftLink(f"/{key}")
            elif value == "away":
                made[key] = h5py.ExternalLink("/no/such/file", "x")
            elif value == "bomb":
                made.create_dataset(key, (10**16,), "u1", chunks=(10**6,))
            else:
                made.create_dataset(key, (10**6, 10**6, 3), "u1", chunks=(1000, 1000, 3))
    assert main(["import", "blenderproc", str(file), "-o", str(out), "--stand-ins"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"scenec: {file}")
    assert words in line
    assert [path.name for path in tmp_path.iterdir()] == ["0.hdf5"]


def test_a_file_that_is_cut_short_is_one_line(tmp_path, capsys):
    whole, cut = tmp_path / "frames" / "0.hdf5", tmp_path / "cut.hdf5"
    write_hdf5(whole, {**LOOKS, "cam_K": K}, [])
    cut.write_bytes(whole.read_bytes()[:900])
    assert main(["import", "blenderproc", str(cut), "-o", str(tmp_path / "ours.json")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"scenec: {cut}: cannot be read")


def test_a_folder_of_neither_is_a_fault_that_names_scenes_below(tmp_path, capsys):
    make_bop(tmp_path, [STILL, STILL])
    out = tmp_path / "ours.json"
    assert (
        "scenes below it: 000000"
        in output_of(capsys, ["import", "blenderproc", str(tmp_path), "-o", str(out)], 2).err
    )
    assert not out.exists()
