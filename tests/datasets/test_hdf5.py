"""What `export hdf5` writes is read back by h5py alone, to the bit."""

from __future__ import annotations

import weakref
from collections.abc import Iterator

import h5py
import numpy as np
import pytest
from PIL import Image

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.contract import Info
from scenec.datasets.formats.registry import find_format
from scenec.datasets.source import LoadedFrame, Source
from scenec.schemas.errors import FrameError
from scenec.schemas.picture import develop
from scenec.testing.made_output import (
    EXPOSURE_EV,
    LABELS,
    exported,
    frame_table,
    make_output,
    pose_of,
    some_passes,
)


@pytest.mark.parametrize("compression", ["none", "lzf", "gzip"])
def test_every_pass_comes_back_bit_for_bit(output, tmp_path, compression):
    folder = exported(output, "hdf5", tmp_path / "d", compression=compression)
    with h5py.File(folder / "all_12x8.h5") as file:
        for number in range(8):
            for name, array in some_passes(number).items():
                stored = file[name][number]
                assert np.array_equal(stored, array), name
                assert file[name].chunks == (1, *array.shape)
        assert file["depth"].dtype == file["rgb"].dtype == np.float32
        assert np.isposinf(file["depth"][0, 0]).all()
        assert file["instance"].dtype == np.uint32
        assert file["rgb"].compression == (None if compression == "none" else compression)


def test_labels_are_stored_in_the_smallest_type_that_holds_their_ids(output, tmp_path):
    with h5py.File(exported(output, "hdf5", tmp_path / "d") / "all_12x8.h5") as file:
        assert file["label.class"].dtype == np.uint8
        assert file["label.surface"].dtype == np.uint16
        for level, names in LABELS.items():
            group = file[f"labels/{level}"]
            assert dict(zip(group["ids"], group["names"].asstr(), strict=True)) == names
            attributes = file[f"label.{level}"].attrs
            assert list(attributes["label_names"]) == list(names.values())
            assert list(attributes["label_ids"]) == list(names)


def test_the_tables_of_instances_are_concatenated_with_offsets(output, tmp_path):
    with h5py.File(exported(output, "hdf5", tmp_path / "d") / "all_12x8.h5") as file:
        group = file["instances"]
        assert len(group["offsets"]) == 9
        assert group["offsets"][0] == 0
        assert group["offsets"][-1] == len(group["id"])
        for number in range(8):
            start, end = group["offsets"][number : number + 2]
            table = frame_table(some_passes(number))
            for name, column in table.items():
                if name == "class":
                    classes = group["classes"].asstr()[:]
                    assert (classes[group["class_index"][start:end]] == column).all()
                elif name.startswith("label."):
                    names = LABELS[name.removeprefix("label.")]
                    found = [names.get(i, "") for i in group[name][start:end]]
                    assert found == column.tolist()
                else:
                    assert group[name][start:end] == pytest.approx(column, rel=1e-8)
            shown = np.unique(file["instance"][number])
            assert (np.sort(group["id"][start:end]) == shown[shown > 0]).all()


def test_cameras_come_back_exactly(output, tmp_path):
    with h5py.File(exported(output, "hdf5", tmp_path / "d") / "all_12x8.h5") as file:
        cameras = file["camera"].asstr()[:]
        for number in range(8):
            sample = int(file["sample"][number])
            assert (file["camera_to_world"][number] == pose_of(cameras[number], sample)).all()
            assert file["time_s"][number] == 0.5 * sample
            assert file["intrinsics"][number].tolist() == [[10, 0, 6], [0, 11, 4], [0, 0, 1]]
            name = f"batch_{file['batch'][number]:04d}/{cameras[number]}/{sample:06d}"
            assert file["frame"].asstr()[number] == name


def test_everything_says_what_it_is(output, tmp_path):
    with h5py.File(exported(output, "hdf5", tmp_path / "d", rgb="both") / "all_12x8.h5") as file:
        silent: list[str] = []

        def look(name: str, node: h5py.Dataset | h5py.Group) -> None:
            told = isinstance(node, h5py.Group) or node.attrs.get("convention")
            if not told and not name.startswith("labels/") and name != "instances/classes":
                silent.append(name)

        file.visititems(look)
        assert silent == []
        assert file["depth"].attrs["unit"] == file["instances/depth_mean"].attrs["unit"] == "m"
        assert "OpenCV" in file["camera_to_world"].attrs["convention"]


def test_the_picture_is_the_one_beside_the_frame(output, tmp_path):
    with h5py.File(exported(output, "hdf5", tmp_path / "d", rgb="srgb8") / "all_12x8.h5") as file:
        assert "rgb" not in file
        picture = Image.open(output / "batch_0000/frames/annotation/rover_left/000001.png")
        assert (file["rgb8"][1] == np.array(picture)).all()
        assert (file["rgb8"][1] == develop(some_passes(1)["rgb"], EXPOSURE_EV)).all()


def test_a_file_holds_one_resolution_and_on_request_one_camera(tmp_path):
    wide = {0: 12, 1: 12, 2: 20, 3: 20}
    out = make_output(tmp_path / "out", lambda n: some_passes(n, wide[n % 4], rgb=False), batches=2)
    folder = exported(out, "hdf5", tmp_path / "a")
    assert sorted(p.name for p in folder.glob("*.h5")) == ["all_12x8.h5", "all_20x8.h5"]
    folder = exported(out, "hdf5", tmp_path / "b", by="camera")
    names = ["all_rover_left_12x8.h5", "all_rover_right_20x8.h5"]
    assert sorted(p.name for p in folder.glob("*.h5")) == names
    with h5py.File(folder / names[1]) as file:
        assert set(file["camera"].asstr()[:]) == {"rover_right"}
        assert file["depth"].shape == (4, 8, 20)


def test_frames_that_are_left_out_leave_no_gap(tmp_path):
    out = make_output(tmp_path / "out", batches=1)
    (out / "batch_0000/frames/annotation/rover_left/000001.exr").write_bytes(b"torn")
    report = export(out, "hdf5", tmp_path / "d", Choice(faults="skip"))
    assert report.frames == 3
    with h5py.File(report.folder / "all_12x8.h5") as file:
        assert len(file["depth"]) == len(file["camera"]) == 3
        for at, number in enumerate((0, 2, 3)):
            assert (file["depth"][at] == some_passes(number)["depth"]).all()


def test_one_pixel_without_instances_or_rgb_is_a_file(tmp_path):
    def passes(number: int) -> dict:
        ids = np.zeros((1, 1), np.uint32)
        return {"label.class": ids + 2, "instance": ids, "depth": np.full((1, 1), np.inf)}

    out = make_output(tmp_path / "out", passes, batches=1, samples=1)
    with h5py.File(exported(out, "hdf5", tmp_path / "d", shuffle="no") / "all_1x1.h5") as file:
        assert file["depth"].shape == (2, 1, 1)
        assert file["instances/offsets"][:].tolist() == [0, 0, 0]
        assert len(file["instances/id"]) == 0


def test_an_id_without_a_name_is_never_cut_to_fit(tmp_path):
    def passes(number: int) -> dict:
        return some_passes(number) | {"label.class": np.full((8, 12), 999, np.uint32)}

    out = make_output(tmp_path / "out", passes, batches=1)
    with pytest.raises(FrameError, match=r"000000\.exr: label.class holds ids \[999\] that"):
        exported(out, "hdf5", tmp_path / "d")
    assert not (tmp_path / "d").exists()


def test_frames_of_other_passes_are_refused_by_name(tmp_path):
    def passes(number: int) -> dict:
        found = some_passes(number)
        return found if number < 3 else {k: v for k, v in found.items() if k != "depth"}

    out = make_output(tmp_path / "out", passes, batches=1)
    with pytest.raises(
        FrameError, match=r"rover_right.000001\.exr: holds rgb, .*the frames before"
    ):
        exported(out, "hdf5", tmp_path / "d")


def test_columns_longer_than_their_blocks_come_back_whole(tmp_path):
    # 6 frames of 3000 instances are more lines than are held back at a time.
    def passes(number: int) -> dict:
        ids = np.arange(1, 3001, dtype=np.uint32).reshape(30, 100) + np.uint32(number)
        return {"label.class": np.full((30, 100), 3, np.uint32), "instance": ids}

    out = make_output(tmp_path / "out", passes, batches=1, cameras=("c",), samples=6)
    with h5py.File(exported(out, "hdf5", tmp_path / "d") / "all_100x30.h5") as file:
        expected = np.concatenate([np.arange(1, 3001) + n for n in range(6)])
        assert (file["instances/id"][:] == expected).all()
        assert (np.diff(file["instances/offsets"][:].astype(int)) == 3000).all()


@pytest.mark.parametrize("name", ["hdf5", "webdataset"])
def test_no_more_than_two_frames_are_in_memory_at_a_time(output, tmp_path, name):
    source = Source(output)
    alive: list[weakref.ref[LoadedFrame]] = []
    most = 0

    def frames() -> Iterator[LoadedFrame]:
        nonlocal most
        for ref in source.frames:
            frame = source.load(ref)
            alive.append(weakref.ref(frame))
            most = max(most, sum(one() is not None for one in alive))
            yield frame

    info = Info("made", LABELS, "class", source.passes(), ("all",), {})
    form = find_format(name)(info)
    (task,) = form.tasks({"all": source.frames})
    form.write(task, frames(), tmp_path, tmp_path)
    assert len(alive) == 8
    assert most <= 2
